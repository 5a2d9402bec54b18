"""Shunt and return to zero: the resistor's change in closed form, and verdicts that hold as often as they say."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from aerobalance.acquisition.pretest_checks import Change, check_return, check_shunt, mean_change, shunt_output


def test_shunt_changes_a_bridge_as_its_resistances_say() -> None:
    # two dividers of equal arms R; S lies across one arm of the second
    for arm, shunt in ((350, 100_000), (120, 59_880), (1000, 1)):
        lower = Fraction(arm * shunt, arm + shunt)
        output = Fraction(1, 2) - lower / (arm + lower)
        assert shunt_output(arm, shunt_resistance=shunt) == pytest.approx(float(1000 * output), rel=1e-15)
    with pytest.raises(ValueError, match="shunt_resistance must be above zero"):
        shunt_output(350.0, shunt_resistance=0.0)


def test_change_and_its_uncertainty_are_students() -> None:
    # means 1, 2, 3 and 5, 7, 9: pooled variance (2 + 8) / 4, standard 2.5 * 2 / 3, 4 degrees of freedom: t = 2.776445
    change = mean_change(np.array([1.0, 2.0, 3.0]), np.array([5.0, 9.0, np.nan, 7.0]))
    assert change.value == 5.0
    assert change.expanded == pytest.approx(2.7764451052 * np.sqrt(2.5 * 2 / 3), rel=1e-9)
    with pytest.raises(ValueError, match="two spans at least"):
        mean_change(np.array([1.0, np.nan]), np.array([1.0, 2.0]))


def test_uncertainty_covers_as_often_as_it_says(rng) -> None:
    trials = 4000
    means = rng.normal(size=(trials, 2, 5))
    changes = [mean_change(before, after) for before, after in means]
    covered = sum(abs(change.value) <= change.expanded for change in changes)
    # binomial of 0.95: 4.5 standard deviations happen by chance once in 150,000 runs
    assert abs(covered - 0.95 * trials) < 4.5 * np.sqrt(trials * 0.95 * 0.05), covered


@pytest.mark.parametrize(
    ("value", "expanded", "verdict"),
    [(99.7, 0.1, "passed"), (100.45, 0.1, "undecided"), (100.55, 0.1, "undecided"), (98.0, 0.5, "failed")],
)
def test_verdict_needs_the_uncertainty_on_one_side(value, expanded, verdict) -> None:
    checked = check_shunt("rAF", Change(value, expanded), expected=100.0, tolerance=0.005)
    assert (checked.verdict, checked.tolerance) == (verdict, 0.5)
    assert checked.departure == pytest.approx(value - 100)


def test_uncertainty_of_what_is_expected_counts() -> None:
    checked = check_shunt("rAF", Change(-0.85, 0.003), expected=-0.85, relative_uncertainty=0.002)
    # both at 95 %: 1.96 * 0.002 * 0.85 and 0.003, in squares
    assert checked.expanded == pytest.approx(np.hypot(0.003, 0.003332))
    with pytest.raises(ValueError, match="must be given"):
        check_shunt("rAF", Change(0.0, 0.1), expected=0.0)


def test_load_returns_to_zero_within_a_part_of_its_range() -> None:
    assert check_return("AF", Change(1.5, 0.4), half_range=2000.0).verdict == "passed"
    assert check_return("AF", Change(-9.0, 0.4), half_range=2000.0).verdict == "failed"
    assert check_return("AF", Change(0.0, 2.5), half_range=2000.0).verdict == "undecided"
    with pytest.raises(ValueError, match="half of the range of AF"):
        check_return("AF", Change(0.0, 1.0), half_range=0.0)
