"""Plain CSV: text columns with a header ``name [unit]`` per column."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.io.columns import Append, Heading, RawColumns
from aerobalance.io.measure import without_infinities
from aerobalance.io.safe_write import replacing
from aerobalance.io.table import Table, table_from
from aerobalance.io.text_clock import ALIKE
from aerobalance.io.text_layout import Layout, TextLayout
from aerobalance.io.text_table import describe_text, guess_encoding, read_text_columns, read_text_table
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
    _compare_clocks(path, found, given)
    plain = any(column.name == "time" and not column.stamped for column in raw.columns) and wanted is None
    if given.clocked or plain:
        return raw
    return _clocked(raw, found, named=wanted is None)


def _compare_clocks(path: Path, found: TextLayout, given: Layout) -> None:
    """Warn where a rate that somebody says, a rate that the file states and its column of times disagree."""
    clock, stated = found.clock, found.stated
    said = given.rate or (stated.rate if stated else None)
    if said is None:
        return
    source = "the channel map says" if given.rate else f"line {stated.line} says" if stated else ""
    other = advice = ""
    if clock is not None and not clock.agrees(said):
        label = found.labels[clock.column]
        rate = clock.rate
        other = f"column {clock.column + 1} ({label!r}) steps by {clock.interval:.6g} {clock.unit}".rstrip()
        other += "" if rate is None else f", which is {rate:.6g} Hz"
        advice = f"; put time = {quoted(label)} under [file] in place of rate" if given.rate else ""
        advice = advice or "; the column of times is taken"
    elif given.rate and stated and abs(given.rate / stated.rate - 1) > ALIKE:
        other, advice = f"line {stated.line} says {stated.rate:.6g} Hz", "; the channel map is taken"
    if other:
        warn_quality(f"{path.name}: {source} {said:.6g} Hz, but {other}{advice}")


def _clocked(raw: RawColumns, found: TextLayout, *, named: bool) -> RawColumns:
    """Give the columns of a file the clock that was recognised; the column of times is called time if `named`."""
    clock, stated = found.clock, found.stated
    by_column = clock is not None and clock.unit and not (clock.stamps and stated)
    if clock is not None and clock.rival is not None:
        places = " and ".join(f"{i + 1} ({found.labels[i]!r})" for i in (clock.column, clock.rival))
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
    import pandas as pd  # noqa: PLC0415 - half a second, and only files need it

    separator = SUFFIXES[path.suffix.lower()]
    with replacing(path) as beside, beside.open("w", encoding="utf-8", newline="") as file:

        def write(table: pd.DataFrame, *, header: bool) -> None:
            table.to_csv(file, header=header, index=False, sep=separator, lineterminator="\n")

        def append(columns: Mapping[str, Array]) -> None:
            finite = {label: without_infinities(columns[label]) for label in labels}
            write(pd.DataFrame(finite), header=False)

        write(pd.DataFrame(columns=list(labels)), header=True)
        yield append
