"""What is not known of a matrix's curvature, in loads that change: against matrices drawn from its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.calibration_nonlinearity import NonlinearErrors, _rectified
from aerobalance.balance.loads import Loads
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zeros import GaugeZero
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.recording import Recording
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, random_balance
from seeds import seed_from

NOISE = 0.7e-3
RATE, COUNT, HIGHEST = 1600.0, 16384, 200.0
NATURAL = np.array([40.0, 45.0, 60.0, 70.0, 90.0, 150.0])


def calibrated(rng: np.random.Generator, *, model: str, way: str = "iterative") -> BalanceMatrix:
    schedule = CalibrationStand(random_balance(seed_from(rng), model=model), noise=NOISE).run(seed_from(rng)).schedule
    return calibrate(schedule, model=model, way=way).matrix


def shaking(rng: np.random.Generator) -> Array:
    """Loads of a band of 5 to 60 Hz, shape (n, 6) [N, N*m]."""
    frequency = np.fft.rfftfreq(COUNT, 1 / RATE)
    inside = (frequency > 5) & (frequency < 60)
    phasors = inside[:, None] * (rng.normal(size=(frequency.size, 6)) + 1j * rng.normal(size=(frequency.size, 6)))
    loads = np.fft.irfft(phasors, COUNT, axis=0)
    return 0.12 * CAPACITIES * loads / loads.std(axis=0)  # capacity, the end of what is calibrated, is 8 deviations


def felt_by(matrix: BalanceMatrix, outputs: Array) -> Loads:
    gauges = {f"r{name}": outputs[:, place] for place, name in enumerate(matrix.gauges)}
    channels = {name: Channel(name, values, "mV/V", noise=0.0) for name, values in gauges.items()}
    recording = Recording.from_columns(np.arange(COUNT) / RATE, channels, name="run")
    plain = replace(matrix, geometry=None)
    return loads_of_outputs(recording, plain, zero=GaugeZero.taken_off(plain))


def ringing(frequency: Array) -> Array:
    """Components each for itself, without damping: -(f / f0)^2."""
    return -((frequency[:, None, None] / NATURAL[:, None]) ** 2) * np.eye(6) + 0j


def drawn(matrix: BalanceMatrix, rng: np.random.Generator) -> BalanceMatrix:
    """Another matrix that the calibration cannot tell from this one."""
    mixed = np.linalg.cholesky(matrix.residual_correlation) @ rng.normal(size=(6, len(matrix.terms)))
    change = [
        np.linalg.cholesky(part + 1e-12 * np.diag(np.diag(part))) @ one
        for part, one in zip(matrix.covariance, mixed, strict=True)
    ]
    return replace(matrix, coefficients=matrix.coefficients + np.array(change).T)


def variance_in_force(error: Array, loads: Array) -> Array:
    """Mean square of D e' + A e'' up to HIGHEST, what is linear in the loads taken off, shape (6,)."""
    shapes = np.column_stack([np.ones(COUNT), loads])
    curved = error - shapes @ np.linalg.lstsq(shapes, error, rcond=None)[0]
    frequency = np.fft.rfftfreq(COUNT, 1 / RATE)
    gain = np.einsum("mii->mi", ringing(frequency)) * (frequency <= HIGHEST)[:, None]
    return np.mean(np.fft.irfft(np.fft.rfft(curved, axis=0) * gain, COUNT, axis=0) ** 2, axis=0)


def mean_error(other: BalanceMatrix, matrix: BalanceMatrix, outputs: Array, loads: Array) -> Array:
    """Mean of the error, less that at the mean load, shape (6,)."""
    mean = loads.mean(axis=0)[None, :]
    return (other.loads(outputs).loads - loads).mean(axis=0) - (other.loads(matrix.outputs(mean)).loads - mean)[0]


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.soak(first=1)
def test_errors_of_matrices_drawn(way: str, rng) -> None:
    matrix = calibrated(rng, model="27", way=way)
    loads = shaking(rng)
    outputs = matrix.outputs(loads)
    felt = felt_by(matrix, outputs)
    curvature = NonlinearErrors.of(felt, rate=RATE, highest=HIGHEST)
    densities = curvature.in_force(ringing(curvature.resolved), list(matrix.components))
    foretold = np.array([curvature.as_noise(part, bandwidth=HIGHEST)[0] for part in densities.T])
    found = np.array(
        [variance_in_force(drawn(matrix, rng).loads(outputs).loads - felt.native, loads) for _ in range(24)]
    )
    ratio = found / foretold**2
    # 24 draws; and 6000 independent samples of 16384 in a window each, so that power differs from place to place by
    # 2 % and, between a window and no window, by about as much: 5 of these
    allowed = 5 * ratio.std(axis=0) / np.sqrt(24) + 0.1
    assert np.all(np.abs(ratio.mean(axis=0) - 1) < allowed), (ratio.mean(axis=0), allowed)


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.soak(first=1)
def test_means_of_errors_of_matrices_drawn(way: str, rng) -> None:
    matrix = calibrated(rng, model="27", way=way)
    outputs = matrix.outputs(shaking(rng))
    felt = felt_by(matrix, outputs)
    curvature = NonlinearErrors.of(felt, rate=RATE, highest=HIGHEST)
    foretold = [curvature.offset(name) for name in matrix.components]
    found = np.array([mean_error(drawn(matrix, rng), matrix, outputs, felt.native) for _ in range(24)])
    # normal deviates, as they are linear in the coefficients but for a percent
    squares = np.sum((found / foretold) ** 2, axis=0)
    low, high = (scipy.stats.chi2.ppf(p, 24) for p in (1e-6, 1 - 1e-6))
    assert np.all((0.97 * low < squares) & (squares < 1.03 * high)), squares


@pytest.mark.parametrize("period", [6, 12])
def test_a_load_that_goes_with_the_clock_is_seen_at_all_its_phases(period: int, rng) -> None:
    """Of so many samples a sixth is taken: of every sixth the load would be one phase, or two."""
    matrix = calibrated(rng, model="27")
    time = np.arange(44_000)[:, None]
    loads = (0.2 + 0.5 * np.cos(2 * np.pi * time / period + 0.2)) * matrix.load_scale
    few = _rectified(loads, matrix)
    whole = _rectified(loads[: 20 * period], matrix)  # whole periods of them, and no more than are taken
    # terms of loads from -0.3 to 0.7 lie within 0.5, and scatter by half of that at most: five of their mean's
    np.testing.assert_allclose(few, whole, atol=5 * 0.25 / np.sqrt(8192))


def test_a_linear_matrix_has_no_curvature(rng) -> None:
    matrix = calibrated(rng, model="linear")
    curvature = NonlinearErrors.of(felt_by(matrix, matrix.outputs(shaking(rng))), rate=RATE, highest=HIGHEST)
    densities = curvature.in_force(ringing(curvature.resolved), list(matrix.components))
    # what is left of a linear term is rounding: 1e-15 of capacity, enlarged by (200 / 40)^2
    deviations = [curvature.as_noise(part, bandwidth=HIGHEST)[0] for part in densities.T]
    assert np.all(np.array(deviations) < 1e-12 * CAPACITIES)
    assert np.all(np.array([curvature.offset(name) for name in matrix.components]) < 1e-12 * CAPACITIES)


def test_nothing_comes_of_a_band_without_frequencies(rng) -> None:
    matrix = calibrated(rng, model="27")
    curvature = NonlinearErrors.of(felt_by(matrix, matrix.outputs(shaking(rng))), rate=RATE, highest=HIGHEST)
    deviation, spectrum = curvature.as_noise(np.zeros(curvature.resolved.size), bandwidth=HIGHEST)
    assert deviation == 0 and spectrum.tolist() == [1.0]
