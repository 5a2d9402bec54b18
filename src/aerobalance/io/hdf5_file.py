"""Recordings in HDF5, as the recorder writes them (see `aerobalance.io.hdf5_layout`), whole or broken off."""

from __future__ import annotations

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
from aerobalance.io.hdf5_layout import StoredChannel, checksum, checksum_of_checksums
from aerobalance.io.hdf5_rows import appending
from aerobalance.io.measure import beyond_all_measure, take_out
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
        data = inside["samples"]
        for number, block in enumerate(found.blocks):
            yield int(block["tick"]), read_block(data, found, number)


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
        return RawColumns(path, (time, *columns), range(1, ticks.size + 1), epoch=found.epoch)
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


def read_block(data: h5py.Dataset, found: Contents, number: int) -> Array | None:
    """Read one block of the samples of a file, shape (n, c); None where it does not agree with its checksum."""
    if found.checksums is not None:
        apart = read_channels(data, found, number, range(len(found.channels)))
        return None if apart is None else apart.T
    tick, rows, crc = (int(found.blocks[number][key]) for key in ("tick", "rows", "crc32"))
    first = number * found.slot
    samples = np.asarray(data[first : first + rows], dtype=np.float64)
    return samples if samples.shape[0] == rows and checksum(tick, samples) == crc else None


def read_channels(
    data: h5py.Dataset, found: Contents, number: int, columns: Sequence[int], into: Array | None = None
) -> Array | None:
    """Read some channels of one block, shape (k, n); None where these do not agree with their checksums.

    Of a file in which channels are stored apart no others are read.

    Parameters
    ----------
    data, found
        The samples of a file, and what it says of itself.
    number
        The block.
    columns
        The channels.
    into
        Where to, shape (k, n); anew if left out.
    """
    rows = int(found.blocks[number]["rows"])
    samples = np.empty((len(columns), rows)) if into is None else into
    if found.checksums is None:
        block = read_block(data, found, number)
        if block is not None:
            for own, column in zip(samples, columns, strict=True):
                own[:] = block[:, column]
        return None if block is None else samples
    own = found.checksums[number]
    tick, crc = (int(found.blocks[number][key]) for key in ("tick", "crc32"))
    first = number * found.slot
    if first + rows > data.shape[0] or checksum_of_checksums(tick, rows, own) != crc:
        return None
    whole = np.empty(found.slot if rows < found.slot else 0)
    for values, column in zip(samples, columns, strict=True):
        # past the selections of the library, which take several times as long as the reading
        into_chunk = whole if whole.size else values
        data.id.read_direct_chunk((first, column), out=into_chunk.view("u1"))
        if whole.size:
            values[:] = whole[:rows]
        if zlib.crc32(values.data) != own[column]:
            return None
    return samples


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
    """Read the blocks that agree with their checksums: ticks (n,), readings (k, n), time stamps (n,)."""
    total = int(found.blocks["rows"].sum())
    if total < 2:
        raise ReadError(
            path, "", f"is a recording of {total} sample(s) ({found.reason or 'not ended'}); two are needed"
        )
    readings = np.empty((len(columns), total))
    ticks = np.empty(total, dtype=np.int64)
    stamps = np.empty(total if found.timed else 0)
    filled = 0
    data, time = file["samples"], file["time"] if found.timed else None
    for number, (tick, rows) in enumerate(found.blocks[["tick", "rows"]].tolist()):
        part = slice(filled, filled + rows)
        if read_channels(data, found, number, columns, readings[:, part]) is None:
            remarks.append(
                f"block {number + 1} of {len(found.blocks)} ({rows} samples from tick {tick}) does not agree with its "
                "checksum: it is left out, and its samples count as missing"
            )
            continue
        ticks[part] = np.arange(tick, tick + rows)
        if time is not None:
            first = number * found.slot
            stamps[part] = time[first : first + rows]
        filled += rows
    if filled < 2:
        raise ReadError(path, "blocks", "has no two samples that agree with their checksums: the file is damaged")
    if not found.timed and int(ticks[filled - 1] - ticks[0]) > LARGEST_GAP * filled:
        raise ReadError(path, "gaps", "has gaps of more than 20 times its samples; use the part before or after them")
    readings = readings[:, :filled]
    taken = enumerate(map(take_out, readings))
    large = [(ticks[places[0]], columns[row], places.size) for row, places in taken if places.size]
    if large:
        tick, column, _ = min(large)
        where = f"{found.channels[column].name} at tick {tick}"
        remarks.append(beyond_all_measure(sum(size for *_, size in large), where))
    return ticks[:filled], readings, stamps[:filled]


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
    "appending",
    "can_read",
    "headings",
    "raw_column",
    "read_block",
    "read_blocks",
    "read_channels",
    "read_columns",
    "remarks_on",
]
