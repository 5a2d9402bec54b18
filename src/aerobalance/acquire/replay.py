"""A recording played again as a source: its gaps stay gaps."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from aerobalance.acquire.pacing import Pacing
from aerobalance.acquire.source import Block, SourceChannel, SourceEndedError
from aerobalance.io import load_channel_map, read


class ReplaySource:
    """A file that can be read, at any speed.

    Units are those used inside (SI; mV/V for gauge outputs). Ticks are the samples of the recording's steady clock.

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

    Raises
    ------
    ReadError
        The file is no recording.
    ValueError
        The speed is not above zero.
    """

    controls: tuple[str, ...] = ()
    clocked = False
    patient = True

    def __init__(
        self, path: Path | str, *, channel_map: Path | None = None, speed: float = 1.0, block: float = 0.02
    ) -> None:
        recording = read(path, channel_map=None if channel_map is None else load_channel_map(channel_map))
        self.rate = recording.rate
        self.channels = tuple(SourceChannel(channel.name, channel.unit) for channel in recording)
        self.description = f"replay of {recording.name} at {speed:g} times its speed"
        self._rows = np.unique(recording.rows)
        self._values = [channel.values for channel in recording]
        # Pieces of rows that follow each other: a block never spans a gap.
        cuts = np.flatnonzero(np.diff(self._rows) > 1) + 1
        self._ends = np.concatenate((cuts, [self._rows.size]))
        self._size = max(1, round(block * self.rate))
        self._pacing = Pacing(self.rate, speed)
        self._next = 0
        self._stopped = False

    def start(self) -> None:
        """Begin with the first sample."""
        self._pacing.start()

    def stop(self) -> None:
        """End."""
        self._stopped = True

    def control(self, name: str, value: float) -> str:
        """Refuse: a recording cannot be changed.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(f"a replayed recording has no controls; {name!r} = {value:g} cannot be set")

    def read(self, timeout: float) -> Block | None:
        """Return the next samples when they are due."""
        if self._stopped:
            raise SourceEndedError("the replay was stopped")
        if self._next >= self._rows.size:
            raise SourceEndedError("the replayed recording is at its end")
        end = min(self._next + self._size, int(self._ends[np.searchsorted(self._ends, self._next, side="right")]))
        first, last = int(self._rows[self._next]), int(self._rows[end - 1]) + 1
        if not self._pacing.wait(last - int(self._rows[0]), 0, timeout):
            return None
        self._next = end
        samples = np.column_stack([values[first:last] for values in self._values])
        return Block(first, samples, time.monotonic())
