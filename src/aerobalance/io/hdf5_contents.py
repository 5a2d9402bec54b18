"""What a recording in HDF5 says of itself without its samples."""

from __future__ import annotations

import contextlib
import json
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.hdf5_closing import is_written, marked_as_written
from aerobalance.io.hdf5_heaps import check_heaps
from aerobalance.io.hdf5_layout import BLOCK, BY_CHANNEL, BY_SUMS, CHANNELS, EVENT, FORMAT, GAP, STATUS, StoredChannel
from aerobalance.io.hdf5_marked import UnmarkedFile
from aerobalance.io.opening import opened_file
from aerobalance.io.said_by_file import date_of
from aerobalance.recording.analog_filter import AntiAlias, Kind
from aerobalance.recording.channel import Channel, Coupling, CrossAxis, unit_inside
from aerobalance.recording.errors import ReadError

if TYPE_CHECKING:
    import h5py

_MOST_CHANNELS: Final = 10_000
_LONGEST_ATTRIBUTE: Final = 4096
_SMALL_CHUNK: Final = 2**20
_COUPLINGS: Final = ("kinematic", "dc", "ac")


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
    gaps, events
        Tables of the gaps and of the events that were noted.
    state
        ``recording`` (still, or broken off) or ``ended``.
    reason
        Why it ended.
    origin
        Tick at which time is zero.
    time_unit
        Unit of the time column; an empty string where there is none.
    marked
        Whether the file has the mark of one that is being written.
    epoch
        Date and time at which the time is zero; None where the file does not say it.
    checksums
        Checksum of each channel of each block, shape (blocks, c), where a channel is read without the others; None
        where a block has one.
    by_sums
        Whether these are checksums of sums of the samples.
    """

    channels: tuple[StoredChannel, ...]
    rate: float
    slot: int
    blocks: NDArray[np.void]
    gaps: NDArray[np.void]
    events: NDArray[np.void]
    state: str
    reason: str
    origin: int
    time_unit: str
    marked: bool
    epoch: np.datetime64 | None = None
    checksums: NDArray[np.uint32] | None = None
    by_sums: bool = False

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
    with opened(file) as inside:
        return contents_of(file, inside)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a file as a reader beside a writer, which is also right after a crash; turn its faults into `ReadError`."""
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    try:
        marked = _is_marked(path)
        if marked and is_written(path):
            # A lock stands in nobody's way there, and the library wants both opened in one way in a process.
            with h5py.File(path, "r", swmr=True, libver="latest", locking=False) as file:
                yield file
            return
        check_heaps(path)
        with contextlib.ExitStack() as stack:
            source: Any = stack.enter_context(UnmarkedFile(path)) if marked else path
            settings = {} if marked else {"locking": "best-effort"}
            yield stack.enter_context(h5py.File(source, "r", libver="latest", **settings))
    except (ReadError, GeneratorExit):
        raise
    except Exception as error:  # noqa: BLE001 - the library fails in a dozen ways on damaged files
        text = " ".join(str(error).split()) or type(error).__name__
        raise ReadError(
            path, "its structure", f"is a damaged HDF5 file, or of a kind that cannot be read: {text[:200]}"
        ) from None


def _is_marked(path: Path) -> bool:
    """Return whether the file is being written to, or was when its writer was killed: a flag in the superblock."""
    with opened_file(path) as file:
        return marked_as_written(file.read(12))


def contents_of(path: Path, file: h5py.File) -> Contents:
    """Read what an open file says of itself."""
    given = _attribute(path, file, "format")
    if given != FORMAT:
        raise ReadError(path, "", f"is an HDF5 file, but no recording: its attribute format must be {FORMAT!r}")
    schema = int(_attribute(path, file, "schema_version"))
    if schema not in CHANNELS:
        raise ReadError(path, "schema_version", f"is {schema}; this program reads {' and '.join(map(str, CHANNELS))}")
    table = _table(path, file, "channels", CHANNELS[schema])
    if table.size > _MOST_CHANNELS:
        raise ReadError(path, "channels", f"are {table.size}; allowed: up to {_MOST_CHANNELS}")
    if zlib.crc32(table.tobytes()) != int(_attribute(path, file, "channels_crc32")):
        raise ReadError(path, "channels", "does not agree with its checksum: units and signs cannot be trusted")
    channels = tuple(_channel(path, row) for row in table)
    names = [channel.name for channel in channels]
    if not names or len(set(names)) != len(names) or "" in names:
        raise ReadError(path, "channels", f"must have names of their own, not {', '.join(map(repr, names)) or 'none'}")
    samples = _dataset(path, file, "samples")
    if samples.ndim != 2 or samples.shape[1] != len(channels) or samples.dtype != "<f8" or not samples.chunks:
        raise ReadError(
            path, "samples", f"must hold {len(channels)} columns of float64 in chunks: the file is damaged"
        )
    if schema >= BY_CHANNEL and samples.chunks[1] != 1:
        raise ReadError(path, "samples", "must have a chunk for every column: the file is damaged")
    unit = _time_unit(path, file)
    rate = float(_attribute(path, file, "rate"))
    if not unit and not 0 < rate < 1e12:
        raise ReadError(path, "rate", f"must be above zero, not {rate:g} Hz")
    status = _table(path, file, "status", STATUS)[0]
    slot = int(samples.chunks[0])
    blocks = _blocks(path, _table(path, file, "blocks", BLOCK), slot, len(channels))
    return Contents(
        channels=channels,
        rate=rate,
        slot=slot,
        blocks=blocks,
        gaps=_table(path, file, "gaps", GAP),
        events=_table(path, file, "events", EVENT),
        state=_text(status["state"]),
        reason=_text(status["reason"]),
        origin=int(status["origin"]),
        time_unit=unit,
        marked=_is_marked(path),
        epoch=date_of(_attribute(path, file["status"], "epoch")) if "epoch" in file["status"].attrs else None,
        checksums=_checksums(path, file, blocks, len(channels)) if schema >= BY_CHANNEL else None,
        by_sums=schema >= BY_SUMS,
    )


def _dataset(path: Path, file: h5py.File, name: str) -> h5py.Dataset:
    """Return a dataset whose data are in this file as they are: linked to no other, of no other, not compressed.

    What is read then has the size of the file at most, whatever its header claims.
    """
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    if not _linked(file, name):
        raise ReadError(path, name, "is missing: the file is damaged")
    kind = file.id.links.get_info(name.encode()).type
    if kind != h5py.h5l.TYPE_HARD:
        where = "another file" if kind == h5py.h5l.TYPE_EXTERNAL else "elsewhere"
        raise ReadError(path, name, f"is a link to {where}; links are not followed: the data must be in their place")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise ReadError(path, name, "is no dataset: the file is damaged")
    if dataset.external or dataset.is_virtual:
        raise ReadError(path, name, "takes its data from other files, which are not opened: the data must be in this")
    if dataset.id.get_create_plist().get_nfilters():
        raise ReadError(
            path,
            name,
            "is compressed or filtered, and might be any size when unpacked; allowed: data as they are "
            "(`h5repack -f NONE IN OUT` unpacks them)",
        )
    held = path.stat().st_size
    chunk = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize if dataset.size else 0
    if chunk > max(held, _SMALL_CHUNK):
        raise ReadError(path, name, f"claims pieces of {chunk} bytes in a file of {held} bytes: it is damaged")
    return dataset


def _linked(file: h5py.File, name: str) -> bool:
    """Return whether there is something of this name, without going where a link leads."""
    return bool(file.id.links.exists(name.encode()))


def _attribute(path: Path, holder: h5py.HLObject, name: str) -> Any:
    """Read a single number or text that is attached to the file or to a dataset."""
    if name not in holder.attrs:
        return None if name == "format" else holder.attrs[name]
    known = holder.attrs.get_id(name)
    if known.shape != () or known.dtype.itemsize > _LONGEST_ATTRIBUTE:
        raise ReadError(path, f"attribute {name}", "must be one number or a short text: the file is damaged")
    return holder.attrs[name]


def _time_unit(path: Path, file: h5py.File) -> str:
    """Unit of the time column; an empty string where there is none."""
    if not _linked(file, "time"):
        return ""
    time = _dataset(path, file, "time")
    if time.dtype != "<f8" or time.ndim != 1 or not time.chunks:
        raise ReadError(path, "time", "must hold one column of float64 in chunks: the file is damaged")
    return str(_attribute(path, time, "unit"))


def _table(path: Path, file: h5py.File, name: str, kind: np.dtype[np.void]) -> NDArray[np.void]:
    dataset = _dataset(path, file, name)
    if dataset.dtype != kind or dataset.ndim != 1:
        raise ReadError(path, name, "is no table of the kind that belongs here: the file is damaged")
    if dataset.shape[0] * kind.itemsize > path.stat().st_size:
        raise ReadError(path, name, f"claims {dataset.shape[0]} rows, more than the file can hold: it is damaged")
    rows: NDArray[np.void] = dataset[...]
    return rows


def _checksums(path: Path, file: h5py.File, blocks: NDArray[np.void], columns: int) -> NDArray[np.uint32]:
    """Checksums of the channels of each block, shape (blocks, c)."""
    dataset = _dataset(path, file, "checksums")
    if dataset.dtype != "<u4" or dataset.shape != (len(blocks), columns):
        raise ReadError(path, "checksums", f"must be {columns} of each of {len(blocks)} blocks: the file is damaged")
    found: NDArray[np.uint32] = dataset[...]
    return found


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
