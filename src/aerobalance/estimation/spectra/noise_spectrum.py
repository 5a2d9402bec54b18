r"""The spectrum of the noise of a reading: white, more below a corner (1/f), and broad humps.

The density is R (1 + (f_c / f)^a) and the humps. For the estimator the 1/f part becomes a sum of relaxations,
processes of one state each whose corners are a factor `APART` apart [Keshner1982]_, and a hump an oscillator.

References
----------
.. [Keshner1982] M. S. Keshner, "1/f noise", Proc. IEEE 70 (1982) 212.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls

from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array

EXPONENTS: Final = (0.3, 2.0)
"""Exponents a of 1/f^a: 2 is a random walk."""

APART: Final = 3.0
"""Ratio of the corners of two relaxations: their sum departs from a power of frequency by under 1 %."""

SLOWEST: Final = 1 / 3
"""Frequency below which 1/f noise is taken as level, over that which a record resolves."""

NEGLIGIBLE: Final = 0.01
"""Density of the 1/f noise, over the white, from which on up it needs no relaxation of its own."""


@dataclass(frozen=True, slots=True)
class Hump:
    """A broad rise of the noise: the density level (w f f_h)^2 / ((f_h^2 - f^2)^2 + (w f f_h)^2).

    Attributes
    ----------
    frequency
        Where it is highest, f_h [Hz].
    width
        Width at half of its height over its frequency, w [1].
    level
        Two-sided density at the top, above what else there is [N^2/Hz].
    """

    frequency: float
    width: float
    level: float

    def density(self, frequency: Array) -> Array:
        """Two-sided density of the process in continuous time [N^2/Hz]."""
        across = self.width * frequency * self.frequency
        return np.asarray(self.level * across**2 / ((self.frequency**2 - frequency**2) ** 2 + across**2))

    def sampled(self, frequency: Array, interval: float) -> Array:
        """Two-sided density of its samples [N^2/Hz], the first two foldings included."""
        return np.asarray(sum(self.density(frequency + shift / interval) for shift in (0, -1, 1)))

    @property
    def shaping(self) -> ShapingFilter:
        """The oscillator whose rate it is."""
        w = 2 * np.pi * self.frequency
        drift = np.array([[-self.width * w, -w], [w, 0.0]])
        return ShapingFilter(drift, np.array([self.width * w * np.sqrt(self.level), 0.0]))


@dataclass(frozen=True, slots=True, eq=False)
class ColoredNoise:
    """What a noise has beyond its white part, as the estimator takes it: independent processes of few states.

    Attributes
    ----------
    corners, variances
        Corner frequencies [Hz] and variances [N^2] of the relaxations, shape (r,) each.
    humps
        The humps.
    interval
        Time between samples [s].
    """

    corners: Array
    variances: Array
    humps: tuple[Hump, ...]
    interval: float

    @property
    def shapings(self) -> tuple[ShapingFilter, ...]:
        """What makes each process out of white noise."""
        rates = 2 * np.pi * self.corners
        slow = (
            ShapingFilter(np.array([[-rate]]), np.array([np.sqrt(2 * rate * variance)]))
            for rate, variance in zip(rates, self.variances, strict=True)
        )
        return (*slow, *(hump.shaping for hump in self.humps))

    def density(self, frequency: Array, *, width: float = 0.0) -> Array:
        """Two-sided density of the samples at frequencies [Hz], or its mean over a width around each, [N^2/Hz]."""
        frequency = np.asarray(frequency, dtype=np.float64)
        whole = np.zeros(frequency.shape)
        for corner, variance in zip(self.corners, self.variances, strict=True):
            if width > 0:
                low, high = frequency - width / 2, frequency + width / 2
                whole += variance * (
                    _power_below(high, corner, self.interval) - _power_below(low, corner, self.interval)
                )
            else:
                whole += variance * _relaxation(frequency, corner, self.interval)
        whole /= width or 1.0
        for hump in self.humps:
            whole += hump.sampled(frequency, self.interval)
        return whole


@dataclass(frozen=True, slots=True, eq=False)
class ShapedNoise:
    """What a noise has beyond its white part, as one process of any spectrum.

    Attributes
    ----------
    shaping
        What makes it out of white noise.
    interval
        Time between samples [s].
    """

    shaping: ShapingFilter
    interval: float

    @property
    def shapings(self) -> tuple[ShapingFilter, ...]:
        """What makes each process out of white noise."""
        return (self.shaping,)

    def density(self, frequency: Array, *, width: float = 0.0) -> Array:
        """Two-sided density of the samples at frequencies [Hz], the first two foldings included, [N^2/Hz].

        It hardly changes within the width of an ordinate, over which a mean is asked for.
        """
        frequency = np.asarray(frequency, dtype=np.float64)
        shifts = (0.0, -1 / self.interval, 1 / self.interval)
        return np.asarray(sum(self.shaping.spectrum(frequency + shift) for shift in shifts))


def _relaxation(frequency: Array, corner: float, interval: float) -> Array:
    """Density of the samples of a relaxation of variance 1 [1/Hz]."""
    kept = np.exp(-2 * np.pi * corner * interval)
    turn = 4 * kept * np.sin(np.pi * frequency * interval) ** 2
    return np.asarray(interval * (1 - kept**2) / ((1 - kept) ** 2 + turn))


def _power_below(frequency: Array, corner: float, interval: float) -> Array:
    """Integral of that from 0 to a frequency [1], odd in it; up to half the sampling rate it is 1/2."""
    kept = np.exp(-2 * np.pi * corner * interval)
    inside = np.clip(frequency * interval, -0.5, 0.5)
    angle = np.pi * inside
    return np.asarray(np.arctan2((1 + kept) * np.sin(angle), (1 - kept) * np.cos(angle)) / np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseSpectrum:
    """Two-sided power spectral density of the noise of a reading, R (1 + (f_c / f)^a) and humps.

    Attributes
    ----------
    white
        Density R of the white part [N^2/Hz].
    corner
        Frequency f_c at which the 1/f part is as strong [Hz]; 0 where there is none.
    exponent
        Exponent a [1].
    humps
        Broad rises above that.
    interval
        Time between the samples of the readings [s].
    covariance
        Covariance of the logarithm of the 1/f part at 1 Hz and of the exponent, shape (2, 2) [1].
    u_white
        Relative standard uncertainty of the white density [1].
    left_out
        Frequencies at which the record shows lines that are no noise [Hz].
    """

    white: float
    corner: float
    exponent: float
    humps: tuple[Hump, ...]
    interval: float
    covariance: Array
    u_white: float = 0.0
    left_out: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (0 < self.white < np.inf and 0 < self.interval < np.inf):
            raise ValueError("the white density of a noise and its interval must be positive")
        if not 0 <= self.corner < np.inf or not (self.corner == 0 or 0 < self.exponent <= EXPONENTS[1]):
            raise ValueError(f"corner must be 0 or more, and exponent above 0 and at most {EXPONENTS[1]:g}")

    @property
    def deviation(self) -> float:
        """Standard deviation of the white part of one reading [N]."""
        return float(np.sqrt(self.white / self.interval))

    @property
    def colored(self) -> bool:
        """Whether there is more than a white part."""
        return bool(self.corner > 0 or self.humps)

    def __str__(self) -> str:
        """What it is, for a reader."""
        parts = ["white noise"]
        if self.corner:
            parts.append(f"1/f^{self.exponent:.2g} below {self.corner:.3g} Hz")
        parts += [f"a hump at {hump.frequency:.3g} Hz" for hump in self.humps]
        return ", ".join(parts)

    def density(self, frequency: Array) -> Array:
        """Two-sided density at frequencies above 0 [Hz], its best value, [N^2/Hz]."""
        frequency = np.asarray(frequency, dtype=np.float64)
        whole = np.full(frequency.shape, self.white)
        if self.corner:
            whole += self.white * (self.corner / frequency) ** self.exponent
        for hump in self.humps:
            whole += hump.sampled(frequency, self.interval)
        return whole

    def relative_uncertainty(self, frequency: Array) -> Array:
        """Relative standard uncertainty of the 1/f part at frequencies above 0 [Hz], [1]."""
        slopes = np.stack([np.ones(np.shape(frequency)), -np.log(frequency)])
        return np.asarray(np.sqrt(np.einsum("i...,ij,j...->...", slopes, self.covariance, slopes)))

    def states(self, duration: float) -> ColoredNoise | None:
        """What is beyond the white part, for a record of a duration [s]; None if there is nothing.

        The expected density is taken, exp(u^2 / 2) times the best one where that is known to u: the variance of an
        error is linear in it. Below `SLOWEST` of the frequency that the record resolves it is level: what is slower is
        the zero of the reading, which neither record tells.
        """
        if not self.colored:
            return None
        corners = variances = np.zeros(0)
        if self.corner:
            slowest = SLOWEST / duration
            fastest = min(max(self.corner * NEGLIGIBLE ** (-1 / self.exponent), 4 * slowest), 0.5 / self.interval)
            count = int(np.ceil(np.log(fastest / slowest) / np.log(APART))) + 1
            corners = np.geomspace(slowest, fastest, count)
            frequency = np.geomspace(slowest / 10, 0.5 / self.interval, 40 * count)
            known = np.sqrt(frequency**2 + slowest**2)
            wanted = self.white * (self.corner / known) ** self.exponent
            wanted *= np.exp(np.minimum(self.relative_uncertainty(known), 1.0) ** 2 / 2)
            parts = np.column_stack([_relaxation(frequency, corner, self.interval) for corner in corners])
            weight = 1 / (wanted + self.white)
            scale = np.linalg.norm(parts * weight[:, None], axis=0)
            sizes, _ = nnls(parts * weight[:, None] / scale, wanted * weight)
            kept = sizes > 0
            corners, variances = corners[kept], (sizes / scale)[kept]
        return ColoredNoise(corners, variances, self.humps, self.interval)
