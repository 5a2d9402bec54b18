"""Compiled loops for the variance that a balance matrix gives to loads: normalised arrays, nothing checked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 192  # samples that are worked on together: with them the loops along samples stay in the fastest memory
FOUR = 4  # monomials that are added at a time: a sum is written once for so many


class Quadratic(NamedTuple):
    """A balance matrix where the signs of its c variables are given, in m monomials of them, r being m up to fours.

    Attributes
    ----------
    factors : int (m, 3)
        Variables that a monomial is the product of; c stands for 1.
    forms : (c, m, r)
        Quadratic forms of the variances of the results, all in the lower half, and zeros.
    scatter : (c,)
        Variance of the results beside that.
    bend : (c, c, 1 + 2 c)
        What makes the derivatives of the results over those of the linear terms, less 1, of 1, the variables and
        their squares.
    back : (c, c)
        Inverse of the derivatives of the linear terms.
    correlation : (c, c)
        Correlation of the results.
    """

    factors: Integers
    forms: Floats
    scatter: Floats
    bend: Floats
    back: Floats
    correlation: Floats


@compiled(inner=True, error_model="numpy", fastmath={"contract"})
def deviations(z: Floats, matrix: Quadratic, values: Floats, part: Floats, out: Floats) -> None:
    """Write the standard deviations of the results, shape (c, b), at variables with a row of ones, (c + 1, b).

    `values` (r, b) and `part` (b,) are room; the rows of `values` beyond the monomials are zero.
    """
    size = z.shape[1]
    for place in range(matrix.factors.shape[0]):
        one, two, three = matrix.factors[place]
        for n in range(size):
            values[place, n] = z[one, n] * z[two, n] * z[three, n]
    for result in range(out.shape[0]):
        for n in range(size):
            out[result, n] = 0.0
        for place in range(matrix.factors.shape[0]):
            row, own = matrix.forms[result, place], values[place]
            for n in range(size):
                part[n] = 0.0
            for other in range(0, place + 1, FOUR):
                a, b, c, d = row[other], row[other + 1], row[other + 2], row[other + 3]
                v, w, x, y = values[other], values[other + 1], values[other + 2], values[other + 3]
                for n in range(size):
                    part[n] += a * v[n] + b * w[n] + c * x[n] + d * y[n]
            for n in range(size):
                out[result, n] += part[n] * own[n]
        for n in range(size):
            out[result, n] = np.sqrt(max(out[result, n] + matrix.scatter[result], 0.0))


@compiled(inner=True, error_model="numpy")
def solve_with_exchange(whole: Floats, n: int) -> None:
    """Solve the equations of one sample in place, c of them and k columns that they are solved for, (c + k, c, b)."""
    columns, rows = whole.shape[0], whole.shape[1]
    for place in range(rows):
        best = place
        for other in range(place + 1, rows):
            if abs(whole[place, other, n]) > abs(whole[place, best, n]):
                best = other
        for column in range(place, columns):
            pivot = whole[column, best, n]
            whole[column, best, n] = whole[column, place, n]
            whole[column, place, n] = pivot
        for column in range(place + 1, columns):
            whole[column, place, n] /= whole[place, place, n]
            for other in range(rows):
                if other != place:
                    whole[column, other, n] -= whole[place, other, n] * whole[column, place, n]


@compiled(inner=True, error_model="numpy", fastmath={"contract"})
def add_product(out: Floats, one: Floats, other: Floats, share: float) -> None:
    """Add the product of two series and a number to a third one, shape (b,) each."""
    for n in range(out.size):
        out[n] += share * one[n] * other[n]


@compiled(inner=True, error_model="numpy")
def fill(out: Floats, value: float) -> None:
    """Write a number to a series, shape (b,)."""
    for n in range(out.size):
        out[n] = value


@compiled(inner=True, error_model="numpy")
def divide(out: Floats, by: Floats) -> None:
    """Divide a series by another, shape (b,) each."""
    for n in range(out.size):
        out[n] /= by[n]


@compiled(inner=True, error_model="numpy")
def smallest(series: Floats) -> float:
    """Least size of the numbers of a series, shape (b,)."""
    least = np.inf
    for n in range(series.size):
        least = min(least, abs(series[n]))
    return least


@compiled(inner=True, error_model="numpy", fastmath={"contract"})
def onward(z: Floats, bend: Floats, transform: Floats, steady: float, whole: Floats) -> None:
    """Write what makes k transformed loads of the results over the linear terms' derivatives, in whole[c:].

    By elimination without exchange of rows, as these derivatives are near 1 where a plain iteration converges; samples
    of which that is not so are solved one by one.

    Parameters
    ----------
    z
        Variables and a row of ones, shape (c + 1, b).
    bend
        As of `Quadratic`.
    transform
        Shape (k, c).
    steady
        Pivot below which rows have to change places.
    whole
        What is written: the equations' columns, then those of what they are solved for, shape (c + k, c, b).
    """
    c = bend.shape[0]
    columns = whole.shape[0]
    for exchanged in range(2):
        for i in range(c):
            for j in range(c):  # of the transpose
                fill(whole[j, i], bend[j, i, 0] + (1.0 if i == j else 0.0))
                for k in range(2 * c):
                    if bend[j, i, 1 + k]:
                        add_product(whole[j, i], z[k % c], z[k - c if k >= c else c], bend[j, i, 1 + k])
            for k in range(columns - c):
                fill(whole[c + k, i], transform[k, i])
        if exchanged:
            for n in range(z.shape[1]):
                solve_with_exchange(whole, n)
            return
        least = np.inf
        for place in range(c):
            least = min(least, smallest(whole[place, place]))
            for column in range(place + 1, columns):
                divide(whole[column, place], whole[place, place])
                for other in range(c):
                    if other != place:
                        add_product(whole[column, other], whole[place, other], whole[column, place], -1.0)
        if least > steady:
            return


@compiled(nogil=True, error_model="numpy", fastmath={"contract"})
def variances(x: Floats, rows: Integers, matrix: Quadratic, transform: Floats, steady: float, out: Floats) -> None:
    """Write the variances of transformed loads of some samples whose variables have the signs of a matrix.

    Parameters
    ----------
    x
        Normalised variables, shape (n, c).
    rows
        Which samples, shape (s,).
    matrix
        The matrix.
    transform
        What is made of the normalised loads, shape (k, c).
    steady
        Pivot of the derivatives, over those of the linear terms, below which rows have to change places.
    out
        What is written, shape (n, k).
    """
    c, k = x.shape[1], transform.shape[0]
    size = min(BLOCK, rows.size)
    z, values = np.ones((c + 1, size)), np.zeros((matrix.forms.shape[2], size))
    deviation, turned, part = np.empty((c, size)), np.empty((c, size)), np.empty(size)
    whole = np.empty((c + k, c, size))
    for begin in range(0, rows.size, size):
        first = min(begin, rows.size - size)  # the last block has some samples of the one before
        for n in range(size):
            for i in range(c):
                z[i, n] = x[rows[first + n], i]
        deviations(z, matrix, values, part, deviation)
        onward(z, matrix.bend, transform, steady, whole)
        for result in range(k):
            fill(part, 0.0)
            for i in range(c):
                fill(turned[i], 0.0)
                for j in range(c):
                    if matrix.back[j, i]:
                        add_product(turned[i], whole[c + result, j], deviation[i], matrix.back[j, i])
                for j in range(i + 1):
                    if matrix.correlation[i, j]:
                        add_product(part, turned[i], turned[j], matrix.correlation[i, j] * (1.0 if j == i else 2.0))
            for n in range(size):
                out[rows[first + n], result] = part[n]
