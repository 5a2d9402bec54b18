"""Tables ``[source]`` of devices: what they are, and how each of their inputs is wired."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from aerobalance.acquisition.fields import Above, Name, NotBelow, Number, Table
from aerobalance.acquisition.source import Source


class SourceSettings(Table):
    """Table ``[source]``: what gives the samples; each kind has a class of its own."""

    kind: str

    def open(self, folder: Path, *, inputs: Sequence[str]) -> Source:
        """Make the source.

        Parameters
        ----------
        folder
            Where files are looked for.
        inputs
            The channels that are wanted, by their names at the source; none for all. A source may give others too.
        """
        raise NotImplementedError


class Opendaq(SourceSettings):
    """``kind = "opendaq"``: an openDAQ device. Which of its signals are read is said by ``input`` of the channels."""

    kind: Literal["opendaq"] = "opendaq"
    address: Annotated[str, Field(pattern=r"^(daq\.(nd|ns|lt|opcua)|daqref)://[!-~]{1,200}$")]
    block: Annotated[float, Field(ge=1e-3, le=0.2)] = 0.02

    def open(self, folder: Path, *, inputs: Sequence[str]) -> Source:
        """Connect to the device."""
        from aerobalance.acquisition.opendaq import OpendaqSource  # noqa: PLC0415 - only the process of the source needs it

        del folder
        return OpendaqSource(self.address, names=tuple(dict.fromkeys(inputs)) or None, block=self.block)


class NiInput(Table):
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

    def open(self, folder: Path, *, inputs: Sequence[str]) -> Source:
        """Set the task up."""
        from aerobalance.acquisition.nidaqmx import NidaqmxSource  # noqa: PLC0415 - only the process of the source needs it

        del folder, inputs  # all are read, as the order in which a device takes them makes their delays
        return NidaqmxSource(self.inputs, rate=self.rate, server=self.server, skew=self.skew, block=self.block)
