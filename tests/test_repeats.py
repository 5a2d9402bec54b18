"""Repeats against what is stated of them, and drift along a test: on numbers worked out by hand, and on drawn ones."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.uncertainty.repeats import Pooled, Scatter, pooled, pooled_results, trend


def test_scatter_of_three():
    # 1, 2, 6: mean 3, squares 4 + 1 + 9 over 2; differences with variances 2, 4, 6, half of their mean 2
    found = Scatter.of([1, 2, 6], [2, 4, 6])
    assert (found.mean, found.deviation, found.expected, found.freedom) == pytest.approx((3, 7**0.5, 2**0.5, 2))
    assert found.chi_square == pytest.approx(3.5)
    other = Scatter.of([0, 2], [8])  # variance 2, expected 4
    whole = pooled([found, other])
    assert whole is not None
    # variance of the expected sum of 8: 2 (2 x 2^2 + 4^2) = 48, and a chi-square of f has 2 x 8^2 / f
    assert (whole.chi_square, whole.freedom) == pytest.approx(((2 * 7 + 2) / (2 * 2 + 4), 64 / 24))
    assert pooled([]) is None
    assert pooled([Scatter.of([1, 2], [0])]) is None


def test_limits_are_those_of_tables_of_chi_square():
    # 10 degrees of freedom: 3.247 and 20.483 at 2.5 and 97.5 %, 29.588 and 1.479 at 99.9 and 0.1 %
    # (NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.4)
    assert Pooled(1.0, 10).limits == pytest.approx((0.3247, 2.0483), abs=5e-5)
    for chi_square, above, below in ((2.95, False, False), (2.97, True, False), (0.149, False, False)):
        assert Pooled(chi_square, 10).above(1e-3) is above
        assert Pooled(chi_square, 10).below(1e-3) is below
    assert Pooled(0.147, 10).below(1e-3)


def test_groups_that_differ_in_what_is_stated_are_judged_as_they_count(rng):
    """Ten groups of three repeats, half of them with three times the uncertainty of the others."""
    u, count = np.repeat([1.0, 3.0], 5), 2000
    squares = u**2 * rng.chisquare(2, (count, 10)) / 2
    found = [pooled([Scatter(0.0, s**0.5, e, 2) for s, e in zip(row, u, strict=True)]) for row in squares]
    inside = np.mean([low < one.chi_square < high for one in found if one for low, high in [one.limits]])
    # 95 % to what a sum of squares of two sizes differs from a chi-square by, which is 1 %; with the freedom of all
    # groups it was 88 %
    assert inside == pytest.approx(0.95, abs=0.01 + 4 * np.sqrt(0.05 * 0.95 / count))


def test_results_of_the_same_repeats_count_by_what_they_do_not_share():
    # three results of 10 degrees of freedom: as many as 30 where nothing is shared, as 10 where all is; two of three
    # that share all: variance 2 (4 x 10 + 10) of a sum of 30, which has 900 / 50 degrees of freedom
    one, other = Pooled(1.3, 10), Pooled(0.7, 10)
    for correlation, freedom in (
        (np.eye(3), 30),
        (np.ones((3, 3)), 10),
        ([[1, 1, 0], [1, 1, 0], [0, 0, 1]], 18),
        ([[1, -1, 0], [-1, 1, 0], [0, 0, 1]], 18),
    ):
        found = pooled_results([one, one, other], correlation)
        assert (found.chi_square, found.freedom) == pytest.approx((1.1, freedom))


def test_a_trend_is_found_with_its_uncertainty(rng):
    place, u = np.arange(40.0), np.full(40, 0.5)
    scores = []
    for _ in range(200):
        found = trend(place, 3.0 + 2.0 * place / 39 + rng.normal(0, u), u)
        scores.append([(found.mean - 4.0) / found.u_mean, (found.change - 2.0) / found.u_change])
    # standard deviation 1, known from 200 to 5 %; the uncertainty is never below that stated, which makes it up to a
    # twentieth larger: half the excess of sqrt(chi-square / 38), on average 0.4 x 0.115
    assert np.std(scores, axis=0) == pytest.approx([0.955, 0.955], abs=5 * 0.05)
    assert np.abs(np.mean(scores, axis=0)) == pytest.approx([0, 0], abs=5 / np.sqrt(200))


def test_a_trend_of_values_that_scatter_more_than_stated_is_as_uncertain_as_they_scatter():
    found = trend([0, 1, 2, 3], [1.0, -1.0, -1.0, 1.0], [0.1] * 4)
    assert found.change == pytest.approx(0)
    # weights of 100, squares of 4 with 2 degrees of freedom: a scale of sqrt(400 / 2)
    assert found.u_mean == pytest.approx(np.sqrt(200 / 400))
