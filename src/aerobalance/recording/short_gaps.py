"""Short gaps in readings that are sampled much faster than they change: filled from the readings on either side.

A series that is band-limited far below its Nyquist frequency is known between its samples, and across a gap of a few
of them nearly as well: what the best linear estimate puts there has less noise than the readings that are missing.
Where the readings beside a gap are not as the others say, something happens there that is faster than the band, as a
blow: nothing is filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import BAND_NOISE, ROLL_OFF, alike_in_gaps, is_short_gap
from aerobalance.recording.linalg import conditional_weights
from aerobalance.recording.noise import white_noise
from aerobalance.recording.resampling import gaps_in


@dataclass(frozen=True, slots=True)
class ShortGapSettings:
    """Which gaps are filled.

    Attributes
    ----------
    reach
        Distance on either side from which readings are used [samples of the slower clock]: the error is 2e-5 of the
        load's rms.
    beside
        Distance on either side of a gap within which readings must be as the others say, in the same unit.
    chance
        Probability that readings with noise alone are taken not to be.
    exact
        Error of what the others say, over the standard deviation of the series, beside its noise [1].
    noise_gain
        Largest variance of a filled reading by noise, over that of a reading [1].
    """

    reach: int = 12
    beside: float = 0.5
    chance: float = 1e-9
    exact: float = 1e-4
    noise_gain: float = 1.0


SETTINGS: Final = ShortGapSettings()
"""Settings that are used."""


def short_gaps_filled(table: Array, factor: int) -> Array:
    """Return readings of c channels with their short gaps filled, shape (n, c); the others are left.

    Parameters
    ----------
    table
        Readings, band-limited to what decimation by the factor keeps, and white noise, (n, c); NaN where missing.
    factor
        Factor by which they are to be decimated.
    """
    filled = table.copy()
    for columns, missing in alike_in_gaps(table):
        gaps = [(first, last) for first, last in gaps_in(missing) if is_short_gap(last - first, factor)]
        known = table[~missing][:, columns]
        if not gaps or len(known) < 2 * SETTINGS.reach * factor:
            continue
        noise = np.array([white_noise(one) for one in known.T])
        noise = np.hypot(noise, SETTINGS.exact * known.std(axis=0))
        for gap in gaps:
            _fill(filled, table, columns, missing=missing, gap=gap, factor=factor, noise=noise)
    return filled


def _fill(
    filled: Array,
    table: Array,
    columns: NDArray[np.intp],
    *,
    missing: NDArray[np.bool_],
    gap: tuple[int, int],
    factor: int,
    noise: Array,
) -> None:
    """Fill one gap of columns that have all their gaps in common, in place, where nothing fast happened."""
    first, last = gap
    reach = SETTINGS.reach * factor
    window = slice(max(first - reach, 0), last + reach)
    present = ~missing[window]
    if np.count_nonzero(present) < reach:
        return
    own = table[window][np.ix_(present, columns)]
    level = own.mean(axis=0)
    own -= level
    weights, departures = _across(present, slice(first - window.start, last - window.start), factor)
    if float(np.max(np.sum(weights**2, axis=1))) > SETTINGS.noise_gain:
        return
    departed = departures @ own
    whitened = np.linalg.solve(departures @ departures.T, departed)
    usual = np.sum(departed * whitened, axis=0) <= chdtri(len(departures), SETTINGS.chance) * noise**2
    filled[first:last, columns[usual]] = (level + weights @ own)[:, usual]


def _across(present: NDArray[np.bool_], gap: slice, factor: int) -> tuple[Array, Array]:
    """Weights of the readings about a gap in what is missing, and in departures of those beside it from the others.

    Both are for readings whose noise is white.

    Parameters
    ----------
    present
        Which samples of a window about the gap there are, shape (n,).
    gap
        Samples of the gap.
    factor
        Factor by which the readings are to be decimated.
    """
    inverse = _inverse_covariance(present.size, factor)
    missing = ~present
    own = np.zeros(present.size, dtype=np.bool_)
    own[gap] = True
    weights = conditional_weights(inverse, missing, present)[own[missing]]
    width = max(int(SETTINGS.beside * factor), 1)
    near = np.zeros(present.size, dtype=np.bool_)
    near[max(gap.start - width, 0) : gap.stop + width] = True
    beside, unused, others = present & near, missing | near, present & ~near
    departures = np.zeros((np.count_nonzero(beside), present.size))
    departures[:, beside] = np.eye(len(departures))
    departures[:, others] = -conditional_weights(inverse, unused, others)[beside[unused]]
    return weights, departures[:, present]


@lru_cache(maxsize=8)  # the windows of all gaps but those near an end have few sizes
def _inverse_covariance(count: int, factor: int) -> Array:
    """Inverse of the covariance of samples of a series that fills the band, with noise, shape (count, count) [1]."""
    twice = (1 - ROLL_OFF) / factor  # the band over half the sampling rate
    covariance = twice * np.sinc(twice * np.arange(count))
    samples = np.arange(count)
    return np.asarray(np.linalg.inv(covariance[np.abs(samples[:, None] - samples)] + BAND_NOISE * np.eye(count)))
