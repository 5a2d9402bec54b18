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


@compiled(inner=True)
def _cost_of_roll_off(
    point: Floats,
    frequency: Floats,
    gain: Floats,
    background: Floats,
    density: Floats,
    weight: Floats,
    gradient: Floats,
    information: Floats,
) -> float:
    """Less the logarithm of Whittle's likelihood; write its slopes, (5,), and the information expected, (5, 5)."""
    level, half, noise = point[0], point[1], np.exp(point[4])
    exponent, power = np.exp(point[2]), np.exp(point[3])
    octave = np.log(2.0) / power
    shift, share = np.log(np.expm1(octave)), octave / -np.expm1(-octave)
    gradient[:] = 0.0
    information[:] = 0.0
    slope = np.empty(5)
    cost = 0.0
    for i in range(weight.size):
        slope[0] = slope[1] = slope[2] = slope[3] = 0.0
        for side in range(2):  # the frequency, and that which is folded onto it
            bend = exponent * (frequency[side, i] - half) + shift
            small = np.exp(-abs(bend))
            fall = max(bend, 0.0) + np.log1p(small)
            felt = gain[side, i] * np.exp(max(level - power * fall, -600.0))
            steep = power * felt * (1.0 if bend > 0 else small) / (1.0 + small)
            slope[0] += felt
            slope[1] += exponent * steep
            slope[2] -= exponent * steep * (frequency[side, i] - half)
            slope[3] += share * steep - power * felt * fall
        slope[4] = noise
        model = slope[0] + background[i] + noise
        ratio = density[i] / model
        cost += weight[i] * (np.log(model) + ratio)
        for j in range(5):
            slope[j] /= model
            gradient[j] += weight[i] * (1 - ratio) * slope[j]
            for k in range(j + 1):
                information[j, k] += weight[i] * slope[j] * slope[k]
    for j in range(5):
        for k in range(j):
            information[k, j] = information[j, k]
    return cost


@compiled(inner=True)
def _scoring_step(slope: Floats, bend: Floats, damping: float, room: Floats, step: Floats) -> None:
    """Write the step for slopes and information, this with so much more of its diagonal; zero where there is none."""
    for j in range(5):
        step[j] = -slope[j]
        for k in range(5):
            room[j, k] = bend[j, k]
        room[j, j] += bend[j, j] * damping + (1e-9 if bend[j, j] > 0 else 1.0)
    # positive definite: no pivots
    for j in range(5):
        for i in range(j + 1, 5):
            factor = room[i, j] / room[j, j]
            for k in range(j, 5):
                room[i, k] -= factor * room[j, k]
            step[i] -= factor * step[j]
    for j in range(4, -1, -1):
        for k in range(j + 1, 5):
            step[j] -= room[j, k] * step[k]
        step[j] /= room[j, j]


@compiled(nogil=True, error_model="numpy")
def score_roll_offs(
    points: Floats,
    free: Flags,
    limits: Floats,
    frequency: Floats,
    gain: Floats,
    background: Floats,
    density: Floats,
    weight: Floats,
    settings: tuple[int, float, float, float],
) -> Floats:
    """Move points of a spectrum that rolls off to where it is most likely, each by itself; return their costs, (b,).

    Parameters
    ----------
    points
        Logarithms of level, frequency of half that level, exponent, power and noise, shape (b, 5).
    free
        Which of them are to be found, shape (b, 5).
    limits
        Least and largest values, shape (2, 5).
    frequency, gain, background, density, weight
        As of `_Averages`.
    settings
        Steps at most, gain that a step must promise, damping of the first step, and longest step.
    """
    most, enough, first_damping, longest = settings
    costs = np.empty(points.shape[0])
    gradient, after = np.empty(5), np.empty(5)
    information, later = np.empty((5, 5)), np.empty((5, 5))
    bend, room = np.empty((5, 5)), np.empty((5, 5))
    slope, left, step, trial = np.empty(5), np.empty(5), np.empty(5), np.empty(5)
    low, high = np.empty(5), np.empty(5)
    stops, moved = np.empty(5, dtype=np.bool_), np.empty(5, dtype=np.bool_)
    for place in range(points.shape[0]):
        here, damping = points[place], first_damping
        cost = _cost_of_roll_off(here, frequency, gain, background, density, weight, gradient, information)
        for _ in range(most):
            for j in range(5):
                below = here[j] <= limits[0, j] and gradient[j] > 0
                above = here[j] >= limits[1, j] and gradient[j] < 0
                moved[j] = free[place, j] and not (below or above)
                low[j] = max(limits[0, j] - here[j], -longest)
                high[j] = min(limits[1, j] - here[j], longest)
            for j in range(5):
                slope[j] = gradient[j] if moved[j] else 0.0
                for k in range(5):
                    bend[j, k] = information[j, k] if moved[j] and moved[k] else 0.0
            _scoring_step(slope, bend, damping, room, step)
            # what would go too far stops there, and the others go on from that
            stopped = False
            for j in range(5):
                stops[j] = step[j] < low[j] or step[j] > high[j]
                stopped |= stops[j]
            if stopped:
                for j in range(5):
                    trial[j] = min(max(step[j], low[j]), high[j]) if stops[j] else 0.0
                for j in range(5):
                    left[j] = slope[j]
                    for k in range(5):
                        left[j] += bend[j, k] * trial[k]
                        later[j, k] = 0.0 if stops[j] or stops[k] else bend[j, k]
                    if stops[j]:
                        left[j] = 0.0
                _scoring_step(left, later, damping, room, step)
                for j in range(5):
                    step[j] += trial[j]
            promise = 0.0
            for j in range(5):
                step[j] = min(max(step[j], low[j]), high[j])
            for j in range(5):
                promise -= slope[j] * step[j]
                for k in range(5):
                    promise -= 0.5 * step[j] * bend[j, k] * step[k]
            if not promise > enough:
                break
            for j in range(5):
                trial[j] = min(max(here[j] + step[j], limits[0, j]), limits[1, j]) if free[place, j] else here[j]
            other = _cost_of_roll_off(trial, frequency, gain, background, density, weight, after, later)
            if other < cost:
                here[:], gradient[:], information[:], cost = trial, after, later, other
                damping /= 10
            else:
                damping *= 10
        costs[place] = cost
    return costs
