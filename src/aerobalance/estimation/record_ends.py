"""The ends of a long record, where windows have no power: whether a load beyond a band is there.

A short stretch at an end is compared with such stretches all along the record, by what is left of it beyond the band.
No window is needed for that: of all sequences of so many samples those that are concentrated in the band are taken
off, which are the discrete prolate spheroidal ones [Slepian1978]_. What the record has there everywhere, noise of any
spectrum, is no load.

References
----------
.. [Slepian1978] D. Slepian, "Prolate spheroidal wave functions, Fourier analysis, and uncertainty V: the discrete
   case", Bell Syst. Tech. J. 57 (1978) 1371.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np
from scipy.linalg import eigh_tridiagonal

from aerobalance.recording.channel import Array

LENGTH: Final = 512
"""Samples of a stretch: 200 more than the windows of the look leave out at an end."""

OF_PIECE: Final = 4
"""Stretches of a piece of a record, from its first samples to its last."""

FURTHER: Final = 12
"""Sequences that are taken off in addition to those that the band has room for. What is left of a load within two
thirds of the band is 7e-11 of its power then, or less."""

STANDS_OUT: Final = 2.0
"""Power of a stretch beyond the band over the median of all from which on a load is there. That of white noise
scatters by 5 to 8 per cent."""

LEAST: Final = 1e-9
"""That power over all of the stretch, at least: less may be left of a load in the band where no noise is."""


def stretches_of(values: Array) -> Array:
    """Stretches of a piece less their means, evenly from its first samples to its last, shape (k, n); none if shorter.

    Half the precision of the readings is enough: they are up to a hundred thousand for each hour.
    """
    if values.size < LENGTH:
        return np.zeros((0, LENGTH), dtype=np.float32)
    begins = np.linspace(0, values.size - LENGTH, OF_PIECE).astype(int)
    stretches = values[begins[:, None] + np.arange(LENGTH)]
    return np.asarray((stretches - stretches.mean(axis=1, keepdims=True)).astype(np.float32))


def load_at_ends(stretches: Sequence[Array], width: float) -> bool:
    """Whether a load beyond a band is at an end of a record.

    Parameters
    ----------
    stretches
        Stretches of its pieces, from the first to the last, each of shape (k, n); NaN where samples are missing.
    width
        Upper edge of the band [cycles a sample].
    """
    every = np.concatenate(list(stretches))
    if not len(every):
        return False
    every = every.astype(float)
    left = every - (every @ _within(width)) @ _within(width).T
    power, whole = np.mean(left**2, axis=1), np.mean(every**2, axis=1)
    told = np.isfinite(power)
    if not told.any():
        return False
    most = np.maximum(STANDS_OUT * np.median(power[told]), LEAST * whole)
    return bool((power[[0, -1]] > most[[0, -1]]).any())


@cache
def _within(width: float) -> Array:
    """Sequences that are concentrated up to a frequency [cycles a sample], orthonormal, shape (n, k)."""
    place = np.arange(LENGTH)
    diagonal = (0.5 * (LENGTH - 1) - place) ** 2 * np.cos(2 * np.pi * width)
    beside = 0.5 * place[1:] * (LENGTH - place[1:])
    count = min(int(np.ceil(2 * LENGTH * width)) + FURTHER, LENGTH)
    return np.asarray(eigh_tridiagonal(diagonal, beside, select="i", select_range=(LENGTH - count, LENGTH - 1))[1])
