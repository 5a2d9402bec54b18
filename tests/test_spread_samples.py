"""Some samples of a record stand for all of them, whatever goes with its clock."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.recording.spread_samples import spread_samples


@pytest.mark.parametrize("period", [2, 3, 5, 6, 10, 12, 37])
@pytest.mark.parametrize("samples", [24_576, 44_000, 49_152])  # multiples of what is taken among them
def test_every_phase_of_what_goes_with_the_clock_is_seen(period: int, samples: int) -> None:
    """As often as another: of 4096 samples each phase has 4096 / period, and their binomial scatter at most."""
    counts = np.bincount(spread_samples(samples, 4096) % period, minlength=period)
    assert np.all(np.abs(counts - 4096 / period) < 5 * np.sqrt(4096 / period))


def test_one_sample_of_each_stretch_and_the_same_ones_again() -> None:
    places = spread_samples(10_007, 1000)
    assert np.array_equal(places, spread_samples(10_007, 1000))
    stretch = 10_007 / 1000
    assert np.all(places <= (np.arange(1000) + 1) * stretch) and np.all(places > np.arange(1000) * stretch - 1)
    assert np.array_equal(spread_samples(7, 1000), np.arange(7))
