"""Lines and cells of text tables: separators, numbers, date-time stamps and cells that hold nothing."""

from __future__ import annotations

import csv
import re
from functools import cache
from typing import Final, Literal

from aerobalance.io.measure import LARGEST

MISSING: Final = (
    *("", "nan", "na", "n/a", "#n/a", "null", "none", "<na>", "-nan"),
    *(f"{sign}{word}" for sign in ("", "+", "-") for word in ("inf", "infinity")),
)
"""Cells, in small, capital or mixed letters, that say that a sample is missing."""

SEPARATORS: Final = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
"""Column separators that may be named in a channel map."""

Kind = Literal["number", "stamp", "text", "missing"]
"""What a cell holds."""

_NUMBER: Final = re.compile(r"[+-]?(?:\d+(?:[.,]\d+|\.)?|[.,]\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_CLOCK: Final = r"(?P<hour>\d{1,2}):(?P<minute>\d{2}):(?P<second>\d{2}(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_ZONE: Final = r"\s?(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?"

_ENGLISH: Final = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

MONTHS: Final = dict(zip(_ENGLISH, range(1, 13), strict=True)) | {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
"""Months by the first three letters of their names, in small letters; English and German."""

_MONTH: Final = f"(?i:{'|'.join(MONTHS)})[a-zä]*"

STAMPS: Final = {
    "iso": rf"(?P<year>\d{{4}})[-/.](?P<month>\d{{1,2}})[-/.](?P<day>\d{{1,2}})[T ]\s*{_CLOCK}{_ZONE}",
    "day first": rf"(?P<day>\d{{1,2}})\.(?P<month>\d{{1,2}})\.(?P<year>\d{{4}}|\d{{2}}),?\s+{_CLOCK}",
    "with slashes": rf"(?P<month>\d{{1,2}})[/-](?P<day>\d{{1,2}})[/-](?P<year>\d{{4}}|\d{{2}}),?\s+{_CLOCK}",
    "month by name": rf"(?P<day>\d{{1,2}})[-. /]\s?(?P<month>{_MONTH})[-. /]\s?(?P<year>\d{{4}}|\d{{2}}),?\s+{_CLOCK}",
    "compact": r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)[T_ ]"
    rf"(?P<hour>\d\d)(?P<minute>\d\d)(?P<second>\d\d(?:[.,]\d+)?)(?P<half>){_ZONE}",
    "day of year": rf"(?:(?P<year>\d{{4}})[-:/ ])?(?P<day>\d{{3}})[T:/ ]{_CLOCK}{_ZONE}",
    "time of day": _CLOCK,
}
"""Ways to write a date with a time of day, or the time alone; with slashes the day may come before the month.

The day of the year is what IRIG clocks write, with the year or without.
"""


def separator_of(line: str) -> str:
    """Recognise the separator from a header line: tab before semicolon before comma, brackets and quotes left out."""
    bare = re.sub(r"\[[^\]]*\]|\"[^\"]*\"|\([^)]*\)", "", line)
    return next((sign for sign in "\t;," if sign in bare), ",")


def split_line(line: str, separator: str) -> list[str]:
    """Split a line into cells; quoted cells may hold the separator, and a space stands for any number of them."""
    if separator == " ":
        return line.split()
    if '"' not in line:
        return line.split(separator) if line else []
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # a cell of more than a hundred thousand characters
        return line.split(separator)


def kind_of(cell: str) -> Kind:
    """Return what a cell holds, whichever its decimal sign."""
    bare = cell.strip()
    if _NUMBER.fullmatch(bare):
        return "number"
    if bare.lower() in MISSING:
        return "missing"
    return "stamp" if bare[:1].isdigit() and stamp_format(bare) else "text"


def stamp_format(cell: str) -> str | None:
    """Return the format of `STAMPS` in which a cell is written; None where it is no stamp."""
    bare = cell.strip()
    return next((name for name in STAMPS if len(bare) < 60 and stamp_pattern(name).fullmatch(bare)), None)


@cache
def stamp_pattern(name: str) -> re.Pattern[str]:
    """Compile a way of `STAMPS`."""
    return re.compile(STAMPS[name], re.ASCII)


def number_in(cell: str, *, decimal: str = ".") -> float | None:
    """Read the number in a cell; None where the cell holds none, or one that no reading is (beyond `LARGEST`)."""
    if not number_pattern(decimal).fullmatch(cell):
        return None
    value = float(cell.strip().replace(decimal, "."))
    return value if abs(value) <= LARGEST else None


@cache
def number_pattern(decimal: str) -> re.Pattern[str]:
    """Compile the pattern of a cell that holds a number with this decimal sign."""
    sign = re.escape(decimal)
    return re.compile(rf"\s*[+-]?(\d+{sign}?\d*|{sign}\d+)([eE][+-]?\d+)?\s*", re.ASCII)
