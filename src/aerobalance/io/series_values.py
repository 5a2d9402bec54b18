"""Samples of series, read as numbers; what is stored together is read once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aerobalance.io.columns import PIECE
from aerobalance.io.format_library import library_faults
from aerobalance.io.measure import beyond_all_measure, take_out, within_measure
from aerobalance.io.series import Series
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality


def read_all(path: Path, series: Sequence[Series]) -> dict[str, Array]:
    """Read the samples of several series, by label; what is stored together is read once."""
    blocks: dict[tuple[str, int], list[Series]] = {}
    for one in series:
        blocks.setdefault((one.block or one.label, one.samples), []).append(one)
    found = {}
    for (_, samples), members in blocks.items():
        if len(members) == 1:
            found[members[0].label] = read_values(path, members[0])
            continue
        values = {one.label: np.empty(samples) for one in members}
        for begin in range(0, samples, PIECE):
            part = slice(begin, min(begin + PIECE, samples))
            for one in members:
                values[one.label][part] = read_values(path, one, part.start, part.stop)
        found |= values
    return found


def read_values(path: Path, series: Series, begin: int = 0, end: int | None = None) -> Array:
    """Read samples of a series as numbers, shape (n,); those beyond all measure are missing.

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
    where = f"channel {series.label!r}"
    with library_faults(path, "recordings", where):
        given = np.asarray(series.read(begin, end))
        if series.stamps:
            return _seconds(path, series, given, begin)
        values = given if given.dtype == np.float64 else given.astype(np.float64)
    if values.shape != (end - begin,):
        raise ReadError(path, where, f"has {values.size} of {end - begin} samples: the file is damaged")
    return within_reason(path, where, values)


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
    found = values.copy()
    places = take_out(found)
    if places.size:
        warn_quality(f"{path.name}: {beyond_all_measure(places.size, f'{where}, sample {places[0] + 1}')}")
    return found
