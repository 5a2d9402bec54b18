"""The calibration against the attainable bound, its speed, and the terms that it chooses against all of them."""

from __future__ import annotations

import time

import numpy as np

from aerobalance import _term_kernels as kernels
from aerobalance.balance import BalanceMatrix
from aerobalance.calibration.fit import calibrate
from aerobalance.channel import Array
from aerobalance.rigs.calibration_stand import CAPACITIES, CalibrationStand, SimulatedCalibration, random_balance
from aerobalance.terms import codes

NOISE = 0.7e-3


def generator() -> np.random.Generator:
    entropy = np.random.SeedSequence().entropy
    print(f"seed {entropy}")  # noqa: T201 - shown when a benchmark fails
    return np.random.default_rng(entropy)


def seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))


def tare_bound(balance: BalanceMatrix, run: SimulatedCalibration) -> Array:
    """Least standard deviation of the tares, over capacity, shape (s, c): Cramer-Rao, all unknowns together."""
    schedule = run.schedule
    x = np.ascontiguousarray((schedule.loads + run.tares[schedule.series]) / CAPACITIES)
    H = kernels.design(*codes(balance.terms), x)
    J = kernels.jacobians(*codes(balance.terms), balance.coefficients, x)
    (n, p), c, s = H.shape, 6, len(schedule.series_names)
    A = np.zeros((c * (n + 1), c * (p + s + 1)))
    for i in range(c):
        rows = slice(i * n, (i + 1) * n)
        A[rows, i * p : (i + 1) * p] = H
        for m in range(c):
            A[np.arange(n) + i * n, c * p + schedule.series * c + m] = J[:, i, m]
        A[rows, c * (p + s) + i] = 1
        A[c * n + i, c * (p + s) + i] = np.sqrt(len(schedule.natural_zeros))
    A *= np.concatenate([np.repeat(balance.output_scale, n), balance.output_scale])[:, None] / NOISE
    variance = np.diag(np.linalg.inv(A.T @ A))
    return np.sqrt(variance[c * p : c * (p + s)]).reshape(s, c)


def test_tares_beside_the_bound(record) -> None:
    rng = generator()
    scores = []
    for _ in range(15):
        balance = random_balance(seed(rng))
        run = CalibrationStand(balance, noise=NOISE).run(seed(rng))
        error = (calibrate(run.schedule, model="96").tares - run.tares) / CAPACITIES
        scores.append(np.mean((error / tare_bound(balance, run)) ** 2))
    ratio = 1 / np.sqrt(np.mean(scores))
    # 15 draws of 6 natural zeros and 96 tares: certain to some 7 %
    record("bound over error of the tares, 6x96 model, 16 series", ratio, 0.75)
    assert ratio > 0.75


def test_residuals_beside_the_noise(record) -> None:
    rng = generator()
    balance = random_balance(seed(rng))
    run = CalibrationStand(balance, noise=NOISE).run(seed(rng))
    matrix = calibrate(run.schedule, model="96").matrix
    ratio = NOISE / np.sqrt(np.mean((matrix.residual_deviation * matrix.output_scale) ** 2))
    record("noise over standard deviation of the residuals, 6x96 model", ratio, 0.9)
    assert ratio > 0.9


def test_calibration_beside_the_clock(record) -> None:
    rng = generator()
    run = CalibrationStand(random_balance(seed(rng))).run(seed(rng))
    calibrate(run.schedule, model="96")  # compiles the kernels
    begin = time.perf_counter()
    calibrate(run.schedule, model="96")
    spent = time.perf_counter() - begin
    record("five seconds over the time of a 6x96 calibration of 348 points", 5 / spent, 1.0)
    assert spent < 5


def test_loads_beside_the_clock(record) -> None:
    rng = generator()
    balance = random_balance(seed(rng))
    rate, count = 25_000.0, 100_000
    outputs = balance.outputs(rng.uniform(-0.9, 0.9, (count, 6)) * CAPACITIES)
    balance.loads(outputs[:10])
    begin = time.perf_counter()
    steps = balance.loads(outputs).steps
    spent = time.perf_counter() - begin
    record("length of the record over time to work out six loads, 6x96 model, 25 kHz", count / rate / spent, 1.0)
    assert steps.all()
    assert count / rate / spent > 1
