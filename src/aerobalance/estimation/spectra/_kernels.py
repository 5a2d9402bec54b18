"""Compiled loops of periodograms and of the search for segments: nothing is checked."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

NUMBERS: Final = 5
"""Numbers of a spectrum that rolls off, with the noise: level, frequency of half that, exponent, power, noise."""


@compiled(nogil=True)
def cheapest(cost: Singles, price: float, total: Floats, moved: Flags, best: Integers, path: Integers) -> None:
    """Write the column of each row of a table of costs for which all together, with a price a change, are least.

    Parameters
    ----------
    cost
        The table in single precision, shape (m, l).
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


class AveragedReading(NamedTuple):
    """What the likelihood of a spectrum that rolls off needs of a periodogram of m reading.

    Attributes
    ----------
    frequency
        Logarithms of the frequencies [Hz], and of those that are folded onto them, shape (2, m).
    gain
        Squares of the response at these, shape (2, m).
    background, density
        Density of what is no force but for the white noise, and of the reading, shape (m,).
    weight
        Number of independent ordinates, shape (m,).
    """

    frequency: Floats
    gain: Floats
    background: Floats
    density: Floats
    weight: Floats


@compiled(inner=True)
def score_roll_off(point: Floats, reading: AveragedReading, gradient: Floats, information: Floats) -> float:
    """Return less the logarithm of Whittle's likelihood of a spectrum that rolls off, and write what scoring needs.

    Parameters
    ----------
    point
        Logarithms of level, frequency of half that level, exponent, power and noise, shape (5,).
    reading
        Averages of its periodogram.
    gradient
        Slopes of what is returned, shape (5,).
    information
        Lower half of the information that is expected, shape (5, 5).
    """
    level, half, noise = point[0], point[1], np.exp(point[4])
    exponent, power = np.exp(point[2]), np.exp(point[3])
    octave = np.log(2.0) / power
    shift, share = np.log(np.expm1(octave)), octave / -np.expm1(-octave)
    cost = 0.0
    for j in range(NUMBERS):
        gradient[j] = 0.0
        for k in range(NUMBERS):
            information[j, k] = 0.0
    for i in range(reading.weight.size):
        at_level = at_half = at_exponent = at_power = 0.0
        for side in range(2):  # the frequency, and that which is folded onto it
            away = reading.frequency[side, i] - half
            bend = exponent * away + shift
            rises = bend > 0
            small = np.exp(-bend if rises else bend)
            fall = np.log1p(small) + (bend if rises else 0.0)
            least = level - power * fall
            felt = reading.gain[side, i] * np.exp(least if least > -600.0 else -600.0)
            steep = power * felt * (1.0 if rises else small) / (1.0 + small)
            at_level += felt
            at_half += exponent * steep
            at_exponent -= exponent * steep * away
            at_power += share * steep - power * felt * fall
        model = at_level + reading.background[i] + noise
        ratio, weight = reading.density[i] / model, reading.weight[i]
        cost += weight * (np.log(model) + ratio)
        slopes = (at_level / model, at_half / model, at_exponent / model, at_power / model, noise / model)
        for j in range(NUMBERS):
            gradient[j] += weight * (1 - ratio) * slopes[j]
            for k in range(j + 1):
                information[j, k] += weight * slopes[j] * slopes[k]
    return cost


@compiled(inner=True)
def solve_by_root(table: Floats, size: int, step: Floats) -> None:
    """Solve some equations by the root of their matrix, in place: of both the first numbers are taken.

    Parameters
    ----------
    table
        The matrix, which has positive eigenvalues, in its lower half, where its root is written; shape (n, n).
    size
        Number of equations.
    step
        Their right side, where what solves them is written, shape (n,).
    """
    for j in range(size):
        for k in range(j + 1):
            left = table[j, k]
            for i in range(k):
                left -= table[j, i] * table[k, i]
            if k < j:
                table[j, k] = left / table[k, k]
            else:
                table[j, j] = np.sqrt(left) if left > 0 else np.inf  # but for rounding: then it is not moved
        for k in range(j):
            step[j] -= table[j, k] * step[k]
        step[j] /= table[j, j]
    for j in range(size - 1, -1, -1):
        for k in range(j + 1, size):
            step[j] -= table[k, j] * step[k]
        step[j] /= table[j, j]


@compiled(inner=True)
def solve_damped(
    slope: Floats,
    information: Floats,
    going: Flags,
    stopped: Floats,
    damping: float,
    table: Floats,
    step: Floats,
) -> None:
    """Write the step of damped scoring of some numbers, beside what others are moved by.

    Parameters
    ----------
    slope, information
        As `score_roll_off` writes them, shapes (n,) and (n, n).
    going
        The numbers whose step is looked for, shape (n,).
    stopped
        What the others are moved by, and zero for these, shape (n,).
    damping
        Added to the information, over its diagonal.
    table
        Room for a matrix, shape (n, n).
    step
        The step, shape (n,).
    """
    for j in range(NUMBERS):
        step[j] = -slope[j] if going[j] else 0.0
        for k in range(NUMBERS):
            both = information[j, k] if k <= j else information[k, j]
            if going[j] and stopped[k] != 0:
                step[j] -= both * stopped[k]
            table[j, k] = both if going[j] and going[k] else 0.0
        table[j, j] += table[j, j] * damping + (1e-9 if table[j, j] > 0 else 1.0)
    solve_by_root(table, NUMBERS, step)
    for j in range(NUMBERS):
        step[j] += stopped[j]


class Search(NamedTuple):
    """How a search goes on.

    Attributes
    ----------
    lower, upper
        Least and largest values of a point's numbers, shape (5,).
    steps
        Steps at most.
    enough
        Gain in log-likelihood expected of a step below which it is not taken.
    longest
        Change of a number in one step at most.
    damping
        Damping of the first step, over the information; a tenth of it after a step that gains, else ten times it.
    """

    lower: Floats
    upper: Floats
    steps: int
    enough: float
    longest: float
    damping: float


@compiled(nogil=True, error_model="numpy")
def lower_roll_offs(points: Floats, found: Floats, free: Flags, reading: AveragedReading, search: Search) -> None:
    """Move points to the least cost near them by damped scoring, each by itself.

    Parameters
    ----------
    points
        Points as of `score_roll_off`, which are moved, shape (b, 5).
    found
        Their costs at last, shape (b,).
    free
        Which of their numbers are to be found, shape (b, 5).
    reading
        Averages of its periodogram.
    search
        How the search goes on.
    """
    gradient, information, here = np.empty(NUMBERS), np.empty((NUMBERS, NUMBERS)), np.empty(NUMBERS)
    further, more = np.empty(NUMBERS), np.empty((NUMBERS, NUMBERS))
    slope, step, stopped, trial = np.empty(NUMBERS), np.empty(NUMBERS), np.empty(NUMBERS), np.empty(NUMBERS)
    table, moved, going = np.empty((NUMBERS, NUMBERS)), np.empty(NUMBERS, np.bool_), np.empty(NUMBERS, np.bool_)
    for place in range(points.shape[0]):
        cost, damping, taken = np.inf, 10 * search.damping, 0
        for j in range(NUMBERS):
            trial[j] = points[place, j]
        while True:
            after = score_roll_off(trial, reading, further, more)
            if after < cost or taken == 0:
                cost, damping = after, damping / 10
                for j in range(NUMBERS):
                    here[j], gradient[j] = trial[j], further[j]
                    for k in range(j + 1):
                        information[j, k] = more[j, k]
            else:
                damping *= 10
            if taken == search.steps:
                break
            taken += 1
            for j in range(NUMBERS):
                outward = gradient[j] > 0 if here[j] <= search.lower[j] else gradient[j] < 0
                ended = here[j] <= search.lower[j] or here[j] >= search.upper[j]
                moved[j] = free[place, j] and not (ended and outward)
                going[j] = moved[j]
                slope[j] = gradient[j] if moved[j] else 0.0
                stopped[j] = 0.0
            for _ in range(2):  # what would go too far stops there, and the others go on from that
                solve_damped(slope, information, going, stopped, damping, table, step)
                beyond = False
                for j in range(NUMBERS):
                    least = max(search.lower[j] - here[j], -search.longest)
                    most = min(search.upper[j] - here[j], search.longest)
                    if step[j] < least or step[j] > most:
                        beyond = True
                        going[j] = False
                    step[j] = min(max(step[j], least), most)
                if not beyond:
                    break
                for j in range(NUMBERS):
                    stopped[j] = 0.0 if going[j] else step[j]
            promise = 0.0
            for j in range(NUMBERS):
                promise -= slope[j] * step[j]
                for k in range(j + 1):
                    if moved[j] and moved[k]:
                        promise -= (0.5 if j == k else 1.0) * step[j] * information[j, k] * step[k]
            if not promise > search.enough:
                break
            for j in range(NUMBERS):
                to = min(max(here[j] + step[j], search.lower[j]), search.upper[j])
                trial[j] = to if free[place, j] else here[j]
        for j in range(NUMBERS):
            points[place, j] = here[j]
        found[place] = cost
