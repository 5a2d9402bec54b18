"""Files opened for reading, with the one set of words for those that cannot be."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from aerobalance.recording.errors import ReadError


@contextmanager
def opened_file(path: Path) -> Iterator[BufferedReader]:
    """Open a file for reading its bytes.

    Raises
    ------
    ReadError
        It is missing, a folder, a pipe or another special file, or cannot be opened or read.
    """
    try:
        mode = path.stat().st_mode  # before it is opened: a pipe nobody writes to would wait for ever
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise ReadError(
                path,
                "",
                "is a pipe, a device or a socket, and files are read more than once; an ordinary file is needed: "
                "save what it gives in one",
            )
        stream = path.open("rb")
    except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
        raise _refusal(path, error) from None
    with stream:
        try:
            yield stream
        except OSError as error:
            raise _refusal(path, error) from None


def _refusal(path: Path, error: OSError | ValueError) -> ReadError:
    if isinstance(error, FileNotFoundError):
        if str(path) == "-":
            return ReadError(path, "", "standard input is not read here; give a file")
        return ReadError(path, "", "there is no such file")
    if isinstance(error, IsADirectoryError):
        return ReadError(path, "", "is a folder; a file is needed")
    return ReadError(path, "", f"cannot be read: {getattr(error, 'strerror', None) or error}")
