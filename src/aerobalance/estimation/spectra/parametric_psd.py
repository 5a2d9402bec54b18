"""A spectrum that rolls off smoothly: S(f) = S(0) / (1 + (f / corner)^m)^q.

Level, corner, one of m and q, and the noise of the reading are found together, by scoring: Newton's method with the
information that is expected [Fahrmeir2001]_, damped as Levenberg and Marquardt do. All beginnings go at once over few
coarse averages; the best of each kind then goes on over all averages.

References
----------
.. [Fahrmeir2001] L. Fahrmeir, G. Tutz, "Multivariate Statistical Modelling Based on Generalized Linear Models",
   2nd ed., Springer (2001), sec. 2.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.spectra._kernels import AveragedReading, Search, lower_roll_offs
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.recording.channel import Array

EXPONENTS: Final = (0.3, 16.0)
"""Least and largest exponent m of a Butterworth spectrum (q = 1; Dryden's has m = 2); what is steeper is an edge."""

POWERS: Final = (0.2, 90.0)
"""Least and largest power q of a Matern spectrum (m = 2; von Karman's has q = 5/6); the largest is a Gauss curve."""

BEGINNINGS: Final = (((2.0, 1.0), (4.0, 1.0), (8.0, 1.0)), ((2.0, 1.0), (2.0, 6.0), (2.0, 20.0)))
"""Pairs of m and q that are tried to begin with: Butterworth's and Matern's."""

CORNERS: Final = 16
"""Corners that are tried to begin with."""

COARSE: Final = 128
"""Averages over which the beginnings are compared; half of them are the lowest, where a roll-off may begin."""

FEW_STEPS: Final = 12
"""Steps of each beginning over these at most."""

FIRST_ENOUGH: Final = 0.1
"""Gain in log-likelihood expected of a step over these below which it is not taken."""

BEHIND: Final = 60.0
"""Logarithm of the likelihood by which a spectrum that is best over these may be behind another and yet come to be
likelier. Of 2,498 spectra none that was 30 behind came nearer than 24; the steps over all averages brought 0.43 of the
distance at most."""

STEPS: Final = 40
"""Steps over all averages at most."""

ENOUGH: Final = 1e-4
"""The same over all averages."""

LONGEST_STEP: Final = 1.5
"""Change of a logarithm in one step at most."""

DAMPING: Final = 1e-3
"""Damping of the first step, over the information; a tenth of it after a step that gains, else ten times it."""

FAR_BEYOND: Final = 40.0
"""Logarithm of (f / corner)^m from which on 1 + (f / corner)^m is that power, in double precision."""

BUTTERWORTH, MATERN = range(2)
"""Kinds of spectra, in the order of `BEGINNINGS`."""

LEVEL, HALF, EXPONENT, POWER, NOISE = range(5)
"""Places of the logarithms of level, frequency of half that level, m, q and noise in a point.

With the corner in its place a Gauss curve is a valley: corner and q grow together without end.
"""


UNSEEN_LEVEL: Final = 1e3
"""Largest level over the largest density that the record shows: below its first ordinate a slow tone would let it rise
without end, to a force that no draw of a Monte Carlo can have."""


def _averages_of(periodogram: Periodogram, *, most: int) -> AveragedReading:
    """The averages of a periodogram, or so many that hold them."""
    weight = periodogram.weight
    rows = np.stack(
        [
            periodogram.frequency,
            periodogram.folded_frequency,
            periodogram.gain,
            periodogram.folded_gain,
            periodogram.background(0.0),
            periodogram.density,
        ]
    )
    if weight.size > most:
        first = np.concatenate([np.arange(most // 2), np.linspace(most // 2, weight.size, most // 2 + 1)[:-1]])
        first = first.astype(np.int64)
        rows = np.add.reduceat(rows * weight, first, axis=1)
        weight = np.add.reduceat(weight, first)
        rows = rows / weight
    return AveragedReading(np.log(rows[:2]), rows[2:4], rows[4], rows[5], weight)


def _costs(reading: AveragedReading, points: Array) -> Array:
    """Less the logarithm of Whittle's likelihood of points (b, 5), shape (b,)."""
    level, half, exponent, power = (points[:, place, None, None] for place in range(4))
    bend = np.exp(exponent) * (reading.frequency - half) + np.log(np.expm1(np.log(2.0) / np.exp(power)))
    # log(1 + exp(bend)), and bend where that is the same; NumPy's own takes ten times as long
    fall = np.where(bend > FAR_BEYOND, bend, np.log1p(np.exp(np.minimum(bend, FAR_BEYOND))))
    felt = reading.gain * np.exp(np.maximum(level - np.exp(power) * fall, -600.0))
    model = felt.sum(axis=1) + reading.background + np.exp(points[:, NOISE, None])
    return np.asarray((np.log(model) + reading.density / model) @ reading.weight)


def _beginnings(reading: AveragedReading, noise: float) -> Array:
    """Points to begin from with a noise: for each pair of m and q the best of some corners, (pairs, 5)."""
    raw = np.maximum(reading.density - reading.background - noise, 0.0) / reading.gain[0]
    below = np.cumsum(raw * reading.weight) / np.cumsum(reading.weight)
    frequency = np.exp(reading.frequency[0])
    halves = np.geomspace(frequency[0], frequency[-1], CORNERS)
    last = np.searchsorted(frequency, np.maximum(halves, frequency[min(3, frequency.size - 1)]), side="right") - 1
    pairs = np.array([pair for pairs in BEGINNINGS for pair in pairs])
    points = np.empty((pairs.shape[0], CORNERS, 5))
    points[:, :, LEVEL] = np.log(np.maximum(below[last], 1e-200))
    points[:, :, HALF] = np.log(halves)
    points[:, :, [EXPONENT, POWER]] = np.log(pairs)[:, None]
    points[:, :, NOISE] = np.log(noise)
    cost = _costs(reading, points.reshape(-1, 5)).reshape(points.shape[:2])
    return np.asarray(points[np.arange(pairs.shape[0]), np.argmin(cost, axis=1)])


def fit_roll_offs(
    periodogram: Periodogram, noises: Sequence[float], *, floor: float | None, beside: float = -np.inf
) -> list[tuple[Spectrum, float]]:
    """The most likely Butterworth and Matern spectra, each with the density of its noise [N^2/Hz].

    One that is far behind another spectrum when it has come to its best over coarse averages is left out.

    Parameters
    ----------
    periodogram
        Of the reading.
    noises
        Densities of the noise to begin with [N^2/Hz].
    floor
        Least density of the noise [N^2/Hz]; None when it is known, and the one to begin with is kept.
    beside
        Logarithm of the likelihood of the other spectrum [1].
    """
    whole, coarse = (_averages_of(periodogram, most=most) for most in (periodogram.weight.size, COARSE))
    limits = _limits(periodogram, floor)
    points = np.concatenate([_beginnings(coarse, noise) for noise in noises])
    kinds = np.tile(np.repeat([BUTTERWORTH, MATERN], [len(pairs) for pairs in BEGINNINGS]), len(noises))
    free = _free(np.array([BUTTERWORTH, MATERN]), floor)
    points, cost = _lowered(points, coarse, free[kinds], limits, most=FEW_STEPS, enough=FIRST_ENOUGH)
    best = np.array([np.flatnonzero(kinds == kind)[np.argmin(cost[kinds == kind])] for kind in (BUTTERWORTH, MATERN)])
    points, cost = _lowered(points[best], whole, free, limits, most=0, enough=ENOUGH)
    near = -cost > beside - BEHIND
    points, _ = _lowered(points[near], whole, free[near], limits, most=STEPS, enough=ENOUGH)
    return [_spectrum_of(point) for point in points]


def refit_roll_off(
    periodogram: Periodogram, start: Spectrum, noise: float, *, floor: float | None
) -> tuple[Spectrum, float]:
    """The most likely spectrum of the kind of another, found from that, with the density of its noise [N^2/Hz].

    Parameters
    ----------
    periodogram, floor
        As for `fit_roll_offs`.
    start, noise
        The other, and the density of its noise [N^2/Hz].
    """
    if start.roll_off is None:
        raise ValueError("the spectrum to begin with has no roll-off: only one of `fit_roll_offs` can be fitted again")
    corner, exponent, power = start.roll_off
    half = corner * np.expm1(np.log(2.0) / power) ** (1 / exponent)
    point = np.log([[float(start.levels[0]), half, exponent, power, noise]])
    limits = _limits(periodogram, floor)
    free = _free(np.array([BUTTERWORTH if power == 1 else MATERN]), floor)
    whole = _averages_of(periodogram, most=periodogram.weight.size)
    points, _ = _lowered(np.clip(point, *limits), whole, free, limits, most=STEPS, enough=FIRST_ENOUGH)
    return _spectrum_of(points[0])


def _limits(periodogram: Periodogram, floor: float | None) -> Array:
    """Least and largest values that a point may have, shape (2, 5)."""
    lowest, highest = float(periodogram.frequency[0]), float(periodogram.frequency[-1])
    least = max(floor or 0.0, 1e-200)
    shown = float(np.max(periodogram.density / periodogram.gain))
    most = min(np.log(UNSEEN_LEVEL * shown), 500.0) if shown > 0 else 500.0
    return np.array(
        [[-500.0, np.log(0.1 * lowest), *np.log([EXPONENTS[0], POWERS[0], least])],
         [most, np.log(30 * highest), *np.log([EXPONENTS[1], POWERS[1], 1e200])]]
    )  # fmt: skip


def _free(kinds: NDArray[np.int64], floor: float | None) -> NDArray[np.bool_]:
    """Which numbers of points of these kinds are to be found, shape (kinds, 5)."""
    free = np.ones((kinds.size, 5), dtype=np.bool_)
    free[kinds == BUTTERWORTH, POWER] = False
    free[kinds == MATERN, EXPONENT] = False
    free[:, NOISE] = floor is not None
    return free


def _spectrum_of(point: Array) -> tuple[Spectrum, float]:
    level, half, exponent, power, noise = np.exp(point)
    corner = half * np.expm1(np.log(2.0) / power) ** (-1 / exponent)
    roll_off = (float(corner), float(exponent), float(power))
    return Spectrum(np.array([np.inf]), np.array([level]), roll_off), float(noise)


def _lowered(
    points: Array, reading: AveragedReading, free: NDArray[np.bool_], limits: Array, *, most: int, enough: float
) -> tuple[Array, Array]:
    """Points (b, 5) of least cost from others, each by itself, and those costs (b,), in so many steps at most."""
    points, found = np.array(points), np.empty(points.shape[0])
    lower, upper = np.ascontiguousarray(limits)
    search = Search(lower, upper, most, enough, LONGEST_STEP, DAMPING)
    lower_roll_offs(points, found, free, reading, search)
    return points, found
