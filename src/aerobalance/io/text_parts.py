"""A long text table read once, a block at a time, into a file of its numbers, of which parts are read.

The file has no name and goes with the process. Where anything is out of the common (dates, letters of another
encoding, bare carriage returns), the table is none that is read so.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from aerobalance.io.opening import opened_file
from aerobalance.io.text_layout import HEAD, Layout, TextLayout, recognise
from aerobalance.io.text_limits import check_columns, check_lines
from aerobalance.io.text_rows import LONG, Grid, read_cells
from aerobalance.recording.errors import ReadError

AT_ONCE: Final = 1 << 22
"""Bytes of a text that are read at once."""

_MARK: Final = b"\xef\xbb\xbf"
_NOTHING: Final = b' ;,\t"\n'


class TableOnDisk:
    """Numbers of a table on the disk; an array of the shape (n, columns) of which rows are read.

    Parameters
    ----------
    stream
        The file, of 64-bit numbers row by row.
    columns
        Their number in a row.
    """

    def __init__(self, stream: BinaryIO, columns: int) -> None:
        self._stream = stream
        self.shape = (stream.seek(0, 2) // (8 * columns), columns)

    def __getitem__(self, rows: slice) -> Any:
        begin, end, _ = rows.indices(self.shape[0])
        self._stream.seek(8 * begin * self.shape[1])
        found = np.frombuffer(self._stream.read(8 * (end - begin) * self.shape[1]))
        return found.reshape(-1, self.shape[1])


@dataclass(frozen=True, slots=True)
class LongText:
    """How a long text is laid out.

    Attributes
    ----------
    path
        The file.
    found
        Its layout.
    place
        Byte at which its rows begin.
    """

    path: Path
    found: TextLayout
    place: int

    @contextlib.contextmanager
    def table(self, chosen: Sequence[int]) -> Iterator[TableOnDisk | None]:
        """Read the numbers of the chosen columns into a file without a name; None where that cannot be done.

        Raises
        ------
        ReadError
            A row has too few or too many cells, or a cell is no number.
        """
        with contextlib.ExitStack() as stack:
            held = stack.enter_context(tempfile.TemporaryFile())
            yield TableOnDisk(held, len(chosen)) if self._fill(held, chosen) else None

    def _fill(self, held: Any, chosen: Sequence[int]) -> bool:
        line, rest = self.found.first, b""
        with opened_file(self.path) as stream:
            stream.seek(self.place)
            while True:
                given = stream.read(AT_ONCE)
                text = rest + given
                end = text.rfind(b"\n") + 1 if given else len(text)
                rest = text[end:]
                if not end and given:
                    return False
                block = _common(text[:end], ended=not given)
                if block is None:
                    return False
                if not block.strip(_NOTHING):
                    return not given  # the end of the text, or a hole in it
                grid = Grid(replace(self.found, first=line), tuple(chosen))
                numbers, _, _ = read_cells(self.path, block, grid, long=True)
                try:
                    held.write(np.column_stack([numbers[i] for i in chosen]).tobytes())
                except OSError:  # no place on the disk, which is no fault of the file that is read
                    return False
                line += block.count(b"\n")
                if not given:
                    return True


def _common(block: bytes, *, ended: bool) -> bytes | None:
    """A block with a line feed a line; None where it has what only all of a text tells how to read."""
    block = block.replace(b"\r\n", b"\n") if b"\r" in block else block
    if b"\r" in block or b"\x00" in block:
        return None
    # rows of nothing but separators are left out at the end of a text, and rows of missing readings elsewhere
    last = block[block.rfind(b"\n", 0, max(0, len(block) - 1)) + 1 :]
    if not ended and not last.strip(_NOTHING):
        return None
    try:
        check_lines(Path(), block)
        if not block.isascii():
            block.decode()
    except (ReadError, UnicodeDecodeError):
        return None
    return block


def long_text(path: Path, layout: Layout) -> LongText | None:
    """Look at the head of a text and return how it is laid out; None where it is short, or must be read whole.

    Raises
    ------
    ReadError
        The file cannot be read, or has too many columns.
    """
    with opened_file(path) as stream:
        if stream.seek(0, 2) <= LONG or layout.encoding not in (None, "utf-8", "ascii"):
            return None
        stream.seek(0)
        raw = stream.read(2 * HEAD)
    mark = len(_MARK) if raw.startswith(_MARK) else 0
    raw = raw[mark : raw.rfind(b"\n") + 1]
    head = _common(raw, ended=True)
    found = None if not head else recognise(head, layout)
    if found is None:
        return None
    check_columns(path, found.labels)
    decimal = found.decimal or ("." if found.separator == "," else None)
    place, line = 0, found.first
    while line > 1 and place < len(raw):
        place, line = raw.find(b"\n", place) + 1, line - 1
    if decimal is None or place >= len(raw):
        return None
    return LongText(path, replace(found, decimal=decimal), mark + place)
