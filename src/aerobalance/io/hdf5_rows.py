"""Rows written to a recording in HDF5 as they come, with their time column (see `aerobalance.io.hdf5_layout`)."""

from __future__ import annotations

import contextlib
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from aerobalance.io.columns import Append, split_label, time_label
from aerobalance.io.hdf5_guard import LIBVER, GuardedFile
from aerobalance.io.hdf5_layout import (
    BLOCK,
    CHANNEL,
    DiskFullError,
    Provenance,
    StoredChannel,
    checksum,
    disk_full,
    lay_out,
    status_row,
)
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array

if TYPE_CHECKING:
    import h5py

CONVERTED: Final = "converted"
"""Why a recording ended that was made from another file."""

ROWS: Final = 8192
"""Rows of a block of a file that is written from columns."""


@contextlib.contextmanager
def appending(
    path: Path,
    labels: Sequence[str],
    described: Mapping[str, StoredChannel] | None = None,
    *,
    epoch: np.datetime64 | None = None,
    rows: int = ROWS,
) -> Iterator[Append]:
    """Write columns that come some rows at a time; the file takes its place when all are written.

    Missing samples are NaN, numbers read back exactly.

    Parameters
    ----------
    path
        The file.
    labels
        The headers ``name [unit]``; one of them is ``time [s]`` or in another unit of time.
    described
        What is known of the columns, by header.
    epoch
        Date and time at which the time is zero; None where it is not known.
    rows
        Rows that there will be, nearly; a block of the file has as many, and `ROWS` at most.

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
                    lay_out(file, channels, rate=float("nan"), rows=rows, provenance=provenance, time_unit=unit)
                    if epoch is not None:
                        file["status"].attrs["epoch"] = str(epoch)
                    writer = _Rows(file, disk, channels, rows)
                    yield writer.append
                    writer.finish()
            except OSError as error:
                raise disk_full(error) from error
    except DiskFullError as problem:
        raise ValueError(f"cannot write {path}: {problem}") from problem


@dataclass(slots=True)
class _Rows:
    """Writes rows to an open file, block by block."""

    file: h5py.File
    disk: GuardedFile
    channels: tuple[StoredChannel, ...]
    rows: int
    _waiting: list[Array] = field(default_factory=list)
    _blocks: list[tuple[int, int, int, float]] = field(default_factory=list)
    _written: int = 0

    def append(self, columns: Mapping[str, Array]) -> None:
        """Take the next rows; whole blocks are written."""
        if self.disk.failure is not None:
            raise self.disk.failure
        stamps = next(values for label, values in columns.items() if split_label(label)[0] == "time")
        table = np.column_stack([stamps, *(columns[one.input] for one in self.channels)])
        self._waiting.append(table)
        if sum(len(part) for part in self._waiting) >= self.rows:
            whole = np.concatenate(self._waiting)
            cut = whole.shape[0] - whole.shape[0] % self.rows
            self._write(whole[:cut])
            self._waiting = [whole[cut:]]

    def finish(self) -> None:
        """Write what is left, and that the record has ended."""
        if self._waiting:
            self._write(np.concatenate(self._waiting))
        if self.disk.failure is not None:
            return
        blocks = np.array(self._blocks, dtype=BLOCK)
        self.file["blocks"].resize(blocks.shape)
        self.file["blocks"][...] = blocks
        self.file["status"][...] = status_row("ended", CONVERTED)

    def _write(self, table: Array) -> None:
        n = self._written + table.shape[0]
        self.file["samples"].resize((n, len(self.channels)))
        self.file["time"].resize((n,))
        for first in range(0, table.shape[0], self.rows):
            part = table[first : first + self.rows]
            values = np.where(np.isfinite(part[:, 1:]), part[:, 1:], np.nan)
            place = slice(self._written, self._written + part.shape[0])
            self.file["samples"][place], self.file["time"][place] = values, part[:, 0]
            self._blocks.append((place.start, part.shape[0], checksum(place.start, values), clock.time()))
            self._written = place.stop
            self.file.flush()
            if self.disk.failure is not None:
                return


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
            raise ValueError(f"cannot write {path}: the column {label!r} has too long a name for HDF5 (60 letters)")
        known = (described or {}).get(label, StoredChannel(name=name, unit=unit))
        channels.append(replace(known, name=name, unit=unit, input=label))
    return tuple(channels), split[time][1]
