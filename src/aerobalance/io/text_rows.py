"""Rows of a text table: the cells of the columns that are wanted, and where one is wrong."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.measure import beyond_all_measure, take_out
from aerobalance.io.text_cells import MISSING, number_pattern, split_line
from aerobalance.io.text_layout import TextLayout
from aerobalance.io.text_limits import check_quotes
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality

if TYPE_CHECKING:
    import pandas as pd

Lines = Sequence[int] | NDArray[np.intp]
"""Line of every row, counted from 1."""

BLOCK: Final = 1 << 21
"""Bytes of a table that are worked on at once."""

LONG: Final = 1 << 24
"""Size of a text from which on a compiled loop reads it, which takes half a second to load [bytes]."""

_SPELT: Final = tuple(
    {spelt for word in MISSING for spelt in (word, word.upper(), word.title(), word.replace("nan", "NaN"))}
)


@dataclass(frozen=True, slots=True)
class Grid:
    """What is needed to read the cells.

    Attributes
    ----------
    found
        How the table is laid out.
    chosen
        Columns to read, counted from 0.
    """

    found: TextLayout
    chosen: tuple[int, ...]

    @property
    def separator(self) -> str:
        """Character between cells."""
        return self.found.separator

    @property
    def decimal(self) -> str:
        """Decimal sign."""
        return self.found.decimal or "."

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.found.labels)

    @property
    def first(self) -> int:
        """Line of the first row."""
        return self.found.first

    @property
    def least(self) -> int:
        """Number of cells that every row has."""
        return self.width - self.found.optional


def read_cells(
    path: Path, text: bytes, grid: Grid, *, begin: int = 0, texts: Sequence[int] = (), long: bool = False
) -> tuple[dict[int, Array], dict[int, list[str]], Lines]:
    """Read the cells of the chosen columns.

    Parameters
    ----------
    path
        The file, for messages.
    text
        The rows, in UTF-8.
    grid
        Which columns, and how they are laid out.
    begin
        Where the rows begin in the text.
    texts
        Columns whose cells are wanted as they stand; those of the others have to be numbers.
    long
        Whether they are some of the rows of a long text.

    Returns
    -------
    numbers
        Cells of each column of numbers, shape (n,); NaN where missing.
    texts
        Cells of the other columns, n of each; empty where missing.
    lines
        Line of every row, n of them.

    Raises
    ------
    ReadError
        A row has too few or too many cells, or a cell is no number.
    """
    if not text[begin : begin + 4096].strip() and not text[begin:].strip():
        return {i: np.empty(0) for i in grid.chosen}, {}, range(0)
    end = _without_last_separators(text, begin)
    lines: Lines
    numbers = None if texts else _plain(text, begin, end, grid, long=long or len(text) > LONG)
    frame = None
    if numbers is not None:
        lines = range(grid.first, grid.first + (next(iter(numbers.values())).size if numbers else 0))
    else:
        body = text[begin:end]
        frame = _careful(path, body, grid, texts)
        lines = _lines(body, grid.first, len(frame))
        numbers = {
            i: frame[i].to_numpy(dtype=np.float64, copy=True, na_value=np.nan) for i in grid.chosen if i not in texts
        }
    beyond = [(int(places[0]), i, places.size) for i, cells in numbers.items() if (places := take_out(cells)).size]
    if beyond:
        row, number, _ = min(beyond)
        where = f"line {lines[row]}, column {number + 1} ({grid.found.labels[number]!r})"
        warn_quality(f"{path.name}: {beyond_all_measure(sum(count for *_, count in beyond), where)}")
    told = {} if frame is None else {i: frame[i].astype(object).fillna("").astype(str).to_list() for i in texts}
    return numbers, told, lines


def _plain(text: bytes, begin: int, last: int, grid: Grid, *, long: bool) -> dict[int, Array] | None:
    """Numbers of a table that has no more than digits, signs and as many separators in every row; None of any other.

    A cell that is empty or no number makes the table another one. The text is worked through in blocks that stay in
    the processor's cache: of a long one by a compiled loop, unless a number has too many digits for it.
    """
    sign = grid.separator.encode()
    line = text.find(b"\n", begin, last)
    most = text.count(sign, begin, last if line < 0 else line) + 1
    if sign == b" " or not grid.chosen or not grid.least <= most <= grid.width:
        return None
    kept = [i for i in grid.chosen if i < most]
    there = np.empty((len(kept), text.count(b"\n", begin, last) + 1))
    rows = 0
    while begin < last:
        end = text.rfind(b"\n", begin, min(begin + BLOCK, last)) + 1 or last
        found = _fill(memoryview(text)[begin:end], grid, most, kept, there[:, rows:], long=long)
        if found < 0:
            return None
        rows, begin = rows + found, end
    numbers = dict(zip(kept, there[:, :rows], strict=True))
    return {i: numbers[i] if i in numbers else np.full(rows, np.nan) for i in grid.chosen}


def _fill(block: memoryview, grid: Grid, width: int, kept: list[int], there: Array, *, long: bool) -> int:
    """Put the numbers of a block into an array, shape (columns, n); the number of its rows, below zero for none."""
    if long:
        from aerobalance.io._text_kernels import plain_numbers  # noqa: PLC0415 - compiled loops take time to load

        places = np.full(width, -1)
        places[kept] = np.arange(len(kept))
        cells = np.frombuffer(block, dtype=np.uint8)
        rows = plain_numbers(cells, ord(grid.separator), ord(grid.decimal), places, there)
        if rows >= 0:
            return rows
    frame = _plain_block(bytes(block), grid, width, kept)
    if frame is None:
        return -1
    for place, i in enumerate(kept):
        there[place, : len(frame)] = frame[i].to_numpy()
    return len(frame)


def _plain_block(block: bytes, grid: Grid, width: int, kept: list[int]) -> pd.DataFrame | None:
    """Cells of a plain block, as is seen from what is left without the letters of numbers; None of any other."""
    import pandas as pd  # noqa: PLC0415 - half a second, and only reading text needs it

    left = block.translate(None, b"0123456789+-eE" + grid.decimal.encode())
    left = left if left.endswith(b"\n") else left + b"\n"
    rows = len(left) // width
    if left != (grid.separator.encode() * (width - 1) + b"\n") * rows:
        return None
    try:
        frame = pd.read_csv(
            io.BytesIO(block),
            sep=grid.separator,
            decimal=grid.decimal,
            header=None,
            names=list(range(width)),
            usecols=kept,
            index_col=False,
            dtype=np.float64,
            na_filter=False,
        )
    except (ValueError, pd.errors.ParserError, OverflowError):
        return None
    return frame if len(frame) == rows else None


def _careful(path: Path, body: bytes, grid: Grid, texts: Sequence[int]) -> pd.DataFrame:
    """Cells of any table, which is looked at row by row where something is wrong."""
    import pandas as pd  # noqa: PLC0415 - half a second, and only reading text needs it

    if grid.separator != " ":
        check_quotes(path, body, separator=grid.separator, first=grid.first)
    most = _check_shape(path, body, grid)
    kept = [i for i in grid.chosen if i < most]
    try:
        frame = pd.read_csv(
            io.BytesIO(body),
            sep=r"\s+" if grid.separator == " " else grid.separator,
            decimal=grid.decimal,
            header=None,
            names=list(range(most)),
            usecols=kept,
            index_col=False,
            dtype={i: str if i in texts else np.float64 for i in kept},
            na_values=list(_SPELT),
            skipinitialspace=True,
        )
    except (ValueError, pd.errors.ParserError, OverflowError) as error:
        _find_fault(path, body, grid, [i for i in grid.chosen if i not in texts], str(error))
    return frame.reindex(columns=grid.chosen)


def _without_last_separators(text: bytes, begin: int) -> int:
    """Where the rows end, without last ones that hold nothing but separators, as spreadsheets write them."""
    end = len(text)
    while True:
        last = text.rfind(b"\n", begin, max(begin, end - 1)) + 1
        if last == 0 or text[last:end].strip(b' ;,\t"\n'):
            return end
        end = last


def _check_shape(path: Path, body: bytes, grid: Grid) -> int:
    """Make sure that rows have as many cells as the header, for the parser fills short ones up silently; the most."""
    sign = grid.separator.encode()
    rows = body.count(b"\n") + (not body.endswith(b"\n"))
    even = body.count(sign) == rows * (grid.width - 1) or grid.least < grid.width
    if not even or b'"' in body or grid.width == 1 or sign == b" ":
        return _find_ragged(path, body, grid)
    cells = np.frombuffer(body, dtype=np.uint8)
    ends, marks = np.flatnonzero(cells == ord("\n")), np.flatnonzero(cells == ord(sign))
    per_row = np.diff(np.concatenate(([0], np.searchsorted(marks, ends), [marks.size])))
    if body.endswith(b"\n"):
        per_row = per_row[:-1]
    if ((per_row < grid.least - 1) | (per_row > grid.width - 1)).any():
        return _find_ragged(path, body, grid)
    return int(per_row.max()) + 1


def _find_ragged(path: Path, body: bytes, grid: Grid) -> int:
    """Refuse a row with too few or too many cells; the most that a row has."""
    most = 0
    for number, line in enumerate(body.decode().split("\n"), start=grid.first):
        if not line.strip():
            continue
        found = len(split_line(line, grid.separator))
        most = max(most, found)
        if not grid.least <= found <= grid.width:
            named = {",": "comma", ";": "semicolon", "\t": "tab", " ": "spaces"}.get(
                grid.separator, repr(grid.separator)
            )
            raise ReadError(
                path,
                f"line {number}",
                f"has {found} cell(s) ({line.strip()[:40]!r}), but the header has {grid.width}, separated by {named}; "
                "every row needs one cell per column (empty where a sample is missing); if another line is the "
                "header, put header_line under [file] of a channel map, which `aerobalance map FILE` makes",
            )
    return most


def _find_fault(path: Path, body: bytes, grid: Grid, numeric: Sequence[int], reason: str) -> NoReturn:
    """Find the cell that is no number, and say where it is."""
    _find_ragged(path, body, grid)
    number = number_pattern(grid.decimal)
    for line, text in enumerate(body.decode().split("\n"), start=grid.first):
        if not text.strip():
            continue
        cells = split_line(text, grid.separator)
        for i in numeric:
            if i < len(cells) and not number.fullmatch(cells[i]) and cells[i].strip().lower() not in MISSING:
                where = f"line {line}, column {i + 1} ({grid.found.labels[i]!r})"
                raise ReadError(path, where, no_number(cells[i], grid.decimal))
    raise ReadError(path, "", f"cannot be read as a table of numbers: {reason}")


def no_number(cell: str, decimal: str) -> str:
    """Return what is wrong with a cell, what is allowed and what to do."""
    other = "," if decimal == "." else "."
    told = (
        f'; if the decimal sign of this file is {other!r}, put decimal = "{other}" under [file] of a channel map, '
        "which `aerobalance map FILE` makes"
        if number_pattern(other).fullmatch(cell)
        else ""
    )
    return (
        f"{cell.strip()[:40]!r} is no number; allowed: numbers such as -12{decimal}5 or 1{decimal}2e-3, and an empty "
        f"cell or NaN for a missing sample{told}"
    )


def _lines(body: bytes, first: int, rows: int) -> Lines:
    """Line number of every row; blank lines are none."""
    lines = body.rstrip(b"\n").count(b"\n") + 1
    if lines == rows:
        return range(first, first + rows)
    full = [i for i, line in enumerate(body.split(b"\n"), start=first) if line.strip()]
    return np.asarray(full[:rows], dtype=np.intp)
