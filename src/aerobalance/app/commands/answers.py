"""The short answer of a command: numbers rounded to what is known of them, in small tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aerobalance.app.commands.shared import table_text

QUANTITY = ("", "value", "u", "unit")
"""Headings of a table with one quantity a line; u is the standard uncertainty."""

_PLAIN = 1e9


def rounded(value: float, u: float) -> tuple[str, str]:
    """Return a value and its standard uncertainty as texts: two digits of the uncertainty, and the value as far.

    A value that is exact (u is zero), or of which nothing is known (u is not finite), has six digits.
    """
    if not np.isfinite(value) or not (0 < u < np.inf):
        return short(value), "0" if u == 0 else "-"
    places = 1 - int(f"{u:.1e}".split("e")[1])  # the exponent after rounding: 0.0996 has 0.10
    if places > 9 or abs(value) >= _PLAIN or u >= _PLAIN:
        digits = max(0, min(14, int(np.floor(np.log10(max(abs(value), u)))) + places))
        return f"{value + 0.0:.{digits}e}", f"{u:.1e}"
    return _fixed(value, places), _fixed(u, places)


def short(value: float | None, digits: int = 6) -> str:
    """Return a number of which no uncertainty is known as a text, a dash where there is none."""
    if value is None or not np.isfinite(value):
        return "-"
    return f"{float(value) + 0.0:.{digits}g}"


def _fixed(value: float, places: int) -> str:
    text = f"{round(value, places):.{max(0, places)}f}"
    return text if float(text) else text.lstrip("-")  # no minus before zeros alone


def quantities(found: Mapping[str, Any], names: Mapping[str, str] | None = None) -> list[tuple[str, str, str, str]]:
    """Return the rows of a table of quantities: name, value, standard uncertainty and unit.

    Parameters
    ----------
    found
        Entries ``{"value", "u", "unit"}`` by key; others are passed over.
    names
        What to call them, in this order; None calls them by their keys.
    """
    chosen = {key: key.replace("_", " ") for key in found} if names is None else names
    rows = []
    for key, name in chosen.items():
        entry = found.get(key)
        if isinstance(entry, dict) and isinstance(entry.get("value"), (int, float)):
            value, u = rounded(entry["value"], entry.get("u", np.nan))
            rows.append((name, value, u, entry.get("unit", "") or ""))
    return rows


def quantity_table(title: str, rows: Sequence[Sequence[str]]) -> str:
    """Lay quantities out, one a line; the table says what u is."""
    return table_text(f"{title}; u is the standard uncertainty", QUANTITY, rows)
