"""Records of a known force, simulated apart from the package: what the balance does is worked out on a fine clock.

The force, the ground's motion and the answer of every mode are taken as periodic over more than the record, and worked
out by Fourier series; a spring that is not linear is integrated step by step. Nothing here uses the estimator's code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MASS: Final = 177.87
STIFFNESS: Final = 3.093e7
DAMPING: Final = 828.21
"""The axial component of the balance of the paper, Table 1 [kg, N/m, N s/m]."""

GRAVITY: Final = 9.80665
FREQUENCY: Final = float(np.sqrt(STIFFNESS / MASS) / (2 * np.pi))
RATIO: Final = DAMPING / (2 * np.sqrt(STIFFNESS * MASS))

LEAD: Final = 1.0
"""Time before the record in which the motion settles [s]."""

TAIL: Final = 2.0
"""Time after the record in which forces come back to where they began [s]."""


@dataclass(frozen=True)
class Clock:
    """The fine clock of a simulation, and the samples of it that are recorded.

    Attributes
    ----------
    rate
        Sampling rate of the record [Hz].
    samples
        Samples of the record.
    fine
        Points of the fine clock for each sample.
    """

    rate: float = 1600.0
    samples: int = 4000
    fine: int = 32

    @property
    def lead(self) -> int:
        """Fine points before the record."""
        return round(LEAD * self.rate) * self.fine

    @property
    def count(self) -> int:
        """Fine points in all."""
        return self.lead + self.samples * self.fine + round(TAIL * self.rate) * self.fine

    @property
    def interval(self) -> float:
        """Time between fine points [s]."""
        return 1 / (self.rate * self.fine)

    @property
    def time(self) -> Array:
        """Time of the fine points from the record's start [s]."""
        return (np.arange(self.count) - self.lead) * self.interval

    @property
    def frequency(self) -> Array:
        """Frequencies of a real Fourier series over the fine clock [Hz]."""
        return np.fft.rfftfreq(self.count, self.interval)

    @property
    def end(self) -> float:
        """End of the record [s]."""
        return self.samples / self.rate

    def sampled(self, values: Array, *, late: float | Array = 0.0) -> Array:
        """Return what a channel that is late by so much [s] shows at the samples of the record."""
        if np.ndim(late) == 0 and late == 0:
            return values[self.lead : self.lead + self.samples * self.fine : self.fine].copy()
        instants = np.arange(self.samples) / self.rate - late
        place = instants / self.interval + self.lead
        first = np.floor(place).astype(int)
        rest = place - first
        around = np.stack([values[(first + shift) % values.size] for shift in (-1, 0, 1, 2)])
        weights = np.stack(
            [
                -rest * (rest - 1) * (rest - 2) / 6,
                (rest + 1) * (rest - 1) * (rest - 2) / 2,
                -(rest + 1) * rest * (rest - 2) / 2,
                (rest + 1) * rest * (rest - 1) / 6,
            ]
        )
        return np.asarray(np.sum(around * weights, axis=0))

    def filtered(self, values: Array, response: Callable[[Array], NDArray[np.complex128]]) -> Array:
        """Return a signal behind a filter."""
        return np.fft.irfft(np.fft.rfft(values) * response(self.frequency), self.count)


Maker = Callable[[Clock, np.random.Generator], Array]
"""Makes a signal on the fine clock."""


def band(rms: float, low: float, high: float, *, fall: float = 0.0) -> Maker:
    """Noise of a band [Hz], flat within it and none beyond, or falling as frequency^-fall within it."""

    def made(clock: Clock, rng: np.random.Generator) -> Array:
        frequency = clock.frequency
        inside = (frequency >= low) & (frequency <= high) & (frequency > 0)
        phasors = np.zeros(frequency.size, dtype=complex)
        count = int(inside.sum())
        phasors[inside] = rng.normal(size=count) + 1j * rng.normal(size=count)
        phasors[inside] *= (frequency[inside] / max(high, 1e-9)) ** (-fall / 2)
        power = 2 * np.sum(2 * (frequency[inside] / max(high, 1e-9)) ** (-fall))
        return np.asarray(np.fft.irfft(phasors, clock.count) * clock.count * rms / np.sqrt(power))

    return made


def soft(rms: float, corner: float, order: float = 4.0) -> Maker:
    """Noise with the spectrum 1 / (1 + (f / corner)^order)."""

    def made(clock: Clock, rng: np.random.Generator) -> Array:
        frequency = clock.frequency
        density = 1 / (1 + (frequency / corner) ** order)
        density[0] = 0
        phasors = np.sqrt(density) * (rng.normal(size=density.size) + 1j * rng.normal(size=density.size))
        return np.asarray(np.fft.irfft(phasors, clock.count) * clock.count * rms / np.sqrt(2 * np.sum(2 * density)))

    return made


def constant(level: float) -> Maker:
    """A force that does not change."""
    return lambda clock, rng: np.full(clock.count, level)


def step(height: float, *, at: float | None = None) -> Maker:
    """A step that goes back softly after the record."""
    return pieces(
        lambda clock, rng: [(0.3 * clock.end + 0.4 * clock.end * rng.random() if at is None else at, height)]
    )


def pieces(changes: Callable[[Clock, np.random.Generator], Sequence[tuple[float, float]]]) -> Maker:
    """Sudden changes, each by its instant [s] and height [N], that go back softly after the record."""

    def made(clock: Clock, rng: np.random.Generator) -> Array:
        time, whole = clock.time, np.zeros(clock.count)
        back = 0.5 + 0.5 * np.cos(np.pi * np.clip((time - clock.end - 0.05) / (TAIL - 0.2), 0, 1))
        for instant, height in changes(clock, rng):
            whole += height * (time > instant) * back
        return whole

    return made


def shaped(signal: Callable[[Array], Array]) -> Maker:
    """A signal by its formula, faded out after the record."""

    def made(clock: Clock, rng: np.random.Generator) -> Array:
        time = clock.time
        fade = 0.5 + 0.5 * np.cos(np.pi * np.clip((time - clock.end - 0.05) / (TAIL - 0.2), 0, 1))
        fade *= 0.5 - 0.5 * np.cos(np.pi * np.clip((time + LEAD) / (0.9 * LEAD), 0, 1))
        return signal(time) * fade

    return made


def level(maker: Maker, envelope: Callable[[Clock, Array], Array]) -> Maker:
    """A signal whose level changes along the record."""
    return lambda clock, rng: maker(clock, rng) * envelope(clock, clock.time)


def together(*makers: Maker) -> Maker:
    """Several signals at once."""
    return lambda clock, rng: np.sum([one(clock, rng) for one in makers], axis=0)


@dataclass(frozen=True)
class Modes:
    """Modes of a balance: natural frequency [Hz], damping ratio and share of a steady load of each."""

    modes: tuple[tuple[float, float, float], ...] = ((FREQUENCY, RATIO, 1.0),)

    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Return load over force."""
        total = np.zeros(frequency.size, dtype=complex)
        for own, ratio, share in self.modes:
            x = frequency / own
            total += share / (1 - x**2 + 2j * ratio * x)
        return total


Spring = Callable[[float, float], tuple[float, float]]
"""Elastic load and damping force [N] of a displacement [m] and a rate [m/s]."""


@dataclass(frozen=True)
class Scene:
    """A record of a known force and how it was made.

    Attributes
    ----------
    force
        The force applied [N].
    clock
        The sampling.
    balance
        The modes that the balance really has.
    spring
        If given, how the balance of one mode is not linear, instead of `balance`.
    noise
        Standard deviation of the white noise of a reading [N].
    ground
        Acceleration of the ground end [m/s^2]; None where it is at rest and not recorded.
    ground_noise
        Noise of the accelerometer [m/s^2].
    pitch
        Attitude [rad]; None where it is none and not recorded.
    load_filter, ground_filter
        Analog filters of the channels that nothing is said of.
    ground_late, pitch_late
        Times by which the channels are late [s]; a function of time for a clock that drifts.
    ground_gain, ground_beside
        Gain of the accelerometer, and the part of a motion across that it shows as well.
    more_noise
        Noise beside the white, on the readings.
    """

    force: Maker
    clock: Clock = field(default_factory=Clock)
    balance: Modes = field(default_factory=Modes)
    spring: Spring | None = None
    mass: float = MASS
    noise: float = 2.0
    ground: Maker | None = None
    ground_noise: float = 0.005
    pitch: Maker | None = None
    pitch_noise: float = 1e-5
    load_filter: Callable[[Array], NDArray[np.complex128]] | None = None
    ground_filter: Callable[[Array], NDArray[np.complex128]] | None = None
    ground_late: float | Callable[[Array], Array] = 0.0
    pitch_late: float = 0.0
    ground_gain: float = 1.0
    ground_beside: float = 0.0
    pitch_gain: float = 1.0
    more_noise: Maker | None = None

    def record(self, rng: np.random.Generator) -> Record:
        """Return the record and its truth."""
        clock = self.clock
        force = self.force(clock, rng)
        net = force.copy()
        columns: dict[str, Array] = {}
        if self.ground is not None:
            ground = self.ground(clock, rng)
            net -= self.mass * ground
            seen = self.ground_gain * ground
            if self.ground_beside:
                seen = seen + self.ground_beside * self.ground(clock, rng)
            if self.ground_filter is not None:
                seen = clock.filtered(seen, self.ground_filter)
            late = self.ground_late
            if callable(late):
                late = late(np.arange(clock.samples) / clock.rate)
            columns["ground_acceleration"] = clock.sampled(seen, late=late) + rng.normal(
                0, self.ground_noise, clock.samples
            )
        if self.pitch is not None:
            pitch = self.pitch(clock, rng)
            net += self.mass * GRAVITY * np.sin(pitch)
            columns["pitch"] = self.pitch_gain * clock.sampled(pitch, late=self.pitch_late) + rng.normal(
                0, self.pitch_noise, clock.samples
            )
        load = clock.filtered(net, self.balance.response) if self.spring is None else self._bent(net)
        if self.load_filter is not None:
            load = clock.filtered(load, self.load_filter)
        reading = clock.sampled(load) + rng.normal(0, self.noise, clock.samples)
        if self.more_noise is not None:
            reading = reading + clock.sampled(self.more_noise(clock, rng))
        columns["AF"] = reading
        return Record(clock.rate, columns, clock.sampled(force))

    def _bent(self, net: Array) -> Array:
        """Elastic load of a spring that is not linear, by Runge and Kutta's method of fourth order."""
        spring, mass, h = self.spring, self.mass, self.clock.interval
        assert spring is not None
        load = np.empty(net.size)
        place, speed = net[0] / STIFFNESS, 0.0

        def push(x: float, v: float, force: float) -> float:
            elastic, damped = spring(x, v)
            return (force - elastic - damped) / mass

        for i in range(net.size):
            load[i] = spring(place, speed)[0]
            now, after = float(net[i]), float(net[(i + 1) % net.size])
            middle = 0.5 * (now + after)
            a1 = push(place, speed, now)
            a2 = push(place + 0.5 * h * speed, speed + 0.5 * h * a1, middle)
            v2 = speed + 0.5 * h * a1
            a3 = push(place + 0.5 * h * v2, speed + 0.5 * h * a2, middle)
            v3 = speed + 0.5 * h * a2
            a4 = push(place + h * v3, speed + h * a3, after)
            v4 = speed + h * a3
            place += h * (speed + 2 * v2 + 2 * v3 + v4) / 6
            speed += h * (a1 + 2 * a2 + 2 * a3 + a4) / 6
        return load


@dataclass(frozen=True)
class Record:
    """Readings by channel, and the truth.

    Attributes
    ----------
    rate
        Sampling rate [Hz].
    columns
        Readings by channel, in SI.
    force
        The force that was applied at the samples [N].
    """

    rate: float
    columns: dict[str, Array]
    force: Array

    def with_column(self, name: str, values: Array) -> Record:
        """Return the same with other readings of a channel."""
        return replace(self, columns={**self.columns, name: values})
