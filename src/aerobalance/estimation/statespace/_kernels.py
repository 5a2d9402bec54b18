"""Compiled loops of the Kalman filter and smoother: SI numbers and arrays, nothing checked.

One observation a sample, y = h x + noise, of a time-invariant state x[k+1] = A x[k] + process noise. The gain does not
depend on the readings, so it is computed once and frozen where it has converged; missing samples thaw it.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@numba.njit(cache=True)
def gains(
    present: Flags, A: Floats, Q: Floats, h: Floats, R: float, P0: Floats, kept: int, tolerance: float
) -> tuple[Integers, Floats, Floats, Floats]:
    """Covariances and gains of the filter.

    Parameters
    ----------
    present : bool (n,)
        False where the reading is missing.
    A, Q : (d, d)
        State transition and process noise covariance over one sample.
    h : (d,)
        Observation row.
    R : float
        Variance of a reading.
    P0 : (d, d)
        Covariance of the first state before its reading.
    kept : int
        Number of leading rows of the covariance that are kept and that have to settle.
    tolerance : float
        Change of their correlations in one sample at which the gain is frozen.

    Returns
    -------
    which : int (n,)
        Row of the tables below that each sample uses.
    P : (m, kept, d)
        Leading rows of the covariances before the reading.
    K : (m, d)
        Gains; zero where the reading is missing.
    S : (m,)
        Variances of the innovation.
    """
    n, d = present.size, h.size
    which = np.empty(n, np.int64)
    room = 64
    table_P = np.empty((room, kept, d))
    table_K = np.empty((room, d))
    table_S = np.empty(room)
    P = P0.copy()
    Ph, K = np.empty(d), np.empty(d)
    updated, half, following = np.empty((d, d)), np.empty((d, d)), np.empty((d, d))
    columns = A.T.copy()
    used = 0
    frozen = False
    for k in range(n):
        if frozen and present[k]:
            which[k] = used - 1
            continue
        if frozen:
            frozen = False
        if used == room:
            room *= 2
            bigger_P = np.empty((room, kept, d))
            bigger_K = np.empty((room, d))
            bigger_S = np.empty(room)
            bigger_P[:used] = table_P[:used]
            bigger_K[:used] = table_K[:used]
            bigger_S[:used] = table_S[:used]
            table_P, table_K, table_S = bigger_P, bigger_K, bigger_S
        table_P[used] = P[:kept]
        S = R
        for i in range(d):
            Ph[i] = 0.0
            for j in range(d):
                Ph[i] += P[i, j] * h[j]
            S += h[i] * Ph[i]
        table_S[used] = S
        for i in range(d):
            K[i] = Ph[i] / S if present[k] else 0.0
            table_K[used, i] = K[i]
        # Joseph form, (1 - K h) P (1 - K h)' + R K K', one factor after the other: the variance stays positive however
        # small the noise of the reading is
        for i in range(d):
            across = 0.0
            for j in range(d):
                updated[i, j] = P[i, j] - K[i] * Ph[j]
                across += updated[i, j] * h[j]
            for j in range(d):
                updated[i, j] += (R * K[i] - across) * K[j]
        np.dot(A, updated, half)
        np.dot(half, columns, following)
        following += Q
        for i in range(d):
            for j in range(i):
                following[i, j] = 0.5 * (following[i, j] + following[j, i])
                following[j, i] = following[i, j]
        if present[k]:
            change = 0.0
            for i in range(kept):
                for j in range(d):
                    scale = np.sqrt(following[i, i] * following[j, j]) + 1e-300
                    change = max(change, abs(following[i, j] - P[i, j]) / scale)
            # a reading that shows more than the first state has to settle as a whole
            across = 0.0
            for i in range(d):
                half[0, i] = 0.0
                for j in range(d):
                    half[0, i] += following[i, j] * h[j]
                across += h[i] * half[0, i]
            for i in range(d):
                scale = np.sqrt(across * following[i, i]) + 1e-300
                change = max(change, abs(half[0, i] - Ph[i]) / scale)
            frozen = change < tolerance
        which[k] = used
        used += 1
        P[:] = following
    return which, table_P[:used].copy(), table_K[:used].copy(), table_S[:used].copy()


@numba.njit(cache=True)
def whiten(y: Floats, present: Flags, A: Floats, h: Floats, which: Integers, K: Floats, S: Floats) -> Floats:
    """Innovations over their standard deviation of several series (n, c) at once, shape (n, c); 0 where missing."""
    n, c = y.shape
    d = h.size
    columns = A.T.copy()
    white = np.zeros((n, c))
    x = np.zeros((c, d))
    updated = np.empty(d)
    for k in range(n):
        w = which[k]
        deviation = np.sqrt(S[w])
        for series in range(c):
            updated[:] = x[series]
            if present[k]:
                v = y[k, series]
                for i in range(d):
                    v -= h[i] * updated[i]
                white[k, series] = v / deviation
                for i in range(d):
                    updated[i] += K[w, i] * v
            x[series] = 0.0
            for j in range(d):  # column by column, so that the inner loop is one vector operation
                for i in range(d):
                    x[series, i] += columns[j, i] * updated[j]
    return white


@numba.njit(cache=True)
def innovations(y: Floats, present: Flags, A: Floats, h: Floats, which: Integers, K: Floats) -> tuple[Floats, Floats]:
    """Run the filter: predicted states (n, d) and innovations (n,); an innovation is 0 where a reading is missing."""
    n, d = y.size, h.size
    columns = A.T.copy()
    states = np.empty((n, d))
    updated = np.empty(d)
    v = np.zeros(n)
    x = np.zeros(d)
    for k in range(n):
        states[k] = x
        updated[:] = x
        if present[k]:
            v[k] = y[k] - h @ x
            for i in range(d):
                updated[i] += K[which[k], i] * v[k]
        x[:] = 0.0
        for j in range(d):
            for i in range(d):
                x[i] += columns[j, i] * updated[j]
    return states, v


@numba.njit(cache=True)
def smooth(
    states: Floats,
    v: Floats,
    present: Flags,
    A: Floats,
    h: Floats,
    which: Integers,
    P: Floats,
    K: Floats,
    S: Floats,
    wanted: int,
    tolerance: float,
) -> tuple[Floats, Floats]:
    """Fixed-interval smoother by the adjoint recursion of Bryson and Frazier; no covariance is inverted.

    Parameters
    ----------
    states, v
        Predicted states and innovations of `innovations`.
    wanted : int
        The state whose variance is wanted; one of those whose rows of the covariance are kept.

    Returns
    -------
    smoothed : (n, kept)
        Leading states given all readings.
    variance : (n,)
        Variances of the state that is wanted.
    """
    n, d = states.shape
    kept = P.shape[1]
    smoothed = np.empty((n, kept))
    variance = np.empty(n)
    r = np.zeros(d)
    N, half, following = np.zeros((d, d)), np.empty((d, d)), np.empty((d, d))
    L = A.copy()
    turned = L.T.copy()
    last = -1
    frozen = False
    for k in range(n - 1, -1, -1):
        w = which[k]
        same = w == last
        if not same:
            L[:] = A
            if present[k]:
                through = A @ K[w]
                for i in range(d):
                    for j in range(d):
                        L[i, j] -= through[i] * h[j]
            turned[:] = L.T
        r = turned @ r
        if present[k]:
            r += h * (v[k] / S[w])
        smoothed[k] = states[k, :kept] + P[w] @ r
        if not (frozen and same):
            np.dot(turned, N, half)
            np.dot(half, L, following)
            if present[k]:
                for i in range(d):
                    for j in range(d):
                        following[i, j] += h[i] * h[j] / S[w]
            change = 0.0
            for i in range(d):
                for j in range(i + 1):
                    value = 0.5 * (following[i, j] + following[j, i])
                    change = max(change, (value - N[i, j]) ** 2 / (following[i, i] * following[j, j] + 1e-300))
                    N[i, j] = value
                    N[j, i] = value
            frozen = same and change < tolerance**2
            row = P[w, wanted]
            explained = row @ (N @ row)
            variance[k] = max(row[wanted] - explained, 0.0)
        else:
            variance[k] = variance[k + 1]
        last = w
    return smoothed, variance
