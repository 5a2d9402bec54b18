"""A source published as an openDAQ device, so that other programs on the network can read it.

Servers of openDAQ listen on all addresses of the computer and ask for no password; neither can be set.
"""

from __future__ import annotations

import socket
import time
from typing import Any, Final

import numpy as np

from aerobalance.acquisition.device import extra_library
from aerobalance.acquisition.source import Block, Source
from aerobalance.recording.errors import FitError

PORT: Final = 7420
"""Port of openDAQ's own protocol."""

EPOCH: Final = "1970-01-01T00:00:00Z"
"""What the ticks are counted from, so that they go on where the device is started again."""

_NATIVE: Final = "OpenDAQNativeStreaming"


class PublishedDevice:
    """A device whose signals are the channels of a source.

    The domain counts sampling intervals since `EPOCH`; the first block that is given is now. `first` is what the
    domain has for sample 0 of the source, None before that block.

    Parameters
    ----------
    source
        What is published.
    port
        Where to listen.

    Raises
    ------
    FitError
        The library is not installed, the port cannot be listened on, or the rate is no whole number: readers of
        openDAQ take no other.
    """

    def __init__(self, source: Source, *, port: int = PORT) -> None:
        daq = self._daq = extra_library("opendaq", extra="opendaq")
        builder = daq.InstanceBuilder()
        builder.global_log_level = daq.LogLevel.Off
        self._instance = builder.build()
        if source.rate != round(source.rate):
            raise FitError(f"openDAQ needs a whole number of samples a second, not {source.rate:g}")
        self._rate = round(source.rate)
        self.first: int | None = None
        folder = daq.IFolderConfig.cast_from(self._instance.root_device.get_item("Sig"))
        self._domain, self._instants = self._signal(folder, "time", "s", domain=True)
        self._signals: list[tuple[Any, Any]] = []
        for channel in source.channels:
            signal, descriptor = self._signal(folder, channel.name, channel.unit)
            signal.domain_signal = self._domain
            self._signals.append((signal, descriptor))
        kind = daq.IComponentType.cast_from(self._instance.available_server_types[_NATIVE])
        config = kind.create_default_config()
        config.set_property_value("NativeStreamingPort", port)
        # The library only logs that a port is taken.
        try:
            with socket.create_server(("", port)):
                pass
        except OSError as problem:
            raise FitError(f"cannot listen on port {port}: {problem.strerror}") from None
        self._instance.add_server(_NATIVE, config)

    def give(self, block: Block) -> None:
        """Send a block to whoever reads."""
        daq, rows = self._daq, len(block.samples)
        if self.first is None:
            self.first = time.time_ns() * self._rate // 10**9 - block.end
        instants = daq.DataPacket(self._instants, rows, self.first + block.tick)
        for (signal, descriptor), column in zip(self._signals, block.samples.T, strict=True):
            packet = daq.DataPacketWithDomain(instants, descriptor, rows, 0)
            np.frombuffer(packet.raw_data, dtype=np.float64)[:] = column
            signal.send_packet(packet)
        self._domain.send_packet(instants)

    def _signal(self, folder: Any, name: str, unit: str, *, domain: bool = False) -> tuple[Any, Any]:
        """Add a signal to the device."""
        daq = self._daq
        builder = daq.DataDescriptorBuilder()
        builder.name = name
        builder.unit = daq.Unit(-1, unit, "", "time" if domain else "")
        builder.sample_type = daq.SampleType.Int64 if domain else daq.SampleType.Float64
        if domain:
            builder.rule = daq.LinearDataRule(1, 0)
            builder.tick_resolution = daq.Ratio(1, self._rate)
            builder.origin = EPOCH
        descriptor = builder.build()
        signal = daq.SignalWithDescriptor(self._instance.context, descriptor, folder, name, None)
        signal.name = name
        folder.add_item(signal)
        return signal, descriptor
