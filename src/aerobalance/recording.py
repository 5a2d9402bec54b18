"""What flows through the program: a recording of named channels, the loads felt, the force applied."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.anti_alias import AntiAlias
from aerobalance.components import COMPONENTS, MOMENTS, is_gauge, si_unit
from aerobalance.problems import DoubtWarning, FitError

Array = NDArray[np.float64]

Coupling = Literal["kinematic", "dc", "ac"]

QUANTITIES: Final[Mapping[str, str]] = {
    **{name: si_unit(name) for name in COMPONENTS},
    **{f"r{name}": "mV/V" for name in COMPONENTS},
    **{f"{end}_acceleration{axis}": "m/s^2" for end in ("ground", "live") for axis in ("", "_y", "_z")},
    **{f"ground_turn_{name}": "rad/s^2" for name in MOMENTS},
    **{f"ground_turn_rate_{name}": "rad/s" for name in MOMENTS},
    "pitch": "rad",
    "roll": "rad",
    "excitation": "V",
    "temperature": "degC",
}
"""The channel names that the program understands, and the unit that each has inside.

Beside the gauge outputs listed, ``r`` and any component as the balance names it is one (rN1, rAft_Pitch): in mV/V,
or in V until `aerobalance.gauges.gauge_outputs` has divided it by the excitation. ``ground_turn_PM`` and its like are
angular accelerations of the ground end, positive as the moment of that name turns: nose up, nose right, right side
down; ``ground_turn_rate_PM`` and its like are their integrals. ``ground_acceleration_`` with any other ending is an
accelerometer on the ground end whose channel says where it sits and which way it looks.
"""

DIRECTIONS: Final[Mapping[str, tuple[float, float, float]]] = {
    "aft": (1.0, 0.0, 0.0),
    "right": (0.0, 1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
}
"""Unit vectors of the balance's axes, in their own coordinates."""

AXES_BY_NAME: Final[Mapping[str, tuple[float, float, float]]] = {
    "ground_acceleration": DIRECTIONS["aft"],
    "ground_acceleration_y": DIRECTIONS["right"],
    "ground_acceleration_z": DIRECTIONS["up"],
}
"""Axes of the accelerometers whose names tell them."""

_GROUND_ACCELERATION: Final = re.compile(r"ground_acceleration(_\w+)?")


def is_ground_acceleration(name: str) -> bool:
    """Say whether a channel name is that of an accelerometer on the ground end."""
    return _GROUND_ACCELERATION.fullmatch(name) is not None


def unit_inside(name: str) -> str | None:
    """Unit that a channel of this name has inside; None where any will do (see `is_gauge` for gauges)."""
    return "m/s^2" if is_ground_acceleration(name) else QUANTITIES.get(name)


@dataclass(frozen=True, slots=True)
class CrossAxis:
    """What an accelerometer reads of an acceleration across its axis.

    Attributes
    ----------
    channel
        Name of the channel of that acceleration.
    sensitivity
        Reading over that acceleration [1].
    uncertainty
        Its standard uncertainty [1].
    """

    channel: str
    sensitivity: float
    uncertainty: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.sensitivity) < 1 or not 0 <= self.uncertainty < 1:
            raise ValueError(
                f"the sensitivity to {self.channel} must lie between -1 and 1 and its uncertainty between 0 and 1, "
                f"not {self.sensitivity:g} and {self.uncertainty:g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One measured quantity over time.

    Attributes
    ----------
    name
        One of `QUANTITIES`, or any other name for a quantity the program only passes on.
    values
        Readings on the recording's clock, shape (n,), in `unit`; NaN where a sample is missing.
    unit
        Unit of `values`.
    noise
        Standard uncertainty of one reading [unit]; None when it is to be estimated from the record.
    relative_uncertainty
        Standard uncertainty of the channel's gain, relative [1].
    delay
        Time by which the readings lag the clock [s].
    coupling
        What an accelerometer reads: ``"kinematic"`` the acceleration of its place, ``"dc"`` specific force
        (x'' - g sin(pitch)), ``"ac"`` the acceleration above a high-pass corner.
    corner
        High-pass corner of an ac-coupled sensor [Hz]; 0 for the others.
    file_unit
        Unit in the channel's file, in which results are written again; an empty string where there is no file.
    zero_uncertainty
        Standard uncertainty of the channel's zero [unit].
    filter
        Analog low-pass before the sampling, still in the readings; None where there is none.
    cross_axis
        What an accelerometer reads of other accelerations, still in the readings.
    place
        Where an accelerometer on the ground end sits, from the balance's centre aft, right and up [m]; None where it
        is not given.
    axis
        Unit vector along which it reads positive: its shares aft, right and up; None where its name tells it.
    place_uncertainty
        Standard uncertainty of every coordinate of `place` [m].
    """

    name: str
    values: Array
    unit: str
    noise: float | None = None
    relative_uncertainty: float = 0.0
    delay: float = 0.0
    coupling: Coupling = "kinematic"
    corner: float = 0.0
    file_unit: str = ""
    zero_uncertainty: float = 0.0
    filter: AntiAlias | None = None
    cross_axis: tuple[CrossAxis, ...] = ()
    place: tuple[float, float, float] | None = None
    axis: tuple[float, float, float] | None = None
    place_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        expected = ("mV/V", "V") if is_gauge(self.name) else (unit_inside(self.name) or self.unit,)
        if self.unit not in expected:
            raise ValueError(f"channel {self.name} must be in {' or '.join(expected)} inside, not {self.unit}")
        if self.values.ndim != 1:
            raise ValueError(f"channel {self.name} must have shape (n,), not {self.values.shape}")
        if self.noise is not None and not self.noise >= 0:
            raise ValueError(f"channel {self.name}: noise must be zero or more, not {self.noise}")
        if not self.zero_uncertainty >= 0:
            raise ValueError(
                f"channel {self.name}: zero_uncertainty must be zero or more, not {self.zero_uncertainty}"
            )
        self._check_mounting()
        fixed = self.values.view()
        fixed.setflags(write=False)  # on a view, so that the caller's own array stays as it was
        object.__setattr__(self, "values", fixed)

    def _check_mounting(self) -> None:
        """Refuse a place or an axis that no accelerometer on the ground end can have."""
        if (self.place, self.axis, self.place_uncertainty) == (None, None, 0.0):
            return
        if not is_ground_acceleration(self.name):
            raise ValueError(f"channel {self.name}: place and axis are for ground_acceleration and its like")
        if self.place is not None and (len(self.place) != 3 or not np.isfinite(self.place).all()):
            raise ValueError(f"channel {self.name}: place must be three numbers [m], aft, right, up, not {self.place}")
        if not 0 <= self.place_uncertainty < np.inf:
            raise ValueError(
                f"channel {self.name}: place_uncertainty must be zero or more, not {self.place_uncertainty}"
            )
        if self.axis is not None and (len(self.axis) != 3 or not abs(np.linalg.norm(self.axis) - 1) < 1e-3):
            raise ValueError(f"channel {self.name}: axis must be a vector aft, right, up of length 1, not {self.axis}")

    @property
    def missing(self) -> NDArray[np.bool_]:
        """True where a sample is missing, shape (n,)."""
        return ~np.isfinite(self.values)

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """True where the reading rests on a limit that it met more than once at speed, shape (n,).

        A plateau is no saturation: a run of equal readings at the highest or lowest value counts where the
        readings on both sides of it, continued, would have gone well past the limit, and where that happens at
        least twice. A single clipped peak cannot be told from a plateau and is not found.
        """
        return _clipped(self.values, 1.0) | _clipped(self.values, -1.0)

    @property
    def at_limit(self) -> NDArray[np.bool_]:
        """True where the reading is at a limit that it rests on somewhere in the record, shape (n,).

        Once a limit is known, a single reading there is as little worth as a run of them.
        """
        limits = np.unique(self.values[self.saturated])
        return np.isin(self.values, limits) if limits.size else np.zeros(self.values.shape, dtype=bool)


def _clipped(values: Array, sign: float) -> NDArray[np.bool_]:
    """Find the runs of three or more equal readings at the highest (sign 1) or lowest (sign -1) value."""
    flags = np.zeros(values.shape, dtype=bool)
    finite = np.isfinite(values)
    if not finite.any():
        return flags
    signal = np.where(finite, sign * values, np.nan)
    limit = np.max(signal[finite])
    spread = limit - np.min(signal[finite])
    edges = np.diff(np.concatenate(([0], (signal == limit).astype(np.int8), [0])))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    inside = (last - first >= 2) & (first > 1) & (last < values.size - 2)
    first, last = first[inside], last[inside]
    levels = np.unique(values[finite]) if first.size >= 2 else values[:1]
    if levels.size < 2:
        return flags
    resolution = float(np.min(np.diff(levels)))
    inner = (signal[first - 1] + signal[last + 1]) / 2
    outer = (signal[first - 2] + signal[last + 2]) / 2
    half = (last - first + 2) / 2
    # A parabola through the two readings on either side, at the middle of the run.
    overshoot = inner + (inner - outer) * half**2 / (2 * half + 1) - limit
    # A quantised peak rests on its top level by itself; a ramp to a long plateau would have overshot the whole range.
    moving = (overshoot > (2 + half) * resolution) & (overshoot > 1e-3 * spread) & (overshoot < spread)
    if np.count_nonzero(moving) < 2:
        return flags
    for start, stop in zip(first, last, strict=True):
        flags[start : stop + 1] = True
    return flags


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
    """

    name: str
    stamps: Array
    rows: NDArray[np.intp]
    start: float
    rate: float
    channels: Mapping[str, Channel]
    time_unit: str = "s"

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
            raise FitError(f"{self.name} has no channel {name}; it has {', '.join(self.channels) or 'none'}")
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
