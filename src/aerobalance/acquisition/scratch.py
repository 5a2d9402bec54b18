"""Folders for the sockets between processes, which are removed even where all of them were killed."""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path
from typing import Final

from aerobalance.io.locked_file import is_locked, open_locked

PREFIX: Final = "aerobalance-"
_LOCK: Final = "lock"
_OWN: Final[dict[Path, int]] = {}


def make_folder() -> Path:
    """Return a new private folder, after removing those whose processes are gone."""
    remove_left_over()
    folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    fresh = folder / "fresh"
    fresh.touch(0o600)
    _OWN[folder] = open_locked(fresh)
    fresh.rename(folder / _LOCK)  # there is no lock that nobody holds
    return folder


def stay(folder: Path) -> None:
    """Keep a folder for as long as this process lives, whoever has made it."""
    with contextlib.suppress(OSError):
        _OWN[folder] = open_locked(folder / _LOCK)


def remove(folder: Path) -> None:
    """Remove a folder with what is in it."""
    shutil.rmtree(folder, ignore_errors=True)
    handle = _OWN.pop(folder, None)
    if handle is not None:
        os.close(handle)


def remove_own() -> None:
    """Remove all folders that this process has made and not removed yet."""
    for folder in list(_OWN):
        remove(folder)


def remove_left_over() -> None:
    """Remove folders whose processes were all killed: those of this user that nobody holds a lock in any more."""
    if sys.platform == "win32":
        return
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            status = os.lstat(folder)
            private = stat.S_ISDIR(status.st_mode) and stat.S_IMODE(status.st_mode) == stat.S_IRWXU
            lock = folder / _LOCK
            if private and status.st_uid == os.getuid() and lock.is_file() and not is_locked(lock):
                shutil.rmtree(folder, ignore_errors=True)
