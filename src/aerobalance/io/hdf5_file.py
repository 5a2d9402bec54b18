"""Recordings in HDF5, as the recorder writes them (see `aerobalance.io.hdf5_layout`), whole or broken off."""

from __future__ import annotations

import contextlib
import json
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from aerobalance.anti_alias import AntiAlias, Kind
from aerobalance.channel import Array, Channel, Coupling, CrossAxis, unit_inside
from aerobalance.io.columns import Clock, Heading, RawColumn, RawColumns, Sensing, split_label
from aerobalance.io.hdf5_layout import (
    BLOCK,
    CHANNEL,
    CHANNELS,
    FORMAT,
    GAP,
    STATUS,
    BlockWriter,
    DiskFullError,
    Provenance,
    StoredChannel,
    checksum,
)
from aerobalance.io.safe_write import replacing
from aerobalance.io.text_table import LARGEST, Layout
from aerobalance.problems import DoubtWarning, ReadError

if TYPE_CHECKING:
    import h5py

NAME: Final = "HDF5 recording"
"""What to call the format in messages."""

SUFFIXES: Final[Mapping[str, str]] = {".h5": "", ".hdf5": ""}
"""File name endings that are written in this format."""

LARGEST_GAP: Final = 20
"""Samples of the clock per sample of the file beyond which the recording has to be cut at its gaps."""

_SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
_FLAGGED_VERSION: Final = 3
_WRITING: Final = 0b101
_ROWS: Final = 8192
_COUPLINGS: Final = ("kinematic", "dc", "ac")


def can_read(head: bytes, path: Path) -> bool:
    """Say whether a file is HDF5, from its first bytes; its name does not matter."""
    del path
    return head.startswith(_SIGNATURE)


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """What a recording's file says without its samples.

    Attributes
    ----------
    channels
        The c columns.
    rate
        Sampling rate [Hz]; NaN where there is a time column.
    slot
        Rows of the file that each block has.
    blocks
        Table of the blocks that hold samples, in order.
    gaps
        Table of the gaps that were noted.
    state
        ``recording`` (still, or broken off) or ``ended``.
    reason
        Why it ended.
    origin
        Tick at which time is zero.
    setup
        Text of the test set-up.
    time_unit
        Unit of the time column; an empty string where there is none.
    """

    channels: tuple[StoredChannel, ...]
    rate: float
    slot: int
    blocks: NDArray[np.void]
    gaps: NDArray[np.void]
    state: str
    reason: str
    origin: int
    setup: str
    time_unit: str

    @property
    def timed(self) -> bool:
        """Whether there is a time column, and no ticks."""
        return bool(self.time_unit)


def contents(path: Path | str) -> Contents:
    """Read what a recording's file says of itself.

    Raises
    ------
    ReadError
        The file is no recording, or damaged.
    """
    file = Path(path)
    with _opened(file) as opened:
        return _contents(file, opened)


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
    with _opened(file) as opened:
        found = _contents(file, opened)
        for number, block in enumerate(found.blocks):
            yield int(block["tick"]), _block(opened, found, number)


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
    DoubtWarning
        A block is damaged and left out, or the record was broken off.
    """
    del layout
    with _opened(path) as file:
        found = _contents(path, file)
        doubts: list[str] = []
        labels = _numbers(path, found, wanted)
        ticks, readings, stamps = _samples(path, file, found, labels, doubts)
    if found.state != "ended":
        doubts.append("the record was not ended (it is still written to, or broken off); its complete blocks are used")
    for text in doubts:
        warnings.warn(f"{path.name}: {text}", DoubtWarning, stacklevel=4)
    columns = [_column(found.channels[i], readings[:, k], i + found.timed) for k, i in enumerate(labels)]
    if found.timed:
        time = RawColumn(f"time [{found.time_unit}]", "time", found.time_unit, stamps, 1)
        return RawColumns(path, (time, *columns), range(1, ticks.size + 1))
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
        return RawColumns(path, tuple(columns), range(1, columns[0].values.size + 1))
    lines = range(1, ticks.size + 1)
    return RawColumns(path, tuple(columns), lines, rate=found.rate, start=start, ticks=ticks_missing)


def write_columns(
    path: Path, columns: Mapping[str, Array], described: Mapping[str, StoredChannel] | None = None
) -> None:
    """Write columns under their headers, with their time column; missing samples are NaN, numbers read back exactly.

    Parameters
    ----------
    path
        The file.
    columns
        Values, shape (n,) each, by header ``name [unit]``; one of them is ``time [s]`` or in another unit of time.
    described
        What is known of the columns, by header.

    Raises
    ------
    ValueError
        A name or unit is too long, or the file cannot be written.
    """
    split = {label: split_label(label) for label in columns}
    time = next((label for label, (name, _) in split.items() if name == "time"), None)
    if time is None:
        raise ValueError(f"cannot write {path}: a recording in HDF5 needs a column time [s]")
    others = [label for label in columns if label != time]
    channels = []
    for label in others:
        name, unit = split[label]
        if len(name.encode()) > CHANNEL["name"].itemsize or len(unit.encode()) > CHANNEL["unit"].itemsize:
            raise ValueError(f"cannot write {path}: the column {label!r} has too long a name for HDF5 (60 letters)")
        known = (described or {}).get(label, StoredChannel(name=name, unit=unit))
        channels.append(replace(known, name=name, unit=unit, input=label))
    n = columns[time].size
    values = np.column_stack([columns[label] for label in others]) if others else np.empty((n, 0))
    values = np.where(np.isfinite(values), values, np.nan)
    provenance = Provenance(f"converted; time column {time}")
    with replacing(path) as beside:
        beside.unlink()
        writer = BlockWriter(
            beside,
            channels,
            rate=float("nan"),
            rows=max(1, min(n, _ROWS)),
            provenance=provenance,
            time_unit=split[time][1],
        )
        try:
            for first in range(0, n, writer.rows):
                part = slice(first, first + writer.rows)
                writer.append(first, values[part], stamps=columns[time][part])
            writer.finish("converted")
        except DiskFullError as problem:
            raise ValueError(f"cannot write {path}: {problem}") from problem


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a file as a reader beside a writer, which is also right after a crash; turn its faults into `ReadError`."""
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    try:
        with h5py.File(path, "r", swmr=_being_written(path), libver="latest", locking="best-effort") as file:
            yield file
    except (ReadError, GeneratorExit):
        raise
    except FileNotFoundError:
        raise ReadError(path, "", "there is no such file") from None
    except Exception as error:  # noqa: BLE001 - the library fails in a dozen ways on damaged files
        text = " ".join(str(error).split()) or type(error).__name__
        raise ReadError(path, "", f"is a damaged HDF5 file, or of a kind that cannot be read: {text[:200]}") from None


def _being_written(path: Path) -> bool:
    """Say whether the file is being written to, or was when its writer was killed: a flag in the superblock.

    Only such a file is opened as beside a writer, as the library then waits for what does not agree with its checksum
    to be written, which never happens in a damaged file.
    """
    with path.open("rb") as file:
        head = file.read(12)
    return len(head) == 12 and head[8] >= _FLAGGED_VERSION and bool(head[11] & _WRITING)


def _contents(path: Path, file: h5py.File) -> Contents:
    given = file.attrs.get("format")
    if given != FORMAT:
        raise ReadError(path, "", f"is an HDF5 file, but no recording: its attribute format must be {FORMAT!r}")
    schema = int(file.attrs["schema_version"])
    if schema not in CHANNELS:
        raise ReadError(path, "schema_version", f"is {schema}; this program reads {' and '.join(map(str, CHANNELS))}")
    table = _table(path, file, "channels", CHANNELS[schema])
    if zlib.crc32(table.tobytes()) != int(file.attrs["channels_crc32"]):
        raise ReadError(path, "channels", "does not agree with its checksum: units and signs cannot be trusted")
    channels = tuple(_channel(path, row) for row in table)
    names = [channel.name for channel in channels]
    if not names or len(set(names)) != len(names) or "" in names:
        raise ReadError(path, "channels", f"must have names of their own, not {', '.join(map(repr, names)) or 'none'}")
    samples = file["samples"]
    if samples.ndim != 2 or samples.shape[1] != len(channels) or samples.dtype != "<f8" or not samples.chunks:
        raise ReadError(
            path, "samples", f"must hold {len(channels)} columns of float64 in chunks: the file is damaged"
        )
    unit = str(file["time"].attrs["unit"]) if "time" in file else ""
    rate = float(file.attrs["rate"])
    if not unit and not 0 < rate < 1e12:
        raise ReadError(path, "rate", f"must be above zero, not {rate:g} Hz")
    status = _table(path, file, "status", STATUS)[0]
    slot = int(samples.chunks[0])
    return Contents(
        channels=channels,
        rate=rate,
        slot=slot,
        blocks=_blocks(path, _table(path, file, "blocks", BLOCK), slot, len(channels)),
        gaps=_table(path, file, "gaps", GAP),
        state=_text(status["state"]),
        reason=_text(status["reason"]),
        origin=int(status["origin"]),
        setup=bytes(file["setup"][...].tobytes()).decode("utf-8", "replace"),
        time_unit=unit,
    )


def _table(path: Path, file: h5py.File, name: str, kind: np.dtype[np.void]) -> NDArray[np.void]:
    dataset = file[name]
    if dataset.dtype != kind or dataset.ndim != 1:
        raise ReadError(path, name, "is no table of the kind that belongs here: the file is damaged")
    if dataset.shape[0] * kind.itemsize > path.stat().st_size:
        raise ReadError(path, name, f"claims {dataset.shape[0]} rows, more than the file can hold: it is damaged")
    rows: NDArray[np.void] = dataset[...]
    return rows


def _blocks(path: Path, table: NDArray[np.void], slot: int, columns: int) -> NDArray[np.void]:
    """Check the table of blocks; its end, where the writing was cut off, is left out."""
    rows, ticks = table["rows"], table["tick"]
    unwritten = np.flatnonzero(rows == 0)
    if unwritten.size:
        table = table[: int(unwritten[0])]
        rows, ticks = table["rows"], table["tick"]
    if (rows < 0).any() or (rows > slot).any() or (np.abs(ticks) > 2**62).any():
        raise ReadError(path, "blocks", "has a block with an impossible number of rows, or tick: the file is damaged")
    if (ticks[1:] < ticks[:-1] + rows[:-1]).any():
        raise ReadError(path, "blocks", "has blocks whose ticks do not increase: the file is damaged")
    if int(rows.sum()) * columns * 8 > path.stat().st_size:
        raise ReadError(path, "blocks", "claims more samples than the file can hold: it is damaged")
    return table


def _channel(path: Path, row: np.void) -> StoredChannel:
    name, coupling = _text(row["name"]), _text(row["coupling"])
    numbers: dict[str, Any] = {
        key: float(row[key]) for key in ("sign", "scale", "offset", "delay", "relative_uncertainty", "corner")
    }
    noise = float(row["noise"])
    low_pass: AntiAlias | None = None
    cross_axis: tuple[CrossAxis, ...] = ()
    mounting: dict[str, Any] = {}
    try:
        if "filter" in (row.dtype.names or ()):
            numbers["zero_uncertainty"] = float(row["zero_uncertainty"])
            low_pass, cross_axis = _low_pass(row), _cross_axis(row)
        if "mounting" in (row.dtype.names or ()):
            mounting = _mounting(name, row)
    except (ValueError, TypeError, AttributeError):
        raise ReadError(path, f"channels, {name!r}", "has impossible settings: the file is damaged") from None
    if coupling not in _COUPLINGS or not all(np.isfinite(value) for value in numbers.values()) or noise < 0:
        raise ReadError(path, f"channels, {name!r}", "has impossible settings: the file is damaged")
    return StoredChannel(
        name=name,
        unit=_text(row["unit"]),
        input=_text(row["input"]),
        noise=None if np.isnan(noise) else noise,
        coupling=cast("Coupling", coupling),
        filter=low_pass,
        cross_axis=cross_axis,
        **mounting,
        **numbers,
    )


def _low_pass(row: np.void) -> AntiAlias | None:
    kind = _text(row["filter"])
    return AntiAlias(cast("Kind", kind), int(row["filter_order"]), float(row["filter_corner"])) if kind else None


def _cross_axis(row: np.void) -> tuple[CrossAxis, ...]:
    parts = json.loads(_text(row["cross_axis"]) or "{}")
    return tuple(CrossAxis(name, float(value), float(u)) for name, (value, u) in parts.items())


def _mounting(name: str, row: np.void) -> dict[str, Any]:
    """Place, axis and the place's uncertainty; a channel without readings refuses what is impossible."""
    given = json.loads(_text(row["mounting"]) or "{}")
    vectors = {key: tuple(float(part) for part in given[key]) for key in ("place", "axis") if key in given}
    found: dict[str, Any] = {**vectors, "place_uncertainty": float(given.get("place_uncertainty", 0.0))}
    if given:
        Channel(name, np.empty(0), unit_inside(name) or _text(row["unit"]), **found)
    return found


def _text(cell: Any) -> str:
    return bytes(cell).decode("utf-8", "replace")


def _block(file: h5py.File, found: Contents, number: int) -> Array | None:
    """Read one block, shape (n, c); None where it does not agree with its checksum."""
    tick, rows, crc = (int(found.blocks[number][key]) for key in ("tick", "rows", "crc32"))
    first = number * found.slot
    samples = np.asarray(file["samples"][first : first + rows], dtype=np.float64)
    return samples if samples.shape[0] == rows and checksum(tick, samples) == crc else None


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
    path: Path, file: h5py.File, found: Contents, columns: list[int], doubts: list[str]
) -> tuple[NDArray[np.int64], Array, Array]:
    """Read the blocks that agree with their checksums: ticks (n,), readings (n, k), time stamps (n,)."""
    total = int(found.blocks["rows"].sum())
    if total < 2:
        raise ReadError(
            path, "", f"is a recording of {total} sample(s) ({found.reason or 'not ended'}); two are needed"
        )
    readings = np.empty((total, len(columns)))
    ticks = np.empty(total, dtype=np.int64)
    stamps = np.empty(total if found.timed else 0)
    filled = 0
    for number, block in enumerate(found.blocks):
        rows, tick = int(block["rows"]), int(block["tick"])
        samples = _block(file, found, number)
        if samples is None:
            doubts.append(
                f"block {number + 1} of {len(found.blocks)} ({rows} samples from tick {tick}) does not agree with its "
                "checksum: it is left out, and its samples count as missing"
            )
            continue
        part = slice(filled, filled + rows)
        readings[part] = samples[:, columns]
        ticks[part] = np.arange(tick, tick + rows)
        if found.timed:
            first = number * found.slot
            stamps[part] = file["time"][first : first + rows]
        filled += rows
    if filled < 2:
        raise ReadError(path, "blocks", "has no two samples that agree with their checksums: the file is damaged")
    if not found.timed and int(ticks[filled - 1] - ticks[0]) > LARGEST_GAP * filled:
        raise ReadError(path, "gaps", "has gaps of more than 20 times its samples; use the part before or after them")
    readings = readings[:filled]
    readings[np.isinf(readings)] = np.nan
    if float(np.nanmax(np.abs(readings), initial=0.0)) > LARGEST:
        raise ReadError(path, "samples", f"holds numbers that no reading is; allowed: up to {LARGEST:.0e} either way")
    return ticks[:filled], readings, stamps[:filled]


def _column(channel: StoredChannel, readings: Array, number: int) -> RawColumn:
    return RawColumn(
        f"{channel.name} [{channel.unit}]",
        channel.name,
        channel.unit,
        channel.values(readings),
        number + 1,
        alias=channel.input,
        delay=channel.delay,
        sensing=Sensing(
            channel.noise,
            channel.relative_uncertainty,
            channel.coupling,
            channel.corner,
            channel.zero_uncertainty,
            channel.filter,
            channel.cross_axis,
            channel.place,
            channel.axis,
            channel.place_uncertainty,
        ),
    )


def _spread(column: RawColumn, ticks: NDArray[np.int64]) -> RawColumn:
    """Put a column on the steady clock, NaN where samples are missing."""
    values = np.full(int(ticks[-1]) + 1, np.nan)
    values[ticks] = column.values
    return replace(column, values=values)
