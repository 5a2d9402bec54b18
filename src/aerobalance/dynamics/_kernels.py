"""Compiled recursions of one mode: SI numbers and arrays, nothing checked."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True)
def first_order(growth: complex, drive: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Run z[k] = growth z[k-1] + drive[k] from rest, shape (n,)."""
    out = np.empty(drive.size, np.complex128)
    z = 0j
    for k in range(drive.size):
        z = growth * z + drive[k]
        out[k] = z
    return out


@numba.njit(cache=True)
def second_order(
    denominator: NDArray[np.float64], drive: NDArray[np.float64], state: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Run y[k] = drive[k] - a1 y[k-1] - a2 y[k-2], shape (n,); the state, shape (2,), is carried on.

    Parameters
    ----------
    denominator : (3,)
        1, a1 and a2.
    drive : (n,)
        What drives it.
    state : (2,)
        What earlier samples add to the next two.
    """
    out = np.empty(drive.size, np.float64)
    for k in range(drive.size):
        y = drive[k] + state[0]
        state[0] = state[1] - denominator[1] * y
        state[1] = -denominator[2] * y
        out[k] = y
    return out
