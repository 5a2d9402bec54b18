"""How a text table is laid out, recognised from its head: preamble, header, units, separator, kinds of columns."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from aerobalance.io.columns import split_label
from aerobalance.io.text_cells import SEPARATORS, Kind, kind_of, split_line
from aerobalance.io.text_clock import FoundClock, StatedRate, find_clock, is_time_name, is_time_unit, stated_rate
from aerobalance.io.text_limits import MOST_COLUMNS
from aerobalance.recording.units import readable

HEAD: Final = 1 << 20
"""Bytes from which the layout is recognised, so that a long file takes no longer than a short one."""

_FIRST: Final = 1 << 15
_LINES: Final = 20_000
_SAMPLE: Final = 60
_HEADER_LINES: Final = 8
_COMMENT: Final = re.compile(
    r"(?:comm?ent|kommentar|bemerkung|remark|note|annotation|remarque|observaci|ereignis|event|marker|marke)\w*.*",
    re.IGNORECASE,
)
_NO_UNIT: Final = ("", "-", "--", "1", "%")
_NAMED_UNIT: Final = re.compile(r".*\S\s*(?:\[[^\[\]]+\]|\([^()]+\))\s*")


@dataclass(frozen=True, slots=True)
class Layout:
    """How a file is laid out, where somebody says it: what is left out is recognised from the file.

    Attributes
    ----------
    separator
        Character between columns; None to recognise it.
    decimal
        Decimal sign, ``"."`` or ``","``; None to recognise it.
    header_line
        Line of the header, counted from 1; 0 for a file without; None to recognise it.
    skip_lines
        Lines between the header and the first row of numbers (a row of units, say); None to recognise it.
    encoding
        Character encoding; None to recognise it.
    clocked
        Whether somebody says what the clock is; it is recognised too where not.
    rate
        Sampling rate that somebody says [Hz]; None where nobody does.
    time_unit
        Unit of the column of times that somebody says; None where nobody does.
    """

    separator: str | None = None
    decimal: str | None = None
    header_line: int | None = None
    skip_lines: int | None = None
    encoding: str | None = None
    clocked: bool = False
    rate: float | None = None
    time_unit: str | None = None


@dataclass(frozen=True, slots=True)
class TextLayout:
    """How a text table is laid out.

    Attributes
    ----------
    separator
        Character between columns; a space stands for any number of them.
    decimal
        Decimal sign; None where no number at the head of the file has one.
    header_line
        Line of the header, counted from 1; 0 for a file without.
    first
        Line of the first row of numbers, counted from 1.
    labels
        Header cell of each column; numbers where there is no header.
    units
        Unit of each column, from the header or a row of units; empty strings where there is none.
    kinds
        What the cells of each column hold at the head of the file: ``"missing"`` where they hold nothing.
    optional
        Number of last columns whose cells a row may leave out.
    clock
        The column of times; None where there is none.
    stated
        Sampling rate that the text before the header states; None where it states none.
    encoding
        Character encoding of the file.
    """

    separator: str
    decimal: str | None
    header_line: int
    first: int
    labels: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[Kind, ...]
    optional: int = 0
    clock: FoundClock | None = None
    stated: StatedRate | None = None
    encoding: str = "utf-8"

    @property
    def names(self) -> tuple[str, ...]:
        """Header cells without units."""
        return tuple(split_label(label)[0] for label in self.labels)

    def is_number(self, column: int) -> bool:
        """Return whether a column, counted from 0, has to hold numbers: most cells do, or its unit is one of time."""
        return self.kinds[column] == "number" or is_time_unit(self.units[column])

    @property
    def skip_lines(self) -> int:
        """Lines between the header and the first row of numbers."""
        return self.first - self.header_line - 1


@dataclass(frozen=True, slots=True)
class _TextGrid:
    """Rows of numbers as one separator shows them."""

    separator: str
    width: int
    start: int
    kinds: tuple[Kind, ...]
    share: float
    header: int | None = None
    rows: tuple[list[str], ...] = field(default=(), repr=False)

    @property
    def rank(self) -> tuple[float, bool, int]:
        """What makes one separator better than another."""
        return (round(self.share, 2), self.header is not None, self.width)


def _head_lines(text: bytes, size: int) -> list[str]:
    """Split the head of a text into lines, the last one left out where it is cut off."""
    head = text[:size]
    if len(text) > size:
        head = head[: head.rfind(b"\n") + 1] or head
    return head.decode("utf-8", errors="replace").rstrip("\n").split("\n")[:_LINES]


def recognise(text: bytes, given: Layout) -> TextLayout | None:
    """Recognise how a text table is laid out; None where no rows of numbers are found.

    Parameters
    ----------
    text
        The file in UTF-8, a line feed a line; not more than `HEAD` bytes of it are looked at.
    given
        What somebody says of it.
    """
    signs = [given.separator] if given.separator else ["\t", ";", ",", " "]
    if given.header_line is None and given.skip_lines is None:
        plain = _plain(_head_lines(text, _FIRST), given)
        if plain is not None:
            return plain
    lines = _head_lines(text, HEAD)
    grids = [grid for grid in (_grid(lines, sign, given) for sign in signs) if grid is not None]
    if not grids:
        return None
    return _finished(lines, max(grids, key=lambda grid: grid.rank), given)


def _plain(lines: Sequence[str], given: Layout) -> TextLayout | None:
    """The layout of a table whose first line names every column with its unit; None for any other."""
    at = next((i for i, line in enumerate(lines) if line.strip()), None)
    below = None if at is None else next((i for i in range(at + 1, len(lines)) if lines[i].strip()), None)
    if at is None or below is None:
        return None
    separator = given.separator or next((sign for sign in "\t;," if sign in _bare(lines[at])), ",")
    labels = [cell.strip() for cell in split_line(lines[at], separator)]
    row = split_line(lines[below], separator)
    if (
        len(labels) > MOST_COLUMNS
        or not all(split_label(label)[1] for label in labels if label)
        or "number" not in map(kind_of, row)
    ):
        return None
    rows = _rows(lines, at + 1, separator)
    ended = all(len(row) == len(labels) + 1 and not row[-1] for row in rows)  # by a separator, which the header is not
    width = len(labels) + ended
    grid = _TextGrid(separator, width, at + 1, _kinds(rows, width), 1.0, at, tuple(rows))
    return _finished(lines, grid, given)


def _bare(line: str) -> str:
    return re.sub(r"\[[^\]]*\]|\"[^\"]*\"|\([^)]*\)", "", line)


def _rows(lines: Sequence[str], start: int, separator: str) -> list[list[str]]:
    """Cells of the first rows from a line on."""
    found: list[list[str]] = []
    for line in lines[start:]:
        if line.strip():
            found.append([cell.strip() for cell in split_line(line, separator)])
        if len(found) == _SAMPLE:
            break
    return found


def _kinds(rows: Sequence[Sequence[str]], width: int) -> tuple[Kind, ...]:
    """What most cells of each column hold that hold anything."""
    kinds: list[Kind] = []
    for i in range(width):
        counted = Counter(kind_of(row[i]) for row in rows if i < len(row))
        del counted["missing"]
        most = max(counted.values(), default=0)
        # In doubt a number: the reader then says which cell is none.
        order: tuple[Kind, ...] = ("number", "stamp", "text")
        kinds.append(next((kind for kind in order if counted[kind] == most), "text") if most else "missing")
    return tuple(kinds)


def _grid(lines: Sequence[str], separator: str, given: Layout) -> _TextGrid | None:
    """Find the rows of numbers as one separator shows them; None where it shows none."""
    least = 0 if given.header_line is None else given.header_line + (given.skip_lines or 0)
    tail: list[list[str]] = []
    for line in reversed(lines[least:]):
        if line.strip():
            tail.append([cell.strip() for cell in split_line(line, separator)])
        if len(tail) == _SAMPLE:
            break
    numbers: Counter[int] = Counter()
    for row in tail:
        numbers[len(row)] += sum(kind_of(cell) == "number" for cell in row)
    width, most = max(numbers.items(), key=lambda item: (item[1], item[0]), default=(0, 0))
    if not most or width > MOST_COLUMNS or (separator == " " and width == 1 and given.separator is None):
        return None
    rows = [row for row in tail if len(row) == width]
    kinds = _kinds(rows, width)
    start = least if given.skip_lines is not None and given.header_line is not None else None
    start = _start(lines, separator, kinds, least) if start is None else start
    if start is None or start >= len(lines):
        return None
    sample = _rows(lines, start, separator)
    cells = [kind_of(cell) for row in sample for cell in row]
    held = max(1, len(cells) - cells.count("missing"))
    header = _header(lines, separator, _TextGrid(separator, width, start, kinds, 0.0))
    return _TextGrid(separator, width, start, kinds, cells.count("number") / held, header, tuple(sample))


def _start(lines: Sequence[str], separator: str, kinds: Sequence[Kind], least: int) -> int | None:
    """Find the first line whose cells, and those of the lines after it, are of the kinds of the columns."""
    for i in range(least, len(lines)):
        if not lines[i].strip() or _fit(lines[i], separator, kinds) < 1.0:
            continue
        after = [line for line in lines[i + 1 : i + 12] if line.strip()][:5]
        if all(_fit(line, separator, kinds) > 0.0 for line in after):
            return i
    return None


def _fit(line: str, separator: str, kinds: Sequence[Kind]) -> float:
    """Share of the columns of numbers that hold one in this line, or nothing; 0 where the line is no row at all."""
    cells = split_line(line, separator)
    if not len(kinds) - 1 <= len(cells) <= len(kinds) + 2:
        return 0.0
    found = [kind_of(cells[i]) for i, kind in enumerate(kinds) if kind == "number" and i < len(cells)]
    if "number" not in found:
        return 0.0
    return sum(kind in ("number", "missing") for kind in found) / len(found)


def _header_cells(line: str, separator: str, width: int) -> list[str]:
    """Cells of a line above the rows; between spaces a name may hold one."""
    if separator != " ":
        return [cell.strip() for cell in split_line(line, separator)]
    ways = [line.split(), re.split(r"\s{2,}|\t", line.strip()), re.findall(r"\S+(?:\s+[\[(][^\])]*[\])])?", line)]
    return next((cells for cells in ways if len(cells) == width), ways[0])


def _compatible(cells: Sequence[str], kinds: Sequence[Kind]) -> bool:
    """Whether a line above the rows has a cell for each of their columns."""
    width, found = len(kinds), len(cells)
    if found == width - 1:
        return width > 1 and kinds[-1] == "missing"
    return width <= found <= width + 2 and all(not cell or _COMMENT.fullmatch(cell) for cell in cells[width:])


def _block(lines: Sequence[str], separator: str, grid: _TextGrid) -> list[int]:
    """Lines right above the rows that have a cell for each of their columns, nearest first."""
    block: list[int] = []
    for i in range(grid.start - 1, -1, -1):
        if not lines[i].strip():
            if block:
                break
            continue
        if not _compatible(_header_cells(lines[i], separator, grid.width), grid.kinds):
            break
        block.append(i)
        if len(block) == _HEADER_LINES:
            break
    return block


def _header(lines: Sequence[str], separator: str, grid: _TextGrid) -> int | None:
    """Find the line of names among those right above the rows; None where there is none."""
    texts = []
    for i in _block(lines, separator, grid):
        cells = [cell for cell in _header_cells(lines[i], separator, grid.width) if cell]
        if cells and sum(kind_of(cell) == "number" for cell in cells) < max(1, len(cells) / 2):
            texts.append(i)
    units = _units_line(lines, separator, grid, texts)
    names = [i for i in texts if i != units]
    if not names:
        return units
    scores = {i: _score(_header_cells(lines[i], separator, grid.width), grid.kinds) for i in names}
    best = max(scores.values())
    alike = [i for i in names if scores[i] == best]
    above = [i for i in alike if units is not None and i < units]
    return max(above) if above else alike[0]


def _units_line(lines: Sequence[str], separator: str, grid: _TextGrid, texts: Sequence[int]) -> int | None:
    """Find the row of units among the lines above the rows; it needs a line of names beside it."""
    if len(texts) < 2:
        return None
    for i in texts:
        cells = [_unbracketed(cell) for cell in _header_cells(lines[i], separator, grid.width)[: grid.width]]
        numeric = [cell for cell, kind in zip(cells, grid.kinds, strict=False) if kind == "number"]
        said = [cell for cell in numeric if cell not in _NO_UNIT]
        if said and all(readable(cell) for cell in said):
            return i
    return None


def _unbracketed(cell: str) -> str:
    match = re.fullmatch(r"\s*[\[(](.*)[\])]\s*", cell)
    return (match[1] if match else cell).strip()


def _score(cells: Sequence[str], kinds: Sequence[Kind]) -> float:
    """How much a line looks like names of these columns."""
    own = [cell for cell, kind in zip(cells, kinds, strict=False) if kind in ("number", "stamp")]
    said = [cell for cell in own if cell]
    score = len(said) + 2.0 * sum(_NAMED_UNIT.fullmatch(cell) is not None for cell in said)
    score += 3.0 * any(is_time_name(split_label(cell)[0]) for cell in said)
    return score - 2.0 * (len(said) - len(set(said)))


def _finished(lines: Sequence[str], grid: _TextGrid, given: Layout) -> TextLayout:
    """Put together what was found and what somebody says."""
    sign, width = grid.separator, grid.width
    header = grid.header if given.header_line is None else given.header_line - 1
    if header is None:
        header = _uneven_header(lines, grid)
    labels = [str(i + 1) for i in range(width)]
    if header is not None and 0 <= header < len(lines):
        labels = _header_cells(lines[header], sign, width)
    elif given.header_line not in (None, 0):
        labels = []
    rows = grid.rows
    labels = labels[: MOST_COLUMNS + 1]
    optional = max(0, len(labels) - width) if _compatible(labels, grid.kinds) else 0
    if len(labels) == width - 1 and width > 1 and grid.kinds[-1] == "missing":
        labels = [*labels, ""]
    units = _units(lines, grid, labels, range((-1 if header is None else header) + 1, grid.start))
    kinds = _kinds(rows, len(labels))
    known = header if header is not None and header >= 0 else grid.start
    decimal = given.decimal or _decimal(rows, kinds)
    said = None if header is None or given.skip_lines is None else header + given.skip_lines + 2
    first = grid.start + 1 if said is None else said
    names = [split_label(label)[0] for label in labels]
    return TextLayout(
        separator=sign,
        decimal=decimal,
        header_line=0 if header is None else header + 1,
        first=first,
        labels=tuple(labels),
        units=units,
        kinds=kinds,
        optional=optional,
        clock=find_clock(names, units, kinds, rows),
        stated=stated_rate(lines[:known], decimal),
    )


def _uneven_header(lines: Sequence[str], grid: _TextGrid) -> int | None:
    """A line right above the rows that seems to be their header though its cells are not as many."""
    above = next((i for i in range(grid.start - 1, -1, -1) if lines[i].strip()), None)
    if above is None:
        return None
    cells = split_line(lines[above], grid.separator)
    if not max(2, grid.width / 2) <= len(cells) <= MOST_COLUMNS or any(
        kind_of(cell) in ("number", "stamp") for cell in cells
    ):
        return None
    return above


def _units(lines: Sequence[str], grid: _TextGrid, labels: Sequence[str], between: range) -> tuple[str, ...]:
    """Unit of each column: from its header cell, else from a row of units between the header and the rows."""
    own = [split_label(label)[1] for label in labels]
    best: list[str] = []
    for i in between:
        cells = [_unbracketed(cell) for cell in _header_cells(lines[i], grid.separator, grid.width)]
        said = [cell for cell in cells if cell not in _NO_UNIT]
        if said and len(cells) >= grid.width - 1 and 2 * sum(map(readable, said)) >= len(said):
            best = cells
            break
    row = [cell if cell not in ("-", "--") else "" for cell in best] + [""] * len(labels)
    return tuple(unit or row[i] for i, unit in enumerate(own))


def _decimal(rows: Sequence[Sequence[str]], kinds: Sequence[Kind]) -> str | None:
    """The decimal sign of the numbers of the first rows; None where none of them has one."""
    signs: Counter[str] = Counter()
    for row in rows:
        for cell, kind in zip(row, kinds, strict=False):
            if kind == "number" and kind_of(cell) == "number":
                signs.update(sign for sign in ".," if sign in cell)
    return signs.most_common(1)[0][0] if signs else None


def separator_word(sign: str) -> str:
    """Return the name of a separator as a channel map does."""
    return next(word for word, found in SEPARATORS.items() if found == sign)
