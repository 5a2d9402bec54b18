"""Numbers that no reading is: they count as missing, wherever they come from."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

LARGEST: Final = 1e100
"""Numbers beyond this are no measurement, and their squares no number."""


def beyond_all_measure(count: int, where: str) -> str:
    """Return the sentence that cells or samples hold numbers beyond `LARGEST`, and what becomes of them."""
    return (
        f"{count} number(s) beyond {LARGEST:.0e} either way, which no reading is, the first in {where}: "
        "they count as missing"
    )


def within_measure(values: Array) -> bool:
    """Return whether no number is beyond `LARGEST`, by one pass over readings that are all there.

    Where some are missing or infinite, or their squares add up to more, it is False without that being so.
    """
    flat = np.ascontiguousarray(values).ravel()
    with np.errstate(all="ignore"):
        # not by the linear algebra, whose threads would wait for the next array in a busy loop
        return float(np.einsum("i,i->", flat, flat)) < LARGEST * LARGEST


def without_infinities(values: Array) -> Array:
    """Return numbers of which infinities are missing (NaN), shape (n,): themselves where there is none."""
    return values if np.isfinite(values).all() else np.where(np.isfinite(values), values, np.nan)


def take_out(values: Array) -> NDArray[np.intp]:
    """Make numbers beyond `LARGEST` and infinities missing (NaN) where they are, shape (n,).

    Returns
    -------
    places
        Those of them that were finite, to be warned of.
    """
    if within_measure(values):
        return np.empty(0, dtype=np.intp)
    with np.errstate(all="ignore"):
        beyond = np.abs(values) > LARGEST
    places = np.flatnonzero(beyond & ~np.isinf(values))
    values[beyond] = np.nan
    return places
