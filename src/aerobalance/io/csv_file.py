"""Plain CSV: text columns with a header ``name [unit]`` per column."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.clocks import steady_clock_of
from aerobalance.io.columns import Append, Clock, Heading, RawColumns
from aerobalance.io.measure import without_infinities
from aerobalance.io.safe_write import replacing
from aerobalance.io.series import Matrix, Series
from aerobalance.io.series_record import SeriesRecord, seconds
from aerobalance.io.table import Table, table_from
from aerobalance.io.text_clock import ALIKE, UNITS_OF_TIME, FoundClock
from aerobalance.io.text_layout import Layout, TextLayout
from aerobalance.io.text_parts import long_text
from aerobalance.io.text_table import (
    chosen_columns,
    describe_text,
    guess_encoding,
    heads_of,
    read_text_columns,
    read_text_table,
)
from aerobalance.io.toml_file import quoted
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality
from aerobalance.recording.units import expected_unit

NAME: Final = "CSV text"
"""What to call the format in messages."""

SUFFIXES: Final = {".csv": ",", ".txt": "\t", ".tsv": "\t"}
"""File name endings that are written in this format, and the separator of each."""


KEEPS_SENSORS: Final = False
KEEPS_EPOCH: Final = False

_HELD: Final = {
    "text": "holds text",
    "stamp": "holds dates and times",
    "missing": "holds nothing at the head of the file",
}


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is text, from its first bytes; its name does not matter."""
    del path
    return guess_encoding(head) is not None


def read_columns(path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None) -> RawColumns:
    """Read the columns of a text file as they are, and find its clock.

    Where all columns are read, the column of times is called ``time``, columns that hold no number are left out if the
    program does not know their names, and a rate that the text before the header states is the clock of a file
    without times. See `aerobalance.io.text_table.read_text_columns`.

    Raises
    ------
    ReadError
        The file is no table of numbers, or its clock is not certain.

    Warns
    -----
    DataQualityWarning
        Columns are left out; two statements of the clock disagree.
    """
    given = layout or Layout()
    raw, found = read_text_table(
        path, layout, wanted=wanted, texts_dropped=wanted is None, clock_wanted=not given.clocked
    )
    return _with_clock(raw, found, given, named=wanted is None)


@contextmanager
def opened_parts(path: Path, channel_map: ChannelMap | None) -> Iterator[SeriesRecord | None]:
    """Read a long file into one of its numbers, to read parts of that; None where it must be read whole.

    It is read whole where a column holds anything but numbers, where its clock is not steady, and where the map has
    the time as a column or derives a channel.

    Raises
    ------
    ReadError
        The file is no table of numbers, or its clock is not certain.
    """
    with ExitStack() as stack:
        yield None if channel_map is not None and channel_map.needs_all else _record(path, channel_map, stack)


def _record(path: Path, channel_map: ChannelMap | None, stack: ExitStack) -> SeriesRecord | None:
    layout, wanted = (Layout(), None) if channel_map is None else (channel_map.layout, channel_map.wanted)
    long = long_text(path, layout)
    if long is None or (long.found.header_line == 0 and layout.header_line is None and wanted is None):
        return None
    found = long.found
    chosen = chosen_columns(path, found, wanted, clock_wanted=not layout.clocked)
    if any(found.kinds[i] != "number" for i in chosen):
        return None
    table = stack.enter_context(long.table(chosen))
    if table is None or table.shape[0] < 2:
        return None
    heads = heads_of(found)
    bare = RawColumns(path, tuple(heads[i] for i in chosen), range(1, table.shape[0] + 1))
    raw = _with_clock(bare, found, layout, named=wanted is None)
    times = [column.number for column in raw.columns if column.name == "time"] if raw.rate is None else []
    number = raw.time or next(iter(times), None)
    matrix = Matrix(table)
    series = {
        column.number: Series(
            column.label, column.name, column.unit, table.shape[0], matrix.reader(chosen.index(column.number - 1))
        )
        for column in raw.columns
    }
    rate = layout.rate or raw.rate
    axis = series.pop(number, None) if number is not None and rate is None else None
    clock = Clock(0.0 if layout.rate else raw.start, 1 / rate) if rate else None
    if axis is not None and axis.unit:
        clock = steady_clock_of(lambda begin, end: seconds(path, axis, begin, end), axis.samples)
    if clock is None or not series:
        return None
    return SeriesRecord(path, tuple(series.items()), clock, axis, channel_map, None)


def _with_clock(raw: RawColumns, found: TextLayout, given: Layout, *, named: bool) -> RawColumns:
    """Give columns the clock of their file, unless somebody says it or they have a column that is called time."""
    _compare_clocks(raw.path, found, given)
    plain = any(column.name == "time" and not column.stamped for column in raw.columns) and named
    if given.clocked or plain:
        return raw
    return _clocked(raw, found, named=named)


def _compare_clocks(path: Path, found: TextLayout, given: Layout) -> None:
    """Warn where a rate that somebody says, a rate that the file states and its column of times disagree.

    Raises
    ------
    ReadError
        The column would agree in another unit of time than the one that is said of it.
    """
    clock, stated = found.clock, found.stated
    if clock is not None and given.time_unit and not clock.stamps:
        clock = replace(clock, unit=given.time_unit)
    said = given.rate or (stated.rate if stated else None)
    if said is None:
        return
    source = "the channel map says" if given.rate else f"line {stated.line} says" if stated else ""
    other = advice = ""
    if clock is not None and not clock.agrees(said):
        label = found.labels[clock.column]
        rate = clock.rate
        _check_unit_of_times(path, clock, label, source=source, said=said)
        other = f"column {clock.column + 1} ({label!r}) steps by {clock.interval:.6g} {clock.unit}".rstrip()
        other += "" if rate is None else f", which is {rate:.6g} Hz"
        advice = f"; put time = {quoted(label)} under [file] in place of rate" if given.rate else ""
        advice = advice or "; the column of times is taken"
    elif given.rate and stated and abs(given.rate / stated.rate - 1) > ALIKE:
        other, advice = f"line {stated.line} says {stated.rate:.6g} Hz", "; the channel map is taken"
    if other:
        warn_quality(f"{path.name}: {source} {said:.6g} Hz, but {other}{advice}")


def _check_unit_of_times(path: Path, clock: FoundClock, label: str, *, source: str, said: float) -> None:
    """Refuse a column of times that disagrees with a rate by just what another unit of time makes."""
    fitting = [unit for unit in UNITS_OF_TIME if clock.unit and replace(clock, unit=unit).agrees(said)]
    if not fitting or clock.stamps or clock.second_time is not None or clock.rate is None:
        return
    unit = fitting[0]
    raise ReadError(
        path,
        f"column {clock.column + 1} ({label!r})",
        f"steps by {clock.interval:.6g} {clock.unit}, which is {clock.rate:.6g} Hz, but {source} {said:.6g} Hz: the "
        f"times are in {unit}, or one of the two is wrong. Allowed are a unit and a rate that agree: write the unit "
        f"[{unit}] in the header, or put time = {quoted(label)} and time_unit = {quoted(unit)} (without rate) under "
        "[file] of a channel map, which `aerobalance map FILE` makes; or correct the rate",
    )


def _clocked(raw: RawColumns, found: TextLayout, *, named: bool) -> RawColumns:
    """Give the columns of a file the clock that was recognised; the column of times is called time if `named`."""
    clock, stated = found.clock, found.stated
    by_column = clock is not None and clock.unit and not (clock.stamps and stated)
    if clock is not None and clock.second_time is not None:
        places = " and ".join(f"{i + 1} ({found.labels[i]!r})" for i in (clock.column, clock.second_time))
        raise ReadError(
            raw.path,
            "header",
            f"columns {places} are times of different rates; say in a channel map which is the time (time under "
            "[file]) and which channels go with it: `aerobalance map FILE` makes one",
        )
    if clock is not None and by_column:
        number = clock.column + 1
        renamed = tuple(
            replace(column, name="time") if named and column.number == number else column for column in raw.columns
        )
        return replace(raw, columns=renamed, time=number)
    others = tuple(column for column in raw.columns if clock is None or not named or column.number != clock.column + 1)
    if stated is not None:
        warn_quality(
            f"{raw.path.name}: has no column of times in a known unit; the clock is what line {stated.line} states "
            f"({stated.text[:60]!r}): {stated.rate:.6g} Hz"
        )
        return replace(raw, columns=others, rate=stated.rate)
    if clock is not None and clock.named and named:
        label = found.labels[clock.column]
        raise ReadError(
            raw.path,
            f"header, column {clock.column + 1} ({label!r})",
            f"looks like the time, but its unit is missing; write {label} [s] (or ms, us, min), or put time = "
            f"{quoted(label)} and time_unit under [file] of a channel map, which `aerobalance map FILE` makes",
        )
    return replace(raw, time=None if clock is None else clock.column + 1)


def headings(path: Path, layout: Layout | None = None) -> tuple[Heading, ...]:
    """Read what the header says of the columns.

    Raises
    ------
    ReadError
        The file is no text, or has no header.
    """
    found = describe_text(path, layout)
    clock = found.clock
    return tuple(
        Heading(
            label,
            name,
            unit,
            i + 1,
            note="" if kind == "number" else _HELD[kind],
            usable=kind == "number" or expected_unit(name) is not None or (clock is not None and clock.column == i),
            time=clock is not None and clock.column == i,
        )
        for i, (label, name, unit, kind) in enumerate(
            zip(found.labels, found.names, found.units, found.kinds, strict=True)
        )
    )


def read_table(path: Path | str, *, required: Sequence[str] = (), missing_allowed: bool = False) -> Table:
    """Read a plain CSV table: any columns ``name [unit]``, no time needed.

    Parameters
    ----------
    path
        The file.
    required
        Names of columns that must be there.
    missing_allowed
        Whether cells may be empty (NaN then).

    Returns
    -------
    Table
        Columns of n cells each in SI units; angles in rad, gauge outputs in mV/V.

    Raises
    ------
    ReadError
        The file is no such table; the message says where and what is allowed.
    """
    raw = read_text_columns(Path(path), texts_dropped=True)
    return table_from(raw, required=required, missing_allowed=missing_allowed)


def digits_for(least: Array) -> int | None:
    """Return the decimals at which rounding is below 1/2000 of what a result is not known to; None for all of them.

    Parameters
    ----------
    least
        Standard uncertainties, or noise, of which the smallest counts.
    """
    known = least[np.isfinite(least) & (least > 0)]
    if not known.size:
        return None
    return max(0, int(np.ceil(-np.log10(1e-3 * float(known.min())))))


def rounded(values: Array, digits: int) -> Array:
    """Round to so many decimals, without a minus before zeros; what is too large to have them stays as it is."""
    with np.errstate(over="ignore", invalid="ignore"):
        kept = np.round(values, digits) + 0.0
    return np.where(np.isfinite(kept), kept, values) if digits < 300 else values


@contextmanager
def appending(
    path: Path, labels: Sequence[str], described: object = None, *, epoch: object = None, rows: int = 0
) -> Iterator[Append]:
    """Write columns that come some rows at a time; the file takes its place when all are written.

    Missing samples become empty cells, numbers read back exactly.

    Parameters
    ----------
    path
        The file; its ending chooses the separator.
    labels
        The headers.
    described, epoch, rows
        What is known beside the columns, for which a text file has no place.

    Yields
    ------
    Append
        Takes the next rows of all columns, by header.
    """
    del described, epoch, rows
    separator = SUFFIXES[path.suffix.lower()]
    missing = "" if len(labels) > 1 else '""'  # a line without a character is no row
    with replacing(path) as beside, beside.open("w", encoding="utf-8", newline="") as file:

        def append(columns: Mapping[str, Array]) -> None:
            cells = [map(repr, without_infinities(columns[label]).tolist()) for label in labels]
            rows = "".join(f"{separator.join(row)}\n" for row in zip(*cells, strict=True))
            file.write(rows.replace("nan", missing))

        csv.writer(file, delimiter=separator, lineterminator="\n").writerow(labels)
        yield append
