"""The last readings of a stream."""

from __future__ import annotations

import numpy as np

from aerobalance.recording.channel import Array


class RecentReadings:
    """The last readings, as many as are wanted at least.

    Parameters
    ----------
    most
        Readings that are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._values = np.empty(0)
        self._first = self._stop = 0

    @property
    def stop(self) -> int:
        """Number after the newest."""
        return self._stop

    def append(self, values: Array) -> None:
        """Add readings."""
        used = self._stop - self._first
        if used + values.size > self._values.size:
            kept = min(used, self._most)
            room = np.empty(2 * (kept + values.size) + self._most)
            room[:kept] = self._values[used - kept : used]
            self._first, self._values = self._stop - kept, room
            used = kept
        self._values[used : used + values.size] = values
        self._stop += values.size

    def between(self, first: int, stop: int) -> Array:
        """Return the readings from a number up to another, shape (stop - first,).

        Raises
        ------
        ValueError
            The first is no longer kept.
        """
        if first < self._first:
            raise ValueError(f"reading {first} is no longer kept; the oldest is {self._first}")
        return self._values[first - self._first : stop - self._first].copy()
