"""Least and largest values of bins of samples, for charts on which no peak may be lost. No clock, no file."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

STEP: Final = 10
"""Bins of one level that make a bin of the next."""


class Bins(NamedTuple):
    """Bins that follow each other.

    Attributes
    ----------
    first
        Number of the first bin; bin k holds the ticks from k times its width on.
    least, largest
        Least and largest values, shape (n, c); NaN where a bin has none.
    """

    first: int
    least: Array
    largest: Array


class Extremes:
    """From samples to bins; what comes out does not depend on how the samples came cut.

    Parameters
    ----------
    columns
        Number of channels, c.
    width
        Ticks of a bin.
    step
        Ticks from one sample to the next.
    longest
        Bins of a gap that are given as empty ones; of a longer gap, the last of them are.
    """

    def __init__(self, columns: int, width: int, *, step: int = 1, longest: int = 1000) -> None:
        if width < step or step < 1:
            raise ValueError(f"a bin of {width} ticks holds no sample every {step} ticks")
        self._columns, self._width, self._step, self._longest = columns, width, step, longest
        self._next: int | None = None
        self._least = np.full(columns, np.nan)
        self._largest = np.full(columns, np.nan)

    def push(self, tick: int, samples: Array) -> Bins:
        """Take samples, shape (n, c), the first at `tick`; return the bins that no later sample can fall into."""
        width, step = self._width, self._step
        count = samples.shape[0]
        bins = (tick + step * np.arange(count)) // width
        end = (tick + step * count) // width
        if self._next is None:
            self._next = tick // width
        first = max(min(self._next, end), end - self._longest - count)
        if end < self._next:  # a source that has begun to count anew
            self._next, first = tick // width, tick // width
            self._least[:], self._largest[:] = np.nan, np.nan
        least = np.full((end - first + 1, self._columns), np.nan)
        largest = np.full((end - first + 1, self._columns), np.nan)
        if first == self._next:
            least[0], largest[0] = self._least, self._largest
        if count:
            starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
            places = bins[starts] - first
            least[places] = np.fmin(least[places], np.fmin.reduceat(samples, starts, axis=0))
            largest[places] = np.fmax(largest[places], np.fmax.reduceat(samples, starts, axis=0))
        self._next, self._least, self._largest = end, least[-1].copy(), largest[-1].copy()
        return Bins(first, least[:-1], largest[:-1])


class Strip:
    """The last bins of some channels, at several widths.

    Parameters
    ----------
    columns
        Number of channels, c.
    kept
        Bins that are kept of each level; a bin of a level is `STEP` bins of the level before.
    """

    def __init__(self, columns: int, kept: tuple[int, ...]) -> None:
        self._kept = kept
        self._rings = [np.full((2, size, columns), np.nan, dtype=np.float32) for size in kept]
        self._ends: list[int | None] = [None] * len(kept)
        self._begins = [0] * len(kept)

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self._kept)

    def extend(self, bins: Bins) -> None:
        """Take bins of the first level, in order; bins that were left out are empty."""
        stop = bins.first + bins.least.shape[0]
        end = self._ends[0]
        if end is not None and bins.first < end:  # the count began anew
            self._ends = [None] * self.levels
            end = None
        for level, size in enumerate(self._kept):
            width = STEP**level
            reached = stop // width
            begin = self._ends[level]
            if begin is None:
                begin = self._begins[level] = bins.first // width
            begin = max(begin, reached - size)
            if reached > begin:
                self._rings[level][:, np.arange(begin, reached) % size] = (
                    _laid(bins, begin, reached) if level == 0 else self._merged(level, begin, reached)
                )
            self._ends[level] = reached

    def end(self, level: int) -> int:
        """Number of the bin after the last one of a level; 0 where there is none yet."""
        return self._ends[level] or 0

    def since(self, level: int, first: int) -> Bins:
        """Return the bins of a level from number `first` on, as far as they are kept."""
        size, end = self._kept[level], self.end(level)
        first = min(max(first, end - size, self._begins[level]), end)
        ring = self._rings[level][:, np.arange(first, end) % size]
        return Bins(first, ring[0], ring[1])

    def _merged(self, level: int, begin: int, reached: int) -> Array:
        size = self._kept[level - 1]
        first = max(begin * STEP, reached * STEP - size)
        fine = self._rings[level - 1][:, np.arange(first, reached * STEP) % size]
        missing = first - begin * STEP
        if missing:
            empty = np.full((2, missing, fine.shape[2]), np.nan, dtype=np.float32)
            fine = np.concatenate((empty, fine), axis=1)
        grouped = fine.reshape(2, reached - begin, STEP, -1)
        return np.stack((np.fmin.reduce(grouped[0], axis=1), np.fmax.reduce(grouped[1], axis=1)))


def _laid(bins: Bins, begin: int, reached: int) -> Array:
    """Bins from `begin` to `reached`; empty before the first."""
    laid = np.full((2, reached - begin, bins.least.shape[1]), np.nan)
    from_, into = max(0, begin - bins.first), max(0, bins.first - begin)
    laid[0, into:], laid[1, into:] = bins.least[from_:], bins.largest[from_:]
    return laid
