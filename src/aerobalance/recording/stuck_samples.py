"""Runs of equal readings of a channel that is finely resolved: it was stuck, or its cable was lost."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

MOST_EQUAL: Final = 0.05
"""Share of neighbours that are equal, from which on a channel has too few steps for a run of them to say anything."""

LEAST_EQUAL: Final = 1e-3
"""The same that is assumed at least: readings of a converter are equal now and then."""

CHANCE: Final = 1e-9
"""Probability that a run as long comes about by chance anywhere in the record."""


def is_dead(values: Array) -> bool:
    """Return whether a channel has one reading all along.

    Parameters
    ----------
    values
        Readings, shape (n,); NaN where missing.
    """
    present = values[np.isfinite(values)]
    return present.size > 1 and bool((present == present[0]).all())


def stuck_samples(values: Array) -> NDArray[np.bool_]:
    """Return which readings repeat the one before them in a run that is no chance, shape (n,).

    The first reading of a run may be sound and is kept. A channel that never changes is dead (`is_dead`), and is not
    looked at.

    Parameters
    ----------
    values
        Readings, shape (n,); NaN where missing.
    """
    found = np.zeros(values.size, dtype=bool)
    same = np.diff(values) == 0
    if values.size < 2 or same.all():
        return found
    edges = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not first.size:
        return found
    # the runs themselves are no chance: of each one pair is counted
    share = first.size / values.size
    if share > MOST_EQUAL:
        return found
    longest = 1 + np.log(CHANCE / values.size) / np.log(max(share, LEAST_EQUAL))
    for start, stop in zip(first, last, strict=True):
        if stop - start + 1 > longest:
            found[start + 1 : stop + 1] = True
    return found
