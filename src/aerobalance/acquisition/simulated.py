"""The simulated rigs as a source: shaken or released while they run."""

from __future__ import annotations

import math
import secrets
import time
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.acquisition.six_rig import GROUND_NOISE, LARGEST_SHAKE, SixMotion, six_dynamics
from aerobalance.acquisition.source import Block, Pacing, SourceChannel, SourceEndedError
from aerobalance.acquisition.source_settings import CLOSED, HALF_RANGES, SHUNT_SHARE, TOUCH_SHARE, RigName
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import QUANTITIES, Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, is_gauge
from aerobalance.simulation import ACCELEROMETER_RANGE, ARMATURE_MASS
from aerobalance.simulation.oscillator import Oscillator
from aerobalance.simulation.published import CABLE_CUT, VIBRATION_RIG
from aerobalance.simulation.six_components import GROUND_CHANNELS

LARGEST_FREQUENCY: Final = 0.45
"""Largest frequency of the drive, over the sampling rate."""

LARGEST_DRIVE: Final = 500.0
"""Largest amplitude of the drive [N]."""

HANGING: Final = 1.0
"""Time within which a new cable takes up its force [s]."""

CIRCUIT_NOISE: Final = 0.02
"""Noise of the contact circuit's voltage [V]."""


class ShakenMode:
    """One mode under a steady force and a sine, in closed form from block to block.

    z' = pole z + p, where p is a constant and a sine of constant frequency whose amplitude may change on a straight
    line; the state at the end of one block begins the next, so the motion does not depend on how it is cut.

    Parameters
    ----------
    mode
        Mass, stiffness and damping.
    push
        Steady force over mass at rest before the start [m/s^2].
    """

    def __init__(self, mode: Oscillator, push: float = 0.0) -> None:
        self.mode, self.push = mode, push
        self.state = complex(-push / mode.pole)

    def move(self, time: Array, *, omega: float, begin: complex, change: complex) -> tuple[Array, Array, complex]:
        """Return displacement and velocity at `time`, and the state there in the last place.

        Parameters
        ----------
        time
            Times from the state's own, shape (n,), increasing [s].
        omega
            Angular frequency of the sine [rad/s].
        begin
            Its complex amplitude over mass at time 0: the push is Im((begin + change t) exp(i omega t)) [m/s^2].
        change
            Change of the amplitude [m/s^3].
        """
        pole = self.mode.pole
        z = np.zeros(time.size, dtype=np.complex128)
        start = -self.push / pole
        if begin or change:
            for sign in (1, -1):
                rate = 1j * sign * omega
                P, D = (begin, change) if sign > 0 else (-np.conj(begin), -np.conj(change))
                lag = rate - pole
                z += np.exp(rate * time) * ((P + D * time) / lag - D / lag**2) / 2j
                start += (P / lag - D / lag**2) / 2j
        z += -self.push / pole + np.exp(pole * time) * (self.state - start)
        y, velocity = self.mode.motion(z)
        return y, velocity, complex(z[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """How a simulated rig is set.

    Attributes
    ----------
    rig
        ``vibration`` (6F-540 on a shaker), ``cable_cut`` (6-EB-128-1, pulled by a cable), or ``six`` (six coupled
        components, pulled in all of them, and the six accelerations of a ground end that may shake).
    rate
        Sampling rate [Hz]; None for that of the printed experiment.
    seed
        Seed of the noise; None for a fresh one.
    speed
        Seconds of the rig in a second of the clock; infinite for as fast as possible.
    block
        Length of a block [s].
    frequency, amplitude
        Drive of the shaker [Hz, N].
    cable_force
        Force of the cable before it is cut [N]; None for the printed one.
    cut_at
        When the cable is cut [s]; None for on call.
    noise
        Factor of the printed noise.
    circuit
        ``fouling`` for a contact circuit between model and support, on a channel of that name; ``none`` without.
    balance
        Matrix of the balance of the rig with six, whose gauge outputs are then given in the place of its loads.
    """

    rig: RigName = "vibration"
    rate: float | None = None
    seed: int | None = None
    speed: float = 1.0
    block: float = 0.02
    frequency: float = 100.0
    amplitude: float = 10.0
    cable_force: float | None = None
    cut_at: float | None = None
    noise: float = 1.0
    circuit: Literal["none", "fouling"] = "none"
    balance: BalanceMatrix | None = None


@dataclass(slots=True)
class _Drive:
    """The sine of the shaker: its phase goes on where its frequency changes."""

    frequency: float
    amplitude: float
    phase: float = 0.0
    wanted: tuple[float, float] = field(default=(0.0, 0.0))


class SimulatedSource:
    """A rig that is simulated while it is recorded.

    A new frequency holds from the next block on, without a jump of phase; a new amplitude is reached on a straight
    line within that block; the cable is cut at the first sample of the next block, or at the time given. A new cable
    is hung up on call: its force grows on a straight line within `HANGING`.

    Parameters
    ----------
    settings
        Which rig, and how it is set.
    """

    patient = True

    def __init__(self, settings: RigSettings) -> None:
        self.settings = settings
        self.clocked = settings.speed == 1.0
        shaken = settings.rig == "vibration"
        printed = VIBRATION_RIG if shaken else CABLE_CUT
        self.rate = settings.rate or (25_000.0 if settings.rig == "six" else printed.rate.value)
        self._components = COMPONENTS if settings.rig == "six" else ("AF",)
        self._outputs = None if settings.balance is None else _Outputs(settings.balance, settings.rig)
        names = [*self._components] if self._outputs is None else [*self._outputs.names]
        names += GROUND_CHANNELS if settings.rig == "six" else ("ground_acceleration", "live_acceleration", "pitch")
        names += ["fouling"] if settings.circuit == "fouling" else []
        self.names = tuple(names)
        self.channels = tuple(SourceChannel(name, _unit(name)) for name in names)
        touching = ("touch", "release") if settings.circuit == "fouling" else ()
        own = {"vibration": ("frequency", "amplitude"), "cable_cut": ("cut", "hang"), "six": ("cut", "hang", "shake")}
        self.controls = (*own[settings.rig], "shunt", *touching)
        half_ranges = HALF_RANGES[settings.rig]
        self._half_ranges = np.array([half_ranges[name] for name in self._components])
        self._shunt = self._touching = False
        self.seed = secrets.randbits(63) if settings.seed is None else settings.seed
        self.description = f"simulated rig: {settings.rig}, {self.rate:g} Hz, seed {self.seed}"
        self._noise = np.random.default_rng(self.seed)
        load, acceleration = printed.dynamic_deviation.value, printed.acceleration_deviation.value
        self._deviation = settings.noise * np.array(
            [{"pitch": 0.0, "fouling": CIRCUIT_NOISE}.get(name, load) for name in self.names]
        )
        self._deviation[["acceleration" in name for name in self.names]] = settings.noise * acceleration
        if settings.rig == "six":
            self._deviation[6:12] = settings.noise * np.array(GROUND_NOISE)
        if self._outputs is not None:
            self._deviation[:6] = settings.noise * load / self._outputs.sensitivity
        self._rows = max(1, round(settings.block * self.rate))
        self._pacing = Pacing(self.rate, settings.speed)
        self._tick = 0
        self._stopped = False
        self._cable = 0.0
        if not shaken:
            self._cable = -CABLE_CUT.excitation.value if settings.cable_force is None else settings.cable_force
        self._full_cable = self._cable
        self._hang_tick: float = -math.inf
        self._cut_tick = math.inf if settings.cut_at is None else round(settings.cut_at * self.rate)
        self._drive = _Drive(settings.frequency, 0.0, wanted=(settings.frequency, settings.amplitude))
        self._check(settings.frequency, settings.amplitude)
        self._shake_now = self._shake_wanted = 0.0
        self._six: SixMotion | None = None
        if settings.rig == "six":
            self._six = SixMotion(six_dynamics(), self._cable * np.ones(6))
        else:
            self._dynamics = printed.dynamics
            self._mode = self._shaken(printed.dynamics)

    def start(self) -> None:
        """Begin at rest, with the drive on."""
        self._pacing.start()

    def stop(self) -> None:
        """End."""
        self._stopped = True

    def control(self, name: str, value: float) -> str:
        """Set what the rig has: the drive, the cable, the shunt, the contact with the support.

        ``frequency`` [Hz] and ``amplitude`` [N] of the drive; ``cut`` the cable, ``hang`` a new one (any value);
        ``shake`` the ground end of the rig with six [m/s^2, rad/s^2, as `SHAKEN` says];
        switch the ``shunt`` of the bridges on (1) or off (0); let the model ``touch`` its support, ``release`` it.

        Raises
        ------
        ValueError
            This rig has no such control, or the value is not allowed.
        """
        if name not in self.controls:
            raise ValueError(f"this rig has no control {name!r}; it has {', '.join(self.controls)}")
        if name == "cut":
            self._cut_tick = min(self._cut_tick, self._tick)
            return "cable cut"
        if name == "hang":
            if self._cable or self._cut_tick >= self._tick:
                raise ValueError("the cable hangs already; cut it first")
            self._cut_tick, self._hang_tick = math.inf, self._tick
            return f"new cable, {abs(self._full_cable):g} N within {HANGING:g} s"
        if name == "shake":
            if not 0 <= value <= LARGEST_SHAKE:
                raise ValueError(f"the ground end is shaken with 0 to {LARGEST_SHAKE:g} m/s^2, not {value:g}")
            self._shake_wanted = value
            return f"ground end shaken with {value:g} m/s^2"
        if name == "shunt":
            self._shunt = bool(value)
            return f"shunt {'on' if value else 'off'}: the loads are those of the resistor and no measurement"
        if name in ("touch", "release"):
            self._touching = name == "touch"
            return "the model touches its support" if self._touching else "the model is free of its support"
        frequency, amplitude = self._drive.wanted
        wanted = (value, amplitude) if name == "frequency" else (frequency, value)
        self._check(*wanted)
        self._drive.wanted = wanted
        return f"drive {name} {value:g} {'Hz' if name == 'frequency' else 'N'}"

    def read(self, timeout: float) -> Block | None:
        """Return the next samples when they are due."""
        if self._stopped:
            raise SourceEndedError("the simulated rig was stopped")
        if not self._pacing.wait(self._tick, self._rows, timeout):
            return None
        tick, rows = self._tick, self._rows
        samples = np.empty((rows, len(self.names)))
        done = 0
        hung = self._hang_tick + round(HANGING * self.rate)
        for change in sorted({self._cut_tick, hung}):
            if tick + done < change < tick + rows:
                self._simulate(samples[done : int(change) - tick])
                done = int(change) - tick
        self._simulate(samples[done:])
        if self._shunt:
            samples[:, : self._half_ranges.size] += SHUNT_SHARE * self._half_ranges
        if self._outputs is not None:
            samples[:, :6] = self._outputs.of(samples[:, :6])
        samples += self._deviation * self._noise.standard_normal(samples.shape)
        for column, name in enumerate(self.names):
            if "acceleration" in name:
                np.clip(samples[:, column], -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE, out=samples[:, column])
        return Block(tick, samples, time.monotonic())

    def _check(self, frequency: float, amplitude: float) -> None:
        if not 0 < frequency <= LARGEST_FREQUENCY * self.rate:
            raise ValueError(
                f"frequency of the drive must be above 0 and up to {LARGEST_FREQUENCY * self.rate:g} Hz "
                f"({LARGEST_FREQUENCY:g} of the sampling rate), not {frequency:g}"
            )
        if not 0 <= amplitude <= LARGEST_DRIVE:
            raise ValueError(f"amplitude of the drive must be from 0 to {LARGEST_DRIVE:g} N, not {amplitude:g}")

    def _shaken(self, dynamics: Dynamics) -> ShakenMode:
        mass = dynamics.mass
        if self.settings.rig == "vibration":
            mass = mass * ARMATURE_MASS / (mass + ARMATURE_MASS)
        mode = Oscillator(mass=mass, stiffness=dynamics.stiffness, damping=dynamics.damping)
        return ShakenMode(mode, self._cable / dynamics.mass)

    def _simulate(self, samples: Array) -> None:
        """Fill in exact readings from the present tick on, and move on."""
        rows = samples.shape[0]
        if "fouling" in self.names:
            samples[:, -1] = CLOSED * self._touching
        t = np.arange(rows + 1) / self.rate
        if self._six is not None:
            self._ring(self._six, samples, t)
        elif self.settings.rig == "vibration":
            self._shake(samples, t)
        else:
            self._pull(samples, t)
        self._tick += rows

    def _shake(self, samples: Array, t: Array) -> None:
        drive, dynamics, shaken = self._drive, self._dynamics, self._mode
        contact = self._contact[0]
        # the support is on the ground end: the force of the contact acts on both, and is no force on the whole
        shaken.push = contact / shaken.mode.mass
        frequency, amplitude = drive.wanted
        omega, turn = 2 * np.pi * frequency, np.exp(1j * drive.phase)
        change = (amplitude - drive.amplitude) / t[-1]
        sine: NDArray[np.float64] = ((drive.amplitude + change * t) * np.exp(1j * omega * t) * turn).imag
        begin, slope = -drive.amplitude * turn / ARMATURE_MASS, -change * turn / ARMATURE_MASS
        y, velocity, shaken.state = shaken.move(t, omega=omega, begin=begin, change=slope)
        drive.frequency, drive.amplitude = frequency, amplitude
        drive.phase = math.fmod(drive.phase + omega * float(t[-1]), 2 * math.pi)
        spring = dynamics.stiffness * y + dynamics.damping * velocity
        samples[:, 0] = (dynamics.stiffness * y + dynamics.mass * STANDARD_GRAVITY)[:-1]
        samples[:, 1] = ((sine + spring - contact) / ARMATURE_MASS)[:-1]
        samples[:, 2] = ((contact - spring) / dynamics.mass)[:-1]
        samples[:, 3] = np.pi / 2

    def _pull(self, samples: Array, t: Array) -> None:
        dynamics, shaken = self._dynamics, self._mode
        cable, slope = self._cable_force()
        steady = cable + self._contact[0]
        shaken.push = steady / dynamics.mass
        # a "sine" of frequency 0 is a straight line
        y, velocity, shaken.state = shaken.move(t, omega=0.0, begin=0j, change=1j * slope / dynamics.mass)
        spring = dynamics.stiffness * y
        forces = steady + slope * t - spring - dynamics.damping * velocity
        samples[:, 0], samples[:, 1], samples[:, 3] = spring[:-1], 0.0, 0.0
        samples[:, 2] = (forces / dynamics.mass)[:-1]
        self._cable = cable + slope * float(t[-1])

    def _ring(self, six: SixMotion, samples: Array, t: Array) -> None:
        cable, slope = self._cable_force()
        more = (self._shake_wanted - self._shake_now) / float(t[-1])
        load, change = cable + self._contact, np.full(6, slope)
        felt, ground = six.move(t, load=load, change=change, shaken=self._shake_now, more=more)
        samples[:, :6], samples[:, 6:12] = felt[:-1], ground[:-1]
        self._shake_now = self._shake_wanted
        self._cable = cable + slope * float(t[-1])

    @property
    def _contact(self) -> Array:
        """Force of the support on the model, by component."""
        return TOUCH_SHARE * self._half_ranges * self._touching

    def _cable_force(self) -> tuple[float, float]:
        """Force of the cable at the present tick [N], and its change [N/s] up to the next change of either."""
        if self._tick >= self._cut_tick:
            return 0.0, 0.0
        since = (self._tick - self._hang_tick) / self.rate
        if since >= HANGING - 0.5 / self.rate:
            return self._full_cable, 0.0
        return self._full_cable * since / HANGING, self._full_cable / HANGING


class _Outputs:
    """Gauge outputs of the rig with six.

    Parameters
    ----------
    matrix
        The balance's matrix.
    rig
        The rig.
    """

    def __init__(self, matrix: BalanceMatrix, rig: RigName) -> None:
        if rig != "six" or matrix.direct is None or len(matrix.gauges) != len(COMPONENTS):
            raise ValueError("a balance matrix of six components goes with the rig six alone")
        self._matrix, self._native = matrix, np.linalg.inv(matrix.direct).T
        self._zero = np.zeros(6) if matrix.natural_zero is None else matrix.natural_zero
        self.names = tuple(f"r{gauge}" for gauge in matrix.gauges)
        # loads for an output of 1 mV/V, by which the noise of a load becomes one of the outputs
        self.sensitivity = matrix.load_scale / matrix.output_scale

    def of(self, loads: Array) -> Array:
        """Outputs [mV/V] at loads in the order of `COMPONENTS`, both of shape (n, 6)."""
        return np.asarray(self._matrix.outputs(np.ascontiguousarray(loads @ self._native)) + self._zero)


def _unit(name: str) -> str:
    return "mV/V" if is_gauge(name) else QUANTITIES.get(name, "V")


def rig_dynamics(rig: RigName) -> BalanceDynamics:
    """Return the dynamics of the components that a rig has."""
    if rig == "six":
        return six_dynamics()
    return dynamics_of((VIBRATION_RIG if rig == "vibration" else CABLE_CUT).dynamics)
