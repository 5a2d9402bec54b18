"""LabVIEW TDMS: groups of channels, each with its own rate, start time and unit in its properties."""

from __future__ import annotations

import contextlib
import logging
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np

from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.columns import Clock, Heading, RawColumn, RawColumns, split_label
from aerobalance.io.opening import opened_file
from aerobalance.io.series import Series, kind_fault
from aerobalance.io.series_record import SeriesRecord
from aerobalance.io.series_values import within_reason
from aerobalance.io.tdms_parts import part_reader
from aerobalance.io.tdms_tasks import Stamped, round_interval, seconds_after, start_stamps
from aerobalance.io.text_layout import Layout
from aerobalance.recording.channel import QUANTITIES, Array
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import ReadError, argument, warn_quality
from aerobalance.recording.units import conversion, readable

if TYPE_CHECKING:
    from nptdms import TdmsChannel, TdmsFile

NAME: Final = "LabVIEW TDMS"
"""What to call the format in messages."""

SUFFIXES: Final[Mapping[str, str]] = {}
"""TDMS is read only."""

appending: Final = None
KEEPS_SENSORS: Final = False
KEEPS_EPOCH: Final = False

# Layout of a segment as in "TDMS File Format Internal Structure" of NI.
_LEAD_IN: Final = 28
"""Bytes at the begin of a segment: tag, flags, version, length of the segment and of its metadata."""
_BIG_ENDIAN: Final = 1 << 6
"""Flag of a segment in big-endian order."""
_SCALES: Final = "NI_Number_Of_Scales"

# Bounds beyond which a number comes from damage and would cost memory or overflow, far from any real recording.
_LATEST: Final = 1 << 33
"""Seconds after 1904: the year 2176."""
_SHORTEST: Final = 1e-12
_LONGEST: Final = 1e6
"""Sampling intervals [s]."""
_MOST_SCALES: Final = 1000
_CUT_OFF: Final = "the file was cut off while it was written; what was complete is used, and the end is missing"
_UNITS: Final = ("unit_string", "NI_UnitDescription")


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is TDMS, from its first bytes; its name does not matter."""
    del path  # a parameter of every format
    return head.startswith(b"TDSm")


def read_columns(path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None) -> RawColumns:
    """Return channels as columns in their own units, each with its clock; only the data of those wanted are read.

    A column's label is ``group/channel``; the channel's name alone will do where no other channel has it. The unit is
    the property ``unit_string`` or ``NI_UnitDescription``, where that is a unit, or stands in the channel's name. The
    clock comes from ``wf_increment``, ``wf_start_offset`` and ``wf_start_time``; a channel without start time starts
    with the first of the others, and channels of one task start together (see `aerobalance.io.tdms_tasks`).

    Parameters
    ----------
    path
        The file.
    layout
        For text files only.
    wanted
        Channels to read, by label, name or number. None for a file that needs no channel map: then every channel of
        numbers is read, each must have a unit, and at least one must have a name that the program knows.

    Raises
    ------
    ReadError
        The file is damaged; a channel is not there, holds no numbers, or needs a channel map.

    Warns
    -----
    DataQualityWarning
        The file was cut off while it was written; the start times of one task differ.
    """
    del layout
    with _opened(path) as (file, _):
        entries = _entries(path, file)
        chosen = _chosen(path, entries, wanted)
        stamps, remarks = _stamps(entries, chosen)
        origin = _origin([stamps.get(entry.number) for entry in chosen])
        columns = tuple(
            _column(entry, _values(path, entry), _clock(path, entry, stamps.get(entry.number), origin))
            for entry in chosen
        )
    for text in remarks:
        warn_quality(f"{path.name}: {text}")
    rows = range(1, max((column.values.size for column in columns), default=0) + 1)
    return RawColumns(path, columns, rows, epoch=date_after_1904(origin))


@contextlib.contextmanager
def opened_parts(path: Path, channel_map: ChannelMap | None) -> Iterator[SeriesRecord | None]:
    """Return a record that is read in parts; None where the file must be read whole.

    It must be read whole where its channels have different clocks or state none, where the map takes the time from a
    column or derives a channel, where a part costs as much as the whole, and where the file was cut off.

    Raises
    ------
    ReadError
        The file is damaged, or does not hold the channels.
    """
    reading = contextlib.ExitStack()
    try:
        file, said = reading.enter_context(_opened(path))
        stream = reading.enter_context(opened_file(path))
        yield None if said else _record(path, file, stream, channel_map)
    finally:
        reading.close()  # closed without the caller's error, which `_opened` would report as a damaged file


def _record(path: Path, file: TdmsFile, stream: BinaryIO, channel_map: ChannelMap | None) -> SeriesRecord | None:
    """Return the record of the channels wanted, all on one clock; None where the file must be read whole."""
    if channel_map is not None and channel_map.needs_all:
        return None
    entries = _entries(path, file)
    chosen = _chosen(path, entries, None if channel_map is None else channel_map.wanted)
    stamps, remarks = _stamps(entries, chosen)
    origin = _origin([stamps.get(entry.number) for entry in chosen])
    clocks = {_clock(path, entry, stamps.get(entry.number), origin) for entry in chosen}
    if channel_map is not None and channel_map.file.rate is not None:
        clocks = {Clock(0.0, 1 / channel_map.file.rate)}
    clock = clocks.pop()
    if clock is None or clocks:
        return None
    readers = [part_reader(file, entry.channel, stream) for entry in chosen]
    series = []
    for entry, reads in zip(chosen, readers, strict=True):
        if reads is None or entry.channel.dtype.kind == "M" or entry.samples != chosen[0].samples:
            return None
        bare = _column(entry, np.empty(0), clock)
        one = Series(entry.label, entry.name, bare.unit, entry.samples, reads, alias=bare.alias, clock=clock)
        series.append((entry.number, one))
    for text in remarks:
        warn_quality(f"{path.name}: {text}")
    return SeriesRecord(path, tuple(series), clock, None, channel_map, date_after_1904(origin))


def _chosen(path: Path, entries: Sequence[_Entry], wanted: Sequence[str | int] | None) -> list[_Entry]:
    """Return the channels that are wanted; an error where one cannot be read as numbers."""
    if wanted is None:
        chosen = _described(path, entries)
    else:
        bare = tuple(_column(entry, np.empty(0), None) for entry in entries)
        stub = RawColumns(path, bare, range(0))
        numbers = {stub.find(key, where="channels").number for key in wanted}
        chosen = [entry for entry in entries if entry.number in numbers]
    for entry in chosen:
        _check_usable(path, entry)
    return chosen


def date_after_1904(stamp: Any) -> np.datetime64 | None:
    """Return date and time (UTC) of a LabVIEW time stamp, which counts from 1904; None where none is stated."""
    if stamp is None or not 0 < int(stamp.seconds) < _LATEST:
        return None
    nanoseconds = int(stamp.second_fractions) * 10**9 >> 64
    found: np.datetime64 = (
        np.datetime64("1904-01-01", "ns") + np.timedelta64(int(stamp.seconds), "s") + np.timedelta64(nanoseconds, "ns")
    )
    return found


def headings(path: Path) -> tuple[Heading, ...]:
    """Return name, unit, rate and length of each channel, without reading data.

    Raises
    ------
    ReadError
        The file is damaged.
    """
    with _opened(path) as (file, _):
        found = []
        for entry in _entries(path, file):
            clock = _clock(path, entry, None, None)
            fault = _fault(entry)
            rate = f"{1 / clock.interval:.9g} Hz" if clock is not None else "no rate stated"
            note = f"cannot be used: {fault}" if fault else f"{rate}, {entry.samples} samples"
            found.append(
                Heading(
                    entry.label,
                    entry.name,
                    entry.unit,
                    entry.number,
                    note,
                    clocked=clock is not None,
                    usable=not fault,
                )
            )
    return tuple(found)


@dataclass(frozen=True, slots=True)
class _Entry:
    """One channel of the file, not yet read."""

    channel: TdmsChannel
    label: str
    name: str
    unit: str
    number: int
    samples: int


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[TdmsFile, list[str]]]:
    """Open a file, and give it with the messages that the reading library has logged so far.

    Every failure of that library becomes a `ReadError`, and its messages become warnings when the file is closed.
    """
    from nptdms import TdmsFile  # noqa: PLC0415 - a third of a second, and only TDMS files need it

    said: list[str] = []
    try:
        # A stream, since for a path the library would trust any index file that lies beside it.
        with path.open("rb") as stream, _listening(said), np.errstate(all="ignore"):
            cut_off = _cut_off(stream)
            with TdmsFile.open(stream, raw_timestamps=True) as file:
                if cut_off:
                    said.insert(0, _CUT_OFF)
                yield file, said
    except ReadError:
        raise
    except OSError as error:
        raise ReadError(path, "", f"cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise ReadError(path, "", "is damaged, or too large for the memory; read fewer channels at a time") from None
    except Exception as error:  # noqa: BLE001 - the library fails in a dozen ways on damaged files
        text = " ".join(str(error).split()) or type(error).__name__
        raise ReadError(
            path, "its segments", f"is a damaged TDMS file, or of a kind that cannot be read: {text[:200]}"
        ) from None
    if cut_off:
        said = [_CUT_OFF]
    for text in dict.fromkeys(said):
        warn_quality(f"{path.name}: {text}")


def _cut_off(stream: BinaryIO) -> bool:
    """Return whether the last segment ends elsewhere than the file, as the library does not report every case."""
    size = stream.seek(0, 2)
    place = 0
    while place < size:
        stream.seek(place)
        head = stream.read(_LEAD_IN)
        if len(head) < _LEAD_IN or not head.startswith(b"TDSm"):
            break
        order = ">" if head[4] & _BIG_ENDIAN else "<"
        place += _LEAD_IN + struct.unpack_from(f"{order}Q", head, 12)[0]
    stream.seek(0)
    return place != size


@contextlib.contextmanager
def _listening(said: list[str]) -> Iterator[None]:
    """Collect the warnings that the library would write to standard error."""

    class _Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    from nptdms.log import log_manager  # noqa: PLC0415 - comes with the library

    collector = _Collector(logging.WARNING)
    loggers = list(log_manager.loggers.values())
    before = [(list(logger.handlers), logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [collector], False
    try:
        yield
    finally:
        for logger, (handlers, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate


def _entries(path: Path, file: TdmsFile) -> list[_Entry]:
    """Return the channels of a file; an error where a claimed length cannot be true."""
    size = path.stat().st_size
    found: list[_Entry] = []
    for group in file.groups():
        for channel in group.channels():
            label = f"{group.name}/{channel.name}"
            if len(channel) > size:  # a sample takes at least one byte
                raise ReadError(
                    path, label, f"claims {len(channel)} samples in a file of {size} bytes: the file is damaged"
                )
            for holder in (channel, group, file):
                scales = holder.properties.get(_SCALES, 0)
                if isinstance(scales, str | float) or scales > _MOST_SCALES:
                    raise ReadError(path, label, f"claims {scales} scales ({_SCALES}): the file is damaged")
            name, unit = channel.name.strip(), _unit(channel)
            if not unit:
                name, unit = split_label(channel.name)
            found.append(_Entry(channel, label, name, unit, len(found) + 1, len(channel)))
    if not found:
        raise ReadError(path, "", "is a TDMS file without channels; at least one, of numbers, is needed")
    return found


def _unit(channel: TdmsChannel) -> str:
    """Return the unit that the properties give; an empty string where they give none."""
    for key in _UNITS:
        text = str(channel.properties.get(key, "")).strip()
        text = text.removeprefix("[").removesuffix("]").strip()
        if text and readable(text):
            return text
    return ""


def _fault(entry: _Entry) -> str:
    """Return why a channel cannot be read as numbers; an empty string where it can."""
    if entry.samples == 0:
        return "it has no samples"
    return kind_fault(entry.channel.dtype.kind, allowed="fiubM")


def _check_usable(path: Path, entry: _Entry) -> None:
    """Raise an error where a channel cannot be read as numbers."""
    fault = _fault(entry)
    if fault:
        raise ReadError(path, f"channel {entry.label!r}", f"{fault}; a channel of numbers is needed")


def _described(path: Path, entries: Sequence[_Entry]) -> list[_Entry]:
    """Return the channels of a file that needs no channel map; an error where it needs one."""
    usable = [entry for entry in entries if not _fault(entry)]
    needed = (
        f"a channel map is needed, which `aerobalance map FILE` makes (then give it with {argument('channel_map')})"
    )
    timed = [entry for entry in usable if not is_time(entry.name) or entry.unit]
    for entry in timed:
        if not entry.unit:
            raise ReadError(
                path, f"channel {entry.label!r}", f"the file does not say what it is: no unit is stated; {needed}"
            )
    if not any(entry.name in QUANTITIES or is_gauge(entry.name) for entry in timed):
        names = ", ".join(repr(entry.label) for entry in usable) or "none with numbers"
        raise ReadError(path, "", f"none of its channels ({names}) has a name that the program knows; {needed}")
    # A time column beside channels with clocks of their own repeats what these say.
    clocked = [entry for entry in timed if "wf_increment" in entry.channel.properties]
    others = [entry for entry in timed if entry not in clocked]
    return clocked if clocked and all(is_time(entry.name) for entry in others) else timed


def is_time(name: str) -> bool:
    """Return whether a channel of this name is the time."""
    return name.strip().lower() == "time"


def _column(entry: _Entry, values: Array, clock: Clock | None) -> RawColumn:
    """Return a channel as a column; channels of time stamps are in s."""
    unit = "s" if entry.channel.dtype.kind == "M" else entry.unit
    return RawColumn(
        entry.label, entry.name, unit, values, entry.number, alias=entry.channel.name.strip(), clock=clock
    )


def _values(path: Path, entry: _Entry) -> Array:
    """Return the samples of one channel, scaled, shape (n,); no other channel's data are read."""
    values = np.empty(0)
    filled = 0
    for chunk in entry.channel.data_chunks():
        part = _numbers(chunk[:], entry)
        if filled == 0:
            if part.size == entry.samples:  # the only chunk need not be copied
                values, filled = part, part.size
                continue
            values = np.empty(entry.samples)
        values[filled : filled + part.size] = part
        filled += part.size
    if filled != entry.samples:
        raise ReadError(
            path, f"channel {entry.label!r}", f"has {filled} of {entry.samples} samples: the file is damaged"
        )
    return within_reason(path, f"channel {entry.label!r}", values)


def _numbers(part: Any, entry: _Entry) -> Array:
    """Return samples as floats; time stamps as the time after the channel's first one [s]."""
    if entry.channel.dtype.kind != "M":
        return np.asarray(part, dtype=np.float64)
    origin = entry.channel[0]
    seconds = np.asarray(part["seconds"], dtype=np.float64) - float(origin.seconds)
    fractions = np.asarray(part["second_fractions"], dtype=np.float64) - float(origin.second_fractions)
    return np.asarray(seconds + fractions * 2.0**-64, dtype=np.float64)


def _stamps(entries: Sequence[_Entry], chosen: Sequence[_Entry]) -> tuple[dict[int, Any], list[str]]:
    """Return the time stamp at which each channel starts, by its number, and what is doubtful about them."""
    stamped = []
    for entry in entries:
        given = entry.channel.properties
        stamp = given.get("wf_start_time")
        stamped.append(
            Stamped(
                entry.number,
                entry.channel.group_name,
                entry.name,
                given.get("wf_increment"),
                given.get("wf_start_offset"),
                entry.samples,
                stamp if hasattr(stamp, "second_fractions") else None,
            )
        )
    return start_stamps(stamped, [entry.number for entry in chosen])


def _origin(stamps: Sequence[Any]) -> Any:
    """Return the earliest start time of the channels; None where none has one."""
    known = [stamp for stamp in stamps if stamp is not None]
    return min(known, key=lambda stamp: (stamp.seconds, stamp.second_fractions), default=None)


def _clock(path: Path, entry: _Entry, stamp: Any, origin: Any) -> Clock | None:
    """Return a channel's clock, which begins `stamp` less `origin` after the record; None where it states no rate."""
    properties = entry.channel.properties
    if "wf_increment" not in properties:
        return None
    numbers = {}
    for key in ("wf_increment", "wf_start_offset"):
        given = properties.get(key, 0.0)
        if isinstance(given, bool) or not isinstance(given, int | float | np.number) or not np.isfinite(given):
            raise ReadError(path, f"channel {entry.label!r}, {key}", f"must be a number, not {given!r}")
        numbers[key] = float(given)
    unit = str(properties.get("wf_xunit_string", "")).strip() or "s"
    try:
        change = conversion(unit, expected="s")
    except ValueError as error:
        raise ReadError(
            path, f"channel {entry.label!r}, wf_xunit_string", f"{error}; spectra cannot be used"
        ) from None
    interval = float(change.inside(round_interval(numbers["wf_increment"])))
    if interval == 0 and entry.samples <= 1:
        return None
    if not _SHORTEST <= interval <= _LONGEST:
        raise ReadError(
            path,
            f"channel {entry.label!r}, wf_increment",
            f"must be above zero, from {_SHORTEST:g} to {_LONGEST:g} s, not {interval:.9g} s",
        )
    start = float(change.inside(numbers["wf_start_offset"]))
    if origin is not None and stamp is not None:
        start += seconds_after(stamp, origin)
    return Clock(start, interval)
