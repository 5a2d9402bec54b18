"""A slower clock against what it promises: the band as it is, white noise white, ends as good as their samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from aerobalance.recording.decimation import (
    BETWEEN,
    ROLL_OFF,
    SPAN,
    Decimation,
    band_limited_weights,
    decimation_filter,
    ends_between_samples,
)

FACTORS = [4, 9, 16]


def band_limited(rng: np.random.Generator, samples: int, *, highest: float) -> np.ndarray:
    """A series of rms 1 with content up to a frequency over its sampling rate, and none of its ends at its period."""
    frequency = np.fft.rfftfreq(4 * samples)
    lines = (frequency < highest) * (rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size))
    series = np.fft.irfft(lines)[samples : 2 * samples]
    return series / series.std()


@pytest.mark.parametrize(("span", "ripple"), [(SPAN, 3e-6), (8, 1e-3)])
@pytest.mark.parametrize("factor", [2, 5, 16])
def test_gain_and_what_folds(factor: int, span: int, ripple: float) -> None:
    taps = decimation_filter(factor, span)
    size = 4096 * factor
    gain = np.abs(np.fft.rfft(taps, size))
    nyquist = 4096 // 2
    assert np.abs(gain[: int((1 - ROLL_OFF) * nyquist)] - 1).max() < ripple
    folded = gain[: nyquist + 1] ** 2 + gain[nyquist : 2 * nyquist + 1][::-1] ** 2
    assert np.abs(folded - 1).max() < 2 * ripple  # a square
    assert taps.sum() == pytest.approx(1.0, abs=1e-12)
    # white noise of variance 1 becomes noise of variance 1 / factor with no correlation from sample to sample
    own = np.correlate(taps, taps, "full")[taps.size - 1 :: factor] * factor
    assert np.abs(own - np.eye(own.size)[0]).max() < 2 * ripple


@pytest.mark.parametrize("factor", FACTORS)
def test_the_band_passes_as_it_is(factor: int, rng: np.random.Generator) -> None:
    series = band_limited(rng, 20_011, highest=0.5 * (1 - ROLL_OFF) / factor)
    decimation = Decimation(factor, series.size)
    found = decimation.decimated(series[:, None], 0, decimation.count)[:, 0]
    error = found - series[decimation.before :: factor]
    # of the ripple of 1e-6 and of noise that is taken for 1e-4 of the series, which no number of samples takes back
    assert np.abs(error[SPAN:-SPAN]).max() < 1e-5
    assert np.abs(error).max() < 1e-3


def test_noise_beside_an_end_is_little_more_than_inside(rng: np.random.Generator) -> None:
    factor, count = 8, 400
    decimation = Decimation(factor, 800)
    noise = rng.normal(size=(decimation.samples, count))
    found = decimation.decimated(noise, 0, decimation.count) * np.sqrt(factor)
    deviation = found.std(axis=1)
    chance = 5 / np.sqrt(2 * count)  # of a standard deviation over that of 400 draws
    assert np.abs(deviation[SPAN:-SPAN] - 1).max() < chance
    # the very first sample has no neighbours on one side: 2.5 times, the second 1.14 times (least squares)
    assert deviation[[0, -1]].max() < 2.6 * (1 + chance)
    assert deviation[[1, -2]].max() < 1.2 * (1 + chance)


@pytest.mark.parametrize("factor", FACTORS)
def test_parts_are_those_of_the_whole(factor: int, rng: np.random.Generator) -> None:
    series = rng.normal(size=(12_007, 2)) + 1000.0
    decimation = Decimation(factor, len(series))
    whole = decimation.decimated(series, 0, decimation.count)
    for begin, end in ((0, 300), (300, 700), (decimation.count - 200, decimation.count)):
        part = decimation.decimated(series[decimation.wanted(begin, end)], begin, end)
        # rounding of transforms of other lengths, of readings of 1000, and of the solution beside an end
        np.testing.assert_allclose(part, whole[begin:end], rtol=0, atol=1e-6)


@pytest.mark.parametrize("factor", FACTORS)
def test_back_on_the_fast_clock(factor: int, rng: np.random.Generator) -> None:
    series = band_limited(rng, 8_003, highest=0.25 / factor)
    decimation = Decimation(factor, series.size)
    slow = series[decimation.before :: factor]
    found = decimation.interpolated(slow, 0, decimation.count)
    assert found.size == series.size
    inside = slice(BETWEEN * factor, -(BETWEEN + 1) * factor)
    assert np.abs(found - series)[inside].max() < 2e-5  # 3e-6 of the largest of some thousand samples of rms 1
    assert np.abs(found - series).max() < 1e-2  # up to a sample of the slow clock beyond its last one
    begin, end = 100, 300
    part = decimation.interpolated(slow[begin - 50 : end + 50], begin, end, first=begin - 50)
    np.testing.assert_array_equal(part, found[decimation.span(begin, end)])


@pytest.mark.parametrize("factor", FACTORS)
def test_pieces_are_those_of_the_whole(factor: int, rng: np.random.Generator) -> None:
    """Whatever their lengths: the shortest piece at an end is less than the interpolation reaches."""
    slow = rng.normal(size=400)
    decimation = Decimation(factor, 400 * factor - 1)
    whole = decimation.interpolated(slow, 0, decimation.count)
    ends = [0, 1, BETWEEN // 2, 200, 400 - BETWEEN // 2, 399, 400]
    pieces = [decimation.interpolated(slow, *two) for two in pairwise(ends)]
    found, inside = np.concatenate(pieces), slice((BETWEEN + 1) * factor, -(BETWEEN + 1) * factor)
    # rounding of products of other shapes, of samples of up to some 4
    np.testing.assert_allclose(found[inside], whole[inside], rtol=0, atol=1e-13)
    # and of the solution beside an end, whose condition is the inverse of noise over series, 1e10
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e10 * np.finfo(float).eps * np.abs(whole).max())


def test_peaks_between_samples() -> None:
    time = np.arange(12_000) / 9.0  # nine samples in a period
    rise = 1 + 0.5 * np.exp(-(((time - 1000) / 50) ** 2))  # highest in a later piece than the first
    least, largest = ends_between_samples(rise * np.sin(2 * np.pi * time + 0.3), 8)
    # a 72nd of a period off, 1 - cos(2 pi / 144); half a period beside the top the rise has lost 5e-5
    assert largest == pytest.approx(1.5, rel=1e-3)
    assert least == pytest.approx(-1.5, rel=1e-3)
    assert ends_between_samples(np.full(100, np.nan), 8) == (np.inf, -np.inf)


def test_the_estimate_beside_an_end_is_the_best(rng: np.random.Generator) -> None:
    """Its mean square error is that which the covariances say, and any other weights have a larger one."""
    places, count, band, noise = np.array([0.0, 3.5]), 40, 0.1, 0.01
    weights = band_limited_weights(places, count, band=band, noise=noise)
    samples = np.arange(count)

    def error(weights: np.ndarray) -> np.ndarray:
        within = 2 * band * np.sinc(2 * band * (samples[:, None] - samples)) + noise * np.eye(count)
        wanted = 2 * band * np.sinc(2 * band * (samples[:, None] - places))
        own = np.einsum("pn,nm,pm->p", weights, within, weights)
        return 2 * band - 2 * np.einsum("pn,np->p", weights, wanted) + own

    least = error(weights)
    assert (least > 0).all()
    for _ in range(5):
        assert (error(weights + 0.01 * rng.normal(size=weights.shape)) > least).all()


def test_a_record_shorter_than_the_filter_is_refused() -> None:
    decimation = Decimation(8, 2 * SPAN * 8 - 1)
    with pytest.raises(ValueError, match="too short to be decimated by 8"):
        decimation.decimated(np.zeros((decimation.samples, 1)), 0, decimation.count)
