"""Spectrum of a reading's noise that is not white, estimated from the record where a force is unlikely.

Above its natural frequency the response G of the balance to a force decreases. The spectrum of the readings there is
explained either by a force with a piecewise constant spectrum, multiplied by |G|^2, or by a noise with a piecewise
constant spectrum: by the one that needs fewer changes of level. Noise that is taken for force is amplified by 1 / |G|.
Converters filter and interpolate, so that a record sampled far above the natural frequency always has such noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.estimation.prior import (
    BESIDE_A_GAP,
    Observation,
    evidence_of_prior,
    fit_prior,
    periodogram_of,
)
from aerobalance.estimation.spectra.noise_spectrum import ShapedNoise
from aerobalance.estimation.spectra.periodogram import Periodogram, share_seen
from aerobalance.estimation.spectra.piecewise_psd import WEAKENED, NoiseLevels, fit_noise_levels
from aerobalance.estimation.spectra.whittle import fit_spectrum, quiet_levels
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.fourier import hann
from aerobalance.recording.resampling import interpolate_gaps_linearly

DECISIVE: Final = 10.0
"""Gain in log-likelihood that a force must bring over the color of the noise: by itself, noise is likelier."""

DIFFERENT: Final = 1.5
"""Ratio of largest to least density of a noise below which it is taken for white: u is then right to a fifth."""

STATED_EVIDENCE: Final = 25.0
"""Gain in log-likelihood of the innovations for which the level of a run's noise is that of the run, where its channel
states another: a force that reaches half the sampling rate looks like noise by its level alone."""

NO_NOISE: Final = 1e-6
"""Noise over the largest reading below which they are computed: what is stated of their noise then holds."""

FAST: Final = 0.375
"""Frequency over the sampling rate from which on it is looked whether noise above what was stated lasts all along."""

DEPARTURE: Final = 0.2
"""Logarithm of the ratio of powers above which the noise of a run differs from that of the record of noise."""

NEARLY: Final = 0.8
"""Frequency over half the sampling rate from which on a noise with a color leaves little to tell its white part by."""

FEWEST_ORDINATES: Final = 64
"""Independent ordinates above the natural frequency from which on a noise floor is estimated."""

BLOCKS: Final = 16
"""Parts of a record whose powers are compared."""

CONTINUED: Final = 2
"""Levels of a noise, from the lowest frequency that shows it, that are tried for all frequencies below them."""

NEXT: Final = 0.1
"""Square of the response down to which such a level is looked for: up to twice the natural frequency."""

NARROW: Final = 0.1
"""Distance from the highest level of a noise, over its frequency, at which it is asked whether that is a resonance."""

STANDS_OUT: Final = 3.0
"""Density there, over that on either side, from which on it is: an edge of a band has its level on one side."""

LASTING: Final = 0.5
"""Median over mean of the parts' powers beyond white noise, below which the excess is not stationary."""

GRID: Final = 8193
"""Frequencies at which spectra are compared."""

CLOSE: Final = 0.03
"""Error of the root of the noise's density where it is approximated, over the root of its mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """A noise that is not white.

    Attributes
    ----------
    first, last
        Lowest and highest frequency at which its density exceeds `DIFFERENT` times its least one [Hz].
    in_reading
        Its root mean square in the reading, beyond white noise [N].
    as_force
        Root mean square of a force that would look about as likely [N]; 0 where none does.
    white
        Standard deviation of its white part [N].
    color
        The part that is not white.
    likelier_force
        Whether a force in white noise as faint as its least density explains the record clearly better: then only few
        frequencies are left without force, and they alone tell the noise.
    """

    first: float
    last: float
    in_reading: float
    as_force: float
    white: float
    color: ShapedNoise
    likelier_force: bool = False

    @property
    def may_be_force(self) -> bool:
        """Whether a force would look much the same: where the balance weakens it, it is more than the reading."""
        return self.as_force > self.in_reading

    def doubt(self, component: str, *, unit: str) -> Doubt:
        """Doubt that this noise may be a force that is missing from the result."""
        seen = (
            f"{component} shows {self.in_reading:.2g} {unit} rms between {self.first:.3g} and {self.last:.3g} Hz "
            "above the white noise of its readings: it is taken for noise of the electronics and not for a force of "
            f"{self.as_force:.2g} {unit} rms, which would look much the same and is then missing from the result"
        )
        if self.likelier_force:
            seen += "; so little is left without force that the noise is not known: that is in the uncertainty"
        effect = self.as_force if self.likelier_force else 0.0
        advice = f"a record of noise alone ({argument('noise')}) decides"
        return Doubt("colored noise", component, seen, advice, effect, unit)


def with_floor(reading: Observation, *, left: Array) -> tuple[Observation, Floor | None]:
    """The reading with the color of its noise far above the natural frequency, and that noise; None where it is white.

    Parameters
    ----------
    reading
        The record; if the color of its noise is known already, it is returned unchanged.
    left
        The readings without steps and hum as far as they are known, shape (n,) [N].
    """
    if reading.color is not None:
        return reading, None
    left = interpolate_gaps_linearly(np.where(reading.present, left, np.nan), beside=BESIDE_A_GAP)
    share = share_seen(reading.present)
    periodogram = periodogram_of(reading, left, share=share)
    if float(np.sum(periodogram.weight[periodogram.gain < WEAKENED])) < FEWEST_ORDINATES:
        return reading, None
    given = None if reading.noise is None else share * reading.noise**2 * reading.interval
    least = reading.least_noise**2 * reading.interval
    starts = quiet_levels(periodogram) if given is None else [given]
    found = [fit_noise_levels(periodogram, max(start, least)) for start in starts]
    found = [replace(one, density=np.maximum(one.density, given or least)) for one in found]
    rising = min(one.rising for one in found)
    if np.isfinite(rising) and lasts(
        left, first=rising, interval=reading.interval, noise=np.sqrt(starts[0] / reading.interval)
    ):
        reading = replace(reading, rising=True)
    colored = [
        one
        for one in found
        if one.density.max() > DIFFERENT * one.density.min() and not _rings(one, periodogram.frequency)
    ]
    colored += [other for one in colored for other in _continued(one, periodogram)]
    floor = _likeliest(reading, periodogram, colored, left=left, given=given) if colored else None
    if floor is None or not lasts(
        left, first=floor.first, last=floor.last, interval=reading.interval, noise=floor.white
    ):
        return reading, None
    return replace(reading, color=floor.color, noise=floor.white), floor


def _continued(found: NoiseLevels, periodogram: Periodogram) -> Iterator[NoiseLevels]:
    """The same with one of the lowest levels that are seen above the natural frequency for all frequencies below it.

    Below that a faint force takes up what the noise is too low by, and the noise is then found too low.
    """
    places = np.flatnonzero(found.seen & (periodogram.gain < WEAKENED) & (periodogram.gain > NEXT))
    changes = np.flatnonzero(np.diff(found.density[places])) + 1
    for place in places[np.append(0, changes)[:CONTINUED]] if places.size else ():
        density = np.where(np.arange(found.density.size) < place, found.density[place], found.density)
        if density.max() > DIFFERENT * density.min():  # else it is white
            yield replace(found, density=density)


def _rings(found: NoiseLevels, frequency: Array) -> bool:
    """Whether the highest level is a peak as narrow as that of a mode, which noise of electronics does not have."""
    place = int(np.argmax(found.density))
    centre, highest = float(frequency[place]), float(found.density[place])
    beside = np.interp(centre * np.array([1 - NARROW, 1 + NARROW]), frequency, found.density)
    return bool(highest > STANDS_OUT * float(beside.max()))


def _likeliest(
    reading: Observation, periodogram: Periodogram, found: Sequence[NoiseLevels], *, left: Array, given: float | None
) -> Floor | None:
    """The likeliest colored noise; None where a force in white noise explains the record clearly better."""
    share, best, evidence = share_seen(reading.present), None, -np.inf
    for one in found:
        floor = _floor(reading, periodogram, one, share=share)
        colored = periodogram_of(replace(reading, color=floor.color), left, share=share)
        white = share * floor.white**2 * reading.interval
        fit = fit_spectrum(colored, noise_density=white, rising=reading.rising)
        if fit.evidence - _schwarz_penalty(one, periodogram) > evidence:
            best, evidence = floor, fit.evidence - _schwarz_penalty(one, periodogram)
    if best is None:
        return None
    # the competitor that segments cannot imitate: a force that rolls off into white noise
    least = reading.least_noise**2 * reading.interval
    plain = fit_spectrum(periodogram, noise_density=given, floor=least, smooth=True)
    if evidence > plain.evidence + DECISIVE:
        # a force nearly up to half the rate leaves too little to begin with the level of the noise
        if given is not None or best.last < NEARLY * 0.5 / reading.interval:
            return best
        wide = fit_spectrum(periodogram, noise_density=share * best.white**2 * reading.interval)
        if wide.evidence < evidence + DECISIVE:
            return best
        frequency = np.linspace(best.first, 0.5 / reading.interval, GRID)
        as_force = float(np.sqrt(2 * np.trapezoid(wide.spectrum.density(frequency), frequency)))
        return replace(best, as_force=as_force, likelier_force=as_force > best.in_reading)
    frequency = np.linspace(best.first, 0.5 / reading.interval, GRID)
    as_force = float(np.sqrt(2 * np.trapezoid(plain.spectrum.density(frequency), frequency)))
    return replace(best, as_force=as_force) if evidence > plain.evidence - DECISIVE else None


def _schwarz_penalty(found: NoiseLevels, periodogram: Periodogram) -> float:
    """Penalty of the Bayesian information criterion (Schwarz) for the levels of a noise and their edges [1]."""
    changes = np.count_nonzero(np.diff(found.density))
    return changes * float(np.log(np.sum(periodogram.weight)))


def _floor(reading: Observation, periodogram: Periodogram, found: NoiseLevels, *, share: float) -> Floor:
    """The noise of a record as a filter of white noise, fitted to its levels."""
    profile = found.density / share
    interval, frequency = reading.interval, periodogram.frequency
    white = float(profile.min())
    above = profile - white
    highest = 0.5 / interval
    step = np.flatnonzero(np.diff(above))
    centre = float(frequency[step[int(np.argmax(np.abs(np.diff(above))[step]))]])
    mean = float(np.average(profile, weights=periodogram.count))

    def whole(f: Array) -> Array:
        # the process goes on beyond half the sampling rate, and is folded back as much as it has fallen there
        ratio = f / highest
        folded = 1 / (1 + ratio**8) + 1 / (1 + (2 - np.minimum(ratio, 2)) ** 8)
        known = np.interp(np.where(f > highest, 2 * highest - f, f), frequency, above) + CLOSE**2 * white
        return np.asarray(known / folded / (1 + ratio**8))

    shaping = ShapingFilter.of_spectrum(whole, centre=centre, tolerance=CLOSE * float(np.sqrt(mean)))
    colored = frequency[found.seen & (profile > DIFFERENT * white)]
    power = 2 * periodogram.step * float(np.sum(periodogram.count * above))
    color = ShapedNoise(shaping, interval)
    first, last = float(colored[0]), float(colored[-1])
    return Floor(first, last, float(np.sqrt(power)), 0.0, float(np.sqrt(white / interval)), color)


def lasts(left: Array, *, first: float, interval: float, noise: float, last: float = np.inf) -> bool:
    """Whether the power between two frequencies [Hz] is stationary, as that of the noise of electronics is.

    A burst is not; it is reported where the innovations show it (`aerobalance.estimation.force`).
    """
    taper = hann(left.size)  # without it the ends of the record, which do not meet, ring in all of it
    transform = np.fft.rfft((left - left.mean()) * taper)
    frequency = np.fft.rfftfreq(left.size, interval)
    inside = (frequency >= first) & (frequency <= last)
    if not inside.any():  # narrower than the record tells frequencies apart
        inside[np.argmin(np.abs(frequency - first))] = True
    high = np.fft.irfft(np.where(inside, transform, 0.0), left.size)
    inner = slice(1, -1)  # the taper leaves nothing of the first and the last part
    squares, weights = (np.array_split(part**2, BLOCKS)[inner] for part in (high, taper))
    power = np.array([one.sum() / weight.sum() for one, weight in zip(squares, weights, strict=True)])
    ordinates = np.count_nonzero(inside)
    white = noise**2 * ordinates / frequency.size
    middle = float(np.median(power))
    # the variance of a part scatters by 1 / sqrt(its ordinates), the median of n such by 1.25 / sqrt(n) of that
    scatter = 1.25 * middle / np.sqrt(ordinates)
    return bool(middle - white > LASTING * (power.mean() - white) - 3 * scatter)


def departure_of(reading: Observation, *, stated: bool = False) -> float | None:
    """Power of a run's white noise over that of the noise that was given for it [1]; None where they agree.

    Where they do not, the noise of the run has to be learned from the run: if it were taken as given, what is beyond
    it would be taken for force.

    Parameters
    ----------
    reading
        The run, with the noise that was given.
    stated
        Whether that is a number, and not from a record of noise: the run must then be clearly likelier without it.
    """
    if reading.noise is None:
        return None
    constant = np.ones((reading.values.size, 1))
    own = replace(reading, noise=None)
    free = fit_prior(own, columns=constant)
    ratio = (free.noise / max(reading.noise, reading.least_noise)) ** 2
    chance = float(np.sqrt(2 / np.count_nonzero(reading.present)))
    if abs(np.log(ratio)) < max(DEPARTURE, 6 * chance):
        return None
    if stated:
        if free.noise < NO_NOISE * float(np.nanmax(np.abs(reading.values))):
            return None
        left = interpolate_gaps_linearly(reading.values, beside=BESIDE_A_GAP)
        first = FAST / reading.interval
        if ratio > 1 and not lasts(left, first=first, interval=reading.interval, noise=reading.noise):
            return None
        held = fit_prior(reading, columns=constant)
        gain = evidence_of_prior(own, free, columns=constant) - evidence_of_prior(reading, held, columns=constant)
        if gain < STATED_EVIDENCE:
            return None
    return ratio
