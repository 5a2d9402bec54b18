"""The elements of a MATLAB file of version 5, checked before the library reads them: damaged ones crash it.

MAT-File Format, The MathWorks: every element has a type and a length; a variable is an element of elements.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Final

from aerobalance.recording.errors import ReadError

MATRIX: Final = 14
PACKED: Final = 15
COMPLEX: Final = 0x800
"""Mark of a variable of complex numbers."""

TABLES: Final = ("unit", "units", "names", "sensors", "epoch")
"""Variables that say of the others what they are, and are no channels themselves."""

_TYPES: Final = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18)
_NUMBERS: Final = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13)
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
_LAST_PLAIN: Final = 15
_MOST_DIMENSIONS: Final = 32
_DEEPEST: Final = 32


def unpacked_variable(path: Path, where: str, packed: bytes, most: int) -> bytes:
    """Unpack a variable, up to so many bytes, and return it without its tag.

    Raises
    ------
    ReadError
        It cannot be unpacked.
    """
    try:
        return zlib.decompressobj().decompress(packed, most)[8:]
    except zlib.error as error:
        raise ReadError(path, where, f"cannot be unpacked ({error}): it is damaged") from None


def check_variable(
    path: Path, where: str, given: bytes | memoryview, order: str, *, whole: bool
) -> tuple[int, int, int] | None:
    """Return where the numbers of a variable are; refuse one of impossible types, lengths or dimensions.

    Parameters
    ----------
    path, where
        The file, and the place of the variable in it.
    given
        Its content after its tag, as bytes.
    order
        Byte order, ``<`` or ``>``.
    whole
        Whether the content is whole; what lies beyond its end is not looked at otherwise.

    Returns
    -------
    tuple or None
        Type of the element of its (real) numbers, the byte at which they begin, and how many bytes they have; None for
        a variable that is none of numbers.

    Raises
    ------
    ReadError
        With the place within the variable.
    """
    with memoryview(given) as view:
        end = len(given) if whole else 1 << 62
        return _VariableCheck(path, where, view, order, whole).matrix(0, end, 0)


class _VariableCheck:
    """The check of one variable."""

    def __init__(self, path: Path, where: str, view: memoryview, order: str, whole: bool) -> None:
        self._path, self._where, self._view, self._order, self._whole = path, where, view, order, whole

    def _fail(self, place: int, what: str) -> ReadError:
        return ReadError(self._path, f"{self._where}, {place} bytes on", f"{what}: the file is damaged")

    def _element(self, place: int, end: int) -> tuple[int, int, int, int]:
        """Type of the element at a place, where its content begins, its length, and where the next one is."""
        if place + 8 > min(end, len(self._view)):
            raise self._fail(place, "ends in the middle of an element")
        (tag,) = struct.unpack_from(f"{self._order}I", self._view, place)
        if tag >> 16:
            kind, length, begin, after = tag & 0xFFFF, tag >> 16, place + 4, place + 8
            if length > 4:
                raise self._fail(place, f"has a short element of {length} bytes")
        else:
            (length,) = struct.unpack_from(f"{self._order}I", self._view, place + 4)
            kind, begin = tag, place + 8
            after = begin + length + (-length % 8 if kind != PACKED else 0)
        if kind not in _TYPES:
            raise self._fail(place, f"has an element of type {kind}")
        if begin + length > end:
            raise self._fail(place, f"has an element of {length} bytes where {end - begin} are left")
        return kind, begin, length, after

    def matrix(self, place: int, end: int, depth: int) -> tuple[int, int, int] | None:
        """Check the elements of a variable, or of one in it, from one place to another; where its numbers are."""
        if end == place:  # an empty field
            return None
        if depth > _DEEPEST:
            raise self._fail(place, f"is nested more than {_DEEPEST} times")
        kind, begin, length, place = self._element(place, end)
        if kind != 6 or length != 8:
            raise self._fail(begin, "does not begin with the class of a variable")
        (flags,) = struct.unpack_from(f"{self._order}I", self._view, begin)
        content = flags & 0xFF
        if not 1 <= content <= _LAST_PLAIN:
            return None  # functions and objects, which are not read
        kind, begin, length, place = self._element(place, end)
        if kind != 5 or length % 4 or not 8 <= length <= 4 * _MOST_DIMENSIONS:
            raise self._fail(begin, "has no dimensions where they belong")
        shape = struct.unpack_from(f"{self._order}{length // 4}i", self._view, begin)
        if min(shape) < 0:
            raise self._fail(begin, f"has the dimensions {' x '.join(map(str, shape))}")
        _, _, _, place = self._element(place, end)  # the name
        members = math.prod(shape)
        if content in (_STRUCT, _OBJECT):
            place, fields = self._fields(place, end, content)
            members *= fields
        nested = content in (_CELL, _STRUCT, _OBJECT)
        pieces: list[tuple[int, int, int]] = []
        while place + 8 <= end and (self._whole or place + 8 <= len(self._view)):
            kind, begin, length, place = self._element(place, end if self._whole else 1 << 62)
            if nested != (kind == MATRIX) or (not nested and content != _CHAR and kind not in _NUMBERS):
                raise self._fail(begin, f"has an element of type {kind} in a variable of class {content}")
            if nested:
                self.matrix(begin, begin + length, depth + 1)
            pieces.append((kind, begin, length))
        count = len(pieces)
        if nested and count != members:
            raise self._fail(place, f"has {count} of {members} members")
        needed = (3 if content == _SPARSE else 1) + bool(flags & COMPLEX)
        if not nested and self._whole and count < needed:
            raise self._fail(place, f"has {count} of {needed} pieces of content")
        return pieces[0] if pieces and not nested and content not in (_CHAR, _SPARSE) else None

    def _fields(self, place: int, end: int, content: int) -> tuple[int, int]:
        """Check the names of fields, and return where they end and how many there are."""
        if content == _OBJECT:
            _, _, _, place = self._element(place, end)
        kind, begin, length, place = self._element(place, end)
        (width,) = struct.unpack_from(f"{self._order}i", self._view, begin) if length == 4 else (0,)
        if kind != 5 or not 0 < width <= 1024:
            raise self._fail(begin, f"has names of fields of {width} bytes")
        kind, begin, length, place = self._element(place, end)
        if kind not in (1, 2) or length % width:
            raise self._fail(begin, f"has {length} bytes of names of fields of {width}")
        return place, length // width
