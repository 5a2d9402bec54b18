"""Spectra: of the force, and of the reading through which it is seen.

The reading shows the force through the balance, with noise: the expected periodogram is |G|^2 (S_F + S_u) + R, with
S_F the force, S_u the white noise that comes with known inputs, and R the noise of the reading, white and colored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel
from aerobalance.recording.channel import Array

LONGEST: Final = 1 << 17
"""Samples of one periodogram; a longer record is averaged over parts of this length."""

HANN_BANDWIDTH: Final = 1.94
"""Ordinates of a Hann periodogram that are as good as one independent ordinate."""

HANN_WIDTH: Final = 2.0
"""Ordinates that a Hann window smears a line over."""

FEWEST_ORDINATES: Final = 4
"""Ordinates that are averaged at least where the balance's response does not change within them."""

FINENESS: Final = 0.003
"""Width of such an average over its frequency."""

STEEPEST: Final = 1.1
"""Ratio of the response's squares within one average at most."""


def leaked(distance: Array) -> Array:
    """Share of a Hann window's power that lies above an edge, at a distance above it in ordinates."""
    return np.asarray(np.interp(distance, _LOBE_PLACE, _LOBE_SHARE))


def _lobe() -> tuple[Array, Array]:
    place = np.linspace(-256, 256, 512 * 64 + 1)
    power = (np.sinc(place) + 0.5 * np.sinc(place - 1) + 0.5 * np.sinc(place + 1)) ** 2
    share = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2)])
    return place, share / share[-1]


_LOBE_PLACE, _LOBE_SHARE = _lobe()


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Two-sided power spectral density of the force: constant over segments, or a smooth roll-off.

    Attributes
    ----------
    edges
        Upper edges of the segments [Hz], shape (s,), rising; from the last on the density is zero.
    levels
        Density of each segment [N^2/Hz], shape (s,).
    roll_off
        Corner frequency [Hz], exponent m and power q of levels[0] / (1 + (f / corner)^m)^q, or None.
    """

    edges: Array
    levels: Array
    roll_off: tuple[float, float, float] | None = None

    @property
    def parameters(self) -> int:
        """Numbers that describe it and are free."""
        if self.roll_off:
            return 3
        return int(2 * np.count_nonzero(self.levels))

    def __str__(self) -> str:
        """What it is, for a reader."""
        if self.roll_off:
            corner, exponent, power = self.roll_off
            return f"spectrum rolling off from {corner:.4g} Hz as the power {exponent * power:.3g} of frequency"
        filled = np.flatnonzero(self.levels)
        if not filled.size:
            return "no fluctuating force"
        return f"spectrum of {filled.size} segment(s) up to {self.edges[filled[-1]]:.4g} Hz"

    def density(self, frequency: Array, *, step: float = 0.0) -> Array:
        """Density at frequencies [Hz], [N^2/Hz]; with a step, as a Hann window with such ordinates [Hz] sees it."""
        frequency = np.asarray(frequency)
        if self.roll_off:
            corner, exponent, power = self.roll_off
            fall = np.logaddexp(0.0, exponent * np.log(np.maximum(frequency, 1e-12 * corner) / corner))
            return np.asarray(self.levels[0] * np.exp(-np.minimum(power * fall, 600.0)))
        if step:
            seen = np.full(frequency.shape, self.levels[0] if self.levels.size else 0.0)
            for edge, change in zip(self.edges[:-1], np.diff(self.levels), strict=True):
                seen += change * leaked((frequency - edge) / step)
            return seen
        place = np.searchsorted(self.edges, frequency, side="left")
        return np.append(self.levels, 0.0)[place]


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
        """
        parts, window = _parts(values)
        length = window.size
        density = np.zeros(length // 2 + 1)
        for part in parts:
            density += np.abs(np.fft.rfft(part * window)) ** 2
        density *= interval / (np.sum(window**2) * len(parts))
        frequency = np.arange(length // 2 + 1) / (length * interval)
        gain = _smeared_gain(dynamics, frequency)
        # what was taken away as a constant is missing in the first ordinates; the last is real, not complex
        inside = slice(2, -1)
        ordinates = np.stack([frequency[inside], density[inside], gain[inside]])
        edges = _averages(ordinates[2])
        count = np.diff(np.append(edges, ordinates.shape[1]))
        frequency, density, gain = np.add.reduceat(ordinates, edges, axis=1) / count
        folded = np.abs(dynamics.response(1 / interval - frequency)) ** 2
        weight = count * (values.size / length / HANN_BANDWIDTH)
        step = 1 / (length * interval)
        seen = None if color is None else color(ordinates[0], HANN_WIDTH * step)
        return cls(frequency, density, gain, weight, folded, interval, ordinates, edges, input_density, seen)

    def background(self, noise: float) -> Array:
        """Density of what is no force: the noise of the reading (its white part is given) and the input's, (m,)."""
        background = (self.gain + self.folded_gain) * self.input_density + noise
        if self.color is not None:
            background = background + np.add.reduceat(self.color, self.edges) / self.count
        return np.asarray(background)

    def load(self, spectrum: Spectrum) -> Array:
        """Density of the load felt under a force of this spectrum, as the window sees it [N^2/Hz], shape (m,)."""
        folded = self.folded_gain * spectrum.density(self.folded_frequency)
        if spectrum.roll_off:
            return np.asarray(self.gain * spectrum.density(self.frequency) + folded)
        frequency, _, gain = self.ordinates
        seen = gain * spectrum.density(frequency, step=float(frequency[1] - frequency[0]))
        return np.asarray(np.add.reduceat(seen, self.edges) / self.count + folded)

    def log_likelihood(self, load: Array, noise: float) -> float:
        """Logarithm of Whittle's likelihood of a load's density (m,) and a noise's [N^2/Hz]."""
        model = load + self.background(noise)
        return -float(self.weight @ (np.log(model) + self.density / model))


def share_seen(present: NDArray[np.bool_]) -> float:
    """Share of the readings that a periodogram sees, weighted as its windows weight them."""
    parts, window = _parts(present.astype(np.float64))
    return float(np.mean([part @ window**2 for part in parts]) / np.sum(window**2))


def _parts(values: Array) -> tuple[list[Array], Array]:
    """Parts of a record of which one periodogram is taken each, half of each in the next, and their Hann window."""
    length = min(values.size, LONGEST)
    parts = [values[k : k + length] for k in range(0, values.size - length + 1, max(length // 2, 1))]
    return parts, np.hanning(length + 2)[1:-1]


def _smeared_gain(dynamics: ModalModel, frequency: Array) -> Array:
    """Square of the response as a Hann window sees it: averaged over the main lobe, eight points an ordinate."""
    step = frequency[1]
    fine = (np.arange(8 * (frequency.size + 4)) / 8 - 2) * step
    gain = np.abs(dynamics.response(fine)) ** 2
    offset = np.arange(-15, 16) / 8
    lobe = (np.sinc(offset) + 0.5 * np.sinc(offset - 1) + 0.5 * np.sinc(offset + 1)) ** 2
    return np.convolve(gain, lobe / lobe.sum(), mode="same")[16::8][: frequency.size]


def _averages(gain: Array) -> NDArray[np.int64]:
    """First ordinate of each average."""
    level = np.log(gain)
    edges = []
    here, most = 0, np.log(STEEPEST)
    while here < gain.size:
        edges.append(here)
        width = max(FEWEST_ORDINATES, int(FINENESS * here))
        part = level[here : here + width]
        here += max(1, int(np.argmax(np.abs(part - part[0]) > most)) if np.abs(part - part[0]).max() > most else width)
    return np.array(edges)
