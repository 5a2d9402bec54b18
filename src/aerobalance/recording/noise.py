"""How noisy a channel is, judged from its own record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.fft import rfft
from scipy.special import ndtri

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.fourier import averaged_spectrum

BANDS: Final = 32
"""Bands of equal width between zero and the Nyquist frequency in which the level is looked at."""

QUIET_SHARE: Final = 0.25
"""Share of the bands that may lie under the noise, where an anti-alias filter has taken it away."""

CLEARLY_LOWER: Final = 0.7
"""Ratio of the two estimates of the noise below which it is no chance of sampling."""

SOME: Final = 1 << 12
"""Third differences by which is asked first whether they are: their median scatters by two per cent."""

NOT_LOWER: Final = 0.8
"""Ratio of these from which on they are not."""

ROUNDING: Final = 1e-9
"""Least noise over the largest reading: what is smaller than that is rounding."""

ENOUGH: Final = 1 << 15
"""Readings, in the middle of a longer record, from which its noise is judged: they tell it to one percent."""

ORDER: Final = 4
"""Order of the differences by which the correlation of two channels' noise is judged."""

STANDS_OUT: Final = 9.0 * 1.4826
"""Difference over the median of their magnitudes above which it is no noise: nine standard deviations."""

FEW: Final = 0.1
"""Share of such differences, with those beside them, up to which they are left out."""

FEWEST: Final = 64
"""Readings below which the correlation of two channels' noise cannot be told."""

MOST_VALUES: Final = 4096
"""Different readings up to which it is looked whether they are steps of a converter."""

EXACT: Final = 1e-6
"""Departure from whole steps, over a step, that is rounding."""


def white_noise(values: Array) -> float:
    """Standard deviation of the white noise of a channel [unit of the channel].

    The level of the quiet bands of its spectrum: the lower quartile over bands, so that the signal may fill up to
    three quarters of the bandwidth and a filter may empty up to a quarter of it. A record of a few jumps has no quiet
    band; where the median third difference, which does not see them, is clearly lower, it is taken instead.

    Parameters
    ----------
    values
        Readings, shape (n,), at least 8; NaN where missing.
    """
    known = np.isfinite(values)
    present = _middle(values if known.all() else values[known])
    if present.size < 8:
        raise ValueError(f"noise needs at least 8 readings, not {present.size}")
    length = int(min(present.size, max(64, present.size // 8)))
    _, power = averaged_spectrum(present, rate=1.0, length=length, less="line")
    density = np.real(power)
    inner = density[2:-1] if density.size > 8 else density
    count = min(BANDS, inner.size)
    sizes = inner.size // count + (np.arange(count) < inner.size % count)
    levels = np.sort(np.add.reduceat(inner, np.cumsum(sizes) - sizes) / sizes)
    level = levels[int(QUIET_SHARE * (levels.size - 1))]
    spectral = float(np.sqrt(level / 2))
    # the third difference of white noise has twenty times its variance
    unit = ndtri(0.75) * np.sqrt(20)
    if present.size > SOME and _median_third_difference(present, present.size // SOME) > NOT_LOWER * spectral * unit:
        return spectral
    calm = _median_third_difference(present, 1) / unit
    return calm if 0 < calm < CLEARLY_LOWER * spectral else spectral


def _median_third_difference(values: Array, every: int) -> float:
    """Median size of third differences of readings, of every so many of them."""
    first, second, third, fourth = (values[place : values.size - 3 + place : every] for place in range(4))
    return float(np.median(np.abs(fourth - first - 3 * (third - second))))


def step_of(values: Array) -> float:
    """Step of the converter that readings (n,) come from, in their unit; 0 where none is seen."""
    some = np.unique(values[np.isfinite(values)])
    if not 2 <= some.size <= MOST_VALUES:
        return 0.0
    apart = np.diff(some)
    step = float(apart.min())
    number = apart / step
    rounding = 4 * np.finfo(np.float64).eps * float(np.max(np.abs(some))) / step
    return step if np.all(np.abs(number - np.round(number)) < EXACT * number + rounding) else 0.0


def channel_noise(channel: Channel) -> float:
    """Standard uncertainty of one reading: as given for the channel, or else judged from its record."""
    return channel.noise if channel.noise is not None else white_noise(channel.values)


def noise_covariance(channels: Sequence[Channel], filled: Array) -> Array:
    """Covariance of the noise of one reading of n channels, shape (n, n) [products of their units].

    Parameters
    ----------
    channels
        The channels; their noise is as given, or else judged from the readings.
    filled
        Their readings without gaps, shape (samples, n).
    """
    deviation = np.array(
        [
            max(
                white_noise(column) if channel.noise is None else channel.noise,
                ROUNDING * float(np.max(np.abs(column))),
                1e-60,
            )
            for channel, column in zip(channels, filled.T, strict=True)
        ]
    )
    return np.outer(deviation, deviation) * noise_correlation(filled)


def noise_correlation(filled: Array) -> Array:
    """Correlation of the noise of n channels, shape (n, n) [1]; 0 between two where chance explains it.

    Judged from the upper half of the spectrum, where no load is left. Loads are better for it than gauge outputs: what
    the terms of a balance matrix make of loads reaches high frequencies, and all bridges have a part in it.

    Parameters
    ----------
    filled
        Readings without gaps, shape (samples, n).
    """
    if filled.shape[0] < FEWEST:
        return np.eye(filled.shape[1])
    # along rows, as memory has them, and of a long record of a length that is quick to transform
    changes = _without_wild(np.diff(np.ascontiguousarray(_middle(filled, ENOUGH + ORDER).T), ORDER))
    spectrum = np.asarray(rfft(changes), dtype=np.complex128)
    upper = spectrum[:, spectrum.shape[1] // 2 :]
    power = np.real(upper.conj() @ upper.T)
    size = np.sqrt(np.maximum(np.diag(power), 1e-300))
    correlation: Array = power / np.outer(size, size)
    # between independent channels it scatters by 1 / sqrt(2 m) over m ordinates; one in 1e8 passes this
    correlation[np.abs(correlation) < 4 / np.sqrt(upper.shape[1])] = 0.0
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _without_wild(changes: Array) -> Array:
    """Differences of n channels, shape (n, m), with 0 for those about single readings that stand out, if few.

    One wild reading of a bridge is in all loads: some of them would make the noise of the loads look like one noise.
    """
    size = np.abs(changes)
    largest = size.max(axis=1, keepdims=True, initial=0.0)
    if (2 * np.count_nonzero(STANDS_OUT * size >= largest, axis=1) > size.shape[1]).all():
        return changes  # so many exceed a part of the largest that the median does: it need not be found
    out = (size > STANDS_OUT * np.median(size, axis=1, keepdims=True)).any(axis=0)
    if not out.any():
        return changes
    # next to the largest differences are smaller ones of the same reading
    about = np.convolve(out, np.ones(ORDER + 1), "same") > 0
    return changes if np.mean(about) > FEW else np.where(about, 0.0, changes)


def _middle(values: Array, length: int = ENOUGH) -> Array:
    """Return the middle of a record, where it is longer than is needed to judge its noise."""
    first = max((len(values) - length) // 2, 0)
    return values[first : first + length]
