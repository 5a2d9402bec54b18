"""What flows through the program: a recording of named channels, the balance loads, the force applied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import QUANTITIES, Array, Channel, unit_inside
from aerobalance.recording.components import COMPONENTS, is_gauge, loads_hint
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.gravity import GravityOnZero
from aerobalance.recording.jitter import following, on_steady_clock
from aerobalance.recording.parts import Extent
from aerobalance.recording.sep005 import clock_of_series
from aerobalance.recording.steady_clock import SteadyClock, first_repeated, seconds_of_stamps, steady_clock
from aerobalance.recording.units import conversion_for, edge_unit

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


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
    gravity_on_zero
        Gravity on the mass whose weight was added to loads that count from a zero read under it.
    from_outputs
        Whether the loads were worked out from gauge outputs, by a matrix whose errors the recording does not hold.
    gains_stated
        Whether gains of the gauge outputs that the loads were worked out from state an uncertainty, which the loads
        have in theirs.
    zero_from_natural
        How far the zero that the loads count from lies from the natural zeros of the balance's calibration, beyond
        the weight, by component [N, N*m]; empty where that is not known.
    zeros_left
        What the bridges' natural zeros would be as loads, by component [N, N*m], where the gauge outputs were taken as
        less their zero already; empty where they were not.
    zero_repeats
        How far zeros differ that are as good as a balance repeats, by component [N, N*m], where no zero was read after
        the run; empty where one was, or where the loads were not worked out from gauge outputs.
    extent
        Which part of a longer record it is; the whole where it is no part.
    declared
        Channels of which an analog filter was stated, and has been undone.
    low_passed
        Filters that have been undone, by the load or gauge output that had them, as far as they leave enough.
    decimated
        Samples of a faster clock that each sample was made of (`aerobalance.recording.decimation`); 1 where none were.
    epoch
        Date and time at which the time is zero (UTC where its file says so); None where that is not known.
    """

    name: str
    stamps: Array
    rows: NDArray[np.intp]
    start: float
    rate: float
    channels: Mapping[str, Channel]
    time_unit: str = "s"
    gravity_on_zero: GravityOnZero = field(default_factory=GravityOnZero)
    from_outputs: bool = False
    gains_stated: bool = False
    zero_from_natural: Mapping[str, float] = field(default_factory=dict)
    zeros_left: Mapping[str, float] = field(default_factory=dict)
    zero_repeats: Mapping[str, float] = field(default_factory=dict)
    extent: Extent = field(default_factory=Extent)
    declared: frozenset[str] = frozenset()
    low_passed: Mapping[str, AntiAlias] = field(default_factory=dict)
    decimated: int = 1
    epoch: np.datetime64 | None = None
    _means: dict[str, float] = field(init=False, default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        for key, channel in self.channels.items():
            if channel.name != key:
                raise ValueError(f"{self.name}: channel {key} is called {channel.name}: which of the two is it?")

    def __repr__(self) -> str:
        span = f"{self.samples} samples, {self.duration:.6g} s at {self.rate:.6g} Hz"
        return f"{self.name}: {span}; {', '.join(f'{one.name} [{one.unit}]' for one in self) or 'no channels'}"

    @classmethod
    def from_columns(
        cls,
        stamps: ArrayLike,
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
            Time of every row, shape (m,) [s], increasing; dates and times (datetime64) count from the first.
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
            A channel has not one reading per row, or another name than its key; a stamp is neither number nor date.
        """
        stamps = seconds_of_stamps(stamps, name)
        for key, channel in channels.items():
            if channel.values.shape != stamps.shape:
                raise ValueError(f"channel {key} has {channel.values.size} readings for {stamps.size} time stamps")
        clock = steady_clock(stamps, name)
        uneven = clock.departure > JITTER_ALLOWED and not clock.rounded
        if uneven and _samples_jitter(stamps, channels, clock, name):
            return _resampled(stamps, channels, clock, name, time_unit)
        rows, start, rate = clock.rows, clock.start, 1 / clock.interval
        samples = int(rows[-1]) + 1
        placed = {}
        for key, channel in channels.items():
            values = np.full(samples, np.nan)
            values[rows] = channel.values
            placed[key] = replace(channel, values=values)
        return cls(name=name, stamps=stamps, rows=rows, start=start, rate=rate, channels=placed, time_unit=time_unit)

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        columns: Mapping[str, ArrayLike],
        *,
        units: Mapping[str, str] | None = None,
        name: str = "recording",
    ) -> Recording:
        """Recording of arrays on a steady clock, each column a channel by its name.

        Parameters
        ----------
        time
            Time of every sample, shape (n,) [s], increasing; dates and times (datetime64) count from the first.
        columns
            Readings by channel, shape (n,) each; NaN where missing. The names are those of
            `aerobalance.recording.channel.QUANTITIES`: ``AF`` a balance load, ``rAF`` the output of its bridge,
            ``pitch``, ``ground_acceleration`` and so on.
        units
            Units of channels that are not in SI (gauge outputs: mV/V), such as ``{"pitch": "deg"}``.
        name
            What to call the recording in messages.

        Raises
        ------
        ValueError
            A channel is not known, a unit does not fit it, a column has another length than `time`, or a unit is
            given of a column that is not there.
        FitError
            The time does not increase, or no steady clock fits it.

        Examples
        --------
        >>> import numpy as np
        >>> import aerobalance as ab
        >>> t = np.arange(1000) / 1600
        >>> run = ab.Recording.from_arrays(t, {"AF": 10 + 0 * t, "pitch": 2 + 0 * t}, units={"pitch": "deg"})
        >>> float(run.channel("pitch").values[0].round(4))
        0.0349
        """
        given = dict(units or {})
        unknown = [key for key in given if key not in columns]
        if unknown:
            raise ValueError(f"units has {unknown[0]}, which is not among the columns: {', '.join(columns)}")
        stamps = seconds_of_stamps(time, name)
        if stamps.ndim != 1:
            raise ValueError(f"time must have shape (n,), not {stamps.shape}")
        channels = {key: _channel_of(key, values, given.get(key)) for key, values in columns.items()}
        for key, channel in channels.items():
            if channel.values.shape != stamps.shape:
                raise ValueError(f"column {key} has shape {channel.values.shape}, time has {stamps.shape}")
        return cls.from_columns(stamps, channels, name=name)

    @classmethod
    def from_dataframe(
        cls,
        frame: pd.DataFrame,
        *,
        time: str = "time",
        units: Mapping[str, str] | None = None,
        name: str = "recording",
    ) -> Recording:
        """Recording of the columns of a pandas data frame; arguments as `from_arrays` has them.

        Parameters
        ----------
        frame
            One row a sample.
        time
            Column of the time [s]; the index is taken where there is no such column.
        units, name
            As in `from_arrays`.
        """
        stamps = frame[time] if time in frame.columns else frame.index
        columns = {str(key): frame[key].to_numpy() for key in frame.columns if key != time}
        return cls.from_arrays(stamps.to_numpy(), columns, units=units, name=name)

    @classmethod
    def from_xarray(cls, data: xr.Dataset, *, time: str = "time", name: str = "recording") -> Recording:
        """Recording of the variables of an xarray data set along one dimension; the attribute ``units`` says theirs.

        Parameters
        ----------
        data
            Variables of shape (n,) along `time`.
        time
            Name of that coordinate [s].
        name
            What to call the recording in messages.
        """
        columns = {str(key): variable.to_numpy() for key, variable in data.data_vars.items()}
        said = {str(key): variable.attrs.get("units") for key, variable in data.data_vars.items()}
        units = {key: str(unit) for key, unit in said.items() if unit is not None}
        return cls.from_arrays(data[time].to_numpy(), columns, units=units, name=name)

    @classmethod
    def from_sep005(
        cls, series: Sequence[Mapping[str, Any]] | Mapping[str, Any], *, name: str = "recording"
    ) -> Recording:
        """Recording of time series as SEP-005 of SDyPy has them: dictionaries, all of one clock.

        Parameters
        ----------
        series
            Dictionaries with ``data`` of shape (n,), ``name``, ``unit_str``, and ``fs`` [Hz] or ``time`` [s]; where
            there, ``start_timestamp`` is the date and time of the first sample.
        name
            What to call the recording in messages.

        Raises
        ------
        ValueError
            A key is missing, or the series have different clocks (each clock is a recording of its own, and
            `aerobalance.recording.joining.join` makes one of them); or as in `from_arrays`.
        FitError
            As in `from_arrays`.
        """
        given = [series] if isinstance(series, Mapping) else list(series)
        stamps, began = clock_of_series(given)
        columns = {str(one["name"]): one["data"] for one in given}
        if len(columns) < len(given):
            raise ValueError("two of the series have one name; every channel needs a name of its own")
        units = {str(one["name"]): str(one["unit_str"]) for one in given}
        return replace(cls.from_arrays(stamps, columns, units=units, name=name), epoch=began)

    def to_sep005(self) -> list[dict[str, Any]]:
        """Channels as time series as SEP-005 of SDyPy has them, in the units of their files: a dictionary each.

        With ``data`` of shape (n,), NaN where a sample is missing, ``name``, ``unit_str``, ``fs`` [Hz], ``time`` [s],
        and where it is known ``start_timestamp``, the date and time (UTC) of the first sample.
        """
        found = []
        for channel in self:
            unit = channel.file_unit or edge_unit(channel.name, channel.unit)
            data = (
                channel.values if unit == channel.unit else conversion_for(channel.name, unit).outside(channel.values)
            )
            one: dict[str, Any] = {
                "data": data,
                "name": channel.name,
                "unit_str": unit,
                "fs": self.rate,
                "time": self.time,
            }
            if self.epoch is not None:
                since = np.timedelta64(round(1e9 * self.start), "ns")
                one["start_timestamp"] = str(self.epoch + since)
            found.append(one)
        return found

    def to_dataframe(self) -> pd.DataFrame:
        """Channels in SI units (gauge outputs in mV/V) over the time [s], as a pandas data frame."""
        import pandas as pd  # noqa: PLC0415 - takes a third of a second

        columns = {channel.name: channel.values for channel in self}
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time"))

    @property
    def samples(self) -> int:
        """Number of samples of the steady clock."""
        for channel in self.channels.values():
            return channel.values.size  # of a part, rows may be missing at its end
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
    def whole_duration(self) -> float:
        """Length of the record that it is a part of, or its own: its samples times the interval [s]."""
        return self.samples / self.rate / (self.extent.end - self.extent.begin)

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Start and length of every gap in the time column [s]."""
        steps = np.diff(self.rows)
        where = np.flatnonzero(steps > 1)
        return [(float(self.stamps[i]), float((steps[i] - 1) / self.rate)) for i in where]

    def part(self, begin: int, end: int) -> Recording:
        """The samples from one to another (not included) as a recording of their own, which knows where it belongs."""
        if (begin, end) == (0, self.samples):
            return self
        rows = slice(*np.searchsorted(self.rows, (begin, end)))
        last = max(self.samples - 1, 1)
        if not self._means and "temperature" in self:  # once for all parts
            mean = float(np.nanmean(self.channel("temperature").values))
            self._means["temperature"] = self.extent.means.get("temperature", mean)
        begun, span = self.extent.begin, self.extent.end - self.extent.begin
        return replace(
            self,
            stamps=self.stamps[rows],
            rows=self.rows[rows] - begin,
            start=self.start + begin / self.rate,
            channels={key: replace(one, values=one.values[begin:end]) for key, one in self.channels.items()},
            extent=Extent(begun + begin * span / last, begun + (end - 1) * span / last, dict(self._means)),
        )

    def __contains__(self, name: object) -> bool:
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
            hint = loads_hint(self.channels) if name in COMPONENTS else ""
            raise FitError(f"{self.name} has no channel {name}; it has {', '.join(self.channels) or 'none'}{hint}")
        return self.channels[name]


def _channel_of(name: str, values: ArrayLike, unit: str | None) -> Channel:
    """Make a channel of a column, in the unit that it has inside."""
    inside = unit_inside(name) or ("mV/V" if is_gauge(name) else None)
    if inside is None:
        raise ValueError(
            f"{name!r} is no channel; known are {', '.join(QUANTITIES)}, r and the name of a bridge, and "
            "ground_acceleration_ with an ending"
        )
    if unit is None:
        return Channel(name, np.array(values, dtype=np.float64), inside)
    change = conversion_for(name, unit)
    return Channel(name, np.asarray(change.inside(np.array(values, dtype=np.float64))), change.unit, file_unit=unit)


def _samples_jitter(stamps: Array, channels: Mapping[str, Channel], clock: SteadyClock, name: str) -> bool:
    """Return whether samples that were stamped unevenly were taken unevenly; warn where they are taken as even."""
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
        which = first_repeated(np.diff(stamps), stamps)
        equal = f"{repeated} time stamp(s) repeat the one before{which}, and " if repeated else ""
        warn_quality(
            f"{name}: {equal}time stamps depart from a steady {1 / clock.interval:.6g} Hz clock by up to "
            f"{clock.departure:.2f} sampling intervals; the samples are taken as evenly spaced: {why}"
        )
    return jitter


def _resampled(
    stamps: Array, channels: Mapping[str, Channel], clock: SteadyClock, name: str, time_unit: str
) -> Recording:
    """Interpolate samples that were taken unevenly to a steady clock, and say what that does to them."""
    first, kept = float(stamps[0]), np.concatenate(([True], np.diff(stamps) > 0))
    places = ((stamps - first) / clock.interval)[kept]
    samples = int(places[-1] + 1e-9) + 1
    given = list(channels.values())
    done = None
    if _even_enough(places, clock.rows[kept]):
        done = on_steady_clock([_unclipped(channel)[kept] for channel in given], places, samples)
    if done is None:
        repeated = first_repeated(np.diff(stamps), stamps)
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
    warn_quality(
        f"{name}: the samples were not taken evenly (jitter {jitter:.2g} sampling intervals rms, up to "
        f"{clock.departure:.2g}); they are interpolated to a steady {1 / clock.interval:.6g} Hz clock. "
        f"What that leaves: {'; '.join(said[:6])}{'; ...' if len(said) > 6 else ''}"
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


JITTER_ALLOWED: Final = 0.1
"""Departure of a time stamp from the steady clock that is taken without a warning, in sampling intervals."""

FOLLOWING_KNOWN: Final = 0.15
"""Standard uncertainty of the share of the jitter that readings follow, below which they tell who jitters."""

RATE_CHANGE_ALLOWED: Final = 0.05
"""Part by which the rate of a clock that wanders may change and still be one rate [1]."""
