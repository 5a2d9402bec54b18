"""Shrinkage: coefficients with a prior width for each kind of term, fitted to the calibration (empirical Bayes).

A calibration seldom says of a small coefficient alone whether it is there, and many that are not, taken together, are
worth more than the noise of a reading. The coefficients of a kind, F*G say, of all bridges are therefore taken to come
from one distribution about zero, whose width the readings tell (empirical Bayes): kinds that a balance does not have
vanish, and the others keep what the readings support. The distribution is Student's, so that a few large ones among
many small are left as they are [Tipping2005]_. A width of zero, which the likelihood alone may ask for, would make
certain what is not; the prior of [Chung2013]_ keeps it about a standard error away.

References
----------
.. [Tipping2005] M. E. Tipping, N. D. Lawrence, "Variational inference for Student-t models: robust Bayesian
   interpolation and generalised component analysis", Neurocomputing 69 (2005) 123-141.
.. [Chung2013] Y. Chung, S. Rabe-Hesketh, V. Dorie, A. Gelman, J. Liu, "A nondegenerate penalized likelihood estimator
   for variance parameters in multilevel models", Psychometrika 78 (2013) 685-709.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class ShrinkageSettings:
    """Thresholds of the shrinkage of coefficients.

    Attributes
    ----------
    tails
        Degrees of freedom of the distribution of the coefficients of a kind.
    away_from_zero
        Power of the width that its prior is proportional to [Chung2013]_.
    rounds
        Steps of the search for the widths, at most.
    tolerance
        Last relative change of a squared width at which the search ends.
    rounding
        Scatter over capacity that is no more than rounding.
    """

    tails: float = 4.0
    away_from_zero: float = 1.0
    rounds: int = 500
    tolerance: float = 1e-3
    rounding: float = 1e-12


SETTINGS: Final = ShrinkageSettings()
"""Thresholds that are used."""


class Design(NamedTuple):
    """Design and values of one component, series intercepts projected out of both: n points, t terms.

    Attributes
    ----------
    design
        Shape (n, t).
    values
        Shape (n,).
    freedom
        Points less intercepts.
    """

    design: Array
    values: Array
    freedom: int


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """Posterior of the coefficients by the readings and the widths of the kinds: c components, t terms.

    Attributes
    ----------
    mean, covariance
        Shape (c, t) and (c, t, t).
    penalty
        What draws each coefficient to zero: the variance of a reading over that expected of the coefficient, shape
        (c, t); 0 for linear terms, of which nothing is expected.
    """

    mean: Array
    covariance: Array
    penalty: Array


def shrink(components: Sequence[Design], kinds: NDArray[np.intp]) -> Coefficients:
    """Return the width of each kind of term, fitted to the readings, and the coefficients with it.

    Widths and scatter of the readings by expectation and maximisation; the weights of single coefficients are those of
    a scale mixture of normal distributions.

    Parameters
    ----------
    components
        Scaled points of every component; all have the same terms, and more points than unknowns.
    kinds
        Kind of every term, shape (t,); 0 is linear.
    """
    problems = [_Problem.of(item) for item in components]
    curved = kinds > 0
    ordinary = np.array([item.coefficients(np.zeros(kinds.size))[0] for item in problems])
    scatter = np.array([item.scatter(b, kinds.size) for item, b in zip(problems, ordinary, strict=True)])
    weight = np.ones_like(ordinary)
    width = _widths(ordinary**2, kinds)
    for _ in range(SETTINGS.rounds):
        penalty = np.where(curved, weight * scatter[:, None] / width, 0.0)
        solved = [item.coefficients(row) for item, row in zip(problems, penalty, strict=True)]
        mean, inverse = np.array([b for b, _ in solved]), np.array([C for _, C in solved])
        own = np.diagonal(inverse, axis1=1, axis2=2)
        unknowns = kinds.size - np.sum(penalty * own, axis=1)
        scatter = np.array([item.scatter(b, n) for item, b, n in zip(problems, mean, unknowns, strict=True)])
        square = mean**2 + own * scatter[:, None]
        weight = (SETTINGS.tails + 1) / (SETTINGS.tails + square / width)
        last, width = width, _widths(weight * square, kinds)
        if np.max(np.abs(np.log(width / last))) < SETTINGS.tolerance:
            break
    return Coefficients(mean, inverse * scatter[:, None, None], penalty)


class _Problem(NamedTuple):
    """A component's points by R and Q^T y of a QR decomposition, their products, and the squares none reaches."""

    R: Array
    turned: Array
    squares: Array
    products: Array
    beyond: float
    freedom: int

    @classmethod
    def of(cls, points: Design) -> _Problem:
        Q, R = np.linalg.qr(points.design)
        turned = Q.T @ points.values
        rest = points.values - Q @ turned
        return cls(R, turned, R.T @ R, R.T @ turned, float(rest @ rest), points.freedom)

    def coefficients(self, penalty: Array) -> tuple[Array, Array]:
        """Coefficients, and their covariance over the variance of a reading."""
        inverse: Array = np.linalg.inv(self.squares + np.diag(penalty)).astype(np.float64, copy=False)
        return inverse @ self.products, inverse

    def scatter(self, coefficients: Array, unknowns: float) -> float:
        """Variance of a reading about the coefficients."""
        missed = self.turned - self.R @ coefficients
        return max((self.beyond + float(missed @ missed)) / max(self.freedom - unknowns, 1.0), SETTINGS.rounding**2)


def _widths(squares: Array, kinds: NDArray[np.intp]) -> Array:
    """Squared width of every term's kind, from the squares of the coefficients of all components, shape (t,)."""
    width = np.ones(kinds.size)
    for kind in np.unique(kinds[kinds > 0]):
        those = squares[:, kinds == kind]
        width[kinds == kind] = max(
            np.sum(those) / max(those.size - SETTINGS.away_from_zero, 1.0), SETTINGS.rounding**2
        )
    return width
