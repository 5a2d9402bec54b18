"""Cells of a spreadsheet as it was written: of a text file as Excel exports it, and of an .xlsx workbook."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from aerobalance.io.opening import opened_file
from aerobalance.io.text_cells import SEPARATORS
from aerobalance.io.text_layout import Layout
from aerobalance.io.text_table import read_text
from aerobalance.recording.errors import ReadError, quiet_libraries

WORKBOOK: Final = b"PK\x03\x04"
"""First bytes of an .xlsx workbook, which is a zip archive."""

OLD_WORKBOOK: Final = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""First bytes of an .xls workbook."""

MOST_BYTES: Final = 256_000_000
"""Most that a workbook may hold unpacked; a calibration's schedule has some hundred kilobytes."""

MOST_ROWS, MOST_COLUMNS = 100_000, 1_000
"""Most rows and columns of a sheet that are read."""

_SEPARATOR_LINE: Final = re.compile(r"sep=(.)\s*")


@dataclass(frozen=True, slots=True)
class Row:
    """A row that is not blank.

    Attributes
    ----------
    line
        Its line in the text file, or its number in the sheet, counted from 1.
    cells
        What stands in it, without blanks at the ends.
    """

    line: int
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Sheet:
    """Rows of one sheet.

    Attributes
    ----------
    name
        The sheet's name; an empty string for a text file.
    rows
        Its rows that are not blank.
    decimal
        Decimal sign of its numbers.
    """

    name: str
    rows: tuple[Row, ...]
    decimal: str


def sheets_of(path: Path, layout: Layout) -> tuple[Sheet, ...]:
    """Return the sheets of a file: those of a workbook, or the one that a text file is.

    Parameters
    ----------
    path
        The file.
    layout
        Separator, decimal sign and encoding of a text file, where they are not to be recognised.

    Raises
    ------
    ReadError
        The file is neither text nor a workbook that can be read; the message says what to do.
    """
    return _workbook(path) if is_workbook(path) else (_text(path, layout),)


def is_workbook(path: Path) -> bool:
    """Return whether a file is an Excel workbook, by its first bytes.

    Raises
    ------
    ReadError
        The file cannot be opened, or is a workbook of the old kind.
    """
    with opened_file(path) as file:
        head = file.read(len(OLD_WORKBOOK))
    if head == OLD_WORKBOOK:
        raise ReadError(path, "", "is an old Excel workbook (.xls); save it as .xlsx or as CSV")
    return head.startswith(WORKBOOK)


def _text(path: Path, layout: Layout) -> Sheet:
    """Rows of a text file."""
    text = read_text(path, layout.encoding)
    first, _, rest = text.partition("\n")
    named = _SEPARATOR_LINE.fullmatch(first)  # what Excel itself reads the separator from
    skipped = 1 if named else 0
    text = rest if named else text
    separator = layout.separator or (named[1] if named else _separator(text))
    rows = []
    for line, cells in _split(text, separator):
        stripped = tuple(cell.strip() for cell in cells)
        if any(stripped):
            rows.append(Row(line + skipped, stripped))
    return Sheet("", tuple(rows), layout.decimal or _decimal(rows, separator))


def _split(text: str, separator: str) -> Iterable[tuple[int, list[str]]]:
    """Lines and their cells; a quoted cell may hold separators and line ends."""
    if separator == " ":
        return [(line, row.split()) for line, row in enumerate(text.split("\n"), start=1)]
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    rows, line = [], 1
    try:
        for cells in reader:
            rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error:  # a quote that is never closed, and the rest of the file behind it
        return [(number, row.split(separator)) for number, row in enumerate(text.split("\n"), start=1)]
    return rows


def _separator(text: str) -> str:
    """Recognise the separator: that which cuts most lines into the same number of cells."""
    best, most = ",", 0
    for sign in (SEPARATORS["tab"], SEPARATORS["semicolon"], SEPARATORS["comma"]):
        widths = Counter(len(cells) for _, cells in _split(text, sign) if len(cells) > 1)
        alike = max(widths.values(), default=0)
        if alike > most:
            best, most = sign, alike
    return best


def _decimal(rows: Sequence[Row], separator: str) -> str:
    """Recognise the decimal sign: a comma where numbers have one, and none has a point."""
    cells = [cell for row in rows for cell in row.cells]
    comma = any(re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell) for cell in cells)
    point = any(re.fullmatch(r"[+-]?\d*\.\d+([eE][+-]?\d+)?", cell) for cell in cells)
    return "," if comma and not point and separator != " " else "."


def _workbook(path: Path) -> tuple[Sheet, ...]:
    """Sheets of an .xlsx workbook; what formulas gave when it was last saved."""
    try:
        import openpyxl  # noqa: PLC0415 - an extra, and only workbooks need it
    except ImportError:
        raise ReadError(
            path,
            "",
            "is an Excel workbook, and reading one needs a library that is not installed: pip install "
            "'aerobalance[excel]'; or save it as CSV",
        ) from None
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MOST_BYTES:
            raise ReadError(path, "", f"unpacks to {size / 1e6:.0f} MB; at most {MOST_BYTES / 1e6:.0f} MB are read")
        with quiet_libraries():  # of styles and extensions, which no reading depends on
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                return tuple(Sheet(sheet.title, tuple(_rows(path, sheet)), ".") for sheet in book.worksheets)
            finally:
                book.close()
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, AttributeError, OSError, SyntaxError) as error:
        raise ReadError(path, "", f"is a zip archive, but no Excel workbook that can be read: {error}") from None


def _rows(path: Path, sheet: Any) -> Iterable[Row]:
    """Rows of a sheet that are not blank."""
    if (sheet.max_row or 0) > MOST_ROWS or (sheet.max_column or 0) > MOST_COLUMNS:
        sheet.reset_dimensions()  # what the file says of its size may be wrong: count while reading
    for number, values in enumerate(sheet.iter_rows(values_only=True, max_col=MOST_COLUMNS), start=1):
        if number > MOST_ROWS:
            raise ReadError(path, f"sheet {sheet.title!r}", f"has more than {MOST_ROWS} rows, which no schedule has")
        cells = tuple(_cell(value) for value in values)
        if any(cells):
            yield Row(number, cells)


def _cell(value: object) -> str:
    """Text of a workbook's cell: numbers with all their digits."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return repr(value) if isinstance(value, float) else str(value).strip()
