"""A recording that is being written, as a whole file of its own: for whoever fetches it over the network.

The bytes of the file cannot be sent as they are: what is read first would not agree with what is written meanwhile.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from aerobalance.io.hdf5_contents import Contents, contents_of, opened
from aerobalance.io.hdf5_guard import LIBVER
from aerobalance.io.hdf5_layout import SCHEMA
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError

_TABLES: Final = ("channels", "gaps", "events", "status")
_LARGEST_SETUP: Final = 2_000_000
_CHUNK: Final = 2**20


class FileSnapshot:
    """The blocks that a recording had at one moment, as bytes of a file of the same layout.

    The file is laid out first, with a hole where the samples belong; these are put in from the recording as the bytes
    are taken, so that it takes no room on the disk and its length is known at once.

    Parameters
    ----------
    path
        The recording, which may be written to meanwhile.

    Raises
    ------
    ReadError
        The file is no recording of the recorder's, or holds no block yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._hull: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as this does
        try:
            with opened(path) as inside:
                found = _checked(path, inside)
                self._slot, self._rows = found.slot, found.blocks["rows"].copy()
                self._columns = len(found.channels)
                self._first = self._lay_out(inside, found.blocks)
        except BaseException:
            self._hull.close()
            raise
        self._slot_bytes = self._slot * self._columns * 8
        self._last = self._first + self._rows.size * self._slot_bytes
        self.size = self._hull.seek(0, 2)

    def _lay_out(self, inside: Any, blocks: Any) -> int:
        """Write all but the samples; return where these begin."""
        import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

        with h5py.File(self._hull, "w", libver=LIBVER) as file:
            file.attrs.update(dict(inside.attrs))
            file.attrs["schema_version"] = inside.attrs.get("schema_version", SCHEMA)
            for name in _TABLES:
                file.create_dataset(name, data=inside[name][...])
            file.create_dataset("setup", data=inside["setup"][...])
            file.create_dataset("blocks", data=blocks)
            shape = ((blocks.size - 1) * self._slot + int(self._rows[-1]), self._columns)
            settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            settings.set_chunk((self._slot, self._columns))
            # all chunks at once, one after the other, and nothing in them
            settings.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            settings.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            kind = h5py.h5t.IEEE_F64LE
            samples = h5py.h5d.create(file.id, b"samples", kind, h5py.h5s.create_simple(shape), settings)
            file.flush()
            places = [samples.get_chunk_info(number).byte_offset for number in (0, blocks.size - 1)]
            if places[1] - places[0] != (blocks.size - 1) * self._slot * self._columns * 8:
                raise ReadError(self._path, "", "cannot be sent while it is written; stop the record first")
        return int(places[0])

    def parts(self) -> Iterator[bytes]:
        """Return the bytes of the file, in order, once."""
        with self._hull:
            yield from self._of_hull(0, self._first)
            with opened(self._path) as inside:
                for number, rows in enumerate(self._rows):
                    block: Array = np.full((self._slot, self._columns), np.nan)
                    first = number * self._slot
                    block[:rows] = inside["samples"][first : first + int(rows)]
                    yield block.astype("<f8").tobytes()
            yield from self._of_hull(self._last, self.size)

    def _of_hull(self, first: int, last: int) -> Iterator[bytes]:
        self._hull.seek(first)
        while first < last:
            part = self._hull.read(min(_CHUNK, last - first))
            first += len(part)
            yield part


def _checked(path: Path, inside: Any) -> Contents:
    """What the file says of itself, where it is a recording with samples."""
    found = contents_of(path, inside)
    if found.timed or not found.blocks.size or inside["setup"].size > _LARGEST_SETUP:
        raise ReadError(path, "", "holds no block yet, or is no recording of the recorder's")
    return found
