"""What a source of samples is: channels, a rate, and blocks of samples that carry their ticks."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from aerobalance.recording.channel import Array, SensorSpec
from aerobalance.recording.errors import FitError

_HEAD: Final = struct.Struct("<qdqqI?")


@dataclass(frozen=True, slots=True)
class SourceChannel(SensorSpec):
    """One channel as its source has it, and what the source knows of its sensor.

    Attributes
    ----------
    name
        Name at the source.
    unit
        Unit of the readings.
    """

    name: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Samples that follow each other without a gap.

    Attributes
    ----------
    tick
        Number of the first sample on the clock of the source: it counts every sampling interval, whether or not its
        sample was delivered, so that a gap shows as a jump.
    samples
        Readings, shape (n, c), n of any size; NaN where a single reading is missing.
    received
        When the last of them arrived, on the steady clock of the computer [s].
    remark
        What the source has to say of the time before the first sample (an overrun, a new connection); an empty string
        for nothing.
    anew
        Whether the count of the device began anew since the last block, so that the tick says nothing of the time
        between.
    """

    tick: int
    samples: Array
    received: float
    remark: str = ""
    anew: bool = False

    def __post_init__(self) -> None:
        if self.samples.ndim != 2:
            raise ValueError(f"samples of a block must have shape (n, c), not {self.samples.shape}")

    @property
    def end(self) -> int:
        """Tick after the last sample."""
        return self.tick + len(self.samples)

    def to_bytes(self) -> bytes:
        """Pack the block for another process."""
        remark = self.remark.encode("utf-8", "replace")
        head = _HEAD.pack(self.tick, self.received, *self.samples.shape, len(remark), self.anew)
        return b"".join((head, remark, np.ascontiguousarray(self.samples, dtype="<f8").tobytes()))

    @classmethod
    def from_bytes(cls, packed: bytes) -> Block:
        """Unpack a block."""
        tick, received, rows, columns, length, anew = _HEAD.unpack_from(packed)
        start = _HEAD.size + length
        remark = packed[_HEAD.size : start].decode("utf-8")
        samples = np.frombuffer(packed, dtype="<f8", offset=start).reshape(rows, columns)
        return cls(tick, samples, received, remark, anew)


class SourceEndedError(Exception):
    """The source has no more samples and will have none; the message says why."""


class Source(Protocol):
    """Gives blocks of samples from its start to its end.

    Devices deliver blocks of any size, drop out and come back. The source does not hide it: it numbers samples by the
    ticks of the device, so that what is missing can be counted, and puts into the next block's remark what it knows
    of the reason. Where a device forgets its count (a restart), its ticks go back or `anew` is set, and `remark` says
    so.
    """

    @property
    def channels(self) -> tuple[SourceChannel, ...]:
        """The c channels, in the order of the columns of every block."""

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""

    @property
    def clocked(self) -> bool:
        """Whether samples come at `rate` by a clock, so that its drift against the computer's can be watched."""

    @property
    def patient(self) -> bool:
        """Whether it may be kept waiting without losing samples; a device may not."""

    @property
    def description(self) -> str:
        """What gives the samples, in one line."""

    @property
    def controls(self) -> tuple[str, ...]:
        """Names of what can be set while it runs."""

    def start(self) -> None:
        """Begin.

        Raises
        ------
        FitError, OSError
            The device cannot be used; the message says why.
        """

    def read(self, timeout: float) -> Block | None:
        """Return the next samples, or None when there are none within `timeout` [s].

        Raises
        ------
        SourceEndedError
            There will be no more.
        """

    def control(self, name: str, value: float) -> str:
        """Set what can be set while the source runs, at the next sample; return what was done, in one line.

        Raises
        ------
        ValueError
            There is no such control, or the value is not allowed.
        """

    def stop(self) -> None:
        """End; the source can be started no more."""


class Uncontrolled:
    """A source of which nothing can be set while it runs."""

    controls: tuple[str, ...] = ()

    def control(self, name: str, value: float) -> str:
        """Refuse.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(f"nothing can be set while this source runs; {name!r} = {value:g} is refused")


class Chosen:
    """Some channels of a source, in an order of their own.

    Parameters
    ----------
    source
        The source.
    names
        The channels wanted, by their names at the source.

    Raises
    ------
    FitError
        The source has no such channel; the message lists those it has.
    """

    def __init__(self, source: Source, names: Sequence[str]) -> None:
        known = {channel.name: number for number, channel in enumerate(source.channels)}
        for name in names:
            if name not in known:
                raise FitError(f"the source has no channel {name!r}; it has {', '.join(known)}")
        self._source = source
        self._columns = [known[name] for name in names]
        self.channels = tuple(source.channels[column] for column in self._columns)
        self.rate, self.clocked, self.patient = source.rate, source.clocked, source.patient
        self.description, self.controls = source.description, source.controls
        self.start, self.control, self.stop = source.start, source.control, source.stop

    def read(self, timeout: float) -> Block | None:
        """Return the next samples of the channels wanted."""
        block = self._source.read(timeout)
        return None if block is None else replace(block, samples=block.samples[:, self._columns])


class Pacing:
    """Counts the samples that are due from a source without a device: at its rate, a multiple of it, or at once.

    Parameters
    ----------
    rate
        Sampling rate [Hz].
    speed
        Seconds of the source in a second of the clock; infinite for as fast as possible.

    Raises
    ------
    ValueError
        The speed is not above zero.
    """

    def __init__(self, rate: float, speed: float) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be above zero, not {speed:g}")
        self.rate, self.speed = rate, speed
        self._began = 0.0

    def start(self) -> None:
        """Count from now on."""
        self._began = time.monotonic()

    def wait(self, done: int, rows: int, timeout: float) -> bool:
        """Wait until `rows` samples beyond the first `done` are due, `timeout` [s] at most; say whether they are."""
        if math.isinf(self.speed):
            return True
        due = self._began + (done + rows) / (self.rate * self.speed)
        left = due - time.monotonic()
        if left <= 0:
            return True
        time.sleep(min(left, timeout))
        return left <= timeout
