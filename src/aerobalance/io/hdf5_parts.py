"""A recording in HDF5 of which no more is read than a part is made of (see `aerobalance.io.hdf5_layout`)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.clocks import steady_clock_of
from aerobalance.io.columns import PIECE, RawColumns
from aerobalance.io.hdf5_contents import Contents, contents_of, opened
from aerobalance.io.hdf5_file import LARGEST_GAP, Blocks, raw_column, remarks_on, stamps_of
from aerobalance.io.measure import beyond_all_measure, take_out
from aerobalance.io.series import Fills
from aerobalance.io.table import channels_of, table_from, warn_of_limit, warn_of_missing
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import OfMissing, ReadError, warn_quality
from aerobalance.recording.parts import Extent, LateMeans, mean_over
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import conversion

if TYPE_CHECKING:
    import h5py


class _Clock(NamedTuple):
    """The steady clock of a file: time of its first sample [s], and time between two [s]."""

    start: float
    interval: float


@dataclass(slots=True, eq=False)
class Hdf5Record:
    """A record in an open file.

    Attributes
    ----------
    path
        The file.
    file
        It, open.
    found
        What it says of itself.
    clock
        Its steady clock.
    """

    path: Path
    file: h5py.File
    found: Contents
    clock: _Clock
    _means: LateMeans = field(init=False, repr=False)
    _blocks: Blocks = field(init=False, repr=False)
    _stamps: Fills | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._blocks, self._stamps = Blocks(self.file, self.found), stamps_of(self.file, self.found)
        self._means = LateMeans([one.name for one in self.found.channels if one.name == "temperature"], self._mean)

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.path.name

    @property
    def samples(self) -> int:
        """Number of samples of its steady clock."""
        first, last = self.found.blocks[0], self.found.blocks[-1]
        return int(last["tick"] + last["rows"] - first["tick"])

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return 1 / self.clock.interval if self.found.timed else self.found.rate

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return self.clock.start

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""
        return self.found.epoch

    def part(self, begin: int, end: int) -> Recording:
        """Samples from one to another (not included) as a recording; what is missing is NaN.

        Warns
        -----
        DataQualityWarning
            A block is damaged and left out, or samples are missing or rest on a limit.
        """
        rows, readings, stamps = self._read(begin, end, range(len(self.found.channels)))
        columns = tuple(
            raw_column(channel, readings[place], place + self.found.timed)
            for place, channel in enumerate(self.found.channels)
        )
        raw = RawColumns(self.path, columns, range(1, rows.size + 1), rate=self.rate, start=self.start)
        channels = {}
        for name, channel in channels_of(table_from(raw, missing_allowed=True)).items():
            warn_of_missing(self.path, channel)
            warn_of_limit(self.path, channel)
            channels[name] = channel
        missing = end - begin - rows.size
        if missing:
            warn_quality(
                OfMissing(
                    f"{self.name}: {missing} sample(s) are missing in {int(np.count_nonzero(np.diff(rows) > 1))} "
                    "gap(s); the model bridges them, with a larger uncertainty"
                )
            )
        last = max(self.samples - 1, 1)
        return Recording(
            name=self.name,
            stamps=stamps,
            rows=rows,
            start=self.start + begin / self.rate,
            rate=self.rate,
            channels={name: _placed(channel, rows, end - begin) for name, channel in channels.items()},
            time_unit=self.found.time_unit or "s",
            extent=Extent(begin / last, (end - 1) / last, self._means),
            epoch=self.found.epoch,
        )

    def _read(self, begin: int, end: int, columns: Sequence[int]) -> tuple[NDArray[np.intp], Array, Array]:
        """Rows that are there, counted from `begin`, shape (m,), readings of columns (k, m), and time stamps (m,)."""
        blocks = self.found.blocks
        first = blocks["tick"] - blocks["tick"][0]
        wanted = np.flatnonzero((first < end) & (first + blocks["rows"] > begin))
        table, there = np.empty((len(columns), end - begin)), np.empty(end - begin, dtype=np.intp)
        stamps, filled = np.empty(end - begin if self.found.timed else 0), 0
        for number in wanted.tolist():
            since, size = int(first[number]) - begin, int(blocks["rows"][number])
            kept = slice(max(0, -since), min(size, end - begin - since))
            part = slice(filled, filled + kept.stop - kept.start)
            whole = part.stop - part.start == size
            try:
                samples = self._blocks.channels(number, columns, table[:, part] if whole else None)
            except (OSError, RuntimeError) as error:
                raise ReadError(self.path, f"block {number + 1}", f"cannot be read: {error}") from None
            if samples is None:
                warn_quality(
                    f"{self.name}: block {number + 1} of {len(blocks)} ({size} samples) does not "
                    "agree with its checksum: it is left out, and its samples count as missing"
                )
                continue
            there[part] = np.arange(since + kept.start, since + kept.stop)
            if not whole:
                table[:, part] = samples[:, kept]
            if self._stamps is not None:
                self._stamps(number * self.found.slot + kept.start, stamps[part])
            filled = part.stop
        table, there = table[:, :filled], there[:filled]
        taken = enumerate(map(take_out, table))
        large = [(there[places[0]] + begin, columns[row], places.size) for row, places in taken if places.size]
        if large:
            sample, column, _ = min(large)
            where = f"{self.found.channels[column].name} at sample {sample}"
            warn_quality(f"{self.name}: {beyond_all_measure(sum(size for *_, size in large), where)}")
        if not self.found.timed:
            return there, table, self.start + (there + begin) / self.rate
        change = conversion(self.found.time_unit, expected="s")
        return there, table, np.asarray(change.inside(stamps[:filled]))

    def _mean(self, name: str) -> float:
        """Mean of a channel over the whole record."""
        place = next(i for i, one in enumerate(self.found.channels) if one.name == name)

        def read(begin: int, end: int) -> Array:
            _, readings, _ = self._read(begin, end, [place])
            column = raw_column(self.found.channels[place], readings[0], place)
            raw = RawColumns(self.path, (column,), range(1, readings.shape[1] + 1), rate=self.rate)
            return table_from(raw, missing_allowed=True).values(name)

        return mean_over(self.samples, read, at_once=PIECE)


def _placed(channel: Channel, rows: NDArray[np.intp], size: int) -> Channel:
    """Put the rows of a channel where they belong; what is between them is missing."""
    if rows.size == size:
        return channel
    values = np.full(size, np.nan)
    values[rows] = channel.values
    return replace(channel, values=values)


@contextlib.contextmanager
def opened_record(path: Path) -> Iterator[Hdf5Record | None]:
    """Open a recording to read parts of it; None where its time column is not that of a steady clock without gaps.

    Raises
    ------
    ReadError
        The file is damaged or no recording, or has gaps out of all proportion.

    Warns
    -----
    DataQualityWarning
        The record was broken off, or model and support touched.
    """
    reading = contextlib.ExitStack()
    try:
        file = reading.enter_context(opened(path))
        record = _record(path, file)
        if record is not None:
            for text in remarks_on(record.found):
                warn_quality(f"{path.name}: {text}")
        yield record
    finally:
        reading.close()  # what went wrong with the record's parts is no fault of the file


def _record(path: Path, file: h5py.File) -> Hdf5Record | None:
    """The record in an open file; None where its time column is not that of a steady clock without gaps."""
    found = contents_of(path, file)
    total = int(found.blocks["rows"].sum())
    if total < 2:
        return None
    if found.timed:
        clock = _steady(file, found)
    else:
        clock = _Clock((int(found.blocks["tick"][0]) - found.origin) / found.rate, 1 / found.rate)
    if clock is None:
        return None
    record = Hdf5Record(path, file, found, clock)
    if not found.timed and record.samples > LARGEST_GAP * total:
        raise ReadError(path, "gaps", "has gaps of more than 20 times its samples; use the part before or after them")
    return record


def _steady(file: h5py.File, found: Contents) -> _Clock | None:
    """The steady clock that fits a time column by least squares; None where a stamp departs from it."""
    samples = int(found.blocks["rows"].sum())
    if (found.blocks["tick"] != np.arange(len(found.blocks)) * found.slot).any():
        return None  # short blocks within the file
    change = conversion(found.time_unit, expected="s")

    def stamps(begin: int, end: int) -> Array:
        return np.asarray(change.inside(np.asarray(file["time"][begin:end], dtype=np.float64)))

    clock = steady_clock_of(stamps, samples)
    return None if clock is None else _Clock(clock.start, clock.interval)
