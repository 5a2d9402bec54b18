"""Spectrum of a reading's noise that is not white, estimated from the record where a force is unlikely.

Above its natural frequency the response G of the balance to a force decreases. The spectrum of the readings there is
explained either by a force with a piecewise constant spectrum, multiplied by |G|^2, or by a noise with a piecewise
constant spectrum: by the one that needs fewer changes of level. Noise that is taken for force is amplified by 1 / |G|.
Converters filter and interpolate, so that a record sampled far above the natural frequency always has such noise.

Where the evidence decides for neither, the other explanation counts in the uncertainty by its probability.

References
----------
.. [Wiener1949] N. Wiener, "Extrapolation, Interpolation, and Smoothing of Stationary Time Series", MIT Press (1949).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import softmax

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import BESIDE_A_GAP, periodogram_of
from aerobalance.estimation.spectra.noise_candidates import (
    DIFFERENT,
    FEWEST_ORDINATES,
    SMOOTH,
    NoiseCandidate,
    beyond_a_gap,
    noise_candidates,
)
from aerobalance.estimation.spectra.noise_spectrum import ShapedNoise
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.estimation.spectra.piecewise_psd import (
    CHANGE_EVIDENCE,
    WEAKENED,
    NoiseLevels,
    fit_noise_levels,
)
from aerobalance.estimation.spectra.whittle import (
    SpectrumFit,
    expected_noise,
    fit_spectra,
    fit_spectrum,
    likeliest_of,
    quiet_levels,
)
from aerobalance.estimation.spectra.windows import share_seen
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.fourier import hann
from aerobalance.recording.resampling import interpolate_gaps_linearly

BEYOND_A_GAP: Final = 6.0
"""Logarithm of how much likelier noise is beforehand where a force would begin again beyond a gap of its spectrum:
electronics have such humps, and few loads have a second band far above the natural frequency. And of how much likelier
a force is at most where that band stands high above the white noise."""

USUAL_HUMP: Final = 100.0
"""Density of a hump of noise over that of the white noise up to which the first of these holds."""

RARER: Final = 3.0
"""Power of that ratio by which such humps are rarer above it: those of a thousand times the white noise are no
likelier than a force, and of ten thousand times there are hardly any."""

BLOCKS: Final = 16
"""Parts of a record whose powers are compared."""

LASTING: Final = 0.5
"""Median over mean of the parts' powers beyond white noise, below which the excess is not stationary."""

GRID: Final = 8192
"""Frequencies at which spectra are compared."""

MARGIN: Final = 0.02
"""Share of an error's power on either side of the band that is named."""

CLOSE: Final = 0.03
"""Error of the root of the noise's density where it is approximated, over the root of its mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """What a record shows that may be force or noise: one is taken, and the other is an error of the force.

    Attributes
    ----------
    first, last
        Frequencies between which that is [Hz].
    in_reading
        Its root mean square in the reading [N].
    as_force
        Its root mean square as a force [N].
    taken
        Whether it is taken for force, and not for noise.
    probability
        Probability that it is the other [1].
    missing
        Root of the mean square error of the force by that, the mean over all explanations [N].
    density
        Spectrum of that error at even frequencies up to half the sampling rate, its mean 1 [1].
    """

    first: float
    last: float
    in_reading: float
    as_force: float
    taken: bool
    probability: float
    missing: float
    density: Array

    def doubt(self, component: str, *, unit: str) -> Doubt:
        """Doubt that it may be the other."""
        seen = f"{component} shows {self.in_reading:.2g} {unit} rms between {self.first:.3g} and {self.last:.3g} Hz"
        if self.taken:
            seen += (
                f" that is taken for a force of {self.as_force:.2g} {unit} rms; noise of the electronics would look "
                f"much the same (probability {self.probability:.2g})"
            )
        else:
            seen += (
                " above the white noise of its readings: it is taken for noise of the electronics and not for a force "
                f"of {self.as_force:.2g} {unit} rms, which would look much the same and is then missing from the "
                f"result (probability {self.probability:.2g})"
            )
        seen += f": {self.missing:.2g} {unit} rms of the uncertainty are for that"
        advice = (
            f"state the noise of the channel, or give a record of noise alone ({argument('noise')}), which decides"
        )
        return Doubt("colored noise", component, seen, advice, self.missing, unit)


class _Color(NamedTuple):
    """A noise that is not white: where it exceeds its least density [Hz], its white part [N], and the rest."""

    first: float
    last: float
    white: float
    color: ShapedNoise


class _Explanation(NamedTuple):
    """Force and noise that explain a record, and the evidence for them.

    The noise is what it most likely is and what it is expected to be, at the frequencies of `_grid`: of a noise that
    the record hardly shows zero may be likeliest.
    """

    force: Spectrum
    likeliest: Array
    expected: Array
    evidence: float


def with_floor(
    reading: Observation, *, left: Array, other_dynamics: Callable[[Array], float]
) -> tuple[Observation, Floor | None]:
    """The reading with the color of its noise far above the natural frequency, and that noise; None where it is white.

    What a mode shows that the dynamics lack is no color of the noise.

    Parameters
    ----------
    reading
        The record; if the color of its noise is known already, it is returned unchanged.
    left
        The readings without steps and hum as far as they are known, shape (n,) [N].
    other_dynamics
        Gives the log-likelihood that other dynamics in white noise gain over those of the reading, of readings
        without gaps, shape (n,) [N].
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
    plain = reading
    if np.isfinite(rising) and lasts(
        left, first=rising, interval=reading.interval, noise=np.sqrt(starts[0] / reading.interval)
    ):
        reading = replace(reading, rising=True)
    fits = fit_spectra(periodogram, noise_density=given, floor=least, rising=reading.rising)
    forces = [_force_in_white(reading, periodogram, fit, share=share, known=given is not None) for fit in fits]
    force = forces[fits.index(likeliest_of(fits))]
    apart = beyond_a_gap(force.force, periodogram)
    others = [one for one in forces if _is_other(one, force)]
    tried = noise_candidates(periodogram, found, apart, least=given or least)
    if tried:
        color, noise = _likeliest(reading, periodogram, tried)
        if not lasts(left, first=color.first, last=color.last, interval=reading.interval, noise=color.white):
            return reading, None
        if noise.evidence >= force.evidence:
            if other_dynamics(left) > noise.evidence - force.evidence:
                return plain, None
            colored = replace(reading, color=color.color, noise=color.white)
            return colored, _left_open(reading, noise, [force, *others])
        others = [noise, *others]
    return reading, _left_open(reading, force, others)


def _grid(reading: Observation) -> Array:
    """Frequencies at which explanations are compared, shape (GRID,) [Hz]."""
    return np.linspace(0, 0.5 / reading.interval, GRID + 1)[1:]


def _force_in_white(
    reading: Observation, periodogram: Periodogram, fit: SpectrumFit, *, share: float, known: bool
) -> _Explanation:
    """A force in white noise, whose density may be known."""
    expected = fit.noise_density if known else expected_noise(periodogram, fit)
    if expected < DIFFERENT * fit.noise_density:  # it is known
        expected = fit.noise_density
    likeliest, mean = (np.full(GRID, density / share) for density in (fit.noise_density, expected))
    return _Explanation(fit.spectrum, likeliest, mean, _evidence_of(fit, periodogram))


def _is_other(one: _Explanation, force: _Explanation) -> bool:
    """Whether the noise differs: else a force is the same but for its edges, which are known to an ordinate."""
    return one is not force and bool(abs(np.log(one.likeliest[0] / force.likeliest[0])) > np.log(DIFFERENT))


def _left_open(reading: Observation, taken: _Explanation, others: Sequence[_Explanation]) -> Floor | None:
    """What the other explanations of a record would be as errors of the force; None where they are nothing.

    A filter W = S / (S + N) by what is taken for the spectra S of the force and N of the noise has an error of
    spectrum (1 - W)^2 S' + W^2 N' where they are S' and N' [Wiener1949]_. Its mean over all explanations, each by its
    evidence, less what is expected of those that are taken is what is not in the uncertainty yet. Beside the resonance
    the readings tell the force whatever the noise is.
    """
    frequency = _grid(reading)
    gain = np.abs(reading.dynamics.response(frequency)) ** 2
    every = [taken, *others]
    weight = softmax([one.evidence for one in every])
    force = taken.force.density(frequency)
    noise = taken.likeliest / gain + reading.input_density
    passed = force / (force + noise)
    error = -force * passed * noise / np.maximum(force, 1e-300)
    for one, probability in zip(every, weight, strict=True):
        error += probability * (1 - passed) ** 2 * one.force.density(frequency)
        error += probability * passed**2 * (one.expected / gain + reading.input_density)
    error = np.where(gain < WEAKENED, np.maximum(error, 0.0), 0.0)
    width = float(frequency[0])
    missing = float(np.sqrt(2 * width * np.sum(error)))
    if not missing > 0:
        return None
    below = np.cumsum(error) / np.sum(error)
    first, last = (float(frequency[np.searchsorted(below, share)]) for share in (MARGIN, 1 - MARGIN))
    other = max(others, key=lambda one: one.evidence, default=taken)
    less = other.force.density(frequency) - force
    inside = (frequency >= first) & (frequency <= last)
    as_force, in_reading = (
        float(np.sqrt(2 * width * np.sum(np.abs(one * less)[inside]))) for one in (np.ones(GRID), gain)
    )
    return Floor(
        first=first,
        last=last,
        in_reading=in_reading,
        as_force=as_force,
        taken=bool(np.sum(less[inside]) < 0),
        probability=float(1 - weight[0]),
        missing=missing,
        density=error / np.mean(error),
    )


def _likeliest(
    reading: Observation, periodogram: Periodogram, found: Sequence[NoiseCandidate]
) -> tuple[_Color, _Explanation]:
    """The likeliest of some noises that are not white, with the force beside it.

    Parameters
    ----------
    reading, periodogram
        The record.
    found
        Noises that are tried.
    """
    fits = []
    for _, density, price in found:
        least = float(density.min())
        beyond = np.repeat(density - least, periodogram.count)
        fit = fit_spectrum(replace(periodogram, color=beyond), noise_density=least, rising=reading.rising)
        fits.append((_evidence_of(fit, periodogram) - price, fit.spectrum))
    best = max(range(len(fits)), key=lambda place: fits[place][0])
    noise = _color(reading, periodogram, found[best][0], share=share_seen(reading.present))
    whole = noise.white**2 * reading.interval + noise.color.density(_grid(reading))
    return noise, _Explanation(fits[best][1], whole, whole, fits[best][0])


def _evidence_of(fit: SpectrumFit, periodogram: Periodogram) -> float:
    """Log-likelihood of a force less the price of its changes of level, with which segments are looked for.

    Where it begins, or begins again, beyond a gap it is likelier or less likely beforehand than noise.
    """
    spectrum = fit.spectrum
    changes = SMOOTH if spectrum.roll_off else max(spectrum.levels.size - 1, 0)
    likelihood = fit.log_likelihood - CHANGE_EVIDENCE * changes
    apart = beyond_a_gap(spectrum, periodogram)
    if not apart.any():
        return likelihood
    above = float(np.max(periodogram.load(spectrum)[apart])) / fit.noise_density
    noise = BEYOND_A_GAP if np.any(spectrum.levels[1:-1] == 0) else 0.0  # it begins again
    return likelihood - max(noise - RARER * float(np.log(max(above / USUAL_HUMP, 1.0))), -BEYOND_A_GAP)


def _color(reading: Observation, periodogram: Periodogram, found: NoiseLevels, *, share: float) -> _Color:
    """The noise of a record as a filter of white noise, fitted to its levels."""
    profile = found.density / share
    interval, frequency = reading.interval, periodogram.frequency
    white = float(profile.min())
    above = profile - white
    step = np.flatnonzero(np.diff(above))
    centre = float(frequency[step[int(np.argmax(np.abs(np.diff(above))[step]))]])
    mean = float(np.average(profile, weights=periodogram.count))

    def known(f: Array) -> Array:
        return np.asarray(np.interp(f, frequency, above) + CLOSE**2 * white)

    tolerance = CLOSE * float(np.sqrt(mean))
    color = ShapedNoise.of_density(known, interval=interval, centre=centre, tolerance=tolerance)
    colored = frequency[found.seen & (profile > DIFFERENT * white)]
    first, last = float(colored[0]), float(colored[-1])
    return _Color(first, last, float(np.sqrt(white / interval)), color)


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
