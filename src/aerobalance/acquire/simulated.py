"""The simulated rigs as a source: shaken or released while they run."""

from __future__ import annotations

import math
import secrets
import time
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.acquire.pacing import Pacing
from aerobalance.acquire.source import Block, SourceChannel, SourceEndedError
from aerobalance.channel import QUANTITIES, Array
from aerobalance.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.dynamics import Dynamics
from aerobalance.published import CABLE_CUT, VIBRATION_RIG
from aerobalance.rigs import ACCELEROMETER_RANGE, ARMATURE_MASS
from aerobalance.rigs.oscillator import Oscillator

RigName = Literal["vibration", "cable_cut", "six"]

LARGEST_FREQUENCY: Final = 0.45
"""Largest frequency of the drive, over the sampling rate."""

LARGEST_DRIVE: Final = 500.0
"""Largest amplitude of the drive [N]."""

HANGING: Final = 1.0
"""Time within which a new cable takes up its force [s]."""

SIX_FREQUENCIES: Final = {"NF": 68.0, "PM": 91.0, "SF": 57.0, "YM": 83.0, "RM": 112.0}
"""Natural frequencies of the five components of the rig with six that are not printed [Hz]; assumed."""

SIX_INERTIAS: Final = {"NF": 178.0, "PM": 24.0, "SF": 178.0, "YM": 26.0, "RM": 3.0}
"""Moving masses [kg] and moments of inertia [kg*m^2] of these; assumed."""


class Shaken:
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
        ``vibration`` (6F-540 on a shaker), ``cable_cut`` (6-EB-128-1, pulled by a cable), or ``six`` (six uncoupled
        components and six accelerations, pulled by a cable in all of them).
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
        self.dynamics = rig_dynamics(settings.rig)
        names = [dynamics.component for dynamics in self.dynamics]
        axes = ("", "_y", "_z") if settings.rig == "six" else ("",)
        names += [f"{end}_acceleration{axis}" for end in ("ground", "live") for axis in axes]
        self.names = (*names, "pitch") if settings.rig != "six" else tuple(names)
        self.channels = tuple(SourceChannel(name, QUANTITIES[name]) for name in self.names)
        self.controls = ("frequency", "amplitude") if shaken else ("cut", "hang")
        self.seed = secrets.randbits(63) if settings.seed is None else settings.seed
        self.description = f"simulated rig: {settings.rig}, {self.rate:g} Hz, seed {self.seed}"
        self._noise = np.random.default_rng(self.seed)
        load, acceleration = printed.dynamic_deviation.value, printed.acceleration_deviation.value
        self._deviation = settings.noise * np.array(
            [0.0 if name == "pitch" else acceleration if "acceleration" in name else load for name in self.names]
        )
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
        self._modes = [self._shaken(dynamics) for dynamics in self.dynamics]

    def start(self) -> None:
        """Begin at rest, with the drive on."""
        self._pacing.start()

    def stop(self) -> None:
        """End."""
        self._stopped = True

    def control(self, name: str, value: float) -> str:
        """Set ``frequency`` [Hz] or ``amplitude`` [N] of the drive; ``cut`` the cable, ``hang`` a new one (any value).

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

    def _shaken(self, dynamics: Dynamics) -> Shaken:
        mass = dynamics.mass
        if self.settings.rig == "vibration":
            mass = mass * ARMATURE_MASS / (mass + ARMATURE_MASS)
        mode = Oscillator(mass=mass, stiffness=dynamics.stiffness, damping=dynamics.damping)
        return Shaken(mode, self._cable / dynamics.mass)

    def _simulate(self, samples: Array) -> None:
        """Fill in exact readings from the present tick on, and move on."""
        rows = samples.shape[0]
        t = np.arange(rows + 1) / self.rate
        if self.settings.rig == "vibration":
            self._shake(samples, t)
        else:
            self._pull(samples, t)
        self._tick += rows

    def _shake(self, samples: Array, t: Array) -> None:
        drive, dynamics, shaken = self._drive, self.dynamics[0], self._modes[0]
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
        samples[:, 1] = ((sine + spring) / ARMATURE_MASS)[:-1]
        samples[:, 2] = (-spring / dynamics.mass)[:-1]
        samples[:, 3] = np.pi / 2

    def _pull(self, samples: Array, t: Array) -> None:
        samples[:] = 0.0
        cable, slope = self._cable_force()
        for column, (dynamics, shaken) in enumerate(zip(self.dynamics, self._modes, strict=True)):
            shaken.push = cable / dynamics.mass
            # a "sine" of frequency 0 is a straight line
            y, velocity, shaken.state = shaken.move(t, omega=0.0, begin=0j, change=1j * slope / dynamics.mass)
            samples[:, column] = (dynamics.stiffness * y)[:-1]
            live = _LIVE.get(dynamics.component, "")
            if live in self.names:
                forces = cable + slope * t - dynamics.stiffness * y - dynamics.damping * velocity
                samples[:, self.names.index(live)] = (forces / dynamics.mass)[:-1]
        self._cable = cable + slope * float(t[-1])

    def _cable_force(self) -> tuple[float, float]:
        """Force of the cable at the present tick [N], and its change [N/s] up to the next change of either."""
        if self._tick >= self._cut_tick:
            return 0.0, 0.0
        since = (self._tick - self._hang_tick) / self.rate
        if since >= HANGING - 0.5 / self.rate:
            return self._full_cable, 0.0
        return self._full_cable * since / HANGING, self._full_cable / HANGING


_LIVE: Final = {"AF": "live_acceleration", "SF": "live_acceleration_y", "NF": "live_acceleration_z"}


def rig_dynamics(rig: RigName) -> tuple[Dynamics, ...]:
    """Return the dynamics of the components that a rig has."""
    if rig == "vibration":
        return (VIBRATION_RIG.dynamics,)
    if rig == "cable_cut":
        return (CABLE_CUT.dynamics,)
    found = []
    for component in COMPONENTS:
        if component == "AF":
            found.append(CABLE_CUT.dynamics)
            continue
        omega = 2 * np.pi * SIX_FREQUENCIES[component]
        inertia = SIX_INERTIAS[component]
        found.append(Dynamics(component, inertia, inertia * omega**2, 0.01 * inertia * omega))
    return tuple(found)
