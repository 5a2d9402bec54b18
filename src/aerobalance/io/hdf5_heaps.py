"""Heaps of texts and names in HDF5 files, checked before the library reads them: it believes what they claim.

HDF5 file format specification, version 3, III.E "Global Heap": a collection has its size and a list of objects, each
with its index and its size; a text elsewhere is its length, the place of the collection, and the index. III.D "Local
Heap", of the names in a group: places without a name are a list of which each tells the next.
"""

from __future__ import annotations

import math
import mmap
import re
import struct
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.io.hdf5_closing import SIGNATURE
from aerobalance.recording.errors import ReadError

_MARK: Final = b"GCOL\x01\0\0\0"
_NAMES: Final = b"HEAP\0\0\0\0"
_LAST: Final = 1
"""What the last place without a name says of the next."""

_TEXT: Final = re.compile(rb"[\x19\x29\x39]...\x10\0\0\0[\x10-\x13\x20-\x23\x30-\x33]", re.DOTALL)
"""Type of a text (or list) of any length, and the beginning of that of its letters."""

_LETTERS: Final = re.compile(rb"\x10\0\0\0[\x10-\x13\x20-\x23\x30-\x33]")
"""Size of a reference to a text, as its type has it, and the beginning of the type of its letters."""

_LISTS: Final = b"\x19\x29\x39"
"""Beginnings of types of lists of any length, texts among them."""

_REFERENCE: Final = 16
_ATTRIBUTE_HEAD: Final = 8
_LONGEST_NAME: Final = 264
"""Bytes from the header of an attribute to its type, at most, that are looked at: a name of 255 letters."""

_MOST_TEXTS: Final = 1024
_HEAD: Final = 16
_LOOKED_THROUGH: Final = 1 << 23
"""Bytes at either end that are looked through of a file of more than twice as many."""

_PIECE: Final = 1 << 13
"""Bytes that are searched or not."""

_LONGEST_PATTERN: Final = 16
"""Bytes of the longest of what is searched for, at least."""


def check_heaps(path: Path) -> None:
    """Refuse heaps, and texts in them, that claim more than there is: the library takes the memory, or never ends.

    Raises
    ------
    ReadError
        With the place.
    """
    size = path.stat().st_size
    if size < _HEAD:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
        whole = size <= 2 * _LOOKED_THROUGH
        for span in [(0, size)] if whole else [(0, _LOOKED_THROUGH), (size - _LOOKED_THROUGH, size)]:
            pieces = _pieces_with_zeros(view, *span)
            for begin, end in pieces:
                _check_lengths(path, view, (begin, end))
            for begin, end in pieces:
                at = view.find(_MARK, begin, end)
                while at >= 0:
                    _check_texts(path, view, at, _objects(path, view, at), span)
                    at = view.find(_MARK, at + 1, end)
            for begin, end in pieces:
                at = view.find(_NAMES, begin, end)
                while at >= 0:
                    _check_free_places(path, view, at)
                    at = view.find(_NAMES, at + 1, end)


def _pieces_with_zeros(view: mmap.mmap, begin: int, end: int) -> list[tuple[int, int]]:
    """Pieces of a span in which there are three zeros in a row, and what touches them.

    All that is looked for has three zeros in a row, so two in one word, and readings seldom have: a look at the words
    takes a tenth of the time of the searches.
    """
    whole = (end - begin) // _PIECE
    words = np.frombuffer(view, dtype=np.uint16, count=whole * _PIECE // 2, offset=begin).reshape(whole, _PIECE // 2)
    numbers = [*np.flatnonzero(words.min(axis=1, initial=1) == 0).tolist(), whole]  # and what is left behind them
    found: list[tuple[int, int]] = []
    for number in numbers:
        first = max(begin, begin + number * _PIECE - _LONGEST_PATTERN)
        last = min(end, begin + (number + 1) * _PIECE + _LONGEST_PATTERN)
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], last
        elif first < last:
            found.append((first, last))
    return found


def _check_free_places(path: Path, view: mmap.mmap, at: int) -> None:
    """Refuse a heap of names whose list of free places runs in a circle: the library follows it without an end."""
    if at + 32 > len(view):
        return
    size, free, address = struct.unpack_from("<QQQ", view, at + 8)
    begin = address + max(0, view.find(SIGNATURE, 0, 4096))
    seen: set[int] = set()
    while free != _LAST and free + _HEAD <= size and begin + free + _HEAD <= len(view):
        if free in seen:
            raise ReadError(
                path, f"byte {begin + free}", "the free places of a group's names are in a circle: the file is damaged"
            )
        seen.add(free)
        (free,) = struct.unpack_from("<Q", view, begin + free)


def _check_lengths(path: Path, view: mmap.mmap, span: tuple[int, int]) -> None:
    """Refuse attributes whose texts are longer than the file: the library takes the memory before it looks for them.

    In an attribute the type is followed by the shape (version 1 or 2), and that by the texts.
    """
    for match in _LETTERS.finditer(view, *span):
        outer, letters = match.start() - 4, match.end() - 1
        if outer < 0 or view[outer] not in _LISTS:
            continue
        # letters are characters (8 bytes tell it) or whole numbers of a byte (12, or 16 where that is a multiple of 8)
        known = _texts_behind_header(view, outer)
        guessed = (_texts_of_attribute(view, place) for place in (letters + 8, letters + 12, letters + 16))
        for places in guessed if known is None else [known]:
            for at in places:
                (length,) = struct.unpack_from("<I", view, at)
                if length > len(view):
                    raise ReadError(
                        path, f"byte {at}", f"claims {length} letters in a file of {len(view)} bytes: it is damaged"
                    )


def _texts_behind_header(view: mmap.mmap, kind: int) -> range | None:
    """Places of the first texts of the attribute whose type is at a place; None where no attribute is.

    Its header says how long its name, its type and its shape are (versions 1 and 2; version 3 has one byte more): the
    library goes by that, whatever else is in the shape.
    """
    for back in range(_ATTRIBUTE_HEAD, min(kind, _LONGEST_NAME) + 1):
        head = kind - back
        version = view[head]
        if version not in (1, 2, 3):
            continue
        name, length, shape = struct.unpack_from("<HHH", view, head + 2)
        padded = 8 if version == 1 else 1
        extra = _ATTRIBUTE_HEAD + (version == 3)
        if not name or extra + name + -name % padded != back or not 16 <= length <= 24 or not 4 <= shape <= 1024:
            continue
        place = kind + length + -length % padded
        begin = place + shape + -shape % padded
        if begin + 4 > len(view):
            return range(0)
        at = place + (8 if view[place] == 1 else 4)
        rank = view[place + 1]
        count = math.prod(struct.unpack_from(f"<{rank}Q", view, at)) if at + 8 * rank <= begin else _MOST_TEXTS
        return range(begin, min(begin + _REFERENCE * min(count, _MOST_TEXTS), len(view) - 4), _REFERENCE)
    return None


def _texts_of_attribute(view: mmap.mmap, place: int) -> range:
    """Places of the first texts of an attribute, behind its shape; none where there is no shape at this place."""
    if place + 8 > len(view):
        return range(0)
    version, rank, flags = view[place : place + 3]
    head = {1: 8, 2: 4}.get(version, 0)
    kind = view[place + 3] if version == 2 else rank  # in version 2 said once more: 0 one number, 1 a list
    reserved = view[place + 3 : place + 8].strip(b"\0") if version == 1 else b""
    if not head or rank > 1 or flags > 1 or kind != rank or reserved:
        return range(0)
    begin = place + head + 8 * rank * (1 + flags)
    count = struct.unpack_from("<Q", view, place + head)[0] if rank and place + head + 8 <= len(view) else 1
    end = min(begin + _REFERENCE * min(count, _MOST_TEXTS), len(view) - 4)
    return range(begin, end, _REFERENCE)


def _objects(path: Path, view: mmap.mmap, at: int) -> dict[int, int]:
    """Sizes of the objects of a collection, by their indices."""
    (claimed,) = struct.unpack_from("<Q", view, at + 8) if at + _HEAD <= len(view) else (0,)
    if not _HEAD <= claimed <= len(view) - at:
        raise ReadError(
            path, f"byte {at}", f"claims a heap of {claimed} bytes in a file of {len(view)}: the file is damaged"
        )
    found: dict[int, int] = {}
    place, end = at + _HEAD, at + claimed
    while place + _HEAD <= end:
        index, _, _, size = struct.unpack_from("<HHIQ", view, place)
        needed = _HEAD + size + -size % 8 if index else size
        if needed < _HEAD or needed > end - place:
            raise ReadError(
                path,
                f"byte {place}",
                f"claims {size} bytes in a heap that has {end - place} left: the file is damaged",
            )
        if index:
            found[index] = size
        place += needed
    return found


def _check_texts(path: Path, view: mmap.mmap, at: int, objects: dict[int, int], span: tuple[int, int]) -> None:
    """Refuse lengths beside references to a collection that are larger than what they refer to."""
    base = max(0, view.find(SIGNATURE, 0, 4096))
    reference = struct.pack("<Q", at - base)
    place = view.find(reference, span[0] + 4, span[1])
    while place >= 0 and place + 12 <= len(view):
        (length,) = struct.unpack_from("<I", view, place - 4)
        (index,) = struct.unpack_from("<I", view, place + 8)
        # readings may have the same bytes, but not behind the type of a text of any length
        is_text = _TEXT.search(view[max(0, place - 68) : place - 4]) is not None
        if is_text and index in objects and length > objects[index]:
            raise ReadError(
                path,
                f"byte {place - 4}",
                f"claims {length} letters, of which its heap has {objects[index]}: the file is damaged",
            )
        place = view.find(reference, place + 1, span[1])
