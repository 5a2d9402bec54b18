"""Noise of a reading that rises at low frequency, as a run itself shows it beside its force.

Amplifiers have 1/f noise. A force that fell like it would make the balance ring, and would be weakened above the
natural frequency, so a record tells the two from each other where it shows them at all: with such noise and without it
the spectrum of the force is learned anew, and the evidence compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import expit

from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import periodogram_of
from aerobalance.estimation.spectra.noise_candidates import standing_out
from aerobalance.estimation.spectra.noise_ordinates import Ordinates
from aerobalance.estimation.spectra.noise_record import likeliest_slow
from aerobalance.estimation.spectra.noise_spectrum import SLOWEST, NoiseSpectrum
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.estimation.spectra.whittle import SpectrumFit, evidence_of, fit_spectrum
from aerobalance.estimation.spectra.windows import HANN_WIDTH, share_seen
from aerobalance.recording.channel import Array

EVEN: Final = 5.0
"""Gain in log-likelihood of 1/f noise at which it is as likely as white noise: chance brings it in one of 500."""

TAKEN: Final = 7.0
"""Gain from which on it is taken for what the noise is beside a force, a probability of 0.88: taken falsely it doubles
the uncertainty, and below this it counts in it by its probability."""

WORTH_A_LOOK: Final = 1.0
"""Gain with the force as it was learned from which on the force is learned anew."""

USUAL: Final = (1.0, 0.2)
"""Exponent that noise of electronics usually has, and its standard deviation: what a force hides of the noise follows
from it."""

TRIED: Final = (0.8, 1.0, 1.3)
"""Exponents that are tried to begin with."""

CORNERS: Final = 10
"""Corners that are tried to begin with."""

COARSE: Final = 0.5
"""Noise over the step of a converter below which its rounding goes with the load."""

TURNS: Final = 4
"""Times that noise and force are found in turn."""

SETTLED: Final = 0.1
"""Change of the evidence at which they are found."""

SCORINGS: Final = 4
"""Steps by which the white part is found for the corners that are tried."""


@dataclass(frozen=True, slots=True, eq=False)
class SlowNoise:
    """Noise of a reading that may rise at low frequency.

    Attributes
    ----------
    spectrum
        Spectrum of the noise.
    gain
        Gain in log-likelihood over white noise, the spectrum of the force learned anew with either [1].
    force
        Spectrum of the force with this noise.
    otherwise
        Spectrum of the force with white noise.
    """

    spectrum: NoiseSpectrum
    gain: float
    force: Spectrum
    otherwise: Spectrum

    @property
    def likely(self) -> bool:
        """Whether it is clearly likelier than white noise."""
        return self.gain > (EVEN if self.instead_of_force else TAKEN)

    @property
    def probability(self) -> float:
        """Probability of it, against white noise [1]."""
        return float(expit(self.gain - EVEN))

    @property
    def instead_of_force(self) -> bool:
        """Whether it is all that is taken for force otherwise."""
        return bool(self.otherwise.levels.any() and not self.force.levels.any())

    def taken_by(self, reading: Observation) -> Observation:
        """The reading with this noise."""
        color = self.spectrum.colored_part(reading.values.size * reading.interval)
        return replace(reading, color=color, noise=self.spectrum.deviation)


def slow_noise_of(
    reading: Observation, learned: SpectralPrior, *, left: Array, resolution: float = 0.0
) -> SlowNoise | None:
    """Return 1/f noise that a record may have; None where white noise is clearly likelier, or its color is known.

    Parameters
    ----------
    reading
        The record.
    learned
        What was learned of it with white noise.
    left
        The readings without the constant, steps and hum, gaps bridged, shape (n,) [N].
    resolution
        Step of the converter [N]: what rounding makes of a load that changes slowly is no 1/f noise.
    """
    if reading.color is not None or reading.noise is not None or learned.noise < COARSE * resolution:
        return None
    share, interval = share_seen(reading.present), reading.interval
    periodogram = periodogram_of(reading, left, share=share)
    floor = reading.least_noise**2 * interval
    plain = evidence_of(learned.spectrum, periodogram, max(share * learned.noise**2 * interval, floor), floor=floor)
    nothing = Spectrum(np.zeros(0), np.zeros(0))
    starts = [_promise(periodogram, one, plain) for one in (learned.spectrum, nothing)]
    if max(gain for gain, _ in starts) < WORTH_A_LOOK:
        return None
    # a line that is left out raises the density about it, as noise of a color does
    background = periodogram.background(plain.noise_density)
    narrow = standing_out(periodogram, periodogram.load(plain.spectrum), background)
    if narrow:
        reach = HANN_WIDTH * periodogram.step
        hidden = [
            (periodogram.frequency > first - reach) & (periodogram.frequency < last + reach) for first, last in narrow
        ]
        periodogram = periodogram.without(np.any(hidden, axis=0), leaks=True)
        plain = evidence_of(learned.spectrum, periodogram, plain.noise_density, floor=floor)
        starts = [_promise(periodogram, one, plain) for one in (learned.spectrum, nothing)]
    again = fit_spectrum(periodogram, floor=floor, rising=reading.rising)
    plain = max(plain, again, key=lambda fit: fit.evidence)
    found = [
        _in_turn(reading, periodogram, spectrum, start)
        for spectrum, (_, start) in zip((learned.spectrum, nothing), starts, strict=True)
    ]
    fit, noise = max(found, key=lambda pair: pair[0].evidence)
    # a segment of the force that is just worth it with one noise may just not be with the other
    same = evidence_of(fit.spectrum, periodogram, plain.noise_density, floor=floor)
    plain = max(plain, same, key=lambda fit: fit.evidence)
    noise = replace(noise, white=noise.white / share)
    return SlowNoise(noise, fit.evidence - plain.evidence, fit.spectrum, plain.spectrum)


def _promise(periodogram: Periodogram, force: Spectrum, plain: SpectrumFit) -> tuple[float, Array]:
    """Gain of the best of some corners and exponents beside a force, and the point that it is at.

    The point is the logarithm of the white density, that of the 1/f part at 1 Hz, and the exponent.
    """
    frequency = periodogram.frequency
    highest = float(frequency[-1]) / 4
    corners = np.geomspace(float(frequency[0]), highest, CORNERS)
    exponent, corner = (one.ravel() for one in np.meshgrid(TRIED, corners))
    shape = 1 + (corner / frequency[:, None]) ** exponent
    load = (periodogram.load(force) + periodogram.background(0.0))[:, None]
    seen, weight = periodogram.density[:, None], periodogram.weight[:, None]
    white = np.full(corner.size, plain.noise_density)
    for _ in range(SCORINGS):
        model = load + white * shape
        slope = np.sum(weight * shape * (seen - model) / model**2, axis=0)
        step = slope / np.sum(weight * (shape / model) ** 2, axis=0)
        white = np.clip(white + step, 0.5 * white, 2 * white)
    model = load + white * shape
    likelihood = -np.sum(weight * (np.log(model) + seen / model), axis=0) - _unusual(exponent)
    price = 0.5 * force.parameters * float(np.log(np.sum(periodogram.weight)))
    best = int(np.argmax(likelihood))
    slow = np.log(white[best]) + exponent[best] * np.log(corner[best])
    return float(likelihood[best]) - price - plain.evidence, np.array([np.log(white[best]), slow, exponent[best]])


def _unusual(exponent: Array | float) -> Array:
    """Less the logarithm of how likely an exponent is over the usual one [1]."""
    return np.asarray(0.5 * ((exponent - USUAL[0]) / USUAL[1]) ** 2)


def _in_turn(
    reading: Observation, periodogram: Periodogram, force: Spectrum, start: Array
) -> tuple[SpectrumFit, NoiseSpectrum]:
    """The likeliest force and noise, found in turn from a force and a point of the noise."""
    interval = reading.interval
    slowest = SLOWEST / (reading.values.size * interval)
    floor = reading.least_noise**2 * interval
    best: tuple[SpectrumFit, NoiseSpectrum] | None = None
    for _ in range(TURNS):
        seen = Ordinates(
            periodogram.frequency,
            periodogram.density,
            periodogram.weight,
            periodogram.gain,
            periodogram.load(force) + periodogram.background(0.0),
            interval,
            (),
        )
        noise, start = likeliest_slow(start, seen, USUAL)
        flattened = np.sqrt(periodogram.ordinates[0] ** 2 + slowest**2)
        color = noise.density(flattened) - noise.white
        fit = fit_spectrum(replace(periodogram, color=color), floor=floor, rising=reading.rising)
        fit = replace(fit, evidence=fit.evidence - float(_unusual(noise.exponent)))
        if best is not None and fit.evidence < best[0].evidence + SETTLED:
            break
        best, force = (fit, noise), fit.spectrum
    assert best is not None  # the first turn sets it
    return best
