"""Write a file whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from aerobalance.io.held_file import refuse_held


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Give a path to write beside a file; put what was written in the file's place at the end.

    The file keeps its old content until the new one is complete and on the disk; where the writing fails, nothing
    is left over.

    Parameters
    ----------
    path
        The file to write.

    Yields
    ------
    Path
        An empty file in the same folder, to be written.

    Raises
    ------
    ValueError
        The folder does not exist or cannot be written to, `path` is a folder, or a recording that is being written.
    """
    target = Path(path)
    if target.is_dir():
        raise ValueError(f"{target} is a folder; the name of a file is needed")
    if not target.parent.is_dir():
        raise ValueError(f"cannot write {target}: there is no folder {target.parent}")
    refuse_held(target)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name[:80]}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise ValueError(f"cannot write {target}: {error.strerror or error}") from None
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        with beside.open("rb+") as file:
            os.fsync(file.fileno())
        beside.chmod(_mode(target))
        refuse_held(target)  # a record may have begun meanwhile
        beside.replace(target)
    except OSError as error:
        raise ValueError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        beside.unlink(missing_ok=True)


def _mode(target: Path) -> int:
    """Permissions of the file: those it had, or those a new file gets (mkstemp makes it private)."""
    if target.exists():
        return target.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
