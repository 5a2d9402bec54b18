"""The noise of a channel, judged from its own record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from aerobalance.recording.noise import noise_correlation, white_noise


def signals(count):
    time = np.arange(count)
    jump = np.where((time > 0.3 * count) & (time < 0.7 * count), 500.0, 0.0)
    # a lightly damped balance at a tenth of the rate, rung by a jump
    pole = 0.999 * np.exp(2j * np.pi * 0.1)
    ringing = lfilter([abs(1 - pole) ** 2], [1, -2 * pole.real, abs(pole) ** 2], jump)
    return {"nothing": 0 * time, "jumps": jump, "a slow sine": 300 * np.sin(time / 90), "ringing": ringing}


@pytest.mark.parametrize("kind", signals(8))
def test_noise_is_found_under_the_signal(rng, kind):
    count = 8000
    found = white_noise(signals(count)[kind] + rng.normal(0, 2.0, count))
    # the lower quartile of some thirty bands reads low by design, up to a tenth; a median of 8000 scatters by 1.5 %
    assert found == pytest.approx(2.0, rel=0.12)


def test_constant_and_short_records():
    assert white_noise(np.zeros(100)) == 0
    with pytest.raises(ValueError, match="at least 8 readings"):
        white_noise(np.zeros(7))


def test_wild_readings_that_channels_have_in_common_are_no_noise_in_common(rng):
    """Of independent noise no correlation is told, as of one record in 1e8; of a true one what it is without them."""
    count = 20_000
    noise = rng.normal(size=(count, 3))
    noise[:, 2] = 0.8 * noise[:, 0] + 0.6 * noise[:, 2]
    expected = noise_correlation(noise)
    assert expected[0, 1] == expected[1, 2] == 0.0
    # over the upper half of the ordinates a correlation of 0.8 scatters by (1 - 0.8^2) / sqrt(2 m)
    assert expected[0, 2] == pytest.approx(0.8, abs=5 * 0.36 / np.sqrt(count / 2))
    wild = noise.copy()
    wild[rng.choice(count, 30, replace=False)] += np.array([300.0, 40.0, -100.0])
    found = noise_correlation(wild)
    assert found[0, 1] == found[1, 2] == 0.0
    # five differences about each are left out: that changes the estimate by the root of their share of its scatter
    assert found[0, 2] == pytest.approx(expected[0, 2], abs=5 * 0.36 / np.sqrt(count / 2) * np.sqrt(5 * 30 / count))
