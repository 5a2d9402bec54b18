"""Tables and recordings in SI units, made from the columns of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.columns import RawColumn, RawColumns
from aerobalance.io.measure import within_measure
from aerobalance.recording.channel import Array, Channel, SensorSpec
from aerobalance.recording.errors import FitError, OfMissing, ReadError, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import ALLOWED, conversion_for, expected_unit


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One column of a table.

    Attributes
    ----------
    name
        Header without its unit.
    values
        Cells, shape (n,), in `unit`.
    unit
        Unit inside (SI; mV/V for gauge outputs).
    file_unit
        Unit in the file.
    place
        The column as a place in an error message.
    sensor
        What the file says of how the column was measured, in `unit`; it may lag the rows it stands in.
    """

    name: str
    values: Array
    unit: str
    file_unit: str
    place: str
    sensor: SensorSpec = field(default_factory=SensorSpec)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of numbers by name, in SI units.

    Attributes
    ----------
    path
        The file.
    columns
        The columns by name, of n cells each.
    lines
        Line of the file that each row stands in.
    epoch
        Date and time at which the time is zero; None where the file does not say it.
    """

    path: Path
    columns: Mapping[str, Column]
    lines: Sequence[int] | NDArray[np.intp]
    epoch: np.datetime64 | None = None

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def column(self, name: str) -> Column:
        """Return one column.

        Raises
        ------
        ReadError
            The table has no such column; the message lists those it has.
        """
        if name not in self.columns:
            raise ReadError(self.path, "header", f"has no column {name}; it has {', '.join(self.columns)}")
        return self.columns[name]

    def values(self, name: str) -> Array:
        """Return the cells of one column, shape (n,), in its unit inside.

        Raises
        ------
        ReadError
            The table has no such column.
        """
        return self.column(name).values


def table_from(raw: RawColumns, *, required: Sequence[str] = (), missing_allowed: bool = False) -> Table:
    """Give every column its name, and turn its values into the unit used inside.

    Parameters
    ----------
    raw
        Columns with headers ``name [unit]``.
    required
        Names of columns that must be there.
    missing_allowed
        Whether cells may be missing (NaN then).

    Raises
    ------
    ReadError
        A column has no name or unit, has a name twice, or has a unit that is unknown or of another kind; a
        required column is not there; a cell is missing.
    """
    columns: dict[str, Column] = {}
    if raw.rate is not None:
        stamps = raw.start + (np.arange(raw.rows) if raw.ticks is None else raw.ticks) / raw.rate
        columns["time"] = Column("time", stamps, "s", "s", "the clock that the file states")
    for column in raw.columns:
        if not column.label and not np.isfinite(column.values).any():
            continue  # the separator at the end of every line that some programs write
        name = _checked_name(raw.path, column, columns)
        try:
            change = conversion_for(name, column.unit)
        except ValueError as error:
            raise ReadError(raw.path, f"header, {column.place}", str(error)) from None
        sensor = SensorSpec(**column.sensor.known(factor=change.factor))
        columns[name] = Column(name, change.inside(column.values), change.unit, column.unit, column.place, sensor)
    table = Table(raw.path, columns, raw.lines, raw.epoch)
    for name in required:
        table.column(name)
    if not missing_allowed:
        for found in columns.values():
            if not np.isfinite(found.values).all():
                line = raw.lines[int(np.flatnonzero(~np.isfinite(found.values))[0])]
                raise ReadError(raw.path, f"line {line}, {found.place}", "the cell is missing; a number is needed")
    return table


def _checked_name(path: Path, column: RawColumn, known: Mapping[str, Column]) -> str:
    where = f"header, {column.place}"
    if not column.name:
        raise ReadError(path, where, "the column has no name; write name [unit], for example AF [N]")
    if not column.unit:
        unit = expected_unit(column.name)
        example = {"rad": "deg", None: "N"}.get(unit, unit)
        allowed = f"; allowed: {ALLOWED[unit]}" if unit else ""
        raise ReadError(
            path,
            where,
            f"the unit is missing; write name [unit], for example {column.name} [{example}]{allowed} "
            "(or describe the file in a channel map, which `aerobalance map FILE` makes)",
        )
    if column.name in known:
        raise ReadError(path, where, f"there is a column {column.name} already ({known[column.name].place})")
    return column.name


def recording_from(table: Table, *, rate: float | None = None, ticks: NDArray[np.intp] | None = None) -> Recording:
    """Put the columns of a table on the clock of its column ``time``.

    Parameters
    ----------
    table
        With a column ``time``.
    rate
        Sampling rate that the file states [Hz], of which ``time`` was made; None where ``time`` was read.
    ticks
        Sample of the steady clock that each row stands for, where the file states it.

    Raises
    ------
    ReadError
        There is no time column, or it does not increase; there is nothing beside it.
    """
    time = table.column("time") if "time" in table else _no_time(table)
    channels = channels_of(table)
    check_time(table.path, time, table.lines)
    return on_clock(
        table.path, time.values, channels, time_unit=time.file_unit, rate=rate, ticks=ticks, epoch=table.epoch
    )


def channels_of(table: Table) -> dict[str, Channel]:
    """Channels of the columns of a table beside the time.

    Raises
    ------
    ReadError
        There is none.
    """
    channels = {
        name: Channel(name, column.values, column.unit, file_unit=column.file_unit, **column.sensor.known())
        for name, column in table.columns.items()
        if name != "time"
    }
    if not channels:
        raise ReadError(
            table.path, "header", "has a time column only; at least one channel is needed, for example AF [N]"
        )
    return channels


def _no_time(table: Table) -> NoReturn:
    raise ReadError(
        table.path,
        "header",
        f"has no column time [s] (or ms, us), which a recording needs; it has {', '.join(table.columns)}; give the "
        "rate, or say which column is the time, in a channel map, which `aerobalance map FILE` makes",
    )


def check_time(path: Path, time: Column, lines: Sequence[int] | NDArray[np.intp]) -> None:
    """Refuse a time column that lacks a cell or goes back.

    Raises
    ------
    ReadError
        With the line.
    """
    if time.values.size < 2:
        raise ReadError(path, "", f"has {time.values.size} row(s) of samples; a recording needs at least two")
    gaps = np.flatnonzero(~np.isfinite(time.values))
    if gaps.size:
        raise ReadError(path, f"line {lines[int(gaps[0])]}, {time.place}", "the time is missing; a number is needed")
    steps = np.diff(time.values)
    back = np.flatnonzero(steps < 0) if (steps > 0).any() else np.flatnonzero(steps <= 0)
    if back.size:
        i = int(back[0])
        raise ReadError(
            path,
            f"line {lines[i + 1]}, {time.place}",
            f"time must increase from row to row, but is {time.values[i + 1]:.9g} s after "
            f"{time.values[i]:.9g} s in line {lines[i]}",
        )


def on_clock(
    path: Path,
    stamps: Array,
    channels: Mapping[str, Channel],
    *,
    time_unit: str = "s",
    rate: float | None = None,
    ticks: NDArray[np.intp] | None = None,
    epoch: np.datetime64 | None = None,
) -> Recording:
    """Make the recording; warn of samples that are missing or rest on a limit.

    Where the file states the rate, that is the clock, and none is fitted to the stamps.

    Raises
    ------
    ReadError
        No steady clock fits the time column.
    """
    for channel in channels.values():
        if channel.missing.all():
            raise ReadError(path, f"column {channel.name}", "has no number in it; leave the column out")
        warn_of_missing(path, channel)
    try:
        if rate is None:
            recording = Recording.from_columns(stamps, channels, name=path.name, time_unit=time_unit)
        else:
            rows = np.arange(stamps.size) if ticks is None else ticks
            channels = channels if ticks is None else _placed(path, channels, ticks)
            recording = Recording(path.name, stamps, rows, float(stamps[0]), rate, channels, time_unit=time_unit)
    except FitError as error:
        text = str(error).removeprefix(f"{path.name}: ")
        raise ReadError(path, "time column", text) from None
    for channel in recording:
        warn_of_limit(path, channel)
    return recording if epoch is None else replace(recording, epoch=epoch)


RESTS_ON_LIMIT: Final = "rests on its limit"
"""What is said of a channel that does."""


def warn_of_missing(path: Path, channel: Channel) -> None:
    """Warn of readings that are missing in rows that are there."""
    if within_measure(channel.values):  # which takes a third of the time
        return
    count = int(np.count_nonzero(channel.missing))
    if count:
        warn_quality(OfMissing.readings(path.name, channel.name, count, channel.values.size))


def warn_of_limit(path: Path, channel: Channel) -> None:
    """Warn of readings that rest on a limit."""
    if expected_unit(channel.name) in (None, "rad"):
        return
    count = int(np.count_nonzero(channel.saturated))
    if count:
        warn_quality(
            f"{path.name}: {channel.name} {RESTS_ON_LIMIT} in {count} samples (saturated); the signal went "
            "further than was recorded: force takes these samples for missing, every other result from them is "
            "too small"
        )


def _placed(path: Path, channels: Mapping[str, Channel], ticks: NDArray[np.intp]) -> dict[str, Channel]:
    """Put the rows of all channels where they belong on the steady clock; what is between them is missing."""
    size = int(ticks[-1]) + 1
    missing = size - ticks.size
    if missing:
        warn_quality(
            f"{path.name}: {missing} sample(s) are missing in {int(np.count_nonzero(np.diff(ticks) > 1))} gap(s); "
            "the model bridges them, with a larger uncertainty"
        )
    placed = {}
    for name, channel in channels.items():
        values = np.full(size, np.nan)
        values[ticks] = channel.values
        placed[name] = replace(channel, values=values)
    return placed
