"""Averaged spectra, windows and filters against those of scipy.signal, and modes' recursions against its filters."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from aerobalance.dynamics import _kernels
from aerobalance.recording.fourier import averaged_spectrum, convolve, hann, tapered, without_line
from aerobalance.recording.resampling import EDGE, FINE, SHARPNESS, upsample

ROUNDING = 1e-12  # of the largest value: some hundred operations on each


@pytest.mark.parametrize("length", [64, 65, 1000])
@pytest.mark.parametrize(("less", "detrend"), [("mean", "constant"), ("line", "linear")])
def test_averaged_spectra_are_those_of_scipy(rng, length, less, detrend) -> None:
    x, y = rng.normal(size=(2, 1000)).cumsum(axis=1)
    found = averaged_spectrum(x, rate=250.0, length=length, less=less)
    expected = signal.welch(x, 250.0, nperseg=length, detrend=detrend)
    np.testing.assert_allclose(found[0], expected[0], rtol=ROUNDING)
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=ROUNDING * expected[1].max())
    cross = averaged_spectrum(x, rate=250.0, length=length, other=y, less=less)[1]
    expected = signal.csd(x, y, 250.0, nperseg=length, detrend=detrend)[1]
    np.testing.assert_allclose(cross, expected, rtol=0, atol=ROUNDING * np.abs(expected).max())


def test_spectra_with_several_series_are_those_with_each(rng) -> None:
    x, *others = rng.normal(size=(4, 1000))
    several = averaged_spectrum(x, rate=250.0, length=128, other=[x, *others])[1]
    each = [averaged_spectrum(x, rate=250.0, length=128, other=one)[1] for one in (x, *others)]
    np.testing.assert_array_equal(several, each)


def test_windows_lines_and_filters_are_those_of_scipy(rng) -> None:
    for _ in range(2):  # one that is kept is the same, and nobody writes to it
        np.testing.assert_allclose(hann(100), signal.windows.hann(100, sym=False), atol=ROUNDING)
    assert not hann(100).flags.writeable
    np.testing.assert_allclose(tapered(101, 0.1), signal.windows.tukey(101, 0.1), atol=ROUNDING)
    x, weights = rng.normal(size=(3, 500)), rng.normal(size=(31, 3))
    np.testing.assert_allclose(without_line(x), signal.detrend(x), atol=ROUNDING * 10)
    expected = np.column_stack([np.convolve(column, own) for column, own in zip(x, weights.T, strict=True)])
    np.testing.assert_allclose(convolve(x.T, weights), expected, atol=ROUNDING * 100)


@pytest.mark.parametrize(("count", "reach"), [(40_000, 900), (40_000, 6000), (16_384, 1), (100, 30_000)])
def test_convolution_in_blocks_is_that_of_scipy(rng, count, reach) -> None:
    x, weights = rng.normal(size=(count, 2)), rng.normal(size=(reach, 2))
    expected = signal.oaconvolve(x, weights, axes=0)
    np.testing.assert_allclose(convolve(x, weights), expected, atol=ROUNDING * np.abs(expected).max())


@pytest.mark.parametrize("count", [30, 400])
def test_samples_between_samples_are_those_of_scipy(rng, count) -> None:
    x = rng.normal(size=(count, 2)).cumsum(axis=0)
    expected = x[:1] + signal.resample_poly(x - x[:1], FINE, 1, axis=0, window=("kaiser", SHARPNESS), padtype="line")
    inner = slice(FINE * EDGE, FINE * (count - EDGE))  # splines take over at the ends
    np.testing.assert_allclose(upsample(x)[inner], expected[inner], atol=ROUNDING * np.abs(x).max())


@pytest.mark.parametrize("compiled", [True, False])
def test_recursions_are_filters(rng, compiled) -> None:
    first_order, driven = (one if compiled else one.py_func for one in (_kernels.first_order, _kernels.driven))
    growth, drive = 0.98 * np.exp(0.2j), rng.normal(size=300) + 1j * rng.normal(size=300)
    expected = signal.lfilter([1.0], [1.0, -growth], drive)
    np.testing.assert_allclose(first_order(growth, drive), expected, atol=ROUNDING * np.abs(expected).max())
    # its state is its last two outputs
    denominator, state, taps = np.array([1.0, -1.9, 0.95]), rng.normal(size=2), rng.normal(size=(3, 2))
    series, found = rng.normal(size=(2, _kernels.BLOCK + 102)), np.empty(_kernels.BLOCK + 100)
    push = sum(np.convolve(one, weights[::-1], "valid") for one, weights in zip(series, taps.T, strict=True))
    expected, _ = signal.lfilter([1.0], denominator, push, zi=signal.lfiltic([1.0], denominator, state))
    driven(denominator, taps, series, state, found)
    np.testing.assert_allclose(found, expected, atol=ROUNDING * np.abs(expected).max())
    np.testing.assert_array_equal(state, found[:-3:-1])


def test_a_force_is_worked_out_without_loading_what_takes_a_second() -> None:
    code = (
        "import sys, numpy as np, aerobalance as ab\n"
        "t = np.arange(800) / 1600\n"
        "y = 100 * np.sin(40 * t) + np.random.default_rng(1).normal(0, 2, t.size)\n"
        "a = np.random.default_rng(2).normal(0, 0.3, t.size)\n"
        "run = ab.Recording.from_arrays(t, {'AF': y, 'ground_acceleration': a, 'pitch': 0 * t})\n"
        "force = ab.estimate_force(run, ab.Dynamics('AF', mass=177.87, stiffness=3.093e7, damping=828.21))\n"
        "ab.budget(force)\n"
        "slow = {'scipy.stats', 'scipy.signal', 'statsmodels', 'pandas', 'matplotlib'}\n"
        "print(sorted(slow & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == "[]"
