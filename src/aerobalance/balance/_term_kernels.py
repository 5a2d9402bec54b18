"""Compiled loops over the terms of a balance matrix: normalised numbers and arrays, nothing checked.

A term is a kind (the ten of AIAA R-091, in its order) and the one or two variables that it is made of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

FARTHEST = 1e6  # of the scale; beyond it an iteration has run away
BLOCK = 128  # samples that are worked on together: what is known of them fits into the fastest memory
SINGLE_STEPS = 4  # in single precision: the samples of a balance, a few hundredths from linear, are then at its end
BLOCK_STEPS = 24  # further ones; samples that need more are left to Newton's method
SURE = 10.0  # by how much the iteration may slow down from one step to the next
ROUNDING = 1e-15  # of a step that ends it at once


@compiled(inner=True)
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


@compiled()
def design(kinds: Integers, first: Integers, second: Integers, x: Floats) -> Floats:
    """Values of all terms: x (n, c) gives (n, t)."""
    n, count = x.shape[0], kinds.size
    H = np.empty((n, count))
    for k in range(n):
        for t in range(count):
            H[k, t] = term(kinds[t], x[k, first[t]], x[k, second[t]])[0]
    return H


@compiled(inner=True)
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


@compiled()
def jacobians(kinds: Integers, first: Integers, second: Integers, C: Floats, x: Floats) -> Floats:
    """Jacobians of the polynomial at every x: (n, c) gives (n, c, c)."""
    n, c = x.shape
    J = np.empty((n, c, c))
    y = np.empty(c)
    for k in range(n):
        forward(kinds, first, second, C, x[k], y, J[k])
    return J


@compiled(inline="always")
def multiply(left: Integers, right: Integers, z: Floats | Singles, terms: Floats | Singles, c: int) -> None:
    """Put the products of rows of z = (1, x, |x|, x^2), in which x alone is given, into terms (t, m)."""
    if z.shape[0] > 1 + c:
        for i in range(c):
            for k in range(z.shape[1]):
                z[1 + c + i, k] = abs(z[1 + i, k])
                z[1 + 2 * c + i, k] = z[1 + i, k] * z[1 + i, k]
    for t in range(left.size):
        i, j = left[t], right[t]
        for k in range(z.shape[1]):
            terms[t, k] = z[i, k] * z[j, k]


@compiled(fastmath={"contract"}, error_model="numpy")
def invert(
    left: Integers,
    right: Integers,
    shares: Floats,
    coarse: Singles,
    linear: Floats,
    scale: Floats,
    y: Floats,
    tolerance: float,
) -> tuple[Floats, Integers]:
    """Find x with x + N(x) = linear y, N the terms that are not linear: the plain iteration x <- linear y - N(x).

    It begins in single precision, which takes half the time and loses nothing. A sample stands still once it is found,
    so that it does not matter which others are worked on beside it.

    Parameters
    ----------
    left, right : int (t,)
        Rows of z = (1, x) or (1, x, |x|, x^2) whose product is a term.
    shares, coarse : (c, t)
        What each term adds to N, and the same in single precision.
    linear : (c, c)
        What turns y into x where there are no other terms.
    scale : (c,)
        What the solutions are multiplied by.
    y : (n, c)
        Values wanted.
    tolerance : float
        Largest error of any variable x.

    Returns
    -------
    x : (n, c)
        Solutions, scaled; NaN where none was found.
    steps : int (n,)
        Steps taken; 0 where none was found.
    """
    n, c = y.shape
    rows = 1 + c
    for t in range(left.size):
        rows = 1 + 3 * c if max(left[t], right[t]) > c else rows
    out, steps = np.empty((n, c)), np.zeros(n, np.int64)
    given, start, bent = np.zeros((c, BLOCK)), np.empty((c, BLOCK)), np.empty((c, BLOCK))
    z, terms = np.ones((rows, BLOCK)), np.empty((left.size, BLOCK))
    start_, bent_ = np.empty((c, BLOCK), np.float32), np.empty((c, BLOCK), np.float32)
    z_, terms_ = np.ones((rows, BLOCK), np.float32), np.empty((left.size, BLOCK), np.float32)
    done, moved, before = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for first in range(0, n, BLOCK):
        count = min(BLOCK, n - first)
        for i in range(c):
            for k in range(count):
                given[i, k] = y[first + k, i]
        np.dot(linear, given, start)
        for i in range(c):
            for k in range(BLOCK):
                start_[i, k] = start[i, k]
                z_[1 + i, k] = start_[i, k]
        for _ in range(SINGLE_STEPS):
            multiply(left, right, z_, terms_, c)
            np.dot(coarse, terms_, bent_)
            for i in range(c):
                for k in range(BLOCK):
                    z_[1 + i, k] = start_[i, k] - bent_[i, k]
        for k in range(BLOCK):
            done[k] = -1.0 if k < count else 1.0
            before[k] = 0.0
        for i in range(c):
            for k in range(BLOCK):
                z[1 + i, k] = z_[1 + i, k]
                done[k] = done[k] if abs(start[i, k]) < FARTHEST else 0.0
        for step in range(1, BLOCK_STEPS + 1):
            multiply(left, right, z, terms, c)
            np.dot(shares, terms, bent)
            for k in range(BLOCK):
                moved[k] = 0.0
            for i in range(c):
                for k in range(BLOCK):
                    change = start[i, k] - bent[i, k] - z[1 + i, k]
                    size = abs(change)
                    moved[k] = size if size > moved[k] else moved[k]
                    z[1 + i, k] += change if done[k] < 0 else 0.0
            going = 0
            for k in range(BLOCK):
                # the next step would be by this one's size times its part of the one before, and so on
                near = SURE * moved[k] * moved[k] <= tolerance * before[k]
                done[k] = step + SINGLE_STEPS if (done[k] < 0) & (near | (moved[k] <= ROUNDING)) else done[k]
                before[k] = moved[k]
                going += done[k] < 0
            if going == 0:
                break
        for i in range(c):
            for k in range(BLOCK):
                done[k] = done[k] if abs(z[1 + i, k]) < FARTHEST else 0.0  # run away, to NaN at last
        for i in range(c):
            for k in range(count):
                out[first + k, i] = z[1 + i, k] * scale[i] if done[k] > 0 else np.nan
        for k in range(count):
            steps[first + k] = int(max(done[k], 0.0))
    return out, steps
