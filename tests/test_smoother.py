"""The compiled filter and smoother against dense Gaussian conditioning, and the model against its closed forms."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, LOAD_RATE, KalmanFilter, StateSpace
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from helpers.butterworth import butterworth
from helpers.cable_cut import T128

INTERVAL = 1 / 1600
ORDERS = (1, 2, 4, 8)


def dense(system: StateSpace, present: np.ndarray, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint covariance of all states, conditioned by a linear solve: mean (n, d), variance of the force, and cov y."""
    A, Q, h = system.transition, system.process_noise, system.observation
    n, d = present.size, h.size
    marginal = [system.initial]
    for _ in range(n - 1):
        marginal.append(A @ marginal[-1] @ A.T + Q)
    joint = np.zeros((n, d, n, d))
    for i in range(n):
        block = marginal[i]
        for j in range(i, n):
            joint[j, :, i, :] = block
            joint[i, :, j, :] = block.T
            block = A @ block
    joint = joint.reshape(n * d, n * d)
    where = np.flatnonzero(present)
    observe = np.zeros((where.size, n * d))
    for row, k in enumerate(where):
        observe[row, k * d : (k + 1) * d] = h
    across = joint @ observe.T
    of_readings = observe @ across + system.noise_variance * np.eye(where.size)
    weights = np.linalg.solve(of_readings, across.T).T
    mean = (weights @ readings[where]).reshape(n, d)
    variance = np.diag(joint) - np.sum(weights * across, axis=1)
    return mean, variance.reshape(n, d)[:, FORCE], of_readings


def case(rng: np.random.Generator, order: int, *, missing: bool) -> tuple[StateSpace, np.ndarray, np.ndarray]:
    force = butterworth(order, cutoff=120.0, density=500.0)
    system = StateSpace.of_balance(T128, force, interval=INTERVAL, noise=2.0, input_density=0.5, swing=30.0)
    present = np.ones(60, dtype=bool)
    if missing:
        present[rng.choice(60, 12, replace=False)] = False
        present[0] = False
        present[30:36] = False
    return system, present, np.where(present, rng.normal(0, 300, 60), 0.0)


@pytest.mark.parametrize("missing", [False, True], ids=["whole", "gaps"])
@pytest.mark.parametrize("order", ORDERS)
def test_smoother_is_dense_conditioning(order, missing, rng):
    system, present, readings = case(rng, order, missing=missing)
    mean, variance, _ = dense(system, present, readings)
    filter_ = KalmanFilter.of(system, present)
    states, found = filter_.smooth(readings[:, None])[:, 0], filter_.smoothed_variance
    assert states.shape == (60, 3)
    # what the filter is taken to have forgotten is 1e-7 of a standard deviation
    mean = mean[:, :3]
    scale = np.max(np.abs(mean), axis=0)
    assert np.max(np.abs(states - mean) / scale) < 1e-6
    # and what adds less than 1e-6 to a variance is left out, of up to 10 states and on the average of a stretch
    assert found == pytest.approx(variance, rel=1e-4)


@pytest.mark.parametrize("missing", [False, True], ids=["whole", "gaps"])
def test_innovations_are_the_dense_likelihood(missing, rng):
    system, present, readings = case(rng, 4, missing=missing)
    covariance = dense(system, present, readings)[2]
    filter_ = KalmanFilter.of(system, present)
    white = filter_.whiten(readings[:, None])[:, 0]
    y = readings[present]
    assert white @ white == pytest.approx(y @ np.linalg.solve(covariance, y), rel=1e-6)
    assert filter_.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-6)


def test_whitening_several_series_is_whitening_each(rng):
    system, present, _ = case(rng, 2, missing=True)
    series = rng.normal(size=(60, 3))
    filter_ = KalmanFilter.of(system, present)
    together = filter_.whiten(series)
    for column in range(3):
        # products of matrices of another shape may add in another order
        alone = filter_.whiten(series[:, [column]])[:, 0]
        assert together[:, column] == pytest.approx(alone, rel=0, abs=1e-12 * np.max(np.abs(alone)))
    assert (together[~present] == 0).all()


@pytest.mark.parametrize("order", (*ORDERS, 16))
def test_spectrum_of_a_shaping_filter(order):
    frequency = np.array([0.0, 20.0, 79.0, 80.0, 120.0, 400.0])
    expected = 300 / (1 + (frequency / 80) ** (2 * order))
    # the eigenvectors of a chain of 16 integrators lose up to half the digits
    assert butterworth(order, cutoff=80.0, density=300.0).spectrum(frequency) == pytest.approx(expected, rel=1e-6)


def continuous(force: ShapingFilter, *, input_density: float = 7.0) -> tuple[np.ndarray, np.ndarray]:
    """The model in continuous time, written down anew: the oscillator, driven by the shaping filter."""
    w0, size = T128.angular_frequency, 2 + force.order
    A, B = np.zeros((size, size)), np.zeros((size, 2))
    A[0, 1], A[1, :3] = w0, [-w0, -T128.damping / T128.mass, w0]
    A[2:, 2:], B[2:, 1] = force.drift, force.drive
    B[1, 0] = w0 * np.sqrt(input_density)
    return A, B


@pytest.mark.parametrize("order", ORDERS)
def test_discretisation_is_the_integral(order):
    force = butterworth(order, cutoff=80.0, density=300.0)
    system = StateSpace.of_balance(T128, force, interval=INTERVAL, noise=1.0, input_density=7.0)
    A, B = continuous(force)
    noise, _ = quad_vec(lambda s: expm(A * s) @ B @ B.T @ expm(A * s).T, 0, INTERVAL, epsrel=1e-12)
    assert system.transition == pytest.approx(expm(A * INTERVAL), rel=1e-9, abs=1e-12)
    scale = np.sqrt(np.outer(np.diag(noise), np.diag(noise)))
    # the product over a part of the interval cancels digits where the noise has to pass a long chain: absolute, on the
    # process' own scale
    whole = np.sqrt(np.outer(np.diag(system.initial), np.diag(system.initial)))
    assert np.max(np.abs(system.process_noise - noise) / np.maximum(scale, whole)) < 1e-9
    if order <= 2:
        assert system.process_noise == pytest.approx(noise, rel=1e-7)


def test_states_far_faster_than_the_clock_are_discretised():
    # a corner a thousand times the sampling rate: exp(+2 pi 1000) is beyond double precision
    force = butterworth(1, cutoff=1000 / INTERVAL, density=300.0)
    system = StateSpace.of_balance(T128, force, interval=INTERVAL, noise=1.0)
    power = 300.0 * np.pi * 1000 / INTERVAL  # of a first-order spectrum, forgotten within the interval
    assert system.process_noise[FORCE, FORCE] == pytest.approx(power, rel=1e-9)
    # the load sees white noise of density 300: the stationary variance of Eq. (8) is density w0 / (4 zeta)
    variance = 300.0 * T128.angular_frequency / (4 * T128.damping_ratio)
    assert system.initial[LOAD, LOAD] == pytest.approx(variance, rel=1e-3)


def test_first_state_is_stationary():
    force = butterworth(4, cutoff=80.0, density=300.0)
    system = StateSpace.of_balance(T128, force, interval=INTERVAL, noise=1.0)
    later = system.transition @ system.initial @ system.transition.T + system.process_noise
    assert np.max(np.abs(later - system.initial)) < 1e-9 * np.max(system.initial)
    # power of a Butterworth spectrum of order n: 2 density cutoff (pi / 2n) / sin(pi / 2n), here n = 4
    power = 2 * 300.0 * 80.0 * (np.pi / 8) / np.sin(np.pi / 8)
    assert system.initial[FORCE, FORCE] == pytest.approx(power, rel=1e-9)


def test_swing_adds_a_free_oscillation():
    force = butterworth(1, cutoff=80.0, density=300.0)
    calm = StateSpace.of_balance(T128, force, interval=INTERVAL, noise=1.0)
    swung = StateSpace.of_balance(T128, force, interval=INTERVAL, noise=1.0, swing=5.0)
    expected = np.zeros(calm.initial.shape)
    expected[LOAD, LOAD] = expected[LOAD_RATE, LOAD_RATE] = 25.0
    assert swung.initial - calm.initial == pytest.approx(expected, abs=1e-9 * calm.initial.max())


def test_a_constant_force_makes_the_step_response_of_all_modes():
    balance = T128.with_modes(Mode(165.0, 0.008, -0.05), Mode(310.0, 0.015, 0.03))
    held = ShapingFilter(np.array([[-1e-12]]), np.zeros(1))
    system = StateSpace.of_balance(balance, held, interval=INTERVAL, noise=1.0, swing=1.0)
    state = np.zeros(system.transition.shape[0])
    state[FORCE] = 1.0
    loads = []
    for _ in range(300):
        loads.append(float(system.observation @ state))
        state = system.transition @ state
    # double precision over 300 products of a matrix of norm below 2
    assert loads == pytest.approx(balance.step_response(np.arange(300) * INTERVAL), abs=1e-10)


def test_noise_of_the_input_excites_all_modes_alike():
    balance = T128.with_modes(Mode(165.0, 0.008, -0.05))
    system = StateSpace.of_balance(balance, ShapingFilter.silent(), interval=INTERVAL, noise=1.0, input_density=7.0)
    # beyond, |G|^2 < 1e-7; a hundredth of a resonance's width from one to the next
    frequency = np.linspace(0, 4e3, 1_000_001)
    transfer = balance.response(frequency)
    power = 2 * 7.0 * np.trapezoid(np.abs(transfer) ** 2, frequency)  # of white noise through Eq. (8), all modes
    assert system.initial[LOAD, LOAD] == pytest.approx(power, rel=1e-4)


def test_modes_that_show_their_rate_are_driven_as_their_closed_form_says():
    balance = T128.with_modes(Mode(110.0, 0.03, 0.2, 4e-4), Mode(260.0, 0.4, -0.05, 1e-4))
    nearly_constant = ShapingFilter(np.array([[-1e-9]]), np.array([0.0]))
    system = StateSpace.of_balance(balance, nearly_constant, interval=INTERVAL, noise=1.0)
    state = np.zeros(system.transition.shape[0])
    state[FORCE] = 1.0
    loads = []
    for _ in range(200):
        loads.append(state[LOAD])
        state = system.transition @ state
    # 1e-9 of the force is lost a second; the exponential of a few milliseconds at 260 Hz is exact to rounding
    np.testing.assert_allclose(loads, balance.step_response(np.arange(200) * INTERVAL), atol=1e-9)
