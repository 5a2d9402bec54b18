"""Compiled loops of periodograms and of the search for segments: arrays of float64, nothing checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@compiled(nogil=True)
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


@compiled(nogil=True)
def averages(level: NDArray[np.float64], fewest: int, fineness: float, most: float) -> NDArray[np.int64]:
    """First ordinate of each average: it ends where the level differs by more than `most`, or after enough of them.

    Parameters
    ----------
    level : (n,)
        Logarithm of the response's squares at the ordinates.
    fewest, fineness
        Ordinates of an average, at least, and over the number of its first one.
    most
        Change of the level within an average.
    """
    edges = np.empty(level.size, np.int64)
    count, here = 0, 0
    while here < level.size:
        edges[count] = here
        count += 1
        end = min(here + max(fewest, int(fineness * here)), level.size)
        last = here + 1
        while last < end and abs(level[last] - level[here]) <= most:
            last += 1
        here = last
    return edges[:count].copy()
