"""The slow, obvious smoother: filter and adjoint recursion sample by sample, as an oracle for the fast one.

The covariance follows its Riccati equation at every sample until it stands still to `TOLERANCE`, and again after every
gap.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aerobalance.estimation.statespace._kernels import (
    Flags,
    Floats,
    Integers,
    Model,
    add_product,
    filter_covariance,
    filter_state,
    predict_covariance,
    update_covariance,
)
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, LOAD_RATE, StateSpace
from aerobalance.recording.compiled import compiled

TOLERANCE = 1e-13
"""Relative change of the covariance in one sample below which it is taken to stand still."""


class SlowSmoother:
    """What `KalmanFilter` is, the obvious way."""

    def __init__(self, system: StateSpace, present: np.ndarray, *, tolerance: float = TOLERANCE) -> None:
        self.model, self.present, self.tolerance = system.model, present, tolerance
        size = self.model.h.size
        row, P, K, S = gains(present, self.model, system.initial, size, tolerance)
        self.gains = Gains(row, P.reshape(S.size, size, size), K, S[:, 0])

    def whiten(self, series: np.ndarray) -> np.ndarray:
        _, innovations = filtered(
            np.ascontiguousarray(series), self.present, self.model, self.gains, np.zeros(0, np.int64)
        )
        return innovations / np.sqrt(self.gains.S[self.gains.row])[:, None]

    def smooth(self, series: np.ndarray, wanted: tuple[int, ...] = (LOAD, LOAD_RATE, FORCE)) -> np.ndarray:
        places = np.array(wanted, dtype=np.int64)
        states, v = filtered(np.ascontiguousarray(series), self.present, self.model, self.gains, places)
        smooth(states, v, self.present, self.model, self.gains, places)
        return states

    @property
    def smoothed_variance(self) -> np.ndarray:
        return smoothed_variance(self.present, self.model, self.gains, FORCE, self.tolerance)

    @property
    def log_determinant(self) -> float:
        return float(np.sum(np.log(self.gains.S[self.gains.row[self.present]])))


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


@compiled()
def _resized(table: Floats, rows: int) -> Floats:
    """Copy the first rows of a table into one of another length."""
    out = np.empty((rows, table.shape[1]))
    for i in range(min(rows, table.shape[0])):
        for j in range(table.shape[1]):
            out[i, j] = table[i, j]
    return out


@compiled()
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


@compiled()
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


@compiled()
def smooth(states: Floats, v: Floats, present: Flags, model: Model, gains: Gains, wanted: Integers) -> None:  # noqa: PLR0917
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


@compiled()
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
