"""Sums over the samples of a force that tell its mean, rms, extremes, spectrum and their uncertainty, part by part.

A record that is worked out in parts needs no more than these, however long it is. What is the same in all parts, an
error of the dynamics, say, is summed up as what it does to the force; noise and the sizes of steps, which one part
does not share with the next, as variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise, Systematic, added
from aerobalance.estimation.sampled_force import End, SampledForce
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import averaged_spectrum
from aerobalance.recording.linalg import sums_of_products

Key = tuple[str, str]
"""Name and source of a contribution."""

SEGMENTS: Final = 8
"""Segments of a record, counted without overlap, that a spectrum is averaged over."""

LONGEST_SEGMENT: Final = 4096
"""Samples of one such segment at most."""


def segment_length(samples: int) -> int:
    """Return the number of samples of one segment of a record's spectrum."""
    return min(max(samples // SEGMENTS, 32), LONGEST_SEGMENT, samples)


@dataclass(slots=True)
class Extreme:
    """The largest or the least value of a force.

    Attributes
    ----------
    value, u
        Value and its standard uncertainty [N].
    sample
        Where it is.
    parts
        What each contribution adds to the uncertainty [N].
    """

    value: float
    u: float
    sample: int
    parts: dict[Key, float]


@dataclass(slots=True, eq=False)
class ContributionSums:
    """Sums over the samples of one contribution to the uncertainty.

    Attributes
    ----------
    is_noise
        Whether it is noise.
    square, fourth
        Sum of the squares of the deviation [N^2], and of its fourth powers times the mean square of the spectrum.
    left
        Sum of the squares that are left when the cause is halved [N^2].
    forms
        Variances and covariance of the sum of the samples, and of that weighted by the force, shape (2, 2), as far as
        parts do not share them.
    common
        The same two sums' slopes by the numbers that all parts share, shape (2, r).
    """

    is_noise: bool
    square: float = 0.0
    fourth: float = 0.0
    left: float = 0.0
    forms: Array = field(default_factory=lambda: np.zeros((2, 2)))
    common: Array = field(default_factory=lambda: np.zeros((2, 0)))

    def variance_of(self, weights: Array) -> float:
        """Variance of a sum of the two, weights of shape (2,) [N^2]."""
        shared = weights @ self.common
        return max(float(weights @ self.forms @ weights + shared @ shared), 0.0)


@dataclass(slots=True, eq=False)
class ForceSums:
    """Sums over the samples of a force.

    Attributes
    ----------
    smoothed
        Whether the force is a smoother's, which has less power than the true one and not more.
    samples
        How many there are.
    level
        What is taken off the force before it is squared: its mean over the first samples [N].
    total, square, variance
        Sums of the force less that [N], of its squares, and of the squares of its uncertainty [N^2].
    largest, least
        Its extremes; None before there is a sample.
    rows
        Sums of every contribution.
    """

    smoothed: bool
    samples: int = 0
    level: float = 0.0
    total: float = 0.0
    square: float = 0.0
    variance: float = 0.0
    largest: Extreme | None = None
    least: Extreme | None = None
    rows: dict[Key, ContributionSums] = field(default_factory=dict)

    def add(
        self,
        values: Array,
        uncertainty: Array,
        contributions: Sequence[Systematic | Noise],
        *,
        first: int = 0,
        sampled: SampledForce | None = None,
    ) -> None:
        """Add samples: force and uncertainty of shape (n,), and their contributions; the first is number `first`.

        Where these are on a slower clock than the record, its extremes are those of the force `sampled` on its own.
        """
        if not self.samples:
            self.level = float(values.mean())
        self.samples += values.size
        change = values - self.level
        self.total += float(change.sum())
        self.square += float(change @ change)
        self.variance += float(uncertainty @ uncertainty)
        if sampled is None:
            ends, every, begin = End.both(values, uncertainty, first=first), 1, first
        else:
            ends, every, begin = sampled.ends, sampled.every, sampled.span.start
        places = [min((one.sample - begin + every // 2) // every, values.size - 1) for one in ends]
        parts: list[dict[Key, float]] = [{}, {}]
        weights = np.stack([np.ones(values.size), change])
        for one in contributions:
            key, deviation = (one.name, one.source), one.deviation
            for place, found in zip(places, parts, strict=True):
                found[key] = float(np.hypot(found.get(key, 0.0), deviation[place]))
            self._add_row(key, one, deviation, weights=weights)
        largest, least = (Extreme(*end, found) for end, found in zip(ends, parts, strict=True))
        if self.largest is None or largest.value > self.largest.value:
            self.largest = largest
        if self.least is None or least.value < self.least.value:
            self.least = least

    def _add_row(self, key: Key, one: Systematic | Noise, deviation: Array, *, weights: Array) -> None:
        row = self.rows.setdefault(key, ContributionSums(isinstance(one, Noise)))
        square = float(deviation @ deviation)
        row.square += square
        row.left += one.halved**2 * square
        if isinstance(one, Noise):
            row.fourth += float(np.sum(deviation**4) * np.mean(one.spectrum**2))
        if isinstance(one, Noise) or one.local:
            row.forms += one.covariance_of(weights)
        elif one.slopes.size:
            row.common = added(row.common, sums_of_products(weights.T, one.slopes) @ one.numbers)


@dataclass(slots=True, eq=False)
class SpectrumSums:
    """Sums over segments of a force of its spectrum and of the errors of that, at a sampling rate of 1.

    Attributes
    ----------
    length
        Samples of a segment.
    every
        Samples of the record for each that is summed up.
    segments
        How many there are; they overlap by half.
    density
        Sum of their one-sided spectral densities, shape (m,) [N^2].
    noise
        Sum of the densities of the noise, over the samples, shape (m,) [N^2].
    variance
        Sum of the variances of `density` by what parts do not share, shape (m,).
    common
        Slopes of `density` by the numbers that all parts share, by contribution, shape (m, r).
    """

    length: int
    every: int = 1
    segments: int = 0
    density: Array = field(init=False)
    noise: Array = field(init=False)
    variance: Array = field(init=False)
    common: dict[Key, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        size = self.length // 2 + 1
        self.density, self.noise, self.variance = np.zeros(size), np.zeros(size), np.zeros(size)

    def add(self, values: Array, contributions: Sequence[Systematic | Noise]) -> None:
        """Add samples, shape (n,), at least `length` of them, with their contributions."""
        count = 1 + (values.size - self.length) // (self.length - self.length // 2)
        self.segments += count
        uncertain = [part for part in contributions if isinstance(part, Systematic) and part.covariance.any()]
        # all of them together: the spectrum of the force itself is in each
        series = [values, *(row for part in uncertain for row in part.slopes.T)]
        density, *slopes = np.real(averaged_spectrum(values, rate=1.0, length=self.length, other=series)[1])
        self.density += count * density
        for part in contributions:
            if isinstance(part, Noise):
                self.noise += part.relative_density(self.noise.size) * 2 * float(np.sum(part.deviation**2))
            elif part.covariance.any():
                own, slopes = slopes[: part.slopes.shape[1]], slopes[part.slopes.shape[1] :]
                gradient = 2 * count * np.stack(own, axis=1)
                if part.local:
                    self.variance += np.sum((gradient @ part.covariance) * gradient, axis=1)
                else:
                    key = (part.name, part.source)
                    before = self.common.get(key, np.zeros((self.density.size, 0)))
                    self.common[key] = added(before, gradient @ part.numbers)
