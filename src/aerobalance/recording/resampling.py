"""Series at other instants: on a finer clock, delayed by parts of a sample, across gaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import FitError
from aerobalance.recording.linalg import conditional_weights

FINE: Final = 4
"""Steps into which a sampling interval is divided where readings drive a balance between samples."""

SHARPNESS: Final = 12.0
"""Parameter of the Kaiser window of the interpolation.

It leaves errors below 3e-6 up to 0.3 of the sampling rate. A component may feel a hundred times the force that is to
be found in another.
"""

REACH: Final = 10
"""Samples on either side that an interpolated value is made from."""

EDGE: Final = 12
"""Samples at either end of a record that the window of the band-limited interpolation reaches beyond."""

AROUND: Final = 200
"""Samples either side of a gap that its readings are predicted from."""

PLACES: Final = 6
"""Decimal places of a sampling interval beyond which a place is rounding."""

OFTEN: Final = 16
"""Gaps of one length from which on the inverse of their window is worth its time: that of some ten solutions."""

EXACT: Final = 1e-9
"""Share of a channel's variance that its samples are taken to be exact to when a gap is filled."""


def upsample(series: Array) -> Array:
    """Return a band-limited series, shape (samples, ...), on a clock `FINE` times as fast; (FINE samples, ...)."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - takes 30 ms, and few records need it

    first = series[:1]
    fine = first + _between(series - first)
    # near the ends the window reaches beyond the record: a spline through the samples there knows better
    count = series.shape[0]
    near, part = min(EDGE, count), min(4 * EDGE, count)
    clock = np.arange(part)
    fine[: FINE * near] = CubicSpline(clock, series[:part])(np.arange(FINE * near) / FINE)
    late = np.arange(FINE * (count - near), FINE * count) / FINE - (count - part)
    fine[FINE * (count - near) :] = CubicSpline(clock, series[count - part :])(np.minimum(late, part - 1))
    return fine


def _between(series: Array) -> Array:
    """Return a series on the finer clock by the window alone; straight lines go on beyond its ends."""
    count, width = series.shape[0], series.shape[1:]
    series = series.reshape(count, -1)
    slope = (series[-1] - series[0]) / max(count - 1, 1)
    beyond = np.arange(1, REACH + 1)[:, None] * slope
    padded = np.concatenate([series[0] - beyond[::-1], series, series[-1] + beyond])
    place = np.arange(-REACH * FINE, REACH * FINE + 1)
    taps = np.sinc(place / FINE) * np.kaiser(place.size, SHARPNESS)
    taps *= FINE / taps.sum()
    phases = np.append(taps, np.zeros(FINE - 1)).reshape(-1, FINE)[::-1]
    between = np.empty((FINE * count, padded.shape[1]))
    for number, column in enumerate(np.ascontiguousarray(padded.T)):
        between[:, number] = (sliding_window_view(column, len(phases)) @ phases).ravel()
    return between.reshape(FINE * count, *width)


def at_places(values: Array, places: Array) -> tuple[Array, Array]:
    """A band-limited series and its slope at any places between its samples [samples], shape (m,) each."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - takes 30 ms, and few commands need it

    fine = upsample(values)
    spline = CubicSpline(np.arange(fine.size) / (fine.size / values.size), fine)
    return spline(places), spline(places, 1)


def upsample_compensated(series: Array) -> Array:
    """Return the upsampled series, compensated for a first-order hold, shape (FINE samples, c).

    A system that takes straight lines between the points (a first-order hold) then answers as to the series itself:
    straight lines lose (w h)^2 / 12 of a sine of angular frequency w; a twelfth of the second difference, taken off
    beforehand, gives it back, and what is lost is (w h)^4 / 240.
    """
    count = series.shape[0]
    fine = upsample(series)
    bend = np.diff(fine[: FINE * (count - 1) + 1], 2, axis=0) / 12
    fine[: FINE * (count - 1) + 1] -= np.concatenate([bend[:1], bend, bend[-1:]])
    return fine


def fractional_delay(series: Array, *, delay: float, interval: float) -> Array:
    """Return a band-limited series, shape (samples, ...), delayed by any time [s].

    Less than a sample beyond its ends it goes on as it goes there; farther out it is held.

    Parameters
    ----------
    series
        Samples without gaps.
    delay
        Time by which the result lags the series; negative where it leads [s].
    interval
        Time between samples [s].
    """
    if not delay or not series.any():
        return series
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - takes 30 ms, and few records need it

    count = series.shape[0]
    fine = upsample(series)[: FINE * (count - 1) + 1]
    place = np.clip(np.arange(count) - delay / interval, -1.0, float(count))
    return CubicSpline(np.arange(fine.shape[0]) / FINE, fine)(place)


def held_by_delays(count: int, *, delays: Sequence[float], interval: float) -> NDArray[np.bool_]:
    """Where `fractional_delay` by any of some times [s] holds a series, over a sample beyond its ends, (count,)."""
    held = np.zeros(count, dtype=bool)
    for delay in delays:
        place = np.arange(count) - delay / interval
        held |= (place < -1.0) | (place > count)
    return held


def align_channels(loads: Array, channels: Sequence[Channel], *, to: Channel, interval: float) -> Array:
    """Return loads at the instants at which one channel was sampled, shape (samples, n).

    Parameters
    ----------
    loads
        Readings without gaps, shape (samples, n).
    channels
        The n channels, with the times by which they lag the clock.
    to
        The channel whose instants are wanted.
    interval
        Time between samples [s].
    """
    delays = [to.delay - channel.delay for channel in channels]
    if not any(delays):
        return loads
    return np.column_stack(
        [
            fractional_delay(column, delay=delay, interval=interval)
            for column, delay in zip(loads.T, delays, strict=True)
        ]
    )


def on_one_delay(readings: Array, channels: Sequence[Channel], *, delay: float, interval: float) -> Array:
    """Return readings with gaps as if all their channels had one delay [s], shape (n, c).

    What is interpolated with a missing reading is missing, as is what lies before the first or after the last.

    Parameters
    ----------
    readings
        Shape (n, c); NaN where one is missing.
    channels
        The c channels.
    delay
        The delay that all are brought to [s].
    interval
        Time between samples [s].
    """
    moved, count = readings, readings.shape[0]
    for index, channel in enumerate(channels):
        by = delay - channel.delay
        if not by:
            continue
        known = np.isfinite(readings[:, index])
        if not known.any():
            continue
        moved = readings.copy() if moved is readings else moved
        late = round(by / interval, PLACES)
        gap = ~known if late == round(late) else np.convolve(~known, np.ones(2 * REACH), "same") > 0
        after = np.clip(np.ceil(np.arange(count) - late).astype(np.intp), 0, count - 1)
        lost = held_by_delays(count, delays=[by], interval=interval) | gap[after]
        filled = interpolate_gaps_linearly(readings[:, index])
        moved[:, index] = np.where(lost, np.nan, fractional_delay(filled, delay=by, interval=interval))
    return moved


# Gaps are filled in three ways, as three things differ. A load is divided by the balance's response, so straight lines
# would look like sudden forces: it is predicted. Motions, angles and spectra only need something harmless: straight
# lines. A stream does not know what comes after a gap: it holds.


def interpolate_gaps(loads: Array) -> Array:
    """Return loads with their gaps filled from the samples around them, shape (samples, n); themselves without gaps.

    The best linear prediction of a process with the record's own autocovariance.
    """
    if np.isfinite(loads).all():
        return loads
    filled = loads.copy()
    index = np.arange(loads.shape[0])
    for column in filled.T:
        gap = ~np.isfinite(column)
        if not gap.any():
            continue
        if gap.all():
            raise FitError("no reading is present")
        column[gap] = np.interp(index[gap], index[~gap], column[~gap])
        mean = column.mean()
        power = np.abs(np.fft.rfft(column - mean, 2 * column.size)) ** 2
        covariance = np.fft.irfft(power)[: column.size] / column.size
        if not covariance[0] > 0:
            continue  # constant: the straight line is all there is
        gaps = gaps_in(gap)
        lengths, counts = np.unique([last - first for first, last in gaps], return_counts=True)
        often = {int(length) for length, count in zip(lengths, counts, strict=True) if count >= OFTEN}
        inverses: dict[int, Array] = {}
        for first, last in gaps:
            window = index[max(first - AROUND, 0) : last + AROUND]
            lost = gap[window]
            known = window[~lost]
            if last - first in often and window.size == last - first + 2 * AROUND:
                if last - first not in inverses:
                    inverses[last - first] = np.asarray(np.linalg.inv(_covariance_of(window, covariance)))
                own = (window >= first) & (window < last)
                weights = conditional_weights(inverses[last - first], lost, ~lost)[own[lost]].T
            else:
                across = _covariance_of(known, covariance)
                weights = np.linalg.solve(across, covariance[np.abs(known[:, None] - np.arange(first, last))])
            column[first:last] = mean + weights.T @ (column[known] - mean)
    return filled


def _covariance_of(samples: NDArray[np.intp], covariance: Array) -> Array:
    """Covariance of samples of a process of known autocovariance, which are exact to `EXACT`, shape (m, m)."""
    exact = EXACT * covariance[0] * np.eye(samples.size)
    return np.asarray(covariance[np.abs(samples[:, None] - samples)] + exact)


def interpolate_gaps_linearly(values: Array, *, beside: int = 1) -> Array:
    """Return readings with straight lines across their gaps, the first or last reading held at the ends, shape (n,).

    Parameters
    ----------
    values
        Readings, shape (n,); NaN where one is missing.
    beside
        Readings on either side of a gap, at most, whose means the line joins, up to a quarter of the gap's length: a
        line between two single readings is as uncertain as they are.

    Raises
    ------
    FitError
        There is no reading.
    """
    present = np.isfinite(values)
    if present.all():
        return values
    place, known = np.arange(values.size), np.flatnonzero(present)
    if not known.size:
        raise FitError("no reading is present")
    filled = np.interp(place, known, values[known])
    for first, last in gaps_in(~present) if beside > 1 else []:
        count = int(np.clip((last - first) // 4, 1, beside))
        middle = int(np.searchsorted(known, first))
        sides = known[max(middle - count, 0) : middle], known[middle : middle + count]
        ends = np.array([(side.mean(), values[side].mean()) for side in sides if side.size])
        filled[first:last] = np.interp(place[first:last], ends[:, 0], ends[:, 1])
    return filled


def hold_over_gaps(values: Array, last: Array) -> Array:
    """Return samples with missing ones held at the last that was there (a zero-order hold), shape (m, c).

    Parameters
    ----------
    values
        Samples of c channels, shape (m, c); NaN where one is missing.
    last
        What to hold before the first, shape (c,).
    """
    there = np.isfinite(values)
    if there.all():
        return values
    whole = np.vstack([last, values])
    place = np.where(np.vstack([np.ones_like(there[:1]), there]), np.arange(whole.shape[0])[:, None], 0)
    return np.take_along_axis(whole, np.maximum.accumulate(place, axis=0), axis=0)[1:]


def gaps_in(gap: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first sample of every gap and the first one after it, from where samples are missing, shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], gap, [False]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def interpolation(shift: float) -> tuple[Array, int]:
    """Weights of samples in values on the fine clock, shape (FINE, taps), and the distance of the first [samples]."""
    place = np.arange(FINE) / FINE - shift
    first = int(np.floor(place[0])) - REACH + 1
    last = int(np.floor(place[-1])) + REACH
    distance = np.arange(first, last + 1) - place[:, None]
    inside = np.abs(distance) < REACH
    window = np.i0(SHARPNESS * np.sqrt(np.where(inside, 1 - (distance / REACH) ** 2, 0.0))) * inside
    weights = np.sinc(distance) * window
    return np.ascontiguousarray(weights / weights.sum(axis=1, keepdims=True)), first
