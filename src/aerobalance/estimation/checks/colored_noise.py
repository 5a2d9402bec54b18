"""Noise of a reading that rises at low frequency: where a force hides it, and where it may be what is taken for force.

What the run shows of such noise (`aerobalance.estimation.spectra.slow_noise`) is taken off the force by the smoother.
Under a load that is stronger it goes on by its law, and nothing there confirms that; and where the evidence decides
for neither, force or noise, each counts by its probability.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import periodogram_of
from aerobalance.estimation.signal_model import SignalModel
from aerobalance.estimation.spectra.noise_spectrum import SLOWEST, NoiseSpectrum
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Assumption, Doubt
from aerobalance.recording.errors import argument

LEFT_OPEN: Final = "noise that the record leaves open"
"""Name of what noise with a color may do to a force that the record neither shows nor rules out."""

FREQUENCIES: Final = 1 << 14
"""Frequencies from zero to half the sampling rate at which spectra are added up."""

BINS: Final = 2048
"""Frequencies at which the spectrum of an error is kept."""

TOLD: Final = 0.3
"""Probability of a noise with a color from which on it is told."""

SHOWN: Final = 12.0
"""Log-likelihood that 1/f noise is expected to gain from which on a record shows it."""

CORNERS: Final = 40
"""Corners of 1/f noise that are tried."""

ROUNDING: Final = 1e-5
"""Root mean square of an error over the range of the readings below which it is that of arithmetic."""

LEAST: Final = 1e-3
"""Root mean square of an error over that of the noise below which nothing is said of it."""


def slow_noise_doubts(
    signal: SignalModel, component: str, *, unit: str
) -> Iterator[tuple[Doubt | None, Noise | None]]:
    """Yield what a record says of noise that rises at low frequency, and what that adds to the uncertainty.

    Parameters
    ----------
    signal
        What the record is made of.
    component
        Whose record it is.
    unit
        Unit of the force.
    """
    slow, reading, learned = signal.slow, signal.reading, signal.learned
    if slow is None:
        return
    taken = slow.likely
    doubtful = 1 - slow.probability if taken else slow.probability
    frequency, color = _color(reading, slow.spectrum)
    hidden, beside = _as_force(reading, learned, frequency, color)
    if slow.instead_of_force:
        density = slow.otherwise.density(frequency)
        open_ = np.sqrt(doubtful) * _rms(density, frequency)
    else:
        density = hidden + beside
        open_ = 0.0 if taken else np.sqrt(doubtful) * _rms(density, frequency)
    error = None
    if open_ > LEAST * learned.noise:
        error = Noise(LEFT_OPEN, component, np.full(reading.values.size, open_), _binned(density))
    below = slow.spectrum.corner < 0.5 / reading.interval
    where = f"below {slow.spectrum.corner:.3g} Hz" if below else "at all frequencies"
    corner = f"as 1/f^{slow.spectrum.exponent:.2g} {where}"
    advice = f"a record of noise alone ({argument('noise')}) decides"
    if taken:
        effect = float(np.hypot(open_, _rms(hidden, frequency)))
        what = (
            f"{component} has noise that rises at low frequency, {corner}, as the run shows it where no force hides "
            f"it; where one does, it is taken to go on: {effect:.2g} {unit} rms of the uncertainty rest on that"
        )
    else:
        effect = float(open_)
        what = (
            f"the noise of {component} may rise at low frequency, {corner} (probability {slow.probability:.2g}), "
            f"which would be taken for force: {effect:.2g} {unit} rms of the uncertainty are for that"
        )
    effect = effect if effect > max(LEAST * learned.noise, ROUNDING * float(np.ptp(reading.filled))) else 0.0
    told = taken or (slow.probability > TOLD and effect > 0)
    yield Doubt("colored noise", component, what, advice, effect, unit) if told else None, error


def noise_assumed(reading: Observation, learned: SpectralPrior, component: str, *, unit: str) -> Iterator[Assumption]:
    """Yield that the noise is white where a force hides it, with what 1/f noise would do that the record cannot show.

    Parameters
    ----------
    reading, learned
        The record, and what was learned of it, its noise being white.
    component, unit
        Whose record it is, and the unit of the force.
    """
    corner = _unseen_corner(reading, learned)
    spectrum = NoiseSpectrum(learned.noise**2 * reading.interval, corner, 1.0, (), reading.interval, np.zeros((2, 2)))
    frequency, color = _color(reading, spectrum)
    effect = _rms(sum(_as_force(reading, learned, frequency, color), np.zeros(1)), frequency)
    if effect > LEAST * learned.noise:
        text = (
            f"the noise of {component} is white where a force hides it: if it rises as 1/f below {corner:.2g} Hz, "
            f"which this record cannot show, it changes the force by {effect:.2g} {unit} rms"
        )
        yield Assumption("colored noise", component, text, effect, unit)


def _unseen_corner(reading: Observation, learned: SpectralPrior) -> float:
    """Highest corner of 1/f noise that a record is not expected to show, up to the natural frequency [Hz]."""
    seen = periodogram_of(reading, reading.filled - float(np.mean(reading.filled)), share=1.0)
    white = learned.noise**2 * reading.interval
    known, frequency = seen.load(learned.spectrum) + seen.background(white), seen.frequency
    weight = seen.weight
    corners = np.geomspace(1e-2 * frequency[0], reading.dynamics.natural_frequency, CORNERS)
    ratio = 1 + white * corners / frequency[:, None] / known[:, None]
    # the white part is found anew with either: it takes up the mean of what is seen of the other
    share = (white / known)[:, None]
    mean = np.sum(weight[:, None] * share * (ratio - 1), axis=0) / np.sum(weight[:, None] * share**2, axis=0)
    ratio = ratio / (1 + mean * share)
    gain = np.sum(weight[:, None] * (ratio - 1 - np.log(ratio)), axis=0)
    return float(corners[max(int(np.searchsorted(gain, SHOWN)) - 1, 0)])


def _color(reading: Observation, spectrum: NoiseSpectrum) -> tuple[Array, Array]:
    """Frequencies [Hz], and the density of the 1/f part of a noise at them, shape (m,) each [N^2/Hz]."""
    frequency = np.linspace(0, 0.5 / reading.interval, FREQUENCIES + 1)
    slowest = SLOWEST / (reading.values.size * reading.interval)
    flattened = np.sqrt(frequency**2 + slowest**2)
    return frequency, spectrum.white * (spectrum.corner / flattened) ** spectrum.exponent


def _as_force(reading: Observation, learned: SpectralPrior, frequency: Array, color: Array) -> tuple[Array, Array]:
    """Density of the force's error by a noise, where a stronger force hides that and where none does, (m,) each."""
    gain = np.abs(reading.dynamics.response(frequency)) ** 2
    noise = learned.noise_density(frequency, interval=reading.interval)
    felt = gain * learned.spectrum.density(frequency)
    passed = felt / np.maximum(felt + noise + gain * reading.input_density, 1e-300)
    error = passed**2 * color / gain
    hidden = felt > noise
    return np.where(hidden, error, 0.0), np.where(hidden, 0.0, error)


def _rms(density: Array, frequency: Array) -> float:
    """Root mean square of a two-sided density [N]."""
    return float(np.sqrt(2 * np.trapezoid(density, frequency)))


def _binned(density: Array) -> Array:
    """A density in bins of equal width, its mean 1."""
    edges = np.linspace(0, density.size, BINS + 1).astype(int)
    means = np.add.reduceat(density, edges[:-1]) / np.diff(edges)
    return np.asarray(means / np.mean(means))
