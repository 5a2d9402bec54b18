"""Compiled loop for the likeliest covariances of forces, by their spectral lines: nothing is checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.checks._root_kernels import add_to_root, over, whiten
from aerobalance.recording.compiled import compiled

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@compiled(nogil=True, error_model="numpy", fastmath={"contract"})
def likeliest_covariances(
    lines: Complexes, noise: Complexes, bands: Integers, rounds: int, covariance: Complexes, found: Floats
) -> None:
    """Write the log-likelihood of lines in every band, the covariance of their forces there at its likeliest.

    By expectation and maximisation. With W the inverse of the covariance C + N of a line z, its force is expected to
    be z - N W z, give or take a covariance of N - N W N. Both are C W z and C - C W C as well: where one strong load
    is in all forces, these would be small differences of large numbers.

    Parameters
    ----------
    lines
        The lines, shape (m, n).
    noise
        Covariance of their noise, N, shape (m, n, n).
    bands
        First ordinate of every band, shape (b,).
    rounds
        Rounds of the search.
    covariance
        The covariances of the forces, C, that the search begins with, which are moved, shape (b, n, n).
    found
        The log-likelihoods before the last move, shape (b,).
    """
    ordinates, count = lines.shape
    root, white = np.empty((count, count), np.complex128), np.empty(count, np.complex128)
    taken, moved = np.empty((count, count), np.complex128), np.empty((count, count), np.complex128)
    force = np.empty(count, np.complex128)
    for band in range(bands.size):
        first, last = bands[band], bands[band + 1] if band + 1 < bands.size else ordinates
        own = covariance[band]
        for _ in range(rounds):
            now = 0.0
            moved[:] = 0.0
            for place in range(first, last):
                for a in range(count):  # root of C + N, and by it the line, N and N W N
                    for b in range(a + 1):
                        now = add_to_root(own[a, b] + noise[place, a, b], a, b, 1e-15, root, now)
                    now = whiten(lines[place, a], a, root, white, now)
                    for b in range(count):
                        left = noise[place, a, b]
                        for c in range(a):
                            left -= root[a, c] * taken[c, b]
                        taken[a, b] = over(left, root[a, a].real)
                for a in range(count):
                    force[a] = lines[place, a]
                    for c in range(count):
                        force[a] -= np.conj(taken[c, a]) * white[c]
                    for b in range(a + 1):
                        both = force[a] * np.conj(force[b]) + noise[place, a, b]
                        for c in range(count):
                            both -= np.conj(taken[c, a]) * taken[c, b]
                        moved[a, b] += both
            found[band] = now
            for a in range(count):
                for b in range(a + 1):
                    own[a, b] = over(moved[a, b], float(last - first))
                    own[b, a] = np.conj(own[a, b])
