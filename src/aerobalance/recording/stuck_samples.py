"""Runs of equal readings of a channel that is finely resolved: it was stuck, or its cable was lost."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

MOST_EQUAL: Final = 0.05
"""Probability that a reading equals the one before, above which runs say nothing: the channel is coarsely resolved, or
held between the readings of a slower one."""

LEAST_EQUAL: Final = 1e-3
"""The same that is assumed at least; with it six equal readings in a thousand are stuck."""

FEWEST_CHANGES: Final = 8
"""Changes in a record from which on they tell that probability; a channel with fewer was stuck beside them."""

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

    The first reading of a run may be sound and is kept. None is told of a channel that never changes (`is_dead`), or
    whose readings rest now and then by their nature: of an encoder, or held between those of a slower converter.

    Parameters
    ----------
    values
        Readings, shape (n,); NaN where missing.
    """
    found = np.zeros(values.size, dtype=bool)
    step = np.diff(values)
    same = step == 0
    changes = int(np.count_nonzero(np.isfinite(step) & ~same))
    if not changes:
        return found
    edges = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not first.size:
        return found
    # a run begins after a change with the probability that the next reading is equal, however long it lasts then
    share = first.size / changes if changes >= FEWEST_CHANGES else 0.0
    if share > MOST_EQUAL:
        return found
    longest = 1 + np.log(CHANCE / values.size) / np.log(max(share, LEAST_EQUAL))
    for start, stop in zip(first, last, strict=True):
        if stop - start + 1 > longest:
            found[start + 1 : stop + 1] = True
    return found
