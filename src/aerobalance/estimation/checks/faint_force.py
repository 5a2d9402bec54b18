"""A force that the noise hides: what could be there and not be found.

Where no fluctuation of the force is found, there may be one below its own detection. What a record leaves open of it
is averaged over the hypotheses: a band from zero up to some frequency, or a line at some frequency, each of any root
mean square, all alike before the record is looked at, by Whittle's likelihood. That there is none is no part of this
average, nor is it likelier that a force is small by orders of magnitude: either would say in advance that nothing is
there, and a force just below detection would then be larger than its uncertainty. Both are only weighed where it is
asked whether something is to be told.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.prior import BESIDE_A_GAP, Observation, SpectralPrior, periodogram_of
from aerobalance.estimation.spectra.periodogram import share_seen
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.resampling import interpolate_gaps_linearly


@dataclass(frozen=True, slots=True)
class FaintSettings:
    """Which forces are thought of, and when one is told.

    Attributes
    ----------
    levels
        Least and largest density over that of the noise.
    steps
        Levels that are tried.
    highest
        Highest frequency over the natural one: farther up the balance hides too much.
    lowest
        Width of the narrowest band in ordinates.
    none, bands
        Probabilities that there is none, and that there is a band, before the record is looked at; else a line. That
        there is none counts where it is asked whether one is told.
    told
        Odds that there is one, by the record alone, from which on it is told.
    """

    levels: tuple[float, float] = (1e-2, 1e3)
    steps: int = 26
    highest: float = 1.0
    lowest: float = 8.0
    none: float = 0.1
    bands: float = 0.7
    told: float = 9.0


BINS: Final = 512
"""Frequencies at which the spectrum of an error is kept."""

SETTINGS: Final = FaintSettings()
"""Settings that are used."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """What may be hidden.

    Attributes
    ----------
    rms
        Root mean square of the force that is to be expected [N].
    odds
        Odds that there is one at all, by the record alone [1].
    frequency
        Frequency below which its power lies, its mean over what is likely [Hz].
    """

    rms: float
    odds: float
    frequency: float

    def error(self, source: str, *, count: int, interval: float) -> Noise:
        """What it does to the force, if that is taken for constant."""
        frequency = np.linspace(0, 0.5 / interval, BINS)
        inside = frequency <= max(self.frequency, float(frequency[1]))
        return Noise(
            "force below detection", source, np.full(count, self.rms), inside * BINS / np.count_nonzero(inside)
        )

    def doubt(self, component: str, *, unit: str) -> Doubt | None:
        """What it says against a force that is taken for constant; None where none is likely."""
        if self.odds < SETTINGS.told:
            return None
        text = (
            f"{component} holds something of about {self.rms:.2g} {unit} rms below {self.frequency:.3g} Hz that is "
            "too faint to be told from noise: the force is taken for constant, and that is added to its uncertainty"
        )
        return Doubt("faint force", component, text, "record for longer, or with less noise", self.rms, unit)


def hidden_force(reading: Observation, learned: SpectralPrior, *, left: Array) -> Hidden | None:
    """Return what force may be hidden in a record that shows none; None where it shows one.

    Parameters
    ----------
    reading
        The record.
    learned
        What was learned of it.
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
    gained = weight[:, None] * (np.log(ratio) + density[:, None] / noise[:, None] * (1 - ratio))
    expected = weight[:, None] * (np.log(ratio) + 1 - ratio)  # without a force
    bands = np.cumsum(gained, axis=0)
    widths = seen.step * np.cumsum(seen.count[kept])
    some = np.unique(np.searchsorted(widths, np.geomspace(SETTINGS.lowest * seen.step, widths[-1], 16)))
    some = some[some < widths.size]
    line = seen.step * seen.count[kept]
    evidence = np.concatenate([[0.0], bands[some].ravel(), gained.ravel()])
    each = (SETTINGS.bands / (some.size * level.size), (1 - SETTINGS.none - SETTINGS.bands) / gained.size)
    chance = np.concatenate([[SETTINGS.none], np.full(some.size * level.size, each[0]), np.full(gained.size, each[1])])
    power = np.concatenate([[0.0], *((2 * width[:, None] * level).ravel() for width in (widths[some], line))])
    reach = np.concatenate([[0.0], np.repeat(widths[some], level.size), np.repeat(frequency + line, level.size)])
    likely = chance * np.exp(evidence - evidence.max())
    likely /= likely.sum()
    # levels are a constant ratio apart: so each root mean square counts alike, up to what is expected to be seen of it
    steady = np.vstack([np.cumsum(expected, axis=0)[some], expected])
    size = np.sqrt(power[1:]).reshape(steady.shape)
    open_ = np.append(0.0, likely[1:] * (size / np.sum(size * np.exp(steady), axis=1, keepdims=True)).ravel())
    if not open_.any():
        return None
    open_ /= open_.sum()
    mean = float(open_ @ power)
    odds = (1 - likely[0]) / max(float(likely[0]), 1e-300) * SETTINGS.none / (1 - SETTINGS.none)
    return Hidden(float(np.sqrt(mean)), float(odds), float(open_ @ (power * reach)) / mean)
