"""Noises that are not white and may be what a record shows far above the natural frequency of its balance.

They are levels between edges, the same going on below the lowest that is seen, a power of frequency between edges, as
a converter leaves it that shapes its noise, and smooth ones: humps, and a roll-off. Each has a price: what is smooth
needs few numbers, and levels need one for each change.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra.banded_noise import likeliest_power
from aerobalance.estimation.spectra.noise_ordinates import Ordinates
from aerobalance.estimation.spectra.noise_record import likeliest_humps
from aerobalance.estimation.spectra.parametric_psd import fit_roll_offs
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.estimation.spectra.piecewise_psd import (
    CHANGE_EVIDENCE,
    LEAK,
    WEAKENED,
    NoiseLevels,
    fit_segments,
    pruned,
    sharpened,
)
from aerobalance.estimation.spectra.whittle import quiet_levels
from aerobalance.recording.channel import Array

DIFFERENT: Final = 1.5
"""Ratio of largest to least density of a noise below which it is taken for white: u is then right to a fifth."""

FEWEST_ORDINATES: Final = 64
"""Independent ordinates above the natural frequency from which on a noise floor is estimated."""

CONTINUED: Final = 2
"""Levels of a noise, from the lowest frequency that shows it, that are tried for all frequencies below them."""

NEXT: Final = 0.1
"""Square of the response down to which such a level is looked for: up to twice the natural frequency."""

NARROW: Final = 0.1
"""Distance from the highest level of a noise, over its frequency, at which it is asked whether that is a resonance.
And width of a band, over its frequency, up to which it is narrow."""

STANDS_OUT: Final = 3.0
"""Density there, over that on either side, from which on it is: an edge of a band has its level on one side."""

NARROW_EVIDENCE: Final = 18.0
"""Logarithm of the likelihood that a narrow band must bring which is not taken for a force, but counts by the
probability that it is one: beside the price of its two edges, 20, what the window leaks from others is left out. Noise
alone had none in 400 records; with the 25 that a force must bring, two of 46 loads at 160 Hz were 71 u off."""

NO_WEIGHT: Final = 1e-9
"""Weight of averages that are left out of a fit."""

SMOOTH: Final = 1.5
"""Numbers of a smooth part of a spectrum over those of a change, its level and its edge."""

EXPONENT: Final = 0.5
"""Numbers of an exponent over those of a change."""


class NoiseCandidate(NamedTuple):
    """A noise that is not white.

    Attributes
    ----------
    noise
        The noise.
    density
        The same as a periodogram shows it, shape (m,) [N^2/Hz].
    price
        Price of its numbers in log-likelihood [1].
    """

    noise: NoiseLevels
    density: Array
    price: float


def noise_candidates(
    periodogram: Periodogram, found: Sequence[NoiseLevels], apart: NDArray[np.bool_], *, least: float
) -> list[NoiseCandidate]:
    """Return the noises that are not white which may be what a record shows, each with its price.

    Parameters
    ----------
    periodogram
        Of the reading.
    found
        Levels of its noise, from several densities beside a force (`fit_noise_levels`).
    apart
        Averages beyond a gap in the spectrum of the force, shape (m,) (`beyond_a_gap`).
    least
        Least density of the white noise as the periodogram sees it [N^2/Hz].
    """
    levels = [
        one
        for one in found
        if one.density.max() > DIFFERENT * one.density.min() and not _rings(one, periodogram.frequency)
    ]
    tried = [
        NoiseCandidate(one, _with_edges(one, periodogram), CHANGE_EVIDENCE * np.count_nonzero(np.diff(one.density)))
        for one in (*levels, *(other for one in levels for other in _continued(one, periodogram)))
    ]
    tried += [other for one in levels for other in _power_law(one, periodogram)]
    tried += _levels_alone(periodogram, apart, least=least)
    for where in (*(one.seen for one in levels), apart):
        tried += _smooth(periodogram, where, least=least)
    return tried


def without_balance(periodogram: Periodogram, where: NDArray[np.bool_]) -> Periodogram:
    """Return the same for what the balance does not weaken, with only some of its averages.

    Parameters
    ----------
    periodogram
        Of the reading.
    where
        Those averages, shape (m,).
    """
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


def narrow_bands(spectrum: Spectrum, which: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the edges of those of some segments of a spectrum, shape (s,), that are narrow [Hz]."""
    firsts = np.append(0.0, spectrum.edges)[:-1]
    narrow = which & (spectrum.edges - firsts < NARROW * spectrum.edges)
    return list(zip(firsts[narrow].tolist(), spectrum.edges[narrow].tolist(), strict=True))


def standing_out(periodogram: Periodogram, load: Array, background: Array) -> list[tuple[float, float]]:
    """Return the edges of narrow bands that stand out where no force shows and the balance would weaken it [Hz].

    Parameters
    ----------
    periodogram
        Of the reading.
    load, background
        Density that is expected of the force's load and of noise, shape (m,) each [N^2/Hz].
    """
    where = (periodogram.gain < WEAKENED) & (load < background)
    if not where.any():
        return []
    alone = replace(without_balance(periodogram, where), color=np.repeat(load + background, periodogram.count))
    found = fit_segments(alone, 0.0)
    found = pruned(found, alone, lambda power: alone.log_likelihood(power, 0.0), worth=NARROW_EVIDENCE)
    return narrow_bands(found, found.levels > 0)


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


def beyond_a_gap(force: Spectrum, periodogram: Periodogram) -> NDArray[np.bool_]:
    """Return where the balance weakens a force that begins again beyond a gap of its spectrum, the gap included, (m,).

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


def _with_edges(found: NoiseLevels, periodogram: Periodogram) -> Array:
    """Density of levels, their edges placed as those of a force are and seen through the same window, shape (m,)."""
    alone = without_balance(periodogram, found.seen)
    white = float(found.density.min())
    edges, levels = _edges_of(found, periodogram)
    return alone.load(sharpened(Spectrum(edges, levels - white), alone, white)) + white


def _edges_of(found: NoiseLevels, periodogram: Periodogram) -> tuple[Array, Array]:
    """Upper edges of the levels of a noise [Hz], and these [N^2/Hz], shape (k,) each."""
    frequency = periodogram.frequency
    last = np.append(np.flatnonzero(np.diff(found.density)), found.density.size - 1)
    edges = (frequency[last] + frequency[np.minimum(last + 1, found.density.size - 1)]) / 2
    edges[-1] = 0.5 / periodogram.interval
    return edges, found.density[last]


def _levels_alone(periodogram: Periodogram, where: NDArray[np.bool_], *, least: float) -> Iterator[NoiseCandidate]:
    """Levels of noise where a force may be as well: which of them needs fewer changes is chance where both are few."""
    if float(np.sum(periodogram.weight[where])) < FEWEST_ORDINATES:
        return
    alone = without_balance(periodogram, where)
    white = max(float(np.min(quiet_levels(alone))), least)
    found = fit_segments(alone, white)
    density = alone.load(found) + white
    noise = NoiseLevels(density, where)
    if density[where].max() > DIFFERENT * density[where].min() and not _rings(noise, periodogram.frequency):
        yield NoiseCandidate(noise, density, CHANGE_EVIDENCE * (found.levels.size - 1))


def _power_law(found: NoiseLevels, periodogram: Periodogram) -> Iterator[NoiseCandidate]:
    """The same as a power of frequency from the lowest level that is not white up to the highest."""
    white = float(found.density.min())
    colored = np.flatnonzero(found.density > DIFFERENT * white)
    first, last = int(colored[0]), int(colored[-1])
    if first == 0 or np.ptp(found.density[first : last + 1]) == 0:
        return  # it goes on below what is seen, or is one level
    edges, levels = _edges_of(found, periodogram)
    alone = without_balance(periodogram, found.seen)
    edges = sharpened(Spectrum(edges, levels - white), alone, white).edges
    inside = levels > DIFFERENT * white
    begin, end = float(edges[np.argmax(inside) - 1]), float(edges[np.flatnonzero(inside)[-1]])
    band = Spectrum(np.array([begin, end, 0.5 / periodogram.interval]), np.array([0.0, 1.0, 0.0]))
    shown, ratio = alone.load(band), np.log(np.maximum(periodogram.frequency / begin, 1.0))
    inside = found.seen & (shown > 0)
    if float(np.sum(periodogram.weight[inside])) < FEWEST_ORDINATES or np.ptp(ratio[inside]) == 0:
        return  # too few to tell a power from a level
    numbers = likeliest_power(
        np.array([np.log(float(found.density[first]) - white), 0.0]),
        shown[inside],
        ratio[inside],
        known=white + periodogram.background(0.0)[inside],
        density=periodogram.density[inside],
        weight=periodogram.weight[inside],
    )
    density = white + shown * np.exp(numbers[0] + numbers[1] * ratio)
    changes = 1 if last == found.density.size - 1 else 2
    yield NoiseCandidate(NoiseLevels(density, found.seen), density, CHANGE_EVIDENCE * (changes + EXPONENT))


def _smooth(periodogram: Periodogram, where: NDArray[np.bool_], *, least: float) -> Iterator[NoiseCandidate]:
    """Noise with broad humps, and noise that rolls off, fitted to some averages.

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
    alone = without_balance(periodogram, where)
    start = float(np.min(quiet_levels(alone)))
    found += [(alone.load(one) + white, 1) for one, white in fit_roll_offs(alone, [start], floor=least)]
    first = int(np.flatnonzero(where)[0])
    for density, parts in found:
        # below what shows it it goes on as it is there, as levels do
        flat = np.maximum(np.where(np.arange(where.size) < first, density[first], density), least)
        noise = NoiseLevels(flat, where)
        if flat[where].max() > DIFFERENT * flat.min() and not _rings(noise, frequency):
            yield NoiseCandidate(noise, flat, SMOOTH * CHANGE_EVIDENCE * parts)
