"""Protection of a file while it is being written: against being replaced, and against loss when its name is deleted.

A writer holds a shared lock (flock) on its file: readers may open it, and this program does not replace it. Meanwhile
the file has a second, hidden name (hard link) beside it: where the first is deleted or given to another file, the
content is still there under the second, with all that was written, and is given a new name beside the old one.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from pathlib import Path
from typing import Final, NamedTuple

from aerobalance.io.hdf5_closing import close_broken_off

if sys.platform != "win32":
    import fcntl

SPARE: Final = ".recording"
"""Ending of the second name, which begins with a dot."""

_LONGEST: Final = 200
"""Characters of a name that are kept in a longer one: file systems allow 255 bytes."""

_MOST_NAMES: Final = 10_000
"""Number below which numbered names are tried."""


class FileFault(NamedTuple):
    """What has happened to a file that is being written.

    Attributes
    ----------
    text
        Description, beginning with the name that the file had.
    path
        Where the file is now; None where it has no name any more, or was cut short.
    damaged
        Whether the file has lost some of what was written.
    """

    text: str
    path: Path | None
    damaged: bool = False


class LockedFile:
    """Lock and hidden second name of a file that is being written; follows the file when it is moved.

    Parameters
    ----------
    path
        The file, which must exist.

    Raises
    ------
    OSError
        The file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()
        self._first = self.path
        self._spare = self.path.with_name(f".{path.name[:_LONGEST]}{SPARE}")
        self._handle = open_locked(self.path)
        self._size = 0
        if sys.platform != "win32":  # there, an open file can be neither deleted nor replaced
            self._link()

    def look(self) -> FileFault | None:
        """Return what has happened to the file; None where it has its name and all of its content.

        A fault that remains is returned again at the next call.
        """
        if sys.platform == "win32":
            return None
        size = os.fstat(self._handle).st_size
        if size < self._size:
            return FileFault(f"{self.path.name} was cut short by another program while it was written", None, True)
        self._size = size
        if self._is(self.path):
            if not self._is(self._spare):
                self._link()
            return None
        old, there = self.path.name, os.path.lexists(self.path)
        moved = Path(f"/proc/self/fd/{self._handle}")
        with contextlib.suppress(OSError):
            moved = moved.readlink()
        if self._is(moved) and moved not in (self._spare, Path(f"/proc/self/fd/{self._handle}")):
            self.path = moved
            self._follow_folder()
            return FileFault(f"{old} was moved to {moved} while it was written", moved)
        what = "was replaced by another file" if there else "was deleted"
        found = self._new_name() if self._is(self._spare) else None
        if found is not None:
            handle = open_locked(found)  # by its new name, so that it can be followed from there
            os.close(self._handle)
            self._handle, self.path = handle, found
        return FileFault(f"{old} {what} while it was written", found)

    def copy(self) -> Path:
        """Copy the content of a file that has no name any more, and return the path of the copy.

        Raises
        ------
        OSError
            The content cannot be copied.
        """
        self._first.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.dup(self._handle), "rb") as source:
            for path in _names(self._first):
                try:
                    target = path.open("xb")
                except FileExistsError:
                    continue
                with target:
                    source.seek(0)
                    shutil.copyfileobj(source, target, 2**20)
                    target.flush()
                    os.fsync(target.fileno())
                self.path = path
                return path
        raise FileExistsError(f"all names beside {self._first} are taken")

    def release(self) -> None:
        """Remove the lock and, where the file still has its name, the second name."""
        if self._is(self._spare) and self._is(self.path):
            with contextlib.suppress(OSError):
                self._spare.unlink()
        os.close(self._handle)

    def _is(self, path: Path) -> bool:
        """Whether a path is a name of the locked file."""
        try:
            return os.path.samestat(os.lstat(path), os.fstat(self._handle))
        except OSError:
            return False

    def _follow_folder(self) -> None:
        """Find the second name again where the whole folder was moved, and not the file alone."""
        beside = self.path.with_name(self._spare.name)
        if not self._is(self._spare) and self._is(beside):
            self._spare = beside
            self._first = self.path.with_name(self._first.name)

    def _link(self) -> None:
        """Give the file its second name, where the file system has hard links."""
        with contextlib.suppress(OSError):
            if os.path.lexists(self._spare) and not is_locked(self._spare):
                recover(self._spare)
            os.link(self.path, self._spare)

    def _new_name(self) -> Path | None:
        """Path of a new name of the file beside its first one; None where it cannot be given."""
        for path in _names(self._first):
            try:
                os.link(self._spare, path)
            except FileExistsError:
                continue
            except OSError:
                return None
            return path
        return None


def open_locked(path: Path) -> int:
    """Return the descriptor of a file, with a shared lock until it is closed, where the file system has locks."""
    handle = os.open(path, os.O_RDONLY)
    if sys.platform != "win32":
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    return handle


def is_locked(path: Path) -> bool:
    """Return whether a file is being written at this moment, or is otherwise locked by another program."""
    if sys.platform == "win32":
        return False
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    else:
        return False
    finally:
        os.close(handle)


def refuse_locked(path: Path) -> None:
    """Refuse to replace a file that is being written.

    Raises
    ------
    ValueError
        The file is being written, or locked by another program.
    """
    if is_locked(path):
        raise ValueError(
            f"{path} is being recorded, or is in use by another program, and is not replaced; "
            "let that end first, or give another name"
        )


def recover(spare: Path) -> Path | None:
    """Remove the second name of a file whose writer was killed; return the new name of a file that had only this one.

    Parameters
    ----------
    spare
        The second name.
    """
    if not spare.is_file() or spare.is_symlink() or is_locked(spare):
        return None
    found: Path | None = None
    if os.lstat(spare).st_nlink == 1:  # its own name is gone
        first = spare.with_name(spare.name.removeprefix(".").removesuffix(SPARE))
        for path in (first, *_names(first)):
            with contextlib.suppress(FileExistsError):
                os.link(spare, path)
                found = path
                break
        else:
            return None
    spare.unlink(missing_ok=True)
    if found is not None:
        with contextlib.suppress(OSError):
            close_broken_off(found)
    return found


def recover_all(folder: Path) -> list[Path]:
    """Remove second names in a folder after writers were killed; return the new names of files that had no other."""
    found = []
    for spare in folder.glob(f".*{SPARE}"):
        with contextlib.suppress(OSError):
            path = recover(spare)
            found += [] if path is None else [path]
    return found


def _names(path: Path) -> list[Path]:
    """Names beside a file: run-2.h5, run-3.h5 and so on."""
    return [path.with_name(f"{path.stem[:_LONGEST]}-{number}{path.suffix}") for number in range(2, _MOST_NAMES)]
