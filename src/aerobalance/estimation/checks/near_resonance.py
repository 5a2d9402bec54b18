"""The resonance that the spectrum of a reading shows near the one that is expected there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from aerobalance.dynamics.modal import ModalModel
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann


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
    slopes
        Powers of frequency with which the density of the force falls.
    rounds
        Rounds in which the level of the force is found.
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
    slopes: tuple[float, ...] = (0.0, 2.0, 4.0)
    rounds: int = 12
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
    count, expected = values.size, dynamics.natural_frequency
    power = np.abs(np.fft.rfft(values * hann(count))) ** 2
    apart = 1 / (count * interval)
    frequency = np.asarray(np.arange(power.size) * apart, dtype=np.float64)
    low, high = SETTINGS.about
    near = (frequency > low * expected) & (frequency < high * expected)
    if np.count_nonzero(near) < SETTINGS.fewest or dynamics.damping_ratio == 0:
        return None
    together = max(int(dynamics.damping_ratio * expected / (SETTINGS.bins * apart)), 1)
    shape = _Shape(
        _averaged(frequency[near], together) / expected,
        _averaged(power[near], together),
        max(float(np.mean(power[3 * power.size // 4 :])), 1e-300),
        SETTINGS.blurred * apart / expected,
    )
    step = max(dynamics.damping_ratio, shape.blurred)
    each_side = min(SETTINGS.most, int(SETTINGS.reach / step))
    moved = np.asarray(1 + step * np.arange(-each_side, each_side + 1), dtype=np.float64)
    best = shape.best(moved, dynamics.damping_ratio * np.array(SETTINGS.dampings))
    w, ratio = shape.best(np.array(SETTINGS.finer) * step + best[0], np.array(SETTINGS.finer_dampings) * best[1])
    return dynamics.retuned(frequency=w, damping=ratio / dynamics.damping_ratio)


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
    """

    frequency: Array
    power: Array
    noise: float
    blurred: float

    def best(self, moved: Array, ratios: Array) -> tuple[float, float]:
        """The likeliest of some natural frequencies, over the one that is expected, and damping ratios."""
        r = self.frequency / moved[:, None, None]
        width = np.hypot(ratios[:, None], self.blurred)
        gain = 1 / ((1 - r**2) ** 2 + (2 * width * r) ** 2)  # |G|^2, shape (moved, ratios, m)
        likelihood = np.max([self._likelihood(gain * self.frequency**-slope) for slope in SETTINGS.slopes], axis=0)
        place = np.unravel_index(np.argmax(likelihood), likelihood.shape)
        return float(moved[place[0]]), float(ratios[place[1]])

    def _likelihood(self, shape: Array) -> Array:
        """Logarithm of Whittle's likelihood of spectra of some shapes, each at its best level."""
        over = np.maximum(self.power - self.noise, 0.05 * self.power)
        level = np.mean(over / shape, axis=-1, keepdims=True)
        for _ in range(SETTINGS.rounds):
            expected = level * shape + self.noise
            lowers = np.sum(self.power * shape / expected**2, axis=-1, keepdims=True)
            level = level * np.sqrt(lowers / np.sum(shape / expected, axis=-1, keepdims=True))
        expected = level * shape + self.noise
        return np.asarray(-np.sum(np.log(expected) + self.power / expected, axis=-1))
