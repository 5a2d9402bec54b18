"""Averaged spectra, and sums of series through filters, by the Fourier transform.

``scipy.signal`` has the same, but loading it takes a second, as it loads ``scipy.stats``; a test compares the two.

References
----------
.. [Welch1967] P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE Trans. Audio
   Electroacoust. 15 (1967) 70.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from aerobalance.recording.channel import Array

_BLOCKS: Final = 4
"""Length of the blocks in which series are convolved, over that of the filters."""

_SHORTEST: Final = 1 << 14
"""Shortest of these blocks."""

HANN_ORDINATES: Final = 18 / 35
"""Ordinates whose power is independent, over those of a Hann window: neighbours correlate by 2/3, the next by 1/6,
their powers by the squares of it, and 1 + 2 (4/9 + 1/36) = 35/18."""

_KEPT: Final = 1 << 16
"""Longest window that is kept for the next time."""


def hann(count: int) -> Array:
    """Hann window of a period of so many samples, shape (count,) [1]; not to be written to."""
    return _kept_hann(count) if count <= _KEPT else _hann(count)


def _hann(count: int) -> Array:
    return np.asarray(np.hanning(count + 1)[:-1], dtype=np.float64)


@lru_cache(maxsize=16)
def _kept_hann(count: int) -> Array:
    """The same, kept: all that is asked of a part of a record asks for windows of a few lengths."""
    window = _hann(count)
    window.setflags(write=False)
    return window


def tapered(count: int, share: float) -> Array:
    """Window that rises and falls like a half sine over a share of a record, and is 1 between, shape (count,) [1]."""
    rise = np.clip(np.arange(count) / (share * (count - 1) / 2), 0.0, 1.0)
    return np.asarray((1 - np.cos(np.pi * np.minimum(rise, rise[::-1]))) / 2)


def without_line(values: Array) -> Array:
    """Series less the straight line that fits it best, along the last axis, shape (..., n)."""
    line = np.arange(values.shape[-1]) - (values.shape[-1] - 1) / 2
    level = values - values.mean(axis=-1, keepdims=True)
    return np.asarray(level - (level @ line)[..., None] * line / (line @ line))


def averaged_spectrum(
    values: Array,
    *,
    rate: float,
    length: int,
    other: Array | Sequence[Array] | None = None,
    less: Literal["mean", "line"] = "mean",
) -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies [Hz] and one-sided spectral density of a series [its unit squared over Hz], by [Welch1967]_.

    Segments under a Hann window, which overlap by half. Series in single precision are transformed in it.

    Parameters
    ----------
    values
        Shape (n,), without gaps.
    rate
        Sampling rate [Hz].
    length
        Samples of a segment, at most n.
    other
        Another series of shape (n,), or k of them; the cross-spectral densities are returned then.
    less
        What is taken off each segment.

    Returns
    -------
    frequency, density
        Shape (length / 2 + 1,) each, or (k, length / 2 + 1) of several densities.
    """
    window = hann(length)

    def spectra(series: Array) -> NDArray[np.complex128]:
        segments = sliding_window_view(series, length)[:: length - length // 2]
        level = segments - segments.mean(axis=1, keepdims=True) if less == "mean" else without_line(segments)
        return np.asarray(rfft(level * window.astype(level.dtype, copy=False)))

    own = spectra(values)
    several = not (other is None or (isinstance(other, np.ndarray) and other.ndim == 1))
    others = other if several and other is not None else [values if other is None else other]
    turned, density = own.conj(), np.empty((len(others), own.shape[1]), dtype=np.complex128)
    singly = turned.astype(np.complex64) if any(np.asarray(one).dtype == np.float32 for one in others) else turned
    for place, one in enumerate(others):  # one after the other, as each has many segments
        theirs = own if one is values else spectra(np.asarray(one))
        density[place] = np.einsum("sf,sf->f", singly if theirs.dtype == np.complex64 else turned, theirs)
    density /= rate * np.sum(window**2) * len(own)
    density[:, 1 : -1 if length % 2 == 0 else None] *= 2
    frequency = np.asarray(np.arange(density.shape[1]) * (rate / length), dtype=np.float64)
    return frequency, np.asarray(density if several else density[0], dtype=np.complex128)


def convolve(series: Array, weights: Array) -> Array:
    """Convolution of series, shape (n, c), with filters, shape (m, c), column by column; shape (n + m - 1, c).

    In blocks of a few lengths of the filters, whose ends overlap and are added: of 1.5 million samples that takes a
    quarter of the time of one transform of the whole, and little room.
    """
    n, m = series.shape[0], weights.shape[0]
    size = next_fast_len(min(n + m - 1, max(_BLOCKS * m, _SHORTEST)), real=True)
    step = size - m + 1
    answer = rfft(weights.T, size)
    whole = np.zeros((series.shape[1], -(-n // step) * step + m - 1))
    for first in range(0, n, step):
        part = np.ascontiguousarray(series[first : first + step].T)
        whole[:, first : first + size] += irfft(rfft(part, size) * answer, size)
    return np.ascontiguousarray(whole[:, : n + m - 1].T)
