"""The mark of a file that is being written, and taking it off where the writer was killed.

HDF5 puts a flag into the first bytes of a file that is written to. A writer that is killed leaves it there, and other
HDF5 programs refuse the file from then on, although every block that was acknowledged is in it. What tells a writer
that lives from one that is gone is a lock, which the system releases with its process: the recorder holds a shared one
on its file, beside which others can read, and the flag is cleared under an exclusive one only.
"""

from __future__ import annotations

import contextlib
import os
import stat
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

try:
    import fcntl
except ImportError:  # no such locks: files are then left as they are
    fcntl = None  # type: ignore[assignment]

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
"""The first bytes of an HDF5 file."""

HEAD: Final = 256
"""Bytes at the beginning of a file that the mark and its checksum are among."""

_ENDINGS: Final = (".h5", ".hdf5")
_FLAGGED_VERSION: Final = 3
_VERSION, _WIDTH, _FLAGS, _END = 8, 9, 11, 28
_ADDRESS: Final = 8
_WRITING: Final = 0b101
_BINARY: Final = getattr(os, "O_BINARY", 0)


def begin_file(path: Path, content: bytes) -> int:
    """Make a new file with its first content, locked as one that is being written, and return its handle.

    Raises
    ------
    OSError
        The file exists, or cannot be written; nothing is left of it then.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
    try:
        if fcntl is not None:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(handle, rest) :]
        os.fsync(handle)
    except OSError:
        os.close(handle)
        path.unlink(missing_ok=True)
        raise
    return handle


def marked_as_written(head: bytes | bytearray) -> bool:
    """Return from the first 12 bytes of a file whether it is being written, or was when its writer was killed."""
    return (
        len(head) > _FLAGS
        and head.startswith(SIGNATURE)
        and head[_VERSION] >= _FLAGGED_VERSION
        and bool(head[_FLAGS] & _WRITING)
    )


def close_broken_off(path: Path | str) -> bool:
    """Take the mark off a file whose writer is gone, and say whether that was done.

    A file that is still being written, that is marked by no writer, or whose first bytes are damaged is left as it is.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    with _alone(Path(path)) as handle:
        return handle is not None and take_mark_off(handle)


def take_mark_off(handle: int) -> bool:
    """Clear the flag of an open file that nobody writes to any more; False where its first bytes are damaged.

    The end of the file, which the library notes there when it closes only, is set to what the file really has.
    """
    os.lseek(handle, 0, os.SEEK_SET)
    head = unmarked_head(os.read(handle, HEAD), os.fstat(handle).st_size)
    if head is None:
        return False
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, head)
    os.fsync(handle)
    return True


def unmarked_head(given: bytes, end: int) -> bytes | None:
    """Return the first bytes of a marked file without the mark; None where they are damaged.

    Parameters
    ----------
    given
        The first bytes, `HEAD` of them where there are as many.
    end
        Size of the file.
    """
    head = bytearray(given)
    size = 12 + 4 * head[_WIDTH] if marked_as_written(head) and head[_WIDTH] == _ADDRESS else 0
    if not 0 < size <= len(head) - 4 or struct.unpack_from("<I", head, size)[0] != lookup3(head[:size]):
        return None
    head[_FLAGS] &= ~_WRITING
    struct.pack_into("<Q", head, _END, end)
    struct.pack_into("<I", head, size, lookup3(head[:size]))
    return bytes(head[: size + 4])


def is_written(path: Path) -> bool:
    """Return whether somebody writes to a marked file now, as far as the lock on it tells."""
    if fcntl is None:
        return True
    with path.open("rb") as file:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        return False


def close_all_broken_off(folder: Path) -> list[str]:
    """Take the mark off every recording in a folder whose writer is gone; return the names of these files.

    Files that cannot be opened or written stay as they are.
    """
    done = []
    with contextlib.suppress(OSError):
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in _ENDINGS:
                with contextlib.suppress(OSError):
                    if close_broken_off(path):
                        done.append(path.name)
    return done


def closed_text(name: str) -> str:
    """Return the sentence that the mark was taken off a file."""
    return f"{name} was broken off by a kill; it is closed now, so that every HDF5 program opens it"


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[int | None]:
    """Open a marked file under a lock that only one can have; None where it is not marked, or somebody has it."""
    no_link = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    handle = os.open(path, os.O_RDONLY | no_link | _BINARY)
    try:
        marked = stat.S_ISREG(os.fstat(handle).st_mode) and marked_as_written(os.read(handle, 12))
    finally:
        os.close(handle)
    if fcntl is None or not marked:
        yield None
        return
    handle = os.open(path, os.O_RDWR | no_link | _BINARY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield None
            return
        yield handle
    finally:
        os.close(handle)


def lookup3(data: bytes | bytearray) -> int:
    """Return Jenkins' lookup3 hash with initial value 0: the checksum of HDF5's own structures.

    R. J. Jenkins, "lookup3.c, for hash table lookup", 2006, public domain; function hashlittle.
    """
    a = b = c = (0xDEADBEEF + len(data)) & _WORD
    rest = len(data)
    place = 0
    while rest > 12:
        x, y, z = struct.unpack_from("<III", data, place)
        a, b, c = _mixed(a + x, b + y, c + z)
        place, rest = place + 12, rest - 12
    if rest == 0:
        return c
    x, y, z = struct.unpack("<III", data[place:].ljust(12, b"\0"))
    return _final((a + x) & _WORD, (b + y) & _WORD, (c + z) & _WORD)


_WORD: Final = 0xFFFFFFFF


def _turned(value: int, bits: int) -> int:
    return ((value << bits) | (value >> (32 - bits))) & _WORD


def _mixed(a: int, b: int, c: int) -> tuple[int, int, int]:
    """Mix three words (macro mix)."""
    a, b, c = a & _WORD, b & _WORD, c & _WORD
    for bits in (4, 6, 8, 16, 19, 4):
        a, c = ((a - c) & _WORD) ^ _turned(c, bits), (c + b) & _WORD
        a, b, c = b, c, a
    return a, b, c


def _final(a: int, b: int, c: int) -> int:
    """Mix three words for the last time (macro final)."""
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _turned(b, bits)) & _WORD
        a, b, c = b, c, a
    return b
