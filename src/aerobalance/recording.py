"""What flows through the program: a recording of named channels, the loads felt, the force applied."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.channel import Array, Channel
from aerobalance.components import COMPONENTS, is_gauge
from aerobalance.gravity import PullOnZero
from aerobalance.problems import DoubtWarning, FitError

GAUGES_BECOME_LOADS: Final = (
    "gauge outputs become loads by a balance matrix: weigh, identify decay and rig, force and compare take --balance, "
    "and for other commands aerobalance loads --balance writes a recording of the loads"
)
"""What to do with gauge outputs where loads are needed."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Channels that share one steady clock.

    Attributes
    ----------
    name
        What the recording is called in messages (a file name, a rig).
    stamps
        The time column as it was given, shape (m,) [s].
    rows
        Sample of the steady clock that each time stamp belongs to, shape (m,); where stamps are missing,
        the clock has more samples (n) than there are rows (m).
    start
        Time of the first sample of the steady clock [s].
    rate
        Sampling rate [Hz].
    channels
        The channels by name, each of n samples.
    time_unit
        Unit that the time column had in its file, in which it is written again.
    pull_on_zero
        Pull of gravity on the mass whose weight was added to loads that count from a zero read under it.
    """

    name: str
    stamps: Array
    rows: NDArray[np.intp]
    start: float
    rate: float
    channels: Mapping[str, Channel]
    time_unit: str = "s"
    pull_on_zero: PullOnZero = field(default_factory=PullOnZero)

    @classmethod
    def from_columns(
        cls,
        stamps: Array,
        channels: Mapping[str, Channel],
        *,
        name: str = "recording",
        time_unit: str = "s",
    ) -> Recording:
        """Put columns of samples on a steady clock, with missing rows marked as such.

        Parameters
        ----------
        stamps
            Time of every row, shape (m,) [s], increasing.
        channels
            Channels of m readings each.
        name
            What to call the recording in messages.
        time_unit
            Unit that the time column had in its file.

        Raises
        ------
        FitError
            The time column does not increase, or no steady clock fits it.
        ValueError
            A channel has not one reading per row.
        """
        stamps = np.array(stamps, dtype=np.float64)
        for key, channel in channels.items():
            if channel.values.shape != stamps.shape:
                raise ValueError(f"channel {key} has {channel.values.size} readings for {stamps.size} time stamps")
        rows, start, rate = _steady_clock(stamps, name)
        samples = int(rows[-1]) + 1
        placed = {}
        for key, channel in channels.items():
            values = np.full(samples, np.nan)
            values[rows] = channel.values
            placed[key] = Channel(
                **{slot: getattr(channel, slot) for slot in Channel.__slots__ if slot != "values"},
                values=values,
            )
        return cls(name=name, stamps=stamps, rows=rows, start=start, rate=rate, channels=placed, time_unit=time_unit)

    @property
    def samples(self) -> int:
        """Number of samples of the steady clock."""
        return int(self.rows[-1]) + 1

    @property
    def time(self) -> Array:
        """The steady clock, shape (n,) [s]."""
        return self.start + np.arange(self.samples) / self.rate

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (self.samples - 1) / self.rate

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Start and length of every gap in the time column [s]."""
        steps = np.diff(self.rows)
        where = np.flatnonzero(steps > 1)
        return [(float(self.stamps[i]), float((steps[i] - 1) / self.rate)) for i in where]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def __iter__(self) -> Iterator[Channel]:
        return iter(self.channels.values())

    def channel(self, name: str) -> Channel:
        """Return one channel.

        Raises
        ------
        FitError
            The recording has no such channel; the message lists those it has.
        """
        if name not in self.channels:
            gauges = name in COMPONENTS and any(is_gauge(other) for other in self.channels)
            hint = f"; {GAUGES_BECOME_LOADS}" if gauges else ""
            raise FitError(f"{self.name} has no channel {name}; it has {', '.join(self.channels) or 'none'}{hint}")
        return self.channels[name]


def _steady_clock(stamps: Array, name: str) -> tuple[NDArray[np.intp], float, float]:
    """Find the steady clock behind a time column: sample index of every row, start [s], rate [Hz]."""
    steps = _checked_steps(stamps, name)
    order = np.arange(stamps.size, dtype=np.intp)
    interval, start, departure = _fitted(order, stamps)
    if departure > GAP_SUSPECTED:
        found = _rows_with_gaps(stamps, steps, name)
        if found is not None:
            order = found
            interval, start, departure = _fitted(order, stamps)
    repeated = int(np.count_nonzero(steps == 0))
    resolution = float(np.min(steps[steps > 0]))
    rounded = repeated > 0 and departure * interval <= resolution
    if departure > 1.0 and not rounded:
        raise FitError(
            f"{name}: the time column fits no steady clock (rows depart from {1 / interval:.6g} Hz by up to "
            f"{departure:.3g} sampling intervals); resample it, or give the rate in a channel map"
        )
    doubts = []
    if departure > 1.0:
        doubts.append(
            f"the time column is rounded to {resolution:.3g} s, more than a sampling interval; the samples are taken "
            f"as evenly spaced at {1 / interval:.6g} Hz, and a gap in them would not be seen"
        )
    elif departure > JITTER_ALLOWED:
        equal = f"{repeated} time stamp(s) repeat the one before, and " if repeated else ""
        doubts.append(
            f"{equal}time stamps depart from a steady {1 / interval:.6g} Hz clock by up to {departure:.2f} sampling "
            "intervals; the samples are taken as evenly spaced, which is right if only the stamps jitter"
        )
    missing = int(order[-1]) + 1 - order.size
    if missing:
        doubts.append(
            f"{missing} sample(s) are missing from the time column in {int(np.count_nonzero(np.diff(order) > 1))} "
            "gap(s); the model bridges them, with a larger uncertainty"
        )
    for doubt in doubts:
        warnings.warn(f"{name}: {doubt}", DoubtWarning, stacklevel=3)
    return order, start, 1 / interval


def _checked_steps(stamps: Array, name: str) -> Array:
    """Return the steps of a time column, which must be finite and not go back."""
    if stamps.size < 2:
        raise FitError(f"{name}: {stamps.size} row(s) of samples; a recording needs at least two")
    if not np.isfinite(stamps).all():
        row = int(np.flatnonzero(~np.isfinite(stamps))[0]) + 1
        raise FitError(f"{name}: the time of sample {row} is not a number")
    steps: Array = np.diff(stamps)
    wrong = steps < 0 if (steps > 0).any() else steps <= 0
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0]) + 2
        raise FitError(
            f"{name}: time must increase from row to row, but sample {row} is at {stamps[row - 1]:.6g} s, "
            f"after {stamps[row - 2]:.6g} s"
        )
    return steps


JITTER_ALLOWED: Final = 0.1
"""Departure of a time stamp from the steady clock that is taken without a warning, in sampling intervals."""

GAP_SUSPECTED: Final = 0.2
"""Departure from evenly spaced rows from which gaps are looked for: one sample lost from five departs by 0.21."""

LARGEST_GAP_RATIO: Final = 20
"""Samples of the steady clock per row of the file beyond which the recording has to be cut at its gaps."""


def _fitted(index: NDArray[np.intp], stamps: Array) -> tuple[float, float, float]:
    """Fit stamps = start + interval * index by least squares; return interval [s], start [s], largest departure."""
    centred = index - index.mean()
    # Stamps less their mean keep microseconds where the clock counts from long ago.
    interval = float(centred @ (stamps - stamps.mean()) / (centred @ centred))
    start = float(stamps.mean() - interval * index.mean())
    departure = float(np.max(np.abs(stamps - stamps.mean() - interval * centred))) / interval
    return interval, start, departure


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


@dataclass(frozen=True, slots=True, eq=False)
class Loads:
    """What the balance feels: the elastic loads of Eq. (2), components in columns.

    Attributes
    ----------
    components
        Names of the c columns, from `aerobalance.components.COMPONENTS`.
    values
        Loads, shape (n, c) [N, N*m]; NaN where missing.
    rate
        Sampling rate [Hz].
    noise
        Standard uncertainty of one reading, shape (c,) [N, N*m]; NaN where it is to be estimated.
    """

    components: tuple[str, ...]
    values: Array
    rate: float
    noise: Array

    @classmethod
    def from_recording(cls, recording: Recording, components: tuple[str, ...]) -> Loads:
        """Take the load channels of a recording, delays known from the channel map not yet removed."""
        channels = [recording.channel(name) for name in components]
        return cls(
            components=components,
            values=np.column_stack([channel.values for channel in channels]),
            rate=recording.rate,
            noise=np.array([np.nan if channel.noise is None else channel.noise for channel in channels]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Force:
    """What was applied: the loads of Eq. (17), components in columns.

    Attributes
    ----------
    components
        Names of the c columns.
    values
        Applied force and moments, shape (n, c) [N, N*m].
    uncertainty
        Standard uncertainty of every sample, shape (n, c) [N, N*m].
    rate
        Sampling rate [Hz].
    """

    components: tuple[str, ...]
    values: Array
    uncertainty: Array
    rate: float
