"""Whether what is measured again and again scatters as its uncertainties state, and whether it drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Scatter:
    """How repeats of one quantity scatter.

    Attributes
    ----------
    mean
        Their mean.
    deviation
        Standard deviation about it.
    expected
        What their stated uncertainties make of it.
    freedom
        Degrees of freedom: their number less 1.
    """

    mean: float
    deviation: float
    expected: float
    freedom: int

    @classmethod
    def of(cls, values: ArrayLike, differences: ArrayLike) -> Scatter:
        """Return how values scatter, in their unit.

        Parameters
        ----------
        values
            Two or more, shape (n,).
        differences
            Variance of the difference of every two of them by what is stated: errors that both share are not in it.
        """
        given = np.asarray(values, dtype=float)
        expected = float(np.sqrt(np.mean(np.asarray(differences, dtype=float)) / 2))
        return cls(float(given.mean()), float(given.std(ddof=1)), expected, given.size - 1)

    @property
    def chi_square(self) -> float:
        """Variance over that expected, which is chi-square per degree of freedom [1]."""
        return (self.deviation / self.expected) ** 2 if self.expected > 0 else float("nan")


@dataclass(frozen=True, slots=True)
class Pooled:
    """Scatter of many groups of repeats over what is stated.

    Attributes
    ----------
    chi_square
        Per degree of freedom [1].
    freedom
        Degrees of freedom.
    """

    chi_square: float
    freedom: int

    @property
    def limits(self) -> tuple[float, float]:
        """Between which `chi_square` lies with 95 % where all is as stated [1]."""
        return self._below(0.025), self._below(0.975)

    def below(self, chance: float) -> bool:
        """Return whether chi-square is so small that chance alone makes it no larger less often than this."""
        return self.chi_square < self._below(chance)

    def above(self, chance: float) -> bool:
        """Return whether chi-square is so large that chance alone makes it no smaller less often than this."""
        return self.chi_square > self._below(1 - chance)

    def _below(self, probability: float) -> float:
        """What chi-square per degree of freedom is below with a probability."""
        from scipy.special import chdtri  # noqa: PLC0415 - few commands need it

        return float(chdtri(self.freedom, 1 - probability)) / self.freedom


def pooled(groups: Sequence[Scatter]) -> Pooled | None:
    """Return the scatter of all groups over what is stated [1]; None where there is none.

    It is the sum of the squares over that of those expected: stated uncertainties are estimates, whose inverses would
    be biased.
    """
    freedom = sum(one.freedom for one in groups)
    expected = sum(one.freedom * one.expected**2 for one in groups)
    if not freedom or not expected:
        return None
    return Pooled(sum(one.freedom * one.deviation**2 for one in groups) / expected, freedom)


@dataclass(frozen=True, slots=True)
class Trend:
    """How a quantity goes along a test.

    Attributes
    ----------
    mean, u_mean
        Weighted mean and its standard uncertainty, not less than the values scatter.
    change, u_change
        Change from the first to the last by a straight line, and the same of it.
    """

    mean: float
    u_mean: float
    change: float
    u_change: float


def trend(place: Sequence[float], values: Sequence[float], u: Sequence[float]) -> Trend:
    """Return the weighted mean of values and the straight line through them, in their unit.

    Parameters
    ----------
    place
        Where each is along the test, such as its number, shape (n,).
    values, u
        The values and their standard uncertainties, shape (n,).
    """
    x, y, weight = np.asarray(place, dtype=float), np.asarray(values), 1 / np.asarray(u) ** 2
    mean = float(np.average(y, weights=weight))
    centre, length = float(np.average(x, weights=weight)), float(np.ptp(x)) or 1.0
    position = (x - centre) / length
    spread = float(np.sum(weight * position**2))
    change = float(np.sum(weight * position * (y - mean)) / spread) if spread > 0 else 0.0
    square = float(np.sum(weight * (y - mean - change * position) ** 2)) / max(y.size - 2, 1)
    scale = float(np.sqrt(max(square, 1.0)))
    u_change = scale / np.sqrt(spread) if spread > 0 else np.inf
    return Trend(mean, scale / float(np.sqrt(weight.sum())), change, float(u_change))
