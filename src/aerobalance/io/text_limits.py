"""What a text file may ask for: lengths of lines, numbers of columns, quotation marks that are closed.

No measurement comes near these limits, and beyond them the work would no longer go with the size of the file.
"""

from __future__ import annotations

import csv
from collections.abc import Sized
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from aerobalance.recording.errors import ReadError

LONGEST_LINE: Final = 2**20
"""Bytes that a line may have."""

MOST_COLUMNS: Final = 10_000
"""Columns that a table may have."""


def check_first_line(path: Path, stream: BinaryIO) -> None:
    """Refuse a file whose first line is endless, before the rest is read; the stream is at its beginning after.

    Raises
    ------
    ReadError
        It is.
    """
    head = stream.read(LONGEST_LINE + 1)
    stream.seek(0)
    check_lines(path, head)


def check_lines(path: Path, text: bytes) -> None:
    """Refuse a text with a line that is longer than any line of a table.

    Raises
    ------
    ReadError
        With the line.
    """
    place = 0
    while len(text) - place > LONGEST_LINE:
        end = max(text.rfind(sign, place, place + LONGEST_LINE + 1) for sign in (b"\n", b"\r"))
        if end < 0:
            line = text.count(b"\n", 0, place) + 1
            raise ReadError(
                path,
                f"line {line}",
                f"is longer than {LONGEST_LINE} bytes, which no line of a table is; allowed: a header line, and a "
                "line of numbers per sample",
            )
        place = end + 1


def check_columns(path: Path, labels: Sized) -> None:
    """Refuse a table with more columns than any recording has.

    Raises
    ------
    ReadError
        There are more.
    """
    if len(labels) > MOST_COLUMNS:
        raise ReadError(
            path,
            "header",
            f"has more than {MOST_COLUMNS} columns, which no recording has. Samples go down the file, a line each, "
            "and channels across",
        )


def check_quotes(path: Path, body: bytes, *, separator: str, first: int) -> None:
    """Refuse rows with a quotation mark that is opened and not closed in its line.

    Parameters
    ----------
    path
        The file.
    body
        Its rows.
    separator
        Character between columns.
    first
        Number of the first line of the rows.

    Raises
    ------
    ReadError
        With the line.
    """
    if b'"' not in body:
        return
    letters = np.frombuffer(body, dtype=np.uint8)
    quotes = np.flatnonzero(letters == ord('"'))
    ends = np.append(np.flatnonzero(letters == ord("\n")), letters.size)
    line = np.searchsorted(ends, quotes)
    opening = np.isin(letters[quotes - 1], np.frombuffer(f"{separator}\n ".encode(), dtype=np.uint8)) | (quotes == 0)
    lines, counts = np.unique(line, return_counts=True)
    for number in np.intersect1d(lines[counts % 2 == 1], line[opening]):
        text = body[ends[number - 1] + 1 if number else 0 : ends[number]].decode(errors="replace")
        if _is_open(text, separator):
            raise ReadError(
                path,
                f"line {first + int(number)}",
                f"opens a quotation mark and does not close it ({text.strip()[:40]!r}); all that follows would be one "
                "cell. Allowed: cells in two marks, or in none",
            )


def _is_open(line: str, separator: str) -> bool:
    try:
        next(csv.reader([line], delimiter=separator, strict=True), None)
    except csv.Error as error:
        return "unexpected end" in str(error)
    return False
