"""Tables ``[source]`` of a test set-up, one class for each kind of source, and the fields that tables are made of.

Nothing here takes long to load: `aerobalance.acquisition.sources` opens what the tables describe.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, field_validator, model_validator

from aerobalance.io.channel_settings import NotBelow, Number, Strict
from aerobalance.io.measure import LARGEST
from aerobalance.recording.components import COMPONENTS

Above = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=10_000)]
Name = Annotated[str, Field(min_length=1, max_length=60)]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]


class SetupTable(Strict):
    """A table of a set-up."""


RigName = Literal["vibration", "cable_cut", "six"]

HALF_RANGES: Final[dict[RigName, dict[str, float]]] = {
    "vibration": {"AF": 100.0},
    "cable_cut": {"AF": 2000.0},
    "six": dict.fromkeys(COMPONENTS, 2000.0),
}
"""Half of the range of each component [N, N*m]: AF as printed, the others assumed."""

SHUNT_SHARE: Final = 0.4
"""What the shunt of the simulated bridges changes their loads by, over half of the range."""

TOUCH_SHARE: Final = 0.05
"""Force between model and support while they touch, over half of the range."""

CLOSED: Final = 5.0
"""Voltage of the contact circuit where it is closed [V]."""

LARGEST_SHARE: Final = 2.0
"""Largest load of each component alone, over half of the range, of the rig with six; assumed."""


class SourceSettings(SetupTable):
    """Table ``[source]``: what gives the samples; each kind has a class of its own."""

    kind: str


class Simulated(SourceSettings):
    """``kind = "simulated"``: see `aerobalance.acquisition.simulated.RigSettings`."""

    kind: Literal["simulated"] = "simulated"
    rig: RigName = "vibration"
    rate: Annotated[float, Field(ge=10, le=1e6)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    speed: Annotated[float, Field(gt=0)] = 1.0
    block: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.02
    frequency: Above = 100.0
    amplitude: NotBelow = 10.0
    cable_force: Annotated[float, Field(ge=-1e5, le=1e5)] | None = None
    cut_at: NotBelow | None = None
    noise: NotBelow = 1.0
    circuit: Literal["none", "fouling"] = "none"
    balance: FileName | None = None


class Replay(SourceSettings):
    """``kind = "replay"``: a recording, played again."""

    kind: Literal["replay"] = "replay"
    file: FileName
    map: FileName | None = None
    speed: Annotated[float, Field(gt=0)] = 1.0
    block: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.02
    loop: bool = False


class Opendaq(SourceSettings):
    """``kind = "opendaq"``: an openDAQ device. Which of its signals are read is said by ``input`` of the channels."""

    kind: Literal["opendaq"] = "opendaq"
    address: Annotated[str, Field(pattern=r"^(daq\.(nd|ns|lt|opcua)|daqref)://[!-~]{1,200}$")]
    block: Annotated[float, Field(ge=1e-3, le=0.2)] = 0.02


class NiInput(SetupTable):
    """Table ``[source.inputs.NAME]``: an analog input of an NI-DAQmx device.

    `low` and `high` are the range in the unit of what is measured: mV/V for a bridge, V, or m/s^2. The excitation of a
    bridge is in V, its resistance in ohm; the sensitivity of an accelerometer in mV/g and its current in A.
    """

    physical: Annotated[str, Field(pattern=r"^[^\s/,:]+/[^\s/,:]+$", max_length=100)]
    measures: Literal["bridge", "voltage", "acceleration"]
    low: Number
    high: Number
    excitation: Above | None = None
    excitation_source: Literal["internal", "external"] = "internal"
    bridge: Literal["full", "half", "quarter"] = "full"
    resistance: Above = 350.0
    sensitivity: Above | None = None
    current: NotBelow = 0.004

    @model_validator(mode="after")
    def _consistent(self) -> NiInput:
        if not self.low < self.high:
            raise ValueError(f"low must be below high, not {self.low:g} and {self.high:g}")
        if (self.measures == "bridge") != (self.excitation is not None):
            raise ValueError('excitation [V] goes with measures = "bridge", and is needed there')
        if (self.measures == "acceleration") != (self.sensitivity is not None):
            raise ValueError('sensitivity [mV/g] goes with measures = "acceleration", and is needed there')
        return self


class Nidaqmx(SourceSettings):
    """``kind = "nidaqmx"``: inputs of NI-DAQmx devices on one sample clock.

    `server` is host:port of an NI gRPC Device Server, where the devices are not in this computer. `skew` is the time
    from one channel to the next of a device that has one converter for all.
    """

    kind: Literal["nidaqmx"] = "nidaqmx"
    rate: Annotated[float, Field(ge=1, le=2e6)]
    inputs: Annotated[dict[Name, NiInput], Field(min_length=1)]
    server: Annotated[str, Field(pattern=r"^[!-~]{1,200}:[0-9]{1,5}$")] | None = None
    skew: Annotated[float, Field(ge=0, le=1e-3)] = 0.0
    block: Annotated[float, Field(ge=1e-3, le=0.2)] = 0.02

    @field_validator("inputs")
    @classmethod
    def _once(cls, given: dict[str, NiInput]) -> dict[str, NiInput]:
        places = [part.physical.lower() for part in given.values()]
        twice = next((place for place in places if places.count(place) > 1), None)
        if twice is not None:
            raise ValueError(f"{twice} is given twice; a task takes each input once")
        return given

    @model_validator(mode="after")
    def _fits(self) -> Nidaqmx:
        devices = [part.physical.partition("/")[0] for part in self.inputs.values()]
        most = max(devices.count(device) for device in devices)
        if self.skew * (most - 1) * self.rate >= 1:
            raise ValueError(
                f"skew: {most} channels of {self.skew:g} s each do not fit into an interval at {self.rate:g} Hz"
            )
        return self


SOURCES: Final[dict[str, type[SourceSettings]]] = {
    "simulated": Simulated,
    "replay": Replay,
    "opendaq": Opendaq,
    "nidaqmx": Nidaqmx,
}
"""The kinds of source; listing one here is all it takes."""
