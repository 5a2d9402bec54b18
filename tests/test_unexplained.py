"""What readings show of a force that the model of the load misses is worked back where it stands out."""

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.unexplained import excess_of, missed_force, sudden_excess
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.steps import columns_of

MASS, FREQUENCY, RATIO, RATE, NOISE = 177.87, 66.4, 0.01, 1600.0, 2.0
OMEGA = 2 * np.pi * FREQUENCY
T128 = Dynamics("AF", MASS, MASS * OMEGA**2, 2 * RATIO * MASS * OMEGA)
COUNT = 4096
TIME = np.arange(COUNT) / RATE


@pytest.fixture
def calm(rng):
    """A record of noise, and what is learned of it."""
    reading = Observation(NOISE * rng.standard_normal(COUNT), 1 / RATE, T128)
    return reading, fit_prior(reading, columns=columns_of([], reading))


@pytest.mark.parametrize("frequency", [30.0, 190.0])
def test_a_force_of_a_while_is_worked_back(calm, frequency, rng):
    reading, learned = calm
    gain = T128.response(np.array([frequency]))[0]
    size = 100.0 * NOISE / abs(gain)  # far above the noise, at any frequency
    wave = np.exp(2j * np.pi * frequency * TIME)
    late = TIME > 1.0
    residuals = reading.values + np.where(late, np.real(size * gain * wave), 0.0)
    found = missed_force(reading, learned, residuals=residuals, strange=late)
    inner = np.abs(TIME - 1.75) < 0.4
    # the response changes by 6 % over the lobe of the window at 190 Hz, by 2 % at 30 Hz; noise is a hundredth
    error = found[inner] - np.real(size * wave)[inner]
    assert np.sqrt(np.mean(error**2)) < 0.1 * size
    assert not found[TIME < 1.0 - 512 / RATE].any()


def test_noise_that_is_stronger_for_a_while_is_no_force(calm, rng):
    reading, learned = calm
    burst = (TIME > 1.0) & (TIME < 1.5)
    residuals = reading.values + np.where(burst, 4 * NOISE * rng.standard_normal(COUNT), 0.0)
    level, edges = excess_of(residuals / NOISE)
    strange = np.repeat(level > 1, np.diff(edges))
    assert strange[burst].mean() > 0.7
    assert not strange[TIME < 0.8].any()
    found = missed_force(reading, learned, residuals=residuals, strange=strange)
    # e^-12 at each of 257 frequencies of a dozen blocks: a line passes once in fifty bursts, and is one of 257
    assert np.count_nonzero(found) < 1024


def test_a_short_record_has_no_stretches(calm):
    reading, learned = calm
    few = Observation(reading.values[:300], 1 / RATE, T128)
    assert not missed_force(few, learned, residuals=few.values, strange=np.ones(300, dtype=bool)).any()


def test_something_sudden_is_told_from_chance_and_from_a_neighbour(rng):
    white = rng.normal(size=200_000)
    # 1e-9 for each of three times 200,000 windows
    assert (sudden_excess(white, reach=10) == 1).all()
    white[1000] += 30.0
    level = sudden_excess(white, reach=10)
    near = slice(1000 - 3 - 10, 1000 + 4 + 10)  # every window of four samples that holds it, and what is beside
    assert level[near].min() > (30 - 5) ** 2 / 4
    assert (np.flatnonzero(level > 1)[[0, -1]] == [1000 - 63 - 10, 1000 + 63 + 10]).all()


def test_something_sudden_in_few_readings_is_seen_over_fewer(rng):
    """Five readings hold no window of 16: those of four tell it alone."""
    white = np.array([0.3, -0.5, 30.0, 0.2, 0.8])
    expected = max(np.mean(white[:4] ** 2), np.mean(white[1:] ** 2))
    assert sudden_excess(white, reach=5) == pytest.approx(np.full(5, expected))
