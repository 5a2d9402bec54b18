"""Samples that were taken at uneven instants, put on a steady clock; and whether it was the samples that were uneven.

A time column that jitters says one of two things: that the samples were taken unevenly, or that they were taken evenly
and stamped unevenly. The readings tell which: a sample taken late lies on the signal's slope, by the slope times the
time that it is late (`following`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array

from aerobalance.recording.channel import Array

_TAPS: Final = 8
_FINE: Final = 24
_WINDOW: Final = 8.0
_PENALTIES: Final = tuple(weight / 256**2 for weight in (0.1, 1.0, 10.0, 100.0, 1e3))
"""Weights of the fourth differences, which at half the sampling rate are 256 times as large as what they are of."""

_PIECE: Final = 16384
_MARGIN: Final = 64
_MEASURED: Final = 32768
_FAST: Final = 9
_TELLING: Final = 0.02
_REACH: Final = 0.8
_GAP: Final = 2.5
_NEAR: Final = 0.1
_MISSED_ALLOWED: Final = 0.2


class JitterCorrection(NamedTuple):
    """By how much of the jitter of their stamps readings are shifted: 1 where the samples jitter, 0 where the stamps.

    Attributes
    ----------
    share
        Estimate [1].
    u
        Standard uncertainty [1]; infinite where the readings do not tell.
    """

    share: float
    u: float


class Resampled(NamedTuple):
    """Readings on the steady clock.

    Attributes
    ----------
    values
        Readings, shape (n,) each; NaN where no reading is near.
    errors
        Standard deviation of what the interpolation does to a signal of this spectrum, channel by channel.
    noise_gains
        Factor by which it changes the standard deviation of white noise [1], channel by channel.
    """

    values: list[Array]
    errors: list[float]
    noise_gains: list[float]


def following(columns: Sequence[Array], late: Array) -> JitterCorrection:
    """Find out whether readings follow the jitter of their stamps.

    Parameters
    ----------
    columns
        Readings, shape (m,) each; NaN where missing.
    late
        Time by which each sample is later than the steady clock has it, shape (m,) [intervals].
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - takes 30 ms, and few records need it

    weight = total = 0.0
    # A clock that wanders slowly moves a signal and its slope alike, which tells nothing: the fast part does.
    fast = late - uniform_filter1d(late, _FAST)
    if late.size < 16 or np.std(fast) < _TELLING:
        return JitterCorrection(0.5, np.inf)
    for values in columns:
        slope = np.full(late.size, np.nan)
        slope[2:-2] = (8 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / 12
        seen, expected = _beside_neighbours(values), _beside_neighbours(slope * fast)
        known = np.isfinite(seen) & np.isfinite(expected)
        # by a power of two, which changes no digit: the fourth power of a number that a damaged file holds is none
        scale = 0.5 ** int(np.frexp(np.abs(expected[known]).max(initial=0.0))[1])
        seen, expected = scale * seen[known], scale * expected[known]
        power = float(expected @ expected)
        # White noise alone has 130 / 144 of its variance in the slope, and 70 / 36 beside the neighbours: where it may
        # be half of the slope, the slope is not that of the signal.
        if known.sum() < 100 or power == 0 or np.nanvar(scale * slope) < 0.93 * np.var(seen):
            continue
        share = float(expected @ seen) / power
        # readings that are off are off in their neighbours' differences as well, so that scatter counts twice
        variance = 2 * float(((seen - share * expected) ** 2) @ expected**2) / power**2 + 1e-6
        weight += 1 / variance
        total += share / variance
    return JitterCorrection(total / weight, weight**-0.5) if weight else JitterCorrection(0.5, np.inf)


def _beside_neighbours(values: Array) -> Array:
    """Readings less a cubic through the two neighbours on either side, shape (m - 4,)."""
    found: Array = values[2:-2] - (4 * (values[1:-3] + values[3:-1]) - values[:-4] - values[4:]) / 6
    return found


def on_steady_clock(columns: Sequence[Array], places: Array, samples: int) -> Resampled | None:
    """Put readings on a steady clock: the smoothest band-limited signal that explains them.

    Parameters
    ----------
    columns
        Readings, shape (m,) each; NaN where missing.
    places
        When they were taken, shape (m,), increasing [intervals after the first sample of the steady clock].
    samples
        Number of samples of the steady clock, n.

    Returns
    -------
    Resampled
        None where more than a fifth of the samples have no reading near.
    """
    if np.count_nonzero(_no_reading(places, samples)) > _MISSED_ALLOWED * samples:
        return None
    # The same noise in every run; what it becomes is a property of the instants alone.
    probe = np.random.default_rng(0).normal(size=places.size)
    found, errors, gains = [], [], []
    for values in columns:
        known = np.isfinite(values)
        if not known.any():
            found.append(np.full(samples, np.nan))
            errors.append(0.0)
            gains.append(1.0)
            continue
        at, mean = places[known], float(values[known].mean())
        penalty = _penalty(values[known] - mean, at, probe[known])
        once = _solved(values[known] - mean, at, samples, penalty)
        gap = _no_reading(at, samples)
        error, gain = _what_is_left(once, at, probe[known], penalty, ~gap)
        errors.append(error)
        gains.append(gain)
        found.append(np.where(gap, np.nan, once + mean))
    return Resampled(found, errors, gains)


def _what_is_left(
    signal: Array, places: Array, probe: Array, penalty: float, used: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return what another interpolation does to a known signal and to white noise, from the first samples."""
    samples = min(signal.size, _MEASURED)
    near, used = places < samples, used[:samples].copy()
    if samples < signal.size:
        used[-_MARGIN:] = False  # the readings that follow would hold these
    signal, places = signal[:samples], places[near]
    again = _solved(_kernel(places, samples, _FINE) @ signal, places, samples, penalty)
    noise = _solved(probe[near], places, samples, penalty)
    return float(np.std((again - signal)[used])), float(np.std(noise[used]) / np.std(probe[near]))


def _penalty(values: Array, places: Array, probe: Array) -> float:
    """Choose the weight of the fourth differences by generalised cross-validation, in the middle of the record.

    P. Craven, G. Wahba, Numer. Math. 31 (1978) 377; the trace by M. F. Hutchinson, Commun. Stat. 18 (1989) 1059.
    """
    middle = places.size // 2
    near = slice(max(0, middle - _PIECE // 4), middle + _PIECE // 4)
    at = places[near] - np.floor(places[near][0]) + _MARGIN
    samples = int(at[-1]) + _MARGIN + 1
    model = _kernel(at, samples, _TAPS)
    scores = []
    for penalty in _PENALTIES:
        left = values[near] - model @ _least_squares(model, values[near], penalty)
        freedom = probe[near] @ (probe[near] - model @ _least_squares(model, probe[near], penalty))
        scores.append(float(left @ left) / max(float(freedom) / at.size, 1e-9) ** 2)
    return _PENALTIES[int(np.argmin(scores))]


def _no_reading(places: Array, samples: int) -> NDArray[np.bool_]:
    """Whether a sample of the steady clock has no reading near, or is at the edge of a gap, shape (n,)."""
    grid = np.arange(samples)
    after = np.clip(np.searchsorted(places, grid), 1, places.size - 1)
    before, behind = grid - places[after - 1], places[after] - grid
    away = np.minimum(np.abs(before), np.abs(behind))
    found: NDArray[np.bool_] = (away > _REACH) | ((before + behind > _GAP) & (away > _NEAR))
    return found


def _solved(values: Array, places: Array, samples: int, penalty: float) -> Array:
    """Solve piece by piece, so that memory does not grow with the record, shape (n,)."""
    found = np.empty(samples)
    for first in range(0, samples, _PIECE):
        last = min(first + _PIECE, samples)
        begin, end = first - _MARGIN, last + _MARGIN
        near = slice(*np.searchsorted(places, (begin + _TAPS, end - _TAPS)))
        model = _kernel(places[near] - begin, end - begin, _TAPS)
        found[first:last] = _least_squares(model, values[near], penalty)[first - begin : last - begin]
    return found


def _least_squares(model: csr_array, values: Array, penalty: float) -> Array:
    """Minimise the residuals of the readings and, more weakly, the fourth differences, shape (n,)."""
    samples = model.shape[1]
    normal = (model.T @ model).tocsr()
    band = np.zeros((2 * _TAPS, samples))
    for k in range(2 * _TAPS):
        band[-1 - k, k:] = normal.diagonal(k)
    rough = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    for k in range(5):
        # the sum of products of coefficients k apart, less what the ends lack
        for j in range(5 - k):
            band[-1 - k, j + k : samples - 4 + j + k] += penalty * rough[j] * rough[j + k]
    solved: Array = solveh_banded(band, model.T @ values, check_finite=False)
    return solved


def _kernel(places: Array, samples: int, taps: int) -> csr_array:
    """Make the matrix that gives a band-limited signal at other instants than its samples', shape (m, n).

    Instants within `taps` of either end of the clock are given by the taps that there are.
    """
    first = np.floor(places).astype(np.intp) - taps + 1
    columns = first[:, None] + np.arange(2 * taps)
    away = places[:, None] - columns
    inside = (columns >= 0) & (columns < samples)
    window = np.i0(_WINDOW * np.sqrt(np.clip(1 - (away / taps) ** 2, 0, None))) / np.i0(_WINDOW)
    weights = np.where(inside, np.sinc(away) * window, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    starts = np.arange(0, columns.size + 1, 2 * taps)
    kept: NDArray[np.intp] = np.clip(columns, 0, samples - 1)
    return csr_array((weights.ravel(), kept.ravel(), starts), shape=(places.size, samples))
