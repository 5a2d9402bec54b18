"""Bins of least and largest values against the samples themselves."""

import itertools

import numpy as np
import pytest

from aerobalance.app.monitor.minmax_strips import STEP, Bins, Extremes, Strip


def pushed(extremes, tick, parts, step=1):
    made = []
    for part in parts:
        made.append(extremes.push(tick, part))
        tick += step * len(part)
    for before, after in itertools.pairwise(made):
        assert after.first == before.first + len(before.least)
    return made[0].first, np.concatenate([b.least for b in made]), np.concatenate([b.largest for b in made])


@pytest.mark.parametrize(("width", "step"), [(1, 1), (25, 1), (25, 9), (9, 9)])
def test_bins_do_not_depend_on_the_cut_and_lose_no_peak(width, step, rng) -> None:
    samples = rng.standard_normal((3000, 2))
    samples[rng.random(3000) < 0.05, 1] = np.nan
    tick = step * int(rng.integers(0, 1000))
    whole = pushed(Extremes(2, width, step=step, longest=10**6), tick, [samples], step)
    parts = np.split(samples, np.sort(rng.integers(0, 3000, 80)))
    again = pushed(Extremes(2, width, step=step), tick, parts, step)
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one, other)
    numbers = (tick + step * np.arange(3000)) // width
    for number in range(whole[0], whole[0] + len(whole[1])):
        inside = samples[numbers == number]
        with np.errstate(invalid="ignore"):
            np.testing.assert_array_equal(whole[1][number - whole[0]], np.fmin.reduce(inside, axis=0))
            np.testing.assert_array_equal(whole[2][number - whole[0]], np.fmax.reduce(inside, axis=0))


def test_a_gap_leaves_empty_bins() -> None:
    extremes = Extremes(1, 10)
    extremes.push(0, np.ones((25, 1)))
    bins = extremes.push(60, np.ones((20, 1)))
    assert bins.first == 2
    assert np.isnan(bins.least[:, 0]).tolist() == [False, True, True, True, False, False]


def test_a_count_that_begins_anew_is_followed() -> None:
    extremes = Extremes(1, 10)
    extremes.push(1000, np.ones((25, 1)))
    bins = extremes.push(0, 2 * np.ones((20, 1)))
    assert (bins.first, bins.least[:, 0].tolist()) == (0, [2.0, 2.0])


def test_coarse_bins_are_the_extremes_of_fine_ones(rng) -> None:
    strip = Strip(2, (500, 100, 20))
    least = rng.standard_normal((3217, 2)).astype(np.float32)
    largest = least + 1
    first, done = 30 * STEP**2, 0
    while done < len(least):
        count = int(rng.integers(1, 90))
        strip.extend(Bins(first + done, least[done : done + count], largest[done : done + count]))
        done += count
    for level in range(3):
        width = STEP**level
        found = strip.since(level, 0)
        assert found.first + len(found.least) == (first + len(least)) // width == strip.end(level)
        assert len(found.least) == (500, 100, 20)[level]
        for k in range(len(found.least)):
            begin = (found.first + k) * width - first
            np.testing.assert_array_equal(found.least[k], least[begin : begin + width].min(axis=0))
            np.testing.assert_array_equal(found.largest[k], largest[begin : begin + width].max(axis=0))
    assert len(strip.since(0, strip.end(0) - 3).least) == 3


def test_a_bin_must_hold_a_sample() -> None:
    with pytest.raises(ValueError, match="holds no sample"):
        Extremes(1, 5, step=9)
