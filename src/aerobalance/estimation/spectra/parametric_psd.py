"""A spectrum that rolls off smoothly: S(f) = S(0) / (1 + (f / corner)^m)^q."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import minimize

from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.recording.channel import Array

STEEPEST_ORDER: Final = 16.0
"""Largest exponent m of a Butterworth spectrum; what is steeper is an edge."""

STEEPEST_POWER: Final = 90.0
"""Largest power q of a Matern spectrum; from there on it is a Gauss curve."""

CORNERS: Final = 16
"""Corners that are tried to begin with."""


def fit_butterworth(periodogram: Periodogram, noise: float, start: Spectrum) -> Spectrum:
    """The most likely spectrum of q = 1: Butterworth's of any order, Dryden's among them."""
    limits = (np.log(0.3), np.log(STEEPEST_ORDER))
    return _fit(periodogram, noise, start, place=2, limits=limits, starts=(2.0, 4.0, 8.0))


def fit_matern(periodogram: Periodogram, noise: float, start: Spectrum) -> Spectrum:
    """The most likely spectrum of m = 2: Matern's of any order, von Karman's among them, Gauss's at its limit."""
    limits = (np.log(0.2), np.log(STEEPEST_POWER))
    return _fit(periodogram, noise, start, place=3, limits=limits, starts=(1.0, 6.0, 20.0))


def _fit(
    periodogram: Periodogram,
    noise: float,
    start: Spectrum,
    *,
    place: int,
    limits: tuple[float, float],
    starts: tuple[float, ...],
) -> Spectrum:
    """Level, corner and one of m and q (the one at `place`) of a roll-off, by the simplex of Nelder and Mead."""
    gain = np.stack([periodogram.gain, periodogram.folded_gain])
    frequency = np.log(np.stack([periodogram.frequency, periodogram.folded_frequency]))
    background, weight, density = periodogram.background(noise), periodogram.weight, periodogram.density
    lowest, highest = float(periodogram.frequency[0]), float(periodogram.frequency[-1])

    def complete(point: Array) -> Array:
        whole = np.array([point[0], point[1], np.log(2.0), 0.0])
        whole[place] = point[2]
        return whole

    def cost(point: Array) -> float:
        level, corner, exponent, power = complete(point)
        inside = limits[0] < point[2] < limits[1] and np.log(0.1 * lowest) < corner < np.log(30 * highest)
        if not (inside and abs(level) < 500):
            return np.inf
        fall = np.exp(power) * np.logaddexp(0.0, np.exp(exponent) * (frequency - corner))
        model = background + np.sum(gain * np.exp(np.maximum(level - fall, -600.0)), axis=0)
        return float(weight @ (np.log(model) + density / model))

    def lowered(origin: Array, **options: float) -> tuple[float, Array]:
        found = minimize(cost, origin, method="Nelder-Mead", options=options)  # type: ignore[call-overload]
        return float(found.fun), np.asarray(found.x)

    if start.roll_off:
        origin = np.log([start.levels[0], start.roll_off[0], start.roll_off[place - 1]])
    else:
        trials = [_origins(periodogram, background, shape, place) for shape in starts]
        quick = [lowered(min(trial, key=cost), xatol=1e-2, fatol=1.0, maxiter=150) for trial in trials]
        origin = min(quick, key=lambda trial: trial[0])[1]
    level, corner, exponent, power = np.exp(complete(lowered(origin, xatol=1e-3, fatol=1e-2, maxiter=600)[1]))
    return Spectrum(np.array([np.inf]), np.array([level]), (float(corner), float(exponent), float(power)))


def _origins(periodogram: Periodogram, background: Array, shape: float, place: int) -> list[Array]:
    """Places to begin from, for one m or q: corners over the whole band, each with the level up to it."""
    raw = np.maximum(periodogram.density - background, 0.0) / periodogram.gain
    frequency, weight = periodogram.frequency, periodogram.weight
    origins = []
    for half in np.geomspace(frequency[0], frequency[-1], CORNERS):
        inside = frequency <= max(half, frequency[min(3, frequency.size - 1)])
        level = max(float(np.average(raw[inside], weights=weight[inside])), 1e-200)
        corner = half if place == 2 else half / np.sqrt(2 ** (1 / shape) - 1)
        origins.append(np.log([level, corner, shape]))
    return origins
