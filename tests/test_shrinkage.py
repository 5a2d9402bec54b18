"""Coefficients drawn to what their kind supports, and the choice among them."""

from __future__ import annotations

import numpy as np
from scipy import stats

from aerobalance.balance.calibration.selection import WORTH_LEAVING, select
from aerobalance.balance.calibration.shrinkage import SETTINGS, Coefficients, Design, shrink
from aerobalance.recording.channel import Array

COMPONENTS, LINEAR, OF_A_KIND, POINTS = 6, 6, 15, 200

KINDS = np.repeat([0, 1, 2, 3], [LINEAR, OF_A_KIND, OF_A_KIND, OF_A_KIND])

SIGMA = 1e-3
"""Scatter of the readings; with orthonormal designs also the standard uncertainty of a coefficient."""

FIVE = 5.0
"""Standard deviations within which a mean of squares lies but once in some million times."""


def readings(truth: Array, rng: np.random.Generator, *, noise: float = SIGMA) -> tuple[list[Design], Array]:
    """Readings of all components with orthonormal designs, and the coefficients of least squares."""
    points, ordinary = [], []
    for row in truth:
        design = np.linalg.qr(rng.normal(size=(POINTS, row.size)))[0]
        values = design @ row + rng.normal(0, noise, POINTS)
        points.append(Design(design, values, POINTS))
        ordinary.append(design.T @ values)
    return points, np.array(ordinary)


def of_kind(kind: int, values: Array) -> Array:
    return values[:, kind == KINDS]


def test_each_kind_is_drawn_to_zero_as_far_as_it_is_not_there(rng) -> None:
    width = np.choose(KINDS, [1.0, 0.0, SIGMA, 10 * SIGMA])
    truth = rng.normal(0, 1, (COMPONENTS, KINDS.size)) * width
    points, _ = readings(truth, rng)
    found = shrink(points, KINDS)
    error = ((found.mean - truth) / SIGMA) ** 2
    n = COMPONENTS * OF_A_KIND
    # a mean of squares is skew: what five standard deviations are of a normal number, 1.93 times the mean is of it
    high = float(stats.chi2.isf(stats.norm.sf(FIVE), n) / n)
    # squares of least squares are 1 +- one here, so that the width of a kind that is not there is learned as one (its
    # prior) or `high` - 1 at the most; the coefficients are then drawn to w / (w + 1) of what they were
    drawn = (high - 1) / high
    assert np.mean(of_kind(1, error)) < drawn**2 * high
    # half of the error of least squares where width and uncertainty are the same (Wiener)
    assert np.mean(of_kind(2, error)) < 0.5 * high
    assert np.mean(of_kind(3, error)) < high
    # what is stated goes with the width, which is learned from n squares too: the one over the other is an F number
    ratio = float(stats.f.isf(stats.norm.sf(FIVE), n, n))
    own = np.diagonal(found.covariance, axis1=1, axis2=2)
    for kind in (2, 3):
        assert 1 / ratio < np.mean(of_kind(kind, error * SIGMA**2 / own)) < ratio


def test_a_few_large_among_many_that_are_not_there_stay_as_they_are(rng) -> None:
    truth = np.where(KINDS == 0, 1.0, 0.0) * np.ones((COMPONENTS, 1))
    few = [(0, 10), (2, 30), (5, 44)]
    for place in few:
        truth[place] = rng.choice([-1, 1]) * 100 * SIGMA
    points, ordinary = readings(truth, rng)
    found = shrink(points, KINDS)
    for place in few:
        # the weight of a large one is at most (tails + 1) width^2 / b^2, so its penalty (tails + 1) scatter / b^2
        limit = (SETTINGS.tails + 1) * SIGMA**2 / abs(truth[place])
        # scatter is known to 3 %, and b to 1 %: twice the limit is far beyond both
        assert abs(found.mean[place] - ordinary[place]) < 2 * limit
    none = np.ones_like(truth, dtype=bool)
    none[:, KINDS == 0] = False
    none[tuple(np.transpose(few))] = False
    assert np.sum(found.mean[none] ** 2) < 0.5 * np.sum(ordinary[none] ** 2)


def test_readings_without_noise_are_left_alone(rng) -> None:
    truth = rng.normal(0, 1, (COMPONENTS, KINDS.size)) * np.choose(KINDS, [1.0, 0.0, 1e-3, 1e-2])
    points, _ = readings(truth, rng, noise=0.0)
    # orthonormal designs, and coefficients of one: a hundred roundings
    np.testing.assert_allclose(shrink(points, KINDS).mean, truth, rtol=0, atol=1e-13)


def test_linear_terms_alone_are_least_squares(rng) -> None:
    truth = rng.normal(0, 1, (COMPONENTS, LINEAR))
    points, ordinary = readings(truth, rng)
    found = shrink(points, np.zeros(LINEAR, dtype=np.intp))
    np.testing.assert_allclose(found.mean, ordinary, rtol=1e-12, atol=1e-15)
    assert not found.penalty.any()


def test_what_is_left_out_is_together_not_significant(rng) -> None:
    t = KINDS.size
    factor = rng.normal(size=(t, t)) / np.sqrt(t)
    covariance = factor @ factor.T + 0.1 * np.eye(t)
    mean = np.sqrt(np.diag(covariance)) * rng.standard_t(1, t) * 0.3
    chosen = select(Coefficients(mean[None], covariance[None], np.zeros((1, t))), KINDS)[0]
    assert chosen[KINDS == 0].all()
    assert 0 < np.count_nonzero(~chosen) < t - LINEAR

    def worth(left: Array) -> float:
        """Wald's statistic of coefficients, all of them together."""
        return float(mean[left] @ np.linalg.solve(covariance[np.ix_(left, left)], mean[left]))

    left = np.flatnonzero(~chosen)
    assert worth(left) <= WORTH_LEAVING * t * (1 + 1e-9)
    for further in np.flatnonzero(chosen & (KINDS > 0)):
        assert worth(np.append(left, further)) > WORTH_LEAVING * t
