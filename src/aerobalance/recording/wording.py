"""Numbers in messages: what a record tells well enough to be said, and words for what it does not tell."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

TOLD: Final = 2.0
"""Standard uncertainties that a number must exceed to be said."""

SURE: Final = 0.1
"""Relative standard uncertainty of a frequency up to which it is said with its uncertainty."""

_NUMBER: Final = re.compile(r"(?<![\w.])\d[\d.,]*(?:e[+-]?\d+)?")
"""A number, and no digit of a name such as N1."""

NOT_TOLD: Final = "cannot be told from this record"


def told(value: float, u: float, *, most: float = np.inf) -> bool:
    """Return whether a value is more than chance, finite, and within what is physically possible."""
    return bool(np.isfinite(value) and np.isfinite(u) and abs(value) > TOLD * u and abs(value) <= most)


def with_u(value: float, u: float, unit: str = "") -> str:
    """Return a value, to two digits of its standard uncertainty, with its unit and that uncertainty."""
    behind = f" {unit}" if unit else ""
    if not (np.isfinite(value) and 0 < u < np.inf):
        return f"{value:.6g}{behind}"
    places = 1 - int(np.floor(np.log10(u)))
    digits = f"{value:.{places}f}" if places > 0 else f"{round(value, places):.0f}"
    return f"{digits}{behind} (u = {u:.2g})"


def share_text(share: float, u: float) -> str:
    """Return a mode's share of a steady load in words; it cannot be more than all of it."""
    if told(share, u, most=1.0):
        return f"{100 * share:.2g} % of a steady load"
    return f"whose share of a steady load {NOT_TOLD}"


def frequency_text(frequency: float, u: float) -> str:
    """Return a frequency in words, with its uncertainty where that is small beside it."""
    if np.isfinite(u) and u <= SURE * frequency:
        return f"{frequency:.4g} Hz (u = {u:.2g} Hz)"
    return f"about {frequency:.2g} Hz"


def damping_text(damping: float, u: float, *, critical: float) -> str:
    """Return a damping in words, or what it stays below; critical damping is more than any balance has.

    Parameters
    ----------
    damping, u
        The damping found and its standard uncertainty [N*s/m].
    critical
        Critical damping [N*s/m].
    """
    if told(damping, u):
        return f"{damping:.3g} give or take {u:.2g}"
    most = damping + TOLD * u
    if np.isfinite(most) and most < critical:
        return f"it {NOT_TOLD} but for being less than {most / critical:.2g} of critical damping"
    return f"it {NOT_TOLD}"


def percent_text(part: float, *, most: float) -> str:
    """Return a part in percent, or that it is more than what means something."""
    return f"{100 * part:.2g} %" if part <= most else f"more than {100 * most:g} %"


def without_numbers(text: str) -> str:
    """Return a text with a sign in the place of each number: what is said alike of other samples has the same."""
    return _NUMBER.sub("#", text)


def last_number(text: str) -> float:
    """Return the last number of a text; 0 where it has none."""
    numbers = _NUMBER.findall(text)
    return float(numbers[-1].rstrip(".,").replace(",", "")) if numbers else 0.0
