"""The resonance that a reading shows near the one that is expected there, and whether those of several differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import HANN_ORDINATES, hann


@dataclass(frozen=True, slots=True)
class NearSettings:
    """What is tried.

    Attributes
    ----------
    about
        Frequencies that are looked at, over the natural frequency that is expected.
    reach
        Largest relative change of the natural frequency.
    most
        Changes of the natural frequency that are tried either side, at most.
    dampings
        Factors of the damping ratio that are tried.
    finer, finer_dampings
        The same about the best, in steps of the first search.
    closer
        Steps of the searches that follow, each about the best of the one before, over those of the first of these.
    slopes
        Powers of frequency with which the density of the force falls.
    rounds
        Rounds in which the level of the force is found, at most.
    settled
        Relative change of all levels in a round from which on there are no more: the log-likelihood of an ordinate
        errs by no more than its square.
    fewest
        Ordinates that are needed.
    blurred
        Width that the window gives a line, over the distance of ordinates.
    bins
        Ordinates within the damping ratio that are not averaged, at most.
    """

    about: tuple[float, float] = (0.7, 1.4)
    reach: float = 0.12
    most: int = 50
    dampings: tuple[float, ...] = (1 / 3, 0.6, 1.0, 1.8, 3.0, 6.0)
    finer: tuple[float, ...] = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)
    finer_dampings: tuple[float, ...] = (0.7, 0.85, 1.0, 1.2, 1.4)
    closer: tuple[float, ...] = (1.0, 1 / 6, 1 / 36)
    slopes: tuple[float, ...] = (0.0, 2.0, 4.0)
    rounds: int = 12
    settled: float = 1e-4
    fewest: int = 20
    blurred: float = 0.7
    bins: int = 4


Known = TypeVar("Known", bound=ModalModel)

SETTINGS: Final = NearSettings()
"""Settings that are used."""


def near_resonance(values: Array, interval: float, dynamics: Known) -> Known | None:
    """Return the dynamics near some whose resonance the spectrum of a reading shows; None where it is too short.

    The density of the force is taken as a power of frequency about the resonance. That costs a thousandth of the
    evidence with a force of any spectrum, which is to be compared at what comes out.

    Parameters
    ----------
    values
        The reading without gaps and tones, its mean taken off, shape (n,) [N].
    interval
        Time between samples [s].
    dynamics
        The dynamics that are expected.
    """
    shape = _Shape.of(values, interval, dynamics)
    if shape is None:
        return None
    (w, ratio), _ = _Search.about([shape], dynamics).likeliest([shape])
    return dynamics.retuned(frequency=w, damping=ratio / dynamics.damping_ratio)


def resonance_gain(values: Array, interval: float, dynamics: ModalModel) -> float:
    """Return by how much the resonance near the expected one makes a reading likelier than it, in log-likelihood.

    Twice the gain has the distribution of chi squared with two degrees of freedom where the expected one is right
    (Wilks). It is 0 for readings that are too short. Arguments as of `near_resonance`.
    """
    shape = _Shape.of(values, interval, dynamics)
    if shape is None:
        return 0.0
    _, best = _Search.about([shape], dynamics).likeliest([shape])
    own = shape.likelihoods(np.ones(1), np.array([dynamics.damping_ratio]))
    return max(best - float(own[0, 0]), 0.0)


def resonances_apart(parts: Sequence[Array], interval: float, dynamics: ModalModel) -> float:
    """Return by how much a resonance for each part makes the readings likelier than one for all, in log-likelihood.

    Each part has a level and a slope of its own of the force. Where all have one resonance, twice the gain has the
    distribution of chi squared with two degrees of freedom for each part but one (Wilks). It is 0 for fewer than two
    parts that are long enough.

    Parameters
    ----------
    parts
        Readings without gaps and tones, their means taken off [N].
    interval
        Time between samples [s].
    dynamics
        The dynamics that are expected.
    """
    shapes = [shape for part in parts if (shape := _Shape.of(part, interval, dynamics)) is not None]
    if len(shapes) < 2:
        return 0.0
    search = _Search.about(shapes, dynamics)
    _, one = search.likeliest(shapes)
    return max(sum(search.likeliest([shape])[1] for shape in shapes) - one, 0.0)


def _averaged(values: Array, together: int) -> Array:
    """Means of so many neighbours each."""
    whole = values[: values.size // together * together]
    return np.asarray(whole.reshape(-1, together).mean(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """The spectrum of a reading about a resonance.

    Attributes
    ----------
    frequency
        Frequency over the one that is expected, shape (m,) [1].
    power
        Power, shape (m,).
    noise
        Power of the noise.
    blurred
        Width of a line [1].
    told
        Ordinates of their own that each of these stands for.
    """

    frequency: Array
    power: Array
    noise: float
    blurred: float
    told: float

    @classmethod
    def of(cls, values: Array, interval: float, dynamics: ModalModel) -> _Shape | None:
        """The spectrum of a reading, as of `near_resonance`; None where it is too short or nothing is read."""
        count, expected = values.size, dynamics.natural_frequency
        power = np.abs(np.fft.rfft(values * hann(count))) ** 2
        apart = 1 / (count * interval)
        frequency = np.asarray(np.arange(power.size) * apart, dtype=np.float64)
        low, high = SETTINGS.about
        near = (frequency > low * expected) & (frequency < high * expected)
        if np.count_nonzero(near) < SETTINGS.fewest or dynamics.damping_ratio == 0 or not power[near].any():
            return None
        together = max(int(dynamics.damping_ratio * expected / (SETTINGS.bins * apart)), 1)
        return cls(
            _averaged(frequency[near], together) / expected,
            _averaged(power[near], together),
            max(float(np.mean(power[3 * power.size // 4 :])), 1e-300),
            SETTINGS.blurred * apart / expected,
            HANN_ORDINATES * together,
        )

    def likelihoods(self, moved: Array, ratios: Array) -> Array:
        """Log-likelihoods of natural frequencies, over the one that is expected, and damping ratios; a row each."""
        r = self.frequency / moved[:, None, None]
        width = np.hypot(ratios[:, None], self.blurred)
        gain = 1 / ((1 - r**2) ** 2 + (2 * width * r) ** 2)  # |G|^2, shape (moved, ratios, m)
        slopes = [self._likelihood(gain * self.frequency**-slope) for slope in SETTINGS.slopes]
        return np.asarray(self.told * np.max(slopes, axis=0))

    def _likelihood(self, shape: Array) -> Array:
        """Logarithm of Whittle's likelihood of spectra of some shapes, each at its best level."""
        over = np.maximum(self.power - self.noise, 0.05 * self.power)
        level = np.mean(over / shape, axis=-1, keepdims=True)
        for _ in range(SETTINGS.rounds):
            expected = level * shape + self.noise
            lowers = np.sum(self.power * shape / expected**2, axis=-1, keepdims=True)
            change = np.sqrt(lowers / np.sum(shape / expected, axis=-1, keepdims=True))
            level = level * change
            if np.max(np.abs(change - 1)) < SETTINGS.settled:  # at once where the noise is small
                break
        expected = level * shape + self.noise
        return np.asarray(-np.sum(np.log(expected) + self.power / expected, axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Natural frequencies, over the one that is expected, and damping ratios that are tried first.

    Attributes
    ----------
    step
        Distance of the frequencies [1].
    moved, ratios
        Frequencies over the one that is expected, and damping ratios [1].
    """

    step: float
    moved: Array
    ratios: Array

    @classmethod
    def about(cls, shapes: Sequence[_Shape], dynamics: ModalModel) -> _Search:
        """What is tried for some spectra: no finer than the width of the resonance or of a line."""
        step = max(dynamics.damping_ratio, *(shape.blurred for shape in shapes))
        each_side = min(SETTINGS.most, int(SETTINGS.reach / step))
        moved = np.asarray(1 + step * np.arange(-each_side, each_side + 1), dtype=np.float64)
        return cls(step, moved, dynamics.damping_ratio * np.array(SETTINGS.dampings))

    def likeliest(self, shapes: Sequence[_Shape]) -> tuple[tuple[float, float], float]:
        """The likeliest frequency and damping ratio of spectra that have one resonance, and their log-likelihood."""
        found, likelihood = _best(shapes, self.moved, self.ratios)
        for closer in SETTINGS.closer:
            tried = found[0] + closer * self.step * np.array(SETTINGS.finer)
            found, likelihood = _best(shapes, tried, found[1] * np.array(SETTINGS.finer_dampings) ** closer)
        return found, likelihood


def _best(shapes: Sequence[_Shape], moved: Array, ratios: Array) -> tuple[tuple[float, float], float]:
    """The likeliest of some frequencies and damping ratios for all spectra together, and their log-likelihood."""
    together = np.sum([shape.likelihoods(moved, ratios) for shape in shapes], axis=0)
    row, column = np.unravel_index(np.argmax(together), together.shape)
    return (float(moved[row]), float(ratios[column])), float(together[row, column])
