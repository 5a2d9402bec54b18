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


@compiled(nogil=True, error_model="numpy")
def score_roll_offs(
    points: Floats,
    frequency: Floats,
    gain: Floats,
    background: Floats,
    density: Floats,
    weight: Floats,
    cost: Floats,
    gradient: Floats,
    information: Floats,
) -> None:
    """Write what the scoring of spectra that roll off needs; all that is written must be zeros.

    Parameters
    ----------
    points
        Logarithms of level, frequency of half that level, exponent, power and noise, shape (b, 5).
    frequency, gain, background, density, weight
        As of `_Averages`.
    cost
        Less the logarithm of Whittle's likelihood, shape (b,).
    gradient
        Its slopes, shape (b, 5).
    information
        Lower half of the information that is expected, shape (b, 5, 5).
    """
    for place in range(cost.size):
        level, half, noise = points[place, 0], points[place, 1], np.exp(points[place, 4])
        exponent, power = np.exp(points[place, 2]), np.exp(points[place, 3])
        octave = np.log(2.0) / power
        shift, share = np.log(np.expm1(octave)), octave / -np.expm1(-octave)
        for i in range(weight.size):
            at_level = at_half = at_exponent = at_power = 0.0
            for side in range(2):  # the frequency, and that which is folded onto it
                away = frequency[side, i] - half
                bend = exponent * away + shift
                rises = bend > 0
                small = np.exp(-bend if rises else bend)
                fall = np.log1p(small) + (bend if rises else 0.0)
                least = level - power * fall
                felt = gain[side, i] * np.exp(least if least > -600.0 else -600.0)
                steep = power * felt * (1.0 if rises else small) / (1.0 + small)
                at_level += felt
                at_half += exponent * steep
                at_exponent -= exponent * steep * away
                at_power += share * steep - power * felt * fall
            model = at_level + background[i] + noise
            ratio = density[i] / model
            cost[place] += weight[i] * (np.log(model) + ratio)
            slopes = (at_level / model, at_half / model, at_exponent / model, at_power / model, noise / model)
            for j in range(5):
                gradient[place, j] += weight[i] * (1 - ratio) * slopes[j]
                for k in range(j + 1):
                    information[place, j, k] += weight[i] * slopes[j] * slopes[k]
