"""The noise of a channel, judged from its own record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from aerobalance.recording.noise import white_noise


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
