"""Windows of periodograms: the density of readings at their ordinates, and what a window leaks beyond an edge."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from aerobalance.recording.channel import Array

LONGEST: Final = 1 << 17
"""Samples of one periodogram; a longer record is averaged over parts of this length."""

INSIDE: Final = slice(2, -1)
"""Ordinates that are looked at: what was taken away as a constant is missing in the first ones; the last is real."""

HANN_BANDWIDTH: Final = 1.94
"""Ordinates of a Hann periodogram that are as good as one independent ordinate."""

HANN_WIDTH: Final = 2.0
"""Ordinates that a Hann window smears a line over."""

TAPERED: Final = 0.01
"""Share of a record at either end that an even window tapers: beyond 100 ordinates it leaks as a Hann window does."""

LOBES: Final = 256
"""Ordinates on either side of an edge up to which the window leaks at all."""


def length_of(samples: int) -> int:
    """Samples of each periodogram of a record of so many."""
    return min(samples, LONGEST)


def leaked(distance: Array) -> Array:
    """Share of a Hann window's power that lies above an edge, at a distance above it in ordinates."""
    return np.asarray(np.interp(distance, _LOBE_PLACE, _LOBE_SHARE))


def leaked_from(power: Array, *, even: bool = False) -> Array:
    """Mean of what the window leaks from power at ordinates to those beyond its main lobe, of their shape (n,).

    Parameters
    ----------
    power
        At ordinates of the same distance, shape (n,); lines may lie anywhere between them.
    even
        Whether the window is an even one, and no Hann window.
    """
    away = np.arange(-LOBES, LOBES + 1, dtype=np.float64)
    far = np.abs(away) >= HANN_WIDTH
    shares, at = np.zeros(away.size), np.pi * away[far]
    # side lobes of a line half way between two ordinates on average, over the sum of all its lobes
    shares[far] = 0.5 / at**2 if even else 0.5 / (at * (away[far] ** 2 - 1)) ** 2 / 1.5
    return np.asarray(np.convolve(power, shares)[LOBES : LOBES + power.size])


def _lobe() -> tuple[Array, Array]:
    place = np.linspace(-LOBES, LOBES, 2 * LOBES * 64 + 1)
    power = (np.sinc(place) + 0.5 * np.sinc(place - 1) + 0.5 * np.sinc(place + 1)) ** 2
    share = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2)])
    return place, share / share[-1]


_LOBE_PLACE, _LOBE_SHARE = _lobe()


def density_of(values: Array, interval: float, *, even: bool = False) -> Array:
    """Two-sided power spectral density of readings at all ordinates of their periodogram, shape (m,) [N^2/Hz].

    Parameters
    ----------
    values
        Readings without gaps, known shapes taken out, shape (n,) [N].
    interval
        Time between samples [s].
    even
        Whether all of a part weighs alike but for `TAPERED` at its ends, as where the load is another there than in
        its middle; else a Hann window weighs it.
    """
    parts, window = _parts(values), (_even_window if even else _window)(length_of(values.size))
    density = np.zeros(window.size // 2 + 1)[INSIDE]
    for part in parts:
        found = rfft(part * window)[INSIDE]
        density += found.real**2 + found.imag**2
    density *= interval / (float(np.sum(window**2)) * len(parts))
    return density


@lru_cache(maxsize=4)
def _window(length: int) -> Array:
    """Hann window, shape (length,) [1]."""
    return np.asarray(np.hanning(length + 2)[1:-1])


@lru_cache(maxsize=4)
def _even_window(length: int) -> Array:
    """Window that is 1 but for cosine tapers at its ends, shape (length,) [1]."""
    from_end = np.minimum(np.arange(1, length + 1), np.arange(length, 0, -1)) / (TAPERED * length)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(from_end, 1.0)))


def share_seen(present: NDArray[np.bool_]) -> float:
    """Share of the readings that a periodogram sees, weighted as its windows weight them."""
    return 1.0 if present.all() else share_of(present.astype(np.float64))


def share_of(shares: Array) -> float:
    """Share of a record of which a share of each sample is seen, shape (n,), weighted as its windows weight them."""
    parts = _parts(shares)
    weights = _window(parts[0].size) ** 2
    return float(np.mean([part @ weights for part in parts]) / np.sum(weights))


def _parts(values: Array) -> list[Array]:
    """Parts of a record of which one periodogram is taken each, half of each or more in the next, from end to end."""
    length = length_of(values.size)
    number = -(-(values.size - length) // max(length // 2, 1)) + 1
    return [values[k : k + length] for k in np.linspace(0, values.size - length, number).astype(int)]
