"""Two calibrations of one balance compared, and what temperature does to a calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from aerobalance.balance.calibration.comparison import SIGNIFICANCE, compare_calibrations
from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.matrix import BalanceMatrix, TemperatureEffect
from aerobalance.balance.schedule import Schedule
from aerobalance.recording.errors import FitError
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, random_balance
from seeds import seed_from

FALSE_ALARM = 1e-6


def calibrated(
    balance: BalanceMatrix, rng: np.random.Generator, *, model: str, way: str = "iterative"
) -> BalanceMatrix:
    return calibrate(CalibrationStand(balance).run(seed_from(rng)).schedule, model=model, way=way).matrix


def with_gain(balance: BalanceMatrix, component: int, gain: float) -> BalanceMatrix:
    """The same balance, one bridge of which gives more for every load."""
    scale = balance.output_scale.copy()
    scale[component] *= gain
    return replace(balance, output_scale=scale)


@pytest.mark.parametrize(
    ("model", "way"), [("linear", "iterative"), ("linear", "non-iterative"), ("abs", "iterative")]
)
@pytest.mark.soak(first=0)
def test_one_truth_twice_shows_no_drift(model: str, way: str, rng) -> None:
    alarms, scores = 0, []
    pairs = 40
    for _ in range(pairs):
        balance = random_balance(seed_from(rng), model=model)
        drift = compare_calibrations(*(calibrated(balance, rng, model=model, way=way) for _ in range(2)))
        alarms += sum(item.significant for item in drift.sensitivities)
        scores += [item.relative / item.u for item in drift.sensitivities]
    # false alarms are rare by design: 1 % of 240, at most so many as the binomial law allows
    assert alarms <= scipy.stats.binom.isf(FALSE_ALARM, 6 * pairs, SIGNIFICANCE)
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], 6 * pairs)
    # uncertainties have an estimated deviation of some 250 degrees of freedom: a percent
    assert low * 0.97 < np.sum(np.square(scores)) < high * 1.03


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.parametrize("gain", [1.01, 0.99])
def test_one_percent_is_found_with_its_sign(gain: float, way: str, rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    before = calibrated(balance, rng, model="linear", way=way)
    after = calibrated(with_gain(balance, 4, gain), rng, model="linear", way=way)
    drift = compare_calibrations(before, after)
    found = drift.sensitivities[4]
    assert found.component == "RM"
    assert found.significant
    assert abs(found.relative - (gain - 1)) < 5 * found.u < 0.002
    assert found.after / found.before == pytest.approx(1 + found.relative)
    # a bridge that gives 1 % more makes the first calibration's loads 1 % too small
    assert drift.load_difference[4] == pytest.approx(0.01, abs=0.002)
    assert drift.interactions[4, 4] == pytest.approx(found.relative, rel=1e-6)


def test_columns_are_matched_by_name(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    before = calibrated(balance, rng, model="linear")
    schedule = CalibrationStand(with_gain(balance, 2, 1.01)).run(seed_from(rng)).schedule
    order = [5, 3, 0, 2, 4, 1]
    names = ("Axial", "Y2", "N1", "Y1", "Mx", "N2")  # the other names of AF S2 N1 S1 RM N2
    mixed = replace(
        schedule,
        components=names,
        gauges=names,
        loads=schedule.loads[:, order],
        outputs=schedule.outputs[:, order],
        capacities=schedule.capacities[order],
        moments=schedule.moments[order],
        natural_zeros=schedule.natural_zeros[:, order],
    )
    straight = compare_calibrations(before, calibrate(schedule, model="linear").matrix)
    drift = compare_calibrations(before, calibrate(mixed, model="linear").matrix)
    # the same numbers in another order of summation
    for one, other in zip(drift.sensitivities, straight.sensitivities, strict=True):
        assert one.component == other.component
        assert one.relative == pytest.approx(other.relative, abs=1e-11)
        assert one.u == pytest.approx(other.u, rel=1e-6)
    np.testing.assert_allclose(drift.interactions, straight.interactions, rtol=0, atol=1e-11)
    np.testing.assert_allclose(drift.load_difference, straight.load_difference, rtol=0, atol=1e-10)
    assert drift.zero_change is not None
    np.testing.assert_allclose(drift.zero_change, straight.zero_change, rtol=0, atol=1e-14)


def test_different_capacities_compare(rng) -> None:
    schedule = CalibrationStand(random_balance(seed_from(rng), model="linear")).run(seed_from(rng)).schedule
    larger = replace(schedule, capacities=1.5 * schedule.capacities)
    drift = compare_calibrations(*(calibrate(item, model="linear").matrix for item in (schedule, larger)))
    for item in drift.sensitivities:
        assert item.relative == pytest.approx(0, abs=1e-10)
    assert (drift.load_difference < 1e-9).all()


def test_zeros_are_compared_where_both_have_them(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    before = calibrated(balance, rng, model="linear")
    shifted = replace(balance, natural_zero=balance.natural_zero + 0.01)
    change = compare_calibrations(before, calibrated(shifted, rng, model="linear")).zero_change
    # two means of four readings of 0.7 uV/V
    np.testing.assert_allclose(change, 0.01, atol=6 * 0.7e-3 / np.sqrt(2))
    stand = CalibrationStand(balance, natural_zeros=False, tare_size=0.0)
    without = calibrate(stand.run(seed_from(rng)).schedule, model="linear").matrix
    assert compare_calibrations(before, without).zero_change is None


def test_different_balances_are_refused() -> None:
    balance = random_balance(0, model="linear")
    other = replace(balance, components=("PM1", "PM2", "YM1", "YM2", "RM", "AF"))
    with pytest.raises(FitError, match="not calibrations of one balance: N1, N2, S1, S2, RM, AF and PM1, PM2"):
        compare_calibrations(balance, other)


# ---- temperature ------------------------------------------------------------------------------------------


def warm_schedule(
    balance: BalanceMatrix, effects: tuple[TemperatureEffect, ...], rng: np.random.Generator
) -> Schedule:
    stand = CalibrationStand(balance, tare_size=0.0, temperature_swing=4.0, temperature_effects=effects)
    return stand.run(seed_from(rng)).schedule


def some_effects(rng: np.random.Generator) -> tuple[TemperatureEffect, ...]:
    """Zeros move by some 0.2 uV/V/K, and sensitivities by some 0.01 %/K."""
    return tuple(TemperatureEffect(20.0, rng.normal(0, 2e-4), 0.0, rng.normal(0, 1e-4), 0.0) for _ in range(6))


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.soak(first=1)
def test_effects_of_temperature_come_back(way: str, rng) -> None:
    zeros, gains = [], []
    for _ in range(15):
        balance = random_balance(seed_from(rng), model="linear")
        effects = some_effects(rng)
        found = calibrate(warm_schedule(balance, effects, rng), model="linear", way=way).matrix.temperature
        for name, true in zip(balance.components, effects, strict=True):
            assert found[name].u_zero < 5e-5
            zeros.append((found[name].zero - true.zero) / found[name].u_zero)
            gains.append((found[name].sensitivity - true.sensitivity) / found[name].u_sensitivity)
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], len(zeros))
    # interactions of 3 % carry a little of one bridge's effect to another where loads are fitted
    for scores in (zeros, gains):
        assert low * 0.97 < np.sum(np.square(scores)) < high * 1.05


def test_effects_of_temperature_are_taken_out_of_the_residuals(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    effects = tuple(TemperatureEffect(20.0, 1e-3, 0.0, 5e-4, 0.0) for _ in range(6))  # up to 0.4 % of capacity
    schedule = warm_schedule(balance, effects, rng)
    fit = calibrate(schedule, model="linear")
    size = np.sqrt(np.mean((fit.residuals / CAPACITIES) ** 2, axis=0))
    noise = 0.7e-3 / balance.output_scale
    # a standard deviation of 348 points is certain to 1 / sqrt(2 * 348) = 4 %, and interactions add up to 5 %
    assert (size < noise * 1.3).all()
    assert fit.tares_by_iteration is not None
    np.testing.assert_allclose(fit.tares / CAPACITIES, fit.tares_by_iteration / CAPACITIES, rtol=0, atol=5e-5)


def test_steady_temperature_tells_no_effects(rng) -> None:
    schedule = CalibrationStand(random_balance(seed_from(rng), model="linear")).run(seed_from(rng)).schedule
    steady = replace(schedule, temperature=20 + rng.uniform(0, 0.5, len(schedule.points)))
    assert not calibrate(steady, model="linear").matrix.temperature
