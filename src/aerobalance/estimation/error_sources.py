"""Contributions to the uncertainty of a force, each with what it needs to be carried to a mean, an rms or a peak.

An error that holds along the whole record is a few unknown numbers times known slopes; an error that is drawn anew all
the time is a noise of some spectrum. The first does not average out, the second does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class Systematic:
    """An error that is fully correlated along the record: slopes times a few quantities that are not well known.

    Attributes
    ----------
    name
        What it is.
    source
        Channel or file that it comes from.
    quantities
        Names of the p quantities.
    slopes
        Derivative of the force with respect to each, shape (n, p) [N per unit of the quantity].
    covariance
        Covariance of the quantities, shape (p, p).
    """

    name: str
    source: str
    quantities: tuple[str, ...]
    slopes: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """Standard uncertainty of every sample, shape (n,) [N]."""
        variance = np.sum((self.slopes @ self.covariance) * self.slopes, axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def halved(self) -> float:
        """What is left of the contribution when its cause is halved, relative [1]."""
        return 0.5

    def variance_of(self, weights: Array) -> float:
        """Variance of a weighted sum of the samples [N^2]; weights of shape (n,) [1]."""
        gradient = weights @ self.slopes
        return max(float(gradient @ self.covariance @ gradient), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """An error that is noise: a standard deviation for every sample and the shape of its spectrum.

    Attributes
    ----------
    name
        What it is.
    source
        Channel that it comes from.
    deviation
        Standard uncertainty of every sample, shape (n,) [N].
    spectrum
        Power spectral density at frequencies from 0 to half the sampling rate, evenly spaced, its mean 1, shape (m,);
        one value stands for white noise.
    halved
        What is left of the contribution when its cause is halved, relative [1].
    """

    name: str
    source: str
    deviation: Array
    spectrum: Array
    halved: float = 0.5

    def variance_of(self, weights: Array) -> float:
        """Variance of a weighted sum of the samples [N^2]; weights of shape (n,) [1]."""
        count = 2 * weights.size  # twice the record, so that its end does not touch its beginning
        power = np.abs(np.fft.rfft(weights * self.deviation, count)) ** 2
        power[1:-1] *= 2
        return float(power @ self.relative_density(power.size) / count)

    def relative_density(self, count: int) -> Array:
        """Spectrum at so many frequencies from 0 to half the sampling rate, shape (count,) [1]."""
        places = np.linspace(0, 1, count)
        return np.interp(places, np.linspace(0, 1, self.spectrum.size), self.spectrum)

    def draw(self, generator: np.random.Generator) -> Array:
        """One error of this kind, shape (n,) [N]."""
        size = self.deviation.size
        white = np.fft.rfft(generator.normal(size=2 * size))
        return self.deviation * np.fft.irfft(white * np.sqrt(self.relative_density(white.size)), 2 * size)[:size]


Contribution = Systematic | Noise


def total_deviation(contributions: tuple[Contribution, ...]) -> Array:
    """Standard uncertainty of every sample from all contributions, shape (n,) [N]."""
    return np.asarray(np.sqrt(np.sum([part.deviation**2 for part in contributions], axis=0)))
