"""An openDAQ device as a source: its signals by name, over the network.

The samples of a device are numbered by its domain signal, whose ticks are instants on the clock of the device. A clock
that goes on while the device is away (one that counts from a date) gives the exact length of every gap, a restart of
the device included; one that begins anew with the device is told from its ticks going back.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.acquisition.device import QUIET, Device, extra_library
from aerobalance.acquisition.source import Block, SourceChannel, SourceEndedError
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

RECONNECTION: Final = 0.2
"""Time between attempts of the library to mend a broken connection [s]."""

SHIFTED: Final = 0.01
"""Change of the instants of sampling that is noted, over the sampling interval."""

_NUMBERS: Final = ("Float32", "Float64", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))


@dataclass(slots=True)
class DomainClock:
    """Numbers samples by their instants, in whole numbers: those of a day in nanoseconds are beyond floats.

    Attributes
    ----------
    rate
        Sampling rate [Hz].
    resolution
        Length of a tick [s].
    origin
        Instant of tick 0 [s].
    """

    rate: Fraction
    resolution: Fraction
    origin: Fraction = Fraction(0)
    _first: Fraction | None = None
    _phase: float = 0.0

    @property
    def step(self) -> int:
        """Ticks from one sample to the next.

        Raises
        ------
        FitError
            It is no whole number.
        """
        step = 1 / (self.rate * self.resolution)
        if step.denominator != 1:
            raise FitError(f"the device has {float(step):g} ticks a sample; only whole numbers can be followed")
        return int(step)

    def number(self, tick: int) -> tuple[int, str]:
        """Return the number of the sample at a tick, from the first one asked for; and what is odd about its instant.

        A device that has begun to sample anew does so at other instants between those that were to come.
        """
        instant = tick * self.resolution + self.origin
        if self._first is None:
            self._first = instant
        place = (instant - self._first) * self.rate
        number = round(place)
        phase = float(place - number)
        moved, self._phase = phase - self._phase, phase
        if abs(moved) < SHIFTED:
            return number, ""
        return number, f"from here on sampled {moved:+.2f} of a sampling interval beside the instants before"


def origin_of(text: str) -> Fraction:
    """Return the instant that a domain counts from [s]; 0 where the device does not give a date."""
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        return Fraction(0)
    since = (date if date.tzinfo else date.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return Fraction(since.days * 86400 + since.seconds) + Fraction(since.microseconds, 10**6)


class _Signal(NamedTuple):
    """A signal that can be read, its name and the rate of its domain."""

    signal: Any
    channel: SourceChannel
    path: str
    rate: Fraction


class OpendaqMemory(NamedTuple):
    """What a process that reads a device has to know of the one before it.

    Attributes
    ----------
    channels
        The channels.
    clock
        By which samples are numbered.
    """

    channels: tuple[SourceChannel, ...]
    clock: DomainClock


class OpendaqSource(Device):
    """Signals of an openDAQ device, read together.

    The connection is made anew whenever it is lost; nothing is read meanwhile, and the next block says so.

    Parameters
    ----------
    address
        Connection string of the device, such as ``daq.nd://192.168.0.5`` or ``daqref://device0``.
    names
        The signals wanted, by name, or by path where names are not unique; all that can be read where left out.
    block
        Length of a block [s].
    memory
        What a process before this one knew of the device, which need not be there then.

    Raises
    ------
    FitError
        The library is not installed, the device cannot be reached, a signal is not there or cannot be read, or the
        signals do not share one rate.
    """

    def __init__(
        self,
        address: str,
        *,
        names: Sequence[str] | None = None,
        block: float = 0.02,
        memory: OpendaqMemory | None = None,
    ) -> None:
        super().__init__()
        self.address = address
        self._daq = extra_library("opendaq", extra="opendaq")
        self._ready: deque[Block] = deque()
        self._device: Any = None
        self._reader: Any = None
        self._renewed = True
        builder = self._daq.InstanceBuilder()
        builder.global_log_level = self._daq.LogLevel.Off
        self._instance = builder.build()
        self._names = None if names is None else tuple(names)
        if memory is None:
            signals = self._connect()
            exact = signals[0].rate
            memory = OpendaqMemory(tuple(signal.channel for signal in signals), DomainClock(exact, 1 / exact))
        else:
            self._names = tuple(channel.name for channel in memory.channels)
        self.channels, self._clock = memory
        self.rate = float(self._clock.rate)
        self._rows = max(1, round(block * self.rate))
        self.description = f"openDAQ device {address}, {self.rate:g} Hz"

    @property
    def memory(self) -> OpendaqMemory:
        """What a process after this one has to know."""
        return OpendaqMemory(self.channels, self._clock)

    def start(self) -> None:
        """Begin to read; where another process has read before, once the device is there.

        Raises
        ------
        FitError
            The signals cannot be read together.
        """
        if self._device is not None:
            self._read_all(self._chosen())

    def stop(self) -> None:
        """Disconnect."""
        self._stopped = True
        self._disconnect()

    def read(self, timeout: float) -> Block | None:
        """Return the next samples, as the device has them."""
        if self._stopped:
            raise SourceEndedError("the openDAQ device was disconnected")
        if not self._ready:
            if self._reader is None:
                self._again(timeout)
            else:
                self._fetch(timeout)
        return self._ready.popleft() if self._ready else None

    def _connect(self) -> list[_Signal]:
        config = self._instance.create_default_add_device_config()
        for kind, protocol in (
            ("Device", "OpenDAQNativeConfiguration"),
            ("Device", "OpenDAQNativeStreaming"),
            ("Streaming", "OpenDAQNativeStreaming"),
        ):
            transport = config.get_property_value(f"{kind}.{protocol}.TransportLayerConfig")
            transport.set_property_value("ReconnectionPeriod", round(RECONNECTION * 1e3))
        try:
            self._device = self._instance.add_device(self.address, config)
        except RuntimeError:
            raise FitError(
                f"no openDAQ device answers at {self.address}; check the address, that the device is on, and that no "
                "firewall is between"
            ) from None
        try:
            return self._chosen()
        except FitError:
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        self._reader = None
        if self._device is not None:
            with contextlib.suppress(RuntimeError):
                self._instance.remove_device(self._device)
            self._device = None

    def _wanted(self) -> list[_Signal]:
        """The signals wanted, in the order wanted, as the device has them now."""
        known = [found for signal in self._device.get_signals_recursive() if (found := _readable(self._daq, signal))]
        if not known:
            raise FitError(f"the device at {self.address} has no signal that is sampled at a steady rate")
        return known if self._names is None else [_named(known, name) for name in self._names]

    def _chosen(self) -> list[_Signal]:
        """The signals wanted, under names of their own; refused where they cannot be read together."""
        chosen = self._wanted()
        rates = {signal.rate for signal in chosen}
        if len(rates) > 1:
            listed = ", ".join(f"{signal.channel.name} {float(signal.rate):g} Hz" for signal in chosen)
            raise FitError(f"the signals do not share one rate: {listed}; name those of one rate under [channels]")
        if chosen[0].rate.denominator != 1:
            raise FitError(f"openDAQ reads whole numbers of samples a second, not {float(chosen[0].rate):.9g}")
        names = [signal.channel.name for signal in chosen]
        return [
            signal._replace(channel=SourceChannel(signal.path, signal.channel.unit))
            if names.count(signal.channel.name) > 1
            else signal
            for signal in chosen
        ]

    def _read_all(self, signals: Sequence[_Signal]) -> None:
        """Begin to read the signals together."""
        builder = self._daq.MultiReaderBuilder()
        for signal in signals:
            builder.add_signal(signal.signal)
        builder.value_read_type = self._daq.SampleType.Float64
        builder.domain_read_type = self._daq.SampleType.Int64
        builder.read_timeout_type = self._daq.ReadTimeoutType.All
        try:
            self._reader = builder.build()
        except RuntimeError as problem:
            raise FitError(f"the signals of {self.address} cannot be read together: {problem}") from None
        self._renewed = True
        self._heard = time.monotonic()

    def _again(self, timeout: float) -> None:
        """Try to read anew, not too often: over the connection there is, which may mend itself, or over a new one."""
        if not self._due(timeout):
            return
        with contextlib.suppress(FitError, RuntimeError):
            signals = self._connect() if self._device is None else self._chosen()
            self._check_rate(signals)
            self._read_all(signals)
            return
        if self._device is not None and time.monotonic() - self._heard > QUIET:
            self._lost_for_long()

    def _check_rate(self, signals: Sequence[_Signal]) -> None:
        """End where the device has been set to another rate: a record has one."""
        others = {signal.rate for signal in signals} - {self._clock.rate}
        if others:
            found = ", ".join(f"{float(rate):g} Hz" for rate in sorted(others))
            raise SourceEndedError(f"the device now samples at {found} instead of {self.rate:g} Hz")

    def _lost(self, text: str) -> None:
        """Give the connection up; it is made anew at the next reading."""
        self._note(text)
        self._disconnect()

    def _lost_for_long(self) -> None:
        self._lost(f"no samples for {QUIET:g} s; the connection to {self.address} was made anew")

    def _read_anew(self, text: str) -> None:
        """Begin to read anew, at the next reading, over the same connection.

        Where the library has just mended that, it may not have all signals yet. The device stays, as one that is
        removed meanwhile ends the process: a thread of the library looks for it to tell it that it is connected.
        """
        self._note(text)
        self._reader = None

    def _fetch(self, timeout: float) -> None:
        """Read what there is, up to the rows of a block."""
        try:
            values, ticks, status = self._reader.read_with_domain(
                self._rows, max(1, round(timeout * 1e3)), return_status=True
            )
            now = time.monotonic()
            if ticks.shape[-1]:
                # one signal alone comes without the axis of signals
                self._take(np.atleast_2d(values), np.atleast_2d(ticks), now)
            elif now - self._heard > QUIET:
                self._lost_for_long()
            elif not self._connected():
                self._note(f"the connection to {self.address} was lost and made again")
            # What has changed holds from the next samples on.
            self._renewed |= status.read_status == self._daq.ReadStatus.Event
            if not status.valid:
                self._read_anew("the signals changed and were read anew")
        except (RuntimeError, FitError) as problem:
            if self._connected():
                self._lost(f"the connection to {self.address} was made anew after an error: {problem}")
            else:
                self._read_anew(f"the signals were read anew after an error: {problem}")

    def _follow(self) -> None:
        """Take over the resolution and the origin that all signals are put on."""
        self._check_rate(self._wanted())
        given, self._renewed = self._reader.tick_resolution, False
        self._clock.resolution = Fraction(given.numerator, given.denominator)
        self._clock.origin = origin_of(self._reader.origin)

    def _connected(self) -> bool:
        try:
            states = dict(self._device.connection_status_container.statuses).values()
        except RuntimeError:
            return False
        return all(str(state).endswith(".Connected") for state in states)

    def _take(self, values: Array, ticks: NDArray[np.int64], now: float) -> None:
        """Make blocks of the samples that follow each other; values and ticks have shape (c, n)."""
        self._heard = now
        if self._renewed:
            self._follow()
        if not (ticks == ticks[0]).all():
            # It happens where a server comes back: its signals are subscribed to one after the other.
            self._read_anew("the signals came apart in time and were read anew")
            return
        steps = np.flatnonzero(np.diff(ticks[0]) != self._clock.step) + 1
        for first, last in zip((0, *steps), (*steps, ticks.shape[1]), strict=True):
            number, odd = self._clock.number(int(ticks[0, first]))
            remark = "; ".join(filter(None, (self._said(), odd)))
            self._ready.append(Block(number, np.ascontiguousarray(values[:, first:last].T), now, remark))


def _readable(daq: Any, signal: Any) -> _Signal | None:
    """Describe a signal of plain numbers at a steady rate; None for any other."""
    descriptor = signal.descriptor
    if signal.domain_signal is None or descriptor is None or len(descriptor.dimensions or ()):
        return None
    domain = daq.ISignal.cast_from(signal.domain_signal).descriptor
    if domain is None or domain.tick_resolution is None or domain.rule.type != daq.DataRuleType.Linear:
        return None
    if str(descriptor.sample_type).rpartition(".")[2] not in _NUMBERS:
        return None
    interval = Fraction(domain.tick_resolution.numerator, domain.tick_resolution.denominator)
    rate = 1 / (interval * Fraction(dict(domain.rule.parameters)["delta"]))
    unit = "" if descriptor.unit is None else descriptor.unit.symbol
    return _Signal(signal, SourceChannel(signal.name, unit), signal.global_id.strip("/"), rate)


def _named(known: Sequence[_Signal], name: str) -> _Signal:
    """Find the signal of a name or path."""
    found = [signal for signal in known if signal.channel.name == name]
    found = found or [signal for signal in known if f"/{signal.path}".endswith(f"/{name.strip('/')}")]
    if len(found) > 1:
        raise FitError(f"several signals are called {name!r}: {', '.join(one.path for one in found)}; give the path")
    if not found:
        listed = ", ".join(signal.channel.name for signal in known)
        raise FitError(f"the device has no signal {name!r} that is sampled at a steady rate; it has {listed}")
    # under the name asked for, by which the set-up knows it
    return found[0]._replace(channel=SourceChannel(name, found[0].channel.unit))
