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
from scipy.special import chdtri

from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import BAND_NOISE, ROLL_OFF, band_limited_weights, is_short_gap
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


def short_gaps_filled(values: Array, factor: int) -> Array:
    """Return readings with their short gaps filled, shape (n,); the others are left.

    Parameters
    ----------
    values
        Readings, band-limited to what decimation by the factor keeps, and white noise, shape (n,); NaN where missing.
    factor
        Factor by which they are to be decimated.
    """
    missing = np.isnan(values)
    gaps = [(first, last) for first, last in gaps_in(missing) if is_short_gap(last - first, factor)]
    known = values[~missing]
    if not gaps or known.size < 2 * SETTINGS.reach * factor:
        return values
    noise = np.hypot(white_noise(values), SETTINGS.exact * float(known.std()))
    filled, reach = values.copy(), SETTINGS.reach * factor
    for first, last in gaps:
        window = slice(max(first - reach, 0), last + reach)
        present = ~missing[window]
        if np.count_nonzero(present) < reach:
            continue
        own = values[window][present]
        level = float(own.mean())
        weights, departures = _across(present.tobytes(), first - window.start, last - window.start, factor)
        departure = departures @ (own - level)
        unlikely = chdtri(departure.size, SETTINGS.chance) * noise**2
        if float(np.max(np.sum(weights**2, axis=1))) <= SETTINGS.noise_gain and departure @ departure <= unlikely:
            filled[first:last] = level + weights @ (own - level)
    return filled


@lru_cache(maxsize=32)  # gaps of one length in the middle of a record have the same
def _across(present: bytes, first: int, last: int, factor: int) -> tuple[Array, Array]:
    """Weights of the readings about a gap in what is missing, and in departures of those beside it from the others.

    The departures are independent and have the variance of a reading's noise.
    """
    own = np.flatnonzero(np.frombuffer(present, dtype=np.bool_))
    band = (1 - ROLL_OFF) / (2 * factor)
    weights = band_limited_weights(np.arange(first, last), own, band=band, noise=BAND_NOISE)
    width = max(int(SETTINGS.beside * factor), 1)
    beside = (own >= first - width) & (own < last + width)
    others = band_limited_weights(own[beside], own[~beside], band=band, noise=BAND_NOISE)
    departures = np.zeros((len(others), own.size))
    departures[:, beside], departures[:, ~beside] = np.eye(len(others)), -others
    return weights, np.linalg.solve(np.linalg.cholesky(departures @ departures.T), departures)
