"""Uncertainty of a force: closed forms for what sums it up, the budget, and the Monte Carlo check."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from aerobalance.dynamics.independent import dynamics_of
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.error_sources import Divided, Noise, Systematic
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record, noise_spectra
from aerobalance.estimation.force_smoother import LinearSmoother, SmootherResult
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.estimation.noise_draws import NoiseDraws
from aerobalance.estimation.observation import SpectralPrior
from aerobalance.estimation.result import ComponentForce, budget_of, with_balance
from aerobalance.estimation.statespace.model_draws import ModelDraws
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import QUANTITIES, Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import filtered
from aerobalance.uncertainty.budget import advice, component_budget, scalars, spectrum
from aerobalance.uncertainty.monte_carlo import monte_carlo
from aerobalance.uncertainty.parameter_draws import CLOSE, ChangedRecord, parameter_errors
from aerobalance.uncertainty.sampling import UncertainDynamics, drawn_numbers, standard_normals
from helpers.cable_cut import T128
from seeds import trials

RATE = 1600.0
UNSURE = replace(T128, covariance=np.diag((np.array([2e-4, 2e-4, 5e-2, 0]) * T128.values) ** 2))


def record(**channels) -> Recording:
    built = {}
    for name, content in channels.items():
        values, settings = content if isinstance(content, tuple) else (content, {})
        built[name] = Channel(name, values, QUANTITIES[name], **settings)
    count = next(iter(built.values())).values.size
    return Recording.from_columns(np.arange(count) / RATE, built, name="test record")


def run(
    generator: np.random.Generator, *, count=2000, rms=100.0, noise=2.0, highest=100.0, dynamics=T128
) -> Recording:
    """Balance load under a force with a flat spectrum, and its noise."""
    frequency = np.fft.rfftfreq(8 * count, 1 / (8 * RATE))
    inside = (frequency > 0) & (frequency < highest)
    phasors = inside * (generator.normal(size=inside.size) + 1j * generator.normal(size=inside.size))
    force = np.fft.irfft(phasors, 8 * count)
    load = dynamics.balance_load(force * rms / force.std() + 50, interval=1 / (8 * RATE))[::8]
    return record(AF=load + noise * generator.normal(size=count))


def made(values: np.ndarray, *contributions, smoothed=False) -> ComponentForce:
    deviation = np.sqrt(sum(part.deviation**2 for part in contributions))
    return ComponentForce(
        component="AF",
        values=values,
        uncertainty=deviation,
        method="made",
        noise=1.0,
        bandwidth=100.0,
        noise_gain=1.0,
        contributions=contributions,
        learned=prior() if smoothed else None,
    )


@cache
def prior() -> SpectralPrior:
    """Any prior: it marks an estimate as the smoother's."""
    learned = estimate_force(run(np.random.default_rng(1)), T128).only.learned
    assert learned is not None
    return learned


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# --- what sums up a force


def test_an_offset_goes_to_the_mean_and_not_to_the_rms():
    values = np.sin(np.arange(500) / 7)
    offset = Systematic("offset", "somewhere", ("offset",), np.ones((500, 1)), np.array([[0.3**2]]))
    found = {item.name: item for item in scalars(made(values, offset))}
    assert found["mean"].u == pytest.approx(0.3)
    assert found["rms_about_mean"].u == pytest.approx(0, abs=1e-9)
    assert found["largest"].u == pytest.approx(0.3)


def test_a_gain_goes_to_the_rms_in_proportion():
    values = 5 + 3 * np.sin(np.arange(500) / 7)
    gain = Systematic("gain", "somewhere", ("gain",), values[:, None], np.array([[0.02**2]]))
    found = {item.name: item for item in scalars(made(values, gain))}
    assert found["rms_about_mean"].u == pytest.approx(0.02 * values.std())
    assert found["mean"].u == pytest.approx(0.02 * values.mean())
    assert found["least"].u == pytest.approx(0.02 * abs(values.min()))


def test_white_noise_averages_out():
    count = 1000
    values = 10 * np.sin(np.arange(count) / 7)
    noise = Noise("noise", "AF", np.full(count, 2.0), np.ones(1))
    found = {item.name: item for item in scalars(made(values, noise))}
    assert found["mean"].u == pytest.approx(2 / np.sqrt(count))
    # r^2 = mean((F + e)^2): variance 4 r^2 s^2 / n + 2 s^4 / n, over (2 r)^2; r is less the noise for an inverse
    r = np.sqrt(values.var() - 4 + 4 / count)
    of_square = (4 * values.var() * 4 + 2 * 16) / count
    assert found["rms_about_mean"].value == pytest.approx(r)
    assert found["rms_about_mean"].u == pytest.approx(np.sqrt(of_square) / (2 * r))
    # the smoother's force lies about its estimate, so there the noise is added
    found = {item.name: item for item in scalars(made(values, noise, smoothed=True))}
    assert found["rms_about_mean"].value == pytest.approx(np.sqrt(values.var() + 4 - 4 / count))


def test_noise_of_a_spectrum_is_carried_by_its_spectrum():
    # cos(w n) picks the density at w: variance of (2/n) sum cos e = (2/n) S(w), S = 1 + cos(w) being of mean 1
    count = 4096
    density = 1 + np.cos(np.linspace(0, np.pi, 2049))
    noise = Noise("noise", "AF", np.ones(count), density)
    for harmonic in (300, 1024, 1700):
        w = 2 * np.pi * harmonic / count
        weights = 2 / count * np.cos(w * np.arange(count))
        # the record's ends smear the density over 1/n: relative error of order w/n
        assert noise.variance_of(weights) == pytest.approx(2 / count * (1 + np.cos(w)), rel=5e-3)
    assert noise.variance_of(np.eye(count)[7]) == pytest.approx(1, rel=1e-3)


def test_draws_of_a_noise_have_its_spectrum(rng):
    density = 1 + np.cos(np.linspace(0, np.pi, 129))
    noise = Noise("noise", "AF", np.full(200, 3.0), density)
    draws = np.array([noise.draw(rng) for _ in range(500)])
    # 100,000 values, neighbours correlated by a half: 9 within 4 * 9 * sqrt(2 * 1.5 / 1e5); 5 standard deviations
    assert np.mean(draws**2) == pytest.approx(9, rel=5 * np.sqrt(3 / 1e5))
    assert np.mean(draws[:, 1:] * draws[:, :-1]) == pytest.approx(4.5, rel=5 * np.sqrt(2 * 3 / 1e5))


def test_the_mean_of_the_smoother_is_as_good_as_that_of_the_readings(rng):
    # With the constant free the mean force is that of the readings, of noise over the root of their number, but for
    # what the balance has in it at both ends: by Eq. (8) its rate there over w0^2 T, not known better than the force.
    count = 4000
    estimate = estimate_force(run(rng, count=count), T128).only
    mean = scalars(estimate)[0]
    # whether the noise rises at low frequency one record of fifteen leaves open, and counts it
    u = np.sqrt(mean.u**2 - mean.parts.get("noise that the record leaves open", 0.0) ** 2)
    ends = estimate.uncertainty[[0, -1]] * RATE / (count * T128.angular_frequency)
    least, most = 2 / np.sqrt(count), np.hypot(2 / np.sqrt(count), np.linalg.norm(ends))
    assert 0.9 * least < u < 1.1 * most  # the noise is learned from half of 4000 readings, to 1.6 %


def test_spectrum_of_a_force_has_both_uncertainties(rng):
    estimate = estimate_force(run(rng, count=8000), UNSURE).only
    found = spectrum(estimate, rate=RATE)
    inside = (found.frequency > 10) & (found.frequency < 90)
    # 100 N rms flat to 100 Hz is 100 N^2/Hz; 15 segments of 1000 over 400 ordinates / 5: 5 standard deviations
    level = found.density[inside]
    assert level.mean() == pytest.approx(100, rel=5 / np.sqrt(14 * 40))
    assert np.std(level) == pytest.approx(found.scatter[inside].mean(), rel=0.6)
    assert (found.uncertainty[inside] < found.scatter[inside]).all()  # 2 N of noise do not hide 100 N


def test_an_error_of_gain_is_twice_as_large_in_the_spectrum():
    values = np.random.default_rng(2).normal(size=4000)
    gain = Systematic("gain", "somewhere", ("gain",), values[:, None], np.array([[0.02**2]]))
    found = spectrum(made(values, gain), rate=RATE)
    assert found.uncertainty[1:] == pytest.approx(2 * 0.02 * found.density[1:])


# --- where it comes from


def test_pitch_zero_turns_the_weight():
    pitch = np.full(800, np.deg2rad(10.0))
    weight = T128.mass * STANDARD_GRAVITY * np.sin(pitch)
    u = np.deg2rad(0.05)
    given = record(AF=weight + np.sin(np.arange(800)), pitch=(pitch, {"noise": 0.0, "zero_uncertainty": u}))
    expected = T128.mass * STANDARD_GRAVITY * np.cos(pitch[0]) * u
    for options in ({}, {"method": "paper"}, {"bandwidth": 100.0}):
        estimate = estimate_force(given, T128, **options).only
        # M g cos(theta) u, to second order in the step of the difference; the smoother hands a constant on
        assert estimate.budget["pitch zero"] == pytest.approx(expected, rel=1e-5), options
        mean = scalars(estimate)[0]
        assert mean.parts["pitch zero"] == pytest.approx(expected, rel=1e-5), options


def test_gravity_and_accelerometer_zero_are_carried():
    pitch = np.full(800, 0.2)
    ground = np.full(800, 2.0) + 1e-3 * np.sin(np.arange(800) / 9)
    given = record(
        AF=T128.mass * STANDARD_GRAVITY * np.sin(0.2) + np.sin(np.arange(800.0)),
        pitch=(pitch, {"noise": 0.0}),
        ground_acceleration=(ground, {"noise": 0.0, "zero_uncertainty": 0.03}),
    )
    estimate = estimate_force(given, T128, method="paper", gravity_uncertainty=0.01).only
    assert estimate.budget["gravity"] == pytest.approx(T128.mass * np.sin(0.2) * 0.01)
    assert estimate.budget["accelerometer zero"] == pytest.approx(T128.mass * 0.03)


def test_a_matrix_is_a_gain_and_an_offset(rng):
    estimate = estimate_force(run(rng), T128, bandwidth=150.0).only
    static = np.hypot(0.3, 0.01 * estimate.values)
    found = with_balance(estimate, static)
    matrix = found.contributions[-1]
    assert matrix.deviation == pytest.approx(static, rel=1e-6)
    assert np.hypot(0.3, 0.01 * estimate.values.mean()) == pytest.approx(
        scalars(found)[0].parts[matrix.name], rel=1e-6
    )


def test_readings_that_the_model_does_not_explain_raise_the_uncertainty(rng):
    load = run(rng, count=4096).channel("AF").values.copy()
    load[2048:2304] += 8 * rng.normal(size=256)
    name = "what the model does not explain"
    with pytest.warns(DataQualityWarning, match="depart from what the model"):
        estimate = estimate_force(record(AF=(load, {"noise": 2.0})), T128).only
    part = next(item for item in estimate.contributions if item.name == name)
    noise = next(item for item in estimate.contributions if item.name == "noise of the readings")
    # told where 256 readings have more than 1 + 8 sqrt(2 / 256) times the variance expected, and raised by as much
    assert (part.deviation[2100:2250] > np.sqrt(8 * np.sqrt(2 / 256)) * noise.deviation[2100:2250]).all()
    assert part.deviation[:1500].max() == 0
    assert estimate.uncertainty[2200] == pytest.approx(np.hypot(part.deviation[2200], noise.deviation[2200]), rel=0.01)


def test_the_budget_adds_up_and_says_what_to_improve_first(rng):
    estimate = estimate_force(run(rng), UNSURE).only
    rows = component_budget(estimate)
    assert sum(row.share for row in rows) == pytest.approx(1)
    assert np.linalg.norm([row.rms for row in rows]) == pytest.approx(rms(estimate.uncertainty))
    assert [row.rms for row in rows] == sorted((row.rms for row in rows), reverse=True)
    text = advice(estimate, sources={"AF": "the balance's channel"})
    assert rows[0].name in text
    assert f"{rows[0].if_halved:.3g} N" in text


def test_halving_the_noise_brings_what_the_budget_says(rng):
    # the spectrum of the force is learned anew: its own scatter makes a few per cent
    quiet = run(rng, noise=0.0, count=4000).channel("AF").values
    noise = rng.normal(size=quiet.size)
    loud, half = (estimate_force(record(AF=(quiet + u * noise, {"noise": u})), T128).only for u in (4.0, 2.0))
    row = next(row for row in component_budget(loud) if row.name == "noise of the readings")
    assert rms(half.uncertainty) == pytest.approx(row.if_halved, rel=0.1)


# --- Monte Carlo


def test_drawn_numbers_have_exactly_their_covariance():
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    drawn = drawn_numbers(np.random.default_rng(3), covariance, 12)
    assert np.cov(drawn.T) == pytest.approx(covariance, abs=1e-12)
    assert drawn.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def alone(dynamics: Dynamics) -> UncertainDynamics:
    return UncertainDynamics.of(dynamics_of(dynamics), np.arange(len(dynamics.parameters)))


def test_drawn_dynamics_have_the_covariance_of_the_dynamics():
    unsure = alone(UNSURE)
    normals = standard_normals(np.random.default_rng(3), unsure.count, 30)
    drawn = np.array([unsure.at(numbers).parameter_values for numbers in normals])
    unit = np.where(np.diag(UNSURE.covariance) > 0, np.sqrt(np.diag(UNSURE.covariance)), 1.0)
    # numbers of 1e7 are drawn: their last digit is 1e-9 of u(k) = 6e3 or better
    assert np.cov((drawn / unit).T) == pytest.approx(UNSURE.covariance / np.outer(unit, unit), abs=1e-6)


def test_dynamics_that_are_hardly_known_are_refused():
    wild = replace(T128, covariance=np.diag([(3 * T128.mass) ** 2, 0, 0, 0]))
    with pytest.raises(FitError, match="not physical"):
        ChangedRecord(alone(wild), lambda _: None).records(np.random.default_rng(3), 50)


def test_the_fast_estimator_is_the_obvious_one(rng):
    given = run(rng, count=1200)
    values = given.channel("AF").values - 800 * T128.step_response(given.time - 0.40012)
    values[900:920] = np.nan
    given = record(AF=values)
    reading = SingleRecord.of(given, T128, GroundMotion.of(given, "AF")).reading()
    estimate = estimate_force(given, T128).only
    assert len(estimate.steps) == 1
    obvious = SmootherResult.of(reading, learned=estimate.learned, steps=estimate.steps)
    fast = LinearSmoother.of(reading, learned=estimate.learned, steps=estimate.steps)
    size = np.ptp(obvious.force)
    left = reading.filled - obvious.columns @ obvious.sizes
    assert fast.apart(left[:, None])[0][:, 0] == pytest.approx(obvious.states[:, 2], abs=1e-9 * size)
    # with the instant free the force moves by less than its own uncertainty
    moved = fast.run(reading.filled[:, None])[:, 0] - obvious.force
    assert rms(moved) < rms(estimate.uncertainty)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # one of many leaves f0 open
def test_simulated_readings_are_those_of_the_model(rng):
    given = run(rng, count=4000)
    estimate = estimate_force(given, T128).only
    reading = SingleRecord.of(given, T128, GroundMotion.of(given, "AF")).reading()
    estimator = LinearSmoother.of(reading, learned=estimate.learned, steps=())
    _, simulated = ModelDraws.of(estimator.system, estimator.filter.present).draw(rng, 1)
    white = estimator.filter.whiten(simulated.T)[:, 0]
    # innovations over their standard deviation: 4000 of variance 1; 5 standard deviations
    assert np.mean(white**2) == pytest.approx(1, abs=5 * np.sqrt(2 / 4000))
    assert abs(np.mean(white[1:] * white[:-1])) < 5 / np.sqrt(4000)


@pytest.mark.parametrize("options", [{}, {"method": "paper"}, {"bandwidth": 100.0}], ids=["smoother", "paper", "band"])
@pytest.mark.soak(first=1)
def test_monte_carlo_agrees_with_first_order(options, rng, seed):
    given = run(rng)
    force = estimate_force(given, UNSURE, **options)
    estimate, found = force.only, monte_carlo(force, draws=50, seed=int(seed % 2**32))["AF"]
    names = [row.name for row in found.contributions]
    assert "mass, stiffness, damping, delay" in names
    # 10 % for first order, and five times the scatter of 50 draws; the ends of an inverse are drawn as they are
    for row in (*found.contributions, *found.scalars):
        if np.isfinite(row.analytic):
            assert abs(row.ratio - 1) < 0.1 + 5 * row.scatter, row
    inner = slice(100, -100)
    ratio = rms(found.deviation[inner]) / rms(estimate.uncertainty[inner])
    assert abs(ratio - 1) < 0.1 + 5 * found.contributions[-1].scatter
    assert (found.low < found.high).all()


def test_monte_carlo_sees_what_is_not_linear(rng):
    # A frequency wrong by two per cent, 1.3 Hz, puts the ringing after a step out of phase within half a second: what
    # is left rings with up to twice the step, where first order goes on growing or sees nothing.
    count = 1200
    unsure = replace(T128, covariance=np.diag([0, (4e-2 * T128.stiffness) ** 2, 0, 0]))
    load = 1000 * T128.step_response(np.arange(count) / RATE - 0.20012) + 2 * rng.normal(size=count)
    given = record(AF=load)
    found = monte_carlo(estimate_force(given, unsure), draws=60, seed=1)["AF"]
    assert any("not linear" in text for text in found.doubts)


def test_errors_drawn_by_spectrum_and_ends_are_those_of_whole_records():
    generator = np.random.default_rng(5)
    given = run(generator, count=40_000)
    estimate = estimate_force(given, T128).only
    reading = SingleRecord.of(given, T128, GroundMotion.of(given, "AF")).reading()
    estimator = LinearSmoother.of(reading, learned=estimate.learned, steps=())
    fast = NoiseDraws.of(estimator)
    assert fast.ends is not None
    lengths = [end.part.stop - end.part.start for end in fast.ends]
    assert max(lengths) > 10
    draws = trials(40, 200)
    one, sizes = fast.draw(generator, draws)
    other, whole_sizes = replace(fast, ends=None).draw(generator, draws)
    size = np.sqrt(estimator.filter.smoothed_variance)
    # weighted sums along and across an end and along the middle: 5 standard deviations of variances of the draws each
    for stop in (10, lengths[0] // 4, lengths[0], 2 * lengths[0], 20_000):
        for part in (slice(0, stop), slice(40_000 - stop, 40_000), slice(lengths[0] - 10, lengths[0] + stop)):
            slow = np.cos(np.linspace(0, 3, one[:, part].shape[1]))
            sums = [np.var((each[:, part] / size[part]) @ slow) for each in (one, other)]
            assert abs(np.log(sums[0] / sums[1])) < 5 * np.sqrt(2 * 2 / draws), (stop, part)
            # the variance of a sample, mean over the part: as many values that hang together as a tenth of its samples
            mean = np.mean((one[:, part] / size[part]) ** 2)
            assert abs(mean - 1) < 5 * np.sqrt(2 / draws) / np.sqrt(max(1, stop / 1000)), (stop, part)
    expected = np.diag(estimator.size_covariance)
    for drawn in (sizes, whole_sizes):
        assert np.mean(drawn**2, axis=1) == pytest.approx(expected, rel=5 * np.sqrt(2 / draws))


def test_a_record_with_a_gap_is_drawn_as_a_whole():
    given = run(np.random.default_rng(5), count=4000)
    values = given.channel("AF").values.copy()
    values[1000:1050] = np.nan
    given = record(AF=values)
    estimate = estimate_force(given, T128).only
    reading = SingleRecord.of(given, T128, GroundMotion.of(given, "AF")).reading()
    assert NoiseDraws.of(LinearSmoother.of(reading, learned=estimate.learned, steps=())).ends is None


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # the gap is told
def test_the_mean_of_a_force_is_as_uncertain_as_a_gap_makes_it():
    """Draws of force and readings from the estimator's own model say by how much a gap makes the mean wrong."""
    rng, samples, before = np.random.default_rng(5), 1600, 400
    dynamics = Dynamics("AF", mass=177.87, stiffness=3.093e7, damping=828.21)
    load = filtered(rng.normal(0, 60.0, samples + before), lambda f: 1 / (1 + (f / 100) ** 8), rate=1600.0)
    felt = dynamics.balance_load(load, interval=1 / 1600)[before:] + rng.normal(0, 0.5, samples)
    felt[800:900] = np.nan
    force = estimate_force(record(AF=felt), dynamics)
    drawn = monte_carlo(force, draws=60)["AF"]
    mean = next(one for one in drawn.scalars if one.name == "mean")
    # of 60 draws, a standard deviation is known to 9 %; the spectra of noise and force are not sharply apart
    assert mean.ratio == pytest.approx(1.0, abs=0.4)
    assert not [one for one in drawn.contributions if not one.agrees]


def test_draws_of_parameters_by_a_polynomial_are_those_one_by_one():
    estimate = estimate_force(run(np.random.default_rng(5), count=1200), UNSURE)
    record = estimate.record.component_record("AF", estimate.filled)
    reading = record.reading()
    given = {"learned": estimate.only.learned, "steps": estimate.only.steps}
    found = LinearSmoother.of(reading, **given).run(reading.filled[:, None])[:, 0]
    asked = []

    def moved(other):
        asked.append(other)
        drawn = other.reading()
        return LinearSmoother.of(drawn, **given).run(drawn.filled[:, None])[:, 0] - found

    change = ChangedRecord(alone(UNSURE), lambda other: record.with_dynamics(other["AF"]))
    errors = np.array(list(parameter_errors(change, moved, draws=60, generator=np.random.default_rng(3))))
    assert len(asked) < 30
    expected = np.array([moved(other) for other in change.records(np.random.default_rng(3), 60)])
    # of what the polynomial is let miss, rms over all draws
    assert rms(errors - expected) < CLOSE * rms(expected)


def test_a_seed_gives_the_same_draws():
    given = run(np.random.default_rng(5))
    force = estimate_force(given, UNSURE)
    one, same, other = (monte_carlo(force, draws=10, seed=seed)["AF"] for seed in (7, 7, 8))
    assert np.array_equal(one.deviation, same.deviation)
    assert not np.array_equal(one.deviation, other.deviation)


def test_draws_of_a_direct_inverse_have_its_noise(rng):
    """The comparison above in short."""
    force = estimate_force(run(rng, count=400), T128, method="paper")
    found = monte_carlo(force, draws=10, seed=1)["AF"]
    noise = next(row for row in found.contributions if row.name == "all together")
    # 10 % for the ends, and five times the scatter of 10 draws
    assert abs(noise.ratio - 1) < 0.1 + 5 * noise.scatter


def test_a_force_of_which_nothing_is_uncertain_has_nothing_to_improve():
    exact = made(np.ones(100), Noise("noise", "AF", np.zeros(100), np.ones(1)))
    assert advice(exact) == "no contribution to the uncertainty is known"


def test_a_contribution_without_quantities_stays_nothing():
    none = Systematic("missing readings", "load", (), np.zeros((50, 0)), np.zeros((0, 0)))
    few = none.few
    assert few.quantities == () and few.slopes.shape == (50, 0)
    assert not few.deviation.any() and few.variance_of(np.ones(50)) == 0


def test_a_contribution_on_a_slower_clock_is_a_straight_line_between_its_samples():
    """Of a slope that is straight itself, the deviation on the record's clock is that line, held after the last."""
    slope = np.linspace(1.0, 3.0, 11)
    pieces = tuple(
        (first, Systematic("gain", "AF", ("gain",), slope[first:last, None], np.array([[0.25]])))
        for first, last in ((0, 5), (5, 11))
    )
    whole = Divided("gain", "AF", 42, pieces, every=4)
    expected = 0.5 * np.minimum(1.0 + 0.05 * np.arange(42), 3.0)
    np.testing.assert_allclose(whole.deviation, expected, rtol=1e-14)
    with pytest.raises(ValueError, match="worked out in parts cannot be summed up again"):
        component_budget(made(np.ones(42), whole))


def test_too_few_draws_are_refused():
    given = run(np.random.default_rng(5))
    with pytest.raises(ValueError, match="at least 10"):
        monte_carlo(estimate_force(given, T128), draws=9, seed=1)


@pytest.mark.parametrize("frequency", [50.0, 233.3])
def test_a_line_in_the_spectrum_of_a_noise_is_there_in_a_short_record(frequency, rng):
    line = np.zeros(4096)
    line[round(frequency / 800 * 4095)] = 1.0
    noise = Noise("hum", "AF", np.ones(1600), line / line.mean())
    for count in (257, 513, 2049):
        assert noise.relative_density(count).mean() == pytest.approx(1.0, rel=5e-3)  # the ends count in full
    drawn = np.sqrt(np.mean([np.mean(noise.draw(rng) ** 2) for _ in range(400)]))
    # a narrow line has the size of two normal numbers: its mean square scatters as itself
    assert drawn == pytest.approx(1.0, abs=5 / (2 * np.sqrt(400)))


def test_two_sensors_of_one_kind_are_both_in_the_budget(rng):
    parts = [
        Systematic("accelerometer gain", source, ("gain",), np.full((100, 1), size), np.eye(1))
        for source, size in (("one", 3.0), ("other", 4.0))
    ]
    assert budget_of(parts) == {"accelerometer gain": pytest.approx(5.0)}
    assert budget_of(parts[1:], budget_of(parts[:1])) == {"accelerometer gain": pytest.approx(5.0)}


def test_a_slow_tone_in_a_short_record_leaves_no_force_without_end(rng):
    time, frequency = np.arange(1600) / 1600, 3.0
    load = 178 * np.sin(2 * np.pi * frequency * time) + 2 * rng.normal(size=1600)
    force = estimate_force(Recording.from_columns(time, {"AF": Channel("AF", load, "N")}, name="tone"), T128)
    (drawn,) = (row for row in monte_carlo(force, draws=40)["AF"].contributions if row.name == "all together")
    assert drawn.drawn == pytest.approx(drawn.analytic, rel=0.25)  # of 40 draws; it was three thousand times as large


def test_a_record_of_noise_has_all_components_and_a_spectrum_no_others(rng):
    time = np.arange(3200) / 1600
    channels = {name: Channel(name, 2 * rng.normal(size=3200), "N") for name in ("AF", "NF")}
    both = Recording.from_columns(time, channels, name="run")
    calm = Recording.from_columns(time, {"AF": channels["AF"]}, name="calm")
    dynamics = dynamics_of({name: Dynamics(name, 177.87, 3.093e7, 828.21) for name in channels})
    with pytest.raises(FitError, match="calm: has no NF"):
        estimate_force(both, dynamics, noise=calm)
    spectra = noise_spectra(calm, force_record(calm, T128))
    with pytest.raises(ValueError, match="noise has XX"):
        estimate_force(calm, T128, noise={"XX": spectra["AF"]})


def test_direct_inverses_refuse_clipped_readings(rng):
    time = np.arange(3200) / 1600
    load = np.clip(100 * np.sin(2 * np.pi * 5 * time), -80, 80)
    clipped = Recording.from_columns(time, {"AF": Channel("AF", load, "N")}, name="run")
    for settings in ({"bandwidth": 100.0}, {"method": "paper"}):
        with pytest.raises(FitError, match=r"rest on a limit of the channel"):
            estimate_force(clipped, T128, keep_outliers=True, **settings)
