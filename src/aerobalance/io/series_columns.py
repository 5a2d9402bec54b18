"""Columns of the series of a file: which are wanted, which of them is the time, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NoReturn

import numpy as np

from aerobalance.io.columns import Clock, RawColumn, RawColumns
from aerobalance.io.format_library import library_faults
from aerobalance.io.series import Holdings, Series, by_label
from aerobalance.io.series_values import read_all, read_values
from aerobalance.recording.channel import QUANTITIES, is_ground_acceleration
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import ReadError, argument, warn_quality
from aerobalance.recording.units import conversion

STEADY: Final = 0.1
"""Sampling intervals by which stamps may depart from a steady clock."""


def columns_of(
    path: Path, found: Holdings, wanted: Sequence[str | int] | None, *, clocked: bool = False
) -> RawColumns:
    """Read the samples of series as columns, with what the file says of their clock.

    Series that share one series of times, or have none, stand beside it; those that have clocks or times of their own
    keep them as a clock each.

    Parameters
    ----------
    path
        The file.
    found
        What it holds.
    wanted
        Series to read, by label, name, alias or number. None for a file that needs no channel map: then every series
        of numbers is read, each must have a unit, and one at least must be known to the program.
    clocked
        Whether somebody else says what the clock is.

    Raises
    ------
    ReadError
        A series is not there, is no readings over time, or needs a channel map.

    Warns
    -----
    DataQualityWarning
        Numbers beyond all measure count as missing.
    """
    chosen = chosen_series(path, found, wanted)
    for _, series in chosen:
        if series.fault:
            raise ReadError(path, f"channel {series.label!r}", f"{series.fault}; readings over time are needed")
    for text in found.remarks:
        warn_quality(f"{path.name}: {text}")
    times = {series.axis for _, series in chosen if series.axis}
    channels = [series for _, series in chosen if series.label not in times]
    axes = set() if clocked else {series.axis for series in channels if series.clock is None}
    if len(axes) == 1 and "" not in axes and all(series.clock is None for series in channels):
        return _on_one_axis(path, found, chosen, next(iter(axes)), named=wanted is None)
    clocks = {axis: _clock_of(path, by_label(found, axis)) for axis in axes if axis}
    values = read_all(path, [series for _, series in chosen])
    columns = tuple(
        replace(bare_column(number, series), values=one, clock=series.clock or clocks.get(series.axis))
        for (number, series), one in zip(chosen, values, strict=True)
    )
    most = max((column.values.size for column in columns), default=0)
    return RawColumns(path, columns, range(1, most + 1), epoch=found.epoch)


def chosen_series(path: Path, found: Holdings, wanted: Sequence[str | int] | None) -> list[tuple[int, Series]]:
    """Return the series that are wanted, with their numbers."""
    numbered = list(enumerate(found.series, start=1))
    if wanted is None:
        return _described(path, found, numbered)
    shown = [(number, series) for number, series in numbered if not series.hidden]
    bare = tuple(bare_column(number, series) for number, series in shown)
    stub = RawColumns(path, bare, range(0))
    numbers = {stub.find(key, where="channels").number for key in wanted}
    return [(number, series) for number, series in numbered if number in numbers]


def _described(path: Path, found: Holdings, numbered: Sequence[tuple[int, Series]]) -> list[tuple[int, Series]]:
    """Choose the series of a file that needs no channel map."""
    times = {series.axis for series in found.series}
    usable = [
        (number, series)
        for number, series in numbered
        if not series.fault and not series.hidden and series.label not in times
    ]
    needed = (
        f"a channel map is needed, which `aerobalance map FILE` makes (then give it with {argument('channel_map')})"
    )
    known = [one for one in usable if is_known(one[1].name)]
    if not known:
        names = ", ".join(repr(series.label) for _, series in usable[:12]) or "none with numbers over time"
        more = f" and {len(usable) - 12} more" if len(usable) > 12 else ""
        raise ReadError(path, "channels", f"none of them ({names}{more}) has a name that the program knows; {needed}")
    for _, series in usable:
        if not series.unit:
            raise ReadError(
                path, f"channel {series.label!r}", f"the file does not say what it is: no unit is stated; {needed}"
            )
    return usable


def is_known(name: str) -> bool:
    """Return whether a channel of this name is one that the program understands."""
    return name in QUANTITIES or is_gauge(name) or is_ground_acceleration(name)


def bare_column(number: int, series: Series) -> RawColumn:
    """Column of a series without its cells."""
    return RawColumn(
        series.label,
        series.name,
        series.unit_as_read,
        np.empty(0),
        number,
        alias=series.alias,
        sensor=series.sensor,
        stamped=series.stamps,
    )


def _on_one_axis(
    path: Path, found: Holdings, chosen: Sequence[tuple[int, Series]], label: str, *, named: bool
) -> RawColumns:
    """Columns beside their one column of times."""
    axis = by_label(found, label)
    place = 1 + found.series.index(axis)
    others = [(number, series) for number, series in chosen if number != place]
    stamps, *values = read_all(path, [axis, *(series for _, series in others)])
    columns = [
        replace(bare_column(number, series), values=one) for (number, series), one in zip(others, values, strict=True)
    ]
    time = replace(bare_column(place, axis), values=stamps)
    columns.insert(0, replace(time, name="time") if named else time)
    rows = range(1, columns[0].values.size + 1)
    return RawColumns(path, tuple(columns), rows, time=place, epoch=axis_epoch(path, found, axis))


def axis_epoch(path: Path, found: Holdings, axis: Series) -> np.datetime64 | None:
    """Date and time at which the times of an axis are zero: the first of its stamps, or what the file says."""
    if not axis.stamps or not axis.samples:
        return found.epoch
    with library_faults(path, "dates and times", f"channel {axis.label!r}"):
        first: np.datetime64 = np.asarray(axis.read(0, 1)).astype("datetime64[ns]")[0]
    return None if np.isnat(first) else first


def _clock_of(path: Path, axis: Series) -> Clock:
    """Return the steady clock of a series of times, where others have one of their own."""
    times = read_values(path, axis)
    if not axis.unit_as_read:
        _unit_needed(path, axis)
    seconds = conversion(axis.unit_as_read, expected="s").inside(times)
    index = np.arange(seconds.size)
    if seconds.size < 2 or not np.isfinite(seconds).all():
        raise ReadError(path, f"channel {axis.label!r}", "is a column of times, and some of its times are missing")
    interval = float(seconds[-1] - seconds[0]) / (seconds.size - 1)
    departure = float(np.abs(seconds - seconds[0] - index * interval).max())
    if not interval > 0 or not departure < STEADY * interval:
        raise ReadError(
            path,
            f"channel {axis.label!r}",
            "is no steady clock, and other channels have another clock: give the channels of each in a map of its "
            "own, and put the files together with `aerobalance convert A B`",
        )
    return Clock(float(seconds[0]), interval)


def _unit_needed(path: Path, axis: Series) -> NoReturn:
    raise ReadError(
        path,
        f"channel {axis.label!r}",
        "is the time, but the file does not say its unit; put time and time_unit under [file] of a channel map",
    )
