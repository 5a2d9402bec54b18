"""What flows through the program: a recording of named channels, the loads felt, the force applied."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.channel import Array, Channel
from aerobalance.components import COMPONENTS, is_gauge
from aerobalance.gravity import PullOnZero
from aerobalance.jitter import following, on_steady_clock
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
        The time column as it was given, shape (m,) [s]; the steady clock where the samples were put on it.
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

        Where the readings follow the jitter of their stamps, or the stamps depart from every steady clock by more
        than an interval, the samples are interpolated to a steady clock, which is then the time column.

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
        clock = _steady_clock(stamps, name)
        uneven = clock.departure > JITTER_ALLOWED and not clock.rounded
        if uneven and _samples_jitter(stamps, channels, clock, name):
            return _resampled(stamps, channels, clock, name, time_unit)
        rows, start, rate = clock.rows, clock.start, 1 / clock.interval
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


class _Clock(NamedTuple):
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


def _steady_clock(stamps: Array, name: str) -> _Clock:
    """Find the steady clock behind a time column, and warn of what is missing or rounded."""
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
    rounded = departure > 1.0 and repeated > 0 and departure * interval <= resolution
    doubts = []
    if rounded:
        interval, start, known = _between_turns(stamps, steps, name, resolution)
        departure = float(np.abs((stamps - start) / interval - order).max())
        doubts.append(
            f"the time column is rounded to {resolution:.3g} s, more than a sampling interval; the samples are "
            f"taken as evenly spaced at {1 / interval:.6g} Hz (known to {100 * known:.1g} %), and a gap in them "
            "would not be seen"
        )
    missing = int(order[-1]) + 1 - order.size
    if missing:
        doubts.append(
            f"{missing} sample(s) are missing from the time column in {int(np.count_nonzero(np.diff(order) > 1))} "
            "gap(s); the model bridges them, with a larger uncertainty"
        )
    for doubt in doubts:
        warnings.warn(f"{name}: {doubt}", DoubtWarning, stacklevel=3)
    return _Clock(order, interval, start, departure, rounded)


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


def _samples_jitter(stamps: Array, channels: Mapping[str, Channel], clock: _Clock, name: str) -> bool:
    """Say whether samples that were stamped unevenly were taken unevenly; warn where they are taken as even."""
    late = clock.late(stamps)
    found = following([channel.values for channel in channels.values()], late)
    if found.u < FOLLOWING_KNOWN:
        jitter = found.share > 0.5
        why = f"the readings do not follow them (by {found.share:.2f} of the jitter, u = {found.u:.2g})"
    else:
        jitter = clock.departure > 1.0
        worst = ", ".join(
            f"{np.nanstd(np.gradient(channel.values) * late):.3g} {channel.unit} of {key}"
            for key, channel in list(channels.items())[:6]
        )
        why = f"the readings do not tell whether they were; if they were not, they are off by {worst} rms"
    if not jitter:
        repeated = int(np.count_nonzero(np.diff(stamps) == 0))
        which = _first_repeated(np.diff(stamps), stamps)
        equal = f"{repeated} time stamp(s) repeat the one before{which}, and " if repeated else ""
        warnings.warn(
            f"{name}: {equal}time stamps depart from a steady {1 / clock.interval:.6g} Hz clock by up to "
            f"{clock.departure:.2f} sampling intervals; the samples are taken as evenly spaced: {why}",
            DoubtWarning,
            stacklevel=3,
        )
    return jitter


def _resampled(stamps: Array, channels: Mapping[str, Channel], clock: _Clock, name: str, time_unit: str) -> Recording:
    """Interpolate samples that were taken unevenly to a steady clock, and say what that does to them."""
    first, kept = float(stamps[0]), np.concatenate(([True], np.diff(stamps) > 0))
    places = ((stamps - first) / clock.interval)[kept]
    samples = int(places[-1] + 1e-9) + 1
    given = list(channels.values())
    done = None
    if _even_enough(places, clock.rows[kept]):
        done = on_steady_clock([_unclipped(channel)[kept] for channel in given], places, samples)
    if done is None:
        repeated = _first_repeated(np.diff(stamps), stamps)
        raise FitError(
            f"{name}: the time column fits no steady clock: rows depart from {1 / clock.interval:.6g} Hz by up to "
            f"{clock.departure:.3g} sampling intervals{repeated}, and are too far apart or too uneven to be put on "
            "one; cut the recording where the rate changes or samples are missing"
        )
    placed, said = {}, []
    for channel, values, error, gain in zip(given, done.values, done.errors, done.noise_gains, strict=True):
        noise = None if channel.noise is None else float(np.hypot(gain * channel.noise, error))
        placed[channel.name] = replace(channel, values=values, noise=noise)
        clipped = ", saturated samples left out" if channel.saturated.any() else ""
        said.append(f"{channel.name} {error:.2g} {channel.unit} rms, noise times {gain:.2f}{clipped}")
    jitter = float(np.std(clock.late(stamps)))
    warnings.warn(
        f"{name}: the samples were not taken evenly (jitter {jitter:.2g} sampling intervals rms, up to "
        f"{clock.departure:.2g}); they are interpolated to a steady {1 / clock.interval:.6g} Hz clock. "
        f"What that leaves: {'; '.join(said[:6])}{'; ...' if len(said) > 6 else ''}",
        DoubtWarning,
        stacklevel=3,
    )
    grid = np.arange(samples)
    time: Array = first + np.arange(samples, dtype=np.float64) * clock.interval
    return Recording(name, time, grid, first, 1 / clock.interval, placed, time_unit=time_unit)


def _unclipped(channel: Channel) -> Array:
    """Readings of a load or an acceleration without those at a limit, which would not be known as such afterwards."""
    return np.where(channel.at_limit, np.nan, channel.values) if channel.unit != "rad" else channel.values


def _even_enough(places: Array, rows: NDArray[np.intp]) -> bool:
    """Whether stamps jitter about one rate, and do not change from one to another."""
    length = min(256, places.size // 4)
    if length < 4:
        return False
    local = (places[length:] - places[:-length]) / (rows[length:] - rows[:-length])
    return bool(np.all(np.abs(local - 1) < RATE_CHANGE_ALLOWED + 2 / length))


def _first_repeated(steps: Array, stamps: Array) -> str:
    """Name the first two samples that have the same time stamp, for a message; nothing where there are none."""
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

FOLLOWING_KNOWN: Final = 0.15
"""Standard uncertainty of the share of the jitter that readings follow, below which they tell who jitters."""

RATE_CHANGE_ALLOWED: Final = 0.05
"""Part by which the rate of a clock that wanders may change and still be one rate [1]."""

GAP_SUSPECTED: Final = 0.2
"""Departure from evenly spaced rows from which gaps are looked for: one sample lost from five departs by 0.21."""

RATE_KNOWN: Final = 1e-4
"""Relative uncertainty of the sampling rate up to which rounded time stamps are taken for a clock."""

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
