"""Compiled loops that run a state space, and its smoother on several series at once; nothing is checked.

Letters: A transition, h observation row, K gain, P predicted covariance, S innovation variance.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@numba.njit(cache=True)
def simulate(A: Floats, root: Floats, first: Floats, normals: Floats, wanted: Integers) -> Floats:
    """Run a state space from a first state (d,), driven by root (d, d) times normals (n, d); states wanted (n, w)."""
    n, d = normals.shape
    rows, roots = A.T.copy(), root.T.copy()
    out = np.empty((n, wanted.size))
    x = first.copy()
    following = np.empty(d)
    for k in range(n):
        for i in range(wanted.size):
            out[k, i] = x[wanted[i]]
        following[:] = 0.0
        for j in range(d):  # column by column, so that the inner loop is one vector operation
            for i in range(d):
                following[i] += rows[j, i] * x[j] + roots[j, i] * normals[k, j]
        x[:] = following
    return out


@numba.njit(cache=True)
def smoothed(
    y: Floats,
    present: Flags,
    A: Floats,
    h: Floats,
    which: Integers,
    P: Floats,
    K: Floats,
    S: Floats,
    wanted: int,
) -> Floats:
    """Smoothed values of one state given several series (n, c) at once, shape (n, c); no variances.

    The adjoint recursion of `aerobalance.estimation.statespace._kernels.smooth`, with L' r = A' r - h (K' A' r).
    """
    n, c = y.shape
    d = h.size
    columns = A.T.copy()
    out = np.empty((n, c))
    v = np.zeros((n, c))
    x = np.zeros((c, d))
    updated = np.empty(d)
    for k in range(n):
        for series in range(c):
            updated[:] = x[series]
            out[k, series] = updated[wanted]
            if present[k]:
                error = y[k, series]
                for i in range(d):
                    error -= h[i] * updated[i]
                v[k, series] = error
                for i in range(d):
                    updated[i] += K[which[k], i] * error
            x[series] = 0.0
            for j in range(d):
                for i in range(d):
                    x[series, i] += columns[j, i] * updated[j]
    r = np.zeros((c, d))
    for k in range(n - 1, -1, -1):
        w = which[k]
        for series in range(c):
            updated[:] = 0.0
            for j in range(d):
                for i in range(d):
                    updated[i] += A[j, i] * r[series, j]
            if present[k]:
                weight = v[k, series] / S[w]
                for i in range(d):
                    weight -= K[w, i] * updated[i]
                for i in range(d):
                    updated[i] += h[i] * weight
            for i in range(d):
                out[k, series] += P[w, wanted, i] * updated[i]
            r[series] = updated
    return out
