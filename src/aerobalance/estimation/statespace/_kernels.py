"""Compiled loops of the Kalman filter and the fixed-interval smoother: SI numbers and arrays, nothing checked.

A time-invariant state space x[k+1] = A x[k] + w with one observation a sample, y[k] = h x[k] + v. The gain does not
depend on the observations, so that it is computed once, frozen where it has converged, and computed anew after a
missing observation. All loops use four steps: `update_covariance`, `predict_covariance`, `filter_state` and
`add_product`; `aerobalance.estimation.live._live_kernels` uses the same.

Loops over the elements are written out where numpy would be shorter: the compiler needs seconds for each copy of a
slice. It keeps its work on disk by the file of each function: after a change of these four steps touch the file of the
live kernels too. ``tests/test_kernels.py`` compares compiled and plain results, and finds machine code that is old.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Model(NamedTuple):
    """The state space x[k+1] = A x[k] + w, y[k] = h x[k] + v.

    Attributes
    ----------
    A
        State transition over one sample, shape (d, d).
    columns
        The columns of A one after the other, which is its transpose, shape (d, d).
    Q
        Covariance of the process noise w, shape (d, d).
    h
        Observation row, shape (d,).
    R
        Variance of the observation noise v.
    """

    A: Floats
    columns: Floats
    Q: Floats
    h: Floats
    R: float


class Gains(NamedTuple):
    """Covariances and gains of the filter; samples at which they are the same share a row.

    Attributes
    ----------
    row
        Row of the tables below that each sample uses, shape (n,).
    P
        Leading rows of the covariance of the predicted state, shape (m, kept, d).
    K
        Gain, zero where the observation is missing, shape (m, d).
    S
        Variance of the innovation, shape (m,).
    """

    row: Integers
    P: Floats
    K: Floats
    S: Floats


@numba.njit(cache=True, inline="always")
def add_product(columns: Floats, x: Floats, out: Floats) -> None:
    """Add the product of a matrix, given by its columns, and a vector to a vector."""
    for j in range(x.size):  # column by column, so that the inner loop is one vector operation
        for i in range(out.size):
            out[i] += columns[j, i] * x[j]


@numba.njit(cache=True, inline="always")
def filter_state(value: float, here: bool, model: Model, K: Floats, x: Floats, updated: Floats) -> float:
    """Update a predicted state x by an observation and predict the next; return the innovation, 0 if it is missing."""
    for i in range(x.size):
        updated[i] = x[i]
    v = 0.0
    if here:
        v = value
        for i in range(x.size):
            v -= model.h[i] * x[i]
        for i in range(x.size):
            updated[i] += K[i] * v
    for i in range(x.size):
        x[i] = 0.0
    add_product(model.columns, updated, x)
    return v


@numba.njit(cache=True)
def update_covariance(P: Floats, h: Floats, Ph: Floats, K: Floats, R: float) -> None:
    """Turn P into (1 - K h) P (1 - K h)' + R K K', given P h'.

    This is the Joseph form, one factor after the other: the variance stays positive however small R is.
    """
    for i in range(h.size):
        across = 0.0
        for j in range(h.size):
            P[i, j] -= K[i] * Ph[j]
            across += P[i, j] * h[j]
        for j in range(h.size):
            P[i, j] += (R * K[i] - across) * K[j]


@numba.njit(cache=True)
def predict_covariance(A: Floats, columns: Floats, P: Floats, half: Floats, out: Floats) -> None:
    """Write A P A' into out."""
    np.dot(A, P, half)
    np.dot(half, columns, out)
    for i in range(A.shape[0]):
        for j in range(i):
            out[i, j] = 0.5 * (out[i, j] + out[j, i])
            out[j, i] = out[i, j]


@numba.njit(cache=True)
def filter_covariance(here: bool, model: Model, kept: int, P: Floats, K: Floats, work: Floats) -> tuple[float, float]:
    """Compute the gain K of a sample and turn its covariance P into that of the next sample.

    Parameters
    ----------
    here : bool
        False if the observation is missing.
    kept : int
        Number of leading rows of the covariance that have to settle, with that of the observation.
    work : (3, d, d)
        Room for intermediate results.

    Returns
    -------
    S : float
        Variance of the innovation.
    change : float
        Largest change of the correlations in these rows.
    """
    h, d = model.h, model.h.size
    updated, half, following = work[0], work[1], work[2]
    Ph = np.zeros(d)
    add_product(P, h, Ph)
    S = model.R
    for i in range(d):
        S += h[i] * Ph[i]
    for i in range(d):
        K[i] = Ph[i] / S if here else 0.0
        for j in range(d):
            updated[i, j] = P[i, j]
    if here:
        update_covariance(updated, h, Ph, K, model.R)
    predict_covariance(model.A, model.columns, updated, half, following)
    for i in range(d):
        for j in range(d):
            following[i, j] += model.Q[i, j]
    change = 0.0
    for i in range(kept):
        for j in range(d):
            scale = np.sqrt(following[i, i] * following[j, j]) + 1e-300
            change = max(change, abs(following[i, j] - P[i, j]) / scale)
    # an observation that shows more than the first state has to settle as a whole
    next_Ph = np.zeros(d)
    add_product(following, h, next_Ph)
    variance = 0.0
    for i in range(d):
        variance += h[i] * next_Ph[i]
    for i in range(d):
        scale = np.sqrt(variance * following[i, i]) + 1e-300
        change = max(change, abs(next_Ph[i] - Ph[i]) / scale)
        for j in range(d):
            P[i, j] = following[i, j]
    return S, change


@numba.njit(cache=True)
def _resized(table: Floats, rows: int) -> Floats:
    """Copy the first rows of a table into one of another length."""
    out = np.empty((rows, table.shape[1]))
    for i in range(min(rows, table.shape[0])):
        for j in range(table.shape[1]):
            out[i, j] = table[i, j]
    return out


@numba.njit(cache=True)
def gains(
    present: Flags, model: Model, initial: Floats, kept: int, tolerance: float
) -> tuple[Integers, Floats, Floats, Floats]:
    """Compute covariances and gains of the filter.

    Parameters
    ----------
    present : (n,)
        False where the observation is missing.
    initial : (d, d)
        Covariance of the first state before its observation.
    kept : int
        Number of leading rows of the covariance that are kept and that have to settle.
    tolerance : float
        Change of their correlations in one sample at which the gain is frozen.

    Returns
    -------
    row, P, K, S
        The attributes of `Gains`, in the shapes (n,), (m, kept d), (m, d) and (m, 1).
    """
    d = model.h.size
    row = np.empty(present.size, np.int64)
    table_P, table_K, table_S = np.empty((64, kept * d)), np.empty((64, d)), np.empty((64, 1))
    P, work = _resized(initial, d), np.empty((3, d, d))
    used = 0
    frozen = False
    for k in range(present.size):
        if not (frozen and present[k]):
            if used == table_S.size:
                table_P = _resized(table_P, 2 * used)
                table_K = _resized(table_K, 2 * used)
                table_S = _resized(table_S, 2 * used)
            for i in range(kept):
                for j in range(d):
                    table_P[used, i * d + j] = P[i, j]
            S, change = filter_covariance(present[k], model, kept, P, table_K[used], work)
            table_S[used, 0] = S
            frozen = present[k] and change < tolerance
            used += 1
        row[k] = used - 1
    return row, _resized(table_P, used), _resized(table_K, used), _resized(table_S, used)


@numba.njit(cache=True)
def filtered(y: Floats, present: Flags, model: Model, gains: Gains, wanted: Integers) -> tuple[Floats, Floats]:
    """Run the filter on several series (n, c), each from a zero state.

    Returns
    -------
    predicted : (n, c, w)
        The wanted states as predicted from the observations before.
    v : (n, c)
        Innovations, 0 where an observation is missing.
    """
    n, c = y.shape
    predicted, v = np.empty((n, c, wanted.size)), np.empty((n, c))
    x, updated = np.zeros((c, model.h.size)), np.empty(model.h.size)
    for k in range(n):
        K = gains.K[gains.row[k]]
        for series in range(c):
            for i in range(wanted.size):
                predicted[k, series, i] = x[series, wanted[i]]
            v[k, series] = filter_state(y[k, series], present[k], model, K, x[series], updated)
    return predicted, v


@numba.njit(cache=True)
def smooth(states: Floats, v: Floats, present: Flags, model: Model, gains: Gains, wanted: Integers) -> None:
    """Turn the predicted states of `filtered` into states given all observations.

    The adjoint recursion of [deJong1989]_ (Bryson and Frazier): with r zero after the last sample, r <- A' r, then
    r <- (1 - K h)' r + h' v / S where there is an observation, and the state is the predicted one plus P r. No
    covariance is inverted.
    """
    n, c = v.shape
    h, d = model.h, model.h.size
    r, before = np.zeros((c, d)), np.empty(d)
    for k in range(n - 1, -1, -1):
        w = gains.row[k]
        for series in range(c):
            for i in range(d):
                before[i] = 0.0
            add_product(model.A, r[series], before)
            if present[k]:
                weight = v[k, series] / gains.S[w]
                for i in range(d):
                    weight -= gains.K[w, i] * before[i]
                for i in range(d):
                    before[i] += h[i] * weight
            for i in range(wanted.size):
                for j in range(d):
                    states[k, series, i] += gains.P[w, wanted[i], j] * before[j]
            for i in range(d):
                r[series, i] = before[i]


@numba.njit(cache=True)
def smoothed_variance(present: Flags, model: Model, gains: Gains, wanted: int, tolerance: float) -> Floats:
    """Compute the variance of one state given all observations, shape (n,).

    P - P N P' with the covariance N of the adjoint state r of `smooth`, which is frozen where it has converged.
    """
    n, d = present.size, model.h.size
    variance = np.empty(n)
    N, work = np.zeros((d, d)), np.empty((2, d, d))
    following = work[1]
    last = -1
    frozen = False
    for k in range(n - 1, -1, -1):
        w = gains.row[k]
        same = w == last
        last = w
        if frozen and same:
            variance[k] = variance[k + 1]
            continue
        predict_covariance(model.columns, model.A, N, work[0], following)
        if present[k]:
            # the recursion of r has h' in the place of the gain and K' in that of the observation row
            NK = np.zeros(d)
            add_product(following, gains.K[w], NK)
            update_covariance(following, gains.K[w], NK, model.h, 1 / gains.S[w])
        change = 0.0
        for i in range(d):
            for j in range(i + 1):
                scale = following[i, i] * following[j, j] + 1e-300
                change = max(change, (following[i, j] - N[i, j]) ** 2 / scale)
        explained = 0.0
        for i in range(d):
            across = 0.0
            for j in range(d):
                N[i, j] = following[i, j]
                across += N[i, j] * gains.P[w, wanted, j]
            explained += gains.P[w, wanted, i] * across
        frozen = same and change < tolerance**2
        variance[k] = max(gains.P[w, wanted, wanted] - explained, 0.0)
    return variance


@numba.njit(cache=True)
def simulate(columns: Floats, root: Floats, first: Floats, normals: Floats, wanted: Integers) -> Floats:
    """Run a state space from a first state (d,), driven by white noise; the wanted states, shape (n, w).

    Transition and root of the process noise are given by their columns, (d, d) each; normals (n, d) drive it.
    """
    n, d = normals.shape
    out = np.empty((n, wanted.size))
    x, following = np.empty(d), np.empty(d)
    for i in range(d):
        x[i] = first[i]
    for k in range(n):
        for i in range(wanted.size):
            out[k, i] = x[wanted[i]]
        for i in range(d):
            following[i] = 0.0
        add_product(columns, x, following)
        add_product(root, normals[k], following)
        for i in range(d):
            x[i] = following[i]
    return out
