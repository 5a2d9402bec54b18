"""Series that a file holds under names, read when they are wanted: what the readers of binary formats hand over.

Such a reader is one small module over the library of its format, with ``NAME``, ``can_read(head, path)`` and
``opened(path)``, which yields the `Holdings` of an open file. What their names and units mean, which of them is the
time, and what is wrong with them, is worked out for all of them in `aerobalance.io.series_columns`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from aerobalance.io.columns import Clock, split_label
from aerobalance.io.text_clock import is_time_name, is_time_unit
from aerobalance.recording.channel import Array, SensorSpec

Reads = Callable[[int, int], Any]
"""Reads the samples of a series from one to another (not included), as numbers or date-time stamps."""

Fills = Callable[[int, Array], None]
"""Reads as many samples of a series from one on as an array takes, into the array."""

MOST_SERIES: Final = 10_000
"""Series that a file may hold: no recorder has as many channels."""

MOST_COLUMNS: Final = 1000
"""Columns of a matrix that are taken for channels; a wider one is no table of readings."""


@dataclass(frozen=True, slots=True)
class Series:
    """One series of a file, not yet read.

    Attributes
    ----------
    label
        What a channel map calls it: ``group/channel``, the path of a data set, the name of a variable.
    name, unit
        What it is, and its unit as the file says it; an empty string where it says none.
    samples
        Number of its samples.
    read
        Reads a part of it.
    alias
        A shorter name, where it is the only one of that name.
    fill
        Reads a part of it into an array, where many short parts take no longer than a long one; None where they do.
    clock
        When the samples were taken, where the file states it as numbers.
    axis
        Label of the series that holds the time of every sample; an empty string where there is none.
    fault
        Why it cannot be used as readings over time; an empty string where it can.
    stamps
        Whether the samples are dates and times.
    hidden
        Whether it is there as the times of others alone, and is no channel.
    block
        What is stored together with other series, so that all of them are best read a piece at a time; an empty
        string for a series that is stored alone.
    sensor
        What the file says of how the series was measured.
    """

    label: str
    name: str
    unit: str
    samples: int
    read: Reads
    alias: str = ""
    fill: Fills | None = field(default=None, kw_only=True)
    clock: Clock | None = None
    axis: str = ""
    fault: str = ""
    stamps: bool = False
    hidden: bool = False
    block: str = ""
    sensor: SensorSpec = field(default_factory=SensorSpec)

    @property
    def unit_as_read(self) -> str:
        """Unit of what `aerobalance.io.series_values.read_values` makes of its samples: dates become seconds."""
        return "s" if self.stamps else self.unit


@dataclass(frozen=True, slots=True)
class Holdings:
    """What a file holds.

    Attributes
    ----------
    series
        Its series, in the file's order.
    epoch
        Date and time (UTC where the file says so) at which its times are zero; None where it does not say it.
    remarks
        What is doubtful about the file.
    parts
        Whether a part of a series costs no more than itself to be read.
    """

    series: tuple[Series, ...]
    epoch: np.datetime64 | None = None
    remarks: tuple[str, ...] = ()
    parts: bool = True


class Reader(Protocol):
    """What the module of one format offers."""

    @property
    def NAME(self) -> str:  # noqa: N802 - a constant of the module
        """What to call the format in messages."""

    def can_read(self, head: bytes, path: Path) -> bool:
        """Return whether a file is of this format, from its first bytes."""

    def opened(self, path: Path) -> AbstractContextManager[Holdings]:
        """Open a file to read its series."""


class Matrix:
    """An array on the disk whose longer side is the time; what was read last is kept, as all columns ask for it.

    Parameters
    ----------
    data
        What has a shape and gives its parts as arrays, of one dimension or two.
    """

    def __init__(self, data: Any) -> None:
        self._data = data
        self._bounds, self._last = (0, 0), None

    def reader(self, column: int) -> Reads:
        """Return what reads a part of one column."""
        shape = self._data.shape
        if len(shape) == 1:
            return lambda begin, end: self._data[begin:end]
        if shape[0] < shape[1]:
            return lambda begin, end: self._data[column, begin:end]
        return lambda begin, end: self._rows(begin, end)[:, column]

    def _rows(self, begin: int, end: int) -> Any:
        if self._bounds != (begin, end):
            self._last, self._bounds = self._data[begin:end], (begin, end)
        return self._last


def kind_fault(kind: str, *, allowed: str = "fiub") -> str:
    """Return why data of a kind of numpy's are no readings; an empty string where they are of those allowed."""
    if kind in allowed:
        return ""
    return "it holds complex numbers" if kind == "c" else "it holds text or data that are no numbers"


def by_label(found: Holdings, label: str) -> Series:
    """Return the series of a label that there is."""
    return next(series for series in found.series if series.label == label)


def with_axes(series: Sequence[Series], *, flat: bool = False) -> tuple[Series, ...]:
    """Give series the one that holds their times: in the same place, of as many samples, and named as a time is.

    The place is what stands before the last sign ``/`` or ``.`` of the label. A series is a time where its name and
    its unit say so, or where it is called exactly time or t. What the file states itself is kept, where there is such
    a series of as many samples. In a `flat` file all stand in one place, whatever their labels.
    """
    times: dict[tuple[str, int], list[str]] = {}
    for one in series:
        named = is_time_name(one.name) and (one.stamps or is_time_unit(one.unit) or one.name.lower() in ("time", "t"))
        if named and not one.fault and one.samples > 1:
            times.setdefault(("" if flat else place_of(one.label), one.samples), []).append(one.label)
    there = {one.label: one.samples for one in series if not one.fault}
    found = []
    for one in series:
        labels = times.get(("" if flat else place_of(one.label), one.samples), [])
        stated = one.axis if there.get(one.axis) == one.samples and one.axis != one.label else ""
        beside = labels[0] if len(labels) == 1 and one.label not in labels else ""
        found.append(replace(one, axis="" if one.clock is not None else stated or beside))
    return tuple(found)


def place_of(label: str) -> str:
    """Return what stands before the name of a series in its label."""
    return label[: max(label.rfind("/"), label.rfind("."), 0)]


def named(text: str, unit: str = "") -> tuple[str, str]:
    """Return name and unit of a series from its header and what the file says of its unit besides."""
    if unit.strip():
        name, bracketed = split_label(text)
        return (name if bracketed == unit.strip() else text.strip()), unit.strip().removeprefix("[").removesuffix("]")
    return split_label(text)
