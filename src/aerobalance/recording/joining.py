"""Several recordings of one event, made one on one clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.recording.alignment import align
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.clock_pair import Alignment, Way
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import EDGE, at_places, interpolate_gaps_linearly

PIECE: Final = 1 << 17
"""Samples that are resampled at once."""

BESIDE: Final = 1
"""Samples next to a missing one whose neighbourhood is not resampled but missing too."""


@dataclass(frozen=True, slots=True)
class Joined:
    """Recordings that were made one.

    Attributes
    ----------
    recording
        All their channels on the clock of the fastest.
    base
        Name of that one.
    alignments
        How the clocks of the others go by its own.
    """

    recording: Recording
    base: str
    alignments: tuple[Alignment, ...]


def join(recordings: Sequence[Recording], *, way: Way = "auto", by: str | None = None) -> Joined:
    """Recordings of one event, which have clocks of their own, on the clock of the fastest.

    The others are resampled once, straight from their own samples to the instants of that clock: by a sinc
    under a Kaiser window (parameter 12, 10 samples either side) to four times their own rate, and a
    cubic spline between these. That is exact to 3e-6 up to 0.3 of their own rate; since the clock is faster than
    theirs, no filter has to take anything away. What is next to a missing sample is missing.
    The recording spans the time that all of them have in common.

    Parameters
    ----------
    recordings
        Two or more. A channel that several have is that of the clock's recording; those of the others have their
        number in the name.
    way, by
        As in `aerobalance.recording.alignment.align`.

    Raises
    ------
    FitError
        The recordings have nothing in common that tells how their clocks go, or no time in common.
    ValueError
        There are less than two.

    Warns
    -----
    DataQualityWarning
        What was found of each; samples outside the time in common are left out.
    """
    if len(recordings) < 2:
        raise ValueError("two recordings or more are needed to be aligned")
    place = max(range(len(recordings)), key=lambda i: (recordings[i].rate, -i))
    base = recordings[place]
    found = [(number, one, align(base, one, way=way, by=by)) for number, one in _others(recordings, place)]
    begin, end = _common_span(base, found)
    kept = base.part(begin, end)
    kept = replace(kept, extent=base.extent)
    channels = dict(kept.channels)
    for number, one, alignment in found:
        places = (alignment.back(kept.time) - one.start) * one.rate
        for channel in one:
            if channel.name != alignment.by:
                name, count = channel.name, number
                while name in channels:
                    name, count = f"{channel.name}_{count}", count + 1
                channels[name] = _resampled(channel, name, places)
    lost = base.samples - (end - begin)
    if lost:
        warn_quality(
            f"{base.name}: {lost} of {base.samples} samples are left out, as the other recordings do not cover their "
            "time"
        )
    return Joined(replace(kept, channels=channels), base.name, tuple(alignment for *_, alignment in found))


def _others(recordings: Sequence[Recording], place: int) -> list[tuple[int, Recording]]:
    return [(number, one) for number, one in enumerate(recordings, start=1) if number != place + 1]


def _common_span(base: Recording, found: Sequence[tuple[int, Recording, Alignment]]) -> tuple[int, int]:
    """First sample of a recording that the others cover, and the one after the last."""
    begin, end = 0.0, float(base.samples - 1)
    for _, one, alignment in found:
        ends = alignment.onto(np.array([one.time[0], one.time[-1]]))
        first, last = (ends - base.start) * base.rate
        begin, end = max(begin, first), min(end, last)
    first_sample, last_sample = int(np.ceil(begin - 1e-6)), int(np.floor(end + 1e-6))
    if last_sample - first_sample < 1:
        names = ", ".join(one.name for _, one, _ in found)
        raise FitError(f"{base.name} and {names} have no time in common once they are aligned")
    return first_sample, last_sample + 1


def _resampled(channel: Channel, name: str, places: Array) -> Channel:
    """A channel at any places between its samples, a piece at a time."""
    values = np.empty(places.size)
    missing = channel.missing
    filled = interpolate_gaps_linearly(channel.values) if missing.any() else channel.values
    for first in range(0, places.size, PIECE):
        part = slice(first, min(first + PIECE, places.size))
        low = max(0, int(places[part][0]) - 2 * EDGE)
        high = min(filled.size, int(places[part][-1]) + 2 * EDGE + 2)
        values[part] = at_places(filled[low:high], places[part] - low)[0]
    if missing.any():
        near = np.convolve(missing, np.ones(2 * BESIDE + 1), "same") > 0
        index = np.clip(np.rint(places).astype(np.intp), 0, missing.size - 1)
        values[near[index]] = np.nan
    return replace(channel, name=name, values=values)


def account(joined: Joined) -> list[dict[str, object]]:
    """What was found of each clock, as plain data: offsets [s], drifts [1], None where they cannot be known."""

    def known(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return [
        {
            "file": one.name,
            "onto": joined.base,
            "way": one.way,
            "by": one.by,
            "offset": one.offset,
            "u_offset": known(one.u_offset),
            "drift": one.drift,
            "u_drift": known(one.u_drift),
            "points": one.points,
        }
        for one in joined.alignments
    ]
