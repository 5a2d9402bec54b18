"""A file with the mark of one that is being written, opened as if it were closed, where its writer is gone.

HDF5 opens a file with the mark as one that is written to, and then waits for what does not agree with its checksum to
be written: twice as long at every one of a hundred times, which in a damaged file has no end. Where nobody writes, the
file is read here with the mark taken off its first bytes in memory.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

from aerobalance.io.hdf5_closing import HEAD, unmarked_head
from aerobalance.recording.errors import ReadError


class UnmarkedFile(io.RawIOBase):
    """A file for `h5py.File` whose mark is taken off and whose end is where it really is; it stays as it is on disk.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    ReadError
        Its first bytes do not agree with their checksum.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._disk = path.open("rb")
        self._size = self._disk.seek(0, os.SEEK_END)
        self._disk.seek(0)
        head = unmarked_head(self._disk.read(HEAD), self._size)
        self._disk.seek(0)
        if head is None:
            self.close()
            raise ReadError(path, "byte 0", "the first bytes do not agree with their checksum: the file is damaged")
        self._head = head

    def close(self) -> None:
        """Close the file."""
        self._disk.close()
        super().close()

    def readable(self) -> bool:
        """It can be read."""
        return True

    def seekable(self) -> bool:
        """Any place can be gone to."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, and return it."""
        return self._disk.seek(offset, whence)

    def tell(self) -> int:
        """Return the place."""
        return self._disk.tell()

    def readinto(self, buffer: Any) -> int:
        """Read from the place on, and return how many bytes."""
        into = memoryview(buffer).cast("B")
        place = self._disk.tell()
        count = self._disk.readinto(into)
        if place < len(self._head):
            own = self._head[place : place + count]
            into[: len(own)] = own
        return count
