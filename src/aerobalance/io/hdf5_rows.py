"""Columns written to a recording in HDF5, some rows at a time (see `aerobalance.io.hdf5_layout` for the format)."""

from __future__ import annotations

import contextlib
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.columns import Append, split_label, time_label
from aerobalance.io.hdf5_guard import LIBVER, GuardedFile
from aerobalance.io.hdf5_layout import (
    BLOCK,
    CHANNEL,
    DiskFullError,
    Provenance,
    StoredChannel,
    checksum_of_checksums,
    checksums_of_sums,
    disk_full,
    lay_out,
    status_row,
)
from aerobalance.io.measure import rows_within_measure
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array

if TYPE_CHECKING:
    import h5py

CONVERTED: Final = "converted"
"""Reason for the end of a recording that was converted from another file."""

ROWS: Final = 8192
"""Largest number of rows of a block in such a file."""


@contextlib.contextmanager
def appending(
    path: Path,
    labels: Sequence[str],
    described: Mapping[str, StoredChannel] | None = None,
    *,
    epoch: np.datetime64 | None = None,
    rows: int = ROWS,
) -> Iterator[Append]:
    """Write columns some rows at a time; the file appears under its name when all are written.

    Numbers are stored exactly; samples that are not finite are stored as NaN, which means missing.

    Parameters
    ----------
    path
        The file.
    labels
        The headers ``name [unit]``; one of them is ``time [s]`` or in another unit of time.
    described
        Metadata of the columns, by header.
    epoch
        Date and time at which the time is zero; None where it is not known.
    rows
        Expected number of rows, which need not be exact; it is the size of a block, up to `ROWS`.

    Yields
    ------
    Append
        Takes the next rows of all columns, by header.

    Raises
    ------
    ValueError
        A name or unit is too long, or the file cannot be written.
    """
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    channels, unit = _stored(path, labels, described)
    rows = max(1, min(rows, ROWS))
    try:
        with replacing(path) as beside:
            try:
                with GuardedFile(beside) as disk, h5py.File(disk, "w", libver=LIBVER) as file:
                    provenance = Provenance(f"converted; time column time [{unit}]")
                    nan = float("nan")
                    lay_out(
                        file, channels, rate=nan, rows=rows, provenance=provenance, time_unit=unit, by_channel=True
                    )
                    if epoch is not None:
                        file["status"].attrs["epoch"] = str(epoch)
                    writer = _Rows(file, disk, channels, rows)
                    yield writer.append
                    writer.finish()
            except OSError as error:
                raise disk_full(error) from error
    except DiskFullError as problem:
        raise ValueError(f"cannot write {path}: {problem}") from problem


class _Rows:
    """Writes rows to an open file, block by block, every channel as a chunk of its own."""

    def __init__(self, file: h5py.File, disk: GuardedFile, channels: tuple[StoredChannel, ...], rows: int) -> None:
        self._file, self._disk, self._channels, self._rows = file, disk, channels, rows
        self._samples, self._time = file["samples"], file["time"]
        self._table, self._stamps = np.empty((len(channels), rows), dtype="<f8"), np.empty(rows, dtype="<f8")
        self._filled = self._written = 0
        self._blocks: list[tuple[int, int, int, float]] = []
        self._checksums: list[NDArray[np.uint32]] = []

    def append(self, columns: Mapping[str, Array]) -> None:
        """Take the next rows; complete blocks are written, the rest is kept."""
        if self._disk.failure is not None:
            raise self._disk.failure
        stamps = next(values for label, values in columns.items() if split_label(label)[0] == "time")
        given = [columns[one.input] for one in self._channels]
        ready = self._filled + stamps.size
        self._grow(self._written + ready - ready % self._rows)
        at = 0
        while at < stamps.size and self._disk.failure is None:
            count = min(self._rows - self._filled, stamps.size - at)
            part, own = slice(at, at + count), slice(self._filled, self._filled + count)
            self._stamps[own] = stamps[part]
            for column, values in enumerate(given):
                self._table[column, own] = values[part]
            at, self._filled = part.stop, own.stop
            if self._filled == self._rows:
                self._write()
        self._file.flush()

    def finish(self) -> None:
        """Write the rows that are left, the index of the blocks, and the status that the record has ended."""
        if self._filled:
            self._grow(self._written + self._filled)
            self._write()
        if self._disk.failure is not None:
            return  # raised when the guarded file is closed
        blocks = np.array(self._blocks, dtype=BLOCK)
        self._file["blocks"].resize(blocks.shape)
        self._file["blocks"][...] = blocks
        checksums = np.array(self._checksums, dtype="<u4").reshape(len(blocks), len(self._channels))
        self._file["checksums"].resize(checksums.shape)
        self._file["checksums"][...] = checksums
        self._file["status"][...] = status_row("ended", CONVERTED)

    def _grow(self, rows: int) -> None:
        if rows > self._samples.shape[0]:
            self._samples.resize((rows, len(self._channels)))
            self._time.resize((rows,))

    def _write(self) -> None:
        """Write the rows that were collected as a block, with its checksums."""
        rows, first = self._filled, self._written
        samples = self._table[:, :rows]
        if not rows_within_measure(samples):
            samples[~np.isfinite(samples)] = np.nan
        # a chunk is whole; the file ends in the middle of the last
        self._table[:, rows:] = self._stamps[rows:] = np.nan
        own = checksums_of_sums(samples)
        chunks = self._samples.id
        for column, values in enumerate(self._table):
            # past the selections of the library, which take longer
            chunks.write_direct_chunk((first, column), values.data)
        self._time.id.write_direct_chunk((first,), self._stamps.data)
        self._checksums.append(own)
        self._blocks.append((first, rows, checksum_of_checksums(first, rows, own), clock.time()))
        self._filled, self._written = 0, first + rows


def _stored(
    path: Path, labels: Sequence[str], described: Mapping[str, StoredChannel] | None
) -> tuple[tuple[StoredChannel, ...], str]:
    """Return the channels of columns by their headers, and the unit of the time."""
    split = {label: split_label(label) for label in labels}
    time = time_label(path, labels, "a recording in HDF5")
    others = [label for label in labels if label != time]
    channels = []
    for label in others:
        name, unit = split[label]
        if len(name.encode()) > CHANNEL["name"].itemsize or len(unit.encode()) > CHANNEL["unit"].itemsize:
            raise ValueError(f"cannot write {path}: the name or the unit of the column {label!r} is too long for HDF5")
        known = (described or {}).get(label, StoredChannel(name=name, unit=unit))
        channels.append(replace(known, name=name, unit=unit, input=label))
    return tuple(channels), split[time][1]
