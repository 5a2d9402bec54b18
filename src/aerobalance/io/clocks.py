"""Clocks of the columns of a file: those that each have one of their own put on one, and the steady one of stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.io.columns import PIECE, Clock, RawColumn, RawColumns
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality
from aerobalance.recording.recording import JITTER_ALLOWED

DRIFT_ALLOWED: Final = 0.1
"""Sampling intervals by which two clocks may run apart over a record and still count as of equal rate."""


def on_one_clock(raw: RawColumns) -> RawColumns:
    """Put columns that each have a clock of their own on the clock of the fastest.

    Columns of the highest rate keep their samples as they are. The clock spans the time that all of them cover;
    where their starts differ, each reading stands in the row nearest to its own time, and what is left, at most half
    an interval, becomes the delay of the column's sensor, so that nothing is lost by interpolation.

    Slower columns are interpolated linearly, by their own start times. They are held for one of their own intervals
    before their first sample and after their last, and missing beyond. A column that is more than twice slower keeps
    what it has, no more: nothing above half of its own rate is in it, linear interpolation leaves about
    sinc^2(f / rate) of a tone at f (0.4 of it at half the rate, 0.97 at a tenth), and its noise is correlated from
    row to row. That suits angles, pressures and temperatures; a load or an acceleration belongs on the fast clock.

    Parameters
    ----------
    raw
        Columns, each with a clock.

    Returns
    -------
    RawColumns
        The same columns, all of n cells, with `rate` and `start`.

    Raises
    ------
    ReadError
        A column has no clock; the fastest columns have no time in common.

    Warns
    -----
    DataQualityWarning
        The fastest columns do not cover the same time, and more than two samples at the ends are left out.
    """
    clocks = [_clock(raw, column) for column in raw.columns]
    interval = min(clock.interval for clock in clocks)
    longest = max(column.values.size for column in raw.columns)
    peers = [abs(clock.interval - interval) * longest < DRIFT_ALLOWED * interval for clock in clocks]
    origin = clocks[peers.index(True)].start
    shifts = [round((clock.start - origin) / interval) for clock in clocks]
    ends = [shift + column.values.size for shift, column in zip(shifts, raw.columns, strict=True)]
    first = max(shift for shift, peer in zip(shifts, peers, strict=True) if peer)
    last = min(end for end, peer in zip(ends, peers, strict=True) if peer)
    _check_overlap(raw, peers, (first, last))
    rows = last - first
    time: Array = origin + (first + np.arange(rows, dtype=np.float64)) * interval
    placed = []
    for column, clock, peer, shift in zip(raw.columns, clocks, peers, shifts, strict=True):
        if peer:
            delay = origin + shift * interval - clock.start
            values = column.values[first - shift : last - shift]
            # Start times are differences of stamps that count from 1904: below a nanosecond there is nothing in them.
            sensor = replace(column.sensor, delay=delay if abs(delay) > 1e-9 else 0.0)
            placed.append(replace(column, values=values, clock=None, sensor=sensor))
        else:
            placed.append(replace(column, values=_interpolated(column.values, clock, time), clock=None))
    rate = float(f"{1 / interval:.15g}")  # 25000 and not 24999.999999999996 where the interval is 40 us
    return RawColumns(raw.path, tuple(placed), range(1, rows + 1), rate=rate, start=float(time[0]), epoch=raw.epoch)


def _clock(raw: RawColumns, column: RawColumn) -> Clock:
    if column.clock is None:
        raise ReadError(
            raw.path,
            column.place,
            "does not state its sampling rate; give rate or time under [file] in a channel map, which then holds for "
            "all channels, or leave this one out",
        )
    return column.clock


def _check_overlap(raw: RawColumns, peers: list[bool], span: tuple[int, int]) -> None:
    """Refuse a span without samples; warn of one that leaves samples out."""
    rows = span[1] - span[0]
    fastest = [column for column, peer in zip(raw.columns, peers, strict=True) if peer]
    if rows < 2:
        raise ReadError(
            raw.path, "", f"the channels {', '.join(column.label for column in fastest)} have no two samples in common"
        )
    lost = max(column.values.size for column in fastest) - rows
    if lost > 2:
        sizes = ", ".join(f"{column.label} {column.values.size}" for column in fastest)
        warn_quality(
            f"{raw.path.name}: the fastest channels do not cover the same time (samples: {sizes}); the recording is "
            f"the {rows} samples that they have in common, and up to {lost} others are left out"
        )


def _interpolated(values: Array, clock: Clock, time: Array) -> Array:
    """Interpolate linearly, held for one interval at the ends, NaN beyond."""
    if values.size == 0:
        return np.full(time.shape, np.nan)
    own = clock.start + np.arange(values.size) * clock.interval
    found = np.interp(time, own, values)
    # Half a millionth of an interval is the rounding of the stamps.
    reach = (1 + 5e-7) * clock.interval
    found[(time < own[0] - reach) | (time > own[-1] + reach)] = np.nan
    return found


def of_one_length(raw: RawColumns) -> RawColumns:
    """Make sure that all columns have as many cells.

    Raises
    ------
    ReadError
        They have not; the message names two of them.
    """
    if raw.columns:
        by_size = sorted(raw.columns, key=lambda column: column.values.size)
        least, most = by_size[0], by_size[-1]
        if least.values.size != most.values.size:
            raise ReadError(
                raw.path,
                "",
                f"{least.label!r} has {least.values.size} samples and {most.label!r} has {most.values.size}; one time "
                "column or one rate holds for channels of one length only (those that state their own rate need "
                "neither)",
            )
    return raw


def steady_clock_of(read: Callable[[int, int], Array], samples: int) -> Clock | None:
    """The steady clock that fits a column of times by least squares; None where a stamp departs from it.

    Parameters
    ----------
    read
        Times of the samples from one to another (not included) [s].
    samples
        Number of samples.
    """

    def pieces() -> Iterator[tuple[NDArray[np.intp], Array]]:
        for begin in range(0, samples, PIECE):
            end = min(begin + PIECE, samples)
            yield np.arange(begin, end), read(begin, end)

    origin = float(read(0, 1)[0])
    middle = (samples - 1) / 2
    total = along = 0.0
    for places, part in pieces():
        since = part - origin
        total += float(since.sum())
        along += float((places - middle) @ since)
    interval = along / (samples * (samples**2 - 1.0) / 12) if samples > 1 else np.nan
    start = total / samples - interval * middle
    if not interval > 0:
        return None
    for places, part in pieces():
        if not np.max(np.abs(part - origin - start - interval * places)) < JITTER_ALLOWED * interval:
            return None
    return Clock(origin + start, interval)
