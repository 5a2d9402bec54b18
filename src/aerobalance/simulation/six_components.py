"""Six coupled components: an elastic balance with a rigid model, on a sting that moves.

K q = X are the balance loads and q the motion of the live end against the ground end, so that

    M q'' + C q' + K q = F + W(pitch, roll) - M a - w x (...),

with F the loads applied, W the weight, a the acceleration of the ground end and w its turning. Mode by mode this is
integrated exactly for loads that are cubics between the points of a fine grid, and releases are added in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.recording import Recording
from aerobalance.simulation.drives import Signal
from aerobalance.simulation.oscillator import Input, Oscillator
from aerobalance.simulation.sensors import Sensor, integration_grid, read_channels
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_signals import BaseMotion, SixSignal

__all__ = [
    "GROUND_CHANNELS",
    "RATE_CHANNELS",
    "CoupledBalance",
    "Release",
    "SixComponentRig",
    "SixSimulation",
    "random_balance",
]

GROUND_CHANNELS: Final = (
    "ground_acceleration_z",
    "ground_turn_PM",
    "ground_acceleration_y",
    "ground_turn_YM",
    "ground_turn_RM",
    "ground_acceleration",
)
"""Channels of the ground's motion, in the order of `COMPONENTS`."""

RATE_CHANNELS: Final = tuple(f"ground_turn_rate_{name}" for name in MOMENTS)
"""Channels of the ground's rate of turn, in the order of `MOMENTS`."""


@dataclass(frozen=True, slots=True, eq=False)
class Release:
    """A load that is held and let go: a cable that is cut; with the sign turned, a load that is put on.

    Attributes
    ----------
    load
        Load held before the release, shape (6,) [N, N*m].
    instant
        When it begins to fall [s]; any instant, not only one of a sample.
    duration
        Time within which it falls to zero on a straight line [s].
    """

    load: Array
    instant: float
    duration: float = 0.0

    def over_time(self, time: Array) -> Array:
        """Load over time, shape (n, 6)."""
        since = time - self.instant
        left = np.clip(1 - since / self.duration, 0.0, 1.0) if self.duration else np.where(since < 0, 1.0, 0.0)
        return left[:, None] * self.load


@dataclass(frozen=True, slots=True, eq=False)
class SixSimulation:
    """A simulated recording of six components with the truth behind it.

    Attributes
    ----------
    recording
        What a file of the rig would hold, in SI units.
    applied
        Loads applied to the live end at every sample, the weight left out, shape (n, 6) [N, N*m].
    load
        Balance loads at every sample, without noise and delay, shape (n, 6) [N, N*m].
    ground
        Accelerations of the ground end at every sample, shape (n, 6) [m/s^2, rad/s^2].
    rate
        Rate of its turning at every sample, shape (n, 3) in the order of `MOMENTS` [rad/s].
    pitch, roll
        Angles at every sample, shape (n,) [rad].
    """

    recording: Recording
    applied: Array
    load: Array
    ground: Array
    rate: Array
    pitch: Array
    roll: Array


@dataclass(frozen=True, slots=True, eq=False)
class SixComponentRig:
    """A coupled balance under releases, loads and motion of its sting; without any it hangs in its own weight.

    Attributes
    ----------
    balance
        The balance with its model.
    releases
        Loads that are let go.
    applied
        Further loads over time, or None. Signals are asked for times before 0 too, and should have no jumps: those
        are releases.
    base
        Motion of the ground end, or None for one at rest, whose acceleration is then not recorded. The turning adds
        to `pitch` and `roll` as small angles do; what stands in `pitch` and `roll` themselves turns nothing.
    pitch, roll
        Attitude over time [rad], or None for a level balance.
    output
        What is recorded: gauge outputs in mV/V, or the balance loads.
    turning
        What is recorded of the base's turning: angular accelerations, or rates of turn.
    rate
        Sampling rate [Hz].
    load_sensor, ground_sensor
        Delay, filter, resolution and limits of the readings; the balance's own noise is added to theirs.
    oversampling
        Points of the integration grid per sample.
    before
        For how long loads and motion have been going on before time 0 [s]; still earlier their first value held.
    dynamics
        What rings where the model or the sting bends (`bending_dynamics`), or None for those of the balance.
    """

    balance: CoupledBalance
    releases: tuple[Release, ...] = ()
    applied: SixSignal | None = None
    base: BaseMotion | None = None
    pitch: Signal | None = None
    roll: Signal | None = None
    output: Literal["gauges", "loads"] = "gauges"
    turning: Literal["acceleration", "rate"] = "acceleration"
    rate: float = 25_000.0
    load_sensor: Sensor = field(default_factory=Sensor)
    ground_sensor: Sensor = field(default_factory=Sensor)
    oversampling: int = 4
    before: float = 0.25
    dynamics: CoupledDynamics | None = None

    def run(self, duration: float, generator: np.random.Generator) -> SixSimulation:
        """Record for `duration` [s] from time 0.

        Parameters
        ----------
        duration
            Length of the recording [s].
        generator
            Source of the randomness of the sensors.
        """
        clock = np.arange(round(duration * self.rate)) / self.rate
        readers = self._sensors()
        grid = integration_grid(clock, self.rate * self.oversampling, readers, before=self.before)
        load = _once(self._load(grid))
        signals = self._load_signals(load) | self._ground_signals()
        channels = read_channels(signals, readers, clock=clock, grid=grid, generator=generator)
        pitch, roll = self._attitude(clock)
        return SixSimulation(
            recording=Recording.from_columns(clock, channels, name="six components"),
            applied=self._applied(clock) + sum(release.over_time(clock) for release in self.releases),
            load=load(clock),
            ground=self.base.acceleration(clock) if self.base else np.zeros((clock.size, 6)),
            rate=self.base.rate(clock) if self.base else np.zeros((clock.size, 3)),
            pitch=pitch,
            roll=roll,
        )

    def zero(self, duration: float, generator: np.random.Generator) -> Recording:
        """Record the gauges of the weightless, unloaded balance, as a zero for `aerobalance.balance.zeros`."""
        clock = np.arange(round(duration * self.rate)) / self.rate
        gauges = {name: sensor for name, sensor in self._sensors().items() if name in self._names}
        signals = self._load_signals(lambda time: np.zeros((time.size, 6)))
        grid = integration_grid(clock, self.rate, gauges, before=0.0)
        channels = read_channels(signals, gauges, clock=clock, grid=grid, generator=generator)
        return Recording.from_columns(clock, channels, name="zero")

    def _applied(self, time: Array) -> Array:
        return self.applied(time) if self.applied else np.zeros((time.size, 6))

    def _attitude(self, time: Array) -> tuple[Array, Array]:
        """Pitch and roll over time, the turning of the ground end included."""
        pitch = self.pitch(time) if self.pitch else np.zeros(time.size)
        roll = self.roll(time) if self.roll else np.zeros(time.size)
        if self.base:
            angle = self.base.angle(time)
            pitch, roll = pitch + angle[:, MOMENTS.index("PM")], roll + angle[:, MOMENTS.index("RM")]
        return pitch, roll

    def _net(self, time: Array) -> Array:
        """Net load on the live end over time, releases left out."""
        mass = self.balance.mass
        net = self._applied(time) + mass.weight(*self._attitude(time))
        if self.base:
            net = net - self.base.acceleration(time) @ mass.matrix.T - mass.turning_load(self.base.rate(time))
        return net

    def _load(self, grid: Array) -> SixSignal:
        """Balance loads at any times within the grid."""
        poles, shapes, weights = (self.dynamics or self.balance.dynamics).modal_form
        up = np.flatnonzero(poles.imag > 0)
        if 2 * up.size != poles.size:
            raise ValueError("a mode is damped critically or more; the simulation needs damping ratios below 1")
        springs = [Oscillator.of(Mode(abs(poles[k]) / (2 * np.pi), -poles[k].real / abs(poles[k]))) for k in up]
        net = self._net(grid)
        drives, states = [], []
        for k, spring in zip(up, springs, strict=True):
            push = net @ weights[k]
            drives.append((Input.through(push.real, grid), Input.through(push.imag, grid)))
            states.append([spring.state(drive) for drive in drives[-1]])

        def load(time: Array) -> Array:
            felt = np.zeros((time.size, 6))
            for k, spring, drive, state in zip(up, springs, drives, states, strict=True):
                z = _at(spring, state[0], drive=drive[0], time=time) + 1j * _at(
                    spring, state[1], drive=drive[1], time=time
                )
                for release in self.releases:
                    fall = spring.fall(time, instant=release.instant, duration=release.duration)
                    z = z + fall * (weights[k] @ release.load)
                felt += 2 * np.real(z[:, None] * shapes[:, k])
            return felt

        return load

    def _sensors(self) -> dict[str, Sensor]:
        balance = self.balance
        if self.output == "gauges":
            own = dict(zip(self._names, balance.noise * balance.matrix.output_scale, strict=True))
        else:
            own = dict(zip(self._names, balance.noise * balance.half_range, strict=True))
        sensors = {name: _noisier(self.load_sensor, float(noise)) for name, noise in own.items()}
        if self.base:
            turns = {name: balance.turn_noise for name in GROUND_CHANNELS if "turn" in name}
            if self.turning == "rate":
                turns = dict.fromkeys(RATE_CHANNELS, balance.rate_noise)
            linear = {name: balance.acceleration_noise for name in GROUND_CHANNELS if "turn" not in name}
            for name, noise in (linear | turns).items():
                sensors[name] = _noisier(self.ground_sensor, noise)
        return sensors | {"pitch": Sensor(), "roll": Sensor()}

    @property
    def _names(self) -> tuple[str, ...]:
        """Channels of the loads or the gauges."""
        return COMPONENTS if self.output == "loads" else tuple(f"r{name}" for name in self.balance.matrix.gauges)

    def _load_signals(self, load: SixSignal) -> dict[str, Signal]:
        table = load if self.output == "loads" else _once(lambda time: self.balance.outputs(load(time)))
        return {name: _column(table, place) for place, name in enumerate(self._names)}

    def _ground_signals(self) -> dict[str, Signal]:
        signals: dict[str, Signal] = {
            "pitch": lambda time: self._attitude(time)[0],
            "roll": lambda time: self._attitude(time)[1],
        }
        if self.base:
            motion = _once(self.base.acceleration)
            signals |= {name: _column(motion, place) for place, name in enumerate(GROUND_CHANNELS)}
            signals |= {name: _column(self.base.rate, place) for place, name in enumerate(RATE_CHANNELS)}
        return signals


def _at(spring: Oscillator, state: NDArray[np.complex128], *, drive: Input, time: Array) -> NDArray[np.complex128]:
    """State at any times within the grid; without a computation where they are points of it."""
    cell, rest = drive.place(time)
    on_grid = rest.size and np.abs(rest).max() < 1e-9 * drive.interval
    return np.asarray(state[cell]) if on_grid else spring.between(state, drive, time=time)


def _noisier(sensor: Sensor, noise: float) -> Sensor:
    return replace(sensor, noise=float(np.hypot(sensor.noise, noise)))


def _column(table: SixSignal, place: int) -> Signal:
    return lambda time: table(time)[:, place]


def _once(signal: SixSignal) -> SixSignal:
    """Remember the last values, for columns that are asked for one after the other."""
    kept: list[Array] = []

    def again(time: Array) -> Array:
        if not kept or kept[0].shape != time.shape or not np.array_equal(kept[0], time):
            kept[:] = [time, signal(time)]
        return kept[1]

    return again
