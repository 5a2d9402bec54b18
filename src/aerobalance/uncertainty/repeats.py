"""Repeatability: reduced chi-square of repeats against their stated uncertainties, and drift along a test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviation of repeats of one quantity, as measured and as expected from their uncertainties.

    Attributes
    ----------
    mean
        Mean of the repeats.
    deviation
        Measured standard deviation about the mean.
    expected
        Standard deviation to be expected from the stated uncertainties.
    freedom
        Degrees of freedom: the number of repeats less 1.
    """

    mean: float
    deviation: float
    expected: float
    freedom: int

    @classmethod
    def of(cls, values: ArrayLike, differences: ArrayLike) -> Scatter:
        """Return the measured and the expected standard deviation of repeats, in their unit.

        Parameters
        ----------
        values
            The repeats, two or more, shape (n,).
        differences
            Stated variance of the difference of each pair of repeats, shape (n (n - 1) / 2,); an error that both share
            cancels in a difference and is not counted.
        """
        given = np.asarray(values, dtype=float)
        # The sample variance is half the mean squared difference of all pairs, so this is its expectation.
        expected = float(np.sqrt(np.mean(np.asarray(differences, dtype=float)) / 2))
        return cls(float(given.mean()), float(given.std(ddof=1)), expected, given.size - 1)

    @property
    def chi_square(self) -> float:
        """Reduced chi-square: measured over expected variance [1]; NaN where no uncertainty is stated."""
        return (self.deviation / self.expected) ** 2 if self.expected > 0 else float("nan")


@dataclass(frozen=True, slots=True)
class Pooled:
    """Reduced chi-square of many groups of repeats together.

    Attributes
    ----------
    chi_square
        Reduced chi-square [1]: 1 on average where the stated uncertainties are right.
    freedom
        Degrees of freedom, by Welch and Satterthwaite: fewer than those of all groups together where some groups are
        expected to scatter more than others, and so count more.
    """

    chi_square: float
    freedom: float

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the central 95 % interval of `chi_square` if the stated uncertainties are right [1]."""
        return self._quantile(0.025), self._quantile(0.975)

    def below(self, chance: float) -> bool:
        """Return whether `chi_square` is so small that the probability of a smaller one is less than `chance`."""
        return self.chi_square < self._quantile(chance)

    def above(self, chance: float) -> bool:
        """Return whether `chi_square` is so large that the probability of a larger one is less than `chance`."""
        return self.chi_square > self._quantile(1 - chance)

    def _quantile(self, probability: float) -> float:
        """Quantile of the reduced chi-square distribution [1]."""
        from scipy.special import chdtri  # noqa: PLC0415 - few commands need it

        return float(chdtri(self.freedom, 1 - probability)) / self.freedom


def pooled(groups: Sequence[Scatter]) -> Pooled | None:
    """Return the reduced chi-square of all groups [1]; None where there are no repeats or no stated uncertainty.

    It is the sum of the measured squares over the sum of the expected ones, and not the mean of the groups' ratios: an
    expected variance is itself an estimate, and the mean of inverses of estimates is biased.
    """
    expected = sum(one.freedom * one.expected**2 for one in groups)
    if not expected:
        return None
    # the variance of the sum of the measured squares, of which each group's is 2 f e^4
    freedom = expected**2 / sum(one.freedom * one.expected**4 for one in groups)
    return Pooled(sum(one.freedom * one.deviation**2 for one in groups) / expected, freedom)


def correlation_of_repeats(groups: Sequence[Array]) -> Array:
    """Return correlation coefficients of the deviations of results from the means of their repeats [1], shape (n, n).

    Their signs are left out.

    Parameters
    ----------
    groups
        Results of each group of repeats, NaN where a run has none, shape (runs, n) each.
    """
    products = np.zeros((groups[0].shape[1],) * 2)
    freedom = np.zeros_like(products)
    for values in groups:
        there = np.isfinite(values)
        means = np.where(there, values, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
        off = np.where(there, values - means, 0.0)
        products += off.T @ off
        freedom += np.maximum(there.T.astype(np.float64) @ there - 1, 0.0)
    scale = np.sqrt(np.diag(products))
    square = np.square(products) / np.square(np.outer(scale, scale) + np.finfo(float).tiny)
    # the square of an estimate from f degrees of freedom is on average larger than that of what it estimates
    square = np.clip((freedom * square - 1) / np.maximum(freedom - 1, 1), 0.0, 1.0)
    np.fill_diagonal(square, 1.0)
    return np.asarray(np.sqrt(square))


def pooled_results(results: Sequence[Pooled], correlation: ArrayLike) -> Pooled:
    """Return the reduced chi-square of several results of the same repeats [1].

    Parameters
    ----------
    results
        That of each result.
    correlation
        Correlation coefficients of their deviations, shape (n, n): results that scatter together are no further
        evidence, so the variance of the sum of their chi-squares, of f degrees of freedom each, is
        2 sum(r_ij^2 sqrt(f_i f_j)).
    """
    freedom = np.array([one.freedom for one in results])
    total = float(freedom.sum())
    root = np.sqrt(freedom)
    chi_square = float(freedom @ [one.chi_square for one in results]) / total
    return Pooled(chi_square, total**2 / float(root @ np.square(correlation) @ root))


@dataclass(frozen=True, slots=True)
class Trend:
    """Weighted mean of a quantity and its drift along a test.

    Both standard uncertainties are enlarged by the Birge ratio where the values scatter more than is stated.

    Attributes
    ----------
    mean, u_mean
        Weighted mean and its standard uncertainty.
    change, u_change
        Change of the fitted straight line from the first to the last value, and its standard uncertainty.
    """

    mean: float
    u_mean: float
    change: float
    u_change: float


def trend(place: Sequence[float], values: Sequence[float], u: Sequence[float]) -> Trend:
    """Return the weighted mean of values and the change of a straight line through them, in their unit.

    Parameters
    ----------
    place
        Position of each value along the test, such as the number of its run, shape (n,).
    values, u
        The values and their standard uncertainties, shape (n,) each.
    """
    x, y, weight = np.asarray(place, dtype=float), np.asarray(values), 1 / np.asarray(u) ** 2
    mean = float(np.average(y, weights=weight))
    centre, length = float(np.average(x, weights=weight)), float(np.ptp(x)) or 1.0
    position = (x - centre) / length
    spread = float(np.sum(weight * position**2))
    change = float(np.sum(weight * position * (y - mean)) / spread) if spread > 0 else 0.0
    chi_square = float(np.sum(weight * (y - mean - change * position) ** 2)) / max(y.size - 2, 1)
    birge = float(np.sqrt(max(chi_square, 1.0)))
    u_change = birge / np.sqrt(spread) if spread > 0 else np.inf
    return Trend(mean, birge / float(np.sqrt(weight.sum())), change, float(u_change))
