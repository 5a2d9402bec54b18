"""The spectrum of the force and the noise of the reading, learned by Whittle's likelihood [Whittle1953]_.

The force may not fluctuate at all, have a spectrum of segments of constant level, or one that rolls off smoothly;
Schwarz's criterion chooses.

References
----------
.. [Whittle1953] P. Whittle, "Estimation and information in stationary time series", Ark. Mat. 2 (1953) 423.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypedDict, Unpack

import numpy as np
from scipy.special import gammaincinv

from aerobalance.estimation.spectra.parametric_psd import fit_roll_offs, refit_roll_off
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.estimation.spectra.piecewise_psd import fit_segments, pruned, with_tail
from aerobalance.recording.channel import Array

TURNS: Final = 4
"""Times that segments and noise are found in turn."""

SETTLED: Final = 1e-3
"""Relative change of the noise at which they are found."""

NEARLY_SETTLED: Final = 1e-2
"""The same from a noise that was found with nearly the same dynamics, where likelihoods are compared: one percent of
the noise is 0.2 in the likelihood of 4000 ordinates."""

SEGMENT_EVIDENCE: Final = 25.0
"""Logarithm of the likelihood that a segment must bring at last, the noise found again without it.

A false one above the natural frequency makes the error several times as large; chance reached 18 in one of a thousand
records.
"""

BANDS: Final = 32
"""Bands of equal width in which the level of the reading is looked at to begin with."""

COLORED: Final = 1.2
"""Ratio of the levels of the reading's upper quarter and its quiet bands, from which both are tried as the noise."""

ANOTHER: Final = 1.0
"""Gain in evidence from which on a fit from another noise is another one, and not the same but for rounding."""

FAINTER: Final = (1.0, 0.25)
"""Densities of the noise to begin with over the level of the faintest band: a force up to half the sampling rate is
the level of that as well, and its edge is looked for too low where as much again is taken for noise."""

FAINT_CHANCE: Final = 0.01
"""Probability with which chance makes one of bands of the same density so faint that these are tried."""


KEPT: Final = 128
"""Fits that are kept: a force and the checks of it ask for some of them again."""

FAINTEST: Final = 1e-6
"""Least density of a noise over the largest that is tried where its mean is asked for."""

TRIED: Final = 256
"""Densities that are tried."""


@dataclass(frozen=True, slots=True)
class SpectrumFit:
    """A spectrum and a noise with the evidence for them.

    Attributes
    ----------
    spectrum
        Spectrum of the force.
    noise_density
        Density of the noise of the reading [N^2/Hz].
    log_likelihood
        Logarithm of Whittle's likelihood [1].
    evidence
        The same less Schwarz's price of the parameters [1].
    """

    spectrum: Spectrum
    noise_density: float
    log_likelihood: float
    evidence: float


class NoiseKnown(TypedDict, total=False):
    """What is known of the noise of a reading, and what its force may be.

    Attributes
    ----------
    noise_density
        Density of the noise of the reading [N^2/Hz]; None, as where it is left out, when it is to be found.
    floor
        Least density of that noise [N^2/Hz]; 0 where left out.
    smooth
        Whether only a spectrum that rolls off is looked for.
    rising
        Whether the force may be stronger where the balance weakens it than elsewhere.
    near
        Density of the noise that was found with nearly the same dynamics [N^2/Hz]: it is begun with in place of a
        quiet level about it, and needs no further turn where it is nearly the same. None, as where it is left out,
        for none.
    """

    noise_density: float | None
    floor: float
    smooth: bool
    rising: bool
    near: float | None


def fit_spectrum(periodogram: Periodogram, **known: Unpack[NoiseKnown]) -> SpectrumFit:
    """Find the spectrum of the force and the noise of the reading.

    Parameters
    ----------
    periodogram
        Of the reading.
    **known
        See `NoiseKnown`.
    """
    return likeliest_of(fit_spectra(periodogram, **known))


def likeliest_of(fits: Sequence[SpectrumFit]) -> SpectrumFit:
    """Return the likeliest of some fits, the first where they are the same but for rounding."""
    best = fits[0]
    for fit in fits[1:]:
        if fit.evidence > best.evidence + ANOTHER:
            best = fit
    return best


def fit_spectra(periodogram: Periodogram, **known: Unpack[NoiseKnown]) -> list[SpectrumFit]:
    """Find what a force may be: the likeliest from usual levels of the noise, and those with a fainter noise.

    Its arguments are those of `fit_spectrum`. What was found lately of the same numbers is not looked for again.
    """
    asked = (periodogram.digest, *sorted(known.items()))
    found = _kept.get(asked)
    if found is None:
        found = _kept[asked] = _fitted(periodogram, **known)
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return list(found)


_kept: Final = OrderedDict[tuple[object, ...], list[SpectrumFit]]()


def _fitted(periodogram: Periodogram, **known: Unpack[NoiseKnown]) -> list[SpectrumFit]:
    """What `fit_spectra` gives, looked for."""
    noise_density, near, floor = known.get("noise_density"), known.get("near"), known.get("floor", 0.0)
    starts = quiet_levels(periodogram) if noise_density is None else [noise_density]
    settled = SETTLED
    if near is not None and noise_density is None and starts[0] / COLORED < near < starts[0] * COLORED:
        starts[0], settled = near, NEARLY_SETTLED
    least = floor if noise_density is None else None
    faint = _faint(periodogram) if noise_density is None else []
    smooth, rising = known.get("smooth", False), known.get("rising", False)
    return [
        _likeliest(periodogram, some, floor=floor, least=least, smooth=smooth, rising=rising, settled=settled)
        for some in (starts, *([one] for one in faint))
    ]


def _likeliest(
    periodogram: Periodogram,
    starts: list[float],
    *,
    floor: float,
    least: float | None,
    smooth: bool,
    rising: bool,
    settled: float,
) -> SpectrumFit:
    """The likeliest of all kinds of spectra, from some densities of the noise."""
    noises = [max(start, floor) for start in starts]
    nothing = Spectrum(np.zeros(0), np.zeros(0))
    fits = [
        *(_with_noise(nothing, periodogram, noise, floor=least) for noise in noises if not smooth),
        *(
            _segmented(periodogram, noise, floor=least, rising=rising, settled=settled)
            for noise in noises
            if not smooth
        ),
    ]
    beside = max((fit.evidence for fit in fits), default=-np.inf)
    fits += [
        _with_noise(spectrum, periodogram, noise, floor=None)
        for spectrum, noise in fit_roll_offs(periodogram, noises, floor=least, beside=beside)
    ]
    return max(fits, key=lambda fit: fit.evidence)


def refit_spectrum(
    periodogram: Periodogram,
    start: SpectrumFit,
    *,
    noise_density: float | None = None,
    floor: float = 0.0,
    rising: bool = False,
) -> SpectrumFit:
    """Find spectrum and noise of a reading from those of one that is nearly the same, of which it keeps the kind.

    That takes a fraction of the time of `fit_spectrum`, whose other arguments it has. A spectrum of another kind,
    which is not looked for, may be more likely.
    """
    least = floor if noise_density is None else None
    noise = max(start.noise_density, floor) if noise_density is None else noise_density
    if start.spectrum.roll_off:
        spectrum, noise = refit_roll_off(periodogram, start.spectrum, noise, floor=least)
        return _with_noise(spectrum, periodogram, noise, floor=None)
    if start.spectrum.levels.size:
        return _segmented(periodogram, noise, floor=least, rising=rising, settled=NEARLY_SETTLED)
    return _with_noise(start.spectrum, periodogram, noise, floor=least)


def evidence_of(spectrum: Spectrum, periodogram: Periodogram, noise: float, *, floor: float | None) -> SpectrumFit:
    """Return a spectrum of the force that is known, with the noise found from one, and the evidence for both.

    Parameters
    ----------
    spectrum, periodogram
        The spectrum, and the reading.
    noise
        Density of the noise to begin with [N^2/Hz].
    floor
        Least density of it [N^2/Hz]; None to keep it.
    """
    return _with_noise(spectrum, periodogram, noise, floor=floor)


def _segmented(
    periodogram: Periodogram, noise: float, *, floor: float | None, rising: bool, settled: float
) -> SpectrumFit:
    """Segments and noise in turn, from a noise, up to a relative change of it; it is kept where no floor is given."""
    for _ in range(TURNS):
        spectrum = fit_segments(periodogram, noise, rising=rising)
        here = _with_noise(spectrum, periodogram, noise, floor=floor)
        change, noise = here.noise_density / noise - 1, here.noise_density
        if abs(change) < settled:
            break
    spectrum = pruned(
        spectrum,
        periodogram,
        lambda load: periodogram.log_likelihood(load, _noise_beside(load, periodogram, here.noise_density, floor)),
        worth=SEGMENT_EVIDENCE,
    )
    spectrum = with_tail(spectrum, periodogram, here.noise_density)
    return _with_noise(spectrum, periodogram, here.noise_density, floor=floor)


def _with_noise(spectrum: Spectrum, periodogram: Periodogram, noise: float, *, floor: float | None) -> SpectrumFit:
    """A spectrum with the noise that goes with it."""
    load = periodogram.load(spectrum)
    noise = _noise_beside(load, periodogram, noise, floor)
    likelihood = periodogram.log_likelihood(load, noise)
    price = 0.5 * spectrum.parameters * float(np.log(np.sum(periodogram.weight)))
    return SpectrumFit(spectrum, noise, likelihood, likelihood - price)


def _noise_beside(load: Array, periodogram: Periodogram, noise: float, floor: float | None) -> float:
    """Density of the noise beside that of a load, (m,), from one to begin with; that one where no floor is given."""
    return noise if floor is None else max(_noise_level(periodogram, load, noise), floor)


def expected_noise(periodogram: Periodogram, fit: SpectrumFit) -> float:
    """Mean of the noise's density by its likelihood, every density being as likely as another beforehand [N^2/Hz].

    A force up to half the sampling rate leaves little to tell it by, and none at all may then be the likeliest.
    """
    most = 2 * max(float(np.min(_levels_of_bands(periodogram)[0])), fit.noise_density)
    tried = np.geomspace(FAINTEST * most, most, TRIED)
    model = (periodogram.load(fit.spectrum) + periodogram.background(0.0))[:, None] + tried
    likelihood = -(periodogram.weight @ (np.log(model) + periodogram.density[:, None] / model))
    weight = np.exp(likelihood - likelihood.max()) * tried  # the densities that are tried are a constant ratio apart
    return float(weight @ tried / np.sum(weight))


def quiet_levels(periodogram: Periodogram) -> list[float]:
    """Densities of the noise to begin with: the lower quartile of the bands' levels, the mean of the upper ones."""
    levels, _ = _levels_of_bands(periodogram)
    quiet, upper = float(np.sort(levels)[len(levels) // 4]), float(np.mean(levels[-(BANDS // 4) :]))
    return [quiet, upper] if upper > COLORED * quiet else [quiet]


def _faint(periodogram: Periodogram) -> list[float]:
    """Densities of the noise to begin with where a band is fainter than the quiet ones by more than chance."""
    levels, weight = _levels_of_bands(periodogram)
    place = int(np.argmin(levels))
    quiet = float(np.sort(levels)[levels.size // 4])
    by_chance = float(gammaincinv(weight[place], FAINT_CHANCE / levels.size)) / weight[place]
    return [share * float(levels[place]) for share in FAINTER] if levels[place] < by_chance * quiet else []


def _levels_of_bands(periodogram: Periodogram) -> tuple[Array, Array]:
    """Mean density of the reading [N^2/Hz] and independent ordinates of each band that has one, shape (b,) each."""
    place = (periodogram.frequency * periodogram.interval * 2 * BANDS).astype(int)
    weight = np.bincount(place, periodogram.weight)
    levels = np.bincount(place, periodogram.weight * periodogram.density)
    return levels[weight > 0] / weight[weight > 0], np.asarray(weight[weight > 0], dtype=np.float64)


def _noise_level(periodogram: Periodogram, load: Array, start: float) -> float:
    """Most likely density of the noise, the load's density known, by Fisher scoring."""
    noise = start
    known = load + periodogram.background(0.0)
    for _ in range(20):
        model = known + noise
        square = model**2
        slope = periodogram.weight @ ((periodogram.density - model) / square)
        step = float(slope / (periodogram.weight @ (1 / square)))
        noise = min(max(noise + step, 0.5 * noise), 2 * noise)
        if abs(step) < 1e-6 * noise:
            break
    return noise
