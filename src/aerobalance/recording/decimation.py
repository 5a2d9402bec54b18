"""Decimation of series with a root-Nyquist filter, and band-limited interpolation back to the faster clock.

The squares of the filter's gain at a frequency and at the one that folds onto it add up to 1 (a root-Nyquist filter),
so that white noise on the fast clock is white on the slow one. Its gain falls off as that of Meyer's wavelet
[Daubechies1992]_: smoothly, so that the impulse response is short. Where the filter would need samples beyond an end
of the record or in a gap, the best linear estimate of a band-limited series from the samples on one side is used
instead.

References
----------
.. [Daubechies1992] I. Daubechies, "Ten Lectures on Wavelets", SIAM (1992), ch. 4.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import gaps_in, interpolate_gaps_linearly

ROLL_OFF: Final = 0.35
"""Half width of the transition band of the filter, over the new Nyquist frequency in its middle [1]."""

SPAN: Final = 24
"""Half length of the filter [new samples]. Up to 1 - ROLL_OFF of the new Nyquist frequency its gain is 1 within 1e-6,
and beyond 1 + ROLL_OFF it is below 2e-5."""

FINE: Final = 64
"""Points at which the gain of the filter is given, over half the number of its coefficients."""

BAND_NOISE: Final = 1e-8
"""Spectral density of noise over that of the series in its band, assumed for the estimate beside an end [1]."""

SHORT_GAP: Final = 0.5
"""Longest gap that is filled before decimation [new samples]: a new sample has at most 1.44 times its variance then,
and a correlation of 0.28 with the next."""

MOST_NOISE: Final = 1.5
"""Variance of a sample beside a gap by noise, over that of others, above which it is left out."""

ABOUT_FAST: Final = 3
"""New samples on either side of an instant that are left out where readings change faster than the band: beyond, what
a mode of 0.12 of the new sampling rate reads of a sudden force is off by less than a thousandth of that force."""

BETWEEN: Final = 12
"""Samples on either side from which a value between samples is interpolated."""

SHARPNESS: Final = 12.0
"""Parameter beta of the Kaiser window of that interpolation: its error is below 4e-6 of the amplitude of a sine, up to
1 - ROLL_OFF of the Nyquist frequency."""

_INTERPOLATED_AT_ONCE: Final = 1 << 12
"""Samples of the slow clock that are interpolated together: their windows stay in the cache."""

CLEAN: Final = 1e-10
"""As `BAND_NOISE`, for the interpolation beside an end [1]."""


@cache
def decimation_filter(factor: int, span: int = SPAN) -> Array:
    """Coefficients of the decimation filter, shape (2 span factor + 1,), symmetric and of sum 1 [1].

    Parameters
    ----------
    factor
        Samples of the fast clock for each sample of the slow one.
    span
        Half length of the filter [new samples]: with 8, its gain in the pass band is 1 within 1e-3.
    """
    half = span * factor
    count = FINE * half
    place = np.clip((2 * factor * np.fft.rfftfreq(count) - (1 - ROLL_OFF)) / (2 * ROLL_OFF), 0.0, 1.0)
    fall = place**4 * (35 - 84 * place + 70 * place**2 - 20 * place**3)
    response = np.fft.irfft(np.cos(0.5 * np.pi * fall), count)
    taps = np.concatenate([response[-half:], response[: half + 1]])
    return np.asarray(taps / taps.sum())


def band_limited_weights(places: Array, count: int, *, band: float, noise: float) -> Array:
    """Weights by which the first samples of a series give its values at given places, shape (m, count) [1].

    They are those of the best linear estimate of a series that is white up to a frequency and zero beyond it, observed
    in white noise.

    Parameters
    ----------
    places
        Where the values are wanted, between the samples or beyond them, shape (m,) [samples from the first].
    count
        Number of samples that the estimate uses.
    band
        Highest frequency of the series over the sampling rate [1].
    noise
        Spectral density of the noise over that of the series in its band [1].
    """
    own = np.arange(count)
    within = 2 * band * np.sinc(2 * band * (own[:, None] - own))
    wanted = 2 * band * np.sinc(2 * band * (own[:, None] - places))
    return np.asarray(np.linalg.solve(within + noise * np.eye(count), wanted).T)


@cache
def _weights_between(factor: int) -> Array:
    """Interpolation weights of the 2 BETWEEN nearest samples for each fast sample, shape (factor, 2 BETWEEN)."""
    distance = np.arange(1 - BETWEEN, BETWEEN + 1) - np.arange(factor)[:, None] / factor
    window = np.i0(SHARPNESS * np.sqrt(np.maximum(1 - (distance / BETWEEN) ** 2, 0.0)))
    weights = np.sinc(distance) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def is_short_gap(samples: int, factor: int) -> bool:
    """Return whether a gap of so many samples is filled before a series is decimated by a factor."""
    return samples <= SHORT_GAP * factor


def alike_in_gaps(table: Array) -> Iterator[tuple[NDArray[np.intp], NDArray[np.bool_]]]:
    """Yield the columns of a table (n, c) that miss the same samples, and where these are, shape (n,)."""
    groups: dict[bytes, list[int]] = {}
    for place, missing in enumerate(np.isnan(table).T):
        groups.setdefault(missing.tobytes(), []).append(place)
    for missing_there, columns in groups.items():
        yield np.array(columns), np.frombuffer(missing_there, dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class Decimation:
    """Which samples of a record those of a slower clock come from; that clock lies in the middle of the record.

    Attributes
    ----------
    factor
        Samples of the record for each sample of the slow clock.
    samples
        Number of samples of the record.
    """

    factor: int
    samples: int

    @property
    def count(self) -> int:
        """Number of samples of the slow clock."""
        return (self.samples - 1) // self.factor + 1

    @property
    def before(self) -> int:
        """Samples of the record before the first of the slow clock; as many, or one more, follow its last one."""
        return (self.samples - 1) % self.factor // 2

    def span(self, begin: int, end: int) -> slice:
        """Samples of the record to which samples `begin` to `end` (excluded) of the slow clock are interpolated."""
        first = 0 if begin == 0 else self.before + begin * self.factor
        return slice(first, self.samples if end == self.count else self.before + end * self.factor)

    def wanted(self, begin: int, end: int) -> slice:
        """Samples of the record needed to compute samples `begin` to `end` (excluded) of the slow clock."""
        # twice what the filter needs: the estimate beside an end uses the samples over its whole length
        reach, before = 2 * SPAN * self.factor, self.before
        first = max(before + begin * self.factor - reach, 0)
        return slice(first, min(before + (end - 1) * self.factor + reach + 1, self.samples))

    def decimated(self, series: Array, begin: int, end: int) -> Array:
        """Return series at samples `begin` to `end` (excluded) of the slow clock, shape (end - begin, c).

        Beside a gap they are estimated as beside an end of the record; NaN in the gap, and next to it where the noise
        of that estimate is too large.

        Parameters
        ----------
        series
            c series at the samples that `wanted` returns, shape (m, c); NaN where one is missing.
        begin, end
            First sample of the slow clock, and the one after the last.

        Raises
        ------
        ValueError
            The record is shorter than the filter.
        """
        if self.samples < 2 * SPAN * self.factor:
            raise ValueError(
                f"a record of {self.samples} samples is too short to be decimated by {self.factor}: "
                f"{2 * SPAN * self.factor} are needed"
            )
        if np.isnan(series).any():
            out = np.empty((end - begin, series.shape[1]))
            for columns, gap in alike_in_gaps(series):
                out[:, columns] = self._beside_gaps(series[:, columns], gap, begin, end)
            return out
        own, factor = self.wanted(begin, end), self.factor
        places = self.before + factor * np.arange(begin, end)
        late = (own.start - self.before) % factor  # so that every factor-th sample of the block is one of the clock
        first = (int(places[0]) - own.start + late) // factor
        count = next_fast_len(-(-(series.shape[0] + late) // factor) + SPAN, real=True)
        answer = _answer(factor, factor * count)
        out, block = np.empty((places.size, series.shape[1])), np.zeros(factor * count)
        for place, column in enumerate(series.T):
            level = column[0]  # taken off, as the block is padded with zeros: without it their edge would ring
            block[late : late + column.size] = column - level
            spectrum = np.asarray(rfft(block), dtype=np.complex128)
            out[:, place] = level + _folded(spectrum * answer, count)[first : first + places.size]
        reach = SPAN * factor
        for near, distance, samples in (
            (places < reach, places, series),
            (self.samples - 1 - places < reach, self.samples - 1 - places, series[::-1]),
        ):
            if near.any():  # the filter would need samples beyond an end of the record
                out[near] = _weights_at_end(distance[near], factor) @ samples[: 2 * reach]
        return out

    def _beside_gaps(self, series: Array, gap: NDArray[np.bool_], begin: int, end: int) -> Array:
        """Series whose gaps are all where `gap` is True, decimated, shape (end - begin, c)."""
        if not gap.any():
            return self.decimated(series, begin, end)
        out = np.full((end - begin, series.shape[1]), np.nan)
        if gap.all():
            return out
        own, factor, reach = self.wanted(begin, end), self.factor, SPAN * self.factor
        at = self.before + factor * np.arange(begin, end) - own.start
        within = self.decimated(np.column_stack([interpolate_gaps_linearly(one) for one in series.T]), begin, end)
        for first, stop in gaps_in(~gap):
            inside = (at >= first) & (at < stop)
            out[inside] = within[inside]
            count, run = min(2 * reach, stop - first), series[first:stop]
            # the estimate beside an end of the record would reach into a gap that is near
            ends = first > 0 or (own.start == 0 and stop < 2 * reach), stop < gap.size
            if all(ends) and count == stop - first:
                out[inside] = _estimated(run, at[inside] - first, factor)
                continue
            for gap_there, samples, distance in zip(ends, (run, run[::-1]), (at - first, stop - 1 - at), strict=True):
                near = inside & (distance < reach)
                if gap_there and near.any():
                    out[near] = _estimated(samples[:count], distance[near], factor)
        for first, stop in gaps_in(gap):
            if is_short_gap(stop - first, factor):  # it would be filled, but for something fast that happened there
                out[(at > first - ABOUT_FAST * factor) & (at < stop + ABOUT_FAST * factor)] = np.nan
        return out

    def interpolated(self, series: Array, begin: int, end: int, *, first: int = 0) -> Array:
        """Return a series at the samples of the record that `span` returns, shape (m,).

        Parameters
        ----------
        series
            Values on the slow clock, shape (n,), band-limited to 1 - ROLL_OFF of its Nyquist frequency: those from
            `begin` to `end` and `BETWEEN` more on either side, or up to the end of the record; up to that too from
            less than `BETWEEN` before it on.
        begin, end
            First sample of the slow clock, and the one after the last.
        first
            Sample of the slow clock at which `series` begins.
        """
        factor, span = self.factor, self.span(begin, end)
        low, high = begin - BETWEEN + 1, end + BETWEEN
        padded = np.zeros(high - low)
        known = slice(max(low, first), min(high, first + series.size))
        padded[known.start - low : known.stop - low] = series[known.start - first : known.stop - first]
        windows, weights = sliding_window_view(padded, 2 * BETWEEN)[: end - begin], _weights_between(factor).T
        out = np.empty(span.stop - span.start)
        ahead = self.before + begin * factor - span.start
        for at in range(0, end - begin, _INTERPOLATED_AT_ONCE):  # of all at once the windows were copied whole
            between = (windows[at : at + _INTERPOLATED_AT_ONCE] @ weights).ravel()
            place = ahead + at * factor
            out[place : place + between.size] = between[: max(out.size - place, 0)]
        places = np.arange(span.start, span.stop) - self.before
        if begin < BETWEEN:
            near = places < BETWEEN * factor
            out[near] = _beside_end(series, places[near] / factor)
        if end > self.count - BETWEEN:
            back = (self.count - 1) * factor - places  # counted from the last sample of the slow clock
            near = back < BETWEEN * factor
            out[near] = _beside_end(series[::-1], back[near] / factor)
        return out


def _weights_at_end(places: NDArray[np.intp], factor: int) -> Array:
    """Weights of the first samples of a record in the samples of the slow clock at `places`, (m, 2 SPAN factor)."""
    band = (1 - ROLL_OFF) / (2 * factor)
    return _weights(places.astype(np.float64).tobytes(), 2 * SPAN * factor, band, BAND_NOISE)


def _estimated(samples: Array, places: NDArray[np.intp], factor: int) -> Array:
    """Series at places in a run of their samples, counted from the first, (m, c); NaN where noise is too large."""
    band = (1 - ROLL_OFF) / (2 * factor)
    weights = _weights(places.astype(np.float64).tobytes(), len(samples), band, BAND_NOISE)
    level = samples.mean(axis=0)
    noisy = factor * np.sum(weights**2, axis=1) > MOST_NOISE
    return np.where(noisy[:, None], np.nan, level + weights @ (samples - level))


def _beside_end(series: Array, places: Array) -> Array:
    """Values of a series near its beginning, at places in samples from its first, shape (m,).

    For the end, give the series in reverse order.
    """
    count = min(4 * BETWEEN, series.size)
    return np.asarray(_weights(places.tobytes(), count, 0.5 * (1 - ROLL_OFF), CLEAN) @ series[:count])


@lru_cache(maxsize=32)  # all channels of a record have the same ends and gaps, and are asked one after the other
def _weights(places: bytes, count: int, band: float, noise: float) -> Array:
    """`band_limited_weights` for places in a form that can be remembered."""
    return band_limited_weights(np.frombuffer(places), count, band=band, noise=noise)


def ends_between_samples(values: Array, factor: int) -> tuple[float, float]:
    """Return the least and the largest value of a band-limited series on a clock that is faster by a factor.

    Where samples are NaN there is none for a few on either side; without any, the least is inf and the largest -inf.
    """
    decimation = Decimation(factor, (values.size - 1) * factor + 1)
    least, largest = np.inf, -np.inf
    for begin in range(0, values.size, _INTERPOLATED_AT_ONCE):
        some = decimation.interpolated(values, begin, min(begin + _INTERPOLATED_AT_ONCE, values.size))
        least, largest = np.nanmin(some, initial=least), np.nanmax(some, initial=largest)
    return float(least), float(largest)


@lru_cache(maxsize=4)  # the pieces of a record have one length, or at its ends others
def _answer(factor: int, size: int) -> Array:
    """Frequency response of the decimation filter over the factor, for a series of `size` samples."""
    return _zero_phase(decimation_filter(factor), size) / factor


def _zero_phase(taps: Array, size: int) -> Array:
    """Frequency response of a symmetric filter, real as it is without delay, shape (size / 2 + 1,) [1]."""
    half = taps.size // 2
    series = np.zeros(size)
    series[: half + 1], series[size - half :] = taps[half:], taps[:half]
    return np.asarray(rfft(series).real)


def _folded(spectrum: NDArray[np.complex128], count: int) -> Array:
    """Series of `count` samples on the slow clock, from a spectrum that is zero above its sampling rate."""
    slow = np.arange(count // 2 + 1)
    # frequencies above the new Nyquist frequency are aliased to those as far below it
    return np.asarray(irfft(spectrum[slow] + spectrum[count - slow].conj(), count))
