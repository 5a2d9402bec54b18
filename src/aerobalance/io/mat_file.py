"""MATLAB files of version 5 to 7.2: variables by their name, fields of structures as ``run.AF``."""

from __future__ import annotations

import contextlib
import math
import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple

import numpy as np

from aerobalance.io.columns import Clock
from aerobalance.io.format_library import library_faults
from aerobalance.io.mat_elements import COMPLEX, MATRIX, PACKED, TABLES, check_variable, unpacked_variable
from aerobalance.io.said_by_file import clock_of, epoch_of, number_of, plain_keys, text_of
from aerobalance.io.sensor_text import sensor_of
from aerobalance.io.series import MOST_COLUMNS, MOST_SERIES, Holdings, Series, named, with_axes
from aerobalance.recording.channel import SensorSpec
from aerobalance.recording.errors import ReadError

if TYPE_CHECKING:
    from numpy.typing import NDArray

NAME: Final = "MATLAB (version 5)"
"""What to call the format in messages."""

_SIGNATURE: Final = b"MATLAB 5.0"
_HEADER: Final = 128
_HEAD: Final = 4096
_STRUCT, _CELL, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 2, 1, 3, 4, 5, 16, 17
_ITEM: Final = {6: 8, 7: 4, 8: 1, 9: 1, 10: 2, 11: 2, 12: 4, 13: 4, 14: 8, 15: 8}
_NUMBERS: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_UNPACKED: Final = 1100
_DEEPEST: Final = 4


@dataclass(frozen=True, slots=True)
class _Variable:
    """What stands before the content of a variable.

    Attributes
    ----------
    name
        Its name.
    kind
        Its class, a number of MATLAB's; `COMPLEX` for complex numbers.
    shape
        Its dimensions.
    size
        Bytes that it has in the file.
    begin
        Byte of the file at which its numbers begin, one column after the other.
    numbers
        Their type in the file; None where they have to be unpacked or made first.
    """

    name: str
    kind: int
    shape: tuple[int, ...]
    size: int
    begin: int = 0
    numbers: np.dtype[Any] | None = None


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is of MATLAB 5 to 7.2, from its first bytes."""
    del path
    return head.startswith(_SIGNATURE)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its variables as series; one that is packed is unpacked whole when it is wanted.

    Raises
    ------
    ReadError
        The file is damaged, or claims more than it can hold.
    """
    with library_faults(path, NAME, "its variables"):
        variables = _variables(path)
        walk = _VariableWalk(path)
        small = {one.name: _load(path, one.name) for one in variables if _is_small(one)}
        walk.level("", small, variables)
        plain = all(one.numbers is not None for one in variables if one.kind in _ITEM and not _is_small(one))
        holdings = Holdings(with_axes(walk.series), walk.epoch, parts=plain)
    yield holdings


def _is_small(one: _Variable) -> bool:
    """Whether a variable is read at once: a number, a text, or a structure, whose fields are not known otherwise."""
    return one.kind in (_STRUCT, _CHAR) or (one.kind in _ITEM and int(np.prod(one.shape)) <= 1)


def _variables(path: Path) -> list[_Variable]:
    """Read what stands before every variable, and refuse what the file cannot hold."""
    found: list[_Variable] = []
    size = path.stat().st_size
    with path.open("rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(_HEADER)[126:128])
        if order is None:
            raise ReadError(path, "byte 127", "must say the byte order, IM or MI: the MATLAB file is damaged")
        while (place := file.tell()) + 8 <= size:
            kind, count = struct.unpack(f"{order}II", file.read(8))
            where = f"byte {place}"
            if count > size - place - 8:
                raise ReadError(path, where, f"claims {count} bytes where {size - place - 8} are left: it is cut off")
            if kind not in (MATRIX, PACKED):
                raise ReadError(
                    path, where, f"is of type {kind}, where a variable (14 or 15) must begin: it is damaged"
                )
            head = _head(file, kind, count)
            variable = _described(path, where, head, order, count)
            held = int(np.prod(variable.shape, dtype=object)) * _ITEM.get(variable.kind, 1)
            if held > _UNPACKED * max(count, 1) or len(found) >= MOST_SERIES:
                raise ReadError(
                    path, f"{where}, {variable.name!r}", f"claims {held} bytes, stored in {count}: it is damaged"
                )
            at = _VariablePlace(kind, place + 8, count, order)
            numbers = _check(path, f"{where}, {variable.name!r}", file, at, variable)
            found.append(_with_numbers(variable, at, numbers))
            file.seek(place + 8 + count)
    return found


def _head(file: BinaryIO, kind: int, count: int) -> bytes:
    """First bytes of a variable, after its tag."""
    raw = file.read(min(count, _HEAD))
    if kind == PACKED:
        return zlib.decompressobj().decompress(raw, 2048)[8:]
    return raw


def _described(path: Path, where: str, head: bytes, order: str, count: int) -> _Variable:
    """Class, dimensions and name, as they stand before the content of a variable."""
    flags = struct.unpack_from(f"{order}I", head, 8)[0]
    kind, length = struct.unpack_from(f"{order}II", head, 16)
    if kind != 5 or not 0 < length <= 128 or length % 4:
        if flags & 0xFF in (_FUNCTION, _OPAQUE):
            return _Variable("", flags & 0xFF, (0,), count)
        raise ReadError(path, where, "has no dimensions where they belong: it is damaged")
    shape = struct.unpack_from(f"{order}{length // 4}i", head, 24)
    if min(shape) < 0:
        raise ReadError(path, where, f"has impossible dimensions, {' x '.join(map(str, shape))}: it is damaged")
    place = 24 + length + (-length % 8)
    tag = struct.unpack_from(f"{order}I", head, place)[0]
    if tag >> 16:  # a short name stands in the tag itself
        text = head[place + 4 : place + 4 + (tag >> 16)]
    else:
        text = head[place + 8 : place + 8 + struct.unpack_from(f"{order}I", head, place + 4)[0]]
    kind = COMPLEX if flags & COMPLEX else flags & 0xFF
    return _Variable(text[:200].decode("latin-1"), kind, shape, count)


class _VariablePlace(NamedTuple):
    """Where a variable is: its kind of element, the place and length of its content, and the byte order."""

    kind: int
    begin: int
    length: int
    order: str


def _with_numbers(variable: _Variable, at: _VariablePlace, numbers: tuple[int, int, int] | None) -> _Variable:
    """Return a variable with the place of its numbers, where they stand in the file one column after the other."""
    if numbers is None or variable.kind not in _ITEM:
        return variable
    kind, begin, length = numbers
    stored = np.dtype(f"{at.order}{_NUMBERS[kind]}")
    if len(variable.shape) != 2 or length != math.prod(variable.shape) * stored.itemsize:
        return variable
    return replace(variable, begin=at.begin + begin, numbers=stored)


def _check(
    path: Path, where: str, file: BinaryIO, at: _VariablePlace, variable: _Variable
) -> tuple[int, int, int] | None:
    """Refuse a variable whose elements, or whose size when unpacked, cannot be; where its numbers are, unpacked."""
    file.seek(at.begin)
    if at.kind != PACKED:
        with (
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as whole,
            memoryview(whole) as view,
            view[at.begin : at.begin + at.length] as content,
        ):
            return check_variable(path, where, content, at.order, whole=True)
    packed = file.read(min(at.length, _HEAD))
    begin = zlib.decompressobj().decompress(packed, 8)
    if len(begin) < 8:
        raise ReadError(path, where, "cannot be unpacked: it is damaged")
    (length,) = struct.unpack(f"{at.order}I", begin[4:])
    if length > _UNPACKED * at.length:
        raise ReadError(path, where, f"claims {length} bytes unpacked of {at.length}: it is damaged")
    if variable.kind in (*_ITEM, COMPLEX):  # its numbers follow its head in one piece
        check_variable(path, where, unpacked_variable(path, where, packed, _HEAD), at.order, whole=False)
        return None
    packed += file.read(at.length - len(packed))
    check_variable(path, where, unpacked_variable(path, where, packed, length + 8), at.order, whole=True)
    return None


def _load(path: Path, name: str) -> Any:
    """Read one variable."""
    from scipy.io import loadmat  # noqa: PLC0415 - a tenth of a second, and only these files need it

    with path.open("rb") as file:
        stream: Any = file
        return loadmat(
            stream,
            variable_names=[name],
            squeeze_me=False,
            struct_as_record=True,
        )[name]


@dataclass(slots=True)
class _VariableWalk:
    """What is found in the variables of a file."""

    path: Path
    series: list[Series] = field(default_factory=list)
    epoch: np.datetime64 | None = None

    def level(self, place: str, given: Mapping[str, Any], variables: list[_Variable]) -> None:
        """Take what stands in one structure, or in the file itself: values that are read, variables that are not."""
        said = {name: number for name, value in given.items() if (number := _number(value)) is not None}
        texts = {name: _text(value) for name, value in given.items()}
        plain = plain_keys(said | {name: text for name, text in texts.items() if text})
        units, names = self._table(given, "units", "unit"), self._table(given, "names")
        sensors = self._table(given, "sensors")
        clock = clock_of(plain)
        self.epoch = self.epoch if self.epoch is not None else epoch_of(plain)
        for one in variables:
            if not _is_small(one) and one.name:
                load = cache(lambda name=one.name: _load(self.path, name))
                text = names.get(one.name, one.name)
                unit, known = units.get(one.name, ""), sensor_of(sensors.get(one.name))
                stored = None if one.numbers is None else _Stored(self.path, one)
                self._array(
                    one.name, text, one.shape, load, unit=unit, clock=clock, kind=one.kind, sensor=known, stored=stored
                )
        for name, value in given.items():
            label = f"{place}.{name}" if place else name
            if isinstance(value, np.ndarray) and value.dtype.names and name.lower() not in TABLES:
                self._structures(label, value)
            elif place and isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
                unit = units.get(name, "")
                self._array(label, name, value.shape, lambda value=value: value, unit=unit, clock=clock, kind=6)

    def _structures(self, label: str, value: NDArray[np.void]) -> None:
        """Take the fields of a structure, or of each of several."""
        if label.count(".") >= _DEEPEST or value.size > MOST_COLUMNS:
            return
        for i, one in enumerate(value.ravel()):
            place = label if value.size == 1 else f"{label}({i + 1})"
            self.level(place, {name: one[name] for name in value.dtype.names or ()}, [])

    def _table(self, given: Mapping[str, Any], *keys: str) -> dict[str, str]:
        """Texts by name of a variable, where a structure of this name holds them."""
        table = next((value for name, value in given.items() if name.lower() in keys), None)
        if not isinstance(table, np.ndarray) or not table.dtype.names or table.size != 1:
            return {}
        return {name: _text(table.ravel()[0][name]) for name in table.dtype.names}

    def _array(
        self,
        label: str,
        text: str,
        shape: tuple[int, ...],
        load: Any,
        *,
        unit: str,
        clock: Clock | None,
        kind: int,
        sensor: SensorSpec | None = None,
        stored: _Stored | None = None,
    ) -> None:
        """Take an array: one series of a row or a column, or one for each column of a matrix."""
        if kind not in _ITEM:
            what = {_CELL: "a cell array", _SPARSE: "a sparse matrix", COMPLEX: "an array of complex numbers"}.get(
                kind, "no array of numbers"
            )
            self.series.append(Series(label, text, "", 0, lambda *_: np.empty(0), fault=f"it is {what}"))
            return
        if len(shape) != 2 or max(shape) < 2 or min(shape) > MOST_COLUMNS or min(shape) < 1:
            return
        name, unit = named(text, unit)
        columns, samples = min(shape), max(shape)
        if len(self.series) + columns > MOST_SERIES:
            raise ReadError(self.path, "variables", f"hold more than {MOST_SERIES} columns, which no recording has")
        for k in range(columns):
            mark = "" if columns == 1 else f"(:,{k + 1})" if shape[0] >= shape[1] else f"({k + 1},:)"
            upright = shape[0] >= shape[1]
            read = _reader(load, k, upright=upright) if stored is None else stored.reader(k)
            self.series.append(
                Series(
                    f"{label}{mark}",
                    f"{name}{mark}",
                    unit,
                    samples,
                    read,
                    alias=f"{text}{mark}",
                    clock=clock,
                    sensor=sensor or SensorSpec(),
                )
            )


class _Stored:
    """Numbers of a variable that are read from the file as they stand there.

    Parameters
    ----------
    path
        The file.
    variable
        Which one; of a matrix the longer side is the time.
    """

    def __init__(self, path: Path, variable: _Variable) -> None:
        self._path, self._variable = path, variable
        self._bounds, self._last = (0, 0), np.empty((0, 0))

    def reader(self, column: int) -> Any:
        """Return what reads a part of one column (or row, where rows are longer)."""
        rows, columns = self._variable.shape
        if rows >= columns:
            return lambda begin, end: self._read(column * rows + begin, end - begin)
        return lambda begin, end: self._table(begin, end)[:, column]

    def _table(self, begin: int, end: int) -> Any:
        """Samples of all rows; what was read last is kept, as all of them ask for it."""
        if self._bounds != (begin, end):
            rows = self._variable.shape[0]
            self._last = self._read(begin * rows, (end - begin) * rows).reshape(-1, rows)
            self._bounds = begin, end
        return self._last

    def _read(self, first: int, count: int) -> Any:
        """Read so many numbers from one on."""
        kind = self._variable.numbers
        assert kind is not None
        with self._path.open("rb") as file:
            file.seek(self._variable.begin + first * kind.itemsize)
            return np.fromfile(file, kind, count)


def _reader(load: Any, column: int, *, upright: bool) -> Any:
    def read(begin: int, end: int) -> Any:
        values = load()
        if values.dtype.kind == "c":
            raise ValueError("it holds complex numbers; readings over time are needed")
        return values[begin:end, column] if upright else values[column, begin:end]

    return read


def _number(value: Any) -> float | None:
    return number_of(value) if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" else None


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return text_of(str(value.ravel()[0]), longest=4096) if value.size == 1 else ""
    return ""
