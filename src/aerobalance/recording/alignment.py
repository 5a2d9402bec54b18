"""Clocks of several recordings of one event, brought together: by a counter, a trigger, a common signal, or dates."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from aerobalance.recording.clock_correlation import by_correlation
from aerobalance.recording.clock_marks import by_edges, by_ticks
from aerobalance.recording.clock_pair import WAYS, Alignment, Pair, Way
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording


def align(base: Recording, other: Recording, *, way: Way = "auto", by: str | None = None) -> Alignment:
    """Offset [s] and drift [1] of the clock of one recording by that of another.

    Parameters
    ----------
    base
        The recording whose clock counts.
    other
        The one to be aligned.
    way
        ``"tick"``: both have a channel that counts the same clock. ``"trigger"``: both have a channel with the same
        rising edges. ``"correlation"``: both have a channel of the same quantity. ``"start"``: by the date and time
        of both. ``"auto"``: the first of tick, trigger and correlation that both have a channel for.
    by
        The channel; where left out ``tick``, ``trigger``, or the first channel that both have.

    Raises
    ------
    FitError
        The recordings have nothing in common by which this could be told, or it is not certain.
    ValueError
        There is no such way.
    """
    if way not in WAYS:
        raise ValueError(f"align must be one of {', '.join(WAYS)}, not {way}")
    chosen = _way(base, other, by) if way == "auto" else way
    if chosen == "start":
        return _by_dates(base, other)
    name = by or (chosen if chosen != "correlation" else _common(base, other))
    ways: Mapping[str, Callable[[Pair], Alignment]] = {
        "tick": by_ticks,
        "trigger": by_edges,
        "correlation": by_correlation,
    }
    return ways[chosen](Pair(base, other, name, base.channel(name), other.channel(name)))


def _way(base: Recording, other: Recording, by: str | None) -> Way:
    if by is not None:
        return "tick" if by == "tick" else "trigger" if by == "trigger" else "correlation"
    for way in ("tick", "trigger"):
        if way in base and way in other:
            return "tick" if way == "tick" else "trigger"
    return "correlation"


def _common(base: Recording, other: Recording) -> str:
    """First channel that two recordings both have, one that changes."""
    names = [one.name for one in base if one.name in other]
    moving = [
        name for name in names if np.nanstd(base.channel(name).values) > 0 < np.nanstd(other.channel(name).values)
    ]
    if not moving:
        raise FitError(
            f"{base.name} and {other.name} have no channel in common (tick, trigger, or a quantity that both "
            "recorded): name one alike in both by channel maps, or take the dates of the files (start), which are as "
            "good as the clocks of the computers"
        )
    return moving[0]


def _by_dates(base: Recording, other: Recording) -> Alignment:
    if base.epoch is None or other.epoch is None:
        lacking = base if base.epoch is None else other
        raise FitError(f"{lacking.name} does not say at which date and time it was taken; align by a channel instead")
    apart: np.timedelta64 = other.epoch - base.epoch
    offset = float(apart / np.timedelta64(1, "ns")) * 1e-9
    return Alignment(other.name, "start", "", offset, float("nan"), 0.0, float("nan"), other.start, 2)
