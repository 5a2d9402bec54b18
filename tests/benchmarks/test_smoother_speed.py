"""A pass of the smoother with its variance, over a Fourier transform there and back of the same record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import irfft, rfft

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.statespace.kalman import FORCE, KalmanFilter
from helpers.accuracy import RIG, SHARP, T128, smooth_run
from helpers.yardstick import spent


@pytest.mark.alone
@pytest.mark.parametrize(("n", "most"), [(100_000, 30.0), (1_000_000, 4.0)])
@pytest.mark.parametrize("place", ["T-128", "rig"])
def test_smoothing_pass_with_variance(place: str, n: int, most: float, record, rng) -> None:
    """The steady filter costs some milliseconds, and it remembers four seconds at 25 kHz where an edge is sharp."""
    dynamics, rate = {"T-128": (T128, 1600.0), "rig": (RIG, 25e3)}[place]
    run, _ = smooth_run(rng, SHARP["0-300 Hz"], dynamics=dynamics, rate=rate, rms=500.0, noise=2.0, seconds=4.0)
    reading = Observation(run.channel("AF").values, 1 / rate, dynamics)
    system = reading.system(fit_prior(reading, columns=np.ones((reading.values.size, 1))))
    values, present = rng.normal(0, 100, (n, 1)), np.ones(n, dtype=bool)

    def smooth() -> None:
        filter_ = KalmanFilter.of(system, present)
        filter_.smooth(values, [FORCE])
        filter_.smoothed_variance  # noqa: B018

    ratio = spent(smooth, runs=3, first=False) / spent(lambda: irfft(rfft(values[:, 0]), n), runs=3, first=False)
    record(f"{most:g} over the transforms that smoothing of {n} samples costs, {place}", most / ratio, 1.0)
    assert ratio < 2 * most  # transforms of a megabyte gain more from a processor that nobody else uses
