"""The look at all of a long record before its forces are estimated: how far its loads stand out of their noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from scipy.fft import rfft

from aerobalance.balance.loads import Loads
from aerobalance.estimation.checks.outliers import without_wild_samples
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann
from aerobalance.recording.recording import Recording


@dataclass(frozen=True, slots=True)
class LookSettings:
    """How the spectra of a record are looked at.

    Attributes
    ----------
    stands_out
        Spectral density of the readings over that of their noise from which on a load is taken to be there [1]: in one
        block of samples, and in the mean of all blocks. With noise alone, the density of a band in a block is a
        chi-squared of some 135 degrees of freedom over their number: 4 in 1e11 are above twice the level.
    block, segment
        Samples of a block, and of the segments over which its spectrum is averaged.
    bands
        Number of bands of equal width over which the spectrum is averaged.
    """

    stands_out: tuple[float, float] = (2.0, 1.25)
    block: int = 1 << 14
    segment: int = 1 << 11
    bands: int = 64


SETTINGS: Final = LookSettings()
"""The settings in use."""


class Levels(NamedTuple):
    """Spectral density of the blocks of a piece, up to a constant factor.

    Attributes
    ----------
    bands
        Mean of each band, shape (blocks, bands).
    resonant
        Density at each natural frequency, shape (blocks, modes).
    """

    bands: Array
    resonant: Array


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
    highest
        Highest frequency at which a load is above the noise in the pieces added so far [Hz].
    """

    rate: float
    above: float
    modes: tuple[float, ...]
    _highest: float = 0.0
    _power: dict[str, Array] = field(default_factory=dict)
    _least: dict[str, Array] = field(default_factory=dict)
    _blocks: dict[str, int] = field(default_factory=dict)

    @property
    def highest(self) -> float:
        """Highest frequency at which a load is above the noise, in one block or in the mean of all [Hz]."""
        whole = [self._edge(power[None], SETTINGS.stands_out[1]) for power in self._power.values()]
        return max(self._highest, *whole)

    @property
    def shown(self) -> tuple[float, ...]:
        """Power at each natural frequency over that of the noise, in the block and the load where it is least [1]."""
        ratios = [
            least * self._blocks[name] / self._noise(self._power[name][None])[0] - 1
            for name, least in self._least.items()
        ]
        return tuple(np.maximum(np.max(ratios, axis=0), 0.0).tolist())

    def levels(self, given: Recording | Loads, components: Sequence[str]) -> dict[str, Levels]:
        """Return the levels of the loads of a piece, by component.

        Where samples are missing, wild, stuck or clipped, nothing is returned for any component.
        """
        recording = given.recording if isinstance(given, Loads) else given
        names = [name for name in components if name in recording]
        whole = all(np.isfinite(channel.values).all() for channel in recording)
        if not whole or without_wild_samples(given, names)[1]:
            return {}
        return {name: self._levels(recording.channel(name).values) for name in names}

    def add(self, found: Sequence[Mapping[str, Levels]]) -> bool:
        """Add the levels of some pieces; return whether all their samples can be taken as they are."""
        for piece in found:
            for name, levels in piece.items():
                bands, resonant = levels
                self._highest = max(self._highest, self._edge(bands, SETTINGS.stands_out[0]))
                self._power[name] = self._power.get(name, np.zeros(bands.shape[1])) + bands.sum(axis=0)
                self._least[name] = np.minimum(self._least.get(name, np.inf), resonant.min(axis=0))
                self._blocks[name] = self._blocks.get(name, 0) + len(bands)
        return all(found)

    def _levels(self, values: Array) -> Levels:
        """Levels of the readings of one load."""
        segment = min(SETTINGS.segment, values.size)
        count = max(values.size // segment, 1)
        segments = values[: count * segment].reshape(count, segment)
        level = segments.mean(axis=1, keepdims=True)
        spectrum = np.asarray(rfft((segments - level) * hann(segment)), dtype=np.complex128)[:, 1:]
        power = spectrum.real**2 + spectrum.imag**2
        each = max(power.shape[1] // SETTINGS.bands, 1)
        bands = power[:, : power.shape[1] // each * each].reshape(count, -1, each).mean(axis=2)
        lines = np.clip(np.round(np.array(self.modes) / self.rate * segment).astype(int) - 1, 0, power.shape[1] - 1)
        block = max(min(SETTINGS.block // segment, count), 1)
        means = (
            part[: count // block * block].reshape(-1, block, part.shape[1]).mean(axis=1)
            for part in (bands, power[:, lines])
        )
        return Levels(*means)

    def _edge(self, levels: Array, stands_out: float) -> float:
        """Upper edge of the highest band that is above the noise in any row of `levels` [Hz]; 0 if none is."""
        out = np.flatnonzero((levels > stands_out * self._noise(levels)[:, None]).any(axis=0))
        return float((out[-1] + 1) * 0.5 * self.rate / levels.shape[1]) if out.size else 0.0

    def _noise(self, levels: Array) -> Array:
        """Level of the noise in every row of `levels`, shape (rows,)."""
        width = 0.5 * self.rate / levels.shape[1]
        return np.asarray(np.median(levels[:, int(np.ceil(self.above / width)) :], axis=1))
