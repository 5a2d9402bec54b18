"""The layout of a recording in HDF5: its datasets, and a writer that makes every block safe before it says so.

========== ================ =================================================================================
dataset    shape            contents
========== ================ =================================================================================
samples    (slots * rows, c) readings as the source gave them, float64; block i begins at row i * rows, where rows
                            is the number of rows of a chunk; what a short block leaves of its slot is NaN
blocks     (slots,)         tick of the block's first sample, its rows, its checksum, when it was written
gaps       (g,)             first tick that is missing, number of samples, kind, text
events     (e,)             tick, time, kind, text
channels   (c,)             name, unit and settings of each column
status     (1,)             state, reason, tick of time zero; written in place
time       (slots * rows,)  time of each row, only in files without ticks (see `write_columns`)
checksums  (slots, c)       checksum of each column of each block, only where columns are stored apart
========== ================ =================================================================================

A tick is the number of a sample on the clock of the source. The value of a channel in its unit is
``sign * (scale * reading + offset)``. The checksum is the CRC-32 of tick and rows as two little-endian 64-bit
integers, followed by the samples row by row; the attribute channels_crc32 is that of the table of channels.

A recorder writes a block at once, in one chunk. What is converted has a chunk for every column of a block, so that one
channel is read without the others: there tick and rows are followed by the block's row of checksums. The checksum of a
column is the CRC-32 of its samples in version 4, and of their sums in version 5: the samples as 64-bit integers stand
in a table of 256 columns, line by line, whose columns and lines are added up modulo 2^64, and the checksum is that of
the sums of the columns, followed by those of the lines, as little-endian integers. No change of up to three samples,
or within one line, leaves all sums as they were; adding up takes a third of the time of a CRC-32.
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
import struct
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.hdf5_closing import begin_file, take_mark_off
from aerobalance.io.hdf5_guard import LIBVER
from aerobalance.recording.channel import Array, SensorSpec
from aerobalance.recording.version import VERSION

if TYPE_CHECKING:
    import h5py

FORMAT: Final = "aerobalance recording"
SCHEMA: Final = 3
"""Version of the layout that a recorder writes; versions 1 and 2 have shorter tables of channels."""

BY_CHANNEL: Final = 4
"""Version of the layout from which on every channel of a block has a chunk and a checksum of its own."""

BY_SUMS: Final = 5
"""Version of the layout in which that checksum is of sums of the samples: what is written now of columns."""

BLOCK: Final = np.dtype([("tick", "<i8"), ("rows", "<i8"), ("crc32", "<u4"), ("written", "<f8")])
GAP: Final = np.dtype([("tick", "<i8"), ("samples", "<i8"), ("kind", "S16"), ("text", "S256")])
EVENT: Final = np.dtype([("tick", "<i8"), ("time", "<f8"), ("kind", "S16"), ("text", "S512")])
CHANNEL_1: Final = np.dtype(
    [
        ("name", "S64"),
        ("unit", "S32"),
        ("input", "S128"),
        ("sign", "<f8"),
        ("scale", "<f8"),
        ("offset", "<f8"),
        ("delay", "<f8"),
        ("noise", "<f8"),
        ("relative_uncertainty", "<f8"),
        ("coupling", "S16"),
        ("corner", "<f8"),
    ]
)
CHANNEL_2: Final = np.dtype(
    [
        *((name, CHANNEL_1[name]) for name in CHANNEL_1.names or ()),
        ("zero_uncertainty", "<f8"),
        ("filter", "S16"),
        ("filter_order", "<i8"),
        ("filter_corner", "<f8"),
        ("cross_axis", "S512"),
    ]
)
CHANNEL: Final = np.dtype([*((name, CHANNEL_2[name]) for name in CHANNEL_2.names or ()), ("mounting", "S256")])
CHANNELS: Final[Mapping[int, np.dtype[np.void]]] = {
    1: CHANNEL_1,
    2: CHANNEL_2,
    SCHEMA: CHANNEL,
    BY_CHANNEL: CHANNEL,
    BY_SUMS: CHANNEL,
}
"""Table of channels by version of the layout."""

_WIDTH: Final = 256
"""Columns of the table in which samples are added up."""

STATUS: Final = np.dtype([("state", "S16"), ("reason", "S512"), ("origin", "<i8"), ("ended", "<f8")])

FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers that mean that nothing more can be written to a file."""


class DiskFullError(Exception):
    """Nothing more can be written; every block before this one is safe."""


@dataclass(frozen=True, slots=True)
class StoredChannel(SensorSpec):
    """One column of the samples, and what is known of its sensor, in `unit`.

    Attributes
    ----------
    name
        The name that the program understands.
    unit
        Unit of ``sign * (scale * reading + offset)``.
    input
        Name of the channel at its source.
    sign, scale, offset
        How a reading becomes a value.
    """

    name: str
    unit: str
    input: str = field(default="", kw_only=True)
    sign: float = field(default=1.0, kw_only=True)
    scale: float = field(default=1.0, kw_only=True)
    offset: float = field(default=0.0, kw_only=True)

    def values(self, readings: Array) -> Array:
        """Turn readings into values in `unit`; readings that need no change come back as they are."""
        if (self.sign, self.scale, self.offset) == (1.0, 1.0, 0.0):
            return readings
        return self.sign * (self.scale * readings + self.offset)


class Provenance(NamedTuple):
    """Where a recording comes from.

    Attributes
    ----------
    source
        What gave the samples.
    setup
        Text of the test set-up, in TOML; an empty string where there was none.
    name
        What the test is called.
    """

    source: str
    setup: str = ""
    name: str = ""


def text_bytes(text: str, width: int) -> bytes:
    """Encode text in at most `width` bytes of UTF-8, cut between characters."""
    return text.encode("utf-8", "replace")[:width].decode("utf-8", "ignore").encode("utf-8")


def status_row(state: str, reason: str = "") -> NDArray[np.void]:
    """Make the table of the state, shape (1,)."""
    ended = time.time() if state == "ended" else 0.0
    return np.array([(state.encode(), text_bytes(reason, 512), 0, ended)], dtype=STATUS)


def checksum(tick: int, samples: Array) -> int:
    """Return the CRC-32 of a block: its tick and rows, then its samples, shape (n, c)."""
    head = zlib.crc32(struct.pack("<qq", tick, samples.shape[0]))
    return zlib.crc32(np.ascontiguousarray(samples, dtype="<f8").data, head)


def checksums_of_sums(samples: Array) -> NDArray[np.uint32]:
    """Return the checksum of each of some columns in layout `BY_SUMS`, shape (k,).

    Parameters
    ----------
    samples
        Float64, little-endian, shape (k, n), each column in one piece.
    """
    words = samples.view("<u8")
    whole = words.shape[1] - words.shape[1] % _WIDTH
    table = words[:, :whole].reshape(len(words), whole // _WIDTH, _WIDTH)
    rest = words[:, whole:]
    sums = np.zeros((len(words), _WIDTH + table.shape[1] + 1), dtype="<u8")
    np.add.reduce(table, axis=1, out=sums[:, :_WIDTH])
    np.add.reduce(table, axis=2, out=sums[:, _WIDTH:-1])
    sums[:, : rest.shape[1]] += rest
    np.add.reduce(rest, axis=1, out=sums[:, -1])
    used = sums if rest.size else sums[:, :-1]
    return np.array([zlib.crc32(one.data) for one in used], dtype=np.uint32)


def checksum_of_checksums(tick: int, rows: int, channels: NDArray[np.uint32]) -> int:
    """Return the CRC-32 of a block of which every channel has its own: its tick and rows, then these, shape (c,)."""
    return zlib.crc32(channels.astype("<u4").tobytes(), zlib.crc32(struct.pack("<qq", tick, rows)))


def lay_out(
    file: h5py.File,
    channels: Sequence[StoredChannel],
    *,
    rate: float,
    rows: int,
    provenance: Provenance,
    time_unit: str = "",
    by_channel: bool = False,
) -> None:
    """Make the datasets of a recording without samples.

    Parameters
    ----------
    file
        An empty file.
    channels
        The columns of the samples.
    rate
        Sampling rate [Hz]; NaN where a time column is written.
    rows
        Largest number of rows of a block; a chunk of the file has as many.
    provenance
        Where the samples come from.
    time_unit
        Unit of the time stamps, where every row has one of its own instead of a tick.
    by_channel
        Whether every channel of a block has a chunk and a checksum of its own.
    """
    table, columns = _channel_table(channels), len(channels)
    file.attrs.update(
        {
            "format": FORMAT,
            "schema_version": BY_SUMS if by_channel else SCHEMA,
            "program": f"aerobalance {VERSION}",
            "rate": rate,
            "name": provenance.name,
            "source": provenance.source,
            "started": time.time(),
            "channels_crc32": zlib.crc32(table.tobytes()),
        }
    )
    # A dataset, as an attribute takes no more than 64 KiB.
    setup = provenance.setup.encode("utf-8") or b"\n"
    file.create_dataset("setup", data=np.frombuffer(setup, dtype="u1"))
    file.create_dataset("channels", data=table)
    growing = {"dtype": "<f8", "fillvalue": np.nan}
    chunk = (rows, 1 if by_channel else columns)
    file.create_dataset("samples", (0, columns), maxshape=(None, columns), chunks=chunk, **growing)
    if by_channel:
        file.create_dataset("checksums", (0, columns), "<u4", maxshape=(None, columns), chunks=(256, columns))
    if time_unit:
        file.create_dataset("time", (0,), maxshape=(None,), chunks=(rows,), **growing)
        file["time"].attrs["unit"] = time_unit
    for name, kind, length in (("blocks", BLOCK, 256), ("gaps", GAP, 16), ("events", EVENT, 16)):
        file.create_dataset(name, (0,), kind, maxshape=(None,), chunks=(length,))
    file.create_dataset("status", data=status_row("recording"))


class BlockWriter:
    """Writes a recording block by block; each is on the disk when its call returns.

    Parameters
    ----------
    path
        The file, which must not exist yet.
    channels
        The columns of the samples.
    rate
        Sampling rate [Hz].
    rows
        Largest number of rows of a block; a chunk of the file has as many.
    provenance
        Where the samples come from.

    Raises
    ------
    OSError
        The file exists, or cannot be written; nothing is left of it.
    """

    def __init__(
        self,
        path: Path,
        channels: Sequence[StoredChannel],
        *,
        rate: float,
        rows: int,
        provenance: Provenance,
    ) -> None:
        import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

        self.path, self.rows, self.columns = path, rows, len(channels)
        self.blocks = self.samples = 0
        self._counts = {"gaps": 0, "events": 0}
        image = io.BytesIO()
        with h5py.File(image, "w", libver=LIBVER) as empty:
            lay_out(empty, channels, rate=rate, rows=rows, provenance=provenance)
        self._handle = begin_file(path, image.getvalue())
        # The lock is this writer's own (see `hdf5_closing`), and the library must not take it for another's.
        self._file: h5py.File = h5py.File(path, "r+", libver=LIBVER, locking=False)
        self._samples = self._file["samples"]
        self._tables = {name: self._file[name] for name in ("blocks", "gaps", "events")}
        self._status = self._file["status"]
        self._state = self._status[...]
        self._place = self._status.id.get_offset()
        self._file.swmr_mode = True
        os.fsync(self._handle)

    def append(self, tick: int, samples: Array) -> int:
        """Write a block and return its number; it is safe then.

        Parameters
        ----------
        tick
            Number of its first sample on the clock of the source.
        samples
            Readings, shape (n, c), n at most `rows`.

        Raises
        ------
        DiskFullError
            The file can take no more. The writer is then of no more use but for `abandon`.
        """
        number, n = self.blocks, samples.shape[0]
        first = number * self.rows
        try:
            self._samples.resize((first + n, self.columns))
            self._samples[first : first + n] = samples
            self._samples.flush()
            self._row("blocks", number, (tick, n, checksum(tick, samples), time.time()))
            os.fsync(self._handle)
        except (OSError, RuntimeError) as error:
            raise disk_full(error) from error
        self.blocks += 1
        self.samples += n
        return number

    def gap(self, tick: int, samples: int, *, kind: str, text: str) -> None:
        """Note that `samples` samples from `tick` on are missing."""
        self._note("gaps", (tick, samples, text_bytes(kind, 16), text_bytes(text, 256)))

    def event(self, tick: int, *, kind: str, text: str) -> None:
        """Note what happened at a tick."""
        self._note("events", (tick, time.time(), text_bytes(kind, 16), text_bytes(text, 512)))

    def origin(self, tick: int) -> None:
        """Set the tick at which time is zero."""
        self._state["origin"] = tick
        self._write_state()

    def finish(self, reason: str) -> None:
        """Say why the record ended and close the file.

        Raises
        ------
        DiskFullError
            The file can take no more; `abandon` is left.
        """
        self._ended(reason)
        try:
            self._write_state()
            self._file.close()
            os.close(self._handle)
        except (OSError, RuntimeError) as error:
            raise disk_full(error) from error

    def abandon(self, reason: str) -> None:
        """Say why the record ended where nothing more can be allocated; the file is left as its last block left it.

        The library still holds what it could not write and would fail to close the file, so the status is written in
        its place past the library, and the mark of a file that is written to is taken off. The process should end
        soon, by `os._exit`.
        """
        self._ended(reason)
        os.pwrite(self._handle, self._state.tobytes(), self._place)
        take_mark_off(self._handle)

    def _ended(self, reason: str) -> None:
        origin = self._state["origin"].copy()
        self._state = status_row("ended", reason)
        self._state["origin"] = origin

    def _write_state(self) -> None:
        self._status[...] = self._state
        self._status.flush()

    def _note(self, table: str, row: tuple[Any, ...]) -> None:
        try:
            self._row(table, self._counts[table], row)
        except (OSError, RuntimeError) as error:
            raise disk_full(error) from error
        self._counts[table] += 1

    def _row(self, table: str, number: int, row: tuple[Any, ...]) -> None:
        dataset = self._tables[table]
        dataset.resize((number + 1,))
        dataset[number] = np.array(row, dtype=dataset.dtype)
        dataset.flush()


def disk_full(error: Exception) -> DiskFullError:
    """Tell a full disk from other faults: the library hides the error number in its text."""
    text = str(error).lower()
    known = getattr(error, "errno", None) in FULL or any(f"errno = {number}," in text for number in FULL)
    if known or "no space left" in text or "file too large" in text or "quota exceeded" in text:
        return DiskFullError("the disk, its quota or the largest size of a file is used up")
    return DiskFullError(f"the file can no longer be written: {plain_reason(error)}")


def plain_reason(error: Exception) -> str:
    """Return in the system's words why a file could not be made or written; the library hides the error number."""
    number = getattr(error, "errno", None)
    found = re.search(r"errno = (\d+)", str(error))
    if not isinstance(number, int) and found:
        number = int(found[1])
    if number == errno.EEXIST:
        return "it is there already, made by another program just now; give another name"
    if isinstance(number, int) and number > 0:
        return os.strerror(number).lower()
    return "it is locked, damaged, or of no use to the HDF5 library"


def _cross_axis_text(channel: StoredChannel) -> bytes:
    """Sensitivity and standard uncertainty by channel, as JSON; an empty string where there are none."""
    parts = {part.channel: [part.sensitivity, part.uncertainty] for part in channel.cross_axis}
    text = json.dumps(parts).encode() if parts else b""
    if len(text) > CHANNEL["cross_axis"].itemsize:
        raise ValueError(f"channel {channel.name}: {len(parts)} cross-axis sensitivities are more than HDF5 can hold")
    return text


def _mounting_text(channel: StoredChannel) -> bytes:
    """Place, axis and the place's uncertainty, as JSON; an empty string where there are none."""
    parts = {"place": channel.place, "axis": channel.axis, "place_uncertainty": channel.place_uncertainty}
    given = {name: part for name, part in parts.items() if part}
    return json.dumps(given).encode() if given else b""


def _channel_table(channels: Sequence[StoredChannel]) -> Any:
    rows = [
        (
            text_bytes(channel.name, 64),
            text_bytes(channel.unit, 32),
            text_bytes(channel.input, 128),
            channel.sign,
            channel.scale,
            channel.offset,
            channel.delay,
            np.nan if channel.noise is None else channel.noise,
            channel.relative_uncertainty,
            channel.coupling.encode(),
            channel.corner,
            channel.zero_uncertainty,
            b"" if channel.filter is None else channel.filter.kind.encode(),
            0 if channel.filter is None else channel.filter.order,
            0.0 if channel.filter is None else channel.filter.corner,
            _cross_axis_text(channel),
            _mounting_text(channel),
        )
        for channel in channels
    ]
    return np.array(rows, dtype=CHANNEL)
