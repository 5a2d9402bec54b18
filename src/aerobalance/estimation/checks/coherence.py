"""Whether two series go together in narrow bands, more than by chance."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

WORTH_A_LOOK: Final = 2.0
"""Excess of coherence over what chance gives, in its standard deviations, from which two series go together."""


def excess_of_coherence(
    one: NDArray[np.complex128], other: NDArray[np.complex128], firsts: NDArray[np.intp], counts: Array
) -> float:
    """Coherence of two series over what chance gives, in standard deviations of that [1].

    Parameters
    ----------
    one, other
        Lines of the two, shape (k,), or of several that each have nothing to do with the others, (n, k).
    firsts
        First line of each band, shape (b,).
    counts
        Independent numbers that each band is worth, shape (b,).
    """
    cross = np.abs(np.add.reduceat(one * np.conj(other), firsts, axis=-1)) ** 2
    powers = np.add.reduceat(np.abs(one) ** 2, firsts, axis=-1) * np.add.reduceat(np.abs(other) ** 2, firsts, axis=-1)
    coherence = np.minimum(cross / np.maximum(powers, 1e-300), 1 - 1e-12)
    # by chance m numbers have -(m - 1) log(1 - coherence) distributed exponentially, with a mean of 1
    excess = -(counts - 1) * np.log1p(-coherence) - 1
    if not excess.size:
        return 0.0
    return float(np.sum(excess) / np.sqrt(excess.size))
