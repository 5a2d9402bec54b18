"""The parsed text of a ``.vol`` file: its ``key--> value`` lines and its blocks of loads and voltages."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.io.text_cells import number_in, separator_of, split_line
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality

_SECTION: Final = re.compile(r"\[\s*(?P<title>[^\[\]]*?)\s*\]")
_SIGNED: Final = re.compile(
    r"(?P<name>.*?)[\s_\-]*(?:(?P<pos>pos|positive|plus|\+)|(?P<neg>neg|negative|minus|-))\.?", re.I
)
_COUNT: Final = re.compile(r"number\s*of\s*loads\b", re.I)
_PADDED: Final = re.compile(r"([,;]) *\t")
"""A separator and the tab after it that only aligns columns."""
_COMMA_DECIMAL: Final = re.compile(r"(?<![\d.,])[+-]?\d*,\d")


@dataclass(frozen=True, slots=True)
class Entry:
    """One line ``key--> value``.

    Attributes
    ----------
    line
        Its number, counted from 1.
    key, value
        The texts before and after the arrow.
    """

    line: int
    key: str
    value: str


@dataclass(frozen=True, slots=True, eq=False)
class VolBlock:
    """One block: loads on one component in one direction, and the bridge outputs.

    Attributes
    ----------
    title
        Text between the brackets, for example ``N1 neg``.
    component
        The title without its sign.
    sign
        1 for pos, -1 for neg, 0 where the title says neither.
    labels
        Header cells of the m columns.
    header_line
        Line number of the header.
    values
        Cells, shape (n, m).
    lines
        Line number of each of the n rows.
    """

    title: str
    component: str
    sign: int
    labels: tuple[str, ...]
    header_line: int
    values: Array
    lines: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class VolText:
    """A parsed ``.vol`` file.

    Attributes
    ----------
    description, capacities, distances
        Lines ``key--> value`` of the sections of these kinds.
    blocks
        The blocks that hold loads.
    """

    description: tuple[Entry, ...]
    capacities: tuple[Entry, ...]
    distances: tuple[Entry, ...]
    blocks: tuple[VolBlock, ...]


@dataclass(slots=True)
class _Section:
    """Lines of one section without the blank ones: entries ``key--> value``, and rows with their line numbers."""

    title: str
    line: int
    entries: list[Entry] = field(default_factory=list)
    rows: list[tuple[int, str]] = field(default_factory=list)


def parse_vol(path: Path, text: str) -> VolText:
    """Parse the text of a ``.vol`` file.

    Raises
    ------
    ReadError
        A row has a cell that is not a number or not one for each column, a block has no header and there is none
        before it, or there is no block of loads.

    Warns
    -----
    DataQualityWarning
        The file is cut off, a block has no header, no rows, or another number of rows than it states.
    """
    sections = _sections(text)
    kinds: dict[str, list[Entry]] = {"description": [], "capacities": [], "distances": []}
    blocks: list[VolBlock] = []
    for section in sections:
        kind = _kind(section)
        if kind != "block":
            kinds.setdefault(kind, []).extend(section.entries)
            continue
        ends = _SectionEnd(whole=text.endswith("\n"), last=section is sections[-1])
        block = _block(path, section, ends, blocks[-1].labels if blocks else ())
        if block is not None:
            blocks.append(block)
    if not blocks:
        raise ReadError(
            path,
            "",
            "has no block of loads; needed: [N1 pos], Number of Loads--> n, a header such as "
            "Load[lb], N1[Volt], ..., Exct.[Volt], and rows of numbers, for every component and sign",
        )
    return VolText(
        description=tuple(kinds["description"]),
        capacities=tuple(kinds["capacities"]),
        distances=tuple(kinds["distances"]),
        blocks=tuple(blocks),
    )


def _sections(text: str) -> list[_Section]:
    """Sections of a file; the first has the lines before any heading, and no title."""
    sections = [_Section("", 1)]
    for number, raw in enumerate(text.split("\n"), start=1):
        line = _PADDED.sub(r"\1", raw)
        bare = line.strip().strip(",;\t\" '")
        if not bare:
            continue
        if heading := _SECTION.fullmatch(bare):
            sections.append(_Section(heading["title"], number))
        elif "->" in bare:
            key, _, value = bare.partition("->")
            sections[-1].entries.append(Entry(number, key.strip(" \t-"), value.strip(" ,;\t\"'")))
        else:
            sections[-1].rows.append((number, line))
    return sections


def _kind(section: _Section) -> str:
    """Kind of a section: block, distances, capacities or description."""
    title = section.title.casefold()
    if _SIGNED.fullmatch(title) or any(_COUNT.match(entry.key) for entry in section.entries):
        return "block"
    for word, kind in (("distance", "distances"), ("load", "capacities"), ("capacit", "capacities")):
        if word in title:
            return kind
    return "description"


@dataclass(frozen=True, slots=True)
class _SectionEnd:
    """Whether the file ends with a complete line, and whether a section is its last one."""

    whole: bool
    last: bool


def _block(path: Path, section: _Section, ends: _SectionEnd, inherited: tuple[str, ...]) -> VolBlock | None:
    """Block that a section holds; None, with a warning, where it has no rows."""
    signed = _SIGNED.fullmatch(section.title)
    rows = list(section.rows)
    labels, header_line = inherited, section.line
    separator = separator_of(rows[0][1]) if rows else ","
    if rows and number_in(split_line(rows[0][1], separator)[0], decimal=".") is None:
        header_line, header = rows.pop(0)
        labels = tuple(_trimmed(split_line(header, separator)))
    elif rows and labels:
        # The load may have another unit than in the block before: without one in its label, that of the maximal load
        # is taken.
        labels = tuple("Load" if label.casefold().startswith("load") else label for label in labels)
        warn_quality(
            f"{path}: block [{section.title}] (line {section.line}) has no header: its columns are taken as those of "
            "the block before, and its load in the unit of the maximal load"
        )
    elif rows:
        raise ReadError(
            path,
            f"line {rows[0][0]}",
            f"block [{section.title}] has no header; needed before the rows: Load[lb], N1[Volt], ..., Exct.[Volt]",
        )
    values, cut = _rows(path, section, rows, _Columns(labels, separator, ends))
    _check_count(path, section, found=len(values), cut=cut)
    if not values:
        return None
    return VolBlock(
        section.title,
        (signed["name"] if signed else section.title).strip(),
        0 if signed is None else (1 if signed["pos"] else -1),
        labels,
        header_line,
        np.array(values, dtype=np.float64),
        tuple(number for number, _ in rows[: len(values)]),
    )


def _trimmed(cells: list[str]) -> list[str]:
    """Cells without the empty ones that trailing separators make."""
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return cells


@dataclass(frozen=True, slots=True)
class _Columns:
    """Labels and separator of the columns of a block, and how the file ends."""

    labels: tuple[str, ...]
    separator: str
    ends: _SectionEnd


def _rows(path: Path, section: _Section, rows: list[tuple[int, str]], columns: _Columns) -> tuple[list[Array], bool]:
    """Numbers in the rows of a block, and whether the file ends in the middle of the last row."""
    values: list[Array] = []
    written: list[int] = []
    cells: list[str] = []
    decimal = _decimal([row for _, row in rows], columns.separator)
    for index, (number, row) in enumerate(rows):
        separator = columns.separator if columns.separator in row else separator_of(row)
        cells = _trimmed(split_line(row, separator))
        found = [number_in(cell, decimal=decimal) for cell in cells]
        # the last row is cut off if cells are missing, or its last one is no number or shorter than in all rows before
        final = columns.ends.last and index == len(rows) - 1
        short = len(cells) < len(columns.labels)
        if final and ((short and None not in found[:-1]) or (not columns.ends.whole and None not in found[:-1])):
            torn = short or None in found or (written and len(cells[-1]) < min(written))
            if torn and len(cells) <= len(columns.labels):
                return values, True
        if len(cells) != len(columns.labels):
            raise ReadError(
                path,
                f"line {number}",
                f"has {len(cells)} cell(s) ({row.strip()[:40]!r}) in block [{section.title}], whose header has "
                f"{len(columns.labels)}; every row needs one number per column",
            )
        if None in found:
            column = found.index(None)
            raise ReadError(
                path,
                f"line {number}, column {column + 1} ({columns.labels[column]!r})",
                f"{cells[column][:40]!r} is no number; allowed in block [{section.title}]: numbers such as "
                f"-12{decimal}5 or 1{decimal}2E-3",
            )
        values.append(np.array(found, dtype=np.float64))
        written.append(len(cells[-1]))
    return values, False


def _decimal(rows: list[str], separator: str) -> str:
    """Decimal sign of a block: a comma only where numbers have commas and none has a point."""
    if separator == ",":
        return "."
    joined = "\n".join(rows)
    return "," if _COMMA_DECIMAL.search(joined) and not re.search(r"\d\.|\.\d", joined) else "."


def _check_count(path: Path, section: _Section, *, found: int, cut: bool) -> None:
    """Warn of a block whose number of rows is not the one that it states."""
    entry = next((entry for entry in section.entries if _COUNT.match(entry.key)), None)
    place = f"{path}: block [{section.title}] (line {section.line})"
    if cut:
        warn_quality(
            f"{place}: the file ends in the middle of a row: it is cut off, and only the {found} complete row(s) of "
            "the block are used"
        )
    elif found == 0:
        warn_quality(f"{place} has no rows of numbers and is left out")
    elif entry is not None and number_in(entry.value) != found:
        warn_quality(
            f"{place} says {entry.value[:20]!r} loads and has {found} row(s); the rows that are there are used, and "
            "the result rests on fewer or other points than were meant"
        )
