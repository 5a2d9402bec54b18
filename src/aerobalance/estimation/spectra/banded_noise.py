"""Noise with edges as a point of the likelihood: white, a 1/f part, and levels and powers of frequency between edges.

Its numbers are found by scoring, for given edges; `aerobalance.estimation.spectra.noise_bands` finds the edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra.noise_ordinates import Ordinates
from aerobalance.estimation.spectra.noise_spectrum import EXPONENTS, Band
from aerobalance.estimation.spectra.piecewise_psd import CHANGE_EVIDENCE
from aerobalance.recording.channel import Array

NUMBER_EVIDENCE: Final = CHANGE_EVIDENCE / 2
"""Gain in log-likelihood that each number must bring: a change has two, its level and its edge."""

STEEPEST: Final = 12.0
"""Largest exponent: converters of the fifth order shape the density of their noise as the tenth power of frequency."""

LEAKS: Final = 12
"""Ordinates on either side of an edge that tell no level: the window leaks less than 1e-5 of a band so far."""

STEPS: Final = 12
"""Steps of scoring at most, by which the level and the exponent of one power of frequency are found."""

ENOUGH: Final = 1e-3
"""Change of both in a step at which the first end; gain expected of a step at which the second end."""

MOST_STEPS: Final = 60
"""Steps of scoring at most, by which all numbers of a noise are found."""

FIRST_DAMPING: Final = 1e-3
"""Damping of the first of the latter, over the information: a tenth after a step that gains, else ten times it."""

MOST_DAMPING: Final = 1e6
"""Damping from which on no step gains anything."""

TINY: Final = 1e-9
"""Information that is added: of a part that is hidden the record tells nothing; and least exponent of a power."""

LONGEST: Final = 1.5
"""Change of a logarithm in one step at most."""

FAINTEST: Final = 1e-12
"""Least density of any part over the largest that the record shows."""

FAR: Final = float(-np.log(FAINTEST))
"""Its logarithm: a number of a part is at most so far from that of the largest, or a quarter of it above."""


def cost_of(model: Array, seen: Ordinates) -> float:
    """Less the logarithm of Whittle's likelihood."""
    return float(seen.weight @ (np.log(model) + seen.density / model))


@dataclass(frozen=True, slots=True, eq=False)
class BandedNoise:
    """White noise, parts between edges, and a 1/f part: a point of the likelihood.

    Attributes
    ----------
    numbers
        Logarithms of the white density and of the 1/f part at 1 Hz [N^2/Hz], the latter minus infinity for none, its
        exponent, and for each band the logarithm of its level at the upper edge and its exponent, shape (3 + 2 b,).
    edges
        Lower and upper edges of the bands [Hz], shape (b, 2).
    sloped
        Which bands are a power of frequency, shape (b,).
    slow_end
        Frequency from which on there is nothing of the 1/f part [Hz].
    """

    numbers: Array
    edges: Array
    sloped: NDArray[np.bool_]
    slow_end: float

    @property
    def slow(self) -> bool:
        """Whether there is a 1/f part."""
        return bool(np.isfinite(self.numbers[1]))

    @property
    def bands(self) -> tuple[Band, ...]:
        """The bands."""
        pairs = self.numbers[3:].reshape(-1, 2)
        return tuple(
            Band(float(first), float(last), float(np.exp(level)), float(exponent))
            for (first, last), (level, exponent) in zip(self.edges, pairs, strict=True)
        )

    def price(self, highest: float) -> float:
        """Price of its numbers beside the white density, up to the highest frequency, in log-likelihood [1]."""
        inner = np.unique(self.edges[(self.edges > 0) & (self.edges < highest)])
        numbers = inner.size + self.sloped.size + np.count_nonzero(self.sloped) + 2 * self.slow
        return float(NUMBER_EVIDENCE * numbers)

    def parts(self, seen: Ordinates) -> Array:
        """Densities of the white part, the 1/f part and the bands in the averages, shape (2 + b, m) [N^2/Hz]."""
        f = seen.frequency
        slow = np.where(f < self.slow_end, np.exp(self.numbers[1] - self.numbers[2] * np.log(f)), 0.0)
        return np.stack([np.full(f.size, np.exp(self.numbers[0])), slow, *(band.density(f) for band in self.bands)])

    def model(self, seen: Ordinates) -> Array:
        """Density of the reading in the averages, shape (m,) [N^2/Hz]."""
        return np.asarray(seen.fixed + self.parts(seen).sum(axis=0))

    def slopes(self, seen: Ordinates, parts: Array) -> Array:
        """Derivatives of its density with its numbers, shape (3 + 2 b, m)."""
        slopes = np.empty((self.numbers.size, seen.frequency.size))
        slopes[:2], slopes[3::2] = parts[:2], parts[2:]
        slopes[2] = -parts[1] * np.log(seen.frequency)
        ratio = np.log(seen.frequency / self.edges[:, 1:])
        slopes[4::2] = parts[2:] * ratio
        return slopes

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which of its numbers are free."""
        free = np.ones(self.numbers.size, dtype=np.bool_)
        free[1:3] = self.slow
        free[4::2] = self.sloped
        return free

    def apart(self, seen: Ordinates) -> list[tuple[float, float]]:
        """Frequencies about its edges that tell no level [Hz]."""
        reach = LEAKS * seen.step
        return [(edge - reach, edge + reach) for edge in np.unique(self.edges) if 0 < edge < 0.5 / seen.interval]

    def lowered(self, seen: Ordinates) -> tuple[BandedNoise, float]:
        """The likeliest with these edges, and less the logarithm of its likelihood."""
        free = self.free
        largest = float(np.log(seen.density.max()))
        of_level, of_slow = (largest - FAR, largest + FAR / 4), (largest - FAR, largest + FAR)
        limits = np.array([of_level, of_slow, EXPONENTS, *[of_level, (-STEEPEST, STEEPEST)] * len(self.edges)])
        limits[4::2, 0] *= self.edges[:, 0] > 0  # from zero on it rises: what falls there has no end
        limits = limits[free]

        here = replace(self, numbers=self.numbers.copy())
        here.numbers[free] = np.clip(self.numbers[free], *limits.T)
        parts = here.parts(seen)
        cost, damping = cost_of(seen.fixed + parts.sum(axis=0), seen), FIRST_DAMPING
        for _ in range(MOST_STEPS):
            model = seen.fixed + parts.sum(axis=0)
            slopes = (here.slopes(seen, parts) / model)[free]
            slope = slopes @ (seen.weight * (seen.density / model - 1))
            information = (slopes * seen.weight) @ slopes.T
            information += np.diag(damping * np.diag(information) + TINY)
            step = np.linalg.solve(information, slope)
            step *= min(1.0, LONGEST / float(np.max(np.abs(step))))
            if slope @ step < ENOUGH or damping > MOST_DAMPING:
                break
            trial = replace(here, numbers=here.numbers.copy())
            trial.numbers[free] = np.clip(here.numbers[free] + step, *limits.T)
            found = trial.parts(seen)
            now = cost_of(seen.fixed + found.sum(axis=0), seen)
            if now < cost:
                here, parts, cost, damping = trial, found, now, damping / 10
            else:
                damping *= 10
        return here, cost

    def covariance(self, seen: Ordinates) -> Array:
        """Covariance of its numbers, from Fisher's information; zero for those that are not free."""
        free, parts = self.free, self.parts(seen)
        slopes = (self.slopes(seen, parts) / (seen.fixed + parts.sum(axis=0)))[free]
        covariance = np.zeros((self.numbers.size, self.numbers.size))
        covariance[np.ix_(free, free)] = np.linalg.pinv((slopes * seen.weight) @ slopes.T, hermitian=True)
        return covariance


def likeliest_power(start: Array, shown: Array, ratio: Array, *, known: Array, density: Array, weight: Array) -> Array:
    """Return the logarithm of a level and the exponent of a power of frequency that is likeliest, by scoring, (2,).

    Parameters
    ----------
    start
        Both to begin with.
    shown
        Share of it that each average shows, shape (m,) [1].
    ratio
        Logarithm of the frequency over that of the level, shape (m,).
    known
        Density of what else there is, shape (m,) [N^2/Hz].
    density, weight
        Density of the reading, and independent ordinates, of each average, shape (m,).
    """
    numbers, shapes = start.copy(), np.stack([np.ones_like(ratio), ratio])
    for _ in range(STEPS):
        rise = shown * np.exp(numbers @ shapes)
        model = rise + known
        slopes = shapes * (rise / model)
        information = (slopes * weight) @ slopes.T + TINY * np.eye(2)
        step = np.clip(np.linalg.solve(information, (slopes * weight) @ (density / model - 1)), -1.0, 1.0)
        numbers[1] = np.clip(numbers[1] + step[1], -STEEPEST, STEEPEST)
        numbers[0] += step[0]
        if np.max(np.abs(step)) < ENOUGH:
            break
    return numbers
