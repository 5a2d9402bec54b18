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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from aerobalance.estimation.prior import (
    BESIDE_A_GAP,
    Observation,
    evidence_of_prior,
    fit_prior,
    periodogram_of,
)
from aerobalance.estimation.spectra.noise_ordinates import Ordinates
from aerobalance.estimation.spectra.noise_record import likeliest_humps
from aerobalance.estimation.spectra.noise_spectrum import ShapedNoise
from aerobalance.estimation.spectra.parametric_psd import fit_roll_offs
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum, share_seen
from aerobalance.estimation.spectra.piecewise_psd import (
    CHANGE_EVIDENCE,
    LEAK,
    WEAKENED,
    NoiseLevels,
    fit_noise_levels,
    sharpened,
)
from aerobalance.estimation.spectra.whittle import (
    SpectrumFit,
    expected_noise,
    fit_spectra,
    fit_spectrum,
    likeliest_of,
    quiet_levels,
)
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

NO_WEIGHT: Final = 1e-9
"""Weight of averages that are left out of a fit."""

GRID: Final = 8192
"""Frequencies at which spectra are compared."""

SMOOTH: Final = 1.5
"""Numbers of a smooth part of a spectrum over those of a change, its level and its edge."""

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
    levels = [
        one
        for one in found
        if one.density.max() > DIFFERENT * one.density.min() and not _rings(one, periodogram.frequency)
    ]
    priced = [
        (one, _with_edges(one, periodogram), CHANGE_EVIDENCE * int(np.count_nonzero(np.diff(one.density))))
        for one in (*levels, *(other for one in levels for other in _continued(one, periodogram)))
    ]
    fits = fit_spectra(periodogram, noise_density=given, floor=least, rising=reading.rising)
    forces = [_force_in_white(reading, periodogram, fit, share=share, known=given is not None) for fit in fits]
    force = forces[fits.index(likeliest_of(fits))]
    apart = _apart(force.force, periodogram)
    for where in (*(one.seen for one in levels), apart):
        priced += _smooth(periodogram, where, least=given or least)
    others = [one for one in forces if _is_other(one, force)]
    if not priced:
        return reading, _left_open(reading, force, others)
    color, noise = _likeliest(reading, periodogram, priced)
    if not lasts(left, first=color.first, last=color.last, interval=reading.interval, noise=color.white):
        return reading, None
    # by itself, what is there beyond a gap in the spectrum of the force is likelier to be noise
    if noise.evidence < force.evidence - (DECISIVE if apart.any() else 0.0):
        return reading, _left_open(reading, force, [noise, *others])
    return replace(reading, color=color.color, noise=color.white), _left_open(reading, noise, [force, *others])


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
    return _Explanation(fit.spectrum, likeliest, mean, _evidence_of(fit))


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


def _apart(force: Spectrum, periodogram: Periodogram) -> NDArray[np.bool_]:
    """Where the balance weakens a force that begins again beyond a gap of its spectrum, the gap included, (m,).

    A line is none: noise of electronics is broad.
    """
    nowhere = np.zeros(periodogram.gain.size, dtype=np.bool_)
    gaps = np.flatnonzero(force.levels[:-1] == 0)
    if not gaps.size:
        return nowhere
    begins = float(force.edges[gaps[-1]])
    ends = float(force.edges[np.flatnonzero(force.levels)[-1]])
    if ends - begins < 2 * NARROW * begins:
        return nowhere
    first = float(force.edges[gaps[-1] - 1]) if gaps[-1] else 0.0
    return (periodogram.gain < WEAKENED) & (periodogram.frequency > first + periodogram.step * LEAK)


def _without_balance(periodogram: Periodogram, where: NDArray[np.bool_]) -> Periodogram:
    """The same for what the balance does not weaken, with only some of its averages, shape (m,)."""
    return replace(
        periodogram,
        gain=np.ones(where.size),
        folded_gain=np.ones(where.size),
        weight=np.where(where, periodogram.weight, NO_WEIGHT),
        ordinates=np.stack([*periodogram.ordinates[:2], np.ones(periodogram.ordinates.shape[1])]),
        input_density=0.0,
        color=np.repeat(periodogram.background(0.0), periodogram.count),
        gains_above={},
    )


def _with_edges(found: NoiseLevels, periodogram: Periodogram) -> Array:
    """Density of levels, their edges placed as those of a force are and seen through the same window, shape (m,)."""
    alone = _without_balance(periodogram, found.seen)
    last = np.append(np.flatnonzero(np.diff(found.density)), found.density.size - 1)
    edges = (alone.frequency[last] + alone.frequency[np.minimum(last + 1, found.density.size - 1)]) / 2
    edges[-1] = 0.5 / periodogram.interval
    white = float(found.density.min())
    return alone.load(sharpened(Spectrum(edges, found.density[last] - white), alone, white)) + white


def _smooth(
    periodogram: Periodogram, where: NDArray[np.bool_], *, least: float
) -> Iterator[tuple[NoiseLevels, Array, float]]:
    """Noise with broad humps, and noise that rolls off, fitted to some averages, with the price of either.

    What is smooth needs many levels, and then a force, which the balance makes fall by itself, may need fewer.

    Parameters
    ----------
    periodogram
        Of the reading.
    where
        Averages that show noise and no force, shape (m,).
    least
        Least density of the white noise as the periodogram sees it [N^2/Hz].
    """
    if float(np.sum(periodogram.weight[where])) < FEWEST_ORDINATES:
        return
    frequency = periodogram.frequency
    seen = Ordinates(
        frequency[where],
        periodogram.density[where],
        periodogram.weight[where],
        periodogram.gain[where],
        periodogram.background(0.0)[where],
        periodogram.interval,
        (),
    )
    white, humps = likeliest_humps(seen)
    smooth = white + sum((one.sampled(frequency, periodogram.interval) for one in humps), np.zeros(where.size))
    found = [(smooth, len(humps))]
    alone = _without_balance(periodogram, where)
    start = float(np.min(quiet_levels(alone)))
    found += [(alone.load(one) + white, 1) for one, white in fit_roll_offs(alone, [start], floor=least)]
    first = int(np.flatnonzero(where)[0])
    for density, parts in found:
        # below what shows it it goes on as it is there, as levels do
        flat = np.maximum(np.where(np.arange(where.size) < first, density[first], density), least)
        noise = NoiseLevels(flat, where)
        if flat[where].max() > DIFFERENT * flat.min() and not _rings(noise, frequency):
            yield noise, flat, SMOOTH * CHANGE_EVIDENCE * parts


def _likeliest(
    reading: Observation, periodogram: Periodogram, found: Sequence[tuple[NoiseLevels, Array, float]]
) -> tuple[_Color, _Explanation]:
    """The likeliest of some noises that are not white, with the force beside it.

    Parameters
    ----------
    reading, periodogram
        The record.
    found
        Noises, each with its density as the periodogram shows it, shape (m,), and the price of its numbers.
    """
    fits = []
    for _, density, price in found:
        least = float(density.min())
        beyond = np.repeat(density - least, periodogram.count)
        fit = fit_spectrum(replace(periodogram, color=beyond), noise_density=least, rising=reading.rising)
        fits.append((_evidence_of(fit) - price, fit.spectrum))
    best = max(range(len(fits)), key=lambda place: fits[place][0])
    noise = _color(reading, periodogram, found[best][0], share=share_seen(reading.present))
    whole = noise.white**2 * reading.interval + noise.color.density(_grid(reading))
    return noise, _Explanation(fits[best][1], whole, whole, fits[best][0])


def _evidence_of(fit: SpectrumFit) -> float:
    """Log-likelihood of a force less the price of its changes of level, with which segments are looked for."""
    spectrum = fit.spectrum
    changes = SMOOTH if spectrum.roll_off else max(spectrum.levels.size - 1, 0)
    return fit.log_likelihood - CHANGE_EVIDENCE * changes


def _color(reading: Observation, periodogram: Periodogram, found: NoiseLevels, *, share: float) -> _Color:
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
    first, last = float(colored[0]), float(colored[-1])
    return _Color(first, last, float(np.sqrt(white / interval)), ShapedNoise(shaping, interval))


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
