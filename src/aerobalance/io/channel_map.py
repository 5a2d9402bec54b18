"""The channel map: a TOML file that says what the columns of a foreign file are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator

from aerobalance.io.channel_settings import ChannelSettings, Number, Strict
from aerobalance.io.clocks import of_one_length, on_one_clock
from aerobalance.io.columns import RawColumn, RawColumns
from aerobalance.io.messages import first_fault
from aerobalance.io.table import Column, check_time, on_clock
from aerobalance.io.text_cells import SEPARATORS
from aerobalance.io.text_layout import Layout
from aerobalance.io.toml_file import read_toml
from aerobalance.recording.analog_filter import HIGHEST_ORDER, AntiAlias, Kind
from aerobalance.recording.channel import (
    Array,
    Channel,
    CrossAxis,
    unit_inside,
)
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import ReadError, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import Conversion, conversion, conversion_for

Position = Annotated[str, Field(min_length=1)] | Annotated[int, Field(ge=1)]

SHUNT_DOUBTED: Final = 0.02
"""Departure of a shunt ratio from 1 that is warned of."""

SHUNT_REFUSED: Final = 0.2
"""Departure of a shunt ratio from 1 that no working bridge with the right resistor has."""

_DERIVED_FROM: Final = {1: "m/s", 2: "m"}
_EITHER: Final = "either time (the time column) or rate (samples per second, evenly spaced)"


class FileLayout(Strict):
    """Table ``[file]``: how the file is laid out. Whatever is left out is recognised from the file."""

    time: Position | None = None
    time_unit: str | None = None
    rate: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    separator: Literal["comma", "semicolon", "tab", "space"] | None = None
    decimal: Literal[".", ","] | None = None
    header_line: Annotated[int, Field(ge=0)] | None = None
    skip_lines: Annotated[int, Field(ge=0)] | None = None
    encoding: str | None = None
    sheet: str | None = None


class MappedFilter(Strict):
    """Entry ``filter``: the analog low-pass before the sampling; its corner in Hz, or text with a unit."""

    kind: Kind
    order: Annotated[int, Field(ge=1, le=HIGHEST_ORDER)]
    corner: Annotated[float, Field(gt=0, allow_inf_nan=False)]

    @field_validator("corner", mode="before")
    @classmethod
    def _in_hertz(cls, given: object) -> object:
        if not isinstance(given, str):
            return given
        number, _, unit = given.strip().partition(" ")
        try:
            return float(number.replace(",", ".")) * conversion(unit.strip(), expected="Hz").factor
        except ValueError:
            raise ValueError('must be a number of Hz, or text like "500 Hz" or "2 kHz"') from None


class MappedSensitivity(Strict):
    """One of the entries of ``cross_axis``: sensitivity and its standard uncertainty [1]."""

    value: Annotated[float, Field(gt=-1, lt=1)]
    u: Annotated[float, Field(ge=0, lt=1)] = 0.0


class _Place(Strict):
    """What comes first in the table of a channel."""

    column: Position


class MappedChannel(ChannelSettings, _Place):
    """Table ``[channels.NAME]``: where a channel comes from and what it is.

    The channel's value is ``sign * (scale * cell + offset)`` in `unit`, differentiated `derivative` times. A gauge
    output in volts is divided by `excitation` [V] where that is given, and any gauge output is multiplied by
    ``shunt_expected / shunt_measured`` [mV/V].
    """

    filter: MappedFilter | None = None
    cross_axis: dict[str, MappedSensitivity] = Field(default_factory=dict)
    derivative: Literal[0, 1, 2] = 0
    excitation: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    shunt_expected: Number | None = None
    shunt_measured: Number | None = None

    @field_validator("cross_axis", mode="before")
    @classmethod
    def _bare_numbers(cls, given: object) -> object:
        """Take a number for a sensitivity that is known exactly."""
        if not isinstance(given, dict):
            return given
        return {name: part if isinstance(part, dict) else {"value": part} for name, part in given.items()}

    @property
    def anti_alias(self) -> AntiAlias | None:
        """The filter, where there is one."""
        given = self.filter
        return None if given is None else AntiAlias(given.kind, given.order, given.corner)

    @property
    def shunt_ratio(self) -> float:
        """Factor that the shunt readings give; 1 where there are none."""
        if self.shunt_expected is None or not self.shunt_measured:
            return 1.0
        return self.shunt_expected / self.shunt_measured


class _MapContents(Strict):
    file: FileLayout = FileLayout()
    channels: Annotated[dict[str, MappedChannel], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class ChannelMap:
    """What the columns of a foreign file are.

    Attributes
    ----------
    path
        The channel map's own file.
    file
        Layout of the foreign file.
    channels
        Where each channel comes from, by the name that the program understands.
    """

    path: Path
    file: FileLayout
    channels: dict[str, MappedChannel]

    @property
    def layout(self) -> Layout:
        """Layout of the text file."""
        return Layout(
            separator=None if self.file.separator is None else SEPARATORS[self.file.separator],
            decimal=self.file.decimal,
            header_line=self.file.header_line,
            skip_lines=self.file.skip_lines,
            encoding=self.file.encoding,
            clocked=self.file.time is not None or self.file.rate is not None,
            rate=self.file.rate,
            time_unit=self.file.time_unit,
        )

    @property
    def needs_all(self) -> bool:
        """Whether a part of a record cannot be made of a part of its file: a channel is derived, or times are read."""
        return self.file.time is not None or any(channel.derivative for channel in self.channels.values())

    @property
    def wanted(self) -> list[str | int]:
        """The columns of the foreign file that are used; the others may hold anything."""
        time = [] if self.file.time is None or self.file.rate is not None else [self.file.time]
        return [*time, *(channel.column for channel in self.channels.values())]


def load_channel_map(path: Path | str) -> ChannelMap:
    """Read a channel map.

    Raises
    ------
    ReadError
        The file is no TOML, or has a key that is unknown, missing or not allowed; the message names the key.
    """
    file = Path(path)
    given = read_toml(file, what="a channel map")
    try:
        contents = _MapContents.model_validate(given)
    except ValidationError as error:
        where, what = first_fault(error, _MapContents)
        if where == "channels" and not given.get("channels"):
            what += "; give one column or more a table [channels.NAME], NAME being what the column is"
        raise ReadError(file, where, what) from None
    chosen = ChannelMap(file, contents.file, contents.channels)
    _check(chosen)
    return chosen


def _check(chosen: ChannelMap) -> None:
    """Refuse settings that contradict each other."""
    path, file = chosen.path, chosen.file
    if file.time is not None and file.rate is not None:
        raise ReadError(path, "file", f"takes {_EITHER}, not both")
    if file.time_unit is not None:
        _converted(chosen, "file.time_unit", file.time_unit, "s")
    for name, channel in chosen.channels.items():
        key = f"channels.{name}"
        if name == "time":
            raise ReadError(path, key, "the time column belongs under [file]: time = ...")
        fault = channel.fault(name)
        if fault is not None:
            raise ReadError(path, f"{key}.{fault[0]}".strip("."), fault[1])
        accelerometer = unit_inside(name) == "m/s^2"
        if not accelerometer and channel.derivative:
            raise ReadError(path, key, "derivative is for accelerations, such as ground_acceleration")
        _check_gauge(path, name, channel)
        for other in channel.cross_axis:
            if not accelerometer or other == name or unit_inside(other) != "m/s^2" or other not in chosen.channels:
                raise ReadError(
                    path,
                    f"{key}.cross_axis.{other}",
                    "cross_axis is for accelerations, and names another acceleration that has a table in this map",
                )
        if channel.unit is not None:
            try:
                _conversion(name, channel, channel.unit)
            except ValueError as error:
                raise ReadError(path, f"{key}.unit", str(error)) from None


def _check_gauge(path: Path, name: str, channel: MappedChannel) -> None:
    """Refuse gauge settings of other channels, and shunt readings that no working bridge gives."""
    key = f"channels.{name}"
    settings = (channel.excitation, channel.shunt_expected, channel.shunt_measured)
    if settings == (None, None, None):
        return
    if not is_gauge(name):
        raise ReadError(
            path, key, "excitation, shunt_expected and shunt_measured are for gauge outputs, such as rAF or rN1"
        )
    if (channel.shunt_expected is None) != (channel.shunt_measured is None):
        raise ReadError(path, key, "shunt_expected and shunt_measured [mV/V] are needed together")
    if channel.shunt_expected == 0 or channel.shunt_measured == 0:
        raise ReadError(path, key, "shunt_expected and shunt_measured must not be zero")
    departure = abs(channel.shunt_ratio - 1)
    if departure > SHUNT_REFUSED:
        raise ReadError(
            path,
            f"{key}.shunt_measured",
            f"the shunt reads {channel.shunt_measured:g} mV/V where {channel.shunt_expected:g} is expected, a ratio "
            f"of {channel.shunt_ratio:.4g}; within {SHUNT_REFUSED:.0%} is allowed: look for a wrong resistor, a wrong "
            "sign or a dead bridge",
        )


def _conversion(name: str, channel: MappedChannel, unit: str) -> Conversion:
    """Conversion of a channel's cells, before they are differentiated or divided by an excitation.

    Raises
    ------
    ValueError
        The unit is not of the kind that the channel asks for.
    """
    if channel.derivative:
        return conversion(unit, expected=_DERIVED_FROM[channel.derivative])
    found = conversion_for(name, unit)
    if channel.excitation is not None and found.unit != "V":
        raise ValueError(f"unit [{unit}] is over excitation already; remove excitation, or give a voltage (V, mV, uV)")
    return found


def _converted(chosen: ChannelMap, where: str, unit: str, expected: str | None) -> None:
    try:
        conversion(unit, expected=expected)
    except ValueError as error:
        raise ReadError(chosen.path, where, str(error)) from None


def mapped_recording(raw: RawColumns, chosen: ChannelMap) -> Recording:
    """Make a recording of the columns of a foreign file.

    Raises
    ------
    ReadError
        A column is not there, has no unit, or has one of another kind; the time column is not steady.
    """
    if chosen.file.sheet is not None:
        raise ReadError(chosen.path, "file.sheet", "is for load schedules in .xlsx workbooks (aerobalance calibrate)")
    own = chosen.file.time is None and chosen.file.rate is None
    raw = _on_own_clocks(raw, chosen) if own else of_one_length(raw)
    stamps, time_unit = _stamps(raw, chosen)
    channels = mapped_channels(raw, chosen)
    rate, ticks = (raw.rate, raw.ticks) if own else (None, None)
    recording = on_clock(raw.path, stamps, channels, time_unit=time_unit, rate=rate, ticks=ticks, epoch=raw.epoch)
    derived = {name: channel.derivative for name, channel in chosen.channels.items() if channel.derivative}
    if not derived:
        return recording
    replaced = dict(recording.channels)
    for name, order in derived.items():
        replaced[name] = _differentiated(replaced[name], order, recording.rate)
    return replace(recording, channels=replaced)


def mapped_channels(raw: RawColumns, chosen: ChannelMap) -> dict[str, Channel]:
    """Channels of the columns of a foreign file, as they were sampled: none differentiated.

    Raises
    ------
    ReadError
        A column is not there, has no unit, or has one of another kind.
    """
    return {name: _channel(raw, chosen, name) for name in chosen.channels}


def _on_own_clocks(raw: RawColumns, chosen: ChannelMap) -> RawColumns:
    """Put columns on one clock by what the file says of each."""
    if raw.rate is not None or raw.time is not None:
        return of_one_length(raw)
    if all(column.clock is None for column in raw.columns):
        raise ReadError(
            chosen.path, "file", f"needs {_EITHER}: {raw.path.name} does not state the rate of these columns itself"
        )
    return on_one_clock(raw)


def _stamps(raw: RawColumns, chosen: ChannelMap) -> tuple[Array, str]:
    """Time of every row [s], and the unit it had in the file."""
    if chosen.file.rate is not None:
        if raw.rows < 2:
            raise ReadError(raw.path, "", f"has {raw.rows} row(s) of samples; a recording needs at least two")
        return np.arange(raw.rows) / chosen.file.rate, "s"
    key = chosen.file.time or raw.time
    if key is None:
        rows = np.arange(raw.rows) if raw.ticks is None else raw.ticks
        return raw.start + rows / (raw.rate or np.nan), "s"
    column = raw.find(key, where="header")
    if column.stamped and chosen.file.time_unit is not None:
        raise ReadError(
            chosen.path, "file.time_unit", f"does not go with {column.label!r}, which holds dates and times; remove it"
        )
    unit = chosen.file.time_unit or column.unit
    if not unit:
        raise ReadError(
            chosen.path,
            "file.time_unit",
            f'is needed: the header {column.label!r} does not say the unit; put time_unit = "s" (or ms, us, min) '
            "under [file]",
        )
    try:
        change = conversion(unit, expected="s")
    except ValueError as error:
        raise ReadError(raw.path, f"header, {column.place}", str(error)) from None
    time = Column("time", change.inside(column.values), "s", unit, column.place)
    check_time(raw.path, time, raw.lines)
    return time.values, unit


def _channel(raw: RawColumns, chosen: ChannelMap, name: str) -> Channel:
    """Make one channel, not yet differentiated."""
    given = chosen.channels[name]
    column: RawColumn = raw.find(given.column, where="header")
    unit = given.unit or column.unit
    if not unit:
        raise ReadError(
            chosen.path, f"channels.{name}.unit", f"is needed: the header {column.label!r} does not say the unit"
        )
    try:
        change = _conversion(name, given, unit)
    except ValueError as error:
        raise ReadError(raw.path, f"header, {column.place}", f"{error} for {name}") from None
    plain = (given.sign, given.scale, given.offset) == (1, 1.0, 0.0)
    values = change.inside(column.values if plain else given.sign * (given.scale * column.values + given.offset))
    gain = _gain(raw.path, name, given)
    inside = "mV/V" if given.excitation is not None else change.unit
    lag = column.sensor.delay if raw.rate is not None else 0.0
    sensor = replace(
        given.sensor(),
        delay=given.delay + lag,
        filter=given.anti_alias,
        cross_axis=tuple(CrossAxis(other, part.value, part.u) for other, part in given.cross_axis.items()),
    )
    if given.derivative:
        sensor = replace(sensor, zero_uncertainty=0.0)
    return Channel(
        name,
        values if gain == 1.0 else values * gain,
        "m/s^2" if given.derivative else inside,
        file_unit="" if given.derivative else inside if given.excitation is not None else unit,
        **sensor.known(factor=change.factor * abs(gain)),
    )


def _gain(path: Path, name: str, given: MappedChannel) -> float:
    """Factor of a gauge output by its nominal excitation and its shunt readings; 1 for other channels."""
    ratio = given.shunt_ratio
    if abs(ratio - 1) > SHUNT_DOUBTED:
        warn_quality(
            f"{path.name}: the shunt readings multiply {name} by {ratio:.4g}; more than {SHUNT_DOUBTED:.0%} is more "
            "than gains drift, so check the resistor and the bridge: a mistake there is a mistake in all its loads"
        )
    return ratio if given.excitation is None else ratio * 1e3 / given.excitation


def _differentiated(channel: Channel, order: int, rate: float) -> Channel:
    """Differentiate a channel once or twice on the steady clock, by central differences."""
    values = channel.values
    if values.size < 3:
        values = np.zeros_like(values) if order == 2 else np.gradient(values, 1 / rate)
    elif order == 1:
        values = np.gradient(values, 1 / rate)
    else:
        inner = (values[2:] - 2 * values[1:-1] + values[:-2]) * rate**2
        values = np.concatenate((inner[:1], inner, inner[-1:]))
    lost = int(np.count_nonzero(~np.isfinite(values)) - np.count_nonzero(channel.missing))
    if lost > 0:
        warn_quality(
            f"{channel.name}: {lost} more samples are missing after differentiation, beside those missing in the "
            "file; the model bridges them, and the uncertainty is larger there"
        )
    # of white noise, by half the difference over two intervals, or by 1, -2, 1 over one
    gain = rate / np.sqrt(2) if order == 1 else np.sqrt(6) * rate**2
    return replace(channel, values=values, noise=None if channel.noise is None else float(gain * channel.noise))
