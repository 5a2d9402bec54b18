"""Writes recordings as MATLAB files of version 5, a variable for each channel, as their rows come."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from aerobalance.io.columns import Append, split_label
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.io.mat_elements import MATRIX, TABLES
from aerobalance.io.safe_write import replacing
from aerobalance.io.sensor_text import sensor_text
from aerobalance.recording.channel import Array

_KEYWORDS: Final = (
    "end",
    "for",
    "if",
    "while",
    "function",
    "return",
    "else",
    "case",
    "switch",
    "try",
    "catch",
    "global",
)
_LONGEST_NAME: Final = 50
_LARGEST: Final = 2**31 - 1024
_MOVED: Final = 1 << 22


@contextlib.contextmanager
def appending(
    path: Path,
    labels: Sequence[str],
    described: Mapping[str, StoredChannel] | None = None,
    *,
    epoch: np.datetime64 | None = None,
    rows: int = 0,
) -> Iterator[Append]:
    """Write columns to a MATLAB file of version 5, which takes its place when all rows are there.

    Every channel is a variable (a column) of its name, or of the name that MATLAB allows that is nearest to it; the
    structures ``units``, ``names`` and, where more is known, ``sensors`` have a text for each, and ``epoch`` is
    the date and time at which the time is zero.

    Raises
    ------
    ValueError
        A column has more bytes than the format allows, or the file cannot be written.
    """
    from scipy.io import savemat  # noqa: PLC0415 - a tenth of a second, and only these files need it

    small: dict[str, Any] = {}
    tables: dict[str, dict[str, str]] = {"units": {}, "names": {}, "sensors": {}}
    variables: dict[str, str] = {}
    for label in labels:
        name, unit = split_label(label)
        variable = _variable_name(name, tables["names"])
        variables[label] = variable
        tables["units"][variable], tables["names"][variable] = unit, name
        if described and label in described and (text := sensor_text(described[label])):
            tables["sensors"][variable] = text
    small |= {name: table for name, table in tables.items() if table}
    if epoch is not None:
        small["epoch"] = str(epoch)
    head: Any = io.BytesIO()
    savemat(head, small, long_field_names=True)
    with replacing(path) as beside:
        try:
            with beside.open("r+b") as file:
                file.write(head.getvalue())
                columns = _Columns(file, variables, rows)
                yield columns.append
                columns.finish()
        except OverflowError:
            raise ValueError(
                f"cannot write {path}: a variable of MATLAB 5 has at most 2 GB; write .h5 or .parquet"
            ) from None


class _Columns:
    """Variables of one column each, of which some rows are written at a time, each to its place.

    Parameters
    ----------
    file
        The file; the variables begin where it ends.
    variables
        Name of the variable by label of the column.
    rows
        Number of rows that are expected; where there are others, the variables are moved.
    """

    def __init__(self, file: BinaryIO, variables: Mapping[str, str], rows: int) -> None:
        self._file, self._variables, self._first = file, variables, file.tell()
        self._room, self._written = min(max(rows, 1), _LARGEST // 8), 0

    def append(self, columns: Mapping[str, Array]) -> None:
        """Write the next rows of all columns.

        Raises
        ------
        OverflowError
            A variable has more bytes than the format allows.
        """
        end = self._written + len(next(iter(columns.values())))
        if 8 * end > _LARGEST:
            raise OverflowError
        if end > self._room:
            self._move(min(max(end, 2 * self._room), _LARGEST // 8))
        for number, label in enumerate(self._variables):
            self._file.seek(self._place(number, self._room) + 8 * self._written)
            self._file.write(np.ascontiguousarray(columns[label], dtype="<f8").data)
        self._written = end

    def finish(self) -> None:
        """Close up the variables, and write what stands before each."""
        self._move(self._written)
        for number, name in enumerate(self._variables.values()):
            self._file.seek(self._place(number, self._room) - len(_before(name, 0)))
            self._file.write(_before(name, self._written))
        self._file.truncate(self._place(len(self._variables) - 1, self._room) + 8 * self._written)

    def _place(self, number: int, room: int) -> int:
        """Where the numbers of a variable begin if each has room for so many rows [bytes]."""
        names = list(self._variables.values())[: number + 1]
        return self._first + sum(len(_before(name, 0)) for name in names) + 8 * room * number

    def _move(self, room: int) -> None:
        """Give every variable room for so many rows."""
        grows = room > self._room
        order = range(len(self._variables))
        for number in reversed(order) if grows else order:
            old, new = self._place(number, self._room), self._place(number, room)
            parts = range(0, 8 * self._written if old != new else 0, _MOVED)
            for part in reversed(parts) if grows else parts:
                self._file.seek(old + part)
                moved = self._file.read(min(_MOVED, 8 * self._written - part))
                self._file.seek(new + part)
                self._file.write(moved)
        self._room = room


def _before(name: str, rows: int) -> bytes:
    """What stands before the numbers of a variable of one column: a multiple of 8 bytes."""
    text = name.encode("ascii")
    described = struct.pack("<4I", 6, 8, 6, 0) + struct.pack("<2I2i", 5, 8, rows, 1)
    described += struct.pack("<2I", 1, len(text)) + text + bytes(-len(text) % 8)
    numbers = struct.pack("<2I", 9, 8 * rows)
    return struct.pack("<2I", MATRIX, len(described) + len(numbers) + 8 * rows) + described + numbers


def _variable_name(name: str, taken: Mapping[str, Any]) -> str:
    """Name that MATLAB allows, nearest to that of a channel, and not taken."""
    plain = re.sub(r"\W", "_", name.encode("ascii", "replace").decode().replace("?", "_"))[:_LONGEST_NAME]
    plain = plain if plain[:1].isalpha() else f"x{plain}"
    if plain.lower() in TABLES or plain in _KEYWORDS:
        plain += "_"
    found, number = plain, 2
    while found in taken:
        found, number = f"{plain}_{number}", number + 1
    return found
