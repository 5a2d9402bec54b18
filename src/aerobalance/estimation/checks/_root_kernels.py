"""Compiled steps of a Cholesky root of a covariance of spectral lines: nothing is checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

Complexes = NDArray[np.complex128]


@compiled(inner=True, fastmath={"contract"})
def over(number: complex, real: float) -> complex:
    """Return a complex number over a real one: by itself the compiler divides by that as by a complex one."""
    share = 1 / real
    return complex(number.real * share, number.imag * share)


# Written into its callers, as `whiten` is: calls would add a quarter to the time of two lines.
@compiled(inner=True, inline="always", fastmath={"contract"})
def add_to_root(left: complex, a: int, b: int, least: float, root: Complexes, found: float) -> float:
    """Return a log-likelihood less what an element of a covariance adds to the logarithm of its determinant.

    That is nothing but for the diagonal. The element of the Cholesky root is written; all of the rows before it, and
    those before it in its row, are written already.

    Parameters
    ----------
    left
        The element of the covariance, in its lower half.
    a, b
        Its row and its column.
    least
        Least variance of a line that those before it leave, over all of its variance: noise of one channel alone in
        two lines makes them one, but for rounding.
    root
        The root, its lower half, shape (n, n).
    found
        The log-likelihood before.
    """
    own = left.real
    for c in range(b):
        left -= root[a, c] * np.conj(root[b, c])
    if b < a:
        root[a, b] = over(left, root[b, b].real)
    else:
        rest = max(left.real, least * own)
        root[a, a] = np.sqrt(rest)
        found -= np.log(rest)
    return found


@compiled(inner=True, inline="always", fastmath={"contract"})
def whiten(line: complex, a: int, root: Complexes, white: Complexes, found: float) -> float:
    """Return a log-likelihood less the squared magnitude of a whitened line, which is written.

    Parameters
    ----------
    line
        The line.
    a
        Its place among all; those before it are whitened already.
    root
        Cholesky root of their covariance, its lower half, shape (n, n).
    white
        The whitened lines, shape (n,).
    found
        The log-likelihood before.
    """
    for c in range(a):
        line -= root[a, c] * white[c]
    white[a] = over(line, root[a, a].real)
    found -= white[a].real ** 2 + white[a].imag ** 2
    return found
