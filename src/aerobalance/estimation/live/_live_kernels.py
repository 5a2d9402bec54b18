"""Compiled loops of the live Kalman filter and its fixed-lag smoother: SI numbers and arrays, nothing checked.

Several series run through one filter: the observations first, then the known shapes whose sizes are free (the
constant, responses to steps). Buffers keep what a sample leaves behind, and samples are counted from their start.

The arrays in the tuples below are changed in place.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.statespace._kernels import Model, filter_covariance, filter_state
from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

NOTHING, STEP, STRANGE = 0, 1, 2
"""Why `advance` stopped: it came to the end; a step is likely; the observations are not explained."""

FAST_CHANGE = 1e-5
"""Change of the covariance's correlations in one sample above which every sample has weights of its own."""

HOLD = 16
"""Samples that share their weights while the gain still changes slowly."""

FOREVER = 1 << 60
"""Number of a sample that never comes."""

MARKS: Final = np.dtype(
    [
        ("series", np.int64),  # series in use: the observations and the known shapes
        ("taken", np.int64),  # samples taken since the filter was started
        ("phase", np.int64),  # number of the first sample of the buffers in the whole stream, modulo `HOLD`
        ("frozen", np.bool_),  # whether the gain has converged
        ("S", np.float64),  # variance of the last innovation
        ("unsteady", np.int64),  # last sample at which the gain had not converged
        ("fast", np.int64),  # last sample at which it changed by more than `FAST_CHANGE`
        ("held", np.int64),  # last sample for which the weights of `FixedLag` hold
        ("expected", np.int64),  # samples taken at which the response to a step is computed again
        ("scanned", np.int64),  # first instant that is scanned for a step
        ("strange", np.int64),  # samples that have not been explained, without a break
    ],
    align=True,
)
"""Numbers that change while samples are taken: one record, `State.marks`."""


class State(NamedTuple):
    """The filter after the last sample taken.

    Attributes
    ----------
    marks
        One record of `MARKS`.
    x
        Predicted state of each series, shape (series, d).
    P
        Covariance of the predicted state, shape (d, d).
    K
        Gain of the last sample, shape (d,).
    inflation
        What the variances of the states grow by after missing observations, shape (d,).
    work
        Room for intermediate results, shape (3, d, d).
    """

    marks: Any
    x: Floats
    P: Floats
    K: Floats
    inflation: Floats
    work: Floats


class History(NamedTuple):
    """Buffers of n samples.

    Attributes
    ----------
    present
        Whether there is an observation, shape (n,).
    values
        Observations, and loads of the known shapes, shape (series, n).
    forces
        Forces of the known shapes, shape (shapes, n).
    v
        Innovations, 0 where an observation is missing, shape (series, n).
    predicted
        Force of each series as predicted from the samples before, shape (series, n).
    K, S
        Gain and innovation variance, shape (n, d) and (n,).
    P
        Row of the force in the covariance of the predicted state, shape (n, d).
    residual
        Innovations with the shapes taken out, over their standard deviation, shape (n,).
    score
        Product of the residuals and the response to a step at each instant, shape (n,).
    """

    present: Flags
    values: Floats
    forces: Floats
    v: Floats
    predicted: Floats
    K: Floats
    S: Floats
    P: Floats
    residual: Floats
    score: Floats


class ShapeFit(NamedTuple):
    """Recursive generalised least squares for the sizes of the known shapes.

    Attributes
    ----------
    information, target
        Matrix and right-hand side of the normal equations, shape (shapes, shapes) and (shapes,).
    sizes
        Their solution, shape (shapes,).
    root
        Cholesky factor of the matrix, shape (shapes, shapes).
    """

    information: Floats
    target: Floats
    sizes: Floats
    root: Floats


class FixedLag(NamedTuple):
    """The fixed-lag smoother.

    Attributes
    ----------
    lag
        Samples after which the force at a sample is final.
    wanted
        Place of the force in the state.
    tolerance
        Change of the covariance's correlations in one sample at which the gain is frozen.
    weight
        Weights of the innovations from a sample on in its force, shape (lag + 1,).
    variance
        Variance of the force that is left after each of them, shape (lag + 1,).
    out
        Force and its variance, final where the lag has passed, shape (n, 2).
    """

    lag: int
    wanted: int
    tolerance: float
    weight: Floats
    variance: Floats
    out: Floats


class LiveScan(NamedTuple):
    """The matched filter for a step, and the test whether the observations are explained.

    Attributes
    ----------
    step
        Balance load 1, 2, ... samples after a force of 1 N sets in, shape (s,).
    response, inverse
        That load whitened with the last gain, and the inverse of its sum of squares, the oldest age first, shape (s,).
    threshold
        Gain in twice the log-likelihood above which a step is likely.
    youngest
        Samples after which a step may be found.
    strange
        Sum of squared residuals over the window above which they are not explained.
    window
        Samples that are summed for that.
    patience
        Samples for which they have to be so without a break.
    """

    step: Floats
    response: Floats
    inverse: Floats
    threshold: float
    youngest: int
    strange: float
    window: int
    patience: int


@compiled()
def solve(fit: ShapeFit, count: int) -> None:
    """Solve the normal equations of so many shapes by Cholesky's method."""
    information, target, sizes, root = fit.information, fit.target, fit.sizes, fit.root
    for i in range(count):
        for j in range(i + 1):
            left = information[i, j]
            for m in range(j):
                left -= root[i, m] * root[j, m]
            if i == j:
                # a shape that the observations do not show yet keeps the size zero
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


@compiled(inner=True)
def variance_along(root: Floats, slope: Floats, count: int, work: Floats) -> float:
    """Return the variance of a sum of the sizes with these weights."""
    total = 0.0
    for i in range(count):
        left = slope[i]
        for m in range(i):
            left -= root[i, m] * work[m]
        work[i] = left / root[i, i]
        total += work[i] ** 2
    return total


@compiled(inner=True)
def _weigh(k: int, last: int, count: int, model: Model, history: History, fixed: FixedLag) -> None:
    """Compute what each innovation from sample k on adds to the force at k, and its variance with each lag.

    The covariance of that force with all states goes the way of an error: as the states of a series of observations
    that are zero. Beyond the last sample taken the gain is held.
    """
    d = model.h.size
    m, updated = np.empty(d), np.empty(d)
    for i in range(d):
        m[i] = history.P[k, i]
    left = m[fixed.wanted]
    for j in range(count):
        n = min(k + j, last)
        across = filter_state(0.0, history.present[n], model, history.K[n], m, updated)
        fixed.weight[j] = -across / history.S[n]
        left -= across * across / history.S[n]
        fixed.variance[j] = max(left, 0.0)


@compiled(fastmath={"reassoc", "nsz", "contract"}, inner=True)
def _weighted_sum(weight: Floats, v: Floats, series: int, k: int, count: int) -> float:
    """Return the sum of the innovations of a series from sample k on, with their weights."""
    total, own = 0.0, v[series, k : k + count]  # a number that may be below zero keeps the compiler from vectors
    for j in range(own.size):
        total += weight[j] * own[j]
    return total


@compiled()
def emit(k: int, end: int, model: Model, state: State, history: History, fit: ShapeFit, fixed: FixedLag) -> None:
    """Compute the force at sample k, and its variance, from the observations up to sample end."""
    marks = state.marks[0]
    count = end - k + 1
    if k <= marks.fast:
        _weigh(k, end, count, model, history, fixed)
        marks.held = -1
    elif k > marks.held:
        _weigh(k, end, fixed.weight.size, model, history, fixed)
        marks.held = FOREVER if k > marks.unsteady else k + HOLD - 1 - (k + marks.phase) % HOLD
    shapes = marks.series - 1
    slope, work = np.empty(shapes), np.empty(shapes)
    force = 0.0
    for s in range(shapes + 1):  # one call, as the compiler makes a function anew for a number that is written out
        smoothed = history.predicted[s, k] + _weighted_sum(fixed.weight, history.v, s, k, count)
        if s == 0:
            force += smoothed
        else:
            slope[s - 1] = history.forces[s - 1, k] - smoothed
            force += fit.sizes[s - 1] * slope[s - 1]
    fixed.out[k, 0] = force
    fixed.out[k, 1] = fixed.variance[count - 1] + variance_along(fit.root, slope, shapes, work)


@compiled(inline="always")
def _expect_step(model: Model, K: Floats, S: float, scan: LiveScan) -> None:
    """Whiten the response to a step with this gain."""
    x, updated = np.zeros(model.h.size), np.empty(model.h.size)
    total = 0.0
    for j in range(scan.step.size):
        place = scan.step.size - 1 - j
        scan.response[place] = filter_state(scan.step[j], True, model, K, x, updated) / np.sqrt(S)
        total += scan.response[place] ** 2
        scan.inverse[place] = 1 / total if total > 0 else 0.0


@compiled(inline="always")
def _take_gain(n: int, model: Model, state: State, history: History, fixed: FixedLag, scan: LiveScan) -> None:
    """Find gain and innovation variance of sample n, and predict the covariance of the next."""
    marks, K = state.marks[0], state.K
    here = history.present[n]
    if here and n > 0 and not history.present[n - 1]:
        for i in range(K.size):
            state.P[i, i] += state.inflation[i]
    for i in range(K.size):
        history.P[n, i] = state.P[fixed.wanted, i]
    if not (marks.frozen and here):
        marks.S, change = filter_covariance(here, model, fixed.wanted + 1, state.P, K, state.work)
        marks.unsteady = n
        if marks.held == FOREVER:
            marks.held = -1
        if change > FAST_CHANGE or not here:
            marks.fast = n
        marks.frozen = here and change < fixed.tolerance
        if here and (marks.taken >= marks.expected or marks.frozen):
            marks.expected = 2 * marks.taken
            _expect_step(model, K, marks.S, scan)
    for i in range(K.size):
        history.K[n, i] = K[i]
    history.S[n] = marks.S
    marks.taken += 1


@compiled(inline="always")
def _take_observation(n: int, shapes: int, history: History, fit: ShapeFit, shown: Floats, work: Floats) -> None:
    """Find the residual of sample n, and the sizes of the shapes with it."""
    v, S = history.v, history.S[n]
    history.residual[n] = 0.0
    if not history.present[n]:
        return
    # recursive residual: what the observations before did not tell, white with variance 1
    left = v[0, n]
    for s in range(shapes):
        shown[s] = v[s + 1, n]
        left -= fit.sizes[s] * v[s + 1, n]
    history.residual[n] = left / np.sqrt(S + variance_along(fit.root, shown, shapes, work))
    for s in range(shapes):
        fit.target[s] += v[0, n] * v[s + 1, n] / S
        for other in range(shapes):
            fit.information[s, other] += v[s + 1, n] * v[other + 1, n] / S
    solve(fit, shapes)


@compiled()
def advance(
    first: int,
    stop: int,
    final: int,
    model: Model,
    state: State,
    history: History,
    fit: ShapeFit,
    fixed: FixedLag,
    scan: LiveScan,
) -> tuple[int, int]:
    """Take samples from first up to stop, until something happens; the force is computed from sample final on.

    Return the sample after the last one taken, and what happened; the force that becomes final by that last sample
    is then left to the caller.
    """
    series = state.marks[0].series
    updated, work, shown = np.empty(model.h.size), np.empty(series), np.empty(series)
    for n in range(first, stop):
        _take_gain(n, model, state, history, fixed, scan)
        here = history.present[n]
        for s in range(series):
            history.predicted[s, n] = state.x[s, fixed.wanted]
            history.v[s, n] = filter_state(history.values[s, n], here, model, state.K, state.x[s], updated)
        _take_observation(n, series - 1, history, fit, shown, work)
        happened = _look(n, state, history, scan)
        if happened != NOTHING:
            return n + 1, happened
        if n - fixed.lag >= final:
            emit(n - fixed.lag, n, model, state, history, fit, fixed)
    return stop, NOTHING


@compiled(fastmath={"reassoc", "nsz", "contract", "nnan"}, inner=True)
def _scan_instants(
    score: Floats, response: Floats, inverse: Floats, u: float, begin: int, stop: int, offset: int, newest: int
) -> float:
    """Add a residual to the scores of instants; return the largest gain in likelihood but for the newest instants."""
    scores = score[begin:stop]  # a number that may be below zero keeps the compiler from vectors
    responses, inverses = response[begin + offset : stop + offset], inverse[begin + offset : stop + offset]
    for n in range(scores.size):
        scores[n] += u * responses[n]
    best = 0.0
    for n in range(scores.size - newest):
        best = max(best, scores[n] * scores[n] * inverses[n])
    return best


@compiled(fastmath={"reassoc", "nsz", "contract", "nnan"}, inner=True)
def _squares(residual: Floats, begin: int, stop: int) -> tuple[float, float]:
    """Return the sum of squares, and the largest of them."""
    total, largest, own = 0.0, 0.0, residual[begin:stop]
    for n in range(own.size):
        total += own[n] * own[n]
        largest = max(largest, own[n] * own[n])
    return total, largest


@compiled(inline="always")
def _look(n: int, state: State, history: History, scan: LiveScan) -> int:
    """Look for a step and for observations that are not explained, now that sample n is there."""
    marks, residual = state.marks[0], history.residual
    length = scan.response.size
    begin = max(marks.scanned, n - length + 1)
    history.score[n] = 0.0
    if begin <= n:
        best = _scan_instants(
            history.score, scan.response, scan.inverse, residual[n], begin, n + 1, length - 1 - n, scan.youngest
        )
        # of a single observation: a stray one is no step
        if best > scan.threshold and best - _squares(residual, begin, n + 1)[1] > scan.threshold:
            return STEP
    total, largest = _squares(residual, max(n - scan.window + 1, marks.scanned, 0), n + 1)
    marks.strange = marks.strange + 1 if total - largest > scan.strange else 0
    return STRANGE if marks.strange > scan.patience else NOTHING


@compiled()
def rebuild(
    first: int, stop: int, place: int, model: Model, state: State, history: History, fit: ShapeFit, wanted: int
) -> None:
    """Run one known shape, zero before sample first, through the gains of the samples taken and into the equations."""
    v, shapes = history.v, state.marks[0].series - 1
    updated = np.empty(model.h.size)
    for i in range(model.h.size):
        state.x[place, i] = 0.0
    for n in range(first):
        v[place, n] = history.predicted[place, n] = 0.0
    row = place - 1
    for s in range(shapes):
        fit.information[row, s] = fit.information[s, row] = 0.0
    fit.target[row] = 0.0
    for n in range(first, stop):
        here, S = history.present[n], history.S[n]
        history.predicted[place, n] = state.x[place, wanted]
        v[place, n] = filter_state(history.values[place, n], here, model, history.K[n], state.x[place], updated)
        if here:
            fit.target[row] += v[0, n] * v[place, n] / S
            for s in range(shapes):
                fit.information[row, s] += v[place, n] * v[s + 1, n] / S
    for s in range(shapes):
        fit.information[s, row] = fit.information[row, s]


@compiled()
def innovate(first: int, values: Floats, model: Model, history: History) -> Floats:
    """Return the innovations of a load that begins at sample first, shape (values,)."""
    x, updated, v = np.zeros(model.h.size), np.empty(model.h.size), np.empty(values.size)
    for j in range(values.size):
        n = first + j
        v[j] = filter_state(values[j], history.present[n], model, history.K[n], x, updated)
    return v
