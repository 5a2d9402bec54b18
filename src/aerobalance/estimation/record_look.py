"""The look at all of a long record before its forces are estimated: how far its loads stand out of their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.special import chdtri

from aerobalance.balance.loads import Loads
from aerobalance.estimation.checks.impossible_channels import is_of_ground
from aerobalance.estimation.checks.outliers import outliers_of, without_outliers
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
        is a chi-squared of some 135 degrees of freedom over their number, and stands out from twice the level on.
    stands_out
        Spectral density of the readings over that of their noise from which on a load is taken to be there in the mean
        of all blocks, at least [1].
    deviations
        Standard deviations of that mean, of noise alone, by which it must stand out as well: of few blocks a quarter
        is five of them, and one record of 6 s in a thousand had that.
    block, segment
        Samples of a block, and of the segments over which its spectrum is averaged.
    bands
        Number of bands of equal width over which the spectrum is averaged.
    gaps
        Gaps of a channel in a piece, at most, for a slower clock: in all, and of those that are not short beside it.
    """

    chance: float = 4e-11
    stands_out: float = 1.25
    deviations: float = 7.0
    block: int = 1 << 14
    segment: int = 1 << 11
    bands: int = 64
    gaps: tuple[int, int] = (4096, 64)


SETTINGS: Final = LookSettings()
"""The settings in use."""

FREEDOM: Final = 17.0
"""Degrees of freedom of a band's density in a segment: fewer than its 32 numbers, as the window joins ordinates."""


class Levels(NamedTuple):
    """Spectral density of the blocks of a piece, up to a constant factor; segments that lack a sample are left out.

    Attributes
    ----------
    bands
        Mean of each band, shape (blocks, bands).
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
    gaps
        Lengths of the gaps of each load and channel of the ground's motion that has some [samples].
    """

    levels: dict[str, Levels]
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
    _blocks: dict[str, int] = field(default_factory=dict)
    _segments: dict[str, int] = field(default_factory=dict)
    _gaps: tuple[NDArray[np.intp], ...] = ()

    @property
    def highest(self) -> float:
        """Highest frequency at which a load is above the noise, in one block or in the mean of all [Hz]."""
        whole = [self._edge(power[None], self._stands_out(name)) for name, power in self._power.items()]
        return max(self._highest, *whole)

    def _stands_out(self, name: str) -> float:
        """Density of the mean of all blocks of a load over that of its noise from which on a load is there [1]."""
        least = SETTINGS.stands_out
        segments = self._segments[name]
        return max(least, 1 + SETTINGS.deviations * np.sqrt(2 / (FREEDOM * segments))) if segments else least

    @property
    def shown(self) -> tuple[float, ...]:
        """Power at each natural frequency over that of the noise, in the block and the load where it is least [1]."""
        ratios = [
            least * self._blocks[name] / self._noise(self._power[name][None])[0] - 1
            for name, least in self._least.items()
            if self._blocks[name]
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
        return Piece(
            {
                name: self._levels(recording.channel(name).values if loads is None else loads[:, place])
                for place, name in enumerate(names)
            },
            gaps,
        )

    def add(self, pieces: Sequence[Piece]) -> None:
        """Add what some pieces show."""
        for piece in pieces:
            self._gaps += piece.gaps
            for name, levels in piece.levels.items():
                bands, resonant, segments = levels
                self._highest = max(self._highest, self._edge(bands, _of_block(segments)))
                self._segments[name] = self._segments.get(name, 0) + segments * len(bands)
                self._power[name] = self._power.get(name, np.zeros(bands.shape[1])) + bands.sum(axis=0)
                least = resonant.min(axis=0, initial=np.inf)
                self._least[name] = np.minimum(self._least.get(name, np.inf), least)
                self._blocks[name] = self._blocks.get(name, 0) + len(bands)

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
        count = max(values.size // segment, 1)
        segments = values[: count * segment].reshape(count, segment)
        whole = np.isfinite(segments).all(axis=1)
        if not whole.all():
            segments = segments[whole]
            count = len(segments)
            if not count:
                each = max(segment // 2 // SETTINGS.bands, 1)
                return Levels(np.zeros((0, segment // 2 // each)), np.zeros((0, len(self.modes))), 1)
        level = segments.mean(axis=1, keepdims=True)
        spectrum = np.asarray(rfft((segments - level) * hann(segment)), dtype=np.complex128)[:, 1:]
        power = spectrum.real**2 + spectrum.imag**2
        each = max(power.shape[1] // SETTINGS.bands, 1)
        bands = power[:, : power.shape[1] // each * each].reshape(count, -1, each).mean(axis=2)
        lines = np.clip(np.round(np.array(self.modes) / self.rate * segment).astype(int) - 1, 0, power.shape[1] - 1)
        block = max(min(SETTINGS.block // segment, count), 1)
        of_bands, resonant = (
            part[: count // block * block].reshape(-1, block, part.shape[1]).mean(axis=1)
            for part in (bands, power[:, lines])
        )
        return Levels(of_bands, resonant, block)

    def _edge(self, levels: Array, stands_out: float) -> float:
        """Upper edge of the highest band that is above the noise in any row of `levels` [Hz]; 0 if none is."""
        out = np.flatnonzero((levels > stands_out * self._noise(levels)[:, None]).any(axis=0))
        return float((out[-1] + 1) * 0.5 * self.rate / levels.shape[1]) if out.size else 0.0

    def _noise(self, levels: Array) -> Array:
        """Level of the noise in every row of `levels`, shape (rows,)."""
        width = 0.5 * self.rate / levels.shape[1]
        return np.asarray(np.median(levels[:, int(np.ceil(self.above / width)) :], axis=1))


@cache
def _of_block(segments: int) -> float:
    """Density of a band in a block of so many segments over that of the noise from which on a load is there [1]."""
    freedom = FREEDOM * segments
    return float(chdtri(freedom, SETTINGS.chance) / freedom)


def _are_few(gaps: NDArray[np.intp]) -> bool:
    """Whether a channel has so few gaps in a piece that a slower clock may be less work, however short they are."""
    return len(gaps) <= SETTINGS.gaps[0]
