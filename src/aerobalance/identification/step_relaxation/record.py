"""Where in a recording the free decay of several coupled components begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording

FEWEST: Final = 64
"""Readings of all components that a recording of a release must have at least."""

FEWEST_HELD: Final = 16
"""Readings before a release that tell how much they scatter."""

ROUNDING: Final = 1e-10
"""Noise over the largest reading below which readings are taken to be exact to rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class ReleaseRecord:
    """The readings of one recording.

    Attributes
    ----------
    name
        What it is called in messages.
    time
        Times of the rows that have all components, from the first sample, shape (m,) [s].
    values
        Balance loads, shape (m, n) [N, N*m].
    start, rate
        Time of the first sample on the recording's clock [s], and sampling rate [Hz].
    noise
        Standard deviation of one reading, given or judged, shape (n,) [N, N*m].
    onset
        Row at which the ringing sets in, roughly.
    """

    name: str
    time: Array
    values: Array
    start: float
    rate: float
    noise: Array
    onset: int


def release_record(recording: Recording, components: tuple[str, ...]) -> ReleaseRecord:
    """Take the load channels of a recording and find the release in it.

    Raises
    ------
    FitError
        A channel is missing or too few readings can be used.
    """
    channels = [recording.channel(name) for name in components]
    usable = np.ones(recording.samples, dtype=bool)
    for channel in channels:
        saturated = channel.saturated
        if saturated.any():
            warn_quality(
                f"{recording.name}: {int(saturated.sum())} readings of {channel.name} rest on a limit; they are left "
                "out of the fit"
            )
        usable &= np.isfinite(channel.values) & ~saturated
    if np.count_nonzero(usable) < FEWEST:
        raise FitError(
            f"{recording.name}: {np.count_nonzero(usable)} samples with usable readings of {', '.join(components)}; a "
            "release needs many more"
        )
    values = np.column_stack([channel.values for channel in channels])
    largest = np.ptp(values[usable], axis=0)
    judged = np.array([channel_noise(channel) for channel in channels])
    noise = np.maximum(judged, ROUNDING * max(float(largest.max()), np.finfo(float).tiny))
    rows = np.flatnonzero(usable)
    return ReleaseRecord(
        name=recording.name,
        time=rows / recording.rate,
        values=values[usable],
        start=recording.start,
        rate=recording.rate,
        noise=noise,
        onset=_onset(values[usable] / noise),
    )


def _onset(values: Array) -> int:
    """Row at which the scatter after it most exceeds the scatter before it; loads over their noise, shape (m, n)."""
    count = values.shape[0]
    best, place = 0.0, 0
    for part in (8, 32, 128):
        width = max(count // part, 16)
        ratio, rows = _contrast(values, width)
        highest = float(np.max(ratio))
        if highest > 1.05 * best:  # the scatter before grows by orders of magnitude behind the edge, that after little
            best, place = highest, int(rows[np.flatnonzero(ratio > 0.7 * highest)[-1]])
    return _sharpened(values, place) if best > np.log(4.0) else 0


def _sharpened(values: Array, place: int) -> int:
    """The row from which on readings depart from those before by more than these scatter, at `place` or earlier."""
    reach = max(values.shape[0] // 64, 32)
    first = place - reach
    if first < FEWEST_HELD:
        return place
    held: Array = values[:first]
    level = 3 * float(np.mean((held - held.mean(axis=0)) ** 2))
    departure: Array = np.mean((values[first:place] - held.mean(axis=0)) ** 2, axis=1)
    return int(first + np.argmin(np.concatenate(([0.0], np.cumsum(departure - level)))))


def _contrast(values: Array, width: int) -> tuple[Array, NDArray[np.intp]]:
    """Logarithm of the scatter in the window after a row over that in the one before, at the rows that have both."""
    values = values - values.mean(axis=0)
    zero = np.zeros((1, values.shape[1]))
    sums = np.concatenate([zero, np.cumsum(values, axis=0)])
    squares = np.concatenate([zero, np.cumsum(values**2, axis=0)])
    rows = np.arange(8, values.shape[0] - width, dtype=np.intp)
    first = np.maximum(rows - width, 0)

    def scatter(start: NDArray[np.intp], stop: NDArray[np.intp]) -> Array:
        length = (stop - start)[:, None]
        spread = squares[stop] - squares[start] - (sums[stop] - sums[start]) ** 2 / length
        return np.asarray(np.sum(np.maximum(spread, 0.0) / length, axis=1))

    floor = float(values.shape[1])
    return np.log((scatter(rows, rows + width) + floor) / (scatter(first, rows) + floor)), rows
