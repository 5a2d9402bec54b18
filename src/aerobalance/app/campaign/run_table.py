"""The table of runs: text with a column `file`, and as many more as there are."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from typing import Final

from aerobalance.app.campaign.definition import Cell
from aerobalance.app.campaign.places import fetched
from aerobalance.io.measure import LARGEST
from aerobalance.io.opening import opened_file
from aerobalance.io.text_table import guess_encoding
from aerobalance.recording.errors import ReadError

PRESSURES: Final = {
    "Pa": 1.0,
    "hPa": 1e2,
    "kPa": 1e3,
    "mbar": 1e2,
    "bar": 1e5,
    "psi": 6894.757293168,
    "psf": 47.88025898,
}
"""Units of pressure of a table or a recording, in Pa."""

DEGREES: Final = {"deg": 1.0, "°": 1.0, "rad": 57.29577951308232}
"""Units of angles of a table, in deg."""

KNOWN: Final = {"q": PRESSURES, "alpha": DEGREES, "beta": DEGREES}
"""Columns that are known to be a pressure or an angle, and have no other unit."""

_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_UNIT: Final = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*)\s*[\])]\s*$")


def read_rows(table: str) -> list[tuple[int, dict[str, Cell]]]:
    """Read a table of runs: text with a header, one column `file`, and as many more as there are; with line numbers.

    Pressures and angles may have a unit in their header, and come out in Pa and deg.

    Raises
    ------
    ReadError
        There is no column `file`, or a row has more cells than the header.
    """
    with fetched(table) as path, opened_file(path) as file:
        content = file.read()
    encoding = guess_encoding(content)
    if encoding is None:
        raise ReadError(table, "", "is no text; a table of runs is CSV with a column file")
    text = content.decode(encoding, errors="replace").lstrip("\ufeff")
    first = text.split("\n", 1)[0]
    separator = max(";\t,", key=first.count)
    rows = list(csv.reader(io.StringIO(text), delimiter=separator))
    if not rows or not any(rows[0]):
        raise ReadError(table, "line 1", "is empty; the first line names the columns, one of them file")
    heads = [_heading(table, name) for name in rows[0]]
    names = [name for name, _ in heads]
    if "file" not in names:
        raise ReadError(table, "line 1", f"has no column file; it has {', '.join(name for name in names if name)}")
    if len(set(names)) < len(names):
        raise ReadError(table, "line 1", "has two columns of one name")
    found = []
    for line, row in enumerate(rows[1:], 2):
        if not any(part.strip() for part in row):
            continue
        if len(row) > len(heads):
            raise ReadError(table, f"line {line}", f"has {len(row)} cells; the header has {len(heads)}")
        comma = separator == ";"
        cells = {
            name: _scaled(
                cell(part.replace(",", ".") if comma and re.fullmatch(r"\s*[-+]?\d+,\d+\s*", part) else part), factor
            )
            for (name, factor), part in zip(heads, row, strict=False)
            if name and part.strip()
        }
        if "file" not in cells:
            raise ReadError(table, f"line {line}", "names no file")
        cells["file"] = row[names.index("file")].strip()  # as it is written: 0012 is no number
        check_numbers(cells, table, f"line {line}", written=dict(zip(names, row, strict=False)))
        found.append((line, cells))
    return found


def _heading(table: str, text: str) -> tuple[str, float]:
    """Name of a column, and the factor of its unit."""
    match = _UNIT.match(text.strip())
    if match is None:
        return text.strip(), 1.0
    name, unit = match[1], match[2]
    factors = PRESSURES | DEGREES
    allowed = KNOWN.get(name)
    if unit not in (allowed or factors):
        if allowed is not None:
            raise ReadError(table, "line 1", f"{name} has unit [{unit}]; allowed: {', '.join(allowed)}")
        return text.strip(), 1.0  # with its unit in its name: nobody takes it for another unit
    return name, factors[unit]


def _scaled(given: Cell, factor: float) -> Cell:
    return given * factor if factor != 1.0 and isinstance(given, int | float) else given


def check_numbers(cells: Mapping[str, Cell], place: str, where: str, *, written: Mapping[str, str]) -> None:
    """Refuse cells with numbers that nothing can be: infinite, NaN, or beyond all sizes.

    Parameters
    ----------
    cells
        By column.
    place, where
        The file, and the place in it.
    written
        The same as they are written, as far as that is known.

    Raises
    ------
    ReadError
        There is one.
    """
    for name, given in cells.items():
        if isinstance(given, int | float) and not abs(given) <= LARGEST:
            said = written.get(name, str(given)).strip()
            what = f"which is no number up to {LARGEST:g} in size; correct it, or leave it out if it is not known"
            raise ReadError(place, where, f"column {name} has {said}, {what}")


def cell(text: str) -> Cell:
    """Return the number that a text is, or else the text."""
    stripped = text.strip()
    if re.fullmatch(r"[+-]?\d{1,15}", stripped):
        return int(stripped)
    # not whatever Python takes for a number: 12_3 is a name, and so is nan
    return float(stripped) if _NUMBER.fullmatch(stripped) else stripped
