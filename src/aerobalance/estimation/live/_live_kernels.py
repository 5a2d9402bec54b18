"""Compiled loops of the live filter and its smoother with a fixed lag: SI numbers and arrays, nothing checked.

Several series run through one filter: the readings first, then the known shapes whose sizes are free. A series of
buffers holds what a sample leaves behind, one column a sample; places are counted from the start of the buffers.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

NOTHING, STEP, STRANGE = 0, 1, 2
"""Why `advance` stopped: it came to the end; a step is likely; the readings are not explained."""

FROZEN, UNSTEADY, FAST, HELD, SCANNED, STRANGE_FOR, AGE, EXPECTED = 0, 1, 2, 3, 4, 5, 6, 7
"""Places in the array of counters: whether the gain is frozen; the last sample where it was not, and the last where it
changed fast; the last sample for which the table of weights holds; the first instant that is scanned for a step;
samples that have been strange without a break; samples taken; and how many of them there have to be before the
response to a step is worked out again."""

FAST_CHANGE = 1e-5
"""Change of the covariance's correlations in one sample above which every sample has weights of its own."""

HOLD = 16
"""Samples that share their weights while the gain still changes slowly."""

FOREVER = 1 << 60


@numba.njit(cache=True)
def _next_gain(
    here: bool, A: Floats, columns: Floats, Q: Floats, h: Floats, R: float, P: Floats, K: Floats, kept: int
) -> tuple[float, float]:
    """Gain of one sample into K, covariance P carried to the next; innovation variance and relative change of P."""
    d = h.size
    Ph = np.zeros(d)
    S = R
    for i in range(d):
        for j in range(d):
            Ph[i] += P[i, j] * h[j]
        S += h[i] * Ph[i]
    for i in range(d):
        K[i] = Ph[i] / S if here else 0.0
    updated = np.empty((d, d))
    # Joseph form, one factor after the other, as in aerobalance.estimation.statespace._kernels.gains
    for i in range(d):
        across = 0.0
        for j in range(d):
            updated[i, j] = P[i, j] - K[i] * Ph[j]
            across += updated[i, j] * h[j]
        for j in range(d):
            updated[i, j] += (R * K[i] - across) * K[j]
    # written out: the compiler takes seconds over products of arrays
    across_A = np.zeros((d, d))
    following = np.empty((d, d))
    for i in range(d):
        for m in range(d):
            for j in range(d):
                across_A[i, j] += A[i, m] * updated[m, j]
    for i in range(d):
        for j in range(d):
            following[i, j] = Q[i, j]
        for m in range(d):
            for j in range(d):
                following[i, j] += across_A[i, m] * columns[m, j]
    for i in range(d):
        for j in range(i):
            following[i, j] = 0.5 * (following[i, j] + following[j, i])
            following[j, i] = following[i, j]
    change = 0.0
    for i in range(d):
        for j in range(d):
            if i < kept:
                scale = np.sqrt(following[i, i] * following[j, j]) + 1e-300
                change = max(change, abs(following[i, j] - P[i, j]) / scale)
            P[i, j] = following[i, j]
    return S, change


@numba.njit(cache=True)
def _next_state(value: float, here: bool, columns: Floats, h: Floats, K: Floats, x: Floats, updated: Floats) -> float:
    """Carry one series' state over one sample; its innovation, 0 where the reading is missing."""
    d = h.size
    for i in range(d):  # not updated[:] = x, which the compiler takes seconds over
        updated[i] = x[i]
    v = 0.0
    if here:
        v = value
        for i in range(d):
            v -= h[i] * x[i]
        for i in range(d):
            updated[i] += K[i] * v
    x[:] = 0.0
    for j in range(d):  # column by column, so that the inner loop is one vector operation
        for i in range(d):
            x[i] += columns[j, i] * updated[j]
    return v


@numba.njit(cache=True)
def solve(information: Floats, target: Floats, count: int, sizes: Floats, root: Floats) -> None:
    """Sizes of the known shapes from their normal equations, by Cholesky; the factor is left in root."""
    for i in range(count):
        for j in range(i + 1):
            left = information[i, j]
            for m in range(j):
                left -= root[i, m] * root[j, m]
            if i == j:
                # a shape that the readings do not show yet keeps the size zero
                root[i, i] = np.sqrt(left) if left > 1e-12 * information[i, i] else 1e150
            else:
                root[i, j] = left / root[j, j]
    for i in range(count):
        left = target[i]
        for m in range(i):
            left -= root[i, m] * sizes[m]
        sizes[i] = left / root[i, i]
    for i in range(count - 1, -1, -1):
        left = sizes[i]
        for m in range(i + 1, count):
            left -= root[m, i] * sizes[m]
        sizes[i] = left / root[i, i]


@numba.njit(cache=True)
def spread(root: Floats, slope: Floats, count: int, work: Floats) -> float:
    """Variance of a sum of the sizes with these weights."""
    total = 0.0
    for i in range(count):
        left = slope[i]
        for m in range(i):
            left -= root[i, m] * work[m]
        work[i] = left / root[i, i]
        total += work[i] ** 2
    return total


@numba.njit(cache=True)
def _weigh(
    k: int,
    last: int,
    count: int,
    wanted: int,
    columns: Floats,
    h: Floats,
    present: Flags,
    gain_K: Floats,
    gain_S: Floats,
    gain_row: Floats,
    weight: Floats,
    variance: Floats,
) -> None:
    """What each innovation from k on adds to the wanted state at k, and its variance with each lag, into the tables.

    The covariance of that state with all states goes the way of an error: as the states of a series of readings that
    are zero. Beyond the last sample taken the gain is held.
    """
    m, updated = gain_row[k].copy(), np.empty(h.size)
    left = m[wanted]
    for j in range(count):
        n = min(k + j, last)
        across = _next_state(0.0, present[n], columns, h, gain_K[n], m, updated)
        weight[j] = -across / gain_S[n]
        left -= across * across / gain_S[n]
        variance[j] = max(left, 0.0)


@numba.njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _weighed(weight: Floats, v: Floats, series: int, k: int, count: int) -> float:
    """Sum of the innovations of a series from k on, with their weights."""
    total = 0.0
    for j in range(count):
        total += weight[j] * v[series, k + j]
    return total


@numba.njit(cache=True)
def emit(
    k: int,
    end: int,
    phase: int,
    wanted: int,
    series: int,
    columns: Floats,
    h: Floats,
    present: Flags,
    shapes: Floats,
    v: Floats,
    ahead: Floats,
    gain_K: Floats,
    gain_S: Floats,
    gain_row: Floats,
    weight: Floats,
    variance: Floats,
    counters: Integers,
    sizes: Floats,
    root: Floats,
) -> tuple[float, float]:
    """Force at sample k from the readings up to sample end, and its variance."""
    count = end - k + 1
    if k <= counters[FAST]:
        _weigh(k, end, count, wanted, columns, h, present, gain_K, gain_S, gain_row, weight, variance)
        counters[HELD] = -1
    elif k > counters[HELD]:
        _weigh(k, end, weight.size, wanted, columns, h, present, gain_K, gain_S, gain_row, weight, variance)
        counters[HELD] = FOREVER if k > counters[UNSTEADY] else k + HOLD - 1 - (k + phase) % HOLD
    slope, work = np.empty(series - 1), np.empty(series - 1)
    force = 0.0
    for s in range(series):  # one call, as the compiler makes a function anew for a number that is written out
        told = ahead[s, k] + _weighed(weight, v, s, k, count)
        if s > 0:
            slope[s - 1] = shapes[s - 1, k] - told
        force += sizes[s - 1] * slope[s - 1] if s > 0 else told
    return force, variance[count - 1] + spread(root, slope, series - 1, work)


@numba.njit(cache=True)
def _expect_step(
    columns: Floats, h: Floats, K: Floats, S: float, step: Floats, response: Floats, inverse: Floats
) -> None:
    """Whitened response to a step with this gain, and the inverse of what it tells at each age, the oldest first."""
    x, updated = np.zeros(h.size), np.empty(h.size)
    total = 0.0
    for j in range(step.size):
        place = step.size - 1 - j
        response[place] = _next_state(step[j], step.size > 0, columns, h, K, x, updated) / np.sqrt(S)
        total += response[place] ** 2
        inverse[place] = 1 / total if total > 0 else 0.0


@numba.njit(cache=True)
def advance(
    first: int,
    stop: int,
    lag: int,
    phase: int,
    wanted: int,
    tolerance: float,
    series: int,
    A: Floats,
    columns: Floats,
    Q: Floats,
    h: Floats,
    R: float,
    P: Floats,
    x: Floats,
    steady_K: Floats,
    steady_S: Floats,
    weight: Floats,
    variance: Floats,
    present: Flags,
    values: Floats,
    shapes: Floats,
    v: Floats,
    ahead: Floats,
    gain_K: Floats,
    gain_S: Floats,
    gain_row: Floats,
    residual: Floats,
    information: Floats,
    target: Floats,
    sizes: Floats,
    root: Floats,
    counters: Integers,
    scores: Floats,
    step: Floats,
    response: Floats,
    inverse: Floats,
    youngest: int,
    threshold: float,
    window: int,
    strange: float,
    patience: int,
    jolt: Floats,
    out_from: int,
    out: Floats,
) -> tuple[int, int]:
    """Take samples up to stop, each with the force that becomes final by it, until something happens.

    After missing readings the variances of the states grow by the jolt.

    Returns the sample after the last one taken, and what happened; the force that becomes final by that last sample
    is then left to the caller.
    """
    updated, work, shown = np.empty(h.size), np.empty(series), np.empty(series)
    for n in range(first, stop):
        here = present[n]
        if here and n > 0 and not present[n - 1]:
            for i in range(h.size):
                P[i, i] += jolt[i]
        for i in range(steady_K.size):  # row by row copies cost the compiler seconds
            gain_row[n, i] = P[wanted, i]
        if counters[FROZEN] and here:
            for i in range(steady_K.size):
                gain_K[n, i] = steady_K[i]
            S = steady_S[0]
        else:
            S, change = _next_gain(here, A, columns, Q, h, R, P, gain_K[n], wanted + 1)
            counters[UNSTEADY] = n
            if counters[HELD] == FOREVER:
                counters[HELD] = -1
            if change > FAST_CHANGE or not here:
                counters[FAST] = n
            counters[FROZEN] = here and change < tolerance
            for i in range(steady_K.size):
                steady_K[i] = gain_K[n, i]
            steady_S[0] = S
            if here and (counters[AGE] >= counters[EXPECTED] or counters[FROZEN]):
                counters[EXPECTED] = 2 * counters[AGE]
                _expect_step(columns, h, gain_K[n], S, step, response, inverse)
        gain_S[n] = S
        counters[AGE] += 1
        for s in range(series):
            ahead[s, n] = x[s, wanted]
            v[s, n] = _next_state(values[s, n], here, columns, h, gain_K[n], x[s], updated)
        residual[n] = 0.0
        if here:
            # recursive residual: what the readings before did not tell, white with variance 1
            left = v[0, n]
            for s in range(series - 1):
                shown[s] = v[s + 1, n]
                left -= sizes[s] * v[s + 1, n]
            residual[n] = left / np.sqrt(S + spread(root, shown, series - 1, work))
            for s in range(series - 1):
                target[s] += v[0, n] * v[s + 1, n] / S
                for other in range(series - 1):
                    information[s, other] += v[s + 1, n] * v[other + 1, n] / S
            solve(information, target, series - 1, sizes, root)
        happened = _look(
            n, counters, residual, scores, response, inverse, youngest, threshold, window, strange, patience
        )
        if happened != NOTHING:
            return n + 1, happened
        if n - lag >= out_from:
            out[n - lag, 0], out[n - lag, 1] = emit(
                n - lag, n, phase, wanted, series, columns, h, present, shapes, v, ahead, gain_K, gain_S, gain_row,
                weight, variance, counters, sizes, root,
            )  # fmt: skip
    return stop, NOTHING


@numba.njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _scan(
    scores: Floats, response: Floats, inverse: Floats, u: float, begin: int, stop: int, offset: int, newest: int
) -> float:
    """Add a residual to what speaks for instants, oldest first; the largest gain but for the newest instants."""
    best = 0.0
    for n in range(begin, stop):
        scores[n] += u * response[n + offset]
    for n in range(begin, stop - newest):
        gain = scores[n] * scores[n] * inverse[n + offset]
        best = gain if gain > best else best
    return best


@numba.njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _squares(residual: Floats, begin: int, stop: int) -> tuple[float, float]:
    """Sum of squares, and the largest of them."""
    total, largest = 0.0, 0.0
    for n in range(begin, stop):
        square = residual[n] * residual[n]
        total += square
        largest = square if square > largest else largest
    return total, largest


@numba.njit(cache=True)
def _look(
    n: int,
    counters: Integers,
    residual: Floats,
    scores: Floats,
    response: Floats,
    inverse: Floats,
    youngest: int,
    threshold: float,
    window: int,
    strange: float,
    patience: int,
) -> int:
    """Look for a step and for readings that are not explained, now that sample n is there."""
    since = counters[SCANNED]
    begin = max(since, n - response.size + 1)
    scores[n] = 0.0
    if begin <= n:
        best = _scan(scores, response, inverse, residual[n], begin, n + 1, response.size - 1 - n, youngest)
        # of a single reading: a stray one is no step
        if best > threshold and best - _squares(residual, begin, n + 1)[1] > threshold:
            return STEP
    total, largest = _squares(residual, max(n - window + 1, since, 0), n + 1)
    counters[STRANGE_FOR] = counters[STRANGE_FOR] + 1 if total - largest > strange else 0
    return STRANGE if counters[STRANGE_FOR] > patience else NOTHING


@numba.njit(cache=True)
def rebuild(
    first: int,
    stop: int,
    series: int,
    place: int,
    columns: Floats,
    h: Floats,
    x: Floats,
    wanted: int,
    present: Flags,
    values: Floats,
    v: Floats,
    ahead: Floats,
    gain_K: Floats,
    gain_S: Floats,
    information: Floats,
    target: Floats,
) -> None:
    """Run one known shape, zero before sample first, through the gains of the samples taken and into the equations."""
    updated = np.empty(h.size)
    for i in range(h.size):  # written out: the compiler takes long over slices
        x[place, i] = 0.0
    for n in range(first):
        v[place, n] = ahead[place, n] = 0.0
    row = place - 1
    for s in range(series - 1):
        information[row, s] = information[s, row] = 0.0
    target[row] = 0.0
    for n in range(first, stop):
        S = gain_S[n]
        ahead[place, n] = x[place, wanted]
        v[place, n] = _next_state(values[place, n], present[n], columns, h, gain_K[n], x[place], updated)
        if present[n]:
            target[row] += v[0, n] * v[place, n] / S
            for s in range(series - 1):
                information[row, s] += v[place, n] * v[s + 1, n] / S
    for s in range(series - 1):
        information[s, row] = information[row, s]


@numba.njit(cache=True)
def innovate(
    first: int, stop: int, columns: Floats, h: Floats, present: Flags, values: Floats, gain_K: Floats
) -> Floats:
    """Innovations of a shape that is zero before sample first, shape (stop - first,)."""
    x, updated, v = np.zeros(h.size), np.empty(h.size), np.empty(stop - first)
    for n in range(first, stop):
        v[n - first] = _next_state(values[n - first], present[n], columns, h, gain_K[n], x, updated)
    return v
