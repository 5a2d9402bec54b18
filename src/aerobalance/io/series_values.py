"""Samples of series, read as numbers; what is stored together is read once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io.columns import PIECE
from aerobalance.io.format_library import library_faults
from aerobalance.io.measure import beyond_all_measure, squares_within_measure, take_out, within_measure
from aerobalance.io.series import Fills, Series
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality

_FILLED: Final = 1 << 18
"""Samples of a series that are read, and looked at while they are in the cache, at once: what is fastest."""


def read_all(path: Path, series: Sequence[Series]) -> list[Array]:
    """Read the samples of several series, in their order; what is stored together is read once."""
    blocks: dict[tuple[str, int, int], list[int]] = {}
    for place, one in enumerate(series):
        alone = -1 if one.block else place  # labels may repeat themselves
        blocks.setdefault((one.block, one.samples, alone), []).append(place)
    found: dict[int, Array] = {}
    for (_, samples, _), members in blocks.items():
        if len(members) == 1:
            found[members[0]] = read_values(path, series[members[0]])
            continue
        values, within = {place: np.empty(samples) for place in members}, dict.fromkeys(members, True)
        for begin in range(0, samples, PIECE):
            for place in members:
                part = values[place][begin : begin + PIECE]
                _read_into(path, series[place], begin, part)
                within[place] = within[place] and within_measure(part)
        for place, cells in values.items():
            found[place] = cells if within[place] else _taken_out(path, _place(series[place].label), cells)
    return [found[place] for place in range(len(series))]


def _read_into(path: Path, series: Series, begin: int, into: Array) -> None:
    """Read samples of a series into an array, as they are."""
    if series.fill is None or series.stamps:
        into[:] = _as_read(path, series, begin, begin + into.size)
        return
    with library_faults(path, "recordings", _place(series.label)):
        series.fill(begin, into)


def _place(label: str) -> str:
    """A series as a place in a message."""
    return f"channel {label!r}"


def read_part(path: Path, series: Sequence[Series], begin: int, end: int) -> list[Array]:
    """Read the same samples of several series, as `read_values` does.

    They are in one block of memory, which is large enough that the system leaves it to the process for the next part.
    """
    table = np.empty((len(series), end - begin))
    return [read_values(path, one, begin, end, into=row) for one, row in zip(series, table, strict=True)]


def read_values(
    path: Path, series: Series, begin: int = 0, end: int | None = None, *, into: Array | None = None
) -> Array:
    """Read samples of a series as numbers, shape (n,); those beyond all measure are missing.

    Parameters
    ----------
    path
        The file.
    series
        Which.
    begin, end
        The first of them, and that behind the last; all if left out.
    into
        An array that may be used for them.

    Raises
    ------
    ReadError
        The file is damaged there.

    Warns
    -----
    DataQualityWarning
        Numbers beyond all measure count as missing.
    """
    end = series.samples if end is None else end
    if series.fill is None or series.stamps:
        values = _as_read(path, series, begin, end)
        if within_measure(values):
            return values
        return _taken_out(path, _place(series.label), values.copy(), begin)
    with library_faults(path, "recordings", _place(series.label)):
        values = np.empty(end - begin) if into is None else into
        within = _filled(series.fill, begin, values)
    return values if within else _taken_out(path, _place(series.label), values, begin)


def _as_read(path: Path, series: Series, begin: int, end: int) -> Array:
    """Samples of a series as numbers, shape (n,), as they are; they may be the file's own."""
    where = _place(series.label)
    with library_faults(path, "recordings", where):
        given = np.asarray(series.read(begin, end))
        if series.stamps:
            return _seconds(path, series, given, begin)
        values = given if given.dtype == np.float64 else given.astype(np.float64)
    if values.shape != (end - begin,):
        raise ReadError(path, where, f"has {values.size} of {end - begin} samples: the file is damaged")
    return values


def _filled(fill: Fills, begin: int, into: Array) -> bool:
    """Read samples piece by piece; whether all are within measure, looked at as long as they are in the cache."""
    within = True
    for at in range(0, into.size, _FILLED):
        part = into[at : at + _FILLED]
        fill(begin + at, part)
        within = within and squares_within_measure(part)
    return within


def _seconds(path: Path, series: Series, stamps: Any, begin: int) -> Array:
    """Seconds since the first stamp of a series."""
    given = np.asarray(stamps)
    first = given[:1] if begin == 0 else np.asarray(series.read(0, 1))
    if given.dtype.kind not in "mM" or np.isnat(first).any():
        raise ReadError(path, f"channel {series.label!r}", "holds dates and times of which the first is missing")
    seconds: Array = (given - first) / np.timedelta64(1, "s")
    return seconds


def within_reason(path: Path, where: str, values: Array) -> Array:
    """Return samples of which those beyond all measure are missing (NaN), shape (n,); they stay as they are."""
    if within_measure(values):
        return values
    return _taken_out(path, where, values.copy())


def _taken_out(path: Path, where: str, values: Array, begin: int = 0) -> Array:
    """Make samples beyond all measure missing (NaN) where they are, and warn of them; the first is number `begin`."""
    places = take_out(values)
    if places.size:
        warn_quality(f"{path.name}: {beyond_all_measure(places.size, f'{where}, sample {begin + places[0] + 1}')}")
    return values
