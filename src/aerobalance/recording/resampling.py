"""Series at other instants: on a finer clock, later by parts of a sample, across gaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly

from aerobalance.recording.channel import Array, Channel

FINE: Final = 4
"""Steps into which a sampling interval is divided where readings drive a balance between samples."""

SHARPNESS: Final = 12.0
"""Parameter of the Kaiser window of the interpolation.

It leaves errors below 3e-6 up to 0.3 of the sampling rate. A component may feel a hundred times the force that is to
be found in another.
"""

EDGE: Final = 12
"""Samples at either end of a record that the window of the band-limited interpolation reaches beyond."""

AROUND: Final = 200
"""Samples either side of a gap from which it is filled at first."""

EXACT: Final = 1e-9
"""Share of a channel's variance that its samples are taken to be exact to when a gap is filled."""


def interpolated(series: Array) -> Array:
    """Series (samples, c) on a clock `FINE` times as fast, band-limited; shape (FINE samples, c)."""
    first = series[:1]
    fine = np.asarray(
        first + resample_poly(series - first, FINE, 1, axis=0, window=("kaiser", SHARPNESS), padtype="line")
    )
    # near the ends the window reaches beyond the record: a spline through the samples there knows better
    count = series.shape[0]
    near, part = min(EDGE, count), min(4 * EDGE, count)
    clock = np.arange(part)
    fine[: FINE * near] = CubicSpline(clock, series[:part])(np.arange(FINE * near) / FINE)
    late = np.arange(FINE * (count - near), FINE * count) / FINE - (count - part)
    fine[FINE * (count - near) :] = CubicSpline(clock, series[count - part :])(np.minimum(late, part - 1))
    return fine


def finer(series: Array) -> Array:
    """The same, such that straight lines between its points do it no harm.

    Straight lines between samples lose (w h)^2 / 12 of a sine of angular frequency w; a twelfth of the second
    difference, taken off beforehand, gives it back, and what is lost is (w h)^4 / 240.
    """
    count = series.shape[0]
    fine = interpolated(series)
    bend = np.diff(fine[: FINE * (count - 1) + 1], 2, axis=0) / 12
    fine[: FINE * (count - 1) + 1] -= np.concatenate([bend[:1], bend, bend[-1:]])
    return fine


def bridged(loads: Array) -> Array:
    """Loads with their gaps filled from the samples around them, shape (samples, n).

    The best guess of a process with the record's own autocovariance: straight lines would look like sudden forces.
    """
    filled = loads.copy()
    index = np.arange(loads.shape[0])
    for column in filled.T:
        gap = ~np.isfinite(column)
        if not gap.any():
            continue
        column[gap] = np.interp(index[gap], index[~gap], column[~gap])
        mean = column.mean()
        power = np.abs(np.fft.rfft(column - mean, 2 * column.size)) ** 2
        covariance = np.fft.irfft(power)[: column.size] / column.size
        for first, last in _runs(gap):
            known = index[max(first - AROUND, 0) : last + AROUND]
            known = known[~gap[known]]
            across = covariance[np.abs(known[:, None] - known)] + EXACT * covariance[0] * np.eye(known.size)
            weights = np.linalg.solve(across, covariance[np.abs(known[:, None] - np.arange(first, last))])
            column[first:last] = mean + weights.T @ (column[known] - mean)
    return filled


def _runs(gap: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First sample of every gap and the first one after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], gap, [False]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def at_instants(loads: Array, channels: Sequence[Channel], *, to: Channel, interval: float) -> Array:
    """Loads at the instants at which one channel was sampled, shape (samples, n)."""
    late = [channel.delay - to.delay for channel in channels]
    if not any(late):
        return loads
    return np.column_stack([later(column, by, interval=interval) for column, by in zip(loads.T, late, strict=True)])


def later(series: Array, by: float, *, interval: float) -> Array:
    """A band-limited series, shape (samples, ...), at instants that are later by so much [s].

    Less than a sample beyond its ends it goes on as it goes there; farther out it is held.
    """
    if not by or not series.any():
        return series
    count = series.shape[0]
    fine = interpolated(series)[: FINE * (count - 1) + 1]
    place = np.clip(np.arange(count) + by / interval, -1.0, float(count))
    return np.asarray(CubicSpline(np.arange(fine.shape[0]) / FINE, fine)(place))
