"""A file that never fails under the HDF5 library, which cannot be closed any more after a failure."""

from __future__ import annotations

import io
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

_AT_ONCE: Final = 1 << 19
"""Bytes that are written at once where they come one after the other; such pieces begin at multiples of it."""

LIBVER: Final = ("v110", "v110")
"""Versions of the format that are written: what HDF5 1.10 and everything after it reads, and the first with SWMR."""


class GuardedFile(io.RawIOBase):
    """A new file on the disk, for `h5py.File`, that remembers a failure in place of raising it.

    A library that is refused a write holds what it could not write, fails again at every try to close, and crashes the
    process in the end. Here what the disk refuses is kept in memory, so that the library closes as usual; whoever
    writes looks at `failure` from time to time, gives up early, and closes: that raises the failure.

    What comes in short pieces one after the other is put together before it is written: pieces that begin in the
    middle of a page take the system up to three times as long.

    Parameters
    ----------
    path
        The file; what is in it is lost.

    Attributes
    ----------
    failure
        The first failure; None as long as there is none.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._disk = io.FileIO(path, "w+")
        self._place = 0
        self._size = 0
        self._kept: list[tuple[int, bytes]] = []
        self._waiting, self._first, self._count = memoryview(bytearray(_AT_ONCE)), 0, 0
        self.failure: OSError | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        """Close; raise the failure, unless something else is on its way."""
        self._put()
        self._disk.close()
        super().close()
        if self.failure is not None and kind is None:
            raise self.failure

    def readable(self) -> bool:
        """It can be read."""
        return True

    def writable(self) -> bool:
        """It can be written."""
        return True

    def seekable(self) -> bool:
        """Any place can be gone to."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, and return it."""
        self._place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._size}[whence]
        return self._place

    def tell(self) -> int:
        """Return the place."""
        return self._place

    def readinto(self, buffer: Any) -> int:
        """Read from the place on, and return how many bytes."""
        self._put()
        into = memoryview(buffer).cast("B")
        count = max(0, min(len(into), self._size - self._place))
        self._disk.seek(self._place)
        got = self._disk.read(count)
        into[:count] = got + bytes(count - len(got))
        for start, part in self._kept:
            first, last = max(start, self._place), min(start + len(part), self._place + count)
            if first < last:
                into[first - self._place : last - self._place] = part[first - start : last - start]
        self._place += count
        return count

    def write(self, data: Any) -> int:
        """Write at the place, to the disk as long as it takes it, and return how many bytes."""
        view = memoryview(data).cast("B")
        if self._place != self._first + self._count:
            self._put()
        done = 0
        while done < len(view):
            if not self._count:
                self._first = self._place + done
            room = _AT_ONCE - self._first % _AT_ONCE - self._count
            part = view[done : done + room]
            self._waiting[self._count : self._count + len(part)] = part
            self._count, done = self._count + len(part), done + len(part)
            if len(part) == room:
                self._put()
        self._place += len(view)
        self._size = max(self._size, self._place)
        return len(view)

    def _put(self) -> None:
        """Write what waits."""
        view, done = self._waiting[: self._count], 0
        self._count = 0
        try:
            if self.failure is None and view:
                self._disk.seek(self._first)
            while self.failure is None and done < len(view):
                done += self._disk.write(view[done:]) or 0
        except OSError as error:
            self.failure = error
        if done < len(view):
            self._kept.append((self._first + done, bytes(view[done:])))

    def truncate(self, size: int | None = None) -> int:
        """Make the file this long, and return it."""
        self._put()
        self._size = self._place if size is None else size
        if self.failure is None:
            try:
                self._disk.truncate(self._size)
            except OSError as error:
                self.failure = error
        return self._size
