"""The calibration against the attainable bound, its speed, and the terms that it chooses against all of them."""

from __future__ import annotations

import time

import numpy as np

from aerobalance.calibration.fit import calibrate
from aerobalance.rigs.calibration_stand import CAPACITIES, CalibrationStand, random_balance
from seeds import generator, seed_from
from tare_bound import tare_bound

NOISE = 0.7e-3


def test_tares_beside_the_bound(record) -> None:
    rng = generator()
    scores = []
    for _ in range(15):
        balance = random_balance(seed_from(rng))
        run = CalibrationStand(balance, noise=NOISE).run(seed_from(rng))
        error = (calibrate(run.schedule, model="96").tares - run.tares) / CAPACITIES
        bound = np.diag(tare_bound(balance, run, noise=NOISE)).reshape(error.shape)
        scores.append(np.mean(error**2 / bound))
    ratio = 1 / np.sqrt(np.mean(scores))
    # 15 draws of 6 natural zeros and 96 tares: certain to some 7 %
    record("bound over error of the tares, 6x96 model, 16 series", ratio, 0.75)
    assert ratio > 0.75


def test_residuals_beside_the_noise(record) -> None:
    rng = generator()
    balance = random_balance(seed_from(rng))
    run = CalibrationStand(balance, noise=NOISE).run(seed_from(rng))
    matrix = calibrate(run.schedule, model="96").matrix
    ratio = NOISE / np.sqrt(np.mean((matrix.residual_deviation * matrix.output_scale) ** 2))
    record("noise over standard deviation of the residuals, 6x96 model", ratio, 0.9)
    assert ratio > 0.9


def test_calibration_beside_the_clock(record) -> None:
    rng = generator()
    run = CalibrationStand(random_balance(seed_from(rng))).run(seed_from(rng))
    calibrate(run.schedule, model="96")  # compiles the kernels
    begin = time.perf_counter()
    calibrate(run.schedule, model="96")
    spent = time.perf_counter() - begin
    record("five seconds over the time of a 6x96 calibration of 348 points", 5 / spent, 1.0)
    assert spent < 5


def test_loads_beside_the_clock(record) -> None:
    rng = generator()
    balance = random_balance(seed_from(rng))
    rate, count = 25_000.0, 100_000
    outputs = balance.outputs(rng.uniform(-0.9, 0.9, (count, 6)) * CAPACITIES)
    balance.loads(outputs[:10])
    begin = time.perf_counter()
    steps = balance.loads(outputs).steps
    spent = time.perf_counter() - begin
    record("length of the record over time to work out six loads, 6x96 model, 25 kHz", count / rate / spent, 1.0)
    assert steps.all()
    assert count / rate / spent > 1
