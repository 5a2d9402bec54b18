"""Compiled loop of the search for segments: arrays of float64, nothing checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@compiled()
def cheapest(cost: Floats, price: float, total: Floats, moved: Flags, best: Integers, path: Integers) -> None:
    """Write the column of each row of a table of costs for which all together, with a price a change, are least.

    Parameters
    ----------
    cost
        The table, shape (m, l).
    price
        Cost of a change of the column from one row to the next.
    total
        Zeros, shape (l,): costs up to a row.
    moved
        Whether the best way to a place comes from the best column of the row before, shape (m, l).
    best
        That column, zero for the first row, shape (m + 1,).
    path
        The columns, shape (m,).
    """
    rows, columns = cost.shape
    for row in range(rows):
        change = total[best[row]] + price
        for column in range(columns):
            further = total[column] > change
            moved[row, column] = further
            total[column] = (change if further else total[column]) + cost[row, column]
        least = 0
        for column in range(columns):
            if total[column] < total[least]:
                least = column
        best[row + 1] = least
    here = best[rows]
    for row in range(rows - 1, -1, -1):
        path[row] = here
        if moved[row, here]:
            here = best[row]
