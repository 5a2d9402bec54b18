"""A complete HDF5 file of a recording that is still being written, as bytes to be sent over the network.

The file on the disk cannot be sent as it is: what is read of it first would not agree with what is written while the
rest is read.
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
"""Bytes of a set-up at most, as it is copied in memory: a set-up is a text of some pages."""

_PIECE: Final = 2**20
"""Bytes that are read at once."""

_BYTES_OF_SAMPLE: Final = 8
"""Samples are float64."""


class FileSnapshot:
    """The blocks that a recording held at one moment, as bytes of an HDF5 file of the same layout.

    First a temporary file is written that has everything but the samples: for these HDF5 only sets space aside, in one
    contiguous range. While the bytes are taken, that range is filled from the recording. So the samples are not copied
    on the disk, and the length of the file is known before the first byte is sent.

    Parameters
    ----------
    path
        The recording, which may be written to meanwhile.

    Raises
    ------
    ReadError
        The file was not written by the recorder, or holds no block of samples yet.

    Attributes
    ----------
    size
        Length of the file [bytes].
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._without_samples: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as this does
        try:
            with opened(path) as inside:
                found = _checked(path, inside)
                self._block_rows, self._rows = found.slot, found.blocks["rows"].copy()
                self._columns = len(found.channels)
                self._first = self._lay_out(inside, found.blocks)
        except BaseException:
            self._without_samples.close()
            raise
        block_bytes = self._block_rows * self._columns * _BYTES_OF_SAMPLE
        self._last = self._first + self._rows.size * block_bytes
        self.size = self._without_samples.seek(0, 2)

    def _lay_out(self, inside: Any, blocks: Any) -> int:
        """Write all but the samples; return the byte at which these begin."""
        import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

        with h5py.File(self._without_samples, "w", libver=LIBVER) as file:
            file.attrs.update(dict(inside.attrs))
            file.attrs["schema_version"] = inside.attrs.get("schema_version", SCHEMA)
            for name in _TABLES:
                file.create_dataset(name, data=inside[name][...])
            file.create_dataset("setup", data=inside["setup"][...])
            file.create_dataset("blocks", data=blocks)
            shape = ((blocks.size - 1) * self._block_rows + int(self._rows[-1]), self._columns)
            settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            settings.set_chunk((self._block_rows, self._columns))
            # allocated at once, so that the chunks follow each other, and not filled, so that nothing is written
            settings.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            settings.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            kind = h5py.h5t.IEEE_F64LE
            samples = h5py.h5d.create(file.id, b"samples", kind, h5py.h5s.create_simple(shape), settings)
            file.flush()
            places = [samples.get_chunk_info(number).byte_offset for number in (0, blocks.size - 1)]
            if places[1] - places[0] != (blocks.size - 1) * self._block_rows * self._columns * _BYTES_OF_SAMPLE:
                raise ReadError(self._path, "", "cannot be sent while it is written; stop the record first")
        return int(places[0])

    def parts(self) -> Iterator[bytes]:
        """Yield the bytes of the file in order; only once, as the temporary file is closed at the end."""
        with self._without_samples:
            yield from self._stored(0, self._first)
            with opened(self._path) as inside:
                for number, rows in enumerate(self._rows):
                    block: Array = np.full((self._block_rows, self._columns), np.nan)
                    first = number * self._block_rows
                    block[:rows] = inside["samples"][first : first + int(rows)]
                    yield block.astype("<f8").tobytes()
            yield from self._stored(self._last, self.size)

    def _stored(self, first: int, last: int) -> Iterator[bytes]:
        """Yield the bytes of the temporary file from one to another, the last not included."""
        self._without_samples.seek(first)
        while first < last:
            part = self._without_samples.read(min(_PIECE, last - first))
            first += len(part)
            yield part


def _checked(path: Path, inside: Any) -> Contents:
    """Return what a recording says of itself; refuse one without samples or not written by the recorder."""
    found = contents_of(path, inside)
    if found.timed or not found.blocks.size or inside["setup"].size > _LARGEST_SETUP:
        raise ReadError(path, "", "holds no block yet, or is no recording of the recorder's")
    return found
