"""Series on a slower clock and back: a filter that leaves white noise white, then every n-th sample.

The squares of the filter's gain at a frequency and at the one that folds onto it add up to 1 (a root-Nyquist filter),
so that white noise on the fast clock is white on the slow one. Its gain falls off as that of Meyer's wavelet
[Daubechies1992]_, smoothly, so that its response in time is short. Where it would reach beyond an end of the record,
the best linear estimate of a band-limited series from the samples there takes its place.

References
----------
.. [Daubechies1992] I. Daubechies, "Ten Lectures on Wavelets", SIAM (1992), ch. 4.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from aerobalance.recording.channel import Array

ROLL_OFF: Final = 0.35
"""Part of the new Nyquist frequency that the filter takes to fall off, on either side of it."""

SPAN: Final = 24
"""New samples on either side that the filter reaches over: its gain is 1 up to 1 - ROLL_OFF of the new Nyquist
frequency to 1e-6, and beyond 1 + ROLL_OFF it is 1e-5."""

FINE: Final = 64
"""Points of the filter's gain for each sample of its response."""

BAND_NOISE: Final = 1e-8
"""Density of the noise over that of the series within its band, for which the estimate beside an end is the best."""

BETWEEN: Final = 12
"""Samples on either side that a value between samples is made from."""

SHARPNESS: Final = 12.0
"""Parameter of the Kaiser window of that: errors stay below 3e-6 up to 0.6 of the Nyquist frequency."""

CLEAN: Final = 1e-10
"""As `BAND_NOISE`, for values between samples beside an end."""


@cache
def decimation_filter(factor: int, span: int = SPAN) -> Array:
    """Coefficients of the filter by which so many samples become one, shape (2 span factor + 1,), of sum 1.

    Parameters
    ----------
    factor
        Samples that become one.
    span
        New samples on either side that it reaches over: with 8 its gain is 1 to 1e-3.
    """
    half = span * factor
    count = FINE * half
    place = np.clip((2 * factor * np.fft.rfftfreq(count) - (1 - ROLL_OFF)) / (2 * ROLL_OFF), 0.0, 1.0)
    fall = place**4 * (35 - 84 * place + 70 * place**2 - 20 * place**3)
    response = np.fft.irfft(np.cos(0.5 * np.pi * fall), count)
    taps = np.concatenate([response[-half:], response[: half + 1]])
    return np.asarray(taps / taps.sum())


def band_limited_weights(places: Array, count: int, *, band: float, noise: float) -> Array:
    """Weights of the first samples of a series in its values at places among or beside them, shape (m, count).

    The best linear estimate of a series that is white up to a frequency, and nothing beyond, in white noise.

    Parameters
    ----------
    places
        Where the values are wanted, shape (m,), in samples from the first.
    count
        Number of samples that they are made from.
    band
        That frequency over the sampling rate [1].
    noise
        Density of the noise over that of the series [1].
    """
    own = np.arange(count)
    within = 2 * band * np.sinc(2 * band * (own[:, None] - own))
    wanted = 2 * band * np.sinc(2 * band * (own[:, None] - places))
    return np.asarray(np.linalg.solve(within + noise * np.eye(count), wanted).T)


@cache
def _weights_between(factor: int) -> Array:
    """Weights of the 2 BETWEEN samples about a place in the values from the one before it on, (factor, 2 BETWEEN)."""
    distance = np.arange(1 - BETWEEN, BETWEEN + 1) - np.arange(factor)[:, None] / factor
    window = np.i0(SHARPNESS * np.sqrt(np.maximum(1 - (distance / BETWEEN) ** 2, 0.0)))
    weights = np.sinc(distance) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


@dataclass(frozen=True, slots=True)
class Decimation:
    """A record of so many samples on a clock that is slower by a factor, as far from both of its ends.

    Attributes
    ----------
    factor
        Samples that become one.
    samples
        Samples of the record.
    """

    factor: int
    samples: int

    @property
    def count(self) -> int:
        """Samples of the slow clock."""
        return (self.samples - 1) // self.factor + 1

    @property
    def before(self) -> int:
        """Samples of the record before the first of the slow clock; as many, or one more, come after its last one."""
        return (self.samples - 1) % self.factor // 2

    def span(self, begin: int, end: int) -> slice:
        """Samples of the record that those of the slow clock, from one to another (not included), stand for."""
        first = 0 if begin == 0 else self.before + begin * self.factor
        return slice(first, self.samples if end == self.count else self.before + end * self.factor)

    def wanted(self, begin: int, end: int) -> slice:
        """Samples of the record that those of the slow clock, from one to another (not included), are made of."""
        reach, before = 2 * SPAN * self.factor, self.before
        first = max(before + begin * self.factor - reach, 0)
        return slice(first, min(before + (end - 1) * self.factor + reach + 1, self.samples))

    def decimated(self, series: Array, begin: int, end: int) -> Array:
        """Return samples of the slow clock, shape (end - begin, c).

        Parameters
        ----------
        series
            The samples `wanted` of c series without gaps, shape (m, c).
        begin, end
            First sample of the slow clock, and the one after the last.
        """
        own, factor = self.wanted(begin, end), self.factor
        places = self.before + factor * np.arange(begin, end)
        late = (own.start - self.before) % factor  # so that every factor-th sample of the block is one of the clock
        first = (int(places[0]) - own.start + late) // factor
        count = next_fast_len(-(-(series.shape[0] + late) // factor) + SPAN, real=True)
        answer = _zero_phase(decimation_filter(factor), factor * count) / factor
        out, block = np.empty((places.size, series.shape[1])), np.zeros(factor * count)
        for place, column in enumerate(series.T):
            level = column[0]  # beyond the ends it is zero
            block[late : late + column.size] = column - level
            spectrum = np.asarray(rfft(block), dtype=np.complex128)
            out[:, place] = level + _folded(spectrum * answer, count)[first : first + places.size]
        reach = SPAN * factor
        for near, distance, samples in (
            (places < reach, places, series),
            (self.samples - 1 - places < reach, self.samples - 1 - places, series[::-1]),
        ):
            if near.any():  # the filter would reach beyond an end
                out[near] = _weights_at_end(distance[near], factor) @ samples[: 2 * reach]
        return out

    def interpolated(self, series: Array, begin: int, end: int, *, first: int = 0) -> Array:
        """Return the samples of the record that those of the slow clock, from one to another, stand for, shape (m,).

        Parameters
        ----------
        series
            Values on the slow clock, shape (n,), of content up to 0.6 of its Nyquist frequency: those from `begin` to
            `end` and `BETWEEN` more on either side, as far as there are so many.
        begin, end
            First sample of the slow clock, and the one after the last.
        first
            Sample of the slow clock that `series` begins with.
        """
        factor, span = self.factor, self.span(begin, end)
        low, high = begin - BETWEEN + 1, end + BETWEEN
        padded = np.zeros(high - low)
        known = slice(max(low, first), min(high, first + series.size))
        padded[known.start - low : known.stop - low] = series[known.start - first : known.stop - first]
        windows = sliding_window_view(padded, 2 * BETWEEN)[: end - begin]
        between = (windows @ _weights_between(factor).T).ravel()
        out = np.empty(span.stop - span.start)
        ahead = self.before + begin * factor - span.start
        out[ahead : ahead + between.size] = between[: out.size - ahead]
        places = np.arange(span.start, span.stop) - self.before
        if begin == 0:
            near = places < BETWEEN * factor
            out[near] = _beside_end(series, places[near] / factor)
        if end == self.count:
            back = (self.count - 1) * factor - places  # counted from the last sample of the slow clock
            near = back < BETWEEN * factor
            out[near] = _beside_end(series[::-1], back[near] / factor)
        return out


def _weights_at_end(places: NDArray[np.intp], factor: int) -> Array:
    """Weights of the first samples of a record in those of the slow clock at places of it, (m, 2 SPAN factor)."""
    band = (1 - ROLL_OFF) / (2 * factor)
    return band_limited_weights(places.astype(np.float64), 2 * SPAN * factor, band=band, noise=BAND_NOISE)


def _beside_end(series: Array, places: Array) -> Array:
    """Values at places, in samples from the first of a series or, of its mirror image, from its last, shape (m,)."""
    count = min(4 * BETWEEN, series.size)
    return np.asarray(band_limited_weights(places, count, band=0.5 * (1 - ROLL_OFF), noise=CLEAN) @ series[:count])


def between_samples(values: Array, factor: int) -> Array:
    """Return a band-limited series, shape (n,), on a clock that is so many times as fast, to its last sample."""
    decimation = Decimation(factor, (values.size - 1) * factor + 1)
    return decimation.interpolated(values, 0, values.size)


def _zero_phase(taps: Array, size: int) -> Array:
    """Gain of symmetric coefficients at the frequencies of a transform of `size` samples, shape (size / 2 + 1,)."""
    half = taps.size // 2
    series = np.zeros(size)
    series[: half + 1], series[size - half :] = taps[half:], taps[:half]
    return np.asarray(rfft(series).real)


def _folded(spectrum: NDArray[np.complex128], count: int) -> Array:
    """Samples of the slow clock, `count` in all, from a spectrum that has nothing above its sampling rate."""
    slow = np.arange(count // 2 + 1)
    # what lies above the new Nyquist frequency folds onto what is as far below it
    return np.asarray(irfft(spectrum[slow] + spectrum[count - slow].conj(), count))
