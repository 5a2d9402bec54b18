"""Samples of HDF5 data sets read where they stand in the file, past the selections of the library.

A selection takes the library several times as long as the reading of a short piece. The library says where a data set
is stored; where it is not stored as it is, or anything about it is out of the common, the library reads it.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.series import Reads
from aerobalance.recording.channel import Array

if TYPE_CHECKING:
    import h5py


class _Run(NamedTuple):
    """Samples that stand in one piece: the first of them, that after the last, and the byte of the file."""

    begin: int
    end: int
    place: int


def is_plain(data: h5py.Dataset) -> bool:
    """Return whether short parts of a data set take no longer to read than a long one: float64 that is not packed."""
    return bool(data.dtype == np.float64 and not data.id.get_create_plist().get_nfilters())


class Filling:
    """Reads samples of a data set that `is_plain` into arrays.

    Parameters
    ----------
    data
        One series: of one dimension, or with one row or column.
    read
        Reads a part of it by the library.
    """

    def __init__(self, data: h5py.Dataset, read: Reads) -> None:
        self._data, self._read = data, read
        self._runs: list[_Run] | None = None
        self._begins: list[int] = []
        self._handle = -1

    def __call__(self, begin: int, into: Array) -> None:
        """Read as many samples as the array takes."""
        if self._runs is None:  # when it is read first: a file may have thousands of data sets
            self._begin()
        if not self._runs or not self._data.id.valid or not self._direct(begin, into.data.cast("B")):
            given = np.asarray(self._read(begin, begin + into.size)).ravel()
            if given.size != into.size:
                raise ValueError(f"it has {given.size} of {into.size} samples")
            into[:] = given

    def _begin(self) -> None:
        runs = _runs(self._data)
        self._begins = [run.begin for run in runs]
        self._handle = int(self._data.file.id.get_vfd_handle()) if runs else -1
        self._runs = runs  # last, as another thread may read meanwhile

    def _direct(self, begin: int, into: memoryview) -> bool:
        """Read from the file; whether all is there."""
        assert self._runs is not None
        at, end = begin, begin + len(into) // 8
        number = max(0, bisect_right(self._begins, begin) - 1)
        while at < end and number < len(self._runs) and self._runs[number].begin <= at < self._runs[number].end:
            run = self._runs[number]
            stop = min(end, run.end)
            part = into[8 * (at - begin) : 8 * (stop - begin)]
            if os.preadv(self._handle, [part], run.place + 8 * (at - run.begin)) != len(part):
                return False
            at, number = stop, number + 1
        return at >= end


def places_of_pieces(data: h5py.Dataset, count: int) -> NDArray[np.int64] | None:
    """Return where pieces of one column each of a table stand in its file [byte], shape (n, c) of the first n rows.

    It is below zero where a piece is not there as it is; None where the library has to read all of them.

    Parameters
    ----------
    data
        The table.
    count
        Rows of pieces that are asked for, n: what the table claims may be any number.
    """
    if not _as_it_is(data) or data.file.userblock_size:
        return None
    rows = data.chunks[0]
    found = np.full((count, data.shape[1]), -1, dtype=np.int64)

    def note(piece: Any) -> None:
        row, column = piece.chunk_offset
        if row < count * rows and not piece.filter_mask and piece.size == 8 * rows:
            found[row // rows, column] = piece.byte_offset

    try:
        data.id.chunk_iter(note)
    except Exception:  # noqa: BLE001 - damaged: the library says at which of them
        return None
    return found


def _as_it_is(data: h5py.Dataset) -> bool:
    """Whether the bytes of a data set of float64 that is not packed can be read from the file."""
    return data.file.driver == "sec2" and hasattr(os, "preadv") and data.dtype == np.float64


def _runs(data: h5py.Dataset) -> list[_Run]:
    """Where the samples of a data set stand, in order; none where the library has to read them."""
    if not _as_it_is(data):
        return []
    if data.chunks is None:
        place = data.id.get_offset()
        return [] if place is None else [_Run(0, data.size, int(place))]
    along = int(np.argmax(data.shape))
    # versions of the library differ in whether the place of a piece counts what stands before the file's own beginning
    if data.file.userblock_size or any(length != 1 for axis, length in enumerate(data.chunks) if axis != along):
        return []
    length, found = data.chunks[along], []

    def note(piece: Any) -> None:
        begin = int(piece.chunk_offset[along])
        whole = not piece.filter_mask and piece.size == 8 * length
        found.append(_Run(begin, min(begin + length, data.size) if whole else begin, int(piece.byte_offset)))

    try:
        data.id.chunk_iter(note)
    except Exception:  # noqa: BLE001 - damaged: the library says where
        return []
    found.sort()
    joined: list[_Run] = []
    for run in found:
        last = joined[-1] if joined else _Run(0, 0, run.place)
        if run.begin != last.end:
            return []  # a piece is not stored, or not whole
        if joined and last.place + 8 * (last.end - last.begin) == run.place:
            joined[-1] = _Run(last.begin, run.end, last.place)
        else:
            joined.append(run)
    return joined
