"""Excitation by a shaker: stepped sine, linear sweep, band-limited noise; steady, or unsteady near resonance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.simulation.published import VIBRATION_RIG

Signal = Callable[[Array], Array]
"""A quantity over time: takes times [s] of shape (n,), returns values of shape (n,)."""


class Drive(Protocol):
    """Force of the shaker over time."""

    @property
    def duration(self) -> float:
        """How long the drive lasts [s]."""

    def signal(self, generator: np.random.Generator) -> Signal:
        """Draw one realisation: force [N] over time [s], zero before 0 and after the duration."""


@dataclass(frozen=True, slots=True)
class Unsteadiness:
    """Random change of a drive's level and phase near resonance.

    The paper's dwells were not steady at 652.5 and 752 Hz; the size and speed of the change are assumed.

    Attributes
    ----------
    level
        Standard deviation of the level at a resonance, relative [1].
    phase
        Standard deviation of the phase at a resonance [rad].
    correlation_time
        Time constant of both low-pass filters that shape the change [s].
    near
        Frequencies of the resonances [Hz].
    width
        Distance from a resonance at which both deviations have fallen to exp(-1/2), as a Gaussian [Hz].
    """

    level: float = 0.5
    phase: float = 0.3
    correlation_time: float = 0.01
    near: tuple[float, ...] = (652.5, 752.0)
    width: float = 10.0

    def wander(self, time: Array, frequency: Array, generator: np.random.Generator) -> tuple[Array, Array]:
        """Draw relative level [1] and phase shift [rad] over time at the frequencies of a drive, shape (n,) each."""
        weight = np.zeros(time.size)
        for centre in self.near:
            weight = np.maximum(weight, np.exp(-0.5 * ((frequency - centre) / self.width) ** 2))
        level, phase = (self._noise(time, generator) for _ in range(2))
        return 1 + self.level * weight * level, self.phase * weight * phase

    def _noise(self, time: Array, generator: np.random.Generator) -> Array:
        """Draw stationary noise of unit variance, low-pass filtered by two equal first-order filters, shape (n,)."""
        from scipy.signal import lfilter  # noqa: PLC0415 - slow, and no live source needs it

        keep = float(np.exp(-(time[1] - time[0]) / self.correlation_time))
        lead = int(10 / (1 - keep))  # ten time constants, in which the start from zero is forgotten
        white = generator.standard_normal(time.size + lead)
        smooth = lfilter([1.0], [1.0, -2 * keep, keep**2], white)[lead:]
        gain = np.sqrt((1 + keep**2) / (1 - keep**2) ** 3)  # root of the sum of (k + 1)^2 keep^(2 k), k = 0, 1, ...
        return np.asarray(smooth / gain)


@dataclass(frozen=True, slots=True)
class SteppedSine:
    """A sine of constant amplitude whose frequency is held for a while and then stepped, without a phase jump.

    Attributes
    ----------
    frequencies
        Frequencies in the order they are held [Hz].
    settle, hold
        Time for transients to decay and time to measure at each frequency; together one dwell [s].
    amplitude
        Amplitude of the force [N].
    unsteadiness
        How level and phase change near resonance; None for a steady drive.
    """

    frequencies: tuple[float, ...]
    settle: float = 0.1
    hold: float = 0.4
    amplitude: float = VIBRATION_RIG.excitation.value
    unsteadiness: Unsteadiness | None = None

    @property
    def duration(self) -> float:
        """How long the drive lasts [s]."""
        return len(self.frequencies) * (self.settle + self.hold)

    def signal(self, generator: np.random.Generator) -> Signal:
        """Draw one realisation: force [N] over time [s]."""
        dwell = self.settle + self.hold
        frequencies = np.array(self.frequencies)
        phases = np.concatenate(([0.0], 2 * np.pi * np.cumsum(frequencies * dwell)))

        def force(time: Array) -> Array:
            step = np.clip(np.floor(time / dwell).astype(np.intp), 0, frequencies.size - 1)
            phase = phases[step] + 2 * np.pi * frequencies[step] * (time - step * dwell)
            level: Array | float = self.amplitude
            if self.unsteadiness is not None:
                factor, shift = self.unsteadiness.wander(time, frequencies[step], generator)
                level, phase = level * factor, phase + shift
            return np.where((time >= 0) & (time <= self.duration), level * np.sin(phase), 0.0)

        return force


@dataclass(frozen=True, slots=True)
class Sweep:
    """A linear sweep: a sine whose frequency changes from `low` to `high` [Hz] at a constant rate.

    Attributes
    ----------
    low, high
        First and last frequency [Hz].
    duration
        How long the drive lasts [s].
    amplitude
        Amplitude of the force [N].
    """

    low: float
    high: float
    duration: float
    amplitude: float = VIBRATION_RIG.excitation.value

    def signal(self, generator: np.random.Generator) -> Signal:
        """Draw one realisation: force [N] over time [s]; the phase at the start is random."""
        initial = generator.uniform(0, 2 * np.pi)

        def force(time: Array) -> Array:
            phase = initial + 2 * np.pi * (self.low * time + (self.high - self.low) * time**2 / (2 * self.duration))
            return np.where((time >= 0) & (time <= self.duration), self.amplitude * np.sin(phase), 0.0)

        return force


@dataclass(frozen=True, slots=True)
class RandomDrive:
    """Gaussian noise of a flat spectrum within a band.

    Attributes
    ----------
    low, high
        Band [Hz].
    duration
        How long the drive lasts [s].
    rms
        Standard deviation of the force [N]; if left out that of the sines of the other drives.
    """

    low: float
    high: float
    duration: float
    rms: float = VIBRATION_RIG.excitation.value / np.sqrt(2)

    def signal(self, generator: np.random.Generator) -> Signal:
        """Draw one realisation: force [N] over time [s]."""
        noise = band_noise(generator, low=self.low, high=self.high, rms=self.rms, period=self.duration)

        def force(time: Array) -> Array:
            return np.where((time >= 0) & (time <= self.duration), noise(time), 0.0)

        return force


def band_noise(generator: np.random.Generator, *, low: float, high: float, rms: float, period: float) -> Signal:
    """Draw periodic Gaussian noise of a flat spectrum between two frequencies, a function of time in the unit of rms.

    Parameters
    ----------
    generator
        Source of randomness.
    low, high
        Band [Hz].
    rms
        Standard deviation of the noise, over many draws.
    period
        Time after which the noise repeats itself [s].
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow, and no live source needs it

    if not 0 <= low < high < np.inf or not period > 0:
        raise ValueError(f"a band needs 0 <= low < high and a positive period, not {low}, {high} and {period}")
    # The spline through 16 points per period follows the fastest sine to 6.4e-5 of its amplitude.
    points = int(np.ceil(16 * high * period))
    lines = np.fft.rfftfreq(points, period / points)
    inside = (lines >= low) & (lines <= high) & (lines > 0)
    if not inside.any():
        raise ValueError(f"no frequency between {low} and {high} Hz repeats itself within {period} s")
    phasors = generator.standard_normal(lines.size) + 1j * generator.standard_normal(lines.size)
    scale = rms * points / (2 * np.sqrt(np.count_nonzero(inside)))
    values = np.fft.irfft(np.where(inside, scale * phasors, 0), points)
    spline = CubicSpline(np.linspace(0, period, points + 1), np.append(values, values[0]), bc_type="periodic")
    return lambda time: np.asarray(spline(np.mod(time, period)))
