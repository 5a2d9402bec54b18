"""Text files of numbers in columns: encoding, separator, decimal sign and cells."""

from __future__ import annotations

import codecs
import csv
import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from aerobalance.channel import Array
from aerobalance.io.columns import RawColumn, RawColumns, split_label
from aerobalance.problems import DoubtWarning, ReadError

MISSING: Final = (
    *("", "nan", "na", "n/a", "#n/a", "null", "none", "<na>", "-nan"),
    *(f"{sign}{word}" for sign in ("", "+", "-") for word in ("inf", "infinity")),
)
"""Cells, in small, capital or mixed letters, that say that a sample is missing."""

_SPELT: Final = tuple(
    {spelt for word in MISSING for spelt in (word, word.upper(), word.title(), word.replace("nan", "NaN"))}
)

LARGEST: Final = 1e100
"""Cells beyond this are no measurement, and their squares no number."""


def beyond_all_measure(count: int, where: str) -> str:
    """Say that cells or samples hold numbers beyond `LARGEST`, and what becomes of them."""
    return (
        f"{count} number(s) beyond {LARGEST:.0e} either way, which no reading is, the first in {where}: "
        "they count as missing"
    )


SEPARATORS: Final = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
"""Column separators that may be named in a channel map."""

_BOMS: Final = (
    (b"\xef\xbb\xbf", "utf-8"),
    (b"\xff\xfe\x00\x00", "utf-32-le"),
    (b"\x00\x00\xfe\xff", "utf-32-be"),
    (b"\xff\xfe", "utf-16-le"),
    (b"\xfe\xff", "utf-16-be"),
)
_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


@dataclass(frozen=True, slots=True)
class Layout:
    """How a text file is laid out, where that is not to be recognised from the file.

    Attributes
    ----------
    separator
        Character between columns; None to recognise it.
    decimal
        Decimal sign, ``"."`` or ``","``; None to recognise it.
    header_line
        Line of the header, counted from 1; 0 for a file without; None for the first line that is not blank.
    skip_lines
        Lines between the header and the first row of numbers (a row of units, say).
    encoding
        Character encoding; None to recognise it.
    """

    separator: str | None = None
    decimal: str | None = None
    header_line: int | None = None
    skip_lines: int = 0
    encoding: str | None = None


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
    path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None
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

    Raises
    ------
    ReadError
        The file is no table of numbers; the message says where and what is allowed.
    """
    layout = layout or Layout()
    body, header, first = _body(path, layout)
    separator = layout.separator or separator_of(header if header is not None else body[:4000].decode())
    labels = _labels(path, header, body, separator)
    start = 1 if header is None else first
    columns = [(i, label, *split_label(label)) for i, label in enumerate(labels)]
    if wanted is None:
        chosen = columns
    else:
        empty = np.empty(0)
        stub = RawColumns(path, tuple(RawColumn(lb, nm, un, empty, i + 1) for i, lb, nm, un in columns), range(0))
        numbers = {stub.find(key, where=f"line {max(start - 1, 1)}").number - 1 for key in wanted}
        chosen = [column for column in columns if column[0] in numbers]
    decimal = layout.decimal or _decimal(body, separator)
    values = _cells(path, body, _Grid(separator, decimal, len(labels), tuple(c[0] for c in chosen), first, labels))
    lines = _lines(body, first, values.shape[0])
    if values.shape[0] == 0:
        raise ReadError(path, f"after line {first - 1}", "there are no rows of numbers; a header and rows are needed")
    return RawColumns(
        path,
        tuple(RawColumn(lb, nm, un, values[:, j], i + 1) for j, (i, lb, nm, un) in enumerate(chosen)),
        lines,
    )


def read_labels(path: Path, layout: Layout | None = None) -> list[str]:
    """Read only the header cells of a text file."""
    layout = layout or Layout()
    body, header, _ = _body(path, layout)
    return _labels(path, header, body, layout.separator or separator_of(header or body[:4000].decode()))


def read_text(path: Path, encoding: str | None = None) -> str:
    """Read a text file whole: byte order mark left out, every line ended by a line feed; encoding recognised if None.

    Raises
    ------
    ReadError
        The file is missing, empty or no text.
    """
    return _utf8(path, encoding).decode()


def separator_of(line: str) -> str:
    """Recognise the separator from a header line: tab before semicolon before comma, brackets and quotes left out."""
    bare = re.sub(r"\[[^\]]*\]|\"[^\"]*\"|\([^)]*\)", "", line)
    return next((sign for sign in "\t;," if sign in bare), ",")


def split_line(line: str, separator: str) -> list[str]:
    """Split a line into cells; quoted cells may hold the separator, and a space stands for any number of them."""
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # a cell of more than a hundred thousand characters
        return line.split(separator)


def number_in(cell: str, *, decimal: str = ".") -> float | None:
    """Read the number in a cell; None where the cell holds none, or one that no reading is (beyond `LARGEST`)."""
    if not _number_pattern(decimal).fullmatch(cell):
        return None
    value = float(cell.strip().replace(decimal, "."))
    return value if abs(value) <= LARGEST else None


@cache
def _number_pattern(decimal: str) -> re.Pattern[str]:
    sign = re.escape(decimal)
    return re.compile(rf"\s*[+-]?(\d+{sign}?\d*|{sign}\d+)([eE][+-]?\d+)?\s*", re.ASCII)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ReadError(path, "", "there is no such file") from None
    except IsADirectoryError:
        raise ReadError(path, "", "is a folder; a file is needed") from None
    except OSError as error:
        raise ReadError(path, "", f"cannot be read: {error.strerror or error}") from None


def _utf8(path: Path, encoding: str | None) -> bytes:
    """Read a text file as UTF-8 without byte order mark, one line feed a line."""
    raw = _bytes(path)
    if not raw.strip(b" \t\r\n\x00\xef\xbb\xbf\xff\xfe"):
        raise ReadError(path, "", "is empty; a header line and rows of numbers are needed")
    found = encoding or guess_encoding(raw[:65536])
    if found is None:
        raise ReadError(path, "", "is no text file; a table of numbers in columns is needed")
    for bom, name in _BOMS:
        if raw.startswith(bom) and found.replace("_", "-").lower().startswith(name[:6]):
            raw, found = raw[len(bom) :], name
            break
    try:
        raw.decode(found)
    except (UnicodeDecodeError, LookupError) as error:
        if encoding is not None:
            raise ReadError(path, "", f"is not in the encoding {encoding!r} of the channel map: {error}") from None
        if found != "utf-8":
            raise ReadError(path, "", f"is cut off or damaged: it begins as {found} text, but {error}") from None
        found = "latin-1"
    if found not in ("utf-8", "ascii"):
        raw = raw.decode("cp1252" if found == "cp1252" else found, errors="replace").encode()
    if b"\r" in raw:
        raw = raw.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    nul = raw.find(b"\x00")
    if nul >= 0:
        line = raw.count(b"\n", 0, nul) + 1
        raise ReadError(path, f"line {line}", "holds zero bytes: the file is damaged, or no text; allowed: numbers")
    return raw


def _body(path: Path, layout: Layout) -> tuple[bytes, str | None, int]:
    """Split a file into rows of numbers and header; return them and the line number of the first row."""
    text = _utf8(path, layout.encoding)
    line, position = 1, 0
    if layout.header_line is None:
        while text[position : position + 1].isspace():
            end = text.find(b"\n", position)
            if text[position : end if end >= 0 else None].strip():
                break
            position, line = end + 1, line + 1
    for _ in range((layout.header_line or 1) - 1):
        end = text.find(b"\n", position)
        if end < 0:
            raise ReadError(path, "", f"has {line} line(s); the channel map puts the header in {layout.header_line}")
        position, line = end + 1, line + 1
    header = None
    if layout.header_line != 0:
        end = text.find(b"\n", position)
        end = len(text) if end < 0 else end
        header = text[position:end].decode()
        position, line = end + 1, line + 1
    for _ in range(layout.skip_lines):
        end = text.find(b"\n", position)
        position, line = (len(text) if end < 0 else end + 1), line + 1
    return text[position:], header, line


def _decimal(body: bytes, separator: str) -> str:
    """Recognise the decimal sign."""
    if separator == "," and b'"' not in body:
        return "."
    comma = re.search(rb'(?:^|[;\t "])[+-]?\d*,\d+(?:[eE][+-]?\d+)?(?=[;\t\n "]|$)', body)
    if comma is None:
        return "."
    dot = re.search(rb"\d\.\d|\.\d", body[: comma.start()])
    return "." if dot else ","


def _labels(path: Path, header: str | None, body: bytes, separator: str) -> list[str]:
    if header is None:
        end = body.find(b"\n")
        first = body[: end if end >= 0 else None].decode()
        return [str(i + 1) for i in range(len(split_line(first, separator)))]
    labels = [cell.strip() for cell in split_line(header, separator)]
    if all(re.fullmatch(r"[+-]?[\d.,]+([eE][+-]?\d+)?", cell) for cell in labels if cell) and any(labels):
        raise ReadError(
            path,
            "first line",
            f"holds numbers ({header.strip()[:40]!r}) where the header belongs: name [unit] per column, "
            "for example time [s],AF [N]",
        )
    return labels


@dataclass(frozen=True, slots=True)
class _Grid:
    """What is needed to read the cells."""

    separator: str
    decimal: str
    width: int
    chosen: tuple[int, ...]
    first: int
    labels: list[str]


def _cells(path: Path, body: bytes, grid: _Grid) -> Array:
    """Read the cells of the chosen columns, shape (n, c)."""
    import pandas as pd  # noqa: PLC0415 - half a second, and only reading text needs it

    if not body.strip():
        return np.empty((0, len(grid.chosen)))
    blank = grid.separator == " "
    if not blank:
        _check_shape(path, body, grid)
    try:
        frame = pd.read_csv(
            io.BytesIO(body),
            sep=r"\s+" if blank else grid.separator,
            decimal=grid.decimal,
            header=None,
            names=list(range(grid.width)),
            usecols=list(grid.chosen),
            index_col=False,
            dtype=np.float64,
            na_values=list(_SPELT),
            skipinitialspace=True,
        )
    except (ValueError, pd.errors.ParserError, OverflowError) as error:
        _find_fault(path, body, grid, str(error))
    values = frame.to_numpy(dtype=np.float64, copy=True, na_value=np.nan)
    large = np.argwhere(np.abs(values) > LARGEST)
    if large.size:
        row, column = large[0]
        line, number = _lines(body, grid.first, values.shape[0])[row], grid.chosen[column]
        where = f"line {line}, column {number + 1} ({grid.labels[number]!r})"
        warnings.warn(f"{path.name}: {beyond_all_measure(len(large), where)}", DoubtWarning, stacklevel=6)
        values[np.abs(values) > LARGEST] = np.nan
    return np.asfortranarray(values)


def _check_shape(path: Path, body: bytes, grid: _Grid) -> None:
    """Make sure that every row has as many cells as the header: the parser fills short rows up silently."""
    separators = body.count(grid.separator.encode())
    rows = body.count(b"\n") + (not body.endswith(b"\n"))
    if separators != rows * (grid.width - 1) or b'"' in body or grid.width == 1:
        _find_ragged(path, body, grid)
        return
    ends = np.flatnonzero(np.frombuffer(body, dtype=np.uint8) == ord("\n"))
    marks = np.flatnonzero(np.frombuffer(body, dtype=np.uint8) == ord(grid.separator))
    per_row = np.diff(np.concatenate(([0], np.searchsorted(marks, ends), [marks.size])))
    if body.endswith(b"\n"):
        per_row = per_row[:-1]
    if (per_row != grid.width - 1).any():
        _find_ragged(path, body, grid)


def _find_ragged(path: Path, body: bytes, grid: _Grid) -> None:
    for number, line in enumerate(body.decode().split("\n"), start=grid.first):
        if not line.strip():
            continue
        found = len(split_line(line, grid.separator))
        if found != grid.width:
            named = {",": "comma", ";": "semicolon", "\t": "tab"}.get(grid.separator, repr(grid.separator))
            raise ReadError(
                path,
                f"line {number}",
                f"has {found} cell(s) ({line.strip()[:40]!r}), but the header has {grid.width}, separated by {named}; "
                "every row needs one cell per column (empty where a sample is missing)",
            )


def _find_fault(path: Path, body: bytes, grid: _Grid, reason: str) -> NoReturn:
    """Find the cell that is no number, and say where it is."""
    _find_ragged(path, body, grid)
    number = _number_pattern(grid.decimal)
    for line, text in enumerate(body.decode().split("\n"), start=grid.first):
        if not text.strip():
            continue
        cells = split_line(text, grid.separator)
        for i in grid.chosen:
            if not number.fullmatch(cells[i]) and cells[i].strip().lower() not in MISSING:
                raise ReadError(
                    path,
                    f"line {line}, column {i + 1} ({grid.labels[i]!r})",
                    f"{cells[i].strip()[:40]!r} is no number; allowed: numbers such as "
                    f"-12{grid.decimal}5 or 1{grid.decimal}2e-3, and an empty cell or NaN for a missing sample",
                )
    raise ReadError(path, "", f"cannot be read as a table of numbers: {reason}")


def _lines(body: bytes, first: int, rows: int) -> Sequence[int] | NDArray[np.intp]:
    """Line number of every row; blank lines are none."""
    lines = body.rstrip(b"\n").count(b"\n") + 1
    if lines == rows:
        return range(first, first + rows)
    full = [i for i, line in enumerate(body.split(b"\n"), start=first) if line.strip()]
    return np.asarray(full[:rows], dtype=np.intp)
