"""The test set-up: a TOML file that says what is measured, how, and when it is recorded.

::

    name = "wing A, run 12"
    notes = "after the new fairing"
    gravity = 9.8155            # where the tunnel stands [m/s^2]; 9.80665 where it is not given

    [files]                     # all optional; beside the set-up, or with a path
    balance = "balance.json"
    dynamics = "dynamics.json"
    mass = "mass.json"

    [source]
    kind = "simulated"          # or "replay", "opendaq", "nidaqmx"; each kind has settings of its own
    rig = "vibration"

    [record]
    seconds = 30.0
    pre_trigger = 0.5
    trigger = "level"           # "none", "time", "level" or "call"
    channel = "AF"
    level = 20.0

    [channels.AF]               # all channels of the source, under their own names, where none is listed
    input = "AF"
    unit = "N"
    sign = -1

    [limits.AF]
    low = -500.0
    high = 500.0
    action = "stop"

What the balance may bear in all, and how it is checked, is in tables of `aerobalance.acquisition.safety`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import tomli_w
from pydantic import BaseModel, Field, SerializeAsAny, ValidationError, model_validator

from aerobalance.acquisition.safety import SetEnvelope, SetFouling, SetLimit, SetShunt, SetStation
from aerobalance.acquisition.source import SourceChannel
from aerobalance.acquisition.source_settings import (
    SOURCES,
    Above,
    FileName,
    Name,
    SetupTable,
    Simulated,
    SourceSettings,
    Text,
)
from aerobalance.io.channel_settings import ChannelSettings, NotBelow, Number
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.io.messages import first_fault
from aerobalance.io.safe_write import replacing
from aerobalance.io.toml_file import read_toml, toml_in
from aerobalance.recording.channel import SensorSpec
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError, ReadError
from aerobalance.recording.units import conversion_for

_MOUNTING: Final = frozenset({"coupling", "corner", "place", "place_uncertainty", "axis"})

LATEST: Final = 1.0
"""Longest delay of a channel [s]; the live force waits for it."""


class Files(SetupTable):
    """Table ``[files]``: what turns the channels into loads and forces."""

    balance: FileName | None = None
    dynamics: FileName | None = None
    mass: FileName | None = None


TriggerKind = Literal["none", "time", "level", "call"]


class Record(SetupTable):
    """Table ``[record]``: when a record begins, how long it is, and what it leaves free on the disk."""

    seconds: Annotated[float, Field(gt=0, le=1e7)] | None = None
    block: Annotated[float, Field(ge=0.01, le=10)] = 0.1
    pre_trigger: Annotated[float, Field(ge=0, le=60)] = 0.0
    trigger: TriggerKind = "none"
    delay: Annotated[float, Field(ge=0, le=1e7)] = 0.0
    channel: Name | None = None
    level: Number | None = None
    edge: Literal["rising", "falling"] = "rising"
    after_limit: Annotated[float, Field(ge=0, le=60)] = 0.1
    keep_free: NotBelow = 64.0

    @model_validator(mode="after")
    def _consistent(self) -> Record:
        level = self.trigger == "level"
        if level and (self.channel is None or self.level is None):
            raise ValueError('trigger = "level" needs channel and level')
        if not level and (self.channel, self.level) != (None, None):
            raise ValueError('channel and level go with trigger = "level"')
        if (self.trigger == "time") != (self.delay > 0):
            raise ValueError('trigger = "time" and delay [s] above zero go together')
        return self


class _Input(SetupTable):
    """What comes first in the table of a channel."""

    input: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    unit: Annotated[str, Field(min_length=1, max_length=30)] | None = None


class SetChannel(ChannelSettings, _Input):
    """Table ``[channels.NAME]``: a channel by the name that the program understands.

    Its value is ``sign * (scale * reading + offset)`` in `unit`; without a unit, that of the source. Percentages of a
    load refer to `half_range`, half of its range in `unit`.
    """

    half_range: Above | None = None


class Setup(SetupTable):
    """A test set-up."""

    name: Annotated[str, Field(max_length=200)] = ""
    notes: Text = ""
    gravity: Annotated[float, Field(ge=9.7, le=9.9)] = STANDARD_GRAVITY
    files: Files = Files()
    source: SerializeAsAny[SourceSettings] = Simulated()
    record: Record = Record()
    channels: dict[Name, SetChannel] = Field(default_factory=dict)
    limits: dict[Name, SetLimit] = Field(default_factory=dict)
    envelope: SetEnvelope = SetEnvelope()
    stations: dict[Name, SetStation] = Field(default_factory=dict)
    shunt: dict[Name, SetShunt] = Field(default_factory=dict)
    fouling: SetFouling = SetFouling()

    @model_validator(mode="after")
    def _consistent(self) -> Setup:
        for name, channel in self.channels.items():
            _check_channel(name, channel)
        if self.stations and self.envelope.shape is None:
            raise ValueError('stations: they need envelope.shape ("stations" where they are all there is)')
        if self.envelope.shape == "stations" and not self.stations:
            raise ValueError('envelope.shape: "stations" needs tables [stations.NAME]')
        if self.envelope.shape == "balance" and self.files.balance is None:
            raise ValueError('envelope.shape: "balance" needs files.balance, whose capacities it takes')
        if self.channels:
            self._check_names()
        return self

    def _check_names(self) -> None:
        """Refuse what is set for channels that are not there; loads may be made of gauge outputs."""
        known = [*self.channels, *(COMPONENTS if self.files.balance is not None else ())]
        for table, names in (
            ("limits.{}", self.limits),
            ("shunt.{}", self.shunt),
            ("record.channel", [self.record.channel]),
            ("fouling.channel", [self.fouling.channel]),
        ):
            for name in names:
                if name is not None and name not in known:
                    there = ", ".join(self.channels)
                    raise ValueError(f"{table.format(name)}: there is no {name}; there are {there}")


def _check_channel(name: str, channel: SetChannel) -> None:
    """Refuse names that a file cannot hold, units of the wrong kind, and couplings of what does not move."""
    if not name.isprintable() or name != name.strip() or set(name) & set('[]",;') or name == "time":
        raise ValueError(f"channels: {name!r} is no name for a channel")
    if channel.unit is not None:
        try:
            conversion_for(name, channel.unit)
        except ValueError as error:
            raise ValueError(f"channels.{name}.unit: {error}") from None
    if abs(channel.delay) > LATEST:
        raise ValueError(f"channels.{name}.delay: must be at most {LATEST:g} s, either way, not {channel.delay:g} s")
    fault = channel.fault(name)
    if fault is not None:
        raise ValueError(f"{f'channels.{name}.{fault[0]}'.strip('.')}: {fault[1]}")


def load_setup(path: Path | str) -> Setup:
    """Read a test set-up.

    Raises
    ------
    ReadError
        The file is no TOML, or has a key that is unknown, missing or not allowed; the message names the key.
    """
    file = Path(path)
    return setup_from(read_toml(file, what="a test set-up"), file)


def parse_setup(text: str, path: Path | str = "set-up") -> Setup:
    """Read a test set-up from text; `path` is what messages call it.

    Raises
    ------
    ReadError
        As `load_setup`.
    """
    return setup_from(toml_in(text, path), path)


def setup_from(given: Mapping[str, Any], path: Path | str = "set-up") -> Setup:
    """Make a test set-up of plain data.

    Raises
    ------
    ReadError
        A key is unknown, missing or not allowed; the message names it.
    """
    contents = dict(given)
    source = contents.get("source", {"kind": "simulated"})
    kinds = ", ".join(SOURCES)
    if not isinstance(source, Mapping):
        raise ReadError(path, "source", f"must be a table with a kind ({kinds})")
    kind = source.get("kind")
    if not isinstance(kind, str) or kind not in SOURCES:
        found = "is missing" if kind is None else f"must be one of the known, not {str(kind)[:60]!r}"
        raise ReadError(path, "source.kind", f"{found}; known: {kinds}")
    model = SOURCES[kind]
    try:
        contents["source"] = model.model_validate(dict(source))
    except ValidationError as error:
        where, what = _fault(error, model)
        raise ReadError(path, f"source.{where}" if where else "source", what) from None
    try:
        return Setup.model_validate(contents)
    except ValidationError as error:
        where, what = _fault(error, Setup)
        raise ReadError(path, where, what) from None


def _fault(error: ValidationError, model: type[BaseModel]) -> tuple[str, str]:
    """Key and sentence of the first fault; what the set-up itself refuses says all by itself."""
    where, what = first_fault(error, model)
    fault = error.errors(include_url=False)[0]
    return (where, fault["msg"].removeprefix("Value error, ")) if fault["type"] == "value_error" else (where, what)


def setup_text(setup: Setup) -> str:
    """Write a set-up as TOML: what was set, in the order of the fields. `parse_setup` gives the same set-up again."""
    return tomli_w.dumps(setup.model_dump(exclude_none=True, exclude_unset=True) | _kind(setup))


def save_setup(path: Path | str, setup: Setup) -> None:
    """Write a set-up to a file, whole or not at all.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    with replacing(path) as beside:
        beside.write_text(setup_text(setup), encoding="utf-8")


def _kind(setup: Setup) -> dict[str, Any]:
    return {"source": setup.source.model_dump(exclude_none=True, exclude_unset=True) | {"kind": setup.source.kind}}


def stored_channels(setup: Setup, given: Sequence[SourceChannel]) -> tuple[StoredChannel, ...]:
    """Describe the columns of a recording: the channels of the source, in order, as the set-up has them.

    What the set-up says of a sensor takes the place of what the source knows of it, except that delays add up.

    Raises
    ------
    FitError
        A unit is of the wrong kind for its channel; a name, sign or scale does not suit what the source knows of the
        sensor.
    """
    named = setup.channels or {channel.name: SetChannel() for channel in given}
    renamed = {source.name: name for name, source in zip(named, given, strict=True)}
    found = []
    for (name, channel), source in zip(named.items(), given, strict=True):
        unit = channel.unit or source.unit
        try:
            conversion_for(name, unit)
        except ValueError as error:
            raise FitError(f"channel {name}: the source gives it in [{unit}]: {error}; set its unit") from None
        kept = {key: getattr(channel, key) for key in ("sign", "scale", "offset")}
        sensor = _sensor(name, channel, source, renamed)
        found.append(StoredChannel(name=name, unit=unit, input=source.name, **kept, **sensor))
    return tuple(found)


def _sensor(name: str, channel: SetChannel, source: SourceChannel, renamed: Mapping[str, str]) -> dict[str, Any]:
    """What is known of a sensor in the channel's unit; the channels of the source are `renamed`."""
    known = source.known(factor=abs(channel.scale))
    across = tuple(replace(part, channel=renamed.get(part.channel, part.channel)) for part in source.cross_axis)
    own = channel.model_fields_set & known.keys()
    own |= {key for key, other in (("corner", "coupling"), ("place_uncertainty", "place")) if other in own}
    made = known | {"cross_axis": across} | {key: getattr(channel, key) for key in own}
    fault = channel.model_copy(update={key: made[key] for key in _MOUNTING}).fault(name)
    if fault is not None and SensorSpec(**{key: known[key] for key in _MOUNTING}) != SensorSpec():
        raise FitError(f"channel {name}: what the source knows of its sensor does not suit this name: {fault[1]}")
    if (channel.sign == -1 and ("axis" not in own and made["axis"])) or (
        (channel.sign, channel.scale) != (1, 1.0) and across
    ):
        raise FitError(
            f"channel {name}: the source knows the axis of its sensor, or what it reads across that, which sign and "
            "scale would change; leave these out, or convert the recording first"
        )
    return made | {"delay": channel.delay + source.delay}
