"""LabVIEW measurement files (.lvm): text with a header of tags, and segments of rows that state their own clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.columns import Clock, Heading, RawColumn, RawColumns, split_label
from aerobalance.io.text_cells import number_in, split_line
from aerobalance.io.text_clock import ALIKE, stamp_seconds
from aerobalance.io.text_layout import Layout, TextLayout
from aerobalance.io.text_rows import Grid, read_cells
from aerobalance.io.text_table import decoded, guess_encoding
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality

NAME: Final = "LabVIEW measurement file (LVM)"
"""What to call the format in messages."""

SUFFIXES: Final[Mapping[str, str]] = {}
"""File name endings that are written in this format: none."""

appending: Final = None
KEEPS_SENSORS: Final = False
KEEPS_EPOCH: Final = False

_MAGIC: Final = "LabVIEW Measurement"
_END: Final = re.compile(rb"^\*\*\*End_of_Header\*\*\*[^\n]*\n?", re.MULTILINE)
_SPECIAL: Final = re.compile(rb"^\*\*\*Start_Special\*\*\*.*?^\*\*\*End_Special\*\*\*[^\n]*", re.MULTILINE | re.DOTALL)
_SEPARATORS: Final = {"tab": "\t", "comma": ",", "semicolon": ";"}


@dataclass(frozen=True, slots=True)
class _Segment:
    """One segment: the tags of its header, its column names, and where its rows stand.

    Attributes
    ----------
    tags
        Cells after each tag.
    labels
        Cells of the line of names.
    rows
        First and last position of its rows in the text.
    """

    tags: Mapping[str, Sequence[str]]
    labels: tuple[str, ...]
    rows: tuple[int, int]


@dataclass(frozen=True, slots=True)
class _LvmContents:
    """What the headers of a file say.

    Attributes
    ----------
    text
        The file, in UTF-8.
    separator, decimal
        As the file's header says.
    x_columns
        ``"no"``, ``"one"`` or ``"multi"``: whether times stand beside the readings.
    segments
        The segments, all of the same columns.
    """

    path: Path
    text: bytes
    separator: str
    decimal: str
    x_columns: str
    segments: tuple[_Segment, ...]

    @property
    def places(self) -> list[int]:
        """Position of every channel among the columns, counted from 0."""
        labels = self.segments[0].labels
        last = len(labels) - (labels[-1].lower() == "comment")
        return list(range(1, last, 2 if self.x_columns == "multi" else 1))

    def tag(self, segment: _Segment, name: str, channel: int) -> str:
        """What the segment says of a channel; an empty string where it says nothing."""
        cells = segment.tags.get(name, ())
        # Where every channel has times of its own, its cells stand above both of its columns.
        at = 2 * channel if self.x_columns == "multi" and len(cells) > len(self.places) else channel
        return cells[at].strip() if at < len(cells) else ""

    def number(self, segment: _Segment, name: str, channel: int) -> float | None:
        """The number that the segment says of a channel; None where it says none."""
        cell = self.tag(segment, name, channel)
        value = number_in(cell, decimal=self.decimal)
        return number_in(cell, decimal=",.".replace(self.decimal, "")) if value is None else value


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is an LVM, from its first bytes."""
    del path
    encoding = guess_encoding(head)
    return encoding is not None and head[:200].decode(encoding, errors="ignore").lstrip("\ufeff").startswith(_MAGIC)


def headings(path: Path) -> tuple[Heading, ...]:
    """Read what the headers say of the channels.

    Raises
    ------
    ReadError
        The headers are damaged.
    """
    contents = _contents(path)
    segment = contents.segments[0]
    found = []
    for channel, place in enumerate(contents.places):
        label, name, unit = _named(contents, channel, place)
        interval = contents.number(segment, "Delta_X", channel)
        note = f"{1 / interval:.6g} Hz" if interval else ""
        found.append(Heading(label, name, unit, place + 1, note, clocked=True))
    return tuple(found)


def read_columns(path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None) -> RawColumns:
    """Read the channels of all segments one after the other, on the clock that their headers state.

    Channels of one rate stand beside each other row by row. A segment that begins later than the one before it ends
    leaves a gap. The layout is that of the file's header.

    Parameters
    ----------
    path
        The file.
    layout
        Not needed.
    wanted
        Columns to read, by label, name or number; all channels where left out.

    Raises
    ------
    ReadError
        The headers or cells are damaged, or segments hold different channels.

    Warns
    -----
    DataQualityWarning
        Headers, times and segments do not agree on the clock.
    """
    del layout
    contents = _contents(path)
    heads = [
        RawColumn(*_named(contents, channel, place), np.empty(0), place + 1)
        for channel, place in enumerate(contents.places)
    ]
    times = [] if contents.x_columns == "no" else [place - 1 for place in contents.places]
    times = times[:1] if contents.x_columns == "one" else times
    labels = contents.segments[0].labels
    stub = RawColumns(
        path, (*heads, *(RawColumn(labels[i], labels[i], "s", np.empty(0), i + 1) for i in times)), range(0)
    )
    chosen = heads if wanted is None else [stub.find(key, where="segment header") for key in wanted]
    chosen = list({column.number: column for column in chosen}.values())
    cells, lines = _cells(contents, [column.number - 1 for column in chosen], times)
    return _on_clock(contents, chosen, cells, lines)


def _contents(path: Path) -> _LvmContents:
    text, _ = decoded(path, None)
    text = _SPECIAL.sub(lambda match: b"\n" * match[0].count(b"\n"), text)
    ends = list(_END.finditer(text))
    if len(ends) < 2:
        raise ReadError(
            path,
            "",
            "is an LVM without a segment header (a second ***End_of_Header***); write it with headers, or say what "
            "the columns are in a channel map with header_line, which `aerobalance map FILE --header-line 0` makes",
        )
    head = text[: ends[0].start()].decode()
    word = re.search(r"^Separator[\t,;]\s*(\w+)", head, re.MULTILINE)
    separator = _SEPARATORS.get(word[1].lower() if word else "tab", "\t")
    tags = _tags(head, separator)
    segments = []
    for i, end in enumerate(ends[1:], start=1):
        begin = _header_begin(text, ends[i - 1].end(), end.start())
        names = text.find(b"\n", end.end())
        names = len(text) if names < 0 else names
        after = _header_begin(text, names, ends[i + 1].start()) if i + 1 < len(ends) else len(text)
        segments.append(
            _Segment(
                tags=_tags(text[begin : end.start()].decode(), separator),
                labels=tuple(_trimmed(split_line(text[end.end() : names].decode(), separator))),
                rows=(min(names + 1, len(text)), after),
            )
        )
    decimal = "," if tags.get("Decimal_Separator", [""])[0].strip() == "," else "."
    x_columns = tags.get("X_Columns", ["No"])[0].strip().lower()
    _check(path, segments)
    return _LvmContents(path, text, separator, decimal, x_columns, tuple(segments))


def _header_begin(text: bytes, first: int, last: int) -> int:
    """Where the header of a segment begins: at its tag Channels."""
    found = text.rfind(b"\nChannels", max(0, first - 1), last)
    return first if found < 0 else found + 1


def _tags(text: str, separator: str) -> dict[str, list[str]]:
    """Cells after the tag of every line."""
    lines = [split_line(line, separator) for line in text.split("\n") if line.strip()]
    return {cells[0].strip(): cells[1:] or [""] for cells in lines if cells}


def _trimmed(cells: list[str]) -> list[str]:
    named = [cell.strip() for cell in cells]
    while named and not named[-1]:
        named.pop()
    return named


def _check(path: Path, segments: Sequence[_Segment]) -> None:
    """Refuse segments without names or of different channels."""
    first = segments[0]
    if len(first.labels) < 2:
        raise ReadError(
            path, "segment 1", "has no line of column names after ***End_of_Header***; the file is damaged"
        )
    for number, segment in enumerate(segments, start=1):
        if segment.labels != first.labels:
            raise ReadError(
                path,
                f"segment {number}",
                f"has the columns {', '.join(segment.labels)}, and segment 1 has {', '.join(first.labels)}; one "
                "recording needs the same channels throughout: write them to files of their own",
            )
        over = segment.tags.get("X_Dimension", ["Time"])[0].strip()
        if over.lower() not in ("time", ""):
            raise ReadError(
                path, f"segment {number}", f"is over {over}; readings over time (X_Dimension Time) are needed"
            )


def _named(contents: _LvmContents, channel: int, place: int) -> tuple[str, str, str]:
    """Label, name and unit of a channel."""
    label = contents.segments[0].labels[place]
    name, unit = split_label(label)
    return label, name, unit or contents.tag(contents.segments[0], "Y_Unit_Label", channel)


def _cells(
    contents: _LvmContents, chosen: Sequence[int], times: Sequence[int]
) -> tuple[dict[int, Array], NDArray[np.intp]]:
    """Cells of columns, those of times too, and the line of every row."""
    text, first = contents.text, contents.segments[0].rows[0]
    body, at = [], first
    for segment in contents.segments:
        begin, end = segment.rows
        # Lines of headers become blank ones, so that the others keep their numbers.
        body += [b"\n" * text.count(b"\n", at, begin), text[begin:end]]
        at = end
    labels = contents.segments[0].labels
    last = labels if labels[-1].lower() == "comment" else (*labels, "Comment")
    found = TextLayout(
        separator=contents.separator,
        decimal=contents.decimal,
        header_line=0,
        first=text.count(b"\n", 0, first) + 1,
        labels=last,
        units=("",) * len(last),
        kinds=tuple("number" for _ in last),
        optional=1,
    )
    grid = Grid(found, tuple(sorted({*chosen, *times})))
    cells, _, lines = read_cells(contents.path, b"".join(body), grid)
    return cells, np.asarray(lines, dtype=np.intp)


def _on_clock(
    contents: _LvmContents, chosen: Sequence[RawColumn], cells: Mapping[int, Array], lines: NDArray[np.intp]
) -> RawColumns:
    """Put the channels on the clock that the headers state."""
    path, first = contents.path, contents.segments[0]
    if lines.size == 0:
        raise ReadError(path, "", "has no rows of numbers after its headers")
    intervals = [_interval(contents, channel, cells) for channel in range(len(contents.places))]
    positions = {place: channel for channel, place in enumerate(contents.places)}
    used = [intervals[positions[column.number - 1]] for column in chosen if column.number - 1 in positions]
    columns = [_filled(column, cells[column.number - 1]) for column in chosen]
    if used and max(used) - min(used) <= 1e-9 * min(used):
        rate = float(f"{1 / used[0]:.15g}")
        start = contents.number(first, "X0", 0) or 0.0
        ticks, began = _ticks(contents, lines, rate), _stamp(contents, first, 0)
        date = np.datetime64(round(began * 1e6), "us").astype("datetime64[ns]") if np.isfinite(began) else None
        return RawColumns(path, tuple(columns), lines, rate=rate, start=start, ticks=ticks, epoch=date)
    if not used:
        return RawColumns(path, tuple(columns), lines)
    if len(contents.segments) > 1:
        raise ReadError(
            path, "", "has several segments of channels of different rates; write channels of one rate to one file"
        )
    clocked = [_own(contents, column, positions.get(column.number - 1), intervals) for column in columns]
    return RawColumns(path, tuple(clocked), lines)


def _filled(column: RawColumn, values: Array) -> RawColumn:
    return RawColumn(column.label, column.name, column.unit, values, column.number)


def _own(contents: _LvmContents, column: RawColumn, channel: int | None, intervals: Sequence[float]) -> RawColumn:
    """Give a column its own clock and the samples that it has."""
    if channel is None:
        return column
    first = contents.segments[0]
    count = contents.number(first, "Samples", channel)
    values = column.values[: int(count)] if count else column.values
    start = contents.number(first, "X0", channel) or 0.0
    offsets = [_stamp(contents, first, i) for i in (0, channel)]
    start += offsets[1] - offsets[0] if np.isfinite(offsets).all() else 0.0
    clock = Clock(start, intervals[channel])
    return RawColumn(column.label, column.name, column.unit, values, column.number, clock=clock)


def _interval(contents: _LvmContents, channel: int, cells: Mapping[int, Array]) -> float:
    """Time from sample to sample of a channel [s]: as the header states it, or its times where these say otherwise."""
    stated = contents.number(contents.segments[0], "Delta_X", channel)
    at = {"one": 0, "multi": 2 * channel}.get(contents.x_columns, -1)
    end = contents.number(contents.segments[0], "Samples", channel)
    times = cells[at][: int(end) if end else None] if at in cells else np.empty(0)
    times = times[np.isfinite(times)]
    stepped = float(times[-1] - times[0]) / (times.size - 1) if times.size > 2 else 0.0
    rounding = 2e-6 / (times[-1] - times[0]) if stepped > 0 else 0.0
    if stepped > 0 and (not stated or abs(stepped / stated - 1) > ALIKE + rounding):
        if stated and (channel == 0 or at > 0):
            warn_quality(
                f"{contents.path.name}: Delta_X of channel {channel + 1} says {1 / stated:.6g} Hz, but its times step "
                f"by {stepped:.6g} s, which is {1 / stepped:.6g} Hz; the times are taken"
            )
        return stepped
    if not stated or stated < 0:
        raise ReadError(
            contents.path,
            "segment 1",
            f"states no Delta_X above 0 for channel {channel + 1}; give rate in a channel map",
        )
    if stated == 1.0 and not stepped and channel == 0:
        warn_quality(
            f"{contents.path.name}: Delta_X is 1 s, which LabVIEW also writes where signals have no timing; if the "
            "rate is another, give it under [file] of a channel map"
        )
    return stated


def _stamp(contents: _LvmContents, segment: _Segment, channel: int) -> float:
    """Date and time of a channel's first sample [s]; NaN where the segment does not say it."""
    date, time = (contents.tag(segment, name, channel) for name in ("Date", "Time"))
    if not date or not time:
        return float("nan")
    day = np.datetime64("1970-01-01")
    found = re.fullmatch(r"(\d{4})[/.-](\d{2})[/.-](\d{2})", date)
    if found is None:
        return float("nan")
    try:
        days = int((np.datetime64("-".join(found.groups())) - day) / np.timedelta64(1, "D"))
    except ValueError:
        return float("nan")
    return 86400.0 * days + float(stamp_seconds([time], "time of day")[0])


def _ticks(contents: _LvmContents, lines: NDArray[np.intp], rate: float) -> NDArray[np.intp] | None:
    """Sample of the steady clock of every row; None where all segments follow each other without a gap."""
    text = contents.text
    bounds = [text.count(b"\n", 0, segment.rows[0]) + 1 for segment in contents.segments]
    sizes = np.diff(np.append(np.searchsorted(lines, bounds), lines.size))
    begins = [
        _stamp(contents, segment, 0) + (contents.number(segment, "X0", 0) or 0.0) for segment in contents.segments
    ]
    ticks, at, late = [], 0, 0
    for begin, size in zip(begins, sizes, strict=True):
        stated = round((begin - begins[0]) * rate) if np.isfinite(begin - begins[0]) else at
        late += stated < at and begin != begins[0]
        at = max(at, stated)
        ticks.append(at + np.arange(size))
        at += int(size)
    if late:
        warn_quality(
            f"{contents.path.name}: {late} of {len(begins)} segments begin, by their date and time, before the one "
            "before them ends; they are taken to follow it without a gap"
        )
    joined = np.concatenate(ticks).astype(np.intp)
    return None if int(joined[-1]) + 1 == joined.size else joined
