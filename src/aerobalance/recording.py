"""What flows through the program: a recording of named channels, the loads felt, the force applied."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from aerobalance.components import COMPONENTS, si_unit
from aerobalance.problems import DoubtWarning, FitError

Array = NDArray[np.float64]

Coupling = Literal["kinematic", "dc", "ac"]

QUANTITIES: Final[Mapping[str, str]] = {
    **{name: si_unit(name) for name in COMPONENTS},
    **{f"r{name}": "mV/V" for name in COMPONENTS},
    **{f"{end}_acceleration{axis}": "m/s^2" for end in ("ground", "live") for axis in ("", "_y", "_z")},
    "pitch": "rad",
    "roll": "rad",
}
"""The channel names that the program understands, and the unit that each has inside."""


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
    """

    name: str
    values: Array
    unit: str
    noise: float | None = None
    relative_uncertainty: float = 0.0
    delay: float = 0.0
    coupling: Coupling = "kinematic"
    corner: float = 0.0

    def __post_init__(self) -> None:
        expected = QUANTITIES.get(self.name)
        if expected is not None and self.unit != expected:
            raise ValueError(f"channel {self.name} must be in {expected} inside, not {self.unit}")
        if self.values.ndim != 1:
            raise ValueError(f"channel {self.name} must have shape (n,), not {self.values.shape}")
        if self.noise is not None and not self.noise >= 0:
            raise ValueError(f"channel {self.name}: noise must be zero or more, not {self.noise}")
        self.values.setflags(write=False)

    @property
    def missing(self) -> NDArray[np.bool_]:
        """True where a sample is missing, shape (n,)."""
        return ~np.isfinite(self.values)

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """True where the reading rests on a limit that it met more than once at speed, shape (n,).

        A plateau is no saturation: a run counts where the neighbours show that the signal was still moving
        when it met the limit, and the limit has to be met in at least two such runs.
        """
        return _clipped(self.values, 1.0) | _clipped(self.values, -1.0)


def _clipped(values: Array, sign: float) -> NDArray[np.bool_]:
    """Find the runs of equal readings at the highest (sign 1) or lowest (sign -1) value."""
    flags = np.zeros(values.shape, dtype=bool)
    if not np.isfinite(values).any():
        return flags
    limit = np.nanmax(sign * values)
    edges = np.diff(np.concatenate(([0], (sign * values == limit).astype(np.int8), [0])))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    long = (last - first >= 2) & (first > 0) & (last < values.size - 1)
    first, last = first[long], last[long]
    if first.size < 2:
        return flags
    levels = np.unique(values[np.isfinite(values)])
    resolution = np.min(np.diff(levels)) if levels.size > 1 else 0.0
    moving = (limit - sign * values[first - 1] > 3 * resolution) | (limit - sign * values[last + 1] > 3 * resolution)
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
    """

    name: str
    stamps: Array
    rows: NDArray[np.intp]
    start: float
    rate: float
    channels: Mapping[str, Channel]

    @classmethod
    def from_columns(cls, stamps: Array, channels: Mapping[str, Channel], *, name: str = "recording") -> Recording:
        """Put columns of samples on a steady clock, with missing rows marked as such.

        Parameters
        ----------
        stamps
            Time of every row, shape (m,) [s], increasing.
        channels
            Channels of m readings each.
        name
            What to call the recording in messages.

        Raises
        ------
        FitError
            The time column does not increase, or no steady clock fits it.
        """
        rows, start, rate = _steady_clock(np.asarray(stamps, dtype=np.float64), name)
        samples = int(rows[-1]) + 1
        placed = {}
        for key, channel in channels.items():
            values = np.full(samples, np.nan)
            values[rows] = channel.values
            placed[key] = Channel(
                **{slot: getattr(channel, slot) for slot in Channel.__slots__ if slot != "values"},
                values=values,
            )
        return cls(name=name, stamps=stamps, rows=rows, start=start, rate=rate, channels=placed)

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
    if stamps.size < 2:
        raise FitError(f"{name}: {stamps.size} row(s) of samples; a recording needs at least two")
    if not np.isfinite(stamps).all():
        row = int(np.flatnonzero(~np.isfinite(stamps))[0]) + 1
        raise FitError(f"{name}: the time of sample {row} is not a number")
    steps = np.diff(stamps)
    if (steps < 0).any() or not (steps > 0).any():
        row = int(np.flatnonzero(steps <= 0)[0]) + 2
        raise FitError(
            f"{name}: time must increase from row to row, but sample {row} is at {stamps[row - 1]:.6g} s, "
            f"after {stamps[row - 2]:.6g} s"
        )
    order = np.arange(stamps.size, dtype=np.intp)
    interval, start = _line(order, stamps)
    departure = float(np.max(np.abs(stamps - start - interval * order))) / interval
    if departure > 0.5:
        interval = float(np.median(steps[steps > 0]))
        rows = np.rint((stamps - stamps[0]) / interval).astype(np.intp)
        for _ in range(5):  # a rounded time column gives a rough interval: refine it on the rows found
            interval, start = _line(rows, stamps)
            rows = np.rint((stamps - start) / interval).astype(np.intp)
            rows -= rows[0]
        if rows[-1] >= order[-1] and (np.diff(rows) > 0).all():
            interval, start = _line(rows, stamps)
            order, departure = rows, float(np.max(np.abs(stamps - start - interval * rows))) / interval
    if departure > 1.0:
        raise FitError(
            f"{name}: the time column fits no steady clock (rows depart from {1 / interval:.6g} Hz by up to "
            f"{departure:.3g} sampling intervals); resample it, or give the rate in a channel map"
        )
    if departure > JITTER_ALLOWED:
        warnings.warn(
            f"{name}: time stamps depart from a steady {1 / interval:.6g} Hz clock by up to {departure:.2f} sampling "
            "intervals; the samples are taken as evenly spaced, which is right if only the stamps jitter",
            DoubtWarning,
            stacklevel=3,
        )
    missing = int(order[-1]) + 1 - order.size
    if missing:
        warnings.warn(
            f"{name}: {missing} sample(s) are missing from the time column in "
            f"{int(np.count_nonzero(np.diff(order) > 1))} gap(s); the model bridges them, with a larger uncertainty",
            DoubtWarning,
            stacklevel=3,
        )
    return order, start, 1 / interval


JITTER_ALLOWED: Final = 0.1
"""Departure of a time stamp from the steady clock that is taken without a warning, in sampling intervals."""


def _line(index: NDArray[np.intp], stamps: Array) -> tuple[float, float]:
    """Fit stamps = start + interval * index by least squares; return interval and start [s]."""
    centred = index - index.mean()
    interval = float(centred @ (stamps - stamps.mean()) / (centred @ centred))
    return interval, float(stamps.mean() - interval * index.mean())


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
