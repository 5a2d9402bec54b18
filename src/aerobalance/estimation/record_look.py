"""The look at all of a long record before its forces are estimated: how far its loads stand out of their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.special import chdtri

from aerobalance.balance.loads import Loads
from aerobalance.estimation.checks.impossible_channels import is_of_ground
from aerobalance.estimation.checks.outliers import outliers_of, without_outliers
from aerobalance.estimation.record_ends import load_at_ends, stretches_of
from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import is_short_gap
from aerobalance.recording.fourier import hann
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import gaps_in
from aerobalance.recording.short_gaps import short_gaps_filled


@dataclass(frozen=True, slots=True)
class LookSettings:
    """How the spectra of a record are looked at.

    Attributes
    ----------
    chance
        Probability that the density of a band in a block of noise alone is taken for a load: with all its segments it
        is a chi-squared of some 195 degrees of freedom over their number, and stands out from 1.8 times the level on.
    stands_out
        Spectral density of the readings over that of their noise from which on a load is taken to be there in the mean
        of all blocks, at least [1].
    deviations
        Standard deviations of that mean, of noise alone, by which it must stand out as well: of few blocks a quarter
        is five of them, and one record of 6 s in a thousand had that.
    block, segment
        Samples of a block, and of the segments over which its spectrum is averaged.
    bands, parts
        Number of bands of equal width over which the spectrum is averaged, and of parts of each. The upper edge of a
        load that stands out in a band is that of the highest part where it does, or else the band's.
    chance_of_part
        Probability that the density of a part in a block of noise alone is taken for that load: it stands out from
        1.75 times the level on there, so that what is missed is no more than in a band where nothing stands out.
    deviations_of_part
        Standard deviations of the mean of all blocks by which it must stand out in a part.
    gaps
        Gaps of a channel in a piece, at most, for a slower clock: in all, and of those that are not short beside it.
    """

    chance: float = 4e-11
    stands_out: float = 1.25
    deviations: float = 7.0
    block: int = 1 << 14
    segment: int = 1 << 11
    bands: int = 64
    parts: int = 4
    chance_of_part: float = 1e-3
    deviations_of_part: float = 3.0
    gaps: tuple[int, int] = (4096, 64)


SETTINGS: Final = LookSettings()
"""The settings in use."""

FREEDOM: Final = 12.2
"""Degrees of freedom of a band's density in a segment: its 32 numbers over 2.63, the sum of the squared
correlations of lines that the window joins."""


class Levels(NamedTuple):
    """Spectral density of the blocks of a piece, up to a constant factor; segments that lack a sample are left out.

    Attributes
    ----------
    bands
        Mean of each part of the bands, shape (blocks, parts).
    resonant
        Density at each natural frequency, shape (blocks, modes).
    segments
        Segments of each block.
    """

    bands: Array
    resonant: Array
    segments: int


class Piece(NamedTuple):
    """What a piece of a record shows.

    Attributes
    ----------
    levels
        Levels of its loads, by component.
    stretches
        Stretches of them that the ends of the record are compared by (`aerobalance.estimation.record_ends`), likewise.
    gaps
        Lengths of the gaps of each load and channel of the ground's motion that has some [samples].
    """

    levels: dict[str, Levels]
    stretches: dict[str, Array]
    gaps: tuple[NDArray[np.intp], ...]


@dataclass(slots=True, eq=False)
class Look:
    """Spectra of the pieces of a record, and the highest frequency at which a load is above the noise in them.

    Attributes
    ----------
    rate
        Sampling rate [Hz].
    above
        Frequency above which the level of the noise is judged [Hz].
    modes
        Natural frequencies [Hz].
    factor
        Largest factor by which the clock may be slower.
    highest
        Highest frequency at which a load is above the noise in the pieces added so far [Hz].
    """

    rate: float
    above: float
    modes: tuple[float, ...]
    factor: int
    _highest: float = 0.0
    _power: dict[str, Array] = field(default_factory=dict)
    _least: dict[str, Array] = field(default_factory=dict)
    _segments: dict[str, int] = field(default_factory=dict)
    _stretches: dict[str, list[Array]] = field(default_factory=dict)
    _gaps: tuple[NDArray[np.intp], ...] = ()

    @property
    def highest(self) -> float:
        """Highest frequency at which a load is above the noise, in one block or in the mean of all [Hz]."""
        whole = [self._edge(power[None], _of_mean(self._segments[name])) for name, power in self._power.items()]
        return max(self._highest, *whole)

    @property
    def shown(self) -> tuple[float, ...]:
        """Power at each natural frequency over that of the noise, in the block and the load where it is least [1]."""
        ratios = [
            least * self._segments[name] / self._noise(_of_bands(self._power[name][None]))[0] - 1
            for name, least in self._least.items()
            if self._segments[name]
        ]
        if not ratios:  # all of the record lies in gaps
            return (0.0,) * len(self.modes)
        return tuple(np.maximum(np.max(ratios, axis=0), 0.0).tolist())

    def at(self, given: Recording | Loads, components: Sequence[str]) -> Piece:
        """Return what a piece shows of the loads of some components, its wild, stuck and clipped samples left out."""
        found = outliers_of(given, components)
        clean = without_outliers(given, found, components, clipped=True)
        recording = clean.recording if isinstance(clean, Loads) else clean
        names = [name for name in components if name in recording]
        needed = [one.values for name, one in recording.channels.items() if name in names or is_of_ground(name)]
        lost = (np.isnan(values) for values in needed)
        gaps = tuple(np.array([last - first for first, last in gaps_in(gap)]) for gap in lost if gap.any())
        loads = None
        if gaps and all(map(_are_few, gaps)):  # otherwise it keeps its clock
            loads = self._mostly_whole(np.column_stack([recording.channel(name).values for name in names]))
        values = {
            name: recording.channel(name).values if loads is None else loads[:, place]
            for place, name in enumerate(names)
        }
        return Piece(
            {name: self._levels(one) for name, one in values.items()},
            {name: stretches_of(one) for name, one in values.items()},
            gaps,
        )

    def add(self, pieces: Sequence[Piece]) -> None:
        """Add what some pieces show."""
        for piece in pieces:
            self._gaps += piece.gaps
            for name, stretches in piece.stretches.items():
                self._stretches.setdefault(name, []).append(stretches)
            for name, levels in piece.levels.items():
                bands, resonant, segments = levels
                self._highest = max(self._highest, self._edge(bands, _of_block(segments)))
                self._segments[name] = self._segments.get(name, 0) + segments * len(bands)
                # a block of few segments, as gaps leave them, is known less well and counts for as many as it has
                self._power[name] = self._power.get(name, np.zeros(bands.shape[1])) + segments * bands.sum(axis=0)
                least = resonant.min(axis=0, initial=np.inf)
                self._least[name] = np.minimum(self._least.get(name, np.inf), least)

    def ends_allow(self, band: float) -> bool:
        """Whether no load beyond a band [Hz] is at the ends of the record, which the windows leave out."""
        return not any(load_at_ends(one, band / self.rate) for one in self._stretches.values())

    def gaps_allow(self, factor: int) -> bool:
        """Whether the gaps of each piece are so few that a clock which is slower by a factor is still less work."""
        return all(
            _are_few(gaps) and sum(not is_short_gap(length, factor) for length in gaps) <= SETTINGS.gaps[1]
            for gaps in self._gaps
        )

    def _mostly_whole(self, loads: Array) -> Array:
        """Readings of loads, shape (n, c), their short gaps filled where more than half of the segments have some."""
        segment = min(SETTINGS.segment, len(loads))
        lacking = np.unique(np.flatnonzero(np.isnan(loads).any(axis=1)) // segment).size
        return loads if 2 * lacking * segment < len(loads) else short_gaps_filled(loads, self.factor)

    def _levels(self, values: Array) -> Levels:
        """Levels of the readings of one load."""
        segment = min(SETTINGS.segment, values.size)
        # they overlap by half: nothing sudden is where all of them have their ends, but at the ends of the record
        segments = sliding_window_view(values, segment)[:: max(segment // 2, 1)]
        count = len(segments)
        whole = np.isfinite(segments).all(axis=1)
        if not whole.all():
            segments = segments[whole]
            count = len(segments)
            if not count:
                return Levels(np.zeros((0, _parts(segment // 2)[0])), np.zeros((0, len(self.modes))), 1)
        level = segments.mean(axis=1, keepdims=True)
        spectrum = np.asarray(rfft((segments - level) * _window(segment)), dtype=np.complex128)[:, 1:]
        power = spectrum.real**2 + spectrum.imag**2
        parts, each = _parts(power.shape[1])
        bands = power[:, : parts * each].reshape(count, parts, each).mean(axis=2)
        lines = np.clip(np.round(np.array(self.modes) / self.rate * segment).astype(int) - 1, 0, power.shape[1] - 1)
        block = max(min(2 * SETTINGS.block // segment, count), 1)
        first = np.arange(0, count - block + 1, block)
        if first[-1] + block < count:  # the last block has some of the one before
            first = np.append(first, count - block)
        within = first[:, None] + np.arange(block)
        return Levels(bands[within].mean(axis=1), power[:, lines][within].mean(axis=1), block)

    def _edge(self, parts: Array, stands_out: tuple[float, float]) -> float:
        """Upper edge of the highest part of a band that is above the noise in any row of `parts` [Hz]; 0 if none is.

        `stands_out` is the density over that of the noise from which on a load is in a band, and in a part of it.
        """
        bands = _of_bands(parts)
        noise = self._noise(bands)[:, None]
        there = bands > stands_out[0] * noise
        out = np.flatnonzero(there.any(axis=0))
        if not out.size:
            return 0.0
        rows, first = there[:, out[-1]], out[-1] * SETTINGS.parts
        within = (parts[rows, first : first + SETTINGS.parts] > stands_out[1] * noise[rows]).any(axis=0)
        last = int(np.flatnonzero(within)[-1]) + 1 if within.any() else SETTINGS.parts
        return float((first + last) * 0.5 * self.rate / parts.shape[1])

    def _noise(self, bands: Array) -> Array:
        """Level of the noise in every row of `bands`, shape (rows,)."""
        width = 0.5 * self.rate / bands.shape[1]
        return np.asarray(np.median(bands[:, int(np.ceil(self.above / width)) :], axis=1))


@cache
def _window(count: int) -> Array:
    """Window of a segment of so many samples, shape (count,) [1].

    The square of a Hann window leaks 1e-10 of the power of a line ten lines farther off, where that leaks 8e-8: what
    leaks from a load seems to be one.
    """
    return hann(count) ** 2


def _parts(lines: int) -> tuple[int, int]:
    """Number of parts of the bands of a spectrum of so many lines, and lines of each; the last lines may be left."""
    each = max(lines // (SETTINGS.bands * SETTINGS.parts), 1)
    return lines // each // SETTINGS.parts * SETTINGS.parts, each


def _of_bands(parts: Array) -> Array:
    """Means of the bands by those of their parts, shape (rows, bands)."""
    return np.asarray(parts.reshape(len(parts), parts.shape[1] // SETTINGS.parts, SETTINGS.parts).mean(axis=2))


@cache
def _of_block(segments: int) -> tuple[float, float]:
    """Density in a block of so many segments over that of the noise from which on a load is in a band, and a part."""
    freedom = FREEDOM * segments, FREEDOM / SETTINGS.parts * segments
    chances = SETTINGS.chance, SETTINGS.chance_of_part
    band, part = (float(chdtri(free, chance) / free) for free, chance in zip(freedom, chances, strict=True))
    return band, part


def _of_mean(segments: int) -> tuple[float, float]:
    """The same of the mean of all blocks, of so many segments together."""
    least = SETTINGS.stands_out
    if not segments:
        return least, least
    deviation = float(np.sqrt(2 / (FREEDOM * segments)))
    of_part = 1 + SETTINGS.deviations_of_part * deviation * float(np.sqrt(SETTINGS.parts))
    return max(least, 1 + SETTINGS.deviations * deviation), max(least, of_part)


def _are_few(gaps: NDArray[np.intp]) -> bool:
    """Whether a channel has so few gaps in a piece that a slower clock may be less work, however short they are."""
    return len(gaps) <= SETTINGS.gaps[0]
