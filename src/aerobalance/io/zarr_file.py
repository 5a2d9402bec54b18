"""Zarr: a folder of arrays, by their path; versions 2 and 3, those of xarray among them."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io.format_library import library, library_faults
from aerobalance.io.said_by_file import clock_of, epoch_of, plain_keys, sensor_said, since, unit_of, unpacked
from aerobalance.io.series import MOST_COLUMNS, MOST_SERIES, Holdings, Matrix, Series, kind_fault, named, with_axes
from aerobalance.recording.errors import ReadError

NAME: Final = "Zarr"
"""What to call the format in messages."""

_MARKS: Final = ("zarr.json", ".zgroup", ".zarray", ".zmetadata")
_LARGEST_MARK: Final = 10_000_000
_DEEPEST: Final = 12
_LARGEST_CHUNK: Final = 1 << 29
_PACKED: Final = 100_000
"""Most bytes that a stored byte may stand for: a constant number packs well."""


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a folder is a Zarr store."""
    del head
    return path.is_dir() and any((path / mark).is_file() for mark in _MARKS)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a store to read its arrays as series; only the chunks that are wanted are read.

    Raises
    ------
    ReadError
        The store is damaged, or zarr is not installed.
    """
    zarr = library("zarr", "zarr", path, "a Zarr store")
    with library_faults(path, NAME, "its description (zarr.json or .zgroup)"):
        _check_marks(path)
        root = zarr.open(zarr.storage.LocalStore(path, read_only=True), mode="r")
        walk = _Walk(path)
        walk.group(root, "", {}, depth=0)
        holdings = Holdings(with_axes(walk.series), walk.epoch)
    yield holdings


def _check_marks(path: Path) -> None:
    """Refuse descriptions that are no JSON of a decent size, and say which; links are not followed."""
    for mark in [place for name in _MARKS for place in sorted(path.rglob(name))][:MOST_SERIES]:
        where = str(mark.relative_to(path))
        if mark.is_symlink() or mark.parent.resolve() != path.resolve() / mark.parent.relative_to(path):
            raise ReadError(path, where, "is a link; links are not followed: the data must be in the folder")
        if mark.stat().st_size > _LARGEST_MARK:
            raise ReadError(path, where, f"is larger than {_LARGEST_MARK / 1e6:.0f} MB, which no description is")
        try:
            json.loads(mark.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ReadError(path, where, f"is no JSON: {' '.join(str(error).split())[:120]}") from None


@dataclass(slots=True)
class _Walk:
    """What is found on the way through the groups of a store."""

    path: Path
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
        held = bool(axis) and (self.path / axis).is_dir() and axis != label
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
            fault=_fault(self.path, one, label, shape),
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


def _fault(path: Path, one: Any, label: str, shape: tuple[int, ...]) -> str:
    """Return why an array cannot be read as readings; an empty string where it can."""
    kind = np.dtype(one.dtype)
    if fault := kind_fault(kind.kind, allowed="fiubM"):
        return fault
    folder = path / label if (path / label).is_dir() else path
    stored = sum(part.stat().st_size for part in folder.rglob("*") if part.is_file() and part.name not in _MARKS)
    if math.prod(shape) * kind.itemsize > _PACKED * stored:
        return f"it claims {math.prod(shape)} samples, stored in {stored} bytes: it is damaged"
    if math.prod(one.chunks) * kind.itemsize > _LARGEST_CHUNK:
        return f"its chunks have {math.prod(one.chunks) * kind.itemsize} bytes; at most {_LARGEST_CHUNK} are read"
    return ""
