"""Zarr: a folder or a zip archive of arrays, by their path; versions 2 and 3, those of xarray among them."""

from __future__ import annotations

import contextlib
import json
import math
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from aerobalance.io.format_library import library, library_faults
from aerobalance.io.said_by_file import clock_of, epoch_of, plain_keys, sensor_said, since, unit_of, unpacked
from aerobalance.io.series import MOST_COLUMNS, MOST_SERIES, Holdings, Matrix, Series, kind_fault, named, with_axes
from aerobalance.recording.errors import ReadError

NAME: Final = "Zarr"
"""What to call the format in messages."""

_MARKS: Final = ("zarr.json", ".zgroup", ".zarray", ".zmetadata")
ZIPPED: Final = b"PK\x03\x04"
"""First bytes of a zip archive."""

_LARGEST_MARK: Final = 10_000_000
_DEEPEST: Final = 12
_LARGEST_CHUNK: Final = 1 << 29
_PACKED: Final = 100_000
"""Most bytes that a stored byte may stand for: a constant number packs well."""


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a folder, or a zip archive, is a Zarr store."""
    if head.startswith(ZIPPED):
        with contextlib.suppress(Exception), zipfile.ZipFile(path) as archive:
            return _root_of(archive.namelist()) is not None
        return False
    return path.is_dir() and any((path / mark).is_file() for mark in _MARKS)


def _root_of(names: Sequence[str]) -> str | None:
    """Where the store is in an archive: at the top, or in the one folder that was packed; None where there is none."""
    folders = {name.partition("/")[0] + "/" for name in names}
    roots = ["", *folders] if len(folders) == 1 else [""]
    return next((root for root in roots if any(root + mark in names for mark in _MARKS)), None)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a store to read its arrays as series; only the chunks that are wanted are read.

    Raises
    ------
    ReadError
        The store is damaged, or zarr is not installed.
    """
    zarr = library("zarr", "zarr", path, "a Zarr store")
    with contextlib.ExitStack() as stack:
        with library_faults(path, NAME, "its description (zarr.json or .zgroup)"):
            place = _Folder(path) if path.is_dir() else _Archive(path, stack.enter_context(zipfile.ZipFile(path)))
            _check_marks(path, place)
            store = zarr.storage.LocalStore(path, read_only=True) if path.is_dir() else zarr.storage.ZipStore(path)
            stack.callback(store.close)
            walk = _StoreWalk(path, place)
            walk.group(zarr.open(store, path=place.root, mode="r"), "", {}, depth=0)
            holdings = Holdings(with_axes(walk.series), walk.epoch)
        yield holdings


class _StorePlace(Protocol):
    """Where a store keeps its files."""

    @property
    def root(self) -> str:
        """Path of the store within the place, without a stroke at its end."""

    def marks(self) -> Iterator[tuple[str, int, Callable[[], bytes]]]:
        """Descriptions: where each is, its size, and what reads it.

        Raises
        ------
        ReadError
            One of them is a link, or a part of the store is too large.
        """

    def holds(self, label: str) -> bool:
        """Whether there is an array or a group of this path."""

    def stored(self, label: str) -> int:
        """Bytes that are stored of an array."""


@dataclass(frozen=True, slots=True)
class _Folder:
    """A store that is a folder."""

    path: Path
    root: str = ""

    def marks(self) -> Iterator[tuple[str, int, Callable[[], bytes]]]:
        """Descriptions, by their path in the folder; links are not followed."""
        for mark in [place for name in _MARKS for place in sorted(self.path.rglob(name))][:MOST_SERIES]:
            where = str(mark.relative_to(self.path))
            if mark.is_symlink() or mark.parent.resolve() != self.path.resolve() / mark.parent.relative_to(self.path):
                raise ReadError(self.path, where, "is a link; links are not followed: the data must be in the folder")
            yield where, mark.stat().st_size, mark.read_bytes

    def holds(self, label: str) -> bool:
        """Whether there is an array or a group of this path."""
        return (self.path / label).is_dir()

    def stored(self, label: str) -> int:
        """Bytes that are stored of an array."""
        folder = self.path / label if self.holds(label) else self.path
        return sum(part.stat().st_size for part in folder.rglob("*") if part.is_file() and part.name not in _MARKS)


@dataclass(frozen=True, slots=True)
class _Archive:
    """A store in a zip archive."""

    path: Path
    archive: zipfile.ZipFile

    @property
    def root(self) -> str:
        """Path of the store in the archive."""
        return (_root_of(self.archive.namelist()) or "").rstrip("/")

    def marks(self) -> Iterator[tuple[str, int, Callable[[], bytes]]]:
        """Descriptions, by their path in the archive."""
        for one in self.archive.infolist():
            if one.file_size > _LARGEST_CHUNK:
                raise ReadError(
                    self.path, one.filename, f"claims {one.file_size} bytes; unpack the archive to read it"
                )
            if one.filename.rpartition("/")[2] in _MARKS:
                yield one.filename, one.file_size, partial(self.archive.read, one)

    def holds(self, label: str) -> bool:
        """Whether there is an array or a group of this path."""
        return bool(self._parts(label))

    def stored(self, label: str) -> int:
        """Bytes that are stored of an array."""
        parts = self._parts(label) or self._parts("")
        return sum(one.compress_size for one in parts if one.filename.rpartition("/")[2] not in _MARKS)

    def _parts(self, label: str) -> list[zipfile.ZipInfo]:
        begin = "/".join(part for part in (self.root, label) if part)
        return [one for one in self.archive.infolist() if one.filename.startswith(f"{begin}/" if begin else "")]


def _check_marks(path: Path, place: _StorePlace) -> None:
    """Refuse descriptions that are no JSON of a decent size, and say which."""
    for where, size, read in place.marks():
        if size > _LARGEST_MARK:
            raise ReadError(path, where, f"is larger than {_LARGEST_MARK / 1e6:.0f} MB, which no description is")
        try:
            json.loads(read().decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise ReadError(path, where, f"is no JSON: {' '.join(str(error).split())[:120]}") from None


@dataclass(slots=True)
class _StoreWalk:
    """What is found on the way through the groups of a store."""

    path: Path
    place: _StorePlace
    series: list[Series] = field(default_factory=list)
    epoch: np.datetime64 | None = None

    def group(self, group: Any, place: str, about: dict[str, Any], *, depth: int) -> None:
        """Take the arrays of a group and those below it."""
        if hasattr(group, "shape"):  # the store is one array
            self.array(group, "array", about)
            return
        about = about | plain_keys(dict(group.attrs))
        self._dated(epoch_of(about))
        for name, one in sorted(group.members(), key=lambda member: str(member[0])):
            label = f"{place}/{name}" if place else str(name)
            if hasattr(one, "shape"):
                self.array(one, label, about)
            elif depth < _DEEPEST:
                self.group(one, label, about, depth=depth + 1)

    def array(self, one: Any, label: str, about: dict[str, Any]) -> None:
        """Take the series of one array."""
        shape = tuple(int(length) for length in one.shape)
        if len(shape) not in (1, 2) or math.prod(shape) < 2 or (len(shape) == 2 and min(shape) > MOST_COLUMNS):
            return
        columns = 1 if len(shape) == 1 else min(shape)
        if len(self.series) + columns > MOST_SERIES:
            raise ReadError(self.path, "arrays", f"are more than {MOST_SERIES}, which no recording has")
        attributes = dict(one.attrs)
        own = plain_keys(attributes)
        stated = unit_of(own)
        unit, date = since(stated) if "since" in stated else (stated, None)
        self._dated(date)
        name, unit = named(label.rpartition("/")[2], unit)
        along = int(np.argmax(shape))
        axis = _dimension(one, label, attributes, along)
        held = bool(axis) and self.place.holds(axis) and axis != label
        clock = clock_of(own) or (None if held else clock_of(about))
        if isinstance(own.get("fillvalue"), str):  # which xarray writes in code
            own.pop("fillvalue")
        whole = Series(
            label,
            name,
            unit,
            shape[along],
            lambda *_: np.empty(0),
            alias=label.rpartition("/")[2],
            clock=clock,
            axis=axis if held and clock is None else "",
            fault=_fault(self.place, one, label, shape),
            stamps=np.dtype(one.dtype).kind == "M",
            block=label if columns > 1 else "",
            sensor=sensor_said(own),
        )
        matrix = Matrix(one)
        for k in range(columns):
            read = unpacked(matrix.reader(k), own)
            mark = "" if columns == 1 else f"[{k + 1}]"
            self.series.append(
                replace(
                    whole,
                    read=read,
                    label=whole.label + mark,
                    name=whole.name + mark,
                    alias=whole.alias + mark,
                )
            )

    def _dated(self, date: np.datetime64 | None) -> None:
        self.epoch = self.epoch if self.epoch is not None else date


def _dimension(one: Any, label: str, attributes: dict[str, Any], along: int) -> str:
    """Path of the array of a dimension's coordinate; an empty string where the dimension has no name."""
    names = getattr(one.metadata, "dimension_names", None) or attributes.get("_ARRAY_DIMENSIONS") or ()
    if len(names) != one.ndim or not names[along]:
        return ""
    return f"{label.rpartition('/')[0]}/{names[along]}".lstrip("/")


def _fault(place: _StorePlace, one: Any, label: str, shape: tuple[int, ...]) -> str:
    """Return why an array cannot be read as readings; an empty string where it can."""
    kind = np.dtype(one.dtype)
    if fault := kind_fault(kind.kind, allowed="fiubM"):
        return fault
    stored = place.stored(label)
    if math.prod(shape) * kind.itemsize > _PACKED * stored:
        return f"it claims {math.prod(shape)} samples, stored in {stored} bytes: it is damaged"
    if math.prod(one.chunks) * kind.itemsize > _LARGEST_CHUNK:
        return f"its chunks have {math.prod(one.chunks) * kind.itemsize} bytes; at most {_LARGEST_CHUNK} are read"
    return ""
