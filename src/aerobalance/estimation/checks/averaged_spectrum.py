"""Averaged periodogram of a reading, as a Hann window smears it, and the band of it that is looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

PARTS: Final = 8
"""Parts of the record whose periodograms are averaged; they overlap by half."""

FEWEST_SAMPLES: Final = 4096
"""Samples below which a record's spectrum tells no resonance from chance."""

INDEPENDENT: Final = 0.53
"""Independent ordinates per ordinate of a Hann periodogram, over the 11/18 by which half overlap thins the average."""

BAND: Final = 0.25
"""Half width of the band in which the force's spectrum is taken for a power of frequency, over its centre."""

REACH: Final = 12
"""Ordinates over which the window smears a line."""


@dataclass(frozen=True, slots=True, eq=False)
class Averaged:
    """Averaged Hann periodogram of a reading.

    Attributes
    ----------
    power
        Two-sided density at `frequency`, shape (m,) [N^2/Hz].
    frequency
        From 0 to half the sampling rate, shape (m,) [Hz].
    averages
        Independent periodograms in the average.
    noise
        Density of the reading's noise [N^2/Hz].
    """

    power: Array
    frequency: Array
    averages: float
    noise: float

    @classmethod
    def of(cls, values: Array, *, interval: float, noise: float) -> Averaged | None:
        """Average over the parts of a record without gaps, or None where it is too short."""
        if values.size < FEWEST_SAMPLES:
            return None
        size = 2 * values.size // (PARTS + 1) // 2 * 2
        window = np.hanning(size + 1)[:-1]
        starts = range(0, values.size - size + 1, size // 2)
        ordinates = [
            np.abs(np.fft.rfft(window * (part - part.mean()))) ** 2
            for part in (values[start : start + size] for start in starts)
        ]
        power: Array = np.mean(ordinates, axis=0) * (interval / float(window @ window))
        averages = len(ordinates) * 18 / 11 / 2 if len(ordinates) > 1 else 1.0
        return cls(power, np.arange(power.size) / (size * interval), averages, noise**2 * interval)

    @property
    def resolution(self) -> float:
        """Distance of the ordinates [Hz]."""
        return float(self.frequency[1])

    def fine(self, band: NDArray[np.intp]) -> Array:
        """Frequencies at half the distance, from `REACH` ordinates below a band to as many above it [Hz]."""
        first, last = (2 * int(band[place]) + shift for place, shift in ((0, -2 * REACH), (-1, 2 * REACH)))
        return np.abs(np.arange(first, last + 1)) * self.resolution / 2

    def near(self, centre: float) -> NDArray[np.intp]:
        """Places of the ordinates within the band about a frequency; not the lowest, from which the mean is taken."""
        lowest, highest = max((1 - BAND) * centre, 4 * self.resolution), (1 + BAND) * centre
        return np.flatnonzero((self.frequency >= lowest) & (self.frequency <= highest))


def smeared(density: Array) -> Array:
    """A density at `Averaged.fine` as the Hann window shows it at the ordinates of the band.

    Beyond `REACH` ordinates the window passes less than 1e-6 of a line's power.
    """
    # whole ordinates away the window passes nothing but at the next ones; half of them away it has its side lobes
    whole = density[_MAIN.start : density.size - _MAIN.start : 2]
    next_, own = _LOBE[_MAIN]
    between = np.convolve(density[1::2], _LOBE[1::2], mode="valid")
    return np.asarray(between + own * whole[1:-1] + next_ * (whole[:-2] + whole[2:]))


def unsmeared(slopes: Array) -> Array:
    """Slopes by a density at `Averaged.fine`, of what has slopes by what `smeared` makes of that density."""
    found = np.zeros(2 * slopes.size - 1 + 4 * REACH)
    found[1::2] = np.convolve(slopes, _LOBE[1::2])
    whole = found[_MAIN.start : found.size - _MAIN.start : 2]
    next_, own = _LOBE[_MAIN]
    whole[1:-1] += own * slopes
    whole[:-2] += next_ * slopes
    whole[2:] += next_ * slopes
    return found


def _lobe() -> Array:
    place = np.arange(-2 * REACH, 2 * REACH + 1) / 2
    power = (np.sinc(place) + 0.5 * np.sinc(place - 1) + 0.5 * np.sinc(place + 1)) ** 2
    return np.asarray(power / power.sum())


_LOBE: Final = _lobe()
_MAIN: Final = slice(2 * REACH - 2, 2 * REACH + 1, 2)
