"""Compiled loops over the terms of a balance matrix: normalised numbers and arrays, nothing checked.

A term is a kind (the ten of AIAA R-091, in its order) and the one or two variables that it is made of.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

FARTHEST = 1e6  # of the scale; beyond it an iteration has run away
BLOCK = 304  # samples that are worked on together: they fit into the fastest memory, and rows do not meet in it
LATE = 38  # samples of a block that may be left, to be found together with those that others left
SINGLE_STEPS = 4  # in single precision: the samples of a balance, a few hundredths from linear, are then at its end
CHANGES = 3  # steps by how the terms have changed that follow each step in double precision
STEPS = 24  # of both kinds; samples that need more are left to Newton's method
SURE = np.float32(6.0)  # by how much the iteration may slow down from one step to the next
SMALL = np.float32(1e5)  # a first change, over the tolerance, whose followers in single precision err by a tenth of it
ROUNDING = np.float32(1e-15)  # of a step that ends it at once
NONE = np.float32(0.0)
SIX, THREE = 6, 3  # sums, and terms they are made of, at a time: as many as the registers of a processor hold
MOVED, BEFORE, FIRST, DONE = range(4)  # rows of `Work.marks`


class Work(NamedTuple):
    """Memory of `invert` for a block of m samples of d variables.

    Attributes
    ----------
    places, ones : int (d,)
        Rows of z with x, and as often the row of ones.
    z, z1, z2 : (r, m)
        Factors of the terms: 1, x and, where terms have them, |x| and x^2; in double and twice in single precision.
    factors : (r, 2 m)
        Means and changes of the factors.
    x, x1, x2 : (d m,)
        The rows with x of z, z1 and z2.
    start, rest : (d m,)
        x without terms that are not linear; what x lacks of it with them.
    start1, change : (d m,)
        The same start, and a change of x, in single precision.
    marks : (4, m)
        Largest change of any variable, the one before it, that of the last step in double precision, and the step at
        which a sample was found: -1 as long as it is not, 0 where it cannot be.
    """

    places: Integers
    ones: Integers
    z: Floats
    z1: Singles
    z2: Singles
    factors: Singles
    x: Floats
    x1: Singles
    x2: Singles
    start: Floats
    rest: Floats
    start1: Singles
    change: Singles
    marks: Singles


class Polynomials(NamedTuple):
    """Terms and what they add to x + N(x) = L y, six values and three terms at a time.

    Attributes
    ----------
    left, right : int (3 g,)
        Rows of z = (1, x) or (1, x, |x|, x^2) whose product is a term.
    shares, coarse : (s, g, 18)
        What three terms add to six values of N, in double and in single precision.
    linear : (s, 2 s, 18)
        -L, three values of y and six of x at a time.
    scale : (d,)
        What solutions are multiplied by.
    """

    left: Integers
    right: Integers
    shares: Floats
    coarse: Singles
    linear: Floats
    scale: Floats


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


@compiled(nogil=True)
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


@compiled(nogil=True)
def jacobians(kinds: Integers, first: Integers, second: Integers, C: Floats, x: Floats) -> Floats:
    """Jacobians of the polynomial at every x: (n, c) gives (n, c, c)."""
    n, c = x.shape
    J = np.empty((n, c, c))
    y = np.empty(c)
    for k in range(n):
        forward(kinds, first, second, C, x[k], y, J[k])
    return J


@compiled(inner=True, fastmath={"contract"})
def subtract(
    left: Integers,
    right: Integers,
    shares: Floats | Singles,
    z: Floats | Singles,
    sums: Floats | Singles,
    change: bool,
) -> None:
    """Subtract terms, products of rows of z, times their shares from sums (d m,); or how the terms change.

    A row of z is a factor, (m,), or its mean and its change, (2 m,): a product changes by the mean of one factor times
    the change of the other, and the other way round.
    """
    for h in range(shares.shape[0]):
        s = sums[h * SIX * BLOCK :]
        for g in range(shares.shape[1]):
            l0, l1, l2 = left[THREE * g], left[THREE * g + 1], left[THREE * g + 2]
            r0, r1, r2 = right[THREE * g], right[THREE * g + 1], right[THREE * g + 2]
            a0, a1, a2 = shares[h, g, 0], shares[h, g, 1], shares[h, g, 2]
            b0, b1, b2 = shares[h, g, 3], shares[h, g, 4], shares[h, g, 5]
            c0, c1, c2 = shares[h, g, 6], shares[h, g, 7], shares[h, g, 8]
            d0, d1, d2 = shares[h, g, 9], shares[h, g, 10], shares[h, g, 11]
            e0, e1, e2 = shares[h, g, 12], shares[h, g, 13], shares[h, g, 14]
            f0, f1, f2 = shares[h, g, 15], shares[h, g, 16], shares[h, g, 17]
            for k in range(BLOCK):
                if change:
                    x = z[l0, k] * z[r0, BLOCK + k] + z[l0, BLOCK + k] * z[r0, k]
                    y = z[l1, k] * z[r1, BLOCK + k] + z[l1, BLOCK + k] * z[r1, k]
                    v = z[l2, k] * z[r2, BLOCK + k] + z[l2, BLOCK + k] * z[r2, k]
                else:
                    x, y, v = z[l0, k] * z[r0, k], z[l1, k] * z[r1, k], z[l2, k] * z[r2, k]
                s[k] = s[k] - a0 * x - a1 * y - a2 * v
                s[BLOCK + k] = s[BLOCK + k] - b0 * x - b1 * y - b2 * v
                s[2 * BLOCK + k] = s[2 * BLOCK + k] - c0 * x - c1 * y - c2 * v
                s[3 * BLOCK + k] = s[3 * BLOCK + k] - d0 * x - d1 * y - d2 * v
                s[4 * BLOCK + k] = s[4 * BLOCK + k] - e0 * x - e1 * y - e2 * v
                s[5 * BLOCK + k] = s[5 * BLOCK + k] - f0 * x - f1 * y - f2 * v


@compiled(inline="always")
def sizes(z: Floats | Singles, d: int) -> None:
    """Put |x| and x^2 of d variables into z = (1, x, |x|, x^2), where it has them."""
    if z.shape[0] > 1 + d:
        for i in range(1, 1 + d):
            for k in range(BLOCK):
                z[d + i, k] = abs(z[i, k])
                z[2 * d + i, k] = z[i, k] * z[i, k]


@compiled(inline="always")
def note(change: Singles, marks: Singles, tolerance: float, step: int, exact: bool) -> int:
    """Number of samples that this change of x does not end; the step is noted of those that it does.

    The next change would be by this one's size times its part of the one before, and so on.
    """
    for k in range(BLOCK):
        marks[MOVED, k] = NONE
    for i in range(change.size // BLOCK):
        for k in range(BLOCK):
            marks[MOVED, k] = max(marks[MOVED, k], abs(change[i * BLOCK + k]))
    count, small, number = 0, np.float32(tolerance), np.float32(step)
    for k in range(BLOCK):
        near = (SURE * marks[MOVED, k] * marks[MOVED, k] <= small * marks[BEFORE, k]) | (marks[MOVED, k] <= ROUNDING)
        near &= exact | (marks[FIRST, k] <= SMALL * small)
        marks[DONE, k] = number if near & (marks[DONE, k] < NONE) else marks[DONE, k]
        marks[FIRST, k] = marks[MOVED, k] if exact else marks[FIRST, k]
        marks[BEFORE, k] = marks[MOVED, k]
        count += marks[DONE, k] < NONE
    return count


@compiled(inline="always")
def move(x: Floats, change: Singles, marks: Singles, factors: Singles) -> None:
    """Change x (d m,) and note the means and changes of its factors; samples that are done change no more."""
    d = x.size // BLOCK
    for i in range(d):
        row = 1 + i
        for k in range(BLOCK):
            by = change[i * BLOCK + k] if marks[DONE, k] < NONE else NONE
            x[i * BLOCK + k] += change[i * BLOCK + k]
            change[i * BLOCK + k] = NONE
            factors[row, k] = x[i * BLOCK + k] - 0.5 * by
            factors[row, BLOCK + k] = by
        if factors.shape[0] > 1 + d:
            for k in range(BLOCK):
                new = x[i * BLOCK + k]
                old = new - factors[row, BLOCK + k]
                factors[d + row, k] = 0.5 * (abs(new) + abs(old))
                factors[d + row, BLOCK + k] = abs(new) - abs(old)
                factors[2 * d + row, k] = 0.5 * (new * new + old * old)
                factors[2 * d + row, BLOCK + k] = (new - old) * (new + old)


@compiled(nogil=True, no_cfunc_wrapper=True)
def invert(
    given: Polynomials, y: Floats, tolerance: float, late: int, work: Work, out: Floats, steps: Integers
) -> None:
    """Find x with x + N(x) = L y, N the terms that are not linear: the plain iteration x <- L y - N(x).

    It begins in single precision, which takes half the time and loses nothing. A step in double precision follows, and
    then steps by how N has changed, for which single precision is enough again. A sample stands still once it is
    found, so that it does not matter which others are worked on beside it.

    Parameters
    ----------
    given : Polynomials
        L and N.
    y : (s, 6 n)
        Values wanted, six of each sample; 0 for variables that are not there.
    tolerance : float
        Largest error of any variable x.
    late : int
        Samples of a block that may be left without a solution, where others are found with fewer steps.
    work : Work
        Memory.
    out : (s, 6 n)
        Takes the solutions, scaled; NaN where none was found.
    steps : int (n,)
        Takes the steps; 0 where no solution was found.
    """
    # flags that are no literals share one compilation
    plain, changed = steps.size < 0, steps.size >= 0
    left, right, shares, coarse, linear, scale = given
    places, ones, z, z1, z2, factors, x, x1, x2, start, rest, start1, change, marks = work
    d, n = scale.size, steps.size
    for begin in range(0, n, BLOCK):
        count = min(BLOCK, n - begin)
        for h in range(y.shape[0]):
            some, six = y[h, SIX * begin : SIX * (begin + count)], x[h * SIX * BLOCK :]  # no index can be negative
            for k in range(count):
                for i in range(SIX):
                    six[i * BLOCK + k] = some[SIX * k + i]
        for j in range(x.size):
            start[j] = 0.0
        subtract(places, ones, linear, z, start, False)
        for k in range(BLOCK):
            marks[DONE, k], marks[BEFORE, k] = np.float32(-1.0) if k < count else NONE, NONE
        for i in range(d):
            for k in range(BLOCK):
                marks[DONE, k] = marks[DONE, k] if abs(start[i * BLOCK + k]) < FARTHEST else NONE
        for j in range(x.size):
            start1[j] = start[j]
            x1[j] = start1[j]
        for step in range(SINGLE_STEPS):
            now, then = (z1, x2) if step % 2 == 0 else (z2, x1)
            last = step == SINGLE_STEPS - 1
            then = change if last else then
            sizes(now, d)
            for j in range(x.size):
                then[j] = NONE if last else start1[j]
            subtract(left, right, coarse, now, then, plain)
        for j in range(x.size):
            x[j] = start[j] + change[j]
        for step in range(STEPS):
            exact = step % (1 + CHANGES) == 0
            if exact:
                sizes(z, d)
                for j in range(x.size):
                    rest[j] = start[j] - x[j]
                subtract(left, right, shares, z, rest, False)
                for i in range(d):
                    for k in range(BLOCK):
                        change[i * BLOCK + k] = rest[i * BLOCK + k] if marks[DONE, k] < NONE else NONE
            else:
                subtract(left, right, coarse, factors, change, changed)
            if note(change, marks, tolerance, SINGLE_STEPS + step + 1, exact) <= late:
                break
            move(x, change, marks, factors)
        for i in range(d):
            to = scale[i]
            for k in range(BLOCK):
                found = x[i * BLOCK + k] + change[i * BLOCK + k]
                marks[DONE, k] = marks[DONE, k] if abs(found) < FARTHEST else NONE  # run away
                x[i * BLOCK + k] = found * to if marks[DONE, k] > NONE else np.nan
        for h in range(y.shape[0]):
            some, six = out[h, SIX * begin : SIX * (begin + count)], x[h * SIX * BLOCK :]
            for k in range(count):
                for i in range(SIX):
                    some[SIX * k + i] = six[i * BLOCK + k]
        part = steps[begin : begin + count]
        for k in range(count):
            part[k] = np.int64(max(marks[DONE, k], NONE))
