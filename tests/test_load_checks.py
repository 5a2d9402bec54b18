"""Range of loads along long tables."""

import numpy as np
import pytest

from aerobalance.balance.load_checks import ROWS_AT_ONCE, _along_rows, beyond_range
from aerobalance.recording.linalg import table_covariance, whole_rows
from aerobalance.simulation.calibration_stand import CAPACITIES, random_balance


@pytest.mark.parametrize("rows", [1, 2 * ROWS_AT_ONCE - 1, 2 * ROWS_AT_ONCE, 5 * ROWS_AT_ONCE + 3])
def test_least_and_largest_of_all_rows_are_found_in_blocks(rows, rng):
    """Every row may hold them, those beyond the last whole block too; what is missing is passed over."""
    table = rng.normal(size=(rows, 6))
    table[rng.random(table.shape) < 0.2] = np.nan
    for ufunc, sign in ((np.fmin, -1.0), (np.fmax, 1.0)):
        for place in {0, rows // 2, rows - 1}:
            marked = table.copy()
            marked[place] = sign * 100.0
            assert np.array_equal(_along_rows(ufunc, marked), np.full(6, sign * 100.0))
        assert np.array_equal(_along_rows(ufunc, table), ufunc.reduce(table), equal_nan=True)


def test_covariance_of_a_long_table_is_that_of_numpy(rng):
    table = rng.normal(size=(5000, 6)) @ rng.normal(size=(6, 6)) + 100.0
    expected = np.cov(table.T)
    # rounding of 5000 products of numbers of 100 and less
    np.testing.assert_allclose(table_covariance(table), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_rows_are_whole_where_nothing_is_missing(rng):
    table = rng.normal(size=(50, 3))
    assert whole_rows(table).all()
    table[[3, 7], [0, 2]] = np.nan
    assert np.flatnonzero(~whole_rows(table)).tolist() == [3, 7]


def test_what_lies_beyond_the_range_is_counted_by_component(seed):
    balance = random_balance(seed)
    assert beyond_range(balance, np.zeros((0, 6))) == {}  # a stream may hand over no sample
    assert beyond_range(balance, 0.9 * np.tile(CAPACITIES, (5, 1))) == {}
    loads = np.zeros((5, 6))
    loads[1:3, 2] = -1.2 * CAPACITIES[2]
    assert beyond_range(balance, loads) == {balance.components[2]: 2}
