"""Recordings in HDF5, as the recorder writes them (see `aerobalance.io.hdf5_layout`), whole or broken off."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.columns import Clock, Heading, RawColumn, RawColumns
from aerobalance.io.hdf5_closing import SIGNATURE
from aerobalance.io.hdf5_contents import Contents, contents, contents_of, opened
from aerobalance.io.hdf5_direct import Filling, places_of_pieces
from aerobalance.io.hdf5_layout import StoredChannel, checksum, checksum_of_checksums, checksums_of_sums
from aerobalance.io.hdf5_rows import appending
from aerobalance.io.measure import beyond_all_measure, rows_within_measure, take_out
from aerobalance.io.series import Fills
from aerobalance.io.text_layout import Layout
from aerobalance.recording.channel import Array, SensorSpec
from aerobalance.recording.errors import ReadError, warn_quality

if TYPE_CHECKING:
    import h5py

NAME: Final = "HDF5 recording"
"""What to call the format in messages."""

SUFFIXES: Final[Mapping[str, str]] = {".h5": "", ".hdf5": ""}
"""File name endings that are written in this format."""

KEEPS_SENSORS: Final = True
KEEPS_EPOCH: Final = True

LARGEST_GAP: Final = 20
"""Samples of the clock per sample of the file beyond which the recording has to be cut at its gaps."""

_CONTACTS: Final = 5  # contacts that are listed


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is HDF5, from its first bytes; its name does not matter."""
    del path
    return head.startswith(SIGNATURE)


def read_blocks(path: Path | str) -> Iterator[tuple[int, Array | None]]:
    """Read a recording block by block, so that it may be larger than the memory.

    Yields
    ------
    tuple
        Tick of the first sample, and readings as the source gave them, shape (n, c); None instead of them where they
        do not agree with their checksum.

    Raises
    ------
    ReadError
        The file is no recording, or damaged.
    """
    file = Path(path)
    with opened(file) as inside:
        found = contents_of(file, inside)
        blocks = Blocks(inside, found)
        for number, tick in enumerate(found.blocks["tick"].tolist()):
            yield tick, blocks.whole(number)


def headings(path: Path) -> tuple[Heading, ...]:
    """Read what the file says of its channels."""
    found = contents(path)
    samples = int(found.blocks["rows"].sum())
    note = f"{samples} samples" if found.timed else f"{found.rate:.9g} Hz, {samples} samples"
    unit = found.time_unit
    time = (Heading(f"time [{unit}]", "time", unit, 1, note),) if found.timed else ()
    return time + tuple(
        Heading(
            f"{channel.name} [{channel.unit}]",
            channel.name,
            channel.unit,
            number + len(time) + 1,
            note,
            clocked=not found.timed,
        )
        for number, channel in enumerate(found.channels)
    )


def read_columns(path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None) -> RawColumns:
    """Read the channels of a recording in their units, on its clock.

    Samples that were lost (gaps), and blocks that do not agree with their checksums, are missing on the clock. A file
    that is still written to, or whose recorder was killed, is read up to its last complete block.

    Parameters
    ----------
    path
        The file.
    layout
        For text files only.
    wanted
        Channels that a channel map names, by label, name or number; only these are kept in memory. None for all.

    Raises
    ------
    ReadError
        The file is damaged or no recording, holds no sample, or has gaps out of all proportion.

    Warns
    -----
    DataQualityWarning
        A block is damaged and left out, the record was broken off, or model and support touched.
    """
    del layout
    with opened(path) as file:
        found = contents_of(path, file)
        remarks: list[str] = []
        labels = _numbers(path, found, wanted)
        ticks, readings, stamps = _samples(path, file, found, labels, remarks)
    for text in (*remarks, *remarks_on(found)):
        warn_quality(f"{path.name}: {text}")
    columns = [raw_column(found.channels[i], readings[k], i + found.timed) for k, i in enumerate(labels)]
    if found.timed:
        time = RawColumn(f"time [{found.time_unit}]", "time", found.time_unit, stamps, 1)
        return RawColumns(path, (time, *columns), range(1, stamps.size + 1), epoch=found.epoch)
    start = (int(ticks[0]) - found.origin) / found.rate
    ticks = ticks - ticks[0]
    if int(ticks[-1]) + 1 == ticks.size:
        ticks_missing = None
    elif wanted is None:
        ticks_missing = ticks.astype(np.intp)
    else:
        columns = [_spread(column, ticks) for column in columns]
        ticks_missing = None
    if wanted is not None:
        clock = Clock(start, 1 / found.rate)
        columns = [replace(column, clock=clock) for column in columns]
        return RawColumns(path, tuple(columns), range(1, columns[0].values.size + 1), epoch=found.epoch)
    lines = range(1, ticks.size + 1)
    return RawColumns(
        path, tuple(columns), lines, rate=found.rate, start=start, ticks=ticks_missing, epoch=found.epoch
    )


def remarks_on(found: Contents) -> list[str]:
    """What there is to say of a whole record: that it was broken off, and when model and support touched."""
    touched = _contact_remark(found.events, rate=found.rate, origin=found.origin)
    return [*([] if found.state == "ended" else [_not_ended(found)]), *([touched] if touched else [])]


def _not_ended(found: Contents) -> str:
    text = "the record was not ended (it is still written to, or broken off); its complete blocks are used"
    if not found.marked:
        return text
    return (
        f"{text}. Other HDF5 programs refuse it until it is closed: after a kill the next `aerobalance record` or "
        "`aerobalance monitor` in its folder does so, and `h5clear -s -i 0 FILE` does"
    )


class Blocks:
    """Reads the blocks of an open file.

    Parameters
    ----------
    file, found
        The file, and what it says of itself.
    """

    def __init__(self, file: h5py.File, found: Contents) -> None:
        self._data, self._found = file["samples"], found
        self._length = self._data.shape[0]
        self._handle = -1
        self._places: NDArray[np.int64] | None = None
        self._located = found.checksums is None

    def whole(self, number: int) -> Array | None:
        """Read all channels of a block, shape (n, c); None where it does not agree with its checksum."""
        if self._found.checksums is not None:
            apart = self.channels(number, range(len(self._found.channels)))
            return None if apart is None else apart.T
        tick, rows, crc = (int(self._found.blocks[number][key]) for key in ("tick", "rows", "crc32"))
        first = number * self._found.slot
        samples = np.asarray(self._data[first : first + rows], dtype=np.float64)
        return samples if samples.shape[0] == rows and checksum(tick, samples) == crc else None

    def channels(self, number: int, columns: Sequence[int], into: Array | None = None) -> Array | None:
        """Read some channels of a block, shape (k, n); None where these do not agree with their checksums.

        Of a file in which channels are stored apart no others are read.

        Parameters
        ----------
        number
            The block.
        columns
            The channels.
        into
            Where to, shape (k, n); anew if left out.
        """
        tick, rows, crc = self._found.blocks[number][["tick", "rows", "crc32"]].item()
        samples = np.empty((len(columns), rows)) if into is None else into
        if self._found.checksums is None:
            block = self.whole(number)
            if block is not None:
                for values, column in zip(samples, columns, strict=True):
                    values[:] = block[:, column]
            return None if block is None else samples
        stated = self._found.checksums[number]
        if number * self._found.slot + rows > self._length or checksum_of_checksums(tick, rows, stated) != crc:
            return None
        own = stated[columns]
        if self._read_together(number, columns, samples) and self._agree(samples, own):
            return samples
        self._read_apart(number, columns, samples)
        return samples if self._agree(samples, own) else None

    def _agree(self, samples: Array, own: NDArray[np.uint32]) -> bool:
        """Whether channels agree with their checksums."""
        if self._found.by_sums:
            return bool((checksums_of_sums(samples) == own).all())
        return all(zlib.crc32(values.data) == one for values, one in zip(samples, own.tolist(), strict=True))

    def _read_together(self, number: int, columns: Sequence[int], samples: Array) -> bool:
        """Read channels that stand one behind the other in the file at once; whether it could be done."""
        if samples.shape[1] < self._found.slot or 2 * len(columns) < len(self._found.channels):
            return False  # where each piece stands takes some time to find out
        if not self._located:
            self._places = places_of_pieces(self._data, len(self._found.blocks))
            self._handle = int(self._data.file.id.get_vfd_handle()) if self._places is not None else -1
            self._located = True  # last, as another thread may read meanwhile
        if self._places is None:
            return False
        size = samples.itemsize * self._found.slot
        places = self._places[number, columns]
        if places[0] < 0 or (np.diff(places) != size).any():
            return False
        return os.preadv(self._handle, list(samples), int(places[0])) == size * len(columns)

    def _read_apart(self, number: int, columns: Sequence[int], samples: Array) -> None:
        """Read channels one by one, by the library."""
        first, rows = number * self._found.slot, samples.shape[1]
        whole = np.empty(self._found.slot if rows < self._found.slot else 0)
        for values, column in zip(samples, columns, strict=True):
            # past the selections of the library, which take several times as long as the reading
            into_chunk = whole if whole.size else values
            self._data.id.read_direct_chunk((first, column), out=into_chunk.view("u1"))
            if whole.size:
                values[:] = whole[:rows]


def _numbers(path: Path, found: Contents, wanted: Sequence[str | int] | None) -> list[int]:
    """Columns to read."""
    if wanted is None:
        return list(range(len(found.channels)))
    bare = [
        RawColumn(f"{channel.name} [{channel.unit}]", channel.name, channel.unit, np.empty(0), i + found.timed + 1)
        for i, channel in enumerate(found.channels)
    ]
    if found.timed:
        bare.insert(0, RawColumn(f"time [{found.time_unit}]", "time", found.time_unit, np.empty(0), 1))
    stub = RawColumns(path, tuple(bare), range(0))
    chosen = {stub.find(key, where="channels").number - found.timed - 1 for key in wanted}
    return sorted(chosen - {-1})


def _samples(
    path: Path, file: h5py.File, found: Contents, columns: list[int], remarks: list[str]
) -> tuple[NDArray[np.int64], Array, Array]:
    """Read the blocks that agree with their checksums: ticks (n,), readings (k, n), time stamps (n,).

    Of a file with time stamps the ticks may be left out.
    """
    total = int(found.blocks["rows"].sum())
    if total < 2:
        raise ReadError(
            path, "", f"is a recording of {total} sample(s) ({found.reason or 'not ended'}); two are needed"
        )
    readings = np.empty((len(columns), total))
    stamps = np.empty(total if found.timed else 0)
    blocks, fill = Blocks(file, found), stamps_of(file, found)
    taken, filled, within = [], 0, True
    for number, (tick, rows) in enumerate(found.blocks[["tick", "rows"]].tolist()):
        part = slice(filled, filled + rows)
        if blocks.channels(number, columns, readings[:, part]) is None:
            remarks.append(
                f"block {number + 1} of {len(found.blocks)} ({rows} samples from tick {tick}) does not agree with its "
                "checksum: it is left out, and its samples count as missing"
            )
            continue
        within = within and rows_within_measure(readings[:, part])  # while they are in the cache
        if fill is not None:
            fill(number * found.slot, stamps[part])
        taken.append((tick, rows))
        filled += rows
    if filled < 2:
        raise ReadError(path, "blocks", "has no two samples that agree with their checksums: the file is damaged")
    first, last = taken[0][0], sum(taken[-1]) - 1
    if not found.timed and last - first > LARGEST_GAP * filled:
        raise ReadError(path, "gaps", "has gaps of more than 20 times its samples; use the part before or after them")
    readings = readings[:, :filled]
    ticks = np.empty(0, dtype=np.int64)
    if not within or not found.timed:
        ticks = np.concatenate([np.arange(tick, tick + rows) for tick, rows in taken])
    if not within:
        found_large = enumerate(map(take_out, readings))
        large = [(ticks[places[0]], columns[row], places.size) for row, places in found_large if places.size]
        if large:
            tick, column, _ = min(large)
            where = f"{found.channels[column].name} at tick {tick}"
            remarks.append(beyond_all_measure(sum(size for *_, size in large), where))
    return ticks, readings, stamps[:filled]


def stamps_of(file: h5py.File, found: Contents) -> Fills | None:
    """Return what reads the time stamps of an open file into an array; None where it has none."""
    if not found.timed:
        return None
    time = file["time"]
    return Filling(time, lambda begin, end: np.asarray(time[begin:end], dtype=np.float64))


def raw_column(channel: StoredChannel, readings: Array, number: int) -> RawColumn:
    """Return a column of readings in its unit."""
    return RawColumn(
        f"{channel.name} [{channel.unit}]",
        channel.name,
        channel.unit,
        channel.values(readings),
        number + 1,
        alias=channel.input,
        sensor=SensorSpec(**channel.known()),
    )


def _spread(column: RawColumn, ticks: NDArray[np.int64]) -> RawColumn:
    """Put a column on the steady clock, NaN where samples are missing."""
    values = np.full(int(ticks[-1]) + 1, np.nan)
    values[ticks] = column.values
    return replace(column, values=values)


def _contact_remark(events: NDArray[np.void], *, rate: float, origin: int) -> str | None:
    """Return when model and support touched; None where they did not.

    Parameters
    ----------
    events
        Table of the events: tick, kind and more.
    rate
        Ticks a second.
    origin
        Tick at which time is zero.
    """
    spans: list[list[str]] = []
    for tick, kind in zip(events["tick"], events["kind"], strict=True):
        name = bytes(kind).rstrip(b"\0")
        if name == b"contact":
            spans.append([f"{(int(tick) - origin) / rate:.4g}", "the end"])
        elif name == b"contact over" and spans:
            spans[-1][1] = f"{(int(tick) - origin) / rate:.4g} s"
    if not spans:
        return None
    listed = ", ".join(f"{begin} s to {end}" for begin, end in spans[:_CONTACTS])
    more = f" and {len(spans) - _CONTACTS} more" if len(spans) > _CONTACTS else ""
    return f"model and support touched ({listed}{more}): the loads read then carry the force of the contact"


__all__ = [
    "KEEPS_EPOCH",
    "KEEPS_SENSORS",
    "LARGEST_GAP",
    "NAME",
    "SUFFIXES",
    "Blocks",
    "appending",
    "can_read",
    "headings",
    "raw_column",
    "read_blocks",
    "read_columns",
    "remarks_on",
    "stamps_of",
]
