"""One clock for all columns of a file, from the clocks of its columns or from a column of time stamps.

`on_one_clock` puts columns that each state a rate and a start on the clock of the fastest; `steady_clock_of` finds the
rate and the start that time stamps have, where they are evenly spaced.
"""

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
"""Drift between two clocks over a record, in sampling intervals [1], below which they count as of equal rate."""

FARTHEST: Final = 1e15
"""Samples by which two clocks may start apart: what counts them is exact up to there."""


def on_one_clock(raw: RawColumns) -> RawColumns:
    """Return the columns of a file, each with a clock of its own, on the clock of the fastest.

    Columns of the highest rate keep their samples as they are. The clock spans the time that all of them cover;
    where their starts differ, each reading stands in the row nearest to its own time, and what is left, at most half
    an interval, becomes the delay of the column's sensor, so that nothing is lost by interpolation.

    Slower columns are interpolated linearly, by their own start times. They are held for one of their own intervals
    before their first sample and after their last, and missing (NaN) beyond. Interpolation adds no information:
    nothing above half of its own rate is in a slow column, linear interpolation leaves about sinc^2(f / rate) of the
    amplitude of a tone at f (0.4 of it at half the rate, 0.97 at a tenth), and the noise is correlated from row to
    row. That suits angles, pressures and temperatures; a load or an acceleration belongs on the fast clock.

    Parameters
    ----------
    raw
        Columns, each with a clock.

    Returns
    -------
    RawColumns
        The same columns, all of n cells, with a common `rate` [Hz] and `start` [s].

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
    shifts = [_shift(raw, *one, origin=origin, interval=interval) for one in zip(raw.columns, clocks, strict=True)]
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
            # start times are differences of stamps that count from 1904: less than a nanosecond is rounding
            sensor = replace(column.sensor, delay=delay if abs(delay) > 1e-9 else 0.0)
            placed.append(replace(column, values=values, clock=None, sensor=sensor))
        else:
            placed.append(replace(column, values=_interpolated(column.values, clock, time), clock=None))
    rate = float(f"{1 / interval:.15g}")  # 25000 and not 24999.999999999996 where the interval is 40 us
    return RawColumns(raw.path, tuple(placed), range(1, rows + 1), rate=rate, start=float(time[0]), epoch=raw.epoch)


def _clock(raw: RawColumns, column: RawColumn) -> Clock:
    """Clock of a column; refuse one without."""
    if column.clock is None:
        raise ReadError(
            raw.path,
            column.place,
            "does not state its sampling rate; give rate or time under [file] in a channel map, which then holds for "
            "all channels, or leave this one out",
        )
    return column.clock


def _shift(raw: RawColumns, column: RawColumn, clock: Clock, *, origin: float, interval: float) -> int:
    """Whole intervals from an instant to the start of a column; refuse what cannot be counted."""
    with np.errstate(all="ignore"):
        shift = float(np.float64(clock.start - origin) / np.float64(interval))
    if not abs(shift) < FARTHEST:
        raise ReadError(
            raw.path,
            column.place,
            f"starts {clock.start - origin:.3g} s from the start of the fastest, which is no number of samples of "
            f"{interval:.3g} s: the file is damaged",
        )
    return round(shift)


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
    """Values (m,) interpolated linearly at times [s], shape (n,): held for one interval at the ends, NaN beyond."""
    if values.size == 0:
        return np.full(time.shape, np.nan)
    own = clock.start + np.arange(values.size) * clock.interval
    found = np.interp(time, own, values)
    # stamps are rounded: a row one interval off must not be lost by the last digits
    reach = (1 + 5e-7) * clock.interval
    found[(time < own[0] - reach) | (time > own[-1] + reach)] = np.nan
    return found


def of_one_length(raw: RawColumns) -> RawColumns:
    """Return the columns as they are, if all have the same number of cells.

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
    """Return start and interval [s] of evenly spaced time stamps, by least squares; None where they are not even.

    They are not where one departs from the fit by `JITTER_ALLOWED` of an interval. The times are read twice, piece by
    piece, so that a long column is never in memory as a whole.

    Parameters
    ----------
    read
        Gives the times [s] of the samples from one number to another, the last not included.
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
        # not by the linear algebra, whose threads would wait for the next piece in a busy loop
        along += float(np.einsum("i,i->", places - middle, since))
    # slope of the straight line: sum of (k - middle)^2 is n (n^2 - 1) / 12
    interval = along / (samples * (samples**2 - 1.0) / 12) if samples > 1 else np.nan
    start = total / samples - interval * middle
    if not interval > 0:
        return None
    for places, part in pieces():
        if not np.max(np.abs(part - origin - start - interval * places)) < JITTER_ALLOWED * interval:
            return None
    return Clock(origin + start, interval)
