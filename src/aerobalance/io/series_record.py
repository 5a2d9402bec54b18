"""A recording in another program's file, read part by part (see `aerobalance.io.series`)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock

import numpy as np

from aerobalance.io.channel_map import ChannelMap, mapped_channels
from aerobalance.io.clocks import steady_clock_of
from aerobalance.io.columns import PIECE, Clock, RawColumns
from aerobalance.io.series import Holdings, Reader, Series
from aerobalance.io.series_columns import axis_epoch, bare_column, chosen_series
from aerobalance.io.series_values import read_part, read_values
from aerobalance.io.table import channels_of, table_from, warn_of_limit, warn_of_missing
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.parts import Extent, LateMeans, mean_over
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import conversion


@dataclass(slots=True, eq=False)
class SeriesRecord:
    """A record in an open file.

    Attributes
    ----------
    path
        The file.
    chosen
        The series that are its channels, with their numbers.
    clock
        Its steady clock.
    axis
        The series of its times; None where the clock is stated.
    channel_map
        What the channels are; None for a file that says it.
    epoch
        Date and time of time zero.
    """

    path: Path
    chosen: tuple[tuple[int, Series], ...]
    clock: Clock
    axis: Series | None
    channel_map: ChannelMap | None
    epoch: np.datetime64 | None
    _means: LateMeans = field(init=False, repr=False)
    # readers go to a place in their one open file and read there, or keep what was read last: one thread at a time
    _reading: Lock = field(init=False, repr=False, default_factory=Lock)

    def __post_init__(self) -> None:
        names = [series.name for _, series in self.chosen] if self.channel_map is None else self.channel_map.channels
        self._means = LateMeans([name for name in names if name == "temperature"], self._mean)

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.path.name

    @property
    def samples(self) -> int:
        """Number of samples of its steady clock."""
        return self.chosen[0][1].samples

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        interval = self.clock.interval
        return 1 / interval if self.axis is not None else float(f"{1 / interval:.15g}")

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return self.clock.start

    def part(self, begin: int, end: int) -> Recording:
        """Samples from one to another (not included) as a recording.

        Warns
        -----
        DataQualityWarning
            Samples are missing or rest on a limit.
        """
        channels = self._channels(begin, end)
        for channel in channels.values():
            warn_of_missing(self.path, channel)
            warn_of_limit(self.path, channel)
        last = max(self.samples - 1, 1)
        return Recording(
            name=self.name,
            stamps=self._stamps(begin, end),
            rows=np.arange(end - begin, dtype=np.intp),
            start=self.start + begin / self.rate,
            rate=self.rate,
            channels=channels,
            time_unit="s" if self.axis is None else self.axis.unit_as_read,
            extent=Extent(begin / last, (end - 1) / last, self._means),
            epoch=self.epoch,
        )

    def _channels(self, begin: int, end: int) -> dict[str, Channel]:
        with self._reading:
            values = read_part(self.path, [series for _, series in self.chosen], begin, end)
        columns = tuple(
            replace(bare_column(number, series), values=one)
            for (number, series), one in zip(self.chosen, values, strict=True)
        )
        raw = RawColumns(self.path, columns, range(1, end - begin + 1), rate=self.rate, start=self.start)
        if self.channel_map is not None:
            return mapped_channels(raw, self.channel_map)
        return channels_of(table_from(raw, missing_allowed=True))

    def _stamps(self, begin: int, end: int) -> Array:
        if self.axis is None:
            return self.start + np.arange(begin, end) / self.rate
        with self._reading:
            return seconds(self.path, self.axis, begin, end)

    def _mean(self, name: str) -> float:
        """Mean of a channel over the whole record."""
        return mean_over(self.samples, lambda begin, end: self._channels(begin, end)[name].values, at_once=PIECE)


@contextlib.contextmanager
def opened_series(path: Path, reader: Reader, channel_map: ChannelMap | None) -> Iterator[SeriesRecord | None]:
    """Open a file to read parts of it; None where it must be read whole.

    It is read whole where parts cost as much, where its channels have different clocks or none that is steady, and
    where the map has the time as a column or derives a channel.

    Raises
    ------
    ReadError
        The file is damaged, or has not the channels.
    """
    reading = contextlib.ExitStack()
    try:
        found = reading.enter_context(reader.opened(path))
        record = _record(path, found, channel_map) if found.parts else None
        if record is not None:
            for text in found.remarks:
                warn_quality(f"{path.name}: {text}")
        yield record
    finally:
        reading.close()  # what went wrong with the record's parts is no fault of the file


def _record(path: Path, found: Holdings, channel_map: ChannelMap | None) -> SeriesRecord | None:
    given = None if channel_map is None else channel_map.file
    if channel_map is not None and channel_map.needs_all:
        return None
    chosen = tuple(chosen_series(path, found, None if channel_map is None else channel_map.wanted))
    if any(one.fault or one.samples != chosen[0][1].samples for _, one in chosen):
        return None
    if given is not None and given.rate is not None:
        return SeriesRecord(path, chosen, Clock(0.0, 1 / given.rate), None, channel_map, found.epoch)
    clock, axis = _common_clock(path, found, chosen)
    if clock is None:
        return None
    epoch = found.epoch if axis is None else axis_epoch(path, found, axis)
    return SeriesRecord(path, chosen, clock, axis, channel_map, epoch)


def _common_clock(
    path: Path, found: Holdings, chosen: tuple[tuple[int, Series], ...]
) -> tuple[Clock | None, Series | None]:
    """The one steady clock of some series, and the series of their times; None where there is none."""
    first = chosen[0][1]
    alike = all((one.clock, one.axis) == (first.clock, first.axis) for _, one in chosen)
    if not alike or first.clock is not None:
        return (first.clock if alike else None), None
    axis = next((one for one in found.series if one.label == first.axis), None)
    if axis is None or not axis.unit_as_read:
        return None, None
    return steady_clock_of(lambda begin, end: seconds(path, axis, begin, end), axis.samples), axis


def seconds(path: Path, axis: Series, begin: int, end: int) -> Array:
    """Times of some samples [s]."""
    return np.asarray(conversion(axis.unit_as_read, expected="s").inside(read_values(path, axis, begin, end)))
