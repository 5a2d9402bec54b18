"""Loads and motions in six components over time: broadband, tapped, sampled; a sting that shakes or oscillates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS

DRIVE_RATE = 20_000.0
"""Points per second from which a drive is integrated to rate and angle of a turn."""

SixSignal = Callable[[Array], Array]
"""Quantities over time: takes times [s] of shape (n,), returns values of shape (n, 6) in the order of `COMPONENTS`."""

TurnSignal = Callable[[Array], Array]
"""The same for turns, shape (n, 3) in the order of `MOMENTS`: nose up, nose right, right side down."""


@dataclass(frozen=True, slots=True)
class Band:
    """Shape of a spectrum: flat between two frequencies, with sharp or soft edges.

    Attributes
    ----------
    low, high
        Edges [Hz].
    order
        Order of the roll-off 1/(1 + (f/high)^(2 order)) above; 0 for a sharp edge.
    """

    low: float
    high: float
    order: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.low < self.high < np.inf or self.order < 0:
            raise ValueError(f"a band needs 0 <= low < high and an order of 0 or more, not {self}")

    @property
    def highest(self) -> float:
        """Frequency above which there is nothing: a soft edge ends where it is down to a millionth [Hz]."""
        return self.high * 1e6 ** (1 / (2 * self.order)) if self.order else self.high

    def shape(self, frequency: ArrayLike) -> Array:
        """Spectral density over that of the flat part at frequencies [Hz]."""
        f = np.asarray(frequency, dtype=np.float64)
        level = 1 / (1 + (f / self.high) ** (2 * self.order)) if self.order else np.ones(f.shape)
        return np.where((f >= self.low) & (f <= self.highest) & (f > 0), level, 0.0)

    def density(self, frequency: ArrayLike) -> Array:
        """One-sided spectral density of a signal of unit variance at frequencies [Hz], [1/Hz]."""
        fine = np.linspace(self.low, self.highest, 200_001)[1:]
        return self.shape(frequency) / float(np.mean(self.shape(fine)) * (self.highest - self.low))

    def phasors(self, generator: np.random.Generator, *, period: float, columns: int) -> tuple[Array, Array]:
        """Draw amplitudes of sines whose squares add to a variance of 1 on average.

        Returns
        -------
        angular_frequency, amplitudes
            Shape (m,) [rad/s], and (m, columns), complex.
        """
        lines = np.arange(1, int(np.ceil(self.highest * period)) + 1) / period
        weight = self.shape(lines)
        if not weight.any():
            raise ValueError(f"no frequency of {self} repeats itself within {period} s")
        size = np.sqrt(weight / np.sum(weight))[:, None]
        drawn = generator.standard_normal((2, lines.size, columns))
        return 2 * np.pi * lines, size * (drawn[0] + 1j * drawn[1])


def _periodic(amplitudes: Array, period: float) -> Callable[[Array], Array]:
    """Sum of sines with the amplitudes of lines 1/period, 2/period ..., as a smooth function of time."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow, and no live source needs it

    points = 16 * (amplitudes.shape[0] + 1)
    lines = np.zeros((points // 2 + 1, amplitudes.shape[1]), dtype=np.complex128)
    lines[1 : amplitudes.shape[0] + 1] = amplitudes * points / 2
    values = np.fft.irfft(lines, points, axis=0)
    spline = CubicSpline(np.linspace(0, period, points + 1), np.vstack([values, values[:1]]), bc_type="periodic")
    return lambda time: np.asarray(spline(np.mod(time, period)))


def broadband(generator: np.random.Generator, band: Band, *, rms: ArrayLike, period: float) -> SixSignal:
    """Draw Gaussian loads of one spectrum in all components, independent of each other.

    Parameters
    ----------
    generator
        Source of randomness.
    band
        Their spectrum.
    rms
        Standard deviation that each has on average, shape (6,) [N, N*m].
    period
        Time after which they repeat themselves [s]; at least the recording and what comes before it.
    """
    _, amplitudes = band.phasors(generator, period=period, columns=len(COMPONENTS))
    return _periodic(amplitudes * np.asarray(rms, dtype=np.float64), period)


def tap(load: ArrayLike, *, instant: float, duration: float) -> SixSignal:
    """Blow of a hammer: a load that rises and falls as the square of half a sine.

    Parameters
    ----------
    load
        Largest load, shape (6,) [N, N*m].
    instant, duration
        When it begins and how long it lasts [s].
    """
    peak = np.asarray(load, dtype=np.float64)

    def signal(time: Array) -> Array:
        progress = np.clip((time - instant) / duration, 0.0, 1.0)
        return np.sin(np.pi * progress)[:, None] ** 2 * peak

    return signal


def sampled(values: Array, *, rate: float, start: float = 0.0) -> SixSignal:
    """Loads given as samples of a clock, cubic between them; the first and last value hold outside.

    Parameters
    ----------
    values
        Shape (m, 6) [N, N*m].
    rate
        Rate of the samples [Hz].
    start
        Time of the first [s].
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow, and no live source needs it

    times = start + np.arange(len(values)) / rate
    spline = CubicSpline(times, values)
    return lambda time: np.asarray(spline(np.clip(time, times[0], times[-1])))


def together(*signals: SixSignal) -> SixSignal:
    """Sum of several signals."""
    return lambda time: np.asarray(sum(signal(time) for signal in signals))


@dataclass(frozen=True, slots=True)
class BaseMotion:
    """How the ground end moves, in axes that turn with it.

    Attributes
    ----------
    acceleration
        Acceleration of the balance's centre and turning, shape (n, 6), in the order and signs of `COMPONENTS`:
        up, nose up, right, nose right, right side down, aft [m/s^2, rad/s^2].
    rate, angle
        Rate [rad/s] and angle [rad] of the turning, shape (n, 3) in the order of `MOMENTS`.
    """

    acceleration: SixSignal
    rate: TurnSignal
    angle: TurnSignal

    def with_motion(self, other: BaseMotion) -> BaseMotion:
        """Both motions at once, for angles so small that they add."""
        return BaseMotion(
            together(self.acceleration, other.acceleration),
            together(self.rate, other.rate),
            together(self.angle, other.angle),
        )


def random_motion(generator: np.random.Generator, band: Band, *, rms: ArrayLike, period: float) -> BaseMotion:
    """Draw a random shaking of the ground end in six degrees of freedom.

    Parameters
    ----------
    generator
        Source of randomness.
    band
        Spectrum of the accelerations; from well above 0, or the angles grow large.
    rms
        Standard deviation of each acceleration, shape (6,) [m/s^2, rad/s^2].
    period
        Time after which it repeats itself [s].
    """
    w, amplitudes = band.phasors(generator, period=period, columns=len(COMPONENTS))
    amplitudes = amplitudes * np.asarray(rms, dtype=np.float64)
    turns = amplitudes[:, [COMPONENTS.index(name) for name in MOMENTS]]
    return BaseMotion(
        _periodic(amplitudes, period),
        _periodic(turns / (1j * w[:, None]), period),
        _periodic(-turns / w[:, None] ** 2, period),
    )


def driven_motion(drive: Callable[[Array], Array], *, along: ArrayLike, duration: float) -> BaseMotion:
    """Shake the ground end by one signal: a stepped or swept sine, along one motion or several at once.

    Parameters
    ----------
    drive
        Acceleration over time, zero before 0 and after the duration, shape (n,) for times [s] of shape (n,).
    along
        Size of each acceleration for a drive of 1, shape (6,) [m/s^2, rad/s^2].
    duration
        For how long it is driven [s].
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow, and no live source needs it

    size = np.asarray(along, dtype=np.float64)
    turns = size[[COMPONENTS.index(name) for name in MOMENTS]]
    grid = np.linspace(0.0, duration, int(DRIVE_RATE * duration) + 1)
    speed = CubicSpline(grid, drive(grid)).antiderivative()
    mean = float(speed.integrate(0.0, duration)) / duration  # the ground end does not turn away
    angle = CubicSpline(grid, speed(grid) - mean).antiderivative()
    centre = float(angle.integrate(0.0, duration)) / duration

    def rate(time: Array) -> Array:
        inside = (time >= 0) & (time <= duration)
        return np.where(inside, speed(time) - mean, 0.0)[:, None] * turns

    def turned(time: Array) -> Array:
        return (angle(np.clip(time, 0.0, duration)) - centre)[:, None] * turns

    return BaseMotion(lambda time: np.asarray(drive(time)[:, None] * size), rate, turned)


def oscillation(
    component: Literal["PM", "YM", "RM"], *, amplitude: float, frequency: float, lever: float = 0.0, phase: float = 0.0
) -> BaseMotion:
    """Forced oscillation of the ground end about one axis.

    Parameters
    ----------
    component
        Moment in whose sense it turns: pitching, yawing or rolling.
    amplitude
        Of the angle [rad].
    frequency
        Of the sine [Hz].
    lever
        Distance of the axis aft of the balance's centre, for pitching and yawing [m].
    phase
        Of the angle at time 0 [rad].
    """
    w, place = 2 * np.pi * frequency, MOMENTS.index(component)
    column = COMPONENTS.index(component)
    across = {"PM": COMPONENTS.index("NF"), "YM": COMPONENTS.index("SF")}.get(component)

    def turn(time: Array) -> Array:
        return amplitude * np.sin(w * time + phase)

    def rate(time: Array) -> Array:
        return amplitude * w * np.cos(w * time + phase)

    def three(values: Array) -> Array:
        found = np.zeros((values.size, 3))
        found[:, place] = values
        return found

    def acceleration(time: Array) -> Array:
        found = np.zeros((time.size, 6))
        found[:, column] = -(w**2) * turn(time)
        if across is not None:
            found[:, across] = lever * found[:, column]
            found[:, COMPONENTS.index("AF")] = lever * rate(time) ** 2  # towards the axis
        return found

    return BaseMotion(acceleration, lambda time: three(rate(time)), lambda time: three(turn(time)))
