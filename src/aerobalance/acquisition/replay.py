"""A recording played again as a source: its gaps stay gaps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from aerobalance.acquisition.source import Block, Pacing, SourceChannel, SourceEndedError, Uncontrolled
from aerobalance.io import load_channel_map, read
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import can_read, read_blocks
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError
from aerobalance.recording.units import conversion_for

AGAIN: Final = "the recording begins again"
"""What is said of the time before the first sample of another round."""


class _Part(NamedTuple):
    """Samples that follow each other, shape (n, c), and what is to be said of the time before them."""

    tick: int
    samples: Array
    remark: str = ""


class _Recorded(NamedTuple):
    """What is played."""

    name: str
    rate: float
    channels: tuple[SourceChannel, ...]
    parts: Callable[[], Iterator[_Part]]


class ReplaySource(Uncontrolled):
    """A file that can be read, at any speed.

    Units are those used inside (SI; mV/V for gauge outputs), and what the recording says of its sensors, their delays
    among it, is what the source knows of them. Ticks are the samples of the recording's steady clock.
    What the recorder has written is read block by block, however large it is. Other formats, and columns that a map
    names, are read whole before the first sample: only all their time stamps together tell the clock.

    Parameters
    ----------
    path
        The recording.
    channel_map
        Channel map for a foreign file, or None.
    speed
        Seconds of the recording in a second of the clock; infinite for as fast as possible.
    block
        Length of a block [s].
    loop
        Whether to begin again at the end, without a gap; the first block of each round says so.

    Raises
    ------
    ReadError
        The file is no recording.
    ValueError
        The speed is not above zero.
    """

    clocked = False
    patient = True

    def __init__(
        self,
        path: Path | str,
        *,
        channel_map: Path | None = None,
        speed: float = 1.0,
        block: float = 0.02,
        loop: bool = False,
    ) -> None:
        file = Path(path)
        recorded = (_ticked(file) if channel_map is None else None) or _whole(file, channel_map)
        self.rate, self.channels = recorded.rate, recorded.channels
        self._again = recorded.parts if loop else None
        self._parts = recorded.parts()
        self._offset = self._end = 0
        self.description = f"replay of {recorded.name} at {speed:g} times its speed{', again and again' * loop}"
        self._size = max(1, round(block * self.rate))
        self._pacing = Pacing(self.rate, speed)
        self._part: _Part | None = None
        self._first: int | None = None
        self._stopped = False

    def start(self) -> None:
        """Begin with the first sample."""
        self._pacing.start()

    def stop(self) -> None:
        """End."""
        self._stopped = True

    def read(self, timeout: float) -> Block | None:
        """Return the next samples when they are due."""
        if self._stopped:
            raise SourceEndedError("the replay was stopped")
        if self._part is None:
            self._part = self._next()
        if self._part is None:
            raise SourceEndedError("the replayed recording is at its end")
        tick, samples, remark = self._part
        if self._first is None:
            self._first = tick
        self._end = tick + len(samples)
        rows = min(self._size, samples.shape[0])
        if not self._pacing.wait(tick - self._first, rows, timeout):
            return None
        rest = samples[rows:]
        self._part = _Part(tick + rows, rest) if rest.shape[0] else None
        return Block(tick, samples[:rows], time.monotonic(), remark)

    def _next(self) -> _Part | None:
        """The next part of the recording, on the ticks of the source; None at the end."""
        part = next(self._parts, None)
        if part is None and self._again is not None:
            self._parts = self._again()
            part = next(self._parts, None)
            if part is not None:
                self._offset = self._end - part.tick
                part = part._replace(remark="; ".join(filter(None, (AGAIN, part.remark))))
        return None if part is None else part._replace(tick=part.tick + self._offset)


def _whole(path: Path, channel_map: Path | None) -> _Recorded:
    """Read any recording into memory."""
    recording = read(path, channel_map=None if channel_map is None else load_channel_map(channel_map))
    rows = np.unique(recording.rows)
    cuts = [0, *(np.flatnonzero(np.diff(rows) > 1) + 1), rows.size]

    def parts() -> Iterator[_Part]:
        # in parts of a length that costs little to copy
        for begin, end in pairwise(cuts):
            for first in range(int(rows[begin]), int(rows[end - 1]) + 1, 8192):
                part = slice(first, min(first + 8192, int(rows[end - 1]) + 1))
                yield _Part(first, np.column_stack([channel.values[part] for channel in recording]))

    channels = tuple(SourceChannel(channel.name, channel.unit, **channel.known()) for channel in recording)
    return _Recorded(recording.name, recording.rate, channels, parts)


def _ticked(path: Path) -> _Recorded | None:
    """Open a recording of the recorder's; None where it is none, or has a time column instead of ticks."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        if not can_read(file.read(16), path):
            return None
    found = contents(path)
    if found.timed:
        return None
    if int(found.blocks["rows"].sum()) < 2:
        raise ReadError(path, "", "is a recording of fewer than two samples")
    changes = [conversion_for(channel.name, channel.unit) for channel in found.channels]

    def parts() -> Iterator[_Part]:
        remark = ""
        first = int(found.blocks["tick"][0])
        for tick, readings in read_blocks(path):
            if readings is None:
                remark = "a block of the recording does not agree with its checksum"
                continue
            values = [channel.values(readings[:, i]) for i, channel in enumerate(found.channels)]
            samples = np.column_stack([change.inside(column) for change, column in zip(changes, values, strict=True)])
            samples[np.isinf(samples)] = np.nan
            yield _Part(tick - first, samples, remark)
            remark = ""

    channels = tuple(
        SourceChannel(channel.name, change.unit, **channel.known(factor=change.factor))
        for channel, change in zip(found.channels, changes, strict=True)
    )
    return _Recorded(path.stem, found.rate, channels, parts)
