"""Compiled loops of the Kalman filter and the fixed-interval smoother: SI numbers and arrays, nothing checked.

A time-invariant state space x[k+1] = A x[k] + w with one observation a sample, y[k] = h x[k] + v. All loops use four
steps: `update_covariance`, `predict_covariance`, `filter_state` and `add_product`;
`aerobalance.estimation.live._live_kernels` uses the same.

Loops over the elements are written out where numpy would be shorter: the compiler needs seconds for each copy of a
slice. ``tests/test_kernels.py`` compares compiled and plain results.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

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


@compiled(inner=True, forceinline=True)
def add_product(columns: Floats, x: Floats, out: Floats) -> None:
    """Add the product of a matrix, given by its columns, and a vector to a vector."""
    for j in range(x.size):  # column by column, so that the inner loop is one vector operation
        for i in range(out.size):
            out[i] += columns[j, i] * x[j]


@compiled(inner=True, forceinline=True)
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


@compiled(inner=True)
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


@compiled(inner=True)
def predict_covariance(A: Floats, columns: Floats, P: Floats, half: Floats, out: Floats) -> None:
    """Write A P A' into out."""
    np.dot(A, P, half)
    np.dot(half, columns, out)
    for i in range(A.shape[0]):
        for j in range(i):
            out[i, j] = 0.5 * (out[i, j] + out[j, i])
            out[j, i] = out[i, j]


@compiled(inner=True)
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


@compiled(nogil=True)
def chain(columns: Floats, states: Floats, forward: bool) -> None:
    """Add to each state (c, m, d) of several series what a matrix makes of the one before it.

    The order is that of time, or the other way round. The matrix is given by its columns, and zeros that make their
    length a multiple of 16: what is beyond such a multiple is worked out one by one.
    """
    c, m, d = states.shape
    work = np.zeros(columns.shape[1])
    for k in range(1, m):
        place, before = (k, k - 1) if forward else (m - k - 1, m - k)
        for series in range(c):  # these do not wait for each other
            for i in range(d):
                work[i] = states[series, place, i]
            add_product(columns, states[series, before], work)
            for i in range(d):
                states[series, place, i] = work[i]
