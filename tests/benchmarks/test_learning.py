"""What it costs to learn spectrum and noise from a record, over a Fourier transform of it there and back.

The yardstick is `scipy.fft.rfft` and `irfft` of the same readings, warm, in processor time of the same run.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import irfft, rfft, rfftfreq

from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.spectra.line_noise import hum_lines
from aerobalance.recording.channel import Array
from helpers.accuracy import RIG
from helpers.yardstick import spent

RATE = 25_000.0
LENGTHS = (100_000, 1_000_000, 10_000_000)


def smooth(rng: np.random.Generator, count: int) -> Array:
    """Readings of the rig under a load of 100 N rms up to 900 Hz, in noise of 0.5 N."""
    frequency = rfftfreq(count, 1 / RATE)
    inside = (frequency > 0) & (frequency < 900)
    phasors = np.zeros(frequency.size, dtype=np.complex128)
    drawn = rng.normal(size=(2, np.count_nonzero(inside)))
    phasors[inside] = (drawn[0] + 1j * drawn[1]) * RIG.response(frequency[inside])
    felt = irfft(phasors, count) * (100.0 * count / np.sqrt(4 * np.count_nonzero(inside)))
    return felt + rng.normal(0, 0.5, count)


@pytest.mark.alone
def test_learning_beside_the_transform(record, rng) -> None:
    learning, hum, transform = [], [], []
    for count in LENGTHS:
        values = smooth(rng, count)
        reading, constant = Observation(values, 1 / RATE, RIG), np.ones((count, 1))
        learning.append(
            spent(lambda reading=reading, constant=constant: fit_prior(reading, columns=constant), runs=3, first=False)
        )
        hum.append(spent(lambda values=values: hum_lines(values, 1 / RATE), runs=3, first=False))
        transform.append(spent(lambda values=values: irfft(rfft(values), values.size), runs=3, first=False))
        record(f"R of learning from {count:.0e} samples, 60 over it", 60 * transform[-1] / learning[-1], 1.0)
    # what does not grow with the length is a few hundred averages' work: some 30 ms, 20 transforms of 1e5 samples
    assert learning[0] < 60 * transform[0]
    further = (learning[-1] - learning[0]) / (transform[-1] - transform[0])
    record("2 transforms over what learning from a further sample costs, 1e5 to 1e7", 2 / further, 1.0)
    assert further < 2
    beside = (hum[-1] - hum[0]) / (transform[-1] - transform[0])
    record("4 transforms over what looking for hum in a further sample costs, 1e5 to 1e7", 4 / beside, 1.0)
    assert beside < 4


@pytest.mark.alone
@pytest.mark.parametrize("count", LENGTHS[:2])
def test_learning_with_a_given_noise_costs_no_more(count: int, record, rng) -> None:
    values, constant = smooth(rng, count), np.ones((count, 1))
    free, given = (
        spent(
            lambda noise=noise: fit_prior(Observation(values, 1 / RATE, RIG, noise=noise), columns=constant),
            runs=3,
            first=False,
        )
        for noise in (None, 0.5)
    )
    record(f"learning from {count:.0e} samples, time with the noise free over that with it given", free / given, 0.5)
    assert given < 2 * free
