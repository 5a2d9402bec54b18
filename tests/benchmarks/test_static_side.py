"""The calibration against the attainable bound, its speed, and the terms that it chooses against all of them."""

from __future__ import annotations

import time

import numpy as np
import pytest
from statsmodels.regression.linear_model import OLS

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.calibration.normalised_points import NormalisedPoints
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import codes
from aerobalance.recording.channel import Array
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, random_balance
from helpers.tare_bound import tare_bound
from helpers.yardstick import spent
from seeds import seed_from

NOISE = 0.7e-3


def test_tares_beside_the_bound(record, rng) -> None:
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


def test_residuals_beside_the_noise(record, rng) -> None:
    balance = random_balance(seed_from(rng))
    run = CalibrationStand(balance, noise=NOISE).run(seed_from(rng))
    matrix = calibrate(run.schedule, model="96").matrix
    ratio = NOISE / np.sqrt(np.mean((matrix.residual_deviation * matrix.output_scale) ** 2))
    record("noise over standard deviation of the residuals, 6x96 model", ratio, 0.9)
    assert ratio > 0.9


@pytest.mark.parametrize("truth", ["linear", "abs", "quadratic", "96"])
def test_chosen_terms_beside_other_choices(record, truth: str, rng) -> None:
    ways = {"auto": [], "all of the 96": [], "elimination by Student's t": [], "the terms of the balance": []}
    for _ in range(6):
        balance = random_balance(seed_from(rng), model=truth)
        schedule = CalibrationStand(balance, noise=NOISE).run(seed_from(rng)).schedule
        loads = rng.uniform(-0.6, 0.6, (500, 6))
        outputs = balance.outputs(loads * CAPACITIES)
        auto, whole = calibrate(schedule, model="auto").matrix, calibrate(schedule, model="96")
        steps = by_students_t(schedule, whole.tares / CAPACITIES, whole.matrix)
        own = calibrate(schedule, model=truth).matrix
        for way, matrix, C in (
            ("auto", auto, auto.coefficients),
            ("all of the 96", whole.matrix, whole.matrix.coefficients),
            ("elimination by Student's t", whole.matrix, steps),
            ("the terms of the balance", own, own.coefficients),
        ):
            given = kernels.design(*codes(matrix.terms), loads) @ C
            ways[way].append(np.sqrt(np.mean((given - outputs / matrix.output_scale) ** 2)))
    rms = {way: float(np.sqrt(np.mean(np.square(each)))) for way, each in ways.items()}
    for way in list(ways)[1:]:
        record(f"error with {way} over error with auto, a balance of the model {truth}", rms[way] / rms["auto"], 0.0)
    assert rms["auto"] < rms["all of the 96"]
    assert rms["auto"] < rms["elimination by Student's t"]


def by_students_t(schedule: Schedule, tares: Array, matrix: BalanceMatrix) -> Array:
    """Least squares without the terms that are not significant at 5 %, taken out one by one, shape (t, c)."""
    data = NormalisedPoints.of(schedule, "iterative")
    design = data.design(matrix.terms, data.variables(tares))
    linear = np.array([term.kind == 0 for term in matrix.terms])
    C = np.zeros_like(matrix.coefficients)
    for i, values in enumerate(data.targets.T):
        kept = np.arange(linear.size)
        while True:
            fit = OLS(values, np.hstack([design[:, kept], data.intercepts])).fit()
            p = np.where(linear[kept], 0.0, fit.pvalues[: kept.size])
            if p.max() < 0.05:
                break
            kept = np.delete(kept, np.argmax(p))
        C[kept, i] = fit.params[: kept.size]
    return C


@pytest.mark.alone
def test_calibration_beside_the_clock(record, rng) -> None:
    run = CalibrationStand(random_balance(seed_from(rng))).run(seed_from(rng))
    calibrate(run.schedule, model="96")  # compiles the kernels
    begin = time.perf_counter()
    calibrate(run.schedule, model="96")
    spent = time.perf_counter() - begin
    record("five seconds over the time of a 6x96 calibration of 348 points", 5 / spent, 1.0)
    assert spent < 5


@pytest.mark.alone
def test_loads_beside_numpy_and_a_copy(record, rng) -> None:
    """Eq. (2) to 1e-10 of capacity: the iteration as numpy does it, and the copying of as many frames."""
    balance = random_balance(seed_from(rng), model="quadratic")
    outputs = balance.outputs(rng.uniform(-0.9, 0.9, (200_000, 6)) * CAPACITIES)
    assert balance.loads(outputs).steps.all()
    found, expected = (loads / CAPACITIES for loads in (balance.loads(outputs).loads, by_equation_2(balance, outputs)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    many = np.tile(outputs, (20, 1))  # beyond what a processor keeps beside it
    ours = spent(lambda: balance.loads(outputs), runs=5, first=False)
    iteration = spent(lambda: by_equation_2(balance, outputs), runs=5, first=False)
    copy = spent(many.copy, runs=5, first=False) / 20
    record("time of Eq. (2) iterated in numpy over that of six loads, 27 terms, to 1e-10", iteration / ours, 60.0)
    record("time of a copy over that of six loads, 27 terms", copy / ours, 0.08)
    assert iteration / ours > 10
    assert copy / ours > 0.02  # half the bandwidth of memory may be another's


def by_equation_2(balance: BalanceMatrix, outputs: Array) -> Array:
    """Loads by the iteration of Eq. (2), all samples at once, until none moves by more than 1e-10 of its capacity."""
    form = balance.paper_form()
    start = form.own * outputs
    loads = start
    for _ in range(200):
        products = np.einsum("irs,nr,ns->ni", form.square, loads, loads, optimize=True)
        before, loads = loads, start + loads @ form.cross.T + products
        if np.max(np.abs(loads - before) / CAPACITIES) < 1e-10:
            return loads
    raise AssertionError("the iteration does not end")


@pytest.mark.alone
def test_loads_beside_the_clock(record, rng) -> None:
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
