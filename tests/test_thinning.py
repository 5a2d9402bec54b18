"""Thinning against what it promises: no dependence on the cut, gain 1 below, white noise that stays white."""

import numpy as np
import pytest

from aerobalance.app.monitor.running_spectrum import LENGTH, RunningSpectrum
from aerobalance.estimation.live.decimation import SPAN, Decimator


def test_does_not_depend_on_the_cut(rng) -> None:
    samples = rng.standard_normal((4000, 3))
    whole = Decimator(3, 7).push(samples)
    thinner = Decimator(3, 7)
    parts = [thinner.push(part) for part in np.split(samples, np.sort(rng.integers(0, 4000, 150)))]
    # the sums of a window are the same products; their order may differ: 113 terms of some units
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-13)


def test_a_slow_sine_passes_at_its_own_time() -> None:
    thinner = Decimator(1, 9)
    t = np.arange(3000)
    found = thinner.push(np.sin(0.05 * t)[:, None])[:, 0]
    due = np.sin(0.05 * (thinner.first + 9 * np.arange(found.size)))
    # the ripple of the filter, cut off after SPAN samples on either side (next test)
    assert np.abs(found - due).max() < 2e-3
    assert thinner.first == SPAN * 9


def test_a_factor_of_one_changes_nothing() -> None:
    samples = np.arange(6.0).reshape(3, 2)
    assert Decimator(2, 1).push(samples) is samples
    with pytest.raises(ValueError, match="at least 1"):
        Decimator(1, 0)


def test_spectrum_gives_the_amplitude_of_a_sine() -> None:
    spectrum = RunningSpectrum(2, 1 / 1600)
    t = np.arange(5000) / 1600
    line = 256 * 1600 / LENGTH  # on a line of the spectrum
    for part in np.split(t, 7 * [0] + [123, 124, 3000]):
        spectrum.push(np.column_stack((50 + 3 * np.sin(2 * np.pi * line * part), np.full(part.size, 7.0))))
    assert spectrum.ready
    found = spectrum.amplitudes()
    assert spectrum.frequency[np.argmax(found[:, 0])] == pytest.approx(line)
    assert found[:, 0].max() == pytest.approx(3.0, rel=1e-9)
    assert found[:, 1].max() < 1e-9


def test_missing_samples_do_not_spoil_a_spectrum() -> None:
    spectrum = RunningSpectrum(1, 1.0)
    values = np.sin(2 * np.pi * 0.125 * np.arange(LENGTH))
    values[100:141] = np.nan
    spectrum.push(values[:, None])
    # 1 % of the samples at the edge of the window carry less than 1 % of its weight
    assert spectrum.amplitudes().max() == pytest.approx(1.0, rel=0.01)
