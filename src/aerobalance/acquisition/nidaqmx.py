"""Bridge, voltage and acceleration channels of NI-DAQmx devices as a source, here or behind an NI gRPC Device Server.

All channels are in one task and share its sample clock. Samples are numbered by the task's own count, so that what an
overrun costs is known to the sample. A task that had to be made anew counts from zero: how long it was away is told
from the computer's clock.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from aerobalance.acquisition.device import QUIET, Device, extra_library
from aerobalance.acquisition.source import Block, SourceChannel, SourceEndedError
from aerobalance.acquisition.source_settings import NiInput
from aerobalance.recording.errors import FitError

BUFFER: Final = 5.0
"""Length of the buffer of the driver [s]; a program that is held up for longer loses samples."""

UNITS: Final = {"bridge": "mV/V", "voltage": "V", "acceleration": "m/s^2"}
"""Unit of the readings."""

_OVERRUN: Final = -200279
_NOT_YET: Final = -200284
_KEEPALIVE: Final = (("grpc.keepalive_time_ms", 10_000), ("grpc.keepalive_timeout_ms", 2_000))


class NidaqmxSource(Device):
    """Analog inputs of NI-DAQmx devices on one sample clock.

    Parameters
    ----------
    inputs
        The inputs by name, in the order in which a multiplexed device takes them.
    rate
        Sampling rate asked for [Hz]; `rate` of the source is what the device makes of it.
    server
        ``host:port`` of an NI gRPC Device Server; None for the driver of this computer.
    skew
        Time from one channel of a device to the next where it has one converter for all [s].
    block
        Length of a block [s].

    Raises
    ------
    FitError
        The library or the driver is not installed, the server cannot be reached, or the device refuses an input.
    """

    def __init__(
        self,
        inputs: dict[str, NiInput],
        *,
        rate: float,
        server: str | None = None,
        skew: float = 0.0,
        block: float = 0.02,
    ) -> None:
        super().__init__()
        self._ni = extra_library("nidaqmx", extra="nidaqmx")
        self._constants = extra_library("nidaqmx.constants", extra="nidaqmx")
        self._inputs, self._asked, self._server = inputs, rate, server
        self._block = block
        self._anew = False
        self._task: Any = None
        self._link: Any = None
        if server is not None:
            self._link = extra_library("grpc", extra="nidaqmx").insecure_channel(server, options=_KEEPALIVE)
        try:
            self.rate = self._make()
        except self._ni.errors.Error as problem:
            self._drop()
            raise FitError(f"NI-DAQmx at {server or 'this computer'}: {_sentence(problem)}") from None
        self._rows = max(1, round(block * self.rate))
        self._buffer = np.empty((len(inputs), self._rows))
        self._reader = self._reader_of_task()
        self.channels = tuple(
            SourceChannel(name, UNITS[inputs[name].measures], delay=delay)
            for name, delay in zip(inputs, skews([given.physical for given in inputs.values()], skew), strict=True)
        )
        devices = dict.fromkeys(given.physical.partition("/")[0] for given in inputs.values())
        asked = "" if self.rate == rate else f" ({rate:g} Hz asked for)"
        self.description = f"NI-DAQmx {', '.join(devices)}, {len(inputs)} channels, {self.rate:.10g} Hz{asked}"

    def start(self) -> None:
        """Start the sample clock.

        Raises
        ------
        FitError
            The device refuses.
        """
        try:
            self._task.start()
        except self._ni.errors.Error as problem:
            raise FitError(f"NI-DAQmx cannot start: {_sentence(problem)}") from None
        self._heard = time.monotonic()

    def stop(self) -> None:
        """Free the devices."""
        self._stopped = True
        self._drop()
        if self._link is not None:
            self._link.close()

    def read(self, timeout: float) -> Block | None:
        """Return the next samples once there are as many as a block has."""
        if self._stopped:
            raise SourceEndedError("the NI-DAQmx task was ended")
        if self._task is None:
            self._again(timeout)
            return None
        try:
            return self._fetch(timeout)
        except self._ni.errors.Error as problem:
            code = getattr(problem, "error_code", None)
            if code == _OVERRUN:
                return self._overrun(timeout)
            if code != _NOT_YET:
                self._lost(_sentence(problem))
            elif getattr(problem, "samps_per_chan_read", 0):
                # What the driver had read by then is counted, but cannot be had through a server.
                self._note("a reading was cut short, as the device fell behind")
            elif time.monotonic() - self._heard > QUIET:
                self._lost(f"no samples for {QUIET:g} s")
        return None

    def _fetch(self, timeout: float) -> Block:
        """Read a block; its place is what the task says of it, as a reading cut short by a fault counts too."""
        self._reader.read_many_sample(self._buffer, self._rows, timeout=timeout + self._block)
        self._heard = time.monotonic()
        tick = int(self._task.in_stream.curr_read_pos) - self._rows
        anew, self._anew = self._anew, False
        return Block(tick, self._buffer.T.copy(), self._heard, self._said(), anew)

    def _overrun(self, timeout: float) -> Block | None:
        """Go on with the newest samples; those between were overwritten before they were read."""
        stream, places = self._task.in_stream, self._constants.ReadRelativeTo
        self._note("overrun: the driver's buffer was overwritten before it was read")
        try:
            stream.offset, stream.relative_to = -self._rows, places.MOST_RECENT_SAMPLE
            found = self._fetch(timeout)
            stream.offset, stream.relative_to = 0, places.CURRENT_READ_POSITION
        except self._ni.errors.Error as problem:
            self._lost(_sentence(problem))
            return None
        return found

    def _lost(self, text: str) -> None:
        """Give the task up; it is made anew at the next reading."""
        self._note(f"the task was made anew: {text}")
        self._drop()

    def _again(self, timeout: float) -> None:
        """Try to make the task anew, not too often."""
        if not self._due(timeout):
            return
        try:
            rate = self._make()
            if rate != self.rate:
                raise SourceEndedError(f"the device came back with {rate:g} Hz instead of {self.rate:g} Hz")
            self._reader = self._reader_of_task()
            self._task.start()
        except self._ni.errors.Error:
            self._drop()
            return
        self._anew, self._heard = True, time.monotonic()

    def _make(self) -> float:
        """Make the task; return the rate that it has."""
        options = None if self._link is None else self._ni.GrpcSessionOptions(self._link, "")
        self._task = self._ni.Task(grpc_options=options)
        for name, given in self._inputs.items():
            self._add(name, given)
        self._task.timing.cfg_samp_clk_timing(
            self._asked,
            sample_mode=self._constants.AcquisitionType.CONTINUOUS,
            samps_per_chan=max(round(BUFFER * self._asked), 2),
        )
        self._task.in_stream.overwrite = self._constants.OverwriteMode.OVERWRITE_UNREAD_SAMPLES
        return float(self._task.timing.samp_clk_rate)

    def _reader_of_task(self) -> Any:
        readers = extra_library("nidaqmx.stream_readers", extra="nidaqmx")
        return readers.AnalogMultiChannelReader(self._task.in_stream)

    def _add(self, name: str, given: NiInput) -> None:
        """Add an input to the task."""
        known, channels = self._constants, self._task.ai_channels
        place = {"name_to_assign_to_channel": name, "min_val": given.low, "max_val": given.high}
        if given.measures == "bridge":
            channels.add_ai_bridge_chan(
                given.physical,
                **place,
                units=known.BridgeUnits.MILLIVOLTS_PER_VOLT,
                bridge_config=known.BridgeConfiguration[f"{given.bridge.upper()}_BRIDGE"],
                voltage_excit_source=known.ExcitationSource[given.excitation_source.upper()],
                voltage_excit_val=given.excitation,
                nominal_bridge_resistance=given.resistance,
            )
        elif given.measures == "acceleration":
            source = "NONE" if given.current == 0 else given.excitation_source.upper()
            channels.add_ai_accel_chan(
                given.physical,
                **place,
                units=known.AccelUnits.METERS_PER_SECOND_SQUARED,
                sensitivity=given.sensitivity,
                sensitivity_units=known.AccelSensitivityUnits.MILLIVOLTS_PER_G,
                current_excit_source=known.ExcitationSource[source],
                current_excit_val=given.current,
            )
        else:
            channels.add_ai_voltage_chan(given.physical, **place, units=known.VoltageUnits.VOLTS)

    def _drop(self) -> None:
        if self._task is not None:
            with contextlib.suppress(self._ni.errors.Error):
                self._task.close()
            self._task = None


def skews(physical: Sequence[str], skew: float) -> tuple[float, ...]:
    """Delays of channels that the converter of their device takes one after the other [s].

    A channel taken after the clock's edge is ahead of it: its delay is negative.
    """
    devices = [name.partition("/")[0] for name in physical]
    return tuple(-skew * devices[:number].count(device) + 0.0 for number, device in enumerate(devices))


def _sentence(problem: Exception) -> str:
    """The driver's words without its paragraphs."""
    return " ".join(str(problem).split())[:300]
