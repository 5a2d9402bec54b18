"""The channel map: a TOML file that says what the columns of a foreign file are."""

from __future__ import annotations

import tomllib
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from aerobalance.io.columns import RawColumn, RawColumns, split_label
from aerobalance.io.messages import first_fault
from aerobalance.io.table import Column, check_time, on_clock
from aerobalance.io.text_table import SEPARATORS, Layout, read_labels
from aerobalance.io.units import conversion, expected_unit, readable
from aerobalance.problems import DoubtWarning, ReadError
from aerobalance.recording import QUANTITIES, Array, Channel, Coupling, Recording

Number = Annotated[float, Field(allow_inf_nan=False)]
Position = Annotated[str, Field(min_length=1)] | Annotated[int, Field(ge=1)]

_DERIVED_FROM: Final = {0: "m/s^2", 1: "m/s", 2: "m"}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class FileLayout(_Strict):
    """Table ``[file]``: how the file is laid out. Whatever is left out is recognised from the file."""

    time: Position | None = None
    time_unit: str | None = None
    rate: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    separator: Literal["comma", "semicolon", "tab", "space"] | None = None
    decimal: Literal[".", ","] | None = None
    header_line: Annotated[int, Field(ge=0)] | None = None
    skip_lines: Annotated[int, Field(ge=0)] = 0
    encoding: str | None = None


class MappedChannel(_Strict):
    """Table ``[channels.NAME]``: where a channel comes from and what it is.

    The channel's value is ``sign * (scale * cell + offset)`` in `unit`, differentiated `derivative` times.
    """

    column: Position
    unit: str | None = None
    scale: Number = 1.0
    offset: Number = 0.0
    sign: Literal[1, -1] = 1
    delay: Number = 0.0
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    relative_uncertainty: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    coupling: Coupling = "kinematic"
    corner: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    derivative: Literal[0, 1, 2] = 0


class _Contents(_Strict):
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
        )

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
    try:
        with file.open("rb") as stream:
            given: dict[str, Any] = tomllib.load(stream)
    except FileNotFoundError:
        raise ReadError(file, "", "there is no such file") from None
    except OSError as error:
        raise ReadError(file, "", f"cannot be read: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ReadError(file, "", f"is no TOML: {error}") from None
    try:
        contents = _Contents.model_validate(given)
    except ValidationError as error:
        where, what = first_fault(error, _Contents)
        raise ReadError(file, where, what) from None
    chosen = ChannelMap(file, contents.file, contents.channels)
    _check(chosen)
    return chosen


def _check(chosen: ChannelMap) -> None:
    """Refuse settings that contradict each other."""
    path, file = chosen.path, chosen.file
    if (file.time is None) == (file.rate is None):
        raise ReadError(
            path, "file", "needs either time (the time column) or rate (samples per second, evenly spaced)"
        )
    if file.time_unit is not None:
        _converted(chosen, "file.time_unit", file.time_unit, "s")
    for name, channel in chosen.channels.items():
        key = f"channels.{name}"
        if name == "time":
            raise ReadError(path, key, "the time column belongs under [file]: time = ...")
        if (channel.corner > 0) != (channel.coupling == "ac"):
            raise ReadError(path, f"{key}.corner", 'goes with coupling = "ac" (then above 0 Hz) and with no other')
        accelerometer = QUANTITIES.get(name) == "m/s^2"
        if not accelerometer and (channel.coupling != "kinematic" or channel.derivative):
            raise ReadError(path, key, "coupling and derivative are for accelerations, such as ground_acceleration")
        if channel.unit is not None:
            _converted(chosen, f"{key}.unit", channel.unit, _column_unit(name, channel))


def _column_unit(name: str, channel: MappedChannel) -> str | None:
    """Unit inside of a channel before it is differentiated."""
    return _DERIVED_FROM[channel.derivative] if channel.derivative else expected_unit(name)


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
    stamps, time_unit = _stamps(raw, chosen)
    channels = {name: _channel(raw, chosen, name) for name in chosen.channels}
    recording = on_clock(raw.path, stamps, channels, time_unit=time_unit)
    derived = {name: channel.derivative for name, channel in chosen.channels.items() if channel.derivative}
    if not derived:
        return recording
    replaced = dict(recording.channels)
    for name, order in derived.items():
        replaced[name] = _differentiated(replaced[name], order, recording.rate)
    return Recording(
        name=recording.name,
        stamps=recording.stamps,
        rows=recording.rows,
        start=recording.start,
        rate=recording.rate,
        channels=replaced,
        time_unit=recording.time_unit,
    )


def _stamps(raw: RawColumns, chosen: ChannelMap) -> tuple[Array, str]:
    """Time of every row [s], and the unit it had in the file."""
    if chosen.file.rate is not None:
        if raw.rows < 2:
            raise ReadError(raw.path, "", f"has {raw.rows} row(s) of samples; a recording needs at least two")
        return np.arange(raw.rows) / chosen.file.rate, "s"
    if chosen.file.time is None:
        raise ReadError(chosen.path, "file", "needs either time or rate")
    column = raw.find(chosen.file.time, where="header")
    unit = chosen.file.time_unit or column.unit
    if not unit:
        raise ReadError(chosen.path, "file.time_unit", f"is needed: the header {column.label!r} does not say the unit")
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
        change = conversion(unit, expected=_column_unit(name, given))
    except ValueError as error:
        raise ReadError(raw.path, f"header, {column.place}", f"{error} for {name}") from None
    derived = given.derivative > 0
    return Channel(
        name,
        change.inside(given.sign * (given.scale * column.values + given.offset)),
        "m/s^2" if derived else change.unit,
        noise=None if given.noise is None else given.noise * change.factor,
        relative_uncertainty=given.relative_uncertainty,
        delay=given.delay,
        coupling=given.coupling,
        corner=given.corner,
        file_unit="" if derived else unit,
    )


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
        warnings.warn(
            f"{channel.name}: {lost} more samples are missing after differentiation, beside those missing in the "
            "file; the model bridges them, and the uncertainty is larger there",
            DoubtWarning,
            stacklevel=3,
        )
    settings = {slot: getattr(channel, slot) for slot in Channel.__slots__ if slot != "values"}
    return Channel(**settings, values=values)


def template(path: Path | str) -> str:
    """Write a channel map for a foreign file, made from its header, to be completed by hand.

    Parameters
    ----------
    path
        The foreign file.

    Returns
    -------
    str
        TOML with comments; every column that is not the time is a commented table.

    Raises
    ------
    ReadError
        The file is no text, or has no header.
    """
    file = Path(path)
    labels = read_labels(file)
    time = next((i for i, label in enumerate(labels) if _is_time(label)), None)
    blocks = [_HEAD.format(names=", ".join(QUANTITIES), file=_quoted(file.name)[1:-1])]
    if time is None:
        blocks.append(
            "# time = 1          # header text or number of the time column, or give the rate\nrate = 1000.0  # Hz"
        )
    else:
        blocks.append(f"time = {_quoted(labels[time])}")
        if not split_label(labels[time])[1]:
            blocks.append('time_unit = "s"')
    blocks.append(_FILE_KEYS)
    for i, label in enumerate(labels):
        if i != time:
            blocks.append(_block(i + 1, label))
    return "\n".join(blocks)


def _is_time(label: str) -> bool:
    name, unit = split_label(label)
    return name.lower().startswith("time") and (
        not unit or (readable(unit) and unit in ("s", "ms", "us", "min", "sec"))
    )


def _quoted(text: str) -> str:
    """Write a TOML string."""
    escaped = "".join(
        "\\\\" if sign == "\\" else '\\"' if sign == '"' else sign if sign.isprintable() else f"\\u{ord(sign):04x}"
        for sign in text
    )
    return f'"{escaped}"'


def _block(number: int, label: str) -> str:
    name, unit = split_label(label)
    known = name if name in QUANTITIES else f"column_{number}"
    lines = [f"[channels.{known}]", f"column = {_quoted(label) if label else number}"]
    lines.append(f"unit = {_quoted(unit)}" if unit else 'unit = "N"  # the header does not say it')
    return "\n".join(["", *(line if known == name else f"# {line}" for line in lines)])


_HEAD: Final = """\
# Channel map for {file}.
# Rename each table that is needed to what the channel is, and remove the "# " before it:
#   {names}
# Any other name is passed on untouched. Columns without a table are ignored.

[file]"""

_FILE_KEYS: Final = """\
# separator = "tab"   # comma, semicolon, tab, space; recognised if left out
# decimal = "."       # or ","
# header_line = 1     # 0: no header, columns by number
# skip_lines = 0      # lines between the header and the first row of numbers
# encoding = "utf-8"

# Every channel may have, beside column and unit:
#   scale = 1.0, offset = 0.0, sign = 1   value = sign * (scale * cell + offset), in unit
#   delay = 0.0                 time by which the readings lag the clock [s]
#   noise = 0.1                 standard uncertainty of one reading, in unit; estimated if left out
#   relative_uncertainty = 0.0  standard uncertainty of the gain [1]
#   derivative = 0              1: a velocity, 2: a position, to be turned into an acceleration
#   coupling = "kinematic"      or "dc" (reads gravity too) or "ac" (then corner = high-pass corner [Hz])"""
