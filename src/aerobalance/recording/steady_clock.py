"""The steady clock behind a column of time stamps: rounded, repeated, or with samples missing."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, warn_quality

GAP_SUSPECTED: Final = 0.2
"""Departure from evenly spaced rows from which gaps are looked for: one sample lost from five departs by 0.21."""

RATE_KNOWN: Final = 1e-4
"""Relative uncertainty of the sampling rate up to which rounded time stamps are taken for a clock."""

LARGEST_GAP_RATIO: Final = 20
"""Samples of the steady clock per row of the file beyond which the recording has to be cut at its gaps."""


AT_ONCE: Final = 1 << 15
"""Stamps that are worked on at once: as many as the processor keeps at hand."""


class SteadyClock(NamedTuple):
    """The steady clock that fits a time column best.

    Attributes
    ----------
    rows
        Sample of the clock that each row stands for, shape (m,).
    interval, start
        Of the clock [s].
    departure
        Largest departure of a stamp from it [intervals].
    rounded
        Whether the stamps depart because they are rounded to more than an interval.
    """

    rows: NDArray[np.intp]
    interval: float
    start: float
    departure: float
    rounded: bool

    def late(self, stamps: Array) -> Array:
        """Time by which each stamp is after its sample of the clock, shape (m,) [intervals]."""
        late: Array = (stamps - self.start) / self.interval - self.rows
        return late


def seconds_of_stamps(stamps: ArrayLike, name: str) -> Array:
    """Return time stamps in seconds, shape as given [s]; dates and times count from the first of them.

    Parameters
    ----------
    stamps
        Seconds; or dates and times, as NumPy, pandas or Python have them; or differences of these.
    name
        What the recording is called in messages.

    Raises
    ------
    ValueError
        A date is missing, or a stamp is neither number nor date.
    """
    given = np.asarray(stamps)
    if given.dtype.kind in "mM":
        missing = np.flatnonzero(np.isnat(given))
        if missing.size:
            raise ValueError(f"{name}: time stamp {int(missing[0]) + 1} of {given.size} is missing (NaT)")
        since = given - given[:1] if given.dtype.kind == "M" else given
        return np.asarray(since / np.timedelta64(1, "s"), dtype=np.float64)
    if given.dtype.kind == "O" and given.size and isinstance(given.flat[0], datetime):
        try:
            return np.array([(one - given.flat[0]).total_seconds() for one in given.flat]).reshape(given.shape)
        except TypeError:
            raise ValueError(f"{name}: the time stamps are not all dates, or not all with a time zone") from None
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name}: time stamps must be seconds, or dates and times (datetime64), not {given.flat[0]!r}"
        ) from None


def steady_clock(stamps: Array, name: str) -> SteadyClock:
    """Find the steady clock behind a time column, and warn of what is missing or rounded."""
    steps = _checked_steps(stamps, name)
    order = np.arange(stamps.size, dtype=np.intp)
    interval, start, departure = _fitted(order, stamps)
    if departure > GAP_SUSPECTED:
        found = _rows_with_gaps(stamps, steps, name)
        if found is not None:
            order = found
            interval, start, departure = _fitted(order, stamps)
    shortest = float(np.min(steps))
    repeated = 0 if shortest > 0 else int(np.count_nonzero(steps == 0))
    resolution = float(np.min(steps[steps > 0])) if repeated else shortest
    rounded = departure > 1.0 and repeated > 0 and departure * interval <= resolution
    remarks = []
    if rounded:
        interval, start, known = _between_turns(stamps, steps, name, resolution)
        departure = float(np.abs((stamps - start) / interval - order).max())
        remarks.append(
            f"the time column is rounded to {resolution:.3g} s, more than a sampling interval; the samples are "
            f"taken as evenly spaced at {1 / interval:.6g} Hz (known to {100 * known:.1g} %), and a gap in them "
            "would not be seen"
        )
    missing = int(order[-1]) + 1 - order.size
    if missing:
        remarks.append(
            f"{missing} sample(s) are missing from the time column in {int(np.count_nonzero(np.diff(order) > 1))} "
            "gap(s); the model bridges them, with a larger uncertainty"
        )
    for remark in remarks:
        warn_quality(f"{name}: {remark}")
    return SteadyClock(order, interval, start, departure, rounded)


def _between_turns(stamps: Array, steps: Array, name: str, resolution: float) -> tuple[float, float, float]:
    """Return interval and start of a clock whose stamps are rounded [s], and the relative uncertainty of its rate.

    Only where a stamp turns to the next is the time known, to one interval: m turns over n samples tell the rate to
    1 / (n sqrt(m)), from the variance of a uniform distribution. All stamps together would count the parts of the
    first and the last one as well, whose lengths are chance.

    Raises
    ------
    FitError
        The turns are too few to tell the rate.
    """
    turns = np.flatnonzero(steps > 0) + 1
    known = 1 / (float(turns[-1] - turns[0]) * np.sqrt(turns.size)) if turns.size > 1 else np.inf
    if known > RATE_KNOWN:
        how = f"to {100 * known:.2g} % only; allowed: {100 * RATE_KNOWN:.2g} %" if np.isfinite(known) else "not at all"
        raise FitError(
            f"{name}: the time column is rounded to {resolution:.3g} s, and its {turns.size} turn(s) tell the "
            f"sampling rate {how}. Frequencies and masses would be wrong by as much and twice that: give the rate in "
            "a channel map (rate = ... under [file], without time), or take a longer record"
        )
    interval, start, _ = _fitted(turns.astype(np.intp), stamps[turns])
    return interval, start, known


def first_repeated(steps: Array, stamps: Array) -> str:
    """Return where the first two samples of the same time stamp are, in words; empty where there are none."""
    rows = np.flatnonzero(steps == 0)
    if not rows.size:
        return ""
    return f" (samples {rows[0] + 1} and {rows[0] + 2} are both at {stamps[rows[0]]:.6g} s)"


def _checked_steps(stamps: Array, name: str) -> Array:
    """Return the steps of a time column, which must be finite and not go back."""
    if stamps.size < 2:
        raise FitError(f"{name}: {stamps.size} row(s) of samples; a recording needs at least two")
    if not np.isfinite(stamps).all():
        row = int(np.flatnonzero(~np.isfinite(stamps))[0]) + 1
        raise FitError(f"{name}: the time of sample {row} is not a number")
    steps: Array = np.diff(stamps)
    if float(np.min(steps)) > 0:
        return steps
    wrong = steps < 0 if (steps > 0).any() else steps <= 0
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0]) + 2
        raise FitError(
            f"{name}: time must increase from row to row, but sample {row} is at {stamps[row - 1]:.6g} s, "
            f"after {stamps[row - 2]:.6g} s"
        )
    return steps


def _fitted(index: NDArray[np.intp], stamps: Array) -> tuple[float, float, float]:
    """Fit stamps = start + interval * index by least squares; return interval [s], start [s], largest departure."""
    middle, mean = float(index.mean()), float(stamps.mean())

    def pieces() -> Iterator[tuple[Array, Array]]:
        """Both less their means, some at a time: memory is slower than all that is done with them."""
        # Stamps less their mean keep microseconds where the clock counts from long ago.
        for first in range(0, index.size, AT_ONCE):
            some = slice(first, first + AT_ONCE)
            yield np.asarray(index[some] - middle, dtype=np.float64), stamps[some] - mean

    across, own = np.sum([(row @ stamp, row @ row) for row, stamp in pieces()], axis=0)
    interval = float(across / own)
    departure = max(float(np.max(np.abs(stamp - interval * row))) for row, stamp in pieces()) / interval
    return interval, mean - interval * middle, departure


def _rows_with_gaps(stamps: Array, steps: Array, name: str) -> NDArray[np.intp] | None:
    """Place the rows on a steady clock with samples missing; None where that explains the stamps no better."""
    usual = float(np.median(steps[steps > 0]))
    interval = float(np.mean(steps[steps < 1.5 * usual]))
    if (stamps[-1] - stamps[0]) / interval > LARGEST_GAP_RATIO * stamps.size:
        longest = int(np.argmax(steps))
        raise FitError(
            f"{name}: time jumps from {stamps[longest]:.6g} s to {stamps[longest + 1]:.6g} s at sample {longest + 2}, "
            f"while samples are {interval:.3g} s apart; cut the recording there"
        )
    # Step by step first, so that an error of the interval does not add up; then all stamps on one line.
    rows = np.concatenate(([0], np.cumsum(np.rint(steps / interval)))).astype(np.intp)
    for _ in range(5):
        if rows[-1] <= 0:
            return None
        interval, start, _ = _fitted(rows, stamps)
        placed = np.rint((stamps - start) / interval).astype(np.intp)
        placed -= placed[0]
        if (placed == rows).all():
            break
        rows = placed
    increments = np.diff(rows)
    if not (increments > 0).all() or rows[-1] == stamps.size - 1:
        return None
    # A clock that wanders slips a sample without a long step; that is no gap.
    mismatch = float(np.max(np.abs(steps / interval - increments)))
    departure = _fitted(rows, stamps)[2]
    return rows if departure <= 0.4 and mismatch < 0.8 else None
