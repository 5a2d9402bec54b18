"""Compiled loops over the terms of a balance matrix: normalised numbers and arrays, nothing checked.

A term is a kind (the ten of AIAA R-091, in its order) and the one or two variables that it is made of.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NEWTON_STEPS = 30
PLAIN_STEPS = 200
FARTHEST = 1e6  # of the scale; beyond it the iteration has run away


@numba.njit(cache=True)
def term(kind: int, a: float, b: float) -> tuple[float, float, float]:
    """Value of one term, and its derivatives by its first and second variable."""
    sa = float(np.sign(a))
    sb = float(np.sign(b))
    if kind == 0:
        return a, 1.0, 0.0
    if kind == 1:
        return abs(a), sa, 0.0
    if kind == 2:
        return a * a, 2 * a, 0.0
    if kind == 3:
        return a * abs(a), 2 * abs(a), 0.0
    if kind == 4:
        return a * b, b, a
    if kind == 5:
        return abs(a * b), sa * abs(b), sb * abs(a)
    if kind == 6:
        return a * abs(b), abs(b), a * sb
    if kind == 7:
        return abs(a) * b, sa * b, abs(a)
    if kind == 8:
        return a * a * a, 3 * a * a, 0.0
    return abs(a * a * a), 3 * a * abs(a), 0.0


@numba.njit(cache=True)
def design(kinds: Integers, first: Integers, second: Integers, x: Floats) -> Floats:
    """Values of all terms: x (n, c) gives (n, t)."""
    n, count = x.shape[0], kinds.size
    H = np.empty((n, count))
    for k in range(n):
        for t in range(count):
            H[k, t] = term(kinds[t], x[k, first[t]], x[k, second[t]])[0]
    return H


@numba.njit(cache=True)
def forward(kinds: Integers, first: Integers, second: Integers, C: Floats, x: Floats, y: Floats, J: Floats) -> None:
    """Put the polynomial y (c,) and its Jacobian J (c, c) at one x (c,) in place; C is (t, c)."""
    y[:] = 0.0
    J[:, :] = 0.0
    for t in range(kinds.size):
        i, j = first[t], second[t]
        value, da, db = term(kinds[t], x[i], x[j])
        for m in range(y.size):
            y[m] += C[t, m] * value
            J[m, i] += C[t, m] * da
            J[m, j] += C[t, m] * db


@numba.njit(cache=True)
def jacobians(kinds: Integers, first: Integers, second: Integers, C: Floats, x: Floats) -> Floats:
    """Jacobians of the polynomial at every x: (n, c) gives (n, c, c)."""
    n, c = x.shape
    J = np.empty((n, c, c))
    y = np.empty(c)
    for k in range(n):
        forward(kinds, first, second, C, x[k], y, J[k])
    return J


@numba.njit(cache=True)
def solve(
    kinds: Integers, first: Integers, second: Integers, C: Floats, inverse: Floats, y: Floats, tolerance: float
) -> tuple[Floats, Integers]:
    """Find x with the polynomial equal to y.

    Newton's method from the linear solution; where the absolute values make it jump to and fro, the plain iteration
    of AIAA R-091, x <- x + C1^-1 (y - f(x)).

    Parameters
    ----------
    kinds, first, second : int (t,)
        The terms.
    C : (t, c)
        Coefficients.
    inverse : (c, c)
        C1^-1, of the linear terms: x = inverse @ y.
    y : (n, c)
        Values wanted; NaN gives NaN.
    tolerance : float
        Largest last step of any variable, over its scale.

    Returns
    -------
    x : (n, c)
        Solutions; NaN where none was found.
    steps : int (n,)
        Iterations taken; 0 where none was found.
    """
    n, c = y.shape
    x = np.empty((n, c))
    steps = np.zeros(n, np.int64)
    value, J = np.empty(c), np.empty((c, c))
    for k in range(n):
        start = inverse @ y[k]
        now = start.copy()
        if not np.all(np.isfinite(start)):
            x[k, :] = np.nan
            continue
        for step in range(NEWTON_STEPS + PLAIN_STEPS):
            if step == NEWTON_STEPS:
                now = start.copy()
            forward(kinds, first, second, C, now, value, J)
            short = y[k] - value
            newton = step < NEWTON_STEPS and abs(np.linalg.det(J)) > 0
            change = np.linalg.solve(J, short) if newton else inverse @ short
            now = now + change
            size = np.max(np.abs(change))
            if not size < FARTHEST:
                if step < NEWTON_STEPS:
                    now = start.copy()
                    continue
                break
            if size <= tolerance * max(1.0, np.max(np.abs(now))):
                steps[k] = step + 1
                break
        x[k, :] = np.nan
        if steps[k] > 0:
            x[k] = now
    return x, steps
