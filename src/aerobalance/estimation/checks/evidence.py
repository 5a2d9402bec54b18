"""How likely a reading is with some dynamics: the spectrum of the force learned with them, and what that costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.estimation.observation import SpectralPrior
from aerobalance.estimation.spectra.noise_spectrum import ColoredNoise, ShapedNoise
from aerobalance.estimation.spectra.periodogram import Periodogram, averages_for
from aerobalance.estimation.spectra.whittle import SpectrumFit, fit_spectrum, refit_spectrum
from aerobalance.estimation.spectra.windows import LONGEST, density_of
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """What of a reading is looked at.

    Attributes
    ----------
    peaks
        Peaks of the spectrum that are tried as a resonance, at most.
    stands_out
        Level of such a peak over the median about it [1]: of a single ordinate, and of the mean of several, which
        chance has as rarely.
    several
        Ordinates from which on they are that.
    width
        Damping ratio over which a peak is averaged to find its frequency: the highest ordinate of a peak that has
        several lies anywhere within it.
    surroundings
        Half width of what is about a peak, over its frequency.
    near
        Relative distance from a known mode within which a peak is that of the mode.
    samples
        Samples that are looked at at most.
    skirts
        Averages on either side of a peak that belong to it.
    """

    peaks: int = 3
    stands_out: tuple[float, float] = (8.0, 5.0)
    several: int = 4
    width: float = 0.008
    surroundings: float = 0.2
    near: float = 0.04
    samples: int = LONGEST
    skirts: int = 2


SETTINGS: Final = EvidenceSettings()
"""Settings that are used."""


class _Narrow(NamedTuple):
    """Where narrow peaks stand out, shape (m,), among averages that begin at some ordinates, (m,)."""

    edges: NDArray[np.int64]
    peaks: NDArray[np.bool_]


class _Read(NamedTuple):
    """The periodogram of a reading as some dynamics show it, and the spectrum that was found with them."""

    periodogram: Periodogram
    fit: SpectrumFit


class _Beside(NamedTuple):
    """What is expected of a reading some of whose averages are left out.

    Attributes
    ----------
    evidence
        Logarithm of the likelihood of the others, less the price of the spectrum.
    noise_density
        Density of the noise [N^2/Hz].
    force, level
        Density of the force and of the reading, with what leaks into it, shape (m,) each [N^2/Hz].
    """

    evidence: float
    noise_density: float
    force: Array
    level: Array


@dataclass(slots=True, eq=False)
class Evidence:
    """Evidence of dynamics in a reading.

    Attributes
    ----------
    values
        The reading without gaps and hum, its mean taken off, shape (n,) [N].
    interval
        Time between samples [s].
    floor
        Least density of the noise of the reading [N^2/Hz].
    white
        Density of the white part of its noise where the color is known [N^2/Hz]; None to find it.
    color
        What its noise has beyond white; None if nothing is known of it.
    rising
        Whether the force was seen to be stronger where the balance weakens it than elsewhere.
    among
        All dynamics near which some are compared: the periodogram is averaged alike for all of them.
    even
        Whether the ends of the reading are weighed as its middle.
    near
        Density of the noise that was found before [N^2/Hz], from which it is looked for; None to begin anew.
    """

    values: Array
    interval: float
    floor: float
    white: float | None = None
    color: ColoredNoise | ShapedNoise | None = None
    rising: bool = False
    among: tuple[ModalModel, ...] = ()
    even: bool = False
    near: float | None = None
    _known: dict[tuple[float, ...], SpectrumFit] = field(default_factory=dict)
    _density: Array | None = None
    _edges: NDArray[np.int64] | None = None
    _narrow: _Narrow | None = None

    def of(self, dynamics: ModalModel) -> float:
        """Logarithm of the likelihood of the reading with dynamics, less the price of the force's spectrum."""
        return self._fit(dynamics).evidence

    def beside(self, dynamics: ModalModel, line: tuple[float, float]) -> float:
        """The same without the ordinates of a line, from one frequency to another [Hz]."""
        periodogram, fit = self._periodogram(dynamics), self._fit(dynamics)
        model = periodogram.load(fit.spectrum) + periodogram.background(fit.noise_density)
        spent = periodogram.weight * (np.log(model) + periodogram.density / model)
        last = periodogram.edges + periodogram.count - 1
        frequency = periodogram.ordinates[0]
        within = (frequency[last] >= line[0]) & (frequency[periodogram.edges] <= line[1])
        return fit.evidence + float(spent[within].sum())

    def over_narrow_loads(
        self, other: ModalModel, own: ModalModel, bands: Sequence[tuple[float, float] | None], *, enough: float
    ) -> float:
        """Gain of other dynamics over own ones where the load may have narrow bands of any shape, in log-likelihood.

        Such a load adds power where it is, and takes none away: there own dynamics are spoken against only where they
        expect more of the reading than the others do, by what the force has on either side. It may be wherever a
        narrow peak stands out, and in a band besides.

        Parameters
        ----------
        other, own
            The dynamics.
        bands
            Lowest and highest frequencies of bands of which it may be any [Hz]; None for none. The least gain counts.
        enough
            Gain below which it does not matter how low it is.
        """
        mine, theirs = _Read(self._periodogram(own), self._fit(own)), _Read(self._periodogram(other), self._fit(other))
        known = mine.periodogram
        peaks, least = self._narrow_in(known), np.inf
        for band in bands:
            lowest, highest = (np.inf, -np.inf) if band is None else band
            inside = (known.frequency >= lowest) & (known.frequency <= highest)
            # how much leaks of such a load hangs on its course: nothing, or what does in the mean
            for leaks in (False, True):
                least = min(least, self._gain_beside(theirs, mine, peaks, inside, leaks=leaks))
                if least < enough:
                    return least
        return least

    def narrow_peaks(self, dynamics: ModalModel) -> int:
        """Number of narrow peaks that stand out, neighbours counted as one."""
        peaks = self._narrow_in(self._periodogram(dynamics))
        return int(np.count_nonzero(np.diff(peaks, prepend=False) & peaks))

    def _narrow_in(self, periodogram: Periodogram) -> NDArray[np.bool_]:
        """Where narrow peaks stand out, shape (m,)."""
        if self._narrow is None or not np.array_equal(self._narrow.edges, periodogram.edges):
            peaks = _stands_out(periodogram.density, periodogram.frequency, periodogram.count)
            self._narrow = _Narrow(periodogram.edges, peaks)
        return self._narrow.peaks

    def _gain_beside(
        self, other: _Read, own: _Read, peaks: NDArray[np.bool_], inside: NDArray[np.bool_], *, leaks: bool
    ) -> float:
        """The gain beside loads at peaks and inside a band, shapes (m,), of which the window leaks or not."""
        known = own.periodogram
        weight, density = known.weight, known.density
        # a resonance of the others within the band tells of the force there
        mine, theirs = (
            self._beside(own, peaks | inside, leaks=leaks),
            self._beside(other, peaks & ~inside, leaks=leaks),
        )
        level = theirs.level
        gain = theirs.evidence - mine.evidence + weight[inside] @ (np.log(level) + density / level)[inside]
        # what the force has on both sides of a load it has there as well; what leaks there hangs on the load's course
        within = peaks | inside
        below, above = _beside_each(within)
        least = np.minimum(mine.force[below], mine.force[above]) * known.gain + known.background(mine.noise_density)
        more = within & (least > level)
        # at peaks elsewhere such a load explains with either what is read beyond what it expects
        beyond = np.where(inside, 0.0, density)
        least, level = np.maximum(least, beyond)[more], np.maximum(level, beyond)[more]
        gain += weight[more] @ (np.log(least / level) + density[more] * (1 / least - 1 / level))
        return float(gain)

    def _beside(self, read: _Read, within: NDArray[np.bool_], *, leaks: bool) -> _Beside:
        """What is expected without some averages, shape (m,), of which the window leaks or not."""
        periodogram = read.periodogram.without(within, leaks=leaks)
        found = fit_spectrum(
            periodogram,
            noise_density=self.white,
            floor=self.floor,
            rising=self.rising,
            near=read.fit.noise_density,
        )
        force = found.spectrum.density(periodogram.frequency)
        level = periodogram.load(found.spectrum) + periodogram.background(found.noise_density)
        return _Beside(found.evidence, found.noise_density, force, level)

    def nearly(self, dynamics: ModalModel, start: ModalModel) -> float:
        """The same, at most, of dynamics nearly like others: with a spectrum of the kind that is best with those."""
        periodogram = self._periodogram(dynamics)
        return refit_spectrum(
            periodogram, self._fit(start), noise_density=self.white, floor=self.floor, rising=self.rising
        ).evidence

    def may_gain(self, other: ModalModel, own: ModalModel, least: float) -> bool:
        """Whether other dynamics are worth a closer look: they may gain so much over own ones, in log-likelihood.

        A load whose spectrum rolls off smoothly with own dynamics does so with others that explain it better: of 636
        of them, in 101 records of all kinds of faults, no record had one that gained 4.5 by any spectrum where none
        gained 4 by such a one. A spectrum of segments tells nothing of that.
        """
        if not self._fit(own).spectrum.roll_off:
            return True
        return self.nearly(other, own) >= self.of(own) + least

    def _fit(self, dynamics: ModalModel) -> SpectrumFit:
        key = tuple(number for mode in dynamics.modes for number in (*numbers_of(mode),))
        if key not in self._known:
            periodogram = self._periodogram(dynamics)
            before = next((fit.noise_density for fit in self._known.values()), self.near)
            self._known[key] = fit_spectrum(
                periodogram, noise_density=self.white, floor=self.floor, rising=self.rising, near=before
            )
        return self._known[key]

    def _periodogram(self, dynamics: ModalModel) -> Periodogram:
        color = self.color
        if self._density is None:
            self._density = density_of(self.values, self.interval, even=self.even)
        if self._edges is None and self.among:
            self._edges = averages_for(self.among, self.values.size, self.interval)
        return Periodogram.of(
            self.values,
            dynamics,
            interval=self.interval,
            color=None if color is None else lambda f, width: color.density(f, width=width),
            density=self._density,
            edges=self._edges,
            even=self.even,
        )

    def peaks(self, dynamics: ModalModel) -> list[float]:
        """Frequencies of narrow peaks that are no known mode's, the highest over its surroundings first [Hz]."""
        count = self.values.size
        power = np.abs(np.fft.rfft(self.values * hann(count))) ** 2
        frequency = np.arange(power.size) / (count * self.interval)
        edges = np.unique(np.geomspace(4, power.size - 1, 400).astype(int))
        if edges.size < 16:
            return []
        # the mean of bins whose width grows with frequency, and of each octave about it the median
        level = np.log(np.maximum(np.add.reduceat(power, edges[:-1]) / np.diff(edges), 1e-300))
        middle = np.sqrt(frequency[edges[:-1]] * frequency[np.maximum(edges[1:] - 1, edges[:-1])])
        above = level - _medians(level, middle)
        for mode in dynamics.modes:
            above[np.abs(middle / mode.natural_frequency - 1) < SETTINGS.near] = 0.0
        single, several = np.log(SETTINGS.stands_out)
        above[above < np.where(np.diff(edges) < SETTINGS.several, single, several)] = 0.0
        found: list[float] = []
        while len(found) < SETTINGS.peaks and above.max() > 0:
            place = int(np.argmax(above))
            own = slice(edges[place], edges[place + 1])
            found.append(float(frequency[own][np.argmax(_averaged(power, own))]))
            above[np.abs(middle / middle[place] - 1) < SETTINGS.surroundings] = 0.0
        return found


def evidence_in(values: Array, *, interval: float, least_noise: float, learned: SpectralPrior | None) -> Evidence:
    """Return the evidence of dynamics in the first of some readings, by what was learned of their noise.

    Parameters
    ----------
    values
        Readings without gaps, hum and other tones, shape (n,) [N].
    interval
        Time between samples [s].
    least_noise
        Least noise of a reading [N].
    learned
        What was learned of force and noise; None if nothing was.
    """
    values = values[: SETTINGS.samples]
    evidence = Evidence(values - values.mean(), interval, least_noise**2 * interval)
    if learned is None:
        return evidence
    noise = learned.noise**2 * interval
    white, near = (None, noise) if learned.color is None else (noise, None)
    return replace(evidence, white=white, color=learned.color, rising=learned.rising, even=learned.even, near=near)


def _averaged(power: Array, own: slice) -> Array:
    """Power at some ordinates, averaged over as wide a peak as a mode there makes, of their number."""
    reach = int(SETTINGS.width * own.start)
    around = np.concatenate([[0.0], np.cumsum(power[max(own.start - reach, 0) : own.stop + reach])])
    first = np.arange(own.stop - own.start)
    last = np.minimum(first + 2 * reach + 1, around.size - 1)
    return np.asarray((around[last] - around[first]) / (last - first))


def _stands_out(density: Array, frequency: Array, count: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Where a narrow peak stands out of what is on both its sides, its neighbours included, shape (m,).

    `count` has the ordinates of each average. The edge of a load has its level on one side.
    """
    level = np.log(np.maximum(density, 1e-300))
    single, several = np.log(SETTINGS.stands_out)
    about = np.maximum(*(_medians(level, frequency, side=side) for side in (-1, 1)))
    peak = level - about > np.where(count < SETTINGS.several, single, several)
    return np.asarray(np.convolve(peak, np.ones(2 * SETTINGS.skirts + 1), mode="same") > 0)


def _beside_each(within: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Nearest place outside some, below and above each; at an end of all, that on the other side, shape (m,) each."""
    place = np.arange(within.size)
    outside = np.flatnonzero(~within)
    if not outside.size:
        return place, place
    after = np.searchsorted(outside, place)
    below, above = outside[np.maximum(after - 1, 0)], outside[np.minimum(after, outside.size - 1)]
    return np.where(within, below, place), np.where(within, above, place)


def _medians(level: Array, middle: Array, *, side: int = 0) -> Array:
    """Median of the levels at rising frequencies within an octave about each, or on one side of it, shape (m,)."""
    away = np.log(middle / middle[:, None])
    near = (np.abs(away) < SETTINGS.surroundings * 2) & (away * side >= 0)
    found = np.empty(middle.size)
    for place, (first, count) in enumerate(zip(near.argmax(axis=1), near.sum(axis=1), strict=True)):
        part = np.sort(level[first : first + count])
        found[place] = (part[(count - 1) // 2] + part[count // 2]) / 2
    return found


def numbers_of(mode: Mode) -> tuple[float, float, float]:
    """Natural frequency [Hz], damping ratio [1] and share [1] of a mode."""
    return mode.natural_frequency, mode.damping_ratio, mode.share
