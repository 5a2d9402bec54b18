"""A record on the clock that its forces are estimated on: its own, or a slower one that its parts are decimated to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Final, NamedTuple

import numpy as np

from aerobalance.balance.load_checks import beyond_range
from aerobalance.balance.load_sums import LoadSums
from aerobalance.balance.loads import Loads
from aerobalance.estimation.checks.impossible_channels import is_of_ground
from aerobalance.estimation.checks.outliers import Outliers, outliers_of, without_outliers
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.decimation import Decimation
from aerobalance.recording.doubts import Doubt, of_pieces
from aerobalance.recording.errors import OfLoads, OfMissing, kept_warnings, warn_quality
from aerobalance.recording.parts import Extent, LongRecord
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly
from aerobalance.recording.sensors import corrected, undone_with
from aerobalance.recording.short_gaps import short_gaps_filled
from aerobalance.recording.side_by_side import side_by_side

Given = Recording | Loads
MadeReady = Callable[[Given], Given]
"""Converts gauge outputs to balance loads, and returns loads unchanged."""

AT_ONCE: Final = 1 << 16
"""Samples of a record that are read, examined or decimated together."""


def beside_pieces(record: LongRecord[Given]) -> int:
    """Samples beside a piece of a record, on either side, that the filters of its channels are undone with."""
    with kept_warnings():  # given when the piece is read again
        given = record.part(0, min(AT_ONCE, record.samples))
    return undone_with(given.recording if isinstance(given, Loads) else given)


class OwnClock(NamedTuple):
    """The record's own clock over a part that was put on a slower one.

    Attributes
    ----------
    begin
        First sample of the record there.
    recording
        The channels from there on, without their samples.
    """

    begin: int
    recording: Recording

    def within(self, first: int, last: int) -> tuple[Recording, slice]:
        """The clock, and which of its samples are those from one of the record to another (not included)."""
        return self.recording, slice(first - self.begin, last - self.begin)


class WorkingPart(NamedTuple):
    """Samples of a record on the clock that its forces are worked out on.

    Attributes
    ----------
    given
        The samples, with balance loads [N, N*m].
    own
        Which of them were asked for: filters are undone with those beside them. None where all are.
    doubts
        Doubts about the wild, stuck and clipped samples that were looked for on a faster clock.
    clock
        That clock; None where there is none.
    """

    given: Given
    own: slice | None = None
    doubts: tuple[Doubt, ...] = ()
    clock: OwnClock | None = None

    @property
    def wanted(self) -> Given:
        """Those samples that were asked for."""
        return self.given if self.own is None else self.given.part(self.own.start, self.own.stop)


def unfiltered_part(given: Given, own: slice) -> Given:
    """Samples of a run, what filters did to its channels undone with those beside them."""
    if isinstance(given, Loads):
        return replace(given, recording=corrected(given.recording)).part(own.start, own.stop)
    return corrected(given).part(own.start, own.stop)


@dataclass(frozen=True, slots=True, eq=False)
class RecordAsItIs:
    """A record on its own clock.

    Attributes
    ----------
    record
        The record.
    made_ready
        Converts samples that are gauge outputs to balance loads.
    beside
        Samples on either side of a part that the filters of its channels are undone with, and that are read with it
        (`aerobalance.recording.sensors.undone_with`): what is in memory is larger by as many.
    """

    record: LongRecord[Given]
    made_ready: MadeReady
    beside: int = 0

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
        """Number of samples of the record for each sample of this clock: 1."""
        return 1

    @property
    def shown(self) -> tuple[float, ...]:
        """Nothing is known of the power at the natural frequencies before the record is read."""
        return ()

    def part(self, begin: int, end: int) -> WorkingPart:
        """Samples `begin` to `end` (excluded) and those `beside` them, with balance loads [N, N*m].

        Its wild, stuck and clipped samples are looked for where the forces are estimated.
        """
        wide = _wider(slice(begin, end), self.beside, self.samples)
        if wide == slice(begin, end):
            return WorkingPart(self.made_ready(self.record.part(begin, end)))
        own = slice(begin - wide.start, end - wide.start)
        read, missing = _read(self.record, wide, own)
        _tell_missing(self.name, missing, samples=end - begin)
        return WorkingPart(self.made_ready(read), own)


class _Piece(NamedTuple):
    """Samples of the slower clock with balance loads, and what there is of the record's own samples there.

    These are their time stamps and outliers, how many readings of each channel are missing, where the record says that
    some are, numbers of the loads that were worked out of gauge outputs, and what was said.
    """

    given: Recording | Loads
    stamps: Array
    outliers: Outliers
    missing: Counter[str]
    sums: LoadSums | None
    said: list[str]


@dataclass(frozen=True, slots=True, eq=False)
class DecimatedRecord:
    """A record on a slower clock.

    Attributes
    ----------
    record
        The record on its own clock.
    made_ready
        Converts samples that are gauge outputs to balance loads.
    decimation
        Factor between the clocks, and where the samples of the slower one are in the record.
    components
        Components whose forces are estimated.
    shown
        Power of the loads at each natural frequency over that of the noise there, at least, all along the record [1].
    beside
        Samples of the record on either side of a piece that the filters of its channels are undone with, and that are
        read with it (`aerobalance.recording.sensors.undone_with`). A piece is no shorter than that, so that no sample
        is read more than three times, and what is in memory grows with the slowest filter.
    """

    record: LongRecord[Given]
    made_ready: MadeReady
    decimation: Decimation
    components: tuple[str, ...]
    shown: tuple[float, ...] = ()
    beside: int = 0

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
        """Time of the first sample of the slower clock [s]."""
        return self.record.start + self.decimation.before / self.record.rate

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""
        return self.record.epoch

    @property
    def every(self) -> int:
        """Number of samples of the record for each sample of the slower clock."""
        return self.decimation.factor

    def part(self, begin: int, end: int) -> WorkingPart:
        """Samples `begin` to `end` (excluded) of the slower clock, with balance loads [N, N*m]."""
        step = max(max(AT_ONCE, self.beside) // self.every, 1)
        edges = [*range(begin, end, step), end]
        if len(edges) > 2 and edges[-1] - edges[-2] < step // 2:
            # a short piece is joined to the one before: the noise of its readings could not be estimated
            del edges[-2]
        pieces, stamps, found, missing, sums, said = zip(*side_by_side(self._piece, pairwise(edges)), strict=True)
        joined, whole, outliers = _joined(pieces), np.concatenate(stamps), Outliers.joined(found)
        del pieces
        joined = self._told(joined, [one for one in sums if one is not None], list(chain.from_iterable(said)))
        _tell_missing(self.name, sum(missing, Counter[str]()), samples=whole.size)
        first = self.decimation.span(begin, end).start
        recording = joined.recording if isinstance(joined, Loads) else joined
        clock = {name: replace(one, values=np.zeros(0)) for name, one in recording.channels.items()}
        fast = replace(
            recording,
            stamps=whole,
            rows=np.arange(whole.size),
            start=self.record.start + first / self.record.rate,
            rate=self.record.rate,
            channels=clock,
            decimated=1,
        )
        names = [name for name in self.components if name in fast]
        return WorkingPart(joined, None, outliers.doubts(fast, names), OwnClock(first, fast))

    def _told(self, joined: Given, sums: Sequence[LoadSums], said: Sequence[str]) -> Given:
        """The part, with doubts in its own numbers; what was said of its pieces is said once, with these too."""
        of_loads = [text for text in said if isinstance(text, OfLoads) and text.startswith(f"{self.name}: ")]
        for text in dict.fromkeys(said):
            if not isinstance(text, OfMissing) and text not in of_loads:
                warn_quality(text)
        if not isinstance(joined, Loads) or not sums:
            return joined
        together = LoadSums.joined(sums)
        joined = replace(joined, doubts=together.doubts(joined.doubts))
        if of_loads:
            for text in together.said(self.name, joined):
                warn_quality(text)
        return joined

    def _piece(self, ends: tuple[int, int]) -> _Piece:
        """Read and decimate a piece of a part."""
        begin, end = ends
        wanted, span = self.decimation.wanted(begin, end), self.decimation.span(begin, end)
        wide = _wider(wanted, self.beside, self.record.samples)
        there = slice(span.start - wide.start, span.stop - wide.start)
        with kept_warnings() as said:
            read, missing = _read(self.record, wide, there)
            given = self.made_ready(read)
        beyond, sums = Counter[str](), None
        if isinstance(given, Loads):
            if isinstance(read, Recording):
                sums = LoadSums.of(read, given, there)
                beyond = sums.beyond
            elif given.beyond:
                beyond += Counter(beyond_range(given.balance, given.native[there]))
        outliers = outliers_of(given, self.components)
        given = self._without_short_gaps(without_outliers(given, outliers, self.components, clipped=True))
        stated = given.recording if isinstance(given, Loads) else given
        undone, own = corrected(stated), slice(wanted.start - wide.start, wanted.stop - wide.start)
        recording = undone.part(own.start, own.stop)
        stamps, outliers = recording.stamps[there.start - own.start : there.stop - own.start], outliers.within(there)
        if not isinstance(given, Loads):
            return _Piece(self._recording(recording, begin, end), stamps, outliers, missing, sums, said)
        given = given.part(own.start, own.stop)
        first = self.decimation.before + begin * self.every - wanted.start
        rows = slice(first, first + (end - begin - 1) * self.every + 1, self.every)
        values = self.decimation.decimated(given.values, begin, end)
        # the loads are channels too, unless a filter that they state was undone
        known = zip(given.components, values.T, strict=True) if undone is stated else ()
        slow = self._recording(recording, begin, end, known=dict(known))
        felt = replace(
            given,
            values=values,
            native=self.decimation.decimated(given.native, begin, end),
            apart=given.apart if len(given.apart) == 1 else given.apart[rows],
            noise_covariance=given.noise_covariance / self.every,
            beyond=beyond,
            recording=slow,
            stuck=None,
            clipped=None,
        )
        return _Piece(felt, stamps, outliers, missing, sums, said)

    def _without_short_gaps(self, given: Given) -> Given:
        """The readings with short gaps filled, of loads and of the ground's motion; of others all by straight lines.

        So are gaps of the loads in the balance's own components, which tell how the errors of the matrix are felt.
        """
        recording = given.recording if isinstance(given, Loads) else given
        gaps = [name for name, one in recording.channels.items() if np.isnan(one.values).any()]
        if not gaps:
            return given
        channels = dict(recording.channels)
        felt = [name for name in gaps if name in self.components or is_of_ground(name)]
        if felt:
            table = short_gaps_filled(np.column_stack([channels[name].values for name in felt]), self.every)
            channels |= {name: replace(channels[name], values=one) for name, one in zip(felt, table.T, strict=True)}
        for name in set(gaps) - set(felt):
            channels[name] = replace(channels[name], values=_with_straight_lines(channels[name].values))
        recording = replace(recording, channels=channels)
        if not isinstance(given, Loads):
            return recording
        lost = np.isnan(given.values).any(axis=1)
        native = np.column_stack([_with_straight_lines(np.where(lost, np.nan, one)) for one in given.native.T])
        values = np.column_stack([channels[name].values for name in given.components])
        return replace(given, values=values, native=native, recording=recording)

    def _recording(
        self, recording: Recording, begin: int, end: int, *, known: Mapping[str, Array] | None = None
    ) -> Recording:
        """The recording with its channels and clock decimated; `known` are channels that are decimated already."""
        factor, count = self.every, end - begin
        known = {} if known is None else known
        channels = {name: self._channel(one, begin, end, known.get(name)) for name, one in recording.channels.items()}
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

    def _channel(self, channel: Channel, begin: int, end: int, known: Array | None) -> Channel:
        """The channel decimated: the standard deviation of white noise falls with the root of the factor."""
        values = self.decimation.decimated(channel.values[:, None], begin, end)[:, 0] if known is None else known
        noise = None if channel.noise is None else channel.noise / np.sqrt(self.every)
        return replace(channel, values=values, noise=noise)


def _wider(part: slice, beside: int, samples: int) -> slice:
    """A part of a record of so many samples with some beside it, as far as they are there."""
    return slice(max(part.start - beside, 0), min(part.stop + beside, samples))


def _read(record: LongRecord[Given], wanted: slice, there: slice) -> tuple[Given, Counter[str]]:
    """Samples of a record, and how many readings of each channel lack in a slice of them, if it says that some do."""
    with kept_warnings() as said:
        read = record.part(wanted.start, wanted.stop)
    missing = Counter[str]()
    if any(isinstance(text, OfMissing) for text in said):
        channels = read.recording if isinstance(read, Loads) else read
        missing = +Counter({one.name: int(np.count_nonzero(one.missing[there])) for one in channels})
    for text in said:
        if not isinstance(text, OfMissing):
            warn_quality(text)
    return read, missing


def _tell_missing(name: str, missing: Counter[str], *, samples: int) -> None:
    """Say once of a part of a record how many readings of which channels are missing."""
    for count in dict.fromkeys(missing.values()):
        channels = ", ".join(channel for channel, one in missing.items() if one == count)
        warn_quality(OfMissing.readings(name, channels, count, samples))


def _with_straight_lines(values: Array) -> Array:
    """Readings with straight lines across their gaps; as they are where none is there."""
    return values if np.isnan(values).all() else interpolate_gaps_linearly(values)


def _joined(pieces: Sequence[Given]) -> Given:
    """Consecutive pieces of a part, joined to one."""
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
    # in a gap there is no noise to be judged
    covariances = [one.noise_covariance for one in felt if np.isfinite(one.values).any()] or [felt[0].noise_covariance]
    apart = felt[0].apart if len(felt[0].apart) == 1 else np.concatenate([one.apart for one in felt])
    return replace(
        felt[0],
        values=np.concatenate([one.values for one in felt]),
        native=np.concatenate([one.native for one in felt]),
        apart=apart,
        noise_covariance=np.mean(covariances, axis=0),
        beyond=sum((Counter(one.beyond) for one in felt), Counter[str]()),
        contraction=max(one.contraction for one in felt),
        doubts=of_pieces(doubt for one in felt for doubt in one.doubts),
        recording=recording,
    )
