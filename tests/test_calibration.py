"""Calibration on the simulated stand: coefficients, tares and loads against the truth, statistics against oracles."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from aerobalance.balance.calibration.fit import Calibration, calibrate
from aerobalance.balance.calibration.fit_warnings import warn_of_weaknesses
from aerobalance.balance.calibration.quality import assess
from aerobalance.balance.calibration.regression import regress
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import terms_of
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, SimulatedCalibration, random_balance
from helpers.tare_bound import tare_bound
from seeds import new_seed, seed_from, trials

NOISE = 0.7e-3
FALSE_ALARM = 1e-6


def plain_schedule(
    loads: Array, outputs: Array, *, series: Array | None = None, zeros: Array | None = None
) -> Schedule:
    n, c = loads.shape
    numbers = np.zeros(n, dtype=np.intp) if series is None else series
    names = ("N1", "N2", "S1", "S2", "RM", "AF")[:c]
    return Schedule(
        name="test",
        components=names,
        gauges=names,
        loads=loads,
        outputs=outputs,
        series=numbers,
        series_names=tuple(f"series {k + 1}" for k in range(int(numbers.max()) + 1)),
        points=tuple(f"P-{k}" for k in range(n)),
        capacities=CAPACITIES[:c],
        moments=np.array([name == "RM" for name in names]),
        load_units=("N",) * c,
        natural_zeros=np.zeros((0, c)) if zeros is None else zeros,
        confirmation=np.zeros(n, dtype=bool),
    )


def single_loads(
    balance: BalanceMatrix, rng: np.random.Generator, *, noise: float = NOISE, low: float = -1
) -> Schedule:
    """One load at a time, one series a component and sign, without natural zeros: as .vol files have it."""
    rows, series = [], []
    for number, (k, sign) in enumerate(itertools.product(range(6), (1, -1) if low < 0 else (1,))):
        for step in (0, 0.2, 0.4, 0.6, 0.8, 1, 0.5, 0):
            rows.append(sign * step * np.eye(6)[k])
            series.append(number)
    loads = np.array(rows) * CAPACITIES
    outputs = balance.outputs(loads) + 0.02 + rng.normal(0, noise, loads.shape)
    return plain_schedule(loads, outputs, series=np.array(series))


# ---- Eq. (2) --------------------------------------------------------------------------------------------


def test_equation_2_comes_back_to_rounding(rng) -> None:
    own = CAPACITIES / rng.uniform(0.8, 1.4, 6) * rng.choice([-1, 1], 6)
    cross = rng.normal(0, 0.03, (6, 6)) * CAPACITIES[:, None] / CAPACITIES
    np.fill_diagonal(cross, 0)
    square = rng.normal(0, 0.004, (6, 6, 6)) * CAPACITIES[:, None, None] / np.outer(CAPACITIES, CAPACITIES)
    square *= np.triu(np.ones((6, 6)))
    loads = CalibrationStand(random_balance(0)).run(seed_from(rng)).schedule.loads
    series = np.zeros(len(loads), dtype=np.intp)
    # Eq. (2) solved for N_i, term by term
    outputs = np.empty_like(loads)
    for k, X in enumerate(loads):
        for i in range(6):
            value = X[i]
            for j in range(6):
                value -= cross[i, j] * X[j] if j != i else 0.0
                for s in range(j, 6):
                    value -= square[i, j, s] * X[j] * X[s]
            outputs[k, i] = value / own[i]
    fit = calibrate(plain_schedule(loads, outputs, series=series, zeros=np.zeros((4, 6))), model="quadratic")
    form = fit.matrix.paper_form()
    # the design's condition number, with its 28 columns and n points, multiplies the roundings of the readings
    tolerance = 10 * fit.condition * np.finfo(float).eps * 28
    assert tolerance < 1e-10
    np.testing.assert_allclose(form.own / own, 1, rtol=0, atol=tolerance)
    np.testing.assert_allclose((form.cross - cross) / CAPACITIES[:, None] * CAPACITIES, 0, atol=tolerance)
    scale = CAPACITIES[:, None, None] / np.outer(CAPACITIES, CAPACITIES)
    np.testing.assert_allclose((form.square - square) / scale, 0, atol=tolerance)
    assert np.max(np.abs(fit.tares / CAPACITIES)) < tolerance


# ---- the 6x96 truth on sixteen series -------------------------------------------------------------------


@pytest.fixture(scope="module")
def draws() -> list[tuple[BalanceMatrix, SimulatedCalibration, Calibration]]:
    rng = np.random.default_rng(new_seed())
    found = []
    for _ in range(trials(8, 20)):
        balance = random_balance(seed_from(rng))
        run = CalibrationStand(balance, noise=NOISE).run(seed_from(rng))
        found.append((balance, run, calibrate(run.schedule, model="96")))
    return found


def test_coefficients_are_covered(draws) -> None:
    ratios = []
    for balance, _, fit in draws:
        assert fit.matrix.terms == balance.terms
        gain = fit.matrix.output_scale / balance.output_scale
        for i in range(6):
            error = fit.matrix.coefficients[:, i] - balance.coefficients[:, i] / gain[i]
            ratios.append(error @ np.linalg.solve(fit.matrix.covariance[i], error) / 96)
    freedom = int(draws[0][2].matrix.degrees_of_freedom[0])
    law = scipy.stats.f(96, freedom)  # the covariance has an estimated deviation
    limit = scipy.stats.norm.isf(FALSE_ALARM / 2) * law.std() / np.sqrt(len(ratios))
    # the fit takes the tares as known but for the intercepts: of second order, and below a tenth of the variance
    assert abs(np.mean(ratios) - law.mean()) < limit + 0.1, f"{np.mean(ratios)} is not {law.mean()} +- {limit}"


def test_tares_reach_the_bound_and_are_covered(draws) -> None:
    scores, over_bound, spread = [], [], []
    for balance, run, fit in draws:
        covariance = tare_bound(balance, run, noise=NOISE)
        error = ((fit.tares - run.tares) / CAPACITIES).ravel()
        bound = np.sqrt(np.diag(covariance))
        scores.append(np.mean((error / (fit.u_tares / CAPACITIES).ravel()) ** 2))
        over_bound.append(np.mean((error / bound) ** 2))
        correlation = covariance / np.outer(bound, bound)
        # mean of squares of correlated normal numbers
        spread.append(2 * np.sum(correlation**2) / error.size**2)
    limit = scipy.stats.norm.isf(FALSE_ALARM / 2) * np.sqrt(np.mean(spread) / len(draws))
    assert limit < 0.6
    assert abs(np.mean(over_bound) - 1) < limit
    # the deviation is estimated, from 236 readings or so in six components: 2 % at most
    assert abs(np.mean(scores) - 1) < limit + 0.05


def test_longer_series_tell_tares_to_three_hundredths_of_a_percent(rng) -> None:
    balance = random_balance(seed_from(rng))
    run = CalibrationStand(balance, noise=NOISE, repeats=4).run(seed_from(rng))
    error = (calibrate(run.schedule, model="96").tares - run.tares) / CAPACITIES
    covariance = tare_bound(balance, run, noise=NOISE)
    # the requirement, as a standard deviation: 0.03 % of capacity; 0.7 uV/V is 0.05-0.08 % of it a reading
    assert np.sqrt(np.mean(np.diag(covariance))) < 0.028e-2
    assert np.sqrt(np.mean(error**2)) < 0.03e-2 * 1.5
    bound = np.sqrt(np.diag(covariance))
    assert np.max(np.abs(error.ravel()) / bound) < scipy.stats.norm.isf(FALSE_ALARM / 2 / error.size) * 1.1


def test_both_ways_to_the_tares_agree(draws) -> None:
    for balance, run, fit in draws[:5]:
        assert fit.tares_by_iteration is not None
        loads = run.schedule.loads + run.tares[run.schedule.series]
        # one averages residuals as outputs, the other as loads: they differ by as much as the sensitivity changes over
        # a series, times the part of noise that makes a tare uncertain
        S = balance.sensitivity(loads) * balance.output_scale / CAPACITIES[:, None]
        change = np.max(np.linalg.norm(S - S.mean(axis=0), axis=2))
        limit = 5 * change * np.max(fit.u_tares / CAPACITIES)
        assert np.max(np.abs(fit.tares - fit.tares_by_iteration) / CAPACITIES) < limit < 5e-4


def test_heavy_fixtures_without_noise(rng) -> None:
    balance = random_balance(seed_from(rng))
    run = CalibrationStand(balance, tare_size=0.1).without_noise().run(seed_from(rng))
    fit = calibrate(run.schedule, model="96")
    assert fit.tares_by_iteration is not None
    # the searches end at a last step of 1e-12 and 1e-9 of capacity. A round of the iteration takes off a hundredth of
    # the error, as most of a tare passes for even terms, so that 1e-7 is left, and ten times that is allowed
    np.testing.assert_allclose(fit.tares / CAPACITIES, run.tares / CAPACITIES, rtol=0, atol=1e-11)
    np.testing.assert_allclose(fit.tares_by_iteration / CAPACITIES, run.tares / CAPACITIES, rtol=0, atol=1e-6)


def test_residuals_are_the_noise(draws) -> None:
    squares = freedom = 0.0
    for _, _, fit in draws:
        for i, part in enumerate(fit.regressions):
            n = part.residuals.size
            assert part.degrees_of_freedom == n - 96 - 16
            np.testing.assert_allclose(part.deviation**2 * part.degrees_of_freedom, np.sum(part.residuals**2))
            squares += np.sum((part.residuals * fit.matrix.output_scale[i]) ** 2) / NOISE**2
            freedom += part.degrees_of_freedom
    low, high = scipy.stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], freedom)
    assert low < squares < high


@pytest.mark.parametrize("model", ["linear", "96"])
def test_iterative_and_non_iterative_matrices_agree(model: str, rng) -> None:
    balance = random_balance(seed_from(rng), model=model)
    schedule = CalibrationStand(balance, noise=NOISE).run(seed_from(rng)).schedule
    one, other = (calibrate(schedule, model=model, way=way).matrix for way in ("iterative", "non-iterative"))
    # the loads of another run of the stand: the range that was calibrated
    outputs = balance.outputs(CalibrationStand(balance).run(seed_from(rng)).schedule.loads)
    difference = (one.loads(outputs).loads - other.loads(outputs).loads) / CAPACITIES
    # each is uncertain by its residuals; a linear balance needs no inverse of higher order, which leaves rounding and
    # the noise squared
    noise = np.hypot(one.residual_deviation, other.residual_deviation)
    assert (np.sqrt(np.mean(difference**2, axis=0)) < noise * (0.1 if model == "linear" else 1)).all()


def test_tares_without_noise_are_exact(rng) -> None:
    balance = random_balance(seed_from(rng))
    run = CalibrationStand(balance).without_noise().run(seed_from(rng))
    fit = calibrate(run.schedule, model="96")
    # the search ends at a last step of 1e-12 of capacity and shrinks its error tenfold a step or better
    np.testing.assert_allclose(fit.tares / CAPACITIES, run.tares / CAPACITIES, rtol=0, atol=1e-11)
    gain = fit.matrix.output_scale / balance.output_scale
    np.testing.assert_allclose(fit.matrix.coefficients * gain, balance.coefficients, rtol=0, atol=1e-10)


def test_nothing_absolute_without_natural_zeros(rng) -> None:
    schedule = (
        CalibrationStand(random_balance(seed_from(rng)), natural_zeros=False, tare_size=0.0)
        .run(seed_from(rng))
        .schedule
    )
    fit = calibrate(schedule, model="96")
    assert fit.tares_by_iteration is None
    assert fit.matrix.natural_zero is None
    assert not fit.tares.any()
    assert np.isnan(fit.u_tares).all()


# ---- uncertainty of the loads ---------------------------------------------------------------------------


def cover_of_errors(model: str, rng: np.random.Generator, *, count: int) -> Array:
    """Variances of errors of loads over those foretold, shape (points, c), from many calibrations of one balance."""
    balance = random_balance(seed_from(rng), model=model)
    loads = rng.uniform(-0.9, 0.9, (4, 6)) * CAPACITIES
    outputs = balance.outputs(loads)
    errors, foretold = [], []
    for _ in range(count):
        matrix = calibrate(CalibrationStand(balance, noise=NOISE).run(seed_from(rng)).schedule, model=model).matrix
        errors.append(matrix.loads(outputs).loads - loads)
        foretold.append(matrix.load_covariance(loads, residual=False))
    mean = np.mean(foretold, axis=0)
    whitened = np.array(
        [[np.linalg.solve(np.linalg.cholesky(S), e) for S, e in zip(mean, row, strict=True)] for row in errors]
    )
    return np.mean(whitened**2, axis=0)


@pytest.mark.parametrize(
    ("model", "fixed", "soak"),
    [("abs", 15, 100), ("linear", 30, 100), pytest.param("96", 20, 40, marks=pytest.mark.slow)],
)
@pytest.mark.soak(first=1)
def test_covariance_of_loads_against_monte_carlo(model: str, fixed: int, soak: int, rng) -> None:
    count = trials(fixed, soak)
    ratio = cover_of_errors(model, rng, count=count)
    # six components are independent; the four loads of one draw need not be
    limit = scipy.stats.norm.isf(FALSE_ALARM / 2) * np.sqrt(2 / (6 * count))
    assert abs(ratio.mean() - 1) < limit + 0.05, f"{ratio.mean()} is not 1 +- {limit}"


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_known_noise_of_the_readings_is_not_counted_as_scatter(way: str, rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    schedule = CalibrationStand(balance, noise=NOISE).run(seed_from(rng)).schedule
    plain = calibrate(schedule, model="linear", way=way).matrix
    matrix = calibrate(schedule, model="linear", way=way, reading_noise=NOISE).matrix
    loads = rng.uniform(-0.9, 0.9, (4, 6)) * CAPACITIES
    np.testing.assert_array_equal(matrix.load_covariance(loads, reading=True), plain.load_covariance(loads))
    # a variance from n degrees of freedom is right to sqrt(2 / n): that much of the noise may be left over
    noise, freedom = matrix.noise_of_readings**2, matrix.degrees_of_freedom
    left = np.maximum(plain.residual_deviation**2 - noise, 0) / noise
    assert np.all(left < scipy.stats.norm.isf(FALSE_ALARM) * np.sqrt(2 / freedom)), left
    rest = replace(plain, residual_deviation=np.sqrt(left * noise))
    np.testing.assert_allclose(matrix.load_covariance(loads), rest.load_covariance(loads), rtol=1e-9)


def test_readings_quieter_than_the_noise_given_are_doubted(rng) -> None:
    noise = 0.2e-3  # so small that no reading is an outlier, which takes 2.5e-3
    schedule = (
        CalibrationStand(random_balance(seed_from(rng), model="linear"), noise=noise).run(seed_from(rng)).schedule
    )
    fit = calibrate(schedule, model="linear", reading_noise=3 * noise)
    with pytest.warns(DataQualityWarning, match=r"scatter less about the matrix than .* the 0\.0006 mV/V"):
        warn_of_weaknesses(fit, assess(fit))
    fit = calibrate(schedule, model="linear", reading_noise=noise)
    warn_of_weaknesses(fit, assess(fit))
    with pytest.raises(ValueError, match="reading_noise must be zero or positive"):
        calibrate(schedule, model="linear", reading_noise=-noise)


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_bridges_have_each_its_own_noise(way: str, rng) -> None:
    noise = 1e-4 * np.array([1.0, 2.0, 0.5, 1.5, 1.0, 3.0])  # so small that no reading is an outlier
    balance = random_balance(seed_from(rng), model="linear")
    schedule = CalibrationStand(balance, noise=0.0).run(seed_from(rng)).schedule
    schedule = replace(schedule, outputs=schedule.outputs + rng.normal(0, noise, schedule.outputs.shape))
    by_bridge = dict(zip((f"r{name}" for name in schedule.gauges), noise.tolist(), strict=True))
    fit = calibrate(schedule, model="linear", way=way, reading_noise=by_bridge)
    np.testing.assert_array_equal(fit.matrix.reading_noise, noise)
    warn_of_weaknesses(fit, assess(fit))
    # chi-squares over their degrees of freedom
    found, freedom = fit.matrix.residual_deviation, fit.matrix.degrees_of_freedom
    ratio = (found / fit.matrix.noise_of_readings) ** 2 - 1
    assert np.all(np.abs(ratio) < scipy.stats.norm.isf(FALSE_ALARM / 2) * np.sqrt(2 / freedom) + 20 / freedom), ratio
    # a bridge that is not named keeps its scatter; r may be left out
    some = calibrate(schedule, model="linear", way=way, reading_noise={schedule.gauges[1]: 2e-4}).matrix
    np.testing.assert_array_equal(some.reading_noise, [0, 2e-4, 0, 0, 0, 0])
    with pytest.raises(ValueError, match="given for rXX, which is no bridge of the schedule; it has r"):
        calibrate(schedule, model="linear", way=way, reading_noise={"rXX": 1e-4})


def test_one_noise_for_bridges_that_differ_is_doubted_for_the_quiet_ones(rng) -> None:
    noise = 1e-4 * np.array([1.0, 0.25, 1.0, 1.0, 1.0, 1.0])
    balance = random_balance(seed_from(rng), model="linear")
    schedule = CalibrationStand(balance, noise=0.0).run(seed_from(rng)).schedule
    schedule = replace(schedule, outputs=schedule.outputs + rng.normal(0, noise, schedule.outputs.shape))
    fit = calibrate(schedule, model="linear", reading_noise=1e-4)
    with pytest.warns(DataQualityWarning) as caught:
        warn_of_weaknesses(fit, assess(fit))
    (text,) = (str(item.message) for item in caught)
    quiet = f"r{schedule.gauges[1]}"
    assert [f"r{name}" for name in schedule.gauges if f"r{name} 0." in text or f"r{name} 1" in text] == [quiet], text
    assert f"{quiet} 0.2" in text, text
    assert text.endswith("give each its own: `reading_noise={'rNAME': ...}`")


def covers(truth: str, model: str, rng: np.random.Generator, *, count: int) -> list[float]:
    """Share of confirmation points, loaded in all components, within two standard uncertainties, by calibration."""
    shares = []
    for _ in range(count):
        stand = CalibrationStand(random_balance(seed_from(rng), model=truth), noise=NOISE, confirmation=1.0)
        quality = assess(calibrate(stand.run(seed_from(rng)).schedule, model=model))
        assert quality.confirmation_covered is not None
        shares.append(float(quality.confirmation_covered.mean()))
    return shares


@pytest.mark.parametrize(
    ("truth", "model", "low", "high"),
    # two standard deviations: 95.45 %. The errors of a calibration are common to all its points, the more so the more
    # terms it has, so that one calibration differs from the next by 0.6 % (12 terms) to 2.3 % (96 terms); that the
    # widths of the kinds are learned, and then taken as known, costs another percent
    [
        ("linear", "linear", 0.93, 0.97),
        ("abs", "abs", 0.93, 0.97),
        ("96", "96", 0.92, 0.98),
        ("linear", "auto", 0.93, 0.98),
        ("96", "auto", 0.91, 0.98),
    ],
)
@pytest.mark.soak(first=1)
def test_cover_of_confirmation_points(truth: str, model: str, low: float, high: float, rng) -> None:
    shares = covers(truth, model, rng, count=trials(6, 12))
    assert low <= np.mean(shares) <= high, shares


# ---- statistics against closed forms --------------------------------------------------------------------


def test_regression_beside_closed_forms(rng) -> None:
    n, t = 60, 7
    X = rng.normal(size=(n, t))
    X[:, 3] = X[:, 2] + 0.3 * X[:, 3]
    Z = np.eye(3)[np.arange(n) % 3]
    y = X @ rng.normal(size=t) + Z @ [1, 2, 3] + rng.normal(0, 0.5, n)
    fit = regress(y, X, Z, included=np.ones(t, dtype=bool), penalty=np.zeros(t))
    A = np.hstack([X, Z])
    inverse = np.linalg.inv(A.T @ A)
    b = inverse @ A.T @ y
    rest = y - A @ b
    freedom = n - A.shape[1]
    variance = rest @ rest / freedom
    u = np.sqrt(variance * np.diag(inverse))
    close = {"rtol": 1e-9, "atol": 1e-12}  # a condition number of 20 squared, and some hundred roundings
    np.testing.assert_allclose(fit.coefficients, b[:t], **close)
    np.testing.assert_allclose(fit.covariance, variance * inverse[:t, :t], **close)
    np.testing.assert_allclose(fit.t, b[:t] / u[:t], **close)
    np.testing.assert_allclose(fit.p, 2 * scipy.stats.t.sf(np.abs(b[:t] / u[:t]), freedom), **close)
    np.testing.assert_allclose(fit.intercepts, b[t:], **close)
    np.testing.assert_allclose(fit.u_intercepts, u[t:], **close)
    np.testing.assert_allclose(fit.deviation, np.sqrt(variance), **close)
    assert fit.degrees_of_freedom == freedom
    np.testing.assert_allclose(fit.r_squared, 1 - rest @ rest / np.sum((y - y.mean()) ** 2), **close)
    left_out, student = np.empty(n), np.empty(n)
    for k in range(n):
        keep = np.arange(n) != k
        c = np.linalg.lstsq(A[keep], y[keep], rcond=None)[0]
        left_out[k] = y[k] - A[k] @ c
        others = y[keep] - A[keep] @ c
        without = others @ others / (freedom - 1)
        student[k] = left_out[k] / np.sqrt(without * (1 + A[k] @ np.linalg.inv(A[keep].T @ A[keep]) @ A[k]))
    np.testing.assert_allclose(fit.press, np.sqrt(np.mean(left_out**2)), **close)
    np.testing.assert_allclose(fit.studentised, student, **close)
    for column, inflated in enumerate(fit.vif):
        own = A[:, column]
        others = np.delete(A, column, axis=1)
        unexplained = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
        centred = own - Z @ np.linalg.lstsq(Z, own, rcond=None)[0]
        np.testing.assert_allclose(inflated, (centred @ centred) / (unexplained @ unexplained), **close)


def test_regression_with_terms_left_out_and_drawn_to_zero(rng) -> None:
    n, t = 60, 7
    X, Z = rng.normal(size=(n, t)), np.eye(3)[np.arange(n) % 3]
    y = X @ rng.normal(size=t) + Z @ [1, 2, 3] + rng.normal(0, 0.5, n)
    penalty = np.array([0, 0, *rng.uniform(1, 50, t - 2)])
    included = np.array([True, True, True, True, False, True, False])
    fit = regress(y, X, Z, included=included, penalty=penalty)
    A, drawn = np.hstack([X, Z]), np.concatenate([penalty, np.zeros(3)])
    inverse = np.linalg.inv(A.T @ A + np.diag(drawn))
    everything = inverse @ A.T @ y
    rest = y - A @ everything
    freedom = n - np.trace(A @ inverse @ A.T)
    used = np.concatenate([included, [True] * 3])
    found = np.zeros(t + 3)
    found[used] = np.linalg.solve(A[:, used].T @ A[:, used] + np.diag(drawn[used]), A[:, used].T @ y)
    covariance = rest @ rest / freedom * inverse + np.outer(found - everything, found - everything)
    close = {"rtol": 1e-9, "atol": 1e-12}
    np.testing.assert_allclose(fit.coefficients, found[:t], **close)
    np.testing.assert_allclose(fit.covariance, covariance[:t, :t], **close)
    np.testing.assert_allclose(fit.u_intercepts, np.sqrt(np.diag(covariance)[t:]), **close)
    np.testing.assert_allclose(fit.deviation, np.sqrt(rest @ rest / freedom), **close)
    np.testing.assert_allclose(fit.t[included], (found[:t] / np.sqrt(np.diag(covariance)[:t]))[included], **close)
    assert fit.degrees_of_freedom == round(freedom)
    assert np.isnan(fit.vif[~included]).all()
    assert np.isnan(fit.t[~included]).all()


def test_too_few_points_are_refused() -> None:
    with pytest.raises(FitError, match=r"5 points for 5 unknowns \(4 terms and 1 series"):
        regress(np.ones(5), np.eye(5)[:, :4], np.ones((5, 1)), included=np.ones(4, dtype=bool), penalty=np.zeros(4))


# ---- what a schedule can tell ---------------------------------------------------------------------------


def unknown(fit: Calibration) -> set[str]:
    labels = set(fit.unidentified_labels)
    present = {term.label(fit.matrix.variables) for term in fit.matrix.terms}
    assert not labels & present  # what is not known comes back as no number
    everything = {term.label(fit.matrix.variables) for term in terms_of(fit.model, 6)}
    assert everything <= labels | present
    return labels


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.parametrize("model", ["linear", "quadratic", "96", "auto"])
def test_single_loads_name_every_cross_term(model: str, way: str, rng) -> None:
    fit = calibrate(single_loads(random_balance(seed_from(rng)), rng), model=model, way=way)
    names = fit.matrix.variables
    # of all 96, whether or not the model offers them
    products = {term.label(names) for term in terms_of("96", 6) if term.kind in {4, 5, 6, 7}}
    assert unknown(fit) == products


def test_loads_of_one_direction_name_absolute_values(rng) -> None:
    fit = calibrate(single_loads(random_balance(seed_from(rng)), rng, low=0), model="96")
    assert {"|N1|", "|AF|", "N1*|N1|", "|RM*RM*RM|", "N1*N2"} <= unknown(fit)
    like = {item.term.label(fit.matrix.variables): item.like for item in fit.unidentified}
    assert like["|N1|"] == fit.matrix.terms[0]
    assert like["N1*N2"] is None


def test_small_parasitic_loads_do_not_make_products_known(rng) -> None:
    balance = random_balance(seed_from(rng))
    schedule = single_loads(balance, rng)
    loads = schedule.loads + rng.uniform(-1, 1, schedule.loads.shape) * 1e-3 * CAPACITIES
    outputs = balance.outputs(loads) + rng.normal(0, NOISE, loads.shape)
    fit = calibrate(replace(schedule, loads=loads, outputs=outputs), model="96")
    assert {term.label(fit.matrix.variables) for term in terms_of("96", 6) if term.kind in {4, 5, 6, 7}} <= unknown(
        fit
    )


def test_pairs_of_loads_tell_all_terms(rng) -> None:
    fit = calibrate(CalibrationStand(random_balance(seed_from(rng))).run(seed_from(rng)).schedule, model="96")
    assert unknown(fit) == set()


def test_selection_keeps_what_is_there_and_little_else(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    fit = calibrate(CalibrationStand(balance).run(seed_from(rng)).schedule, model="auto")
    linear = np.array([term.kind == 0 for term in fit.matrix.terms])
    chosen = np.array([part.included for part in fit.regressions])
    assert chosen[:, linear].all()
    # idle terms are drawn to a sixth or less: their squares over their variances are then 90 / 6 = 15 on average, of
    # which 0.05 * 96 = 4.8 may go; as the squares of the least half of normal numbers are a seventh of all, more
    # than half of the terms go
    assert chosen[:, ~linear].mean() < 0.5


def test_model_and_way_are_checked() -> None:
    schedule = CalibrationStand(random_balance(0, model="linear")).run(0).schedule
    with pytest.raises(ValueError, match="model must be one of"):
        calibrate(schedule, model="cubic")
    with pytest.raises(ValueError, match="way must be iterative or non-iterative"):
        calibrate(schedule, model="linear", way="both")


# ---- directions, repeats, hysteresis, outliers ----------------------------------------------------------


def balance_with(kind: int, size: float, rng: np.random.Generator) -> BalanceMatrix:
    """A balance whose bridges have, beside linear terms, one other kind of term of their own load."""
    balance = random_balance(seed_from(rng))
    C = balance.coefficients.copy()
    for row, term in enumerate(balance.terms):
        if term.kind:
            C[row] = 0.0
        if term.kind == kind:
            C[row, term.first] = size
    return replace(balance, coefficients=C)


def test_bridges_with_two_sensitivities_are_found(rng) -> None:
    balance = balance_with(1, 0.01, rng)  # slopes 1.01 and 0.99: 2 % apart
    for schedule in (CalibrationStand(balance).run(seed_from(rng)).schedule, single_loads(balance, rng)):
        for direction in assess(calibrate(schedule, model="abs")).directions:
            assert direction.known
            assert direction.bidirectional
            # 0.08 % a reading; eight of a sign have a spread of 1 about their mean, so that a slope is uncertain by
            # 0.08 % and the difference of two by 0.12 %: five times that
            assert direction.difference == pytest.approx(0.02, abs=0.006)


def test_curved_and_plain_bridges_are_not_taken_for_it(rng) -> None:
    false = 0
    for _ in range(10):
        # |F| fits a square of 0.03 to within 0.03 / sqrt(180) = 0.22 % of capacity, well above 0.06 % of noise
        for kind, size in ((2, 0.03), (8, 0.01), (0, 1.0)):
            schedule = single_loads(balance_with(kind, size, rng), rng)
            false += sum(item.bidirectional for item in assess(calibrate(schedule, model="quadratic")).directions)
    # p < 0.001 by chance in 180 bridges: more than 4 have a probability below 2e-6
    assert false <= 4


@pytest.mark.filterwarnings("ignore:.*does not go with the others")  # of some thousand readings one by chance
def test_one_direction_tells_nothing_of_the_other(rng) -> None:
    schedule = single_loads(random_balance(seed_from(rng), model="linear"), rng, low=0)
    fit = calibrate(schedule, model="linear")
    quality = assess(fit)
    assert not any(item.known or item.bidirectional for item in quality.directions)
    with (
        pytest.warns(DataQualityWarning, match="cannot identify 78 terms"),
        pytest.warns(DataQualityWarning, match="N1, N2, S1, S2, RM, AF loaded in one direction only"),
    ):
        warn_of_weaknesses(fit, quality)


def test_loads_that_never_come_again_tell_no_repeatability(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    loads = rng.uniform(-1, 1, (60, 6)) * CAPACITIES
    schedule = plain_schedule(loads, balance.outputs(loads) + rng.normal(0, NOISE, (60, 6)))
    assert np.isnan(assess(calibrate(schedule, model="linear")).repeatability).all()


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_a_series_of_confirmation_points_alone_has_no_tares(way: str, rng) -> None:
    schedule = single_loads(random_balance(seed_from(rng), model="linear"), rng)
    zeros = 0.02 + rng.normal(0, NOISE, (4, 6))
    own = schedule.series == 4
    calibration = calibrate(replace(schedule, natural_zeros=zeros, confirmation=own), model="linear", way=way)
    for table in (calibration.tares, calibration.u_tares, calibration.tares_by_iteration):
        assert np.isnan(table[4]).all()
        assert np.isfinite(np.delete(table, 4, axis=0)).all()
    assert np.isfinite(calibration.residuals).all()
    assert np.isfinite(assess(calibration).confirmation).all()


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_confirmation_points_of_a_series_of_their_own_count_from_their_mean(way: str, rng) -> None:
    """Where nothing is absolute, a change of the zero from series to series is no error of the matrix."""
    schedule = single_loads(random_balance(seed_from(rng), model="linear"), rng)
    own = schedule.series == 4
    moved = schedule.outputs + np.where(own[:, None], rng.normal(0, 0.1, 6), 0.0)
    found, shifted = (
        calibrate(replace(schedule, outputs=outputs, confirmation=own), model="linear", way=way).residuals[own]
        for outputs in (schedule.outputs, moved)
    )
    # rounding of 0.1 in 1 mV/V, through a matrix of a condition below ten
    np.testing.assert_allclose(shifted / CAPACITIES, found / CAPACITIES, atol=1e-13)
    np.testing.assert_allclose(found.mean(axis=0) / CAPACITIES, 0, atol=1e-13)
    # a reading's noise is 0.08 % of capacity; six times that
    assert np.abs(found / CAPACITIES).max() < 6 * 0.8e-3


def test_a_single_series_is_not_blamed(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    loads = rng.uniform(-1, 1, (60, 6)) * CAPACITIES
    outputs = balance.outputs(loads) + rng.normal(0, 0.1, (60, 6))
    with pytest.raises(FitError, match="unfit for a matrix") as told:
        calibrate(plain_schedule(loads, outputs), model="linear")
    assert "of it in series" not in str(told.value)
    two = plain_schedule(loads, outputs, series=np.arange(60) // 30)
    with pytest.raises(FitError, match=r"% of it in series 'series [12]'"):
        calibrate(two, model="linear")


def test_outliers_hysteresis_and_repeats(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    clean = single_loads(balance, rng, noise=0.3e-3)
    quality = assess(calibrate(clean, model="linear"))
    assert not quality.outliers
    unit = 0.3e-3 / balance.output_scale
    # 24 pairs of zero readings, so 24 degrees of freedom of two bridges' noise at most
    low, high = np.sqrt(scipy.stats.chi2.ppf([FALSE_ALARM, 1 - FALSE_ALARM], 12) / 12)
    assert (quality.repeatability > low * unit).all()
    assert (quality.repeatability < high * unit * 1.05).all()
    outputs = clean.outputs.copy()
    outputs[19, 1] += 6e-3
    spoilt = assess(calibrate(replace(clean, outputs=outputs), model="linear"))
    assert (spoilt.outliers[0].point, spoilt.outliers[0].component) == (19, 1)
    # the fit takes its share of the point away: leverage below 0.3 in a series of eight
    assert 6e-3 * 0.6 < spoilt.outliers[0].residual < 6e-3 + 5 * 0.3e-3


def test_hysteresis_between_going_up_and_down(rng) -> None:
    balance = random_balance(seed_from(rng), model="linear")
    schedule = CalibrationStand(balance, noise=0.05e-3, tare_size=0).run(seed_from(rng)).schedule
    # round loads, so that a load comes twice
    loads = np.rint(schedule.loads / CAPACITIES / 0.25) * 0.25 * CAPACITIES
    outputs = balance.outputs(loads) + rng.normal(0, 0.05e-3, loads.shape)
    plain = assess(
        calibrate(replace(schedule, loads=loads, outputs=outputs, natural_zeros=np.zeros((0, 6))), model="linear")
    )
    rows = np.flatnonzero(schedule.series == 0)
    planted = outputs.copy()
    first = np.abs(loads[rows, 0] / CAPACITIES[0])
    down = rows[(np.abs(first - 0.5) < 0.01) & (np.diff(first, prepend=0) < 0)]
    planted[down, 0] += 2e-3
    found = assess(
        calibrate(replace(schedule, loads=loads, outputs=planted, natural_zeros=np.zeros((0, 6))), model="linear")
    )
    size = 2e-3 / balance.output_scale[0]
    assert found.hysteresis[0] == pytest.approx(size, abs=5 * 0.05e-3 * np.sqrt(2) / balance.output_scale[0])
    assert plain.hysteresis[0] < size / 2


@pytest.mark.parametrize("digits", [0.0, 2e-5])
def test_repeats_on_the_way_up_are_no_way_down(digits: float, rng) -> None:
    """Each load is read three times, as it is or to the last digit of the weights, over capacity."""
    balance = random_balance(seed_from(rng), model="linear")
    up, both = np.repeat([0, 0.25, 0.5, 0.75, 1], 3), np.repeat([0, 0.25, 0.5, 1, 0.5, 0.25], 3)
    found = {}
    for name, nominal in (("up", up), ("both", both)):
        steps = nominal + digits * np.tile([0, 1, -1], len(nominal) // 3)
        loads = np.concatenate([np.outer(steps, CAPACITIES[k] * np.eye(6)[k]) for k in range(6)])
        lag = np.zeros(loads.shape)
        lag[12:18, 0] = 2e-3 if name == "both" else 0.0
        outputs = balance.outputs(loads) + rng.normal(0, 1e-5, loads.shape) + lag
        schedule = plain_schedule(loads, outputs, series=np.repeat(np.arange(6), len(steps)))
        found[name] = assess(calibrate(schedule, model="linear")).hysteresis
    assert np.isnan(found["up"]).all()
    # means of three readings each way of 1e-5 mV/V, five standard deviations; the lag turns the sensitivity by 0.2 %
    unit = balance.output_scale[0]
    assert found["both"][0] == pytest.approx(2e-3 / unit, abs=5 * 1e-5 * np.sqrt(2 / 3) / unit + 2e-3 * 2e-3)


# ---- a healthy schedule raises nothing ------------------------------------------------------------------


@pytest.mark.soak(first=2)
@pytest.mark.parametrize("model", ["linear", "abs", "quadratic", "96"])
def test_healthy_schedules_raise_no_doubt(model: str, rng) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataQualityWarning)
        for _ in range(3):
            balance = random_balance(seed_from(rng), model=model)
            for way in ("iterative", "non-iterative"):
                calibrate(CalibrationStand(balance).run(seed_from(rng)).schedule, model=model, way=way)
                calibrate(single_loads(balance, rng), model=model, way=way)
