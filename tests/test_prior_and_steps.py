"""What the estimator learns from a record: prior, noise and steps, each against the truth of a simulation."""

import itertools

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aerobalance.dynamics import Dynamics
from aerobalance.force import reconstruct
from aerobalance.prior import (
    LEARNING_SAMPLES,
    Reading,
    generalised_least_squares,
    learn,
    learning_blocks,
    log_likelihood,
)
from aerobalance.recording import Channel, Recording
from aerobalance.rigs import CableCut, Sensor
from aerobalance.smoother import Filter, ForcePrior
from aerobalance.steps import Step, find_steps, shape_of

T128 = Dynamics("AF", 177.87, 3.093e7, 828.21)
RATE = 1600.0
STEP = 1020.0


def fresh() -> tuple[np.random.Generator, int]:
    seed = np.random.SeedSequence().entropy
    return np.random.default_rng(seed), seed


def band_limited(generator: np.random.Generator, n: int, *, rate: float, edge: float, rms: float) -> np.ndarray:
    """Gaussian process with a flat spectrum from 0 to `edge` [Hz]."""
    frequency = np.fft.rfftfreq(n, 1 / rate)
    spectrum = np.where((frequency > 0) & (frequency <= edge), 1.0, 0.0) * (
        generator.normal(size=frequency.size) + 1j * generator.normal(size=frequency.size)
    )
    values = np.fft.irfft(spectrum, n)
    return values * rms / values.std()


def smooth_reading(
    generator: np.random.Generator,
    *,
    seconds: float = 5.0,
    edge: float = 120.0,
    rms: float = 500.0,
    noise: float = 2.0,
) -> Reading:
    """Load felt under a smooth force, made on a clock 8 times as fast."""
    n = int(seconds * RATE)
    force = band_limited(generator, 8 * n, rate=8 * RATE, edge=edge, rms=rms)
    load = T128.load_felt(force, interval=1 / (8 * RATE))[::8]
    return Reading(load + generator.normal(0, noise, n), 1 / RATE, T128)


def released(generator: np.random.Generator, *, noise: float, instant: float, duration: float = 0.0) -> Reading:
    rig = CableCut(release=instant, release_duration=duration, sensors={"AF": Sensor(noise=noise)})
    record = rig.run(3.0, generator).recording
    return Reading(record.channel("AF").values, 1 / RATE, T128)


@pytest.mark.parametrize("missing", [False, True])
def test_log_likelihood_is_the_dense_one_up_to_a_constant(missing):
    generator, seed = fresh()
    n = 48
    values = generator.normal(0, 100, n)
    if missing:
        values[[0, 7, 8, 9, 30]] = np.nan
    reading = Reading(values, 1 / RATE, T128)
    present = np.flatnonzero(reading.present)
    columns = np.column_stack([np.ones(n), np.linspace(-1, 1, n)])
    found, dense = [], []
    for order, cutoff, density, noise in ((1, 10.0, 50.0, 5.0), (2, 100.0, 5.0, 2.0), (4, 150.0, 30.0, 20.0)):
        prior = ForcePrior(order=order, cutoff=cutoff, density=density)
        found.append(log_likelihood(reading, prior, noise, columns=columns))
        system = reading.system(prior, noise)
        h, P = system.observation, system.initial
        covariance = np.zeros((n, n))
        for i in range(n):
            block = P.copy()
            for j in range(i, n):
                covariance[i, j] = covariance[j, i] = h @ block @ h
                block = system.transition @ block
            P = system.transition @ P @ system.transition.T + system.process_noise
        covariance = covariance[np.ix_(present, present)] + noise**2 * np.eye(present.size)
        X, y = columns[present], values[present]
        weights = np.linalg.solve(covariance, X)
        sizes = np.linalg.solve(X.T @ weights, weights.T @ y)  # sizes of the columns at their most likely
        dense.append(multivariate_normal(X @ sizes, covariance).logpdf(y))
    # the same constant (half n log 2 pi) for every prior; 1e-6 of the largest covers the frozen gain
    shift = np.array(dense) - np.array(found)
    assert np.ptp(shift) < 1e-6 * np.max(np.abs(dense)), seed
    assert shift[0] == pytest.approx(-present.size / 2 * np.log(2 * np.pi), rel=1e-5), seed


def test_generalised_least_squares_is_the_textbook_one():
    generator, seed = fresh()
    n = 50
    reading = Reading(generator.normal(0, 30, n), 1 / RATE, T128)
    system = reading.system(ForcePrior(order=2, cutoff=80.0, density=5.0), 3.0)
    filter_ = Filter.of(system, reading.present)
    X = generator.normal(size=(n, 3))
    sizes, covariance, squares = generalised_least_squares(filter_, reading.values, X)
    white = filter_.whiten(np.eye(n))  # inverse Cholesky factor of the readings' covariance
    inverse = white.T @ white
    expected = np.linalg.inv(X.T @ inverse @ X)
    assert covariance == pytest.approx(expected, rel=1e-8), seed
    assert sizes == pytest.approx(expected @ X.T @ inverse @ reading.values, rel=1e-8), seed
    left = reading.values - X @ sizes
    assert squares == pytest.approx(left @ inverse @ left, rel=1e-8), seed


def test_noise_and_cutoff_are_learned():
    generator, seed = fresh()
    reading = smooth_reading(generator)
    learned = learn(reading, columns=np.ones((reading.values.size, 1)))
    # 85 % of 8000 samples' bandwidth carries noise alone: relative error 1 / sqrt(2 * 6800) = 0.9 %; 5 of these.
    assert learned.noise == pytest.approx(2.0, rel=0.045), seed
    # a sharp edge at 120 Hz is known to a few ordinates of 0.2 Hz; the roll-off of the finite order smears it by
    # half the frequency over which a Butterworth of order 8 drops to the noise, (S/R)^(1/16) = about 1.5
    assert 120 / 1.5 < learned.prior.cutoff < 120 * 1.5, seed
    assert learned.prior.order >= 4, seed
    # two-sided density rms^2 / (2 edge) = 1042; 600 ordinates give 4 %, the roll-off below the edge up to half
    assert learned.prior.density == pytest.approx(500.0**2 / 240.0, rel=0.5), seed


def test_given_noise_is_kept():
    generator, seed = fresh()
    reading = smooth_reading(generator, seconds=2.0)
    given = Reading(reading.values, reading.interval, T128, noise=2.0)
    assert learn(given, columns=np.ones((given.values.size, 1))).noise == 2.0, seed


def test_no_force_is_learned_where_none_fluctuates():
    generator, seed = fresh()
    reading = Reading(100 + generator.normal(0, 3.0, 4000), 1 / RATE, T128)
    learned = learn(reading, columns=np.ones((4000, 1)))
    resolved = np.sqrt(learned.prior.density * 2 * learned.prior.cutoff)
    assert resolved < 0.3, seed  # a tenth of the noise
    # relative error of a standard deviation 1 / sqrt(2 * 4000) = 1.1 %; 5 of these
    assert learned.noise == pytest.approx(3.0, rel=0.056), seed


def test_long_records_are_learned_from_blocks():
    def record(samples: int, *also: int) -> Reading:
        return Reading(np.zeros(samples), 1 / RATE, T128, also=also)

    assert learning_blocks(record(100)) == [slice(0, 100)]
    blocks = learning_blocks(record(10 * LEARNING_SAMPLES))
    assert sum(block.stop - block.start for block in blocks) == LEARNING_SAMPLES
    assert blocks[0].start == 0
    assert blocks[-1].stop == 10 * LEARNING_SAMPLES
    assert all(one.stop <= two.start for one, two in itertools.pairwise(blocks))
    assert slice(77, 77 + blocks[0].stop) in learning_blocks(record(10 * LEARNING_SAMPLES, 77))


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_step_is_found_between_samples(noise):
    generator, seed = fresh()
    instant = 1 + generator.uniform(0, 1) / RATE
    (step,), learned = find_steps(released(generator, noise=noise, instant=instant))
    # Cramer-Rao: u = noise / (height w0 sqrt(sum of exp(-2 a t) / 2)) = 3e-7 s for 2 N, 1.5e-6 s for 10 N:
    # 0.1 sample (6e-5 s) is beyond any chance.
    assert abs(step.instant - instant) < 0.1 / RATE, seed
    assert abs(step.instant - instant) < 5 * step.instant_uncertainty, seed
    assert step.duration == 0.0, seed
    assert abs(step.height - STEP) < 5 * step.height_uncertainty, seed
    assert step.evidence > 25, seed
    assert learned.noise == pytest.approx(noise, rel=5 / np.sqrt(2 * 4800)), seed


@pytest.mark.parametrize(("noise", "allowed"), [(2.0, 0.1), (10.0, 0.3)])
def test_plateaus_beside_a_step_are_flat(noise, allowed):
    # The mean of 3200 (1600) samples is known to noise / sqrt(n) = 0.035 (0.05) N for 2 N, five times that for 10 N:
    # 0.1 and 0.3 N are the sought bounds, three standard deviations off on the longer plateau for 2 N.
    generator, seed = fresh()
    reading = released(generator, noise=noise, instant=1.00031)
    record = Recording.from_columns(
        np.arange(reading.values.size) / RATE, {"AF": Channel("AF", reading.values, "N")}, name="step"
    )
    estimate = reconstruct(record, T128)
    time = record.time
    errors = {"before": estimate.values[time < 1.0] + STEP, "after": estimate.values[time > 1.001]}
    for error in errors.values():
        # the constant's own uncertainty comes on top of the bound
        level = 4 * noise / np.sqrt(error.size)
        assert np.sqrt(np.mean(error**2)) < max(allowed, level), seed


@pytest.mark.parametrize("duration", [0.002, 0.005])
def test_ramps_are_found(duration):
    generator, seed = fresh()
    instant = 1 + generator.uniform(0, 1) / RATE
    (step,), _ = find_steps(released(generator, noise=2.0, instant=instant, duration=duration))
    # The amplitude of the ringing goes as sinc(f T): its relative slope by T is (pi f)^2 T / 3 = 29 1/s (2 ms),
    # and the amplitude is known to 2 / 1020 / sqrt(sum exp(-2 a t) / 2) = 1.1e-4: 4 us, 5 times that is 0.02 ms.
    assert step.duration == pytest.approx(duration, abs=2e-5), seed
    # the middle of the ramp is fixed by the phase to about 1e-6 s, the beginning by the duration's half as well
    assert step.instant + step.duration / 2 == pytest.approx(instant + duration / 2, abs=1e-5), seed
    assert abs(step.height - STEP) < 5 * step.height_uncertainty, seed


def test_two_steps_are_told_apart():
    generator, seed = fresh()
    time = np.arange(4800) / RATE
    load = 700 * T128.step_response(time - 0.80011) - 300 * T128.step_response(time - 0.93007)
    steps, _ = find_steps(Reading(load + generator.normal(0, 2, 4800), 1 / RATE, T128))
    assert len(steps) == 2, (steps, seed)
    for step, (instant, height) in zip(steps, ((0.80011, 700), (0.93007, -300)), strict=True):
        assert abs(step.instant - instant) < 5 * step.instant_uncertainty, (steps, seed)
        assert abs(step.height - height) < 5 * step.height_uncertainty, (steps, seed)


@pytest.mark.parametrize("edge", [30.0, 120.0])
def test_no_step_in_a_smooth_record(edge):
    # 25 in twice the log-likelihood for one of n instants: n exp(-25 / 2) = 0.02 at the very most for independent
    # instants, far less for correlated ones.
    generator, seed = fresh()
    assert find_steps(smooth_reading(generator, seconds=3.0, edge=edge))[0] == [], seed


def test_no_step_in_noise():
    generator, seed = fresh()
    assert find_steps(Reading(generator.normal(0, 2, 3000), 1 / RATE, T128))[0] == [], seed


def test_shape_of_a_step():
    reading = Reading(np.zeros(8), 0.1, T128)
    assert shape_of(Step(0.25, 0.0), reading) == pytest.approx([0, 0, 0, 1, 1, 1, 1, 1])
    assert shape_of(Step(0.15, 0.2), reading) == pytest.approx([0, 0, 0.25, 0.75, 1, 1, 1, 1])
