"""Text files of numbers in columns: encoding, and the cells of the columns that are wanted."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NoReturn

import numpy as np

from aerobalance.io.columns import RawColumn, RawColumns, split_label
from aerobalance.io.opening import opened_file
from aerobalance.io.text_cells import MISSING, number_in, separator_of, split_line
from aerobalance.io.text_clock import seconds_of
from aerobalance.io.text_layout import Layout, TextLayout, recognise
from aerobalance.io.text_limits import check_columns, check_first_line, check_lines
from aerobalance.io.text_rows import Grid, Lines, no_number, read_cells
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality
from aerobalance.recording.units import expected_unit

_BOMS: Final = (
    (b"\xef\xbb\xbf", "utf-8"),
    (b"\xff\xfe\x00\x00", "utf-32-le"),
    (b"\x00\x00\xfe\xff", "utf-32-be"),
    (b"\xff\xfe", "utf-16-le"),
    (b"\xfe\xff", "utf-16-be"),
)
_HEAD: Final = 1 << 16
_NOTHING: Final = b" \t\r\n\x00\xef\xbb\xbf\xff\xfe"
_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


def guess_encoding(head: bytes) -> str | None:
    """Recognise the encoding of a text from its first bytes; None where they are no text."""
    for bom, name in _BOMS:
        if head.startswith(bom):
            return name
    if b"\x00" in head:
        # In UTF-16 every second byte of digits and separators is zero; which one tells the byte order.
        even, odd = head[0::2], head[1::2]
        for half, other, name in ((odd, even, "utf-16-le"), (even, odd, "utf-16-be")):
            if half.count(0) > 0.9 * len(half) and not _CONTROL.search(other):
                return name
        return None
    if _CONTROL.search(head):
        return None
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def read_text_columns(
    path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None, texts_dropped: bool = False
) -> RawColumns:
    """Read the columns of a text file.

    Parameters
    ----------
    path
        The file.
    layout
        How it is laid out; recognised where left out.
    wanted
        Columns to read, by label, name or number; all where left out. The others may hold anything.
    texts_dropped
        Whether columns without a number are left out, with a warning, if the program does not know their names.

    Raises
    ------
    ReadError
        The file is no table of numbers; the message says where and what is allowed.

    Warns
    -----
    DataQualityWarning
        Columns that hold text are left out.
    """
    return read_text_table(path, layout, wanted=wanted, texts_dropped=texts_dropped)[0]


def read_text_table(
    path: Path,
    layout: Layout | None = None,
    *,
    wanted: Sequence[str | int] | None = None,
    texts_dropped: bool = False,
    clock_wanted: bool = False,
) -> tuple[RawColumns, TextLayout]:
    """Read the columns of a text file, and say how it is laid out; see `read_text_columns`.

    With `clock_wanted` the column that was recognised as the clock is read beside those that are wanted.
    """
    layout = layout or Layout()
    text, encoding = decoded(path, layout.encoding)
    found = _recognised(path, text, layout, encoding)
    if found.header_line == 0 and layout.header_line is None and wanted is None:
        _no_header(path, text, found)
    begin = _offset(text, found.first)
    found = found if found.decimal else replace(found, decimal=_decimal(text[begin:], found.separator))
    heads = heads_of(found)
    chosen = chosen_columns(path, found, wanted, clock_wanted=clock_wanted)
    dropped = [i for i in chosen if texts_dropped and _droppable(found, i)]
    late = [i for i in dropped if found.kinds[i] == "missing"]
    kept = [i for i in chosen if i not in dropped or i in late]
    grid = Grid(found, tuple(kept))
    stamps = [i for i in kept if found.kinds[i] == "stamp" and not found.is_number(i)]
    numbers, told, lines = read_cells(path, text, grid, begin=begin, texts=(*late, *stamps))
    columns = {i: replace(heads[i], values=values) for i, values in numbers.items()}
    epoch: np.datetime64 | None = None
    for i, cells in told.items():
        if i in stamps:
            seconds, first = seconds_of(path, cells, lines=lines, place=heads[i].place)
            epoch = first if found.clock is not None and found.clock.column == i else epoch
            columns[i] = replace(heads[i], values=seconds, unit="s", stamped=True)
        elif (values := _late_numbers(path, heads[i], cells, lines=lines, decimal=grid.decimal)) is not None:
            columns[i] = replace(heads[i], values=values)
    if not len(lines):
        where = f"after line {found.first - 1}"
        raise ReadError(path, where, "there are no rows of numbers; a header and rows are needed")
    _say_dropped(path, heads, [i for i in dropped if i not in columns and i < len(heads) - found.optional])
    return RawColumns(path, tuple(columns[i] for i in kept if i in columns), lines, epoch=epoch), found


def describe_text(path: Path, layout: Layout | None = None) -> TextLayout:
    """Return how a text file is laid out, without reading more than its head.

    Raises
    ------
    ReadError
        The file is no text, or the header line asked for is not there.
    """
    layout = layout or Layout()
    text, encoding = decoded(path, layout.encoding)
    return _recognised(path, text, layout, encoding)


def read_text(path: Path, encoding: str | None = None) -> str:
    """Read a text file whole: byte order mark left out, every line ended by a line feed; encoding recognised if None.

    Raises
    ------
    ReadError
        The file is missing, empty or no text.
    """
    return decoded(path, encoding)[0].decode()


def _bytes(path: Path) -> bytes:
    with opened_file(path) as stream:
        check_first_line(path, stream)
        raw = stream.read()
    check_lines(path, raw)
    return raw


def decoded(path: Path, encoding: str | None) -> tuple[bytes, str]:
    """Read a text file as UTF-8 without byte order mark, one line feed a line; and the encoding that it had.

    Raises
    ------
    ReadError
        The file is missing, empty or no text.
    """
    raw = _bytes(path)
    if not raw[:_HEAD].strip(_NOTHING) and not raw.strip(_NOTHING):
        raise ReadError(path, "", "is empty; a header line and rows of numbers are needed")
    found = encoding or guess_encoding(raw[:_HEAD])
    if found is None:
        raise ReadError(path, "", "is no text file; a table of numbers in columns is needed")
    for bom, name in _BOMS:
        if raw.startswith(bom) and found.replace("_", "-").lower().startswith(name[:6]):
            raw, found = raw[len(bom) :], name
            break
    plain = raw.isascii()
    try:
        if found not in ("utf-8", "ascii") or not plain:
            raw.decode(found)
    except (UnicodeDecodeError, LookupError) as error:
        if encoding is not None:
            raise ReadError(
                path,
                "",
                f"is not in the encoding {encoding!r} of the channel map: {error}; without `encoding` there "
                "it is recognised",
            ) from None
        if found != "utf-8":
            raise ReadError(path, "", f"is cut off or damaged: it begins as {found} text, but {error}") from None
        # The first letter that is no UTF-8 comes late: the head alone does not tell.
        found = "cp1252" if _decodes(raw, "cp1252") else "latin-1"
    if found not in ("utf-8", "ascii"):
        raw = raw.decode(found, errors="replace").encode()
    if b"\r" in raw:
        raw = raw.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    nul = raw.find(b"\x00")
    if nul >= 0:
        line = raw.count(b"\n", 0, nul) + 1
        raise ReadError(path, f"line {line}", "holds zero bytes: the file is damaged, or no text; allowed: numbers")
    # what is plain in all encodings does not tell which one the other files of the same recorder have
    return raw, "ascii" if found == "utf-8" and plain else found


def _decodes(raw: bytes, encoding: str) -> bool:
    try:
        raw.decode(encoding)
    except UnicodeDecodeError:
        return False
    return True


def _recognised(path: Path, text: bytes, layout: Layout, encoding: str) -> TextLayout:
    """Recognise the layout; where no rows of numbers are found, take the first line for the header."""
    found = recognise(text, layout) or _assumed(path, text, layout)
    check_columns(path, found.labels)
    return replace(found, encoding=encoding)


def _assumed(path: Path, text: bytes, layout: Layout) -> TextLayout:
    """Layout of a text in which no rows of numbers were found: the error is told when its cells are read."""
    line, position = 1, 0
    if layout.header_line is None:
        while text[position : position + 1].isspace():
            end = text.find(b"\n", position)
            if text[position : end if end >= 0 else None].strip():
                break
            position, line = end + 1, line + 1
    elif layout.header_line > 1:
        line, position = layout.header_line, _offset(text, layout.header_line)
        if position >= len(text):
            last = text.rstrip(b"\n").count(b"\n") + 1
            raise ReadError(path, "", f"has {last} line(s); the channel map puts the header in {line}")
    end = text.find(b"\n", position)
    header = text[position : end if end >= 0 else None].decode()
    separator = layout.separator or separator_of(header)
    labels = [cell.strip() for cell in split_line(header, separator)]
    if layout.header_line == 0:
        line, labels = 0, [str(i + 1) for i in range(len(labels))]
    return TextLayout(
        separator=separator,
        decimal=layout.decimal,
        header_line=line,
        first=line + 1 + (layout.skip_lines or 0),
        labels=tuple(labels),
        units=tuple(split_label(label)[1] for label in labels),
        kinds=tuple("number" for _ in labels),
    )


def _no_header(path: Path, text: bytes, found: TextLayout) -> NoReturn:
    row = text[_offset(text, found.first) :].split(b"\n", 1)[0].decode()
    raise ReadError(
        path,
        "first line" if found.first == 1 else f"line {found.first}",
        f"holds numbers ({row.strip()[:40]!r}) where the header belongs: name [unit] per column, "
        "for example time [s],AF [N]; or say what the columns are in a channel map, which `aerobalance map FILE` "
        "makes",
    )


def _offset(text: bytes, line: int) -> int:
    """Position at which a line begins, counted from 1; the end where there are fewer."""
    position = 0
    for _ in range(line - 1):
        end = text.find(b"\n", position)
        if end < 0:
            return len(text)
        position = end + 1
    return position


def heads_of(found: TextLayout) -> list[RawColumn]:
    """Return the columns of a text file, without their cells."""
    empty = np.empty(0)
    return [
        RawColumn(label, name, unit, empty, i + 1)
        for i, (label, name, unit) in enumerate(zip(found.labels, found.names, found.units, strict=True))
    ]


def chosen_columns(
    path: Path, found: TextLayout, wanted: Sequence[str | int] | None, *, clock_wanted: bool
) -> list[int]:
    """Return the columns that are wanted, counted from 0; all where left out, and the clock if it is wanted."""
    heads = heads_of(found)
    if wanted is None:
        return list(range(len(heads)))
    stub = RawColumns(path, tuple(heads), range(0))
    where = f"line {max(found.header_line, 1)}"
    chosen = {stub.find(key, where=where).number - 1 for key in wanted}
    return sorted(chosen | ({found.clock.column} if clock_wanted and found.clock is not None else set()))


def _droppable(found: TextLayout, i: int) -> bool:
    """Whether a column that holds no number at the head of the file may be left out."""
    stated_clock = found.clock is not None and found.clock.column == i
    return found.kinds[i] != "number" and not stated_clock and bool(found.labels[i]) and _unknown(found.names[i])


def _unknown(name: str) -> bool:
    return expected_unit(name) is None


def _say_dropped(path: Path, heads: Sequence[RawColumn], dropped: Sequence[int]) -> None:
    if dropped:
        warn_quality(f"{path.name}: left out, for they hold no number: {', '.join(heads[i].place for i in dropped)}")


def _late_numbers(path: Path, head: RawColumn, cells: Sequence[str], *, lines: Lines, decimal: str) -> Array | None:
    """Numbers of a column that holds none at the head of the file; None where it holds none at all."""
    numbers = [number_in(cell, decimal=decimal) for cell in cells]
    if all(number is None for number in numbers):
        return None
    for row, (cell, number) in enumerate(zip(cells, numbers, strict=True)):
        if number is None and cell.strip().lower() not in MISSING:
            raise ReadError(path, f"line {lines[row]}, {head.place}", no_number(cell, decimal))
    return np.array([np.nan if number is None else number for number in numbers])


def _decimal(body: bytes, separator: str) -> str:
    """Recognise the decimal sign from the whole table, where its head has whole numbers only."""
    if b"," not in body or (separator == "," and b'"' not in body):
        return "."
    comma = re.search(rb'(?:^|[;\t\n "])[+-]?\d*,\d+(?:[eE][+-]?\d+)?(?=[;\t\n "]|$)', body)
    if comma is None:
        return "."
    dot = re.search(rb'(?:^|[;\t\n "])[+-]?\d*\.\d+(?:[eE][+-]?\d+)?(?=[;\t\n "]|$)', body[: comma.start() + 1])
    return "." if dot else ","
