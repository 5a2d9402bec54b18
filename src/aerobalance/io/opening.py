"""Files opened for reading, with the one set of words for those that cannot be."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from aerobalance.problems import ReadError


@contextmanager
def opened_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading its bytes.

    Raises
    ------
    ReadError
        It is missing, a folder, or cannot be read.
    """
    try:
        with path.open("rb") as stream:
            yield stream
    except FileNotFoundError:
        raise ReadError(path, "", "there is no such file") from None
    except IsADirectoryError:
        raise ReadError(path, "", "is a folder; a file is needed") from None
    except OSError as error:
        raise ReadError(path, "", f"cannot be read: {error.strerror or error}") from None
