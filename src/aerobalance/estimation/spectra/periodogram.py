"""Spectra: of the force, and of the reading through which it is seen.

The reading shows the force through the balance, with noise: the expected periodogram is |G|^2 (S_F + S_u) + R, with
S_F the force, S_u the white noise that comes with known inputs, and R the noise of the reading, white and colored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import blake2b
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.spectra._kernels import averages
from aerobalance.estimation.spectra.windows import (
    HANN_BANDWIDTH,
    HANN_WIDTH,
    INSIDE,
    LOBES,
    density_of,
    leaked,
    leaked_from,
    length_of,
)
from aerobalance.recording.channel import Array

FEWEST_ORDINATES: Final = 4
"""Ordinates that are averaged at least where the balance's response does not change within them."""

FINENESS: Final = 0.003
"""Width of such an average over its frequency."""

TRACE: Final = 1e-9
"""Weight of averages that do not count, over their own."""

STRAIGHT: Final = 1e-3
"""Second difference of the response's squares at neighbouring ordinates, over them, below which they hardly bend."""

STEEPEST: Final = 1.1
"""Ratio of the response's squares within one average at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Two-sided power spectral density of the force: constant over segments, or a smooth roll-off.

    Attributes
    ----------
    edges
        Upper edges of the segments [Hz], shape (s,), rising; from the last on the density is zero.
    levels
        Density of each segment [N^2/Hz], shape (s,); where there is a tail the last is that at its lower edge.
    roll_off
        Corner frequency [Hz], exponent m and power q of levels[0] / (1 + (f / corner)^m)^q, or None.
    tail
        Power of frequency as which the density falls from the lower edge of the last segment on, without an end;
        None where that segment is constant. There are two segments at least.
    """

    edges: Array
    levels: Array
    roll_off: tuple[float, float, float] | None = None
    tail: float | None = None

    @property
    def parameters(self) -> int:
        """Numbers that describe it and are free: a tail has its power in place of an edge."""
        return 3 if self.roll_off else int(2 * np.count_nonzero(self.levels))

    def __str__(self) -> str:
        """What it is, for a reader."""
        if self.roll_off:
            corner, exponent, power = self.roll_off
            return f"spectrum rolling off from {corner:.4g} Hz as the power {exponent * power:.3g} of frequency"
        filled = np.flatnonzero(self.levels)
        if not filled.size:
            return "no fluctuating force"
        if self.tail is not None:
            start = f"{self.edges[-2]:.4g} Hz as the power {self.tail:.3g} of frequency"
            if filled.size == 1:
                return f"spectrum that falls from {start}"
            return f"spectrum of {_bands_of_one_level(filled.size - 1).rstrip(',')}, falling from {start}"
        return f"spectrum of {_bands_of_one_level(filled.size)} up to {self.edges[filled[-1]]:.4g} Hz"

    def density(self, frequency: Array) -> Array:
        """Density at frequencies [Hz], [N^2/Hz]."""
        frequency = np.asarray(frequency)
        if self.roll_off:
            corner, exponent, power = self.roll_off
            fall = np.logaddexp(0.0, exponent * np.log(np.maximum(frequency, 1e-12 * corner) / corner))
            return np.asarray(self.levels[0] * np.exp(-np.minimum(power * fall, 600.0)))
        place = np.searchsorted(self.edges, frequency, side="left")
        if self.tail is None:
            return np.append(self.levels, 0.0)[place]
        return np.asarray(self.levels[np.minimum(place, self.levels.size - 1)] * self.fallen(frequency))

    def fallen(self, frequency: Array) -> Array:
        """Density at frequencies [Hz] over that at the lower edge of the last segment's tail, 1 below it [1]."""
        if self.tail is None:
            return np.ones(np.shape(frequency))
        return np.asarray(np.maximum(frequency / self.edges[-2], 1.0) ** -self.tail)


@dataclass(frozen=True, slots=True, eq=False)
class Periodogram:
    """A reading's averaged periodogram, and what the balance makes of a force at the same frequencies.

    Attributes
    ----------
    frequency
        Middle of each average [Hz], shape (m,).
    density
        Two-sided power spectral density of the reading [N^2/Hz].
    gain
        Square of the response load over force, averaged alike, the window's width included [1].
    weight
        Number of independent ordinates in each average [1].
    folded_gain
        The same at the sampling rate less the frequency: what is folded back [1].
    interval
        Time between samples [s].
    ordinates
        All ordinates before averaging: frequency, density and gain, shape (3, n).
    edges
        First ordinate of each average, shape (m,).
    input_density
        Density of the white noise that enters as a force with the known inputs [N^2/Hz].
    color
        Density of the reading's noise beyond its white part at all ordinates, shape (n,) [N^2/Hz]; None if there is
        none.
    even
        Whether the ends of the readings are weighed as their middle: what stands there leaks.
    counted
        One for each ordinate that counts and zero for others, shape (n,); None where all do.
    gains_above
        Results of `gain_above` so far.
    """

    frequency: Array
    density: Array
    gain: Array
    weight: Array
    folded_gain: Array
    interval: float
    ordinates: Array
    edges: NDArray[np.int64]
    input_density: float
    color: Array | None = None
    even: bool = False
    counted: Array | None = None
    gains_above: dict[float, Array] = field(default_factory=dict)

    @property
    def step(self) -> float:
        """Distance of the ordinates [Hz]."""
        return float(self.ordinates[0, 1] - self.ordinates[0, 0])

    @property
    def digest(self) -> bytes:
        """What is the same for periodograms of the same numbers, and hardly for others.

        The averages tell apart what differs at any ordinate, and of what is not averaged the sum does: all ordinates
        would take a tenth of the time of a fit.
        """
        found = blake2b(repr((self.interval, self.input_density, self.even)).encode(), digest_size=16)
        for averaged in (self.frequency, self.density, self.gain, self.weight, self.folded_gain, self.edges):
            found.update(averaged.tobytes())
        for every in (self.ordinates, self.color, self.counted):
            found.update(b"none" if every is None else np.asarray(every.sum(axis=-1)).tobytes())
        return found.digest()

    @property
    def count(self) -> NDArray[np.int64]:
        """Number of ordinates in each average, shape (m,)."""
        return np.diff(np.append(self.edges, self.ordinates.shape[1]))

    @property
    def folded_frequency(self) -> Array:
        """Frequencies that are folded back onto those of the averages [Hz], shape (m,)."""
        return 1 / self.interval - self.frequency

    @classmethod
    def of(
        cls,
        values: Array,
        dynamics: ModalModel,
        *,
        interval: float,
        input_density: float = 0.0,
        color: Callable[[Array, float], Array] | None = None,
        density: Array | None = None,
        edges: NDArray[np.int64] | None = None,
        even: bool = False,
    ) -> Periodogram:
        """Take a Hann periodogram and average it as far as the balance's response allows.

        Parameters
        ----------
        values
            Readings without gaps, known shapes taken out, shape (n,) [N].
        dynamics
            The balance.
        interval
            Time between samples [s].
        input_density
            Density of the white noise that enters as a force with the known inputs [N^2/Hz].
        color
            Mean density of the colored noise about frequencies [Hz], over a width [Hz], [N^2/Hz].
        density
            What `density_of` gives of these readings, where it is known.
        edges
            First ordinate of each average, shape (m,), by `averages_for`, where other dynamics are compared.
        even
            Whether `density` is of an even window.
        """
        length = length_of(values.size)
        grid = _Ordinates.of(dynamics, length, interval)
        if edges is not None:
            grid = grid.averaged_over(edges)
        density = density_of(values, interval) if density is None else density
        return cls(
            frequency=grid.mean(grid.frequency),
            density=grid.mean(density),
            gain=grid.mean(grid.gain),
            weight=np.asarray(grid.count * (values.size / length / HANN_BANDWIDTH)),
            folded_gain=grid.folded_gain,
            interval=interval,
            ordinates=np.stack([grid.frequency, density, grid.gain]),
            edges=grid.edges,
            input_density=input_density,
            color=None if color is None else color(grid.frequency, HANN_WIDTH * grid.step),
            even=even,
        )

    def without(self, hidden: NDArray[np.bool_], *, leaks: bool) -> Periodogram:
        """The same, some averages left with a trace of weight, by which a level there is a number.

        Parameters
        ----------
        hidden
            Those averages, shape (m,).
        leaks
            Whether what the window leaks from them, in the mean, is known noise of the others.
        """
        weight = np.where(hidden, TRACE * self.weight, self.weight)
        beyond = np.repeat(hidden, self.count)
        color = self.color
        if leaks:
            leak = leaked_from(np.where(beyond, self.ordinates[1], 0.0), even=self.even)
            color = leak if color is None else color + leak
        return replace(self, weight=weight, counted=np.where(beyond, 0.0, 1.0), color=color)

    def background(self, noise: float) -> Array:
        """Density of what is no force: the noise of the reading (its white part is given) and the input's, (m,)."""
        background = (self.gain + self.folded_gain) * self.input_density + noise
        if self.color is not None:
            background = background + np.add.reduceat(self.color, self.edges) / self.count
        return np.asarray(background)

    def load(self, spectrum: Spectrum) -> Array:
        """Density of the balance load under a force of this spectrum, as the window sees it [N^2/Hz], shape (m,)."""
        if spectrum.roll_off:
            folded = self.folded_gain * spectrum.density(self.folded_frequency)
            return np.asarray(self.gain * spectrum.density(self.frequency) + folded)
        felt, here = np.zeros(self.gain.size), self.gain
        for edge, level in zip(spectrum.edges[:-1], spectrum.levels[:-1], strict=True):
            beyond = self.gain_above(float(edge))
            felt += level * np.maximum(here - beyond, 0.0)  # rounding must not make a density negative
            here = beyond
        if not spectrum.levels.size:
            return felt
        last = here if spectrum.tail is None else here * spectrum.fallen(self.frequency)
        felt += spectrum.levels[-1] * last
        return felt

    def gain_above(self, edge: float) -> Array:
        """Mean in each average of the gain times the share of the window that lies above an edge [Hz], shape (m,)."""
        known = self.gains_above.get(edge)
        if known is not None:
            return known
        place = (edge - float(self.ordinates[0, 0])) / self.step
        low, high = (min(max(round(place) + reach, 0), self.ordinates.shape[1]) for reach in (-LOBES, LOBES))
        first = max(int(np.searchsorted(self.edges, low, side="right")) - 1, 0)
        last = int(np.searchsorted(self.edges, high))
        found = np.where(np.arange(self.edges.size) >= last, self.gain, 0.0)
        if last > first:
            part = slice(int(self.edges[first]), int(np.append(self.edges, self.ordinates.shape[1])[last]))
            share = leaked(np.arange(part.start, part.stop, dtype=np.float64) - place)
            seen = self.ordinates[2, part] * share
            found[first:last] = np.add.reduceat(seen, self.edges[first:last] - part.start) / self.count[first:last]
        self.gains_above[edge] = found
        return found

    def log_likelihood(self, load: Array, noise: float) -> float:
        """Logarithm of Whittle's likelihood of a load's density (m,) and a noise's [N^2/Hz]."""
        model = load + self.background(noise)
        return -float(self.weight @ (np.log(model) + self.density / model))


@dataclass(frozen=True, slots=True, eq=False)
class _Ordinates:
    """What periodograms of records of one length and balance have in common.

    Attributes
    ----------
    dynamics
        The balance.
    interval
        Time between samples [s].
    frequency, gain
        Frequencies of the ordinates [Hz], and square of the response as the window sees it [1], shape (n,) each.
    edges, count
        First ordinate of each average, and the number of them, shape (m,) each.
    folded_gain
        Square of the response at the sampling rate less the frequency of each average [1], shape (m,).
    """

    dynamics: ModalModel
    interval: float
    frequency: Array
    gain: Array
    edges: NDArray[np.int64]
    count: NDArray[np.int64]
    folded_gain: Array

    @staticmethod
    @lru_cache(maxsize=32)  # asked for with every step that is found, and of each of some dynamics
    def of(dynamics: ModalModel, length: int, interval: float) -> _Ordinates:
        """Lay it out for periodograms of so many samples."""
        frequency = np.arange(length // 2 + 1) / (length * interval)
        gain = _smeared_gain(dynamics, frequency)[INSIDE]
        return _Ordinates._laid_out(dynamics, interval, frequency[INSIDE], gain, _averages(np.log(gain)))

    @staticmethod
    def _laid_out(
        dynamics: ModalModel, interval: float, frequency: Array, gain: Array, edges: NDArray[np.int64]
    ) -> _Ordinates:
        count = np.diff(np.append(edges, gain.size))
        middle = np.add.reduceat(frequency, edges) / count
        folded = np.abs(dynamics.response(1 / interval - middle)) ** 2
        return _Ordinates(dynamics, interval, frequency, gain, edges, count, folded)

    def averaged_over(self, edges: NDArray[np.int64]) -> _Ordinates:
        """The same with other averages, by the first ordinate of each, shape (m,)."""
        return self._laid_out(self.dynamics, self.interval, self.frequency, self.gain, edges)

    @property
    def step(self) -> float:
        """Distance of the ordinates [Hz]."""
        return float(self.frequency[1] - self.frequency[0])

    def mean(self, values: Array) -> Array:
        """Mean of ordinates (n,) over each average, shape (m,)."""
        return np.asarray(np.add.reduceat(values, self.edges) / self.count)


def _bands_of_one_level(count: int) -> str:
    """So many segments, in words."""
    return "one band of one level" if count == 1 else f"{count} bands, each of one level,"


def averages_for(models: Sequence[ModalModel], samples: int, interval: float) -> NDArray[np.int64]:
    """First ordinate of each average of a periodogram within which no response of several changes, shape (m,).

    Likelihoods of several dynamics may be compared over the same averages alone: where the spectrum of the force has
    an edge, what an average has of either side makes them differ by ten and more.

    Parameters
    ----------
    models
        The dynamics that are compared.
    samples
        Samples of the record.
    interval
        Time between samples [s].
    """
    length = length_of(samples)
    changes = [np.abs(np.diff(np.log(_Ordinates.of(model, length, interval).gain))) for model in models]
    return _averages(np.concatenate([[0.0], np.cumsum(np.max(changes, axis=0))]))


def _averages(level: Array) -> NDArray[np.int64]:
    """First ordinate of each average, by the logarithm of the response's squares at the ordinates, shape (n,)."""
    return averages(level, FEWEST_ORDINATES, FINENESS, float(np.log(STEEPEST)))


def _smeared_gain(dynamics: ModalModel, frequency: Array) -> Array:
    """Square of the response as a Hann window sees it, averaged over the main lobe, at ordinates from 0 on, (n,).

    Eight points an ordinate near the modes; elsewhere it bends so little that its second difference tells all.
    """
    step, beyond = frequency[1], 2
    places = np.arange(-beyond, frequency.size + beyond)
    gain = np.abs(dynamics.response(places * step)) ** 2
    offset = np.arange(-15, 16) / 8
    lobe = (np.sinc(offset) + 0.5 * np.sinc(offset - 1) + 0.5 * np.sinc(offset + 1)) ** 2
    lobe /= lobe.sum()
    bend = np.diff(gain, 2)
    smeared = gain[beyond:-beyond] + 0.5 * float(lobe @ offset**2) * bend[1:-1]
    steep = np.abs(bend[1:-1]) > STRAIGHT * gain[beyond:-beyond]
    for first, last in np.flatnonzero(np.diff(np.concatenate([[0], steep, [0]]))).reshape(-1, 2):
        fine = np.arange(8 * first - 15, 8 * (last - 1) + 16) / 8 * step
        near = np.abs(dynamics.response(fine)) ** 2
        smeared[first:last] = np.convolve(near, lobe, mode="valid")[::8]
    return np.asarray(smeared)
