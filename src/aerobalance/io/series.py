"""Series that a file holds under names, read when they are wanted: what the readers of binary formats hand over.

Such a reader is one small module over the library of its format, with ``NAME``, ``can_read(head, path)`` and
``opened(path)``, which yields the `Holdings` of an open file. What their names and units mean, which of them is the
time, and what is wrong with them, is worked out here for all of them.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

import numpy as np

from aerobalance.io.columns import Clock, Heading, RawColumn, RawColumns, split_label
from aerobalance.io.text_cells import LARGEST, beyond_all_measure
from aerobalance.io.text_clock import is_time_name, is_time_unit
from aerobalance.io.text_layout import Layout
from aerobalance.recording.channel import QUANTITIES, Array, SensorSpec, is_ground_acceleration
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import ReadError, argument, warn_quality
from aerobalance.recording.units import conversion

Reads = Callable[[int, int], Any]
"""Reads the samples of a series from one to another (not included), as numbers or date-time stamps."""

PIECE: Final = 1 << 16
"""Samples of series that are stored together which are read at once."""

STEADY: Final = 0.1
"""Sampling intervals by which stamps may depart from a steady clock."""

MOST_SERIES: Final = 10_000
"""Series that a file may hold: no recorder has as many channels."""


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
    clock: Clock | None = None
    axis: str = ""
    fault: str = ""
    stamps: bool = False
    hidden: bool = False
    block: str = ""
    sensor: SensorSpec = field(default_factory=SensorSpec)


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


@dataclass(frozen=True, slots=True)
class SeriesFormat:
    """A format whose module opens files as series, as `aerobalance.io.Format` has it.

    Attributes
    ----------
    reader
        The module.
    SUFFIXES
        File name endings that are written in this format.
    appending
        Writes columns that come some rows at a time; None for a format that is read only.
    KEEPS_SENSORS, KEEPS_EPOCH
        Whether it has a place for how a channel was measured, and for the date and time of time zero.
    """

    reader: Reader
    SUFFIXES: Mapping[str, str] = field(default_factory=dict)
    appending: Any = None
    KEEPS_SENSORS: bool = False
    KEEPS_EPOCH: bool = True

    @property
    def NAME(self) -> str:  # noqa: N802 - as the modules of the other formats call it
        """What to call the format in messages."""
        return self.reader.NAME

    def can_read(self, head: bytes, path: Path) -> bool:
        """Return whether a file is of this format, from its first bytes."""
        return self.reader.can_read(head, path)

    def headings(self, path: Path) -> tuple[Heading, ...]:
        """Read what the file says of its series, without their samples."""
        with self.reader.opened(path) as found:
            return headings_of(found)

    def read_columns(
        self, path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None
    ) -> RawColumns:
        """Read series as columns; only the samples of those wanted are read."""
        with self.reader.opened(path) as found:
            return columns_of(path, found, wanted, clocked=layout is not None and layout.clocked)


@contextlib.contextmanager
def library_faults(path: Path, name: str, where: str = "") -> Iterator[None]:
    """Turn whatever a library fails with on a file into a `ReadError`, and keep what it would print to itself."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    except (ReadError, GeneratorExit, KeyboardInterrupt):
        raise
    except FileNotFoundError:
        raise ReadError(path, "", "there is no such file") from None
    except MemoryError:
        raise ReadError(
            path, where, "is damaged, or too large for the memory; read fewer channels at a time"
        ) from None
    except Exception as error:  # noqa: BLE001 - libraries fail in a dozen ways on damaged files
        text = " ".join(str(error).split()) or type(error).__name__
        raise ReadError(
            path, where, f"is a damaged file of {name}, or of a kind that cannot be read: {text[:200]}"
        ) from None


def library(module: str, extra: str, path: Path | str, what: str) -> Any:
    """Import the library of a format.

    Raises
    ------
    ReadError
        It is not installed; the message has the command that does it.
    """
    if find_spec(module.partition(".")[0]) is None:
        raise ReadError(
            path, "", f"is {what}, and needs a library that is not installed: pip install 'aerobalance[{extra}]'"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what the library finds or lacks on this machine
        return import_module(module)


def library_to_write(module: str, extra: str, path: Path | str, what: str) -> Any:
    """Import the library of a format that is written.

    Raises
    ------
    ValueError
        It is not installed; the message has the command that does it.
    """
    try:
        return library(module, extra, path, what)
    except ReadError:
        raise ValueError(
            f"cannot write {path}: {what} needs a library that is not installed: pip install 'aerobalance[{extra}]'"
        ) from None


def headings_of(found: Holdings) -> tuple[Heading, ...]:
    """Return what a file says of its series."""
    axes = {series.axis: _by_label(found, series.axis) for series in found.series if series.axis}
    rows = []
    for number, series in enumerate(found.series, start=1):
        if series.hidden:
            continue
        rate = f"{1 / series.clock.interval:.9g} Hz, " if series.clock is not None else ""
        note = f"cannot be used: {series.fault}" if series.fault else f"{rate}{series.samples} samples"
        axis = axes.get(series.axis)
        own = axes.get(series.label)
        rows.append(
            Heading(
                series.label,
                series.name,
                "s" if series.stamps else series.unit,
                number,
                "the time of other channels" if own else note,
                clocked=series.clock is not None or (axis is not None and _has_unit(axis)),
                usable=not series.fault and own is None,
                time=own is not None and not _has_unit(own),
            )
        )
    return tuple(rows)


def _has_unit(axis: Series) -> bool:
    """Whether a series of times needs no more than itself to be seconds."""
    return axis.stamps or is_time_unit(axis.unit)


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
    clocks = {axis: _clock_of(path, _by_label(found, axis)) for axis in axes if axis}
    values = read_all(path, [series for _, series in chosen])
    columns = tuple(
        replace(
            bare_column(number, series), values=values[series.label], clock=series.clock or clocks.get(series.axis)
        )
        for number, series in chosen
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


def _by_label(found: Holdings, label: str) -> Series:
    return next(series for series in found.series if series.label == label)


def bare_column(number: int, series: Series) -> RawColumn:
    """Column of a series without its cells."""
    unit = "s" if series.stamps else series.unit
    return RawColumn(
        series.label,
        series.name,
        unit,
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
    axis = _by_label(found, label)
    place = 1 + found.series.index(axis)
    others = [(number, series) for number, series in chosen if number != place]
    values = read_all(path, [axis, *(series for _, series in others)])
    columns = [replace(bare_column(number, series), values=values[series.label]) for number, series in others]
    time = replace(bare_column(place, axis), values=values[axis.label])
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
    unit = axis.unit or ("s" if axis.stamps else "")
    if not unit:
        _unit_needed(path, axis)
    seconds = conversion(unit, expected="s").inside(times)
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
    return without_infinities(path, where, values)


def _seconds(path: Path, series: Series, stamps: Any, begin: int) -> Array:
    """Seconds since the first stamp of a series."""
    given = np.asarray(stamps)
    first = given[:1] if begin == 0 else np.asarray(series.read(0, 1))
    if given.dtype.kind not in "mM" or np.isnat(first).any():
        raise ReadError(path, f"channel {series.label!r}", "holds dates and times of which the first is missing")
    seconds: Array = (given - first) / np.timedelta64(1, "s")
    return seconds


def without_infinities(path: Path, where: str, values: Array) -> Array:
    """Return samples of which those beyond all measure are missing (NaN), shape (n,)."""
    flat = np.ascontiguousarray(values)
    with np.errstate(all="ignore"):
        power = float(flat @ flat)  # one pass over good samples; all that is not good shows in it
    if power < LARGEST * LARGEST:
        return values
    with np.errstate(all="ignore"):
        large = np.flatnonzero(np.abs(flat) > LARGEST)
    if not large.size:
        return values
    found = flat.copy()
    infinite = np.isinf(found[large])
    if not infinite.all():
        first = large[~infinite][0]
        warn_quality(f"{path.name}: {beyond_all_measure(int((~infinite).sum()), f'{where}, sample {first + 1}')}")
    found[large] = np.nan
    return found


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
