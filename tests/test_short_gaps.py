"""Short gaps of readings that are to be decimated: filled as well as theory says, and where nothing fast happens."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.recording import resampling, short_gaps
from aerobalance.recording.decimation import ROLL_OFF, Decimation, decimation_filter, is_short_gap
from aerobalance.recording.resampling import interpolate_gaps
from aerobalance.recording.short_gaps import SETTINGS, short_gaps_filled
from helpers.cable_cut import T128
from seeds import trials

FACTORS = [4, 10, 16]


def band_limited(rng: np.random.Generator, samples: int, *, factor: int, rms: float) -> np.ndarray:
    """A series that fills the band which decimation by the factor keeps, and has none of its ends at its period."""
    frequency = np.fft.rfftfreq(4 * samples)
    kept = (frequency < (1 - ROLL_OFF) / (2 * factor)) & (frequency > 0)
    series = np.fft.irfft(kept * (rng.normal(size=kept.size) + 1j * rng.normal(size=kept.size)))[samples : 2 * samples]
    return rms * series / series.std()


def lacking(values: np.ndarray, begins: np.ndarray, length: int) -> np.ndarray:
    without = values.copy()
    without[(begins[:, None] + np.arange(length)).ravel()] = np.nan
    return without


def filled_of(values: np.ndarray, factor: int) -> np.ndarray:
    return short_gaps_filled(values[:, None], factor)[:, 0]


@pytest.mark.parametrize("share", [0, 1])
@pytest.mark.parametrize("factor", FACTORS)
def test_what_is_filled_is_off_by_less_than_a_reading(factor: int, share: int, rng: np.random.Generator) -> None:
    """The error is what the weights make of the noise, closed form, and less than the noise of a reading."""
    length, samples = max(int(SETTINGS.beside * factor * share), 1), 40_000
    true = band_limited(rng, samples, factor=factor, rms=100.0)
    begins = np.arange(50, samples - 50, 40 * factor)
    filled = filled_of(lacking(true + rng.normal(size=samples), begins, length), factor)
    reach = SETTINGS.reach * factor
    present = np.ones(2 * reach + length, dtype=bool)
    present[reach : reach + length] = False
    weights, _ = short_gaps._across(present, slice(reach, reach + length), factor)
    variance = np.sum(weights**2, axis=1)
    assert variance.max() < SETTINGS.noise_gain
    inside = begins[(begins > 24 * factor) & (begins < samples - 24 * factor)]
    scores = (filled - true)[inside[:, None] + np.arange(length)] / np.sqrt(variance)
    # at the beginning and the end of a gap the errors are nearly one: a mean square of as many as there are gaps
    assert np.mean(scores**2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / inside.size))


@pytest.mark.parametrize("factor", FACTORS)
def test_a_slower_sample_has_little_more_noise_for_it(factor: int, rng: np.random.Generator) -> None:
    """At most 1.44 times the variance in the sample where the filter has most of the gap, from the weights alone."""
    length, reach = int(0.5 * factor), SETTINGS.reach * factor
    present = np.ones(2 * reach + length, dtype=bool)
    present[reach : reach + length] = False
    weights, _ = short_gaps._across(present, slice(reach, reach + length), factor)
    taps = decimation_filter(factor)
    half, worst = taps.size // 2, 0.0
    readings = np.arange(present.size)
    for middle in range(reach - factor, reach + length + factor):
        place = readings - middle + half
        own = np.where((place >= 0) & (place < taps.size), taps[np.clip(place, 0, taps.size - 1)], 0.0)
        share = own[present] + own[~present] @ weights
        outside = np.sum(taps**2) - np.sum(own**2)
        worst = max(worst, float((np.sum(share**2) + outside) / np.sum(taps**2)))
    assert 1.0 < worst < 1.45


def test_gaps_at_the_ends_and_long_ones_are_left(rng: np.random.Generator) -> None:
    factor, samples = 10, 5000
    values = band_limited(rng, samples, factor=factor, rms=100.0) + rng.normal(size=samples)
    values[:2] = values[-3:] = values[2000:2006] = np.nan
    values[3000:3005] = np.nan
    filled = filled_of(values, factor)
    assert not is_short_gap(6, factor)
    assert np.flatnonzero(np.isnan(filled)).tolist() == [0, 1, *range(2000, 2006), *range(4997, 5000)]
    untouched = ~np.isnan(values)
    np.testing.assert_array_equal(filled[untouched], values[untouched])


def test_gaps_near_each_other_are_filled_from_what_is_there(rng: np.random.Generator) -> None:
    factor, samples = 10, 4000
    true = band_limited(rng, samples, factor=factor, rms=100.0)
    begins = np.arange(1000, 1400, 8)
    filled = filled_of(lacking(true + 0.5 * rng.normal(size=samples), begins, 2), factor)
    lost = (begins[:, None] + np.arange(2)).ravel()
    assert np.isfinite(filled).all()
    # less than the noise of a reading, as `noise_gain` says; of a hundred numbers half of which go together
    assert np.sqrt(np.mean((filled - true)[lost] ** 2)) < 0.5 * (1 + 4 / np.sqrt(lost.size))


@pytest.mark.parametrize("place", [0, 1, 2])
def test_where_readings_change_faster_than_the_band_nothing_is_filled(place: int, rng: np.random.Generator) -> None:
    """A force of 400 N bends the reading of a balance at once: its speed changes by 6 N a sample within a few."""
    rate, samples, factor = 12_800.0, 40_000, 16
    time = np.arange(samples) / rate
    for _ in range(trials(2, 20)):
        begin = int(rng.integers(10_000, 30_000))
        load = 5000.0 * T128.step_response(time - (begin + place + 0.3) / rate)
        values = load + 0.5 * rng.normal(size=samples)
        values[begin : begin + 4] = np.nan
        assert np.isnan(filled_of(values, factor)[begin : begin + 4]).all()


def test_decimated_beside_a_long_gap(rng: np.random.Generator) -> None:
    """Away from it as without it, beside it to what the band says, with the noise that is promised; nothing in it."""
    factor, samples = 10, 20_000
    decimation = Decimation(factor, samples)
    true = band_limited(rng, samples, factor=factor, rms=100.0)
    whole = decimation.decimated(true[:, None], 0, decimation.count)[:, 0]
    for first, stop in ((7000, 7600), (0, 300), (19_000, 20_000), (100, 108), (7000, 7006)):
        values = true.copy()
        values[first:stop] = np.nan
        found = decimation.decimated(values[:, None], 0, decimation.count)[:, 0]
        place = decimation.before + factor * np.arange(decimation.count)
        gap = (place >= first) & (place < stop)
        assert np.isnan(found[gap]).all()
        # beside it one sample on either side has too much noise
        assert np.count_nonzero(np.isnan(found) & ~gap) <= 2
        known = np.isfinite(found)
        # noise of 1e-8 of the band's density is assumed: its root, times the gain of the noise
        assert np.max(np.abs((found - whole)[known])) < 100.0 * 10 * 1e-4
        far = (place < first - 24 * factor) | (place > stop + 24 * factor)
        if 2 * 24 * factor < first and stop + 2 * 24 * factor < samples:
            # frequencies that fold twice are left out, where the filter has 2e-5: that of the edges of a gap, of which
            # 3e-9 of the load come there in half of 300 records, and 1.4e-8 at most
            np.testing.assert_allclose(found[far], whole[far], rtol=0, atol=100.0 * 5e-8)
    noise = rng.normal(size=(samples, trials(100, 600)))
    noise[7000:7600] = np.nan
    found = decimation.decimated(noise, 690, 770) * np.sqrt(factor)
    variance = np.mean(found**2, axis=1)
    # the largest of eighty mean squares
    assert np.nanmax(variance) < 1.5 * (1 + 5 * np.sqrt(2 / noise.shape[1]))


def test_short_runs_between_gaps_are_estimated_from_their_own_samples(rng: np.random.Generator) -> None:
    factor, samples = 8, 10_000
    decimation = Decimation(factor, samples)
    true = band_limited(rng, samples, factor=factor, rms=10.0)
    values = true.copy()
    values[4000:4100], values[4220:4300] = np.nan, np.nan
    whole, found = (decimation.decimated(one[:, None], 0, decimation.count)[:, 0] for one in (true, values))
    inside = (decimation.before + factor * np.arange(decimation.count) - 4160.0) / 60.0
    middle = np.abs(inside) < 0.8
    assert np.isfinite(found[middle]).all()
    assert np.max(np.abs((found - whole)[middle])) < 10.0 * 10 * 1e-4


def test_pieces_of_a_record_with_gaps_are_those_of_the_whole(rng: np.random.Generator) -> None:
    factor, samples = 5, 12_000
    decimation = Decimation(factor, samples)
    values = band_limited(rng, samples, factor=factor, rms=10.0)
    for first, stop in ((3000, 3400), (3500, 3520), (8000, 8004), (11_900, 12_000)):
        values[first:stop] = np.nan
    whole = decimation.decimated(values[:, None], 0, decimation.count)[:, 0]
    for begin, end in ((0, 640), (640, 700), (700, 1590), (1590, 2400)):
        own = decimation.wanted(begin, end)
        part = decimation.decimated(values[own, None], begin, end)[:, 0]
        # as in `test_decimation`: transforms of other lengths
        np.testing.assert_allclose(part, whole[begin:end], rtol=0, atol=1e-6)


def test_many_gaps_of_one_length_are_predicted_as_each_alone(rng: np.random.Generator, monkeypatch) -> None:
    """The inverse of the covariance of a whole window gives what the equations of each gap's own readings give."""
    values = np.cumsum(rng.normal(size=(6000, 2)), axis=0)
    for length in (1, 3):
        begins = rng.choice(np.arange(5, 5990, 7), 60, replace=False)
        values[(begins[:, None] + np.arange(length)).ravel(), length // 2] = np.nan
    found = interpolate_gaps(values)
    monkeypatch.setattr(resampling, "OFTEN", 10_000)
    # readings are exact to 1e-9 of the variance: that is the condition of the equations, whose rounding is 2e-16
    np.testing.assert_allclose(found, interpolate_gaps(values), rtol=0, atol=1e-6 * np.nanstd(values))
