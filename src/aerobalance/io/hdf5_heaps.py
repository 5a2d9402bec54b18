"""Heaps of texts in HDF5 files, checked before the library reads attributes: it believes what they claim.

HDF5 file format specification, version 3, III.E "Global Heap": a collection has its size and a list of objects, each
with its index and its size; a text elsewhere is its length, the place of the collection, and the index.
"""

from __future__ import annotations

import mmap
import re
import struct
from pathlib import Path
from typing import Final

from aerobalance.io.hdf5_closing import SIGNATURE
from aerobalance.recording.errors import ReadError

_MARK: Final = b"GCOL\x01\0\0\0"
_TEXT: Final = re.compile(rb"[\x19\x29\x39]...\x10\0\0\0[\x10-\x13\x20-\x23\x30-\x33]", re.DOTALL)
"""Type of a text (or list) of any length, and the beginning of that of its letters."""

_HEAD: Final = 16
_LOOKED_THROUGH: Final = 1 << 23
"""Bytes at either end that are looked through of a file of more than twice as many."""


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
        for begin, end in [(0, size)] if whole else [(0, _LOOKED_THROUGH), (size - _LOOKED_THROUGH, size)]:
            at = view.find(_MARK, begin, end)
            while at >= 0:
                _check_texts(path, view, at, _objects(path, view, at), (begin, end))
                at = view.find(_MARK, at + 1, end)


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
