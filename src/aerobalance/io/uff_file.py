"""Universal files (UFF): data sets 58 of readings over time, as text or binary (58b); others are passed over.

Data set 58 is a header of eleven lines of fixed columns and the numbers. It is read here and not by a library, since
those cut the binary numbers into lines and take any that look like an end mark for one; tests compare with pyuff.

References
----------
.. [UFF58] Structural Dynamics Research Laboratory, University of Cincinnati, "Universal File Formats for Modal
   Analysis Testing", data sets 58 and 58b.
"""

from __future__ import annotations

import contextlib
import re
import sys
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np

from aerobalance.io.columns import Append, Clock, split_label, time_label
from aerobalance.io.format_library import library_faults
from aerobalance.io.opening import opened_file
from aerobalance.io.safe_write import replacing
from aerobalance.io.said_by_file import date_of
from aerobalance.io.series import MOST_SERIES, Holdings, Series, named
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError
from aerobalance.recording.units import conversion

NAME: Final = "universal file (UFF)"
"""What to call the format in messages."""

_MARK: Final = b"    -1"
_FIRST: Final = re.compile(rb"\s*?    -1\s*?\r?\n *(\d+)(b?)")
_LINES: Final = 11
_LONGEST_LINE: Final = 200
_DIRECTIONS: Final = ("", "X", "Y", "Z", "RX", "RY", "RZ")
_FUNCTIONS: Final = {2: "an auto spectrum", 3: "a cross spectrum", 4: "a frequency response", 6: "a coherence"}
_TIME: Final = 17
_UNEVEN: Final = {2: (13, 13), 4: (13, 20)}


class _Header(NamedTuple):
    """What stands before the numbers of a data set 58."""

    ids: tuple[str, ...]
    function: int
    node: int
    direction: int
    kind: int
    points: int
    even: bool
    start: float
    interval: float
    abscissa: int
    abscissa_unit: str
    unit: str


@dataclass(frozen=True, slots=True)
class _Set:
    """A data set 58: where its numbers are, and what stands before them."""

    number: int
    place: int
    begin: int
    end: int
    order: str
    header: _Header

    @property
    def binary(self) -> bool:
        """Whether its numbers are binary."""
        return bool(self.order)

    @property
    def per_point(self) -> int:
        """Numbers of a point: itself, and its time where that is uneven."""
        return 1 if self.header.even else 2


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is a universal file, from its first bytes."""
    del path
    return _FIRST.match(head[:400]) is not None


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its data sets 58 as series, by their first line or by node and direction.

    Raises
    ------
    ReadError
        The file is damaged.
    """
    with opened_file(path) as file:
        with library_faults(path, NAME, "its data sets"):
            sets, others = _sets(path, file)
            if not sets:
                kinds = ", ".join(sorted(others)) or "none"
                raise ReadError(path, "", f"holds no data set 58 (readings over time); its data sets are {kinds}")
            holdings = _holdings(path, file, sets)
        yield holdings


def _sets(path: Path, file: BinaryIO) -> tuple[list[_Set], set[str]]:
    """Data sets 58, and the numbers of the others."""
    size = path.stat().st_size
    found: list[_Set] = []
    others: set[str] = set()
    place, number = 0, 0
    while (start := _next_mark(file, place, size)) >= 0:
        number += 1
        file.seek(start)
        file.readline(_LONGEST_LINE)
        first = file.readline(_LONGEST_LINE)
        kind = first[:6].strip()
        if kind != b"58":
            others.add(kind.decode("ascii", "replace")[:6])
            end = _next_mark(file, file.tell(), size)
            place = size if end < 0 else end + len(_MARK)
            continue
        where = f"data set {number} of the universal file (byte {start})"
        with library_faults(path, NAME, where):
            lines = [file.readline(_LONGEST_LINE).decode("latin-1").rstrip("\r\n") for _ in range(_LINES)]
            header = _header(lines)
        begin = file.tell()
        order = ""
        if first[6:7].lower() == b"b":
            words = first[7:].split()
            order = "<" if words[0] == b"1" else ">"
            if words[1] != b"2":
                raise ReadError(path, where, f"has numbers that are no IEEE 754 (format {words[1]!r}): not read")
            # Some programs count the values only where each has a time beside it.
            end = begin + max(int(words[3]), _needed(header, binary=True))
        else:
            mark = _next_mark(file, begin, size)
            end = size if mark < 0 else mark
        if end > size:
            raise ReadError(path, where, f"claims {end - begin} bytes, where {size - begin} are left: it is cut off")
        one = _Set(number, start, begin, end, order, header)
        _check(path, where, one)
        found.append(one)
        if len(found) > MOST_SERIES:
            raise ReadError(path, where, f"has more than {MOST_SERIES} data sets, which no recording has")
        after = _next_mark(file, end, min(size, end + _LONGEST_LINE))
        place = size if after < 0 else after + len(_MARK)
    return found, others


def _next_mark(file: BinaryIO, begin: int, end: int) -> int:
    """Place of the next mark that stands alone in its line; -1 where there is none."""
    step = 1 << 20
    while begin < end:
        file.seek(begin)
        part = file.read(min(step + len(_MARK) + 2, end - begin + len(_MARK) + 2))
        at = part.find(_MARK)
        while at >= 0:
            after = part[at + len(_MARK) : at + len(_MARK) + 1]
            if after in (b"", b"\n", b"\r", b" "):
                return begin + at if begin + at < end else -1
            at = part.find(_MARK, at + 1)
        begin += step
    return -1


def _header(lines: list[str]) -> _Header:
    """Header of a data set 58, by its columns (records 1 to 9)."""

    def whole(line: str, begin: int, width: int) -> int:
        return int(line[begin : begin + width].strip() or 0)

    def real(line: str, begin: int) -> float:
        return float(line[begin : begin + 13].strip().replace("D", "E") or 0)

    degrees, form = lines[5], lines[6]
    return _Header(
        ids=tuple(line[:80].strip() for line in lines[:5]),
        function=whole(degrees, 0, 5),
        node=whole(degrees, 41, 10),
        direction=whole(degrees, 51, 4),
        kind=whole(form, 0, 10),
        points=whole(form, 10, 10),
        even=whole(form, 20, 10) == 1,
        start=real(form, 30),
        interval=real(form, 43),
        abscissa=whole(lines[7], 0, 10),
        abscissa_unit=lines[7][46:67].strip(),
        unit=lines[8][46:67].strip(),
    )


def _check(path: Path, where: str, one: _Set) -> None:
    """Refuse a data set whose numbers cannot be where it says."""
    header = one.header
    if header.kind not in (2, 4, 5, 6):
        raise ReadError(path, where, f"has numbers of kind {header.kind}; allowed: 2, 4, 5, 6")
    needed = _needed(header, binary=one.binary)
    if header.points < 0 or needed > one.end - one.begin:
        raise ReadError(
            path,
            where,
            f"claims {header.points} points, for which {one.end - one.begin} bytes are not enough: damaged",
        )


def _needed(header: _Header, *, binary: bool) -> int:
    """Bytes of the numbers of a data set; of text, the least that they may take."""
    width = (4 if header.kind in (2, 5) else 8) if binary else 1
    return header.points * (1 if header.even else 2) * (2 if header.kind > 4 else 1) * width


def _fault(header: _Header) -> str:
    """Return why a data set is no readings over time; an empty string where it is."""
    if header.function not in (0, 1):
        return (
            f"it is {_FUNCTIONS.get(header.function, f'a function of kind {header.function}')}, not readings over time"
        )
    if header.kind > 4:
        return "it holds complex numbers"
    if header.abscissa not in (0, _TIME):
        return f"it is over a quantity of kind {header.abscissa}, not over time (17)"
    if header.even and not 1e-12 <= header.interval <= 1e6:
        return f"its interval is {header.interval:g} {header.abscissa_unit or 's'}"
    return "" if header.points > 1 else f"it has {header.points} point(s)"


def _holdings(path: Path, file: BinaryIO, sets: list[_Set]) -> Holdings:
    """Series of the data sets; the times of those that have their own stand behind them all."""
    labels = _labels(sets)
    series: list[Series] = []
    axes: list[Series] = []
    shared: dict[bytes, str] = {}
    for one, label in zip(sets, labels, strict=True):
        header = one.header
        name, unit = named(label, "" if header.unit.upper() == "NONE" else header.unit)
        clock, axis, fault = None, "", _fault(header)
        if header.even:
            try:
                change = conversion(_unit_of_time(header), expected="s")
                clock = Clock(float(change.inside(header.start)), float(change.inside(header.interval)))
            except ValueError as error:
                fault = fault or f"its times are in another unit than those of time: {error}"
        elif not fault:
            key = _numbers(path, file, one, 0, header.points)[::2].tobytes()
            axis = shared.setdefault(key, f"{label} (times)")
            if axis == f"{label} (times)":
                read = _reader(path, file, one, 0)
                axes.append(Series(axis, "time", _unit_of_time(header), header.points, read, hidden=True))
        read = _reader(path, file, one, one.per_point - 1)
        series.append(Series(label, name, unit, header.points, read, clock=clock, axis=axis, fault=fault))
    dates = (date_of(one.removeprefix("epoch ")) for set_ in sets for one in (set_.header.ids[4],))
    exact = next((date for date in dates if date is not None), None)
    epoch = exact if exact is not None else _date(sets[0].header.ids[2])
    return Holdings((*series, *axes), epoch, parts=all(one.binary for one in sets))


def _unit_of_time(header: _Header) -> str:
    """Unit of the abscissa; seconds where it is the time and states none."""
    text = header.abscissa_unit
    return "s" if text.casefold() in ("", "none", "s", "sec", "second", "seconds") else text


def _labels(sets: list[_Set]) -> list[str]:
    """What a map calls the data sets: their first line where it tells them apart, else node and direction."""
    firsts = [one.header.ids[0] for one in sets]
    points = [
        f"{one.header.node}{'-' if one.header.direction < 0 else '+'}{_DIRECTIONS[min(abs(one.header.direction), 6)]}"
        for one in sets
    ]
    for given in (firsts, points):
        if all(text and text.upper() != "NONE" for text in given) and max(Counter(given).values()) == 1:
            return given
    return [f"set {one.number}" for one in sets]


def _date(text: str) -> np.datetime64 | None:
    """Date and time of the third line, as programs write it; None where it is none."""
    for form in ("%d-%b-%y %H:%M:%S", "%d-%b-%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S"):
        with contextlib.suppress(ValueError):
            return date_of(datetime.strptime(text[:40].strip(), form))
    return date_of(text)


def _reader(path: Path, file: BinaryIO, one: _Set, column: int) -> Any:
    """Read a part of the points of a data set: their times (0) or their values."""
    width = one.per_point
    return lambda begin, end: _numbers(path, file, one, begin, end)[column if width == 2 else 0 :: width]


def _numbers(path: Path, file: BinaryIO, one: _Set, begin: int, end: int) -> Any:
    """Numbers of some points, with their times where they are uneven."""
    header, width = one.header, one.per_point
    if one.binary:
        kind = np.dtype(f"{one.order}f{4 if header.kind == 2 else 8}")
        return np.fromfile(path, kind, count=width * (end - begin), offset=one.begin + width * begin * kind.itemsize)
    file.seek(one.begin)
    cells = _cells(file.read(one.end - one.begin), header)
    return cells[width * begin : width * end]


def _cells(text: bytes, header: _Header) -> Array:
    """Numbers of a data set that is text: in columns of fixed width, as they may touch each other."""
    widths: tuple[int, ...] = (13,) if header.kind == 2 else (20,)
    if not header.even:
        widths = _UNEVEN[header.kind]
    count = header.points * (1 if header.even else 2)
    if b"*" not in text:
        with contextlib.suppress(ValueError), warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # what numpy says of what is no number
            cells = np.fromstring(text.decode("latin-1"), sep=" ")
            if cells.size == count:
                return cells
    found: list[float] = []  # two numbers touch, or one is missing
    for line in text.splitlines():
        at, i = 0, 0
        while (cell := line[at : at + widths[i % len(widths)]]).strip():
            found.append(float(cell))
            at, i = at + widths[i % len(widths)], i + 1
    return np.array(found[:count])


@contextlib.contextmanager
def appending(
    path: Path, labels: Sequence[str], described: object = None, *, epoch: np.datetime64 | None = None, rows: int = 0
) -> Iterator[Append]:
    """Write columns as data sets 58b of double precision, one for each; the file takes its place when all are there.

    The header has room for six digits of start and interval: where that is not exact, every point has its own time.

    Raises
    ------
    ValueError
        There is no column of times, or the file cannot be written.
    """
    del described, rows
    split = {label: split_label(label) for label in labels}
    time = time_label(path, labels, "a universal file")
    parts: dict[str, list[Array]] = {label: [] for label in labels}

    def append(columns: Mapping[str, Array]) -> None:
        for label in labels:
            parts[label].append(np.array(columns[label], dtype="<f8"))

    with replacing(path) as beside:
        yield append
        stamps = np.asarray(conversion(split[time][1], expected="s").inside(np.concatenate(parts.pop(time))))
        clock = _exact_clock(stamps)
        with beside.open("wb") as file:
            for number, label in enumerate(list(parts), start=1):
                values = np.concatenate(parts.pop(label))
                numbers = values if clock is not None else np.column_stack([stamps, values])
                file.write(_head(number, split[label], numbers, clock=clock, epoch=epoch))
                file.write(np.ascontiguousarray(numbers, dtype="<f8").data)
                file.write(_MARK + b"\n")


def _exact_clock(stamps: Array) -> Clock | None:
    """The clock of evenly spaced times, where six digits tell it exactly; None where they do not."""
    if stamps.size < 2:
        return None
    start, interval = (float(f"{one:.5e}") for one in (stamps[0], (stamps[-1] - stamps[0]) / (stamps.size - 1)))
    even = start + np.arange(stamps.size) * interval
    close = np.abs(even - stamps) <= 4 * sys.float_info.epsilon * np.maximum(np.abs(stamps), interval)
    return Clock(start, interval) if interval > 0 and bool(close.all()) else None


def _head(
    number: int, named_as: tuple[str, str], numbers: Array, *, clock: Clock | None, epoch: np.datetime64 | None
) -> bytes:
    """Header of a data set 58b [UFF58]_."""

    def ascii_of(text: str, width: int) -> str:
        plain = text.replace("°C", "degC").replace("°", "deg").replace("µ", "u").replace("·", "*").replace("²", "^2")
        return plain.encode("ascii", "replace").decode()[:width]

    name, unit = named_as
    points, size = len(numbers), numbers.nbytes
    date = "NONE"
    if epoch is not None:
        date = datetime.fromisoformat(str(epoch.astype("datetime64[s]"))).strftime("%d-%b-%y %H:%M:%S")
    exact = f"epoch {epoch}" if epoch is not None else "NONE"
    ids = (ascii_of(name, 80), "recorded channel, written by aerobalance", date, "NONE", exact)
    start, interval = (clock.start, clock.interval) if clock is not None else (0.0, 0.0)
    lines = [
        "    -1",
        f"    58b{1:6d}{2:6d}{11:12d}{size:12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *(f"{text:<80}" for text in ids),
        f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':>10}{number:10d}{0:4d} {'NONE':>10}{0:10d}{0:4d}",
        f"{4:10d}{points:10d}{int(clock is not None):10d}{start:13.5e}{interval:13.5e}{0.0:13.5e}",
        f"{_TIME:10d}{0:5d}{0:5d}{0:5d} {'Time':<20} {'s':<20}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {ascii_of(name, 20):<20} {ascii_of(unit, 20):<20}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")
