r"""The spectrum of a reading's noise learned from a record of noise alone: wind off, balance at rest.

Level, corner, exponent and humps are found by Whittle's likelihood [Whittle1953]_; a corner or a hump is taken up only
on evidence. Where levels and powers of frequency between edges have more evidence, these are taken in place of humps
(`aerobalance.estimation.spectra.noise_bands`). What shakes in the balance itself is no noise of the reading:
frequencies near its modes are left out, and so are the mains and other lines
(`aerobalance.estimation.spectra.noise_ordinates`).

References
----------
.. [Whittle1953] P. Whittle, "Estimation and information in stationary time series", Ark. Mat. 2 (1953) 423.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammainc, gammaincc

from aerobalance.dynamics.modal import ModalModel
from aerobalance.estimation.spectra.banded_noise import NUMBER_EVIDENCE, BandedNoise, cost_of
from aerobalance.estimation.spectra.noise_bands import FINE, banded, departs
from aerobalance.estimation.spectra.noise_ordinates import FEWEST_SAMPLES, Ordinates
from aerobalance.estimation.spectra.noise_spectrum import EXPONENTS, Hump, NoiseSpectrum
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError, warn_quality

COLOR_EVIDENCE: Final = 6.0
"""Gain in log-likelihood that a corner must bring; chance brings it in one of 400 records."""

HUMP_EVIDENCE: Final = 20.0
"""Gain in log-likelihood that a hump must bring: Schwarz's price is 14, and it is looked for at many places."""

MOST_HUMPS: Final = 4
"""Most humps."""

WIDTHS: Final = (0.1, 3.0)
"""Widths of a hump over its frequency."""

LACK_OF_FIT_BANDS: Final = 24
"""Bands, a constant ratio wide, in which the record is compared with what is taken for its spectrum."""

LACK_OF_FIT_CHANCE: Final = 1e-7
"""Probability of a departure by chance from which on it is none."""

MATTERS: Final = 0.3
"""Logarithm of the ratio of power from which on they are said to differ."""

ANY_EXPONENT: Final = (1.0, np.inf)
"""Exponent of the 1/f part and its standard deviation before the record is looked at, where it alone is to tell it."""

FAINTEST: Final = 0.05
"""Least white density over the mean one."""


def noise_spectrum_of(
    values: Array, dynamics: ModalModel, *, interval: float, input_density: float = 0.0, name: str = "noise"
) -> NoiseSpectrum:
    """Learn it from a record of noise alone: wind off, balance at rest.

    Parameters
    ----------
    values
        Readings, shape (n,) [N]; NaN where missing: the longest stretch without is taken.
    dynamics
        The balance; frequencies near its modes are left out.
    interval
        Time between samples [s].
    input_density
        Density of the white noise that enters as a force with known inputs [N^2/Hz].
    name
        What the record is called in messages.

    Raises
    ------
    FitError
        The record is too short, does not change, or shows nothing but the modes of the balance.
    """
    values = _longest_stretch(values)
    if values.size < FEWEST_SAMPLES:
        raise FitError(
            f"{name}: {values.size} readings of {dynamics.component} without a gap; "
            f"a spectrum of noise needs at least {FEWEST_SAMPLES}"
        )
    if not float(np.ptp(values)) > 0:
        raise FitError(f"{name}: {dynamics.component} does not change; a record of its noise is needed")
    seen = Ordinates.of(values, dynamics, interval=interval, input_density=input_density, name=name)
    point = fitted(seen)
    edged = _likelier_with_edges(point, seen)
    if edged is None:
        _tell_of_lack_of_fit(seen, model_of(point, seen), component=dynamics.component, name=name)
        return _spectrum_of(point, seen)
    noise, clear = edged
    _tell_of_lack_of_fit(clear, noise.model(clear), component=dynamics.component, name=name)
    return _spectrum_with_edges(noise, clear)


def _likelier_with_edges(point: Array, seen: Ordinates) -> tuple[BandedNoise, Ordinates] | None:
    """Noise with edges, and the averages that tell its levels; None where a point without edges is likelier."""
    fine = seen.averaged(fineness=FINE)
    if point.size == 3 and not departs(fine, model_of(point, fine)):
        return None
    found = banded(seen)
    if found is None:
        return None
    noise, clear = found
    numbers = 3 * len(humps_of(point)) + 2 * np.isfinite(point[1])
    smooth = cost_of(model_of(point, clear), clear) + NUMBER_EVIDENCE * numbers
    edged = cost_of(noise.model(clear), clear) + noise.price(0.5 / seen.interval)
    return found if edged < smooth else None


def _spectrum_with_edges(noise: BandedNoise, seen: Ordinates) -> NoiseSpectrum:
    """The spectrum of a noise with edges."""
    covariance, (white, slow, exponent) = noise.covariance(seen), noise.numbers[:3]
    return NoiseSpectrum(
        white=float(np.exp(white)),
        corner=float(np.exp((slow - white) / exponent)) if noise.slow else 0.0,
        exponent=float(exponent) if noise.slow else 0.0,
        humps=(),
        interval=seen.interval,
        covariance=covariance[1:3, 1:3],
        u_white=float(np.sqrt(covariance[0, 0])),
        left_out=seen.lines,
        hum=seen.hum,
        bands=noise.bands,
        slow_end=noise.slow_end,
    )


def likeliest_slow(start: Array, seen: Ordinates, usual: tuple[float, float]) -> tuple[NoiseSpectrum, Array]:
    """White noise with a 1/f part that is likeliest beside what is known, and its point, found from another.

    Parameters
    ----------
    start
        Logarithms of the white density and of the 1/f part at 1 Hz [N^2/Hz], and the exponent, shape (3,).
    seen
        The record; what is `fixed` in it may be a force as well.
    usual
        Exponent that such noise usually has, and its standard deviation.
    """
    point, _ = _lowered(start, seen, float(np.exp(start[0])), usual=usual)
    return _spectrum_of(point, seen, usual=usual), point


def likeliest_humps(seen: Ordinates) -> tuple[float, tuple[Hump, ...]]:
    """Density of white noise [N^2/Hz], and the humps beside it that there is evidence for.

    Parameters
    ----------
    seen
        The record; what is `fixed` in it may be a force as well.
    """
    mean = float(np.average(seen.density, weights=seen.weight))
    plain = np.array([np.log(float(np.median(seen.density))), -np.inf, 1.0])
    point = _with_humps(*_lowered(plain, seen, mean), seen, mean, slow=False)
    return float(np.exp(point[0])), humps_of(point)


def _spectrum_of(point: Array, seen: Ordinates, *, usual: tuple[float, float] = ANY_EXPONENT) -> NoiseSpectrum:
    """The spectrum of a point."""
    covariance = _covariance(point, seen, usual=usual)
    slow = np.isfinite(point[1])
    exponent = float(point[2]) if slow else 0.0
    return NoiseSpectrum(
        white=float(np.exp(point[0])),
        corner=float(np.exp((point[1] - point[0]) / exponent)) if slow else 0.0,
        exponent=exponent,
        humps=humps_of(point),
        interval=seen.interval,
        covariance=covariance[1:3, 1:3],
        u_white=float(np.sqrt(covariance[0, 0])),
        left_out=seen.lines,
        hum=seen.hum,
    )


def _tell_of_lack_of_fit(seen: Ordinates, model: Array, *, component: str, name: str) -> None:
    """Say where a record of noise departs from its model by more than chance and by enough to matter."""
    edges = np.geomspace(seen.frequency[0], seen.frequency[-1] * (1 + 1e-9), LACK_OF_FIT_BANDS + 1)
    place = np.digitize(seen.frequency, edges) - 1
    weight = np.bincount(place, seen.weight, LACK_OF_FIT_BANDS)
    ratio = np.bincount(place, seen.weight * seen.density / model, LACK_OF_FIT_BANDS) / np.maximum(weight, 1e-300)
    chance = np.minimum(gammaincc(weight, weight * ratio), gammainc(weight, weight * ratio))
    wrong = np.flatnonzero((weight > 0) & (ratio > 0) & (chance < LACK_OF_FIT_CHANCE))
    wrong = wrong[np.abs(np.log(ratio[wrong])) > MATTERS]
    if wrong.size:
        worst = int(wrong[np.argmax(np.abs(np.log(ratio[wrong])))])
        warn_quality(
            f"{name}: the noise of {component} is no white noise with 1/f, broad humps and bands: between "
            f"{edges[worst]:.3g} and {edges[worst + 1]:.3g} Hz its power is {ratio[worst]:.2g} times what is taken; "
            "the uncertainty of a force there is wrong by as much"
        )


def _longest_stretch(values: Array) -> Array:
    """The longest part without a missing reading."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.isfinite(values).astype(np.int8), [0]])))
    starts, ends = edges[::2], edges[1::2]
    if not starts.size:
        return values[:0]
    longest = int(np.argmax(ends - starts))
    return values[starts[longest] : ends[longest]]


def model_of(point: Array, seen: Ordinates) -> Array:
    """Density of a point: log white, log of the 1/f part at 1 Hz, exponent, then log of frequency, width and level."""
    model = seen.fixed + np.exp(point[0])
    if np.isfinite(point[1]):
        model = model + np.exp(point[1] - point[2] * np.log(seen.frequency))
    for hump in humps_of(point):
        model = model + hump.sampled(seen.frequency, seen.interval)
    return np.asarray(model)


def slopes_of(point: Array, seen: Ordinates) -> Array:
    """Derivatives of `model_of` with the numbers of a point, zero for those that it does not have, shape (p, m)."""
    slopes = np.zeros((point.size, seen.frequency.size))
    slopes[0] = np.exp(point[0])
    if np.isfinite(point[1]):
        slow = np.exp(point[1] - point[2] * np.log(seen.frequency))
        slopes[1:3] = slow, -slow * np.log(seen.frequency)
    for place, hump in zip(range(3, point.size, 3), humps_of(point), strict=True):
        slopes[place : place + 3] = hump.slopes(seen.frequency, seen.interval)
    return slopes


def humps_of(point: Array) -> tuple[Hump, ...]:
    """The humps of a point."""
    return tuple(Hump(*(float(number) for number in np.exp(part))) for part in point[3:].reshape(-1, 3))


def fitted(seen: Ordinates) -> Array:
    """The likeliest point with as many parts as there is evidence for."""
    mean = float(np.average(seen.density, weights=seen.weight))
    plain = np.array([np.log(float(np.median(seen.density))), -np.inf, 1.0])
    best, here = _lowered(plain, seen, mean)
    trial, cost = min((_lowered(start, seen, mean) for start in _slow_starts(best, seen)), key=lambda pair: pair[1])
    if here - cost > COLOR_EVIDENCE and _corner_inside(trial, seen):
        best, here = trial, cost
    return _with_humps(best, here, seen, mean, slow=True)


def _with_humps(best: Array, here: float, seen: Ordinates, mean: float, *, slow: bool) -> Array:
    """The likeliest point of a cost with as many humps as there is evidence for, with a 1/f part or without."""
    for _ in range(MOST_HUMPS):
        start = _hump_start(best, seen)
        trials = [(*_lowered(np.concatenate([best, start]), seen, mean), 0.0)]
        if slow and not np.isfinite(best[1]):  # a hump may have hidden the corner
            trials += [
                (*_lowered(np.concatenate([other, start]), seen, mean), COLOR_EVIDENCE)
                for other in _slow_starts(best[:3], seen)[:1]
            ]
        trial, cost, _ = min(trials, key=lambda one: one[1] + one[2])
        if here - cost < HUMP_EVIDENCE or not _corner_inside(trial, seen):
            break
        best, here = trial, cost
    return best


def _corner_inside(point: Array, seen: Ordinates) -> bool:
    """Whether a 1/f part, if there is one, has fallen below the white part within the band."""
    return bool(point[1] - point[0] < -point[2] * np.log(2 * seen.interval))


def _slow_starts(point: Array, seen: Ordinates) -> list[Array]:
    """Points with a 1/f part to begin with: exponents, each as strong as the lowest ordinates show."""
    low = slice(0, 12)
    f = float(np.exp(np.mean(np.log(seen.frequency[low]))))
    level = max(float(np.mean(seen.density[low])) - np.exp(point[0]), 1e-3 * np.exp(point[0]))
    starts = []
    for exponent in (0.7, 1.0, 1.6):
        start = point.copy()
        start[1:3] = np.log(level) + exponent * np.log(f), exponent
        starts.append(start)
    return starts


def _hump_start(point: Array, seen: Ordinates) -> Array:
    """Frequency, width and level of the hump that promises most beside a point, their logarithms."""
    model = model_of(point, seen)
    best, gain = np.zeros(3), -np.inf
    for centre in np.geomspace(seen.lowest_hump, 0.6 / seen.interval, 40):
        for width in (0.2, 0.6, 1.5):
            shape = Hump(float(centre), width, 1.0).sampled(seen.frequency, seen.interval)
            size = shape / model
            level = float(seen.weight @ ((seen.density / model - 1) * size) / (seen.weight @ size**2))
            if level <= 0:
                continue
            promise = cost_of(model, seen) - cost_of(model + level * shape, seen)
            if promise > gain:
                best, gain = np.log([centre, width, level]), promise
    return best if np.isfinite(gain) else np.log([seen.frequency[-1] / 2, 1.0, 1e-3 * model[-1]])


def _lowered(
    start: Array, seen: Ordinates, mean: float, *, usual: tuple[float, float] = ANY_EXPONENT
) -> tuple[Array, float]:
    """The point of least cost from a start, and that cost."""
    free = np.isfinite(start)
    free[2] = free[1]
    humps = (start.size - 3) // 3
    logarithms = [[FAINTEST, 1e3], [1e-12, 1e12]], [[0.5 * seen.lowest_hump, 0.7 / seen.interval], WIDTHS, [1e-9, 1e9]]
    of_noise, of_hump = (np.log(part) for part in logarithms)
    of_noise += np.log(mean)
    of_hump[2] += np.log(mean)
    limits = np.concatenate([of_noise, [EXPONENTS], np.tile(of_hump, (humps, 1))])[free].T

    def whole(point: Array) -> Array:
        full = start.copy()
        full[free] = point
        return full

    def cost(point: Array) -> tuple[float, Array]:
        full = whole(point)
        model, slopes = model_of(full, seen), slopes_of(full, seen)
        slope = slopes @ (seen.weight * (1 - seen.density / model) / model)
        off = (full[2] - usual[0]) / usual[1]
        slope[2] += off / usual[1]
        return cost_of(model, seen) + 0.5 * off**2, slope[free]

    found = minimize(
        cost,
        np.clip(start[free], *limits),
        method="L-BFGS-B",
        jac=True,
        bounds=list(zip(*limits, strict=True)),
        options={"maxiter": 200, "ftol": 1e-10},
    )
    return whole(found.x), float(found.fun)


def _covariance(point: Array, seen: Ordinates, *, usual: tuple[float, float] = ANY_EXPONENT) -> Array:
    """Covariance of a point's numbers, from Fisher's information; zero for those that it does not have."""
    model = model_of(point, seen)
    free = np.isfinite(point)
    free[2] = free[1]
    slopes = slopes_of(point, seen) / model
    information = (slopes * seen.weight) @ slopes.T
    information[2, 2] += 1 / usual[1] ** 2
    covariance = np.zeros((point.size, point.size))
    covariance[np.ix_(free, free)] = np.linalg.pinv(information[np.ix_(free, free)], hermitian=True)
    return covariance
