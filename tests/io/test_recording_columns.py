"""Columns that a recording is written as: the numbers that went in come out, whatever their unit."""

import numpy as np
import pytest

from aerobalance.io.recording_columns import as_it_went_in, with_fifteen_digits
from aerobalance.recording.units import conversion


def by_formatting(values):
    """The obvious way: each number printed with fifteen digits and read again."""
    return np.array([float(f"{value:.15g}") for value in values.tolist()])


def decimals(rng, digits, count=4000):
    """Numbers of so many digits and of any size, and powers of ten."""
    wholes = rng.integers(-(10**digits), 10**digits, count)
    given = [float(f"{whole}e{power}") for whole, power in zip(wholes, rng.integers(-30, 20, count), strict=True)]
    return np.array([*given, *(float(f"1e{power}") for power in range(-30, 30)), 0.0])


@pytest.mark.parametrize("digits", [1, 7, 15])
def test_numbers_of_fifteen_digits_are_found_beside_them(rng, digits) -> None:
    given = decimals(rng, digits)
    for ulps in (-1, 0, 1):  # what a change of unit does to them
        near = given
        for _ in range(abs(ulps)):
            near = np.nextafter(near, np.copysign(np.inf, ulps * given))
        np.testing.assert_array_equal(with_fifteen_digits(near), by_formatting(near))


def test_any_number_is_rounded_to_fifteen_digits(rng) -> None:
    given = rng.normal(size=5000) * 10.0 ** rng.integers(-12, 18, 5000)
    # a tie in the sixteenth digit may go either way
    np.testing.assert_allclose(with_fifteen_digits(given), by_formatting(given), rtol=1.01e-14)
    assert np.mean(with_fifteen_digits(given) == by_formatting(given)) > 0.9
    odd = np.array([np.nan, np.inf, -np.inf, -0.0, 5e-324, 1.7e308])
    np.testing.assert_array_equal(with_fifteen_digits(odd), by_formatting(odd))


@pytest.mark.parametrize(("unit", "expected"), [("deg", "rad"), ("kN", "N"), ("lbf", "N"), ("g", "m/s^2")])
def test_what_went_in_comes_out(rng, unit, expected) -> None:
    change = conversion(unit, expected=expected)
    given = np.round(rng.normal(size=5000), 9)
    np.testing.assert_array_equal(as_it_went_in(np.asarray(change.inside(given)), change), given)
