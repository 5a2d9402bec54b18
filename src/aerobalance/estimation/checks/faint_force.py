r"""Rms of a fluctuating force that may be there below the limit of detection, as a contribution to the uncertainty.

Where a record shows no fluctuation of the force, the force is taken for constant; one too weak to be detected would
then be an error. Its expected rms is an average over hypotheses (Bayesian model averaging): white noise in a band from
zero up to some frequency, or a line at some frequency, each at several levels. The likelihood of each is that of
[Whittle1953]_, from the averaged periodogram of the reading.

Two different prior distributions are used, on purpose:

- for the odds that there is a force at all, one hypothesis is that there is none, and levels are spaced by a constant
  ratio, each as likely as the others;
- for the expected rms, there is a force, and each rms is as likely as any other. With the first prior a force just
  below the limit of detection would be larger than its uncertainty, as the prior itself would say that most likely
  there is nothing or next to nothing.

References
----------
.. [Whittle1953] P. Whittle, "Estimation and information in stationary time series", Ark. Mat. 2 (1953) 423.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import BESIDE_A_GAP, periodogram_of
from aerobalance.estimation.spectra.windows import share_seen
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.resampling import interpolate_gaps_linearly


@dataclass(frozen=True, slots=True)
class FaintSettings:
    """Hypotheses of a force, their prior probabilities, and the odds from which on a doubt is raised.

    These numbers are chosen, not derived.

    Attributes
    ----------
    levels
        Least and largest density of the force over that of the noise [1].
    steps
        Number of levels, a constant ratio apart.
    highest
        Highest frequency over the natural frequency [1]: farther up the balance weakens the force too much.
    lowest
        Width of the narrowest band [ordinates of the periodogram].
    none, bands
        Prior probabilities that there is no force, and that it is a band; what is left is that of a line. The first
        counts for the odds alone.
    told
        Bayes factor of a force against none from which on a doubt is raised [1].
    below
        Posterior probability that the rms of a band is below its upper limit [1].
    """

    levels: tuple[float, float] = (1e-2, 1e3)
    steps: int = 26
    highest: float = 1.0
    lowest: float = 8.0
    none: float = 0.1
    bands: float = 0.7
    told: float = 9.0
    below: float = 0.9


BINS: Final = 512
"""Frequencies from zero to half the sampling rate at which the spectrum of the error is kept."""

SETTINGS: Final = FaintSettings()
"""Settings that are used."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """A force that may be there below the limit of detection.

    Attributes
    ----------
    rms
        Root of its expected mean square [N].
    odds
        Bayes factor of a force against none: the posterior odds over the prior ones [1].
    frequency
        Upper edge of the band or line, its mean over all hypotheses weighted by their power [Hz].
    limit
        Upper limit of the rms of the band that may have most [N].
    edge
        Upper edge of that band [Hz].
    """

    rms: float
    odds: float
    frequency: float
    limit: float
    edge: float

    def error(self, source: str, *, count: int, interval: float) -> Noise:
        """Contribution to the uncertainty of a force that is taken for constant: noise of its rms or limit [N].

        Parameters
        ----------
        source
            Channel that it comes from.
        count
            Number of samples.
        interval
            Time between samples [s].
        """
        frequency = np.linspace(0, 0.5 / interval, BINS)
        rms, highest = max((self.rms, self.frequency), (self.limit, self.edge))
        inside = frequency <= max(highest, float(frequency[1]))
        return Noise("force below detection", source, np.full(count, rms), inside * BINS / np.count_nonzero(inside))

    def doubt(self, component: str, *, unit: str) -> Doubt | None:
        """Doubt about a force that is taken for constant; None where the odds for a fluctuating one are low."""
        if self.odds < SETTINGS.told:
            return None
        text = (
            f"{component} holds something of about {self.rms:.2g} {unit} rms below {self.frequency:.3g} Hz that is "
            "too faint to be told from noise: the force is taken for constant, and that is added to its uncertainty"
        )
        return Doubt("faint force", component, text, "record for longer, or with less noise", self.rms, unit)


def hidden_force(reading: Observation, learned: SpectralPrior, *, left: Array) -> Hidden | None:
    """Return the rms [N] and the band [Hz] of a force that a record may hide; None where the record shows one.

    Parameters
    ----------
    reading
        The record.
    learned
        Spectrum of the force and noise as they were learned from it.
    left
        The readings without the constant, steps and hum, shape (n,) [N].
    """
    if learned.spectrum.levels.any():
        return None
    values = interpolate_gaps_linearly(np.where(reading.present, left, np.nan), beside=BESIDE_A_GAP)
    share = share_seen(reading.present)
    seen = periodogram_of(reading, values - values.mean(), share=share)
    kept = seen.frequency < SETTINGS.highest * reading.dynamics.natural_frequency
    if not kept.any() or not learned.noise > 0:
        return None
    frequency, weight, gain, density = (one[kept] for one in (seen.frequency, seen.weight, seen.gain, seen.density))
    noise = seen.background(share * learned.noise**2 * reading.interval)[kept]
    levels = np.geomspace(*SETTINGS.levels, SETTINGS.steps)
    level = levels * float(np.mean(noise))
    model = noise[:, None] + gain[:, None] * level
    ratio = noise[:, None] / model
    # logarithm of Whittle's likelihood over that without a force, shape (averages, levels): of each record, and on
    # average where there is no force
    gained = weight[:, None] * (np.log(ratio) + density[:, None] / noise[:, None] * (1 - ratio))
    expected = weight[:, None] * (np.log(ratio) + 1 - ratio)
    bands = np.cumsum(gained, axis=0)
    widths = seen.step * np.cumsum(seen.count[kept])
    edges = np.unique(np.searchsorted(widths, np.geomspace(SETTINGS.lowest * seen.step, widths[-1], 16)))
    edges = edges[edges < widths.size]
    line = seen.step * seen.count[kept]
    evidence = np.concatenate([[0.0], bands[edges].ravel(), gained.ravel()])
    each = (SETTINGS.bands / (edges.size * level.size), (1 - SETTINGS.none - SETTINGS.bands) / gained.size)
    prior = np.concatenate([[SETTINGS.none], np.full(edges.size * level.size, each[0]), np.full(gained.size, each[1])])
    # mean squares: densities are two-sided
    power = np.concatenate([[0.0], *((2 * width[:, None] * level).ravel() for width in (widths[edges], line))])
    reach = np.concatenate([[0.0], np.repeat(widths[edges], level.size), np.repeat(frequency + line, level.size)])
    posterior = prior * np.exp(evidence - evidence.max())
    posterior /= posterior.sum()
    # the prior of the expected rms: in proportion to the rms at levels a constant ratio apart, so uniform in the rms,
    # cut off where the force would be seen (`expected` is far below zero there)
    expected_gain = np.vstack([np.cumsum(expected, axis=0)[edges], expected])
    rms = np.sqrt(power[1:]).reshape(expected_gain.shape)
    unseen = np.sum(rms * np.exp(expected_gain), axis=1, keepdims=True)
    weights = np.append(0.0, posterior[1:] * (rms / unseen).ravel())
    if not weights.any():
        return None
    weights /= weights.sum()
    mean = float(weights @ power)
    odds = (1 - posterior[0]) / max(float(posterior[0]), 1e-300) * SETTINGS.none / (1 - SETTINGS.none)
    limits = _limits(rms[: edges.size], bands[edges])
    most = int(np.argmax(limits))
    return Hidden(
        float(np.sqrt(mean)),
        float(odds),
        float(weights @ (power * reach)) / mean,
        float(limits[most]),
        float(widths[edges[most]]),
    )


def _limits(rms: Array, gained: Array) -> Array:
    """Upper limit of the rms of each band, every rms being as likely as another beforehand, shape (bands,) [N].

    Parameters
    ----------
    rms, gained
        Rms at levels a constant ratio apart [N], and the gain in log-likelihood, shape (bands, levels) each.
    """
    weights = rms * np.exp(gained - gained.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    below = np.cumsum(weights, axis=1) - 0.5 * weights
    return np.array([np.interp(SETTINGS.below, *one) for one in zip(below, rms, strict=True)])
