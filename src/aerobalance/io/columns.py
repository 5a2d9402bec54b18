"""Columns as a file has them, before units and meanings: what every file format hands over."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array, SensorSpec
from aerobalance.recording.errors import ReadError
from aerobalance.recording.units import readable

Append = Callable[[Mapping[str, Array]], None]
"""Takes the next rows of all columns of a file that is written, by header."""

PIECE: Final = 1 << 16
"""Samples that are read or looked at at once, where all of them would take too much room."""

LISTED: Final = 20
LONGEST_LABEL: Final = 40
"""Columns that a message lists at most, and letters of each."""

_SQUARE: Final = re.compile(r"(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]\s*")
_ROUND: Final = re.compile(r"(?P<name>.*?)\s*\((?P<unit>.*)\)\s*")


@dataclass(frozen=True, slots=True)
class Clock:
    """When the cells of a column were read, where the file states it column by column.

    Attributes
    ----------
    start
        Time of the first cell [s], on one time scale for the whole file.
    interval
        Time from cell to cell [s].
    """

    start: float
    interval: float


@dataclass(frozen=True, slots=True)
class Heading:
    """What a file says about one of its columns, read without the cells.

    Attributes
    ----------
    label
        The column's header as the file has it.
    name
        The header without its unit.
    unit
        The unit; an empty string where there is none.
    number
        Position in the file, counted from 1.
    note
        What else is good to know when making a channel map: rate, number of samples.
    clocked
        Whether the file states the column's own sampling rate.
    usable
        Whether the column holds numbers.
    time
        Whether the column was recognised as the time of every row.
    """

    label: str
    name: str
    unit: str
    number: int
    note: str = ""
    clocked: bool = False
    usable: bool = True
    time: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RawColumn:
    """One column of a file.

    Attributes
    ----------
    label
        The column's header as the file has it.
    name
        The header without its unit.
    unit
        The unit in the header; an empty string where there is none.
    values
        Cells, shape (n,), in the file's unit; NaN where missing.
    number
        Position in the file, counted from 1.
    alias
        Another name that a channel map may give; an empty string where there is none.
    clock
        When the cells were read; None where a time column, or a rate for the whole file, says it.
    sensor
        What the file says of how the column was measured; it may lag the rows it stands in.
    stamped
        Whether the values are seconds made of date-time stamps.
    """

    label: str
    name: str
    unit: str
    values: Array
    number: int
    alias: str = ""
    clock: Clock | None = None
    sensor: SensorSpec = field(default_factory=SensorSpec)
    stamped: bool = False

    @property
    def place(self) -> str:
        """The column as a place in an error message."""
        return f"column {self.number} ({self.label!r})"


@dataclass(frozen=True, slots=True, eq=False)
class RawColumns:
    """The columns of one file.

    Attributes
    ----------
    path
        The file.
    columns
        Its columns, in the file's order, of n cells each (of any length where each has a clock of its own).
    lines
        Line (or row, for a binary file) that each of the n cells stands in, counted from 1.
    rate
        Sampling rate of all columns [Hz] where the file itself states it; None where a time column has to.
    start
        Time of the first row [s], where `rate` is given.
    ticks
        Sample of the steady clock that each row stands for, shape (n,), increasing from 0, where `rate` is given;
        None where no sample is missing.
    time
        Number of the column that was recognised as the time of every row; None where none was, or where `rate` holds.
    epoch
        Date and time at which the time is zero; None where the file does not say it.
    """

    path: Path
    columns: tuple[RawColumn, ...]
    lines: Sequence[int] | NDArray[np.intp]
    rate: float | None = None
    start: float = 0.0
    ticks: NDArray[np.intp] | None = None
    time: int | None = None
    epoch: np.datetime64 | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.lines)

    def labels(self) -> str:
        """List the columns for an error message: the first of them, each as far as it can be read at a glance."""
        listed = ", ".join(repr(column.label[:LONGEST_LABEL]) for column in self.columns[:LISTED])
        more = len(self.columns) - LISTED
        return f"{listed} and {more} more" if more > 0 else listed

    def find(self, key: str | int, *, where: str) -> RawColumn:
        """Return a column by its label, its name or its number.

        Raises
        ------
        ReadError
            There is no such column, or more than one.
        """
        if isinstance(key, int):
            for column in self.columns:
                if column.number == key:
                    return column
            last = max((column.number for column in self.columns), default=0)
            raise ReadError(self.path, where, f"there is no column {key}; the file has {last} columns")
        for attribute in ("label", "name", "alias"):
            found = [column for column in self.columns if getattr(column, attribute) == key.strip()]
            if len(found) == 1:
                return found[0]
            if found:
                numbers = " and ".join(str(column.number) for column in found)
                raise ReadError(self.path, where, f"columns {numbers} are both called {key!r}; give the number")
        own = "a file with other columns needs a channel map of its own, which `aerobalance map FILE` makes"
        raise ReadError(self.path, where, f"there is no column {key!r}; the file has {self.labels()}; {own}")


def time_label(path: Path, labels: Sequence[str], what: str) -> str:
    """Return the header of the column of times of a file that is written.

    Raises
    ------
    ValueError
        There is none, and the format needs one.
    """
    found = next((label for label in labels if split_label(label)[0] == "time"), None)
    if found is None:
        raise ValueError(f"cannot write {path}: {what} needs a column time [s]")
    return found


def split_label(label: str) -> tuple[str, str]:
    """Split a header cell into name and unit: ``AF [N]``, and ``Moment (Nm)`` where the brackets hold a unit."""
    match = _SQUARE.fullmatch(label)
    if match:
        return match["name"].strip(), match["unit"].strip()
    match = _ROUND.fullmatch(label)
    if match and readable(match["unit"]):
        return match["name"].strip(), match["unit"].strip()
    return label.strip(), ""
