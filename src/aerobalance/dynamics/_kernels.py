"""Compiled recursions of one mode: SI numbers and arrays, nothing checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

BLOCK = 512  # samples that are worked on together: they stay in the fastest memory


@compiled(nogil=True)
def first_order(growth: complex, drive: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Run z[k] = growth z[k-1] + drive[k] from rest, shape (n,)."""
    out = np.empty(drive.size, np.complex128)
    z = 0j
    for k in range(drive.size):
        z = growth * z + drive[k]
        out[k] = z
    return out


@compiled(nogil=True, fastmath={"contract"})
def driven(
    denominator: NDArray[np.float64],
    taps: NDArray[np.float64],
    series: NDArray[np.float64],
    state: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Run y[k] = sum over t and i of taps[t, i] series[i, k + t], - a1 y[k-1] - a2 y[k-2]; the state is carried on.

    Parameters
    ----------
    denominator : (3,)
        1, a1 and a2.
    taps : (t, c)
        Weights of the series.
    series : (c, n + t - 1)
        What drives it.
    state : (2,)
        The last two y, the later one first.
    out : (n,)
        Where y is written.
    """
    last, before = state[0], state[1]
    work, near = np.empty(BLOCK), np.zeros(BLOCK + taps.shape[0])
    for begin in range(0, out.size, BLOCK):
        count = min(BLOCK, out.size - begin)
        for k in range(BLOCK):
            work[k] = 0.0
        for i in range(taps.shape[1]):
            for k in range(count + taps.shape[0] - 1):
                near[k] = series[i, begin + k]
            # one product a tap, so that the sum does not hang on how many samples come at once
            for t in range(taps.shape[0]):
                weight = taps[t, i]
                for k in range(BLOCK):
                    work[k] += weight * near[k + t]
        for k in range(count):
            # only one product waits for the sample before
            y = (work[k] - denominator[2] * before) - denominator[1] * last
            last, before = y, last
            out[begin + k] = y
    state[0], state[1] = last, before
