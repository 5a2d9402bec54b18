"""Numbers that no reading is: they count as missing, wherever they come from."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

LARGEST: Final = 1e100
"""Numbers beyond this are no measurement, and their squares no number."""


_AT_ONCE: Final = 1 << 13
"""Numbers whose squares are added up at once: for more, linear algebra takes threads, which wait in a busy loop."""


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
    with np.errstate(all="ignore"):
        return squares_within_measure(np.ascontiguousarray(values).ravel())


def squares_within_measure(flat: Array) -> bool:
    """Return what `within_measure` does of a plain array, shape (n,); floating-point errors are the caller's."""
    whole = flat.size - flat.size % _AT_ONCE
    rows = flat[:whole].reshape(-1, _AT_ONCE)
    total = sum(np.vecdot(rows, rows).tolist())
    if whole < flat.size:
        rest = flat[whole:]
        total += float(np.vecdot(rest, rest))
    return bool(total < LARGEST * LARGEST)


def rows_within_measure(rows: Array) -> bool:
    """Return what `within_measure` does of rows that are in one piece each, shape (k, n)."""
    with np.errstate(all="ignore"):
        if rows.shape[1] > _AT_ONCE:
            return all(map(squares_within_measure, rows))
        return bool(sum(np.vecdot(rows, rows).tolist()) < LARGEST * LARGEST)


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
        beyond = np.flatnonzero(np.abs(values) > LARGEST)
    places = beyond[np.isfinite(values[beyond])]
    values[beyond] = np.nan
    return places
