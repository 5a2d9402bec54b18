"""The clock on which the forces of a long record are worked out: slower than its own where that loses nothing.

A balance that rings at 300 Hz is recorded at 25 kHz, for the sake of its steps and of the filters. Above some multiple
of the highest natural frequency the readings then hold nothing but noise, and a force there has none of it to thank.
White noise stays white on the slower clock (`aerobalance.recording.decimation`), the load in the band stays what it
is, and the response to a step is filtered as the readings are, so that prior, likelihood and uncertainty are the same.
What a sample costs, it costs once for each of the slower clock.

The record is looked at first, all of it: samples are missing, wild or clipped, or the load goes beyond that band, then
it keeps its clock. So does a record that is short enough to be worked out at once.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Final, Protocol

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.checks.outliers import without_wild_samples
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.decimation import ROLL_OFF, Decimation
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.fourier import hann
from aerobalance.recording.parts import Extent, LongRecord
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected
from aerobalance.recording.side_by_side import WORKERS, side_by_side

Given = Recording | Loads
MadeReady = Callable[[Given], Given]
"""Makes balance loads of gauge outputs, and gives loads as they are."""


@dataclass(frozen=True, slots=True)
class WorkingClockSettings:
    """When a record is worked out on a slower clock, and on which.

    Attributes
    ----------
    periods
        Band of the slower clock, in which its filter changes nothing, over the highest natural frequency, at least.
    beyond
        The same over the highest frequency at which the load stands out of the noise.
    stands_out
        Density of a load over that of the noise in a block of samples, and in the whole record, from which on it
        stands out. Of noise alone, a band of a block has some 200 degrees of freedom: one in 1e12 has twice its level.
    factors
        Factors by which the clock may be slower; four at least, or little is gained.
    at_once
        Samples that are looked at together.
    block, segment
        Samples of a block, and of the segments that its spectrum is averaged over.
    bands
        Bands of equal width in which the spectrum is looked at.
    """

    periods: float = 3.0
    beyond: float = 1.5
    stands_out: tuple[float, float] = (2.0, 1.25)
    factors: tuple[int, ...] = (16, 15, 14, 12, 10, 9, 8, 7, 6, 5, 4)
    at_once: int = 1 << 16
    block: int = 1 << 14
    segment: int = 1 << 11
    bands: int = 64


SETTINGS: Final = WorkingClockSettings()
"""Settings that are used."""


class WorkingRecord(Protocol):
    """A record as its forces are worked out: on its own clock or on a slower one, its gauge outputs made loads."""

    @property
    def name(self) -> str:
        """What it is called in messages."""

    @property
    def samples(self) -> int:
        """Number of samples of the clock on which it is worked out."""

    @property
    def rate(self) -> float:
        """Sampling rate of that clock [Hz]."""

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""

    @property
    def every(self) -> int:
        """Samples of the record for each of that clock."""

    def part(self, begin: int, end: int) -> Given:
        """Samples from one to another (not included), with loads."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordAsItIs:
    """A record on its own clock.

    Attributes
    ----------
    record
        The record.
    made_ready
        Makes loads of samples that are gauge outputs.
    """

    record: LongRecord[Given]
    made_ready: MadeReady

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.record.name

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.record.samples

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return self.record.rate

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return self.record.start

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""
        return self.record.epoch

    @property
    def every(self) -> int:
        """1."""
        return 1

    def part(self, begin: int, end: int) -> Given:
        """Samples from one to another (not included), with loads."""
        return self.made_ready(self.record.part(begin, end))


@dataclass(frozen=True, slots=True, eq=False)
class DecimatedRecord:
    """A record on a slower clock.

    Attributes
    ----------
    record, made_ready
        The record, and what makes loads of samples of it that are gauge outputs.
    decimation
        How much slower the clock is.
    """

    record: LongRecord[Given]
    made_ready: MadeReady
    decimation: Decimation
    _clocks: list[tuple[int, Recording]] = field(init=False, default_factory=list)

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.record.name

    @property
    def samples(self) -> int:
        """Number of samples of the slower clock."""
        return self.decimation.count

    @property
    def rate(self) -> float:
        """Sampling rate of the slower clock [Hz]."""
        return self.record.rate / self.decimation.factor

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return self.record.start + self.decimation.before / self.record.rate

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""
        return self.record.epoch

    @property
    def every(self) -> int:
        """Samples of the record for each of the slower clock."""
        return self.decimation.factor

    def part(self, begin: int, end: int) -> Given:
        """Samples of the slower clock from one to another (not included), with loads."""
        step = max(SETTINGS.at_once // self.every, 1)
        edges = [*range(begin, end, step), end]
        if len(edges) > 2 and edges[-1] - edges[-2] < step // 2:
            del edges[-2]  # no piece so short that its noise is not known
        pieces, stamps = zip(*side_by_side(self._piece, pairwise(edges)), strict=True)
        joined, whole = _joined(pieces), np.concatenate(stamps)
        del pieces
        recording = joined.recording if isinstance(joined, Loads) else joined
        clock = {name: replace(one, values=np.zeros(0)) for name, one in recording.channels.items()}
        fast = replace(
            recording,
            stamps=whole,
            rows=np.arange(whole.size),
            rate=self.record.rate,
            channels=clock,
            decimated=1,
        )
        self._clocks[:] = [(self.decimation.span(begin, end).start, fast)]
        return joined

    def clock(self, first: int, last: int) -> tuple[Recording, slice]:
        """The clock of the part of the record that was worked on last, and which of its samples are wanted.

        Parameters
        ----------
        first, last
            First sample of the record that is wanted, and the one after the last.
        """
        ((begin, recording),) = self._clocks
        return recording, slice(first - begin, last - begin)

    def _piece(self, ends: tuple[int, int]) -> tuple[Given, Array]:
        """A piece of a part, and the time stamps of its samples of the record [s]."""
        begin, end = ends
        wanted = self.decimation.wanted(begin, end)
        given = self.made_ready(self.record.part(wanted.start, wanted.stop))
        recording = corrected(given.recording if isinstance(given, Loads) else given)
        span = self.decimation.span(begin, end)
        stamps = recording.stamps[span.start - wanted.start : span.stop - wanted.start]
        slow = self._recording(recording, begin, end)
        if not isinstance(given, Loads):
            return slow, stamps
        first = self.decimation.before + begin * self.every - wanted.start
        rows = slice(first, first + (end - begin - 1) * self.every + 1, self.every)
        felt = replace(
            given,
            values=self.decimation.decimated(given.values, begin, end),
            native=self.decimation.decimated(given.native, begin, end),
            apart=given.apart if len(given.apart) == 1 else given.apart[rows],
            noise_covariance=given.noise_covariance / self.every,
            recording=slow,
        )
        return felt, stamps

    def _recording(self, recording: Recording, begin: int, end: int) -> Recording:
        factor, count = self.every, end - begin
        channels = {name: self._channel(one, begin, end) for name, one in recording.channels.items()}
        start = self.start + begin / self.rate
        span = recording.extent.end - recording.extent.begin
        wanted = self.decimation.wanted(begin, end)
        ends = (self.decimation.before + place * factor - wanted.start for place in (begin, end - 1))
        first, last = (recording.extent.begin + end * span / (wanted.stop - wanted.start - 1) for end in ends)
        return replace(
            recording,
            stamps=start + np.arange(count) / self.rate,
            rows=np.arange(count),
            start=start,
            rate=self.rate,
            channels=channels,
            extent=Extent(first, last, recording.extent.means),
            decimated=factor,
        )

    def _channel(self, channel: Channel, begin: int, end: int) -> Channel:
        values = self.decimation.decimated(channel.values[:, None], begin, end)[:, 0]
        noise = None if channel.noise is None else channel.noise / np.sqrt(self.every)
        return replace(channel, values=values, noise=noise)


def _joined(pieces: Sequence[Given]) -> Given:
    """Pieces of a part, one after the other, as one."""
    if len(pieces) == 1:
        return pieces[0]
    recordings = [one.recording if isinstance(one, Loads) else one for one in pieces]
    first, last = recordings[0], recordings[-1]
    recording = replace(
        first,
        stamps=np.concatenate([one.stamps for one in recordings]),
        rows=np.arange(sum(one.samples for one in recordings)),
        channels={
            name: replace(channel, values=np.concatenate([one.channel(name).values for one in recordings]))
            for name, channel in first.channels.items()
        },
        extent=replace(first.extent, end=last.extent.end),
    )
    felt = [one for one in pieces if isinstance(one, Loads)]
    if not felt:
        return recording
    apart = felt[0].apart if len(felt[0].apart) == 1 else np.concatenate([one.apart for one in felt])
    return replace(
        felt[0],
        values=np.concatenate([one.values for one in felt]),
        native=np.concatenate([one.native for one in felt]),
        apart=apart,
        noise_covariance=np.mean([one.noise_covariance for one in felt], axis=0),
        beyond=sum((Counter(one.beyond) for one in felt), Counter[str]()),
        contraction=max(one.contraction for one in felt),
        recording=recording,
    )


def slower_clock(
    record: LongRecord[Given], dynamics: BalanceDynamics, made_ready: MadeReady
) -> DecimatedRecord | None:
    """Return a record on the slowest clock that loses nothing of its load; None where that is its own.

    Parameters
    ----------
    record
        The record.
    dynamics
        Its components.
    made_ready
        Makes loads of samples that are gauge outputs.
    """
    highest = max(mode.natural_frequency for mode in dynamics.modes)
    fitting = [one for one in SETTINGS.factors if _band(record.rate, one) >= SETTINGS.periods * highest]
    if not fitting:
        return None
    look = _Look(record.rate, above=_band(record.rate, fitting[0]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # it is said when the record is worked out
            begins, length = _pieces(record.samples)
            looked = partial(look.levels, record, made_ready, dynamics, length=length)
            for some in PROGRESS.each([begins[at : at + WORKERS] for at in range(0, len(begins), WORKERS)], "look"):
                if not look.add(side_by_side(looked, some)):
                    return None
    except FitError:
        return None  # said as well when it is worked out
    for factor in fitting:
        if _band(record.rate, factor) >= SETTINGS.beyond * look.highest:
            return DecimatedRecord(record, made_ready, Decimation(factor, record.samples))
    return None


def _band(rate: float, factor: int) -> float:
    """Frequency up to which a clock that is slower by a factor leaves all as it is [Hz]."""
    return (1 - ROLL_OFF) * rate / (2 * factor)


def _pieces(samples: int) -> tuple[list[int], int]:
    """First samples of the pieces in which a record is looked at, and their length."""
    length = min(SETTINGS.at_once, samples)
    begins = [*range(0, samples - length + 1, length)]
    if begins[-1] + length < samples:
        begins.append(samples - length)
    return begins, length


@dataclass(slots=True, eq=False)
class _Look:
    """What pieces of a record show above the noise.

    Attributes
    ----------
    rate
        Sampling rate [Hz].
    above
        Frequency above which the level of the noise is judged [Hz].
    highest
        Highest frequency at which a load stands out of the noise so far [Hz].
    """

    rate: float
    above: float
    _highest: float = 0.0
    _power: dict[str, Array] = field(default_factory=dict)

    @property
    def highest(self) -> float:
        """Highest frequency at which a load stands out of the noise, in a block or in all of them together [Hz]."""
        whole = [self._edge(power[None], SETTINGS.stands_out[1]) for power in self._power.values()]
        return max(self._highest, *whole)

    def levels(
        self,
        record: LongRecord[Given],
        made_ready: MadeReady,
        dynamics: BalanceDynamics,
        begin: int,
        *,
        length: int,
    ) -> dict[str, Array]:
        """Return the level of each band in each block of a piece by component; none where samples are not sound."""
        given = made_ready(record.part(begin, begin + length))
        recording = given.recording if isinstance(given, Loads) else given
        names = [name for name in dynamics.components if name in recording]
        whole = all(np.isfinite(channel.values).all() for channel in recording)
        if not whole or without_wild_samples(given, names)[1]:
            return {}
        return {name: self._levels(recording.channel(name).values) for name in names}

    def add(self, found: Sequence[Mapping[str, Array]]) -> bool:
        """Add the levels of some pieces; return whether all their samples can be taken as they are."""
        for piece in found:
            for name, levels in piece.items():
                self._highest = max(self._highest, self._edge(levels, SETTINGS.stands_out[0]))
                self._power[name] = self._power.get(name, np.zeros(levels.shape[1])) + levels.sum(axis=0)
        return all(found)

    def _levels(self, values: Array) -> Array:
        """Density of each band in each block, shape (blocks, bands), up to a factor."""
        segment = min(SETTINGS.segment, values.size)
        count = max(values.size // segment, 1)
        segments = values[: count * segment].reshape(count, segment)
        spectrum = np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * hann(segment))[:, 1:]
        power = spectrum.real**2 + spectrum.imag**2
        each = max(power.shape[1] // SETTINGS.bands, 1)
        bands = power[:, : power.shape[1] // each * each].reshape(count, -1, each).mean(axis=2)
        block = max(min(SETTINGS.block // segment, count), 1)
        return np.asarray(bands[: count // block * block].reshape(-1, block, bands.shape[1]).mean(axis=1))

    def _edge(self, levels: Array, stands_out: float) -> float:
        """Upper edge of the highest band that stands out of the noise in any row [Hz]; 0 if none does."""
        width = 0.5 * self.rate / levels.shape[1]
        noise = np.median(levels[:, int(np.ceil(self.above / width)) :], axis=1, keepdims=True)
        out = np.flatnonzero((levels > stands_out * noise).any(axis=0))
        return float((out[-1] + 1) * width) if out.size else 0.0
