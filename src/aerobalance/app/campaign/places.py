"""Files of a campaign on this machine or in an object store: listing, fingerprints, local copies.

A place is a path, or an address such as ``s3://bucket/run.h5`` of any store that fsspec opens.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aerobalance.io.artefacts import digest
from aerobalance.recording.errors import ReadError

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

INSTALL: Final = "pip install 'aerobalance[campaign]'"
"""Command that installs what campaigns need."""

AT_ONCE: Final = 32
"""Requests to a store that are sent at once: each waits tens of milliseconds for its answer and takes no processor."""

MARKS: Final = (
    ("ETag", "etag", "VersionId", "generation", "md5Hash", "Content-MD5", "Digest"),
    ("LastModified", "Last-Modified", "last_modified", "updated", "mtime", "modify", "modificationTime"),
)
"""Keys by which stores state the version of a file: marks of its content; where there is none, times of change."""

READ: Final = 1 << 20
"""Bytes that are read at a time."""

Given = TypeVar("Given")
Found = TypeVar("Found")


class MissingLibraryError(ValueError):
    """A library that campaigns need is not installed; the message names the command that installs it."""

    def __init__(self, library: str) -> None:
        super().__init__(f"campaigns need the library {library}, which is not installed: {INSTALL}")


def is_address(place: str) -> bool:
    """Return whether a place is the address of a store, and not a path."""
    return "://" in place


def joined(folder: str, name: str) -> str:
    """Return the place of a name in a folder; an absolute path or an address is returned as it is."""
    if is_address(name) or Path(name).is_absolute():
        return name
    if is_address(folder):
        return f"{folder.rstrip('/')}/{name}"
    return str(Path(folder) / name)


def folder_of(place: str) -> str:
    """Return the folder that a place is in."""
    return place.rpartition("/")[0] if is_address(place) else str(Path(place).parent)


def name_of(place: str) -> str:
    """Return the name of a file without its folders."""
    return posixpath.basename(place.rstrip("/")) if is_address(place) else Path(place).name


def store_of(place: str) -> tuple[AbstractFileSystem, str]:
    """Return the file system of a place, and the path of the place in it.

    Raises
    ------
    ReadError
        There is no such kind of store, or the library of this kind is not installed.
    MissingLibraryError
        fsspec itself is not installed.
    """
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 - of an extra
    except ImportError:
        raise MissingLibraryError("fsspec") from None
    try:
        system, inside = url_to_fs(place)
    except (ValueError, ImportError) as error:
        command = _command_for(place) if isinstance(error, ImportError) else ""
        raise ReadError(place, "", f"cannot be opened: {' '.join(str(error).split())}{command}") from None
    return system, inside


def _command_for(place: str) -> str:
    """The command that installs the library of a kind of store; nothing where fsspec does not name it."""
    from fsspec.registry import known_implementations  # noqa: PLC0415 - of an extra

    known = known_implementations.get(place.partition("://")[0], {})
    module = str(known.get("class", "")).partition(".")[0]
    return f": pip install {module}" if module not in ("", "fsspec") else ""


def exists(place: str) -> bool:
    """Return whether there is a file or a folder."""
    if not is_address(place):
        return Path(place).exists()
    return bool(_asked(place, "exists"))


def matching(folder: str, pattern: str) -> list[str]:
    """Return the places in a folder that match a pattern such as ``runs/*.h5``, sorted by name.

    A name without wildcards is returned as it is, whether there is such a file or not, and so is one that is there:
    ``run[2].h5`` may be a file. The name of the folder is no pattern.
    """
    whole = joined(folder, pattern)
    if not any(sign in pattern for sign in "*?[") or exists(whole):
        return [whole]
    pattern = joined(escape(folder), pattern)
    if not is_address(pattern):
        path = Path(pattern)
        root = Path(path.anchor)
        found = sorted(root.glob(str(path.relative_to(root)))) if path.is_absolute() else sorted(Path().glob(pattern))
        return [str(one) for one in found if one.is_file()]
    system, inside = store_of(pattern)
    try:
        system.invalidate_cache()  # a listing of an earlier call would lack new files
        return sorted(str(system.unstrip_protocol(one)) for one in system.glob(inside))
    except OSError as error:
        raise ReadError(pattern, "", f"cannot be listed: {error}") from None


def listed(folder: str) -> list[str]:
    """Return the files of a folder that are not hidden, sorted by name."""
    return [place for place in matching(folder, "*") if not name_of(place).startswith(".")]


def fingerprint(place: str) -> str:
    """Return a text that changes when the content of a file changes.

    It is the SHA-256 of the content. In a store that states a version or a time of change it is these with the size,
    since the SHA-256 would cost sending the whole file.

    Raises
    ------
    ReadError
        There is no such file, or it cannot be read.
    """
    if not is_address(place):
        return f"sha256:{digest(Path(place))}"
    if not place.startswith(("file://", "local://")):  # of a local file the time of change says less than the content
        about = _asked(place, "info")
        for keys in MARKS:
            said = [str(about[key]) for key in keys if about.get(key)]
            if said:
                return " ".join(["store:", str(about.get("size")), *said])
    system, inside = store_of(place)
    whole = hashlib.sha256()
    try:
        with system.open(inside, "rb") as file:
            while part := file.read(READ):
                whole.update(part)
    except OSError as error:
        raise _refusal(place, error) from None
    return f"sha256:{whole.hexdigest()}"


def each_of(work: Callable[[Given], Found], given: Sequence[Given], *, of_store: bool) -> list[Found]:
    """Return the results of a function for each argument, in their order; of a store with many calls at once.

    Parameters
    ----------
    work
        The function.
    given
        Its arguments, one for each call.
    of_store
        Whether a call waits for a store rather than uses this machine.
    """
    if not of_store or len(given) < 2:
        return [work(one) for one in given]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(work, given))


def _asked(place: str, what: str) -> Any:
    """Return the answer of a store to one of fsspec's methods, such as ``info``."""
    system, inside = store_of(place)
    try:
        return getattr(system, what)(inside)
    except OSError as error:
        raise _refusal(place, error) from None


def _refusal(place: str, error: OSError) -> ReadError:
    missing = isinstance(error, FileNotFoundError)
    return ReadError(place, "", "there is no such file" if missing else f"cannot be read: {error}")


@contextmanager
def fetched(place: str) -> Iterator[Path]:
    """Give the path of a file on this machine: the file itself, or a copy of the same name that is deleted afterwards.

    Raises
    ------
    ReadError
        There is no such file, or it cannot be read.
    """
    if not is_address(place):
        yield Path(place)
        return
    system, inside = store_of(place)
    with TemporaryDirectory(prefix="aerobalance-") as folder:
        copy = Path(folder) / name_of(place)
        try:
            system.get_file(inside, str(copy))
        except OSError as error:
            raise _refusal(place, error) from None
        yield copy
