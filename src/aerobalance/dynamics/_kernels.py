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


@compiled(nogil=True)
def add_mode(
    growth: complex,
    held: NDArray[np.complex128],
    weight: NDArray[np.complex128],
    shape: NDArray[np.complex128],
    change: NDArray[np.float64],
    every: int,
    out: NDArray[np.float64],
) -> None:
    """Add what one mode shows of loads that are linear between samples, at every so many of them.

    Parameters
    ----------
    growth : complex
        What becomes of its motion over a sampling interval.
    held : complex (2,)
        What a load at the end of an interval adds to its motion there, and one at the beginning.
    weight, shape : complex (c,)
        How loads drive it, and what it shows as loads, of which the real part counts.
    change : (n, c)
        The loads, less those that were held before the first.
    every : int
        Of how many samples one is added to.
    out : (m, c)
        Takes the loads that it shows.
    """
    z, before = 0j, 0j
    for k in range(change.shape[0]):
        real, imaginary = 0.0, 0.0
        for i in range(weight.size):
            real += change[k, i] * weight[i].real
            imaginary += change[k, i] * weight[i].imag
        push = complex(real, imaginary)
        z = growth * z + (held[0] * push + held[1] * before)
        before = push
        if k % every == 0:
            for i in range(shape.size):
                out[k // every, i] += shape[i].real * z.real - shape[i].imag * z.imag


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
