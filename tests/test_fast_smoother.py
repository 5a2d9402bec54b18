"""The smoother by blocks against the one sample by sample: starts, ends, gaps, many states, noise of any size."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import irfft

from aerobalance.dynamics.single import Dynamics, Mode
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.spectra.noise_spectrum import ColoredNoise
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, KalmanFilter, StateSpace
from aerobalance.estimation.statespace.model_draws import FORGOTTEN, ModelDraws
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.estimation.statespace.steady_state import root_of
from aerobalance.estimation.steps import Step, columns_of
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_signals import Band, broadband
from helpers.butterworth import butterworth
from helpers.cable_cut import T128
from helpers.slow_smoother import SlowSmoother

INTERVAL = 1 / 1600
RIG = Dynamics("AF", 0.68, 11.43e6, 371.98)
TOLERANCE = 0.01
"""Of the standard uncertainty: an error that no uncertainty shows."""


def gusts(dynamics: Dynamics, *, edge: float, rate: float, noise: float = 2.0, **known: float) -> StateSpace:
    """A model with a sharp edge, learned from a record of such gusts."""
    rng = np.random.default_rng(7)
    n = 4000
    frequency = np.fft.rfftfreq(n, 1 / rate)
    inside = (frequency > 0) & (frequency < edge)
    spectrum = np.where(inside, rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size), 0)
    force = np.fft.irfft(spectrum, n)
    load = np.fft.irfft(np.fft.rfft(500 * force / force.std()) * dynamics.response(frequency), n)
    reading = Observation(load + rng.normal(0, noise, n), 1 / rate, dynamics, **known)
    return reading.system(fit_prior(reading, columns=np.ones((n, 1))))


def drawn(rng: np.random.Generator) -> StateSpace:
    """A model with modes, damping, colors and noise as they come."""
    modes = [
        Mode(float(rng.uniform(90, 500)), float(rng.uniform(1e-3, 0.3)), float(rng.normal(0, 0.1)))
        for _ in range(rng.integers(0, 3))
    ]
    balance = Dynamics("AF", 177.87, 3.093e7, float(10 ** rng.uniform(2, 5))).with_modes(*modes)
    return StateSpace.of_balance(
        balance,
        butterworth(int(rng.choice([1, 2, 4, 6])), cutoff=float(rng.uniform(20, 300)), density=500.0),
        interval=INTERVAL,
        noise=float(10 ** rng.uniform(-1.5, 2)),
        input_density=float(rng.choice([0.0, 0.5, 50.0])),
        swing=float(rng.choice([0.0, 30.0, 3000.0])),
        colors=[butterworth(1, cutoff=float(rng.uniform(1, 30)), density=1.0)] if rng.random() < 0.5 else (),
    )


MODELS = {
    "learned, T-128, 0-120 Hz": lambda: gusts(T128, edge=120.0, rate=1600.0),
    "learned, T-128, shaken ground": lambda: gusts(T128, edge=120.0, rate=1600.0, input_density=0.5),
    "learned, rig, 0-300 Hz": lambda: gusts(RIG, edge=300.0, rate=25e3),
    "decoupled: a mode that shows its rate": lambda: StateSpace.of_balance(
        T128.with_modes(Mode(110.0, 0.03, 0.2, 4e-4), Mode(260.0, 0.4, -0.05, 1e-4)),
        butterworth(4, cutoff=120.0, density=500.0),
        interval=INTERVAL,
        noise=2.0,
        swing=300.0,
    ),
    "colored noise": lambda: StateSpace.of_balance(
        T128,
        butterworth(4, cutoff=120.0, density=500.0),
        interval=INTERVAL,
        noise=2.0,
        swing=100.0,
        colors=(butterworth(1, cutoff=1.0, density=1.0), butterworth(2, cutoff=300.0, density=0.01)),
    ),
    "16 states beside each other": lambda: StateSpace.of_balance(
        T128, butterworth(16, cutoff=120.0, density=500.0), interval=INTERVAL, noise=0.5, swing=30.0
    ),
    "no force": lambda: StateSpace.of_balance(T128, ShapingFilter.silent(), interval=INTERVAL, noise=2.0, swing=100.0),
    **{f"drawn {seed}": lambda seed=seed: drawn(np.random.default_rng(seed)) for seed in range(8)},
}


def gaps(n: int, kind: str) -> np.ndarray:
    present = np.ones(n, dtype=bool)
    if kind == "gaps":
        for first, length in ((0, 2), (100, 1), (103, 1), (130, 3), (700, 50), (1990, 2), (n - 1, 1)):
            present[first : first + length] = False
    elif kind == "a long gap":
        present[600 : n - 400] = False
    return present


def simulated(rng: np.random.Generator, system: StateSpace, n: int) -> np.ndarray:
    """Readings of a model."""
    d = system.transition.shape[0]
    noise = root_of(system.process_noise) @ rng.normal(size=(d, n))
    state = root_of(system.initial) @ rng.normal(size=d)
    values = np.empty(n)
    for k in range(n):
        values[k] = system.observation @ state
        state = system.transition @ state + noise[:, k]
    return values + np.sqrt(system.noise_variance) * rng.normal(size=n)


@pytest.mark.soak(first=2 * len(MODELS))
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("kind", "n"), [("gaps", 2500), ("whole", 50), ("a long gap", 4000), ("whole", 2500)])
def test_smoothing_by_blocks_is_smoothing_sample_by_sample(model, kind, n, rng):
    system = MODELS[model]()
    present = gaps(n, kind)
    values = np.where(present, simulated(rng, system, n), 0.0)
    step = np.where(present, np.arange(n) > n // 3, 0.0)
    fast, slow = KalmanFilter.of(system, present), SlowSmoother(system, present)
    series = np.column_stack([values, step])
    ours, oracle = fast.smooth(series), slow.smooth(series)
    variance = slow.smoothed_variance
    # rounding of a variance that is known to 1e-7 of the force's own is none
    deviation = np.sqrt(np.maximum(variance, 1e-14 * system.initial[FORCE, FORCE] + 1e-12 * system.noise_variance))
    assert np.max(np.abs(ours[:, 0, FORCE] - oracle[:, 0, FORCE]) / deviation) < TOLERANCE
    size = np.sqrt(system.noise_variance)
    assert np.max(np.abs(ours[:, 0, LOAD] - oracle[:, 0, LOAD])) < TOLERANCE * size
    assert np.max(np.abs(ours[:, 1] - oracle[:, 1])) < 1e-6 * max(1.0, float(np.max(np.abs(oracle[:, 1]))))
    assert np.sqrt(fast.smoothed_variance + 1e-300) == pytest.approx(deviation, rel=TOLERANCE, abs=TOLERANCE * 1e-3)


@pytest.mark.soak(first=len(MODELS))
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("kind", "n"), [("gaps", 2500), ("whole", 50), ("a long gap", 4000), ("whole", 2500)])
def test_sums_of_what_is_shown_are_those_of_the_innovations(model, kind, n, rng):
    system = MODELS[model]()
    present = gaps(n, kind)
    series = np.where(present, simulated(rng, system, n), 0.0)[:, None]
    filter_ = KalmanFilter.of(system, present)
    shown = np.empty((1, filter_.shown))
    states = filter_.smooth(series, [FORCE], shown=shown)
    weights = rng.normal(size=(3, filter_.shown))
    again, sums = filter_.smooth_and_sum(series, [FORCE], filter_.weighed(weights))
    np.testing.assert_array_equal(again, states)
    # rounding of the readings, through a filter that may make as much of each as its largest number
    size = np.sqrt(filter_.shown / system.noise_variance) * np.max(np.abs(series))
    assert np.abs(sums - weights @ shown.T).max() < 1e-9 * max(size, float(np.abs(shown).max()))


STEPS = {
    "at start and end": (0.0, 0.8, 2.6, -3.3, -0.4),  # the last samples count from the end
    "inside": (611.0, 1403.4, 1405.1),
    "beside gaps and in them": (99.6, 103.5, 129.4, 131.7, 133.2, 699.5, 711.3, 749.5, 1989.4, 1992.2),
}
"""Instants of steps in samples of `gaps(2500, "gaps")`."""


def in_two_ways(
    reading: Observation, learned: SpectralPrior, steps: Sequence[Step], monkeypatch: pytest.MonkeyPatch
) -> tuple[SmootherResult, SmootherResult]:
    """The force of a record, its prior and the instants of its steps given: by blocks, and sample by sample."""
    fast = SmootherResult.of(reading, learned=learned, steps=steps)
    with monkeypatch.context() as patched:
        patched.setattr(
            "aerobalance.estimation.force_smoother.KalmanFilter", type("Slow", (), {"of": staticmethod(SlowSmoother)})
        )
        return fast, SmootherResult.of(reading, learned=learned, steps=steps)


def check_same_force(fast: SmootherResult, slow: SmootherResult, *, rms: float) -> None:
    """At every sample the same force to 0.01 u, the part of u that steps add not counted."""
    # rounding of a variance that is known to 1e-7 of the force's own is none
    deviation = np.sqrt(np.maximum(slow.variance, 1e-14 * rms**2))
    assert np.max(np.abs(fast.force - slow.force) / deviation) < TOLERANCE
    assert np.max(np.abs(np.sqrt(fast.variance) - deviation) / deviation) < TOLERANCE


@pytest.mark.parametrize("where", STEPS)
@pytest.mark.parametrize("missing", [False, True], ids=["whole", "gaps"])
@pytest.mark.parametrize("color", [False, True], ids=["white", "colored noise"])
def test_forces_with_steps_are_those_sample_by_sample(where, missing, color, rng, monkeypatch):
    n = 2500
    frequency = np.fft.rfftfreq(n, INTERVAL)
    inside = (frequency > 0) & (frequency < 120)
    spectrum = np.where(inside, rng.normal(size=inside.size) + 1j * rng.normal(size=inside.size), 0)
    noise, known = rng.normal(0, 2.0, n), {}
    if color:
        relaxations = ColoredNoise(np.array([1.0, 30.0]), np.array([9.0, 16.0]), (), INTERVAL)
        known = {"noise": 2.0, "color": relaxations}
        white = np.fft.rfft(rng.normal(size=n))
        noise += np.fft.irfft(white * np.sqrt(relaxations.density(frequency) / INTERVAL), n)
    load = np.fft.irfft(spectrum * T128.response(frequency), n)
    values = 300 * load / load.std() + noise
    steps = [Step((at if at >= 0 else n + at) * INTERVAL, 0.0) for at in STEPS[where]]
    reading = Observation(values, INTERVAL, T128, **known)
    values = values + columns_of(steps, reading)[:, 1:] @ rng.normal(0, 500, len(steps))
    reading = replace(reading, values=np.where(gaps(n, "gaps" if missing else "whole"), values, np.nan))
    learned = fit_prior(reading, columns=columns_of(steps, reading))
    fast, slow = in_two_ways(reading, learned, steps, monkeypatch)
    check_same_force(fast, slow, rms=500.0)


@pytest.mark.parametrize("missing", [True, False], ids=["gaps", "whole"])
@pytest.mark.soak(first=1)
def test_forces_of_six_components_are_those_sample_by_sample(missing, rng, monkeypatch):
    """Each along its decoupled component, with steps at the start, inside, in a gap and at the end."""
    balance = random_balance(rng)
    dynamics = replace(balance.dynamics, mass=balance.mass)
    load = broadband(rng, Band(0, 400.0), rms=0.1 * balance.half_range, period=0.4)
    run = SixComponentRig(balance, applied=load, output="loads").run(0.1, rng).recording
    record = force_record(run, dynamics)
    n = run.samples
    steps = [Step(at / run.rate, 0.0) for at in (1.4, 1203.3, 711.3, n - 3.3)]
    for name, one in record.component_records(record.loads).items():
        reading = one.reading()
        size = 0.1 * balance.half_range[list(record.dynamics.components).index(name)]
        values = reading.values + columns_of(steps, reading)[:, 1:] @ rng.normal(0, size, len(steps))
        reading = replace(reading, values=np.where(gaps(n, "gaps" if missing else "whole"), values, np.nan))
        learned = fit_prior(reading, columns=columns_of(steps, reading))
        check_same_force(*in_two_ways(reading, learned, steps, monkeypatch), rms=size)


@pytest.mark.parametrize("kind", ["whole", "gaps"])
@pytest.mark.parametrize("model", MODELS)
def test_likelihood_by_blocks_is_that_sample_by_sample(model, kind, rng):
    n = 2500
    system, present = MODELS[model](), gaps(n, kind)
    series = np.column_stack([np.where(present, simulated(rng, system, n), 0.0), present, present * np.arange(n) / n])
    fast, slow = KalmanFilter.of(system, present), SlowSmoother(system, present)
    ours, oracle = (white.T @ white for white in (fast.whiten(series), slow.whiten(series)))
    scale = np.sqrt(np.outer(np.diag(oracle), np.diag(oracle)))
    # a likelihood is a sum of n = 2500 and differences of 1 matter; 1e-6 of it is a four-hundredth
    assert np.max(np.abs(ours - oracle) / scale) < 1e-6
    assert fast.log_determinant == pytest.approx(slow.log_determinant, abs=1e-3)


def test_settled_filter_is_the_one_long_after_the_start(rng):
    system = MODELS["colored noise"]()
    n = 6000
    series = np.zeros((n, 1))
    series[4000:] = rng.normal(size=(2000, 1))
    present = np.ones(n, dtype=bool)
    settled = KalmanFilter.of(system, present).settled.whiten(series[4000 - 1 :].copy())
    # what is seen of the start then is less than 1e-7 of a standard deviation
    whole = SlowSmoother(system, present).whiten(series)[4000:]
    assert settled[1:2001] == pytest.approx(whole, abs=1e-6 * np.max(np.abs(whole)))


@pytest.mark.parametrize("noise", [1e-2, 1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("order", [2, 8, 16])
@pytest.mark.parametrize("kind", ["whole", "gaps"])
def test_readings_almost_without_noise_stay_within_reason(order, noise, kind, rng):
    system = StateSpace.of_balance(
        T128, butterworth(order, cutoff=120.0, density=500.0), interval=INTERVAL, noise=noise, swing=500.0
    )
    n = 3000
    present = gaps(n, kind)
    values = np.where(present, simulated(rng, system, n), 0.0)
    filter_ = KalmanFilter.of(system, present)
    states, variance = filter_.smooth(values[:, None])[:, 0], filter_.smoothed_variance
    assert np.isfinite(states).all()
    assert np.isfinite(variance).all()
    # what is read is reproduced to a millionth, and the force is nowhere beyond what such a force reaches
    assert np.max(np.abs(states[present, LOAD] - values[present])) < 1e-6 * np.max(np.abs(values)) + 6 * noise
    assert np.max(np.abs(states[:, FORCE])) < 10 * np.sqrt(system.initial[FORCE, FORCE])
    assert np.isfinite(filter_.log_determinant)


@pytest.mark.parametrize("values", [np.zeros(400), np.full(400, 7.0)])
def test_records_without_any_force_or_noise(values):
    system = StateSpace.of_balance(T128, ShapingFilter.silent(), interval=INTERVAL, noise=1e-60, swing=1e-60)
    filter_ = KalmanFilter.of(system, np.ones(400, dtype=bool))
    assert np.isfinite(filter_.whiten(values[:, None])).all()
    assert np.isfinite(filter_.smooth(values[:, None])).all()
    assert (filter_.smoothed_variance >= 0).all()


def test_no_reading_at_all(rng):
    system = MODELS["colored noise"]()
    present = np.zeros(100, dtype=bool)
    filter_, slow = KalmanFilter.of(system, present), SlowSmoother(system, present)
    assert filter_.smoothed_variance == pytest.approx(slow.smoothed_variance, rel=1e-9)
    assert (filter_.smooth(np.zeros((100, 1))) == 0).all()
    assert filter_.log_determinant == 0


@pytest.mark.parametrize("kind", ["none", "gaps", "a long gap"])
def test_products_of_what_is_shown_are_those_of_whitened_series(kind: str, rng) -> None:
    n = 2000
    system, present = MODELS["colored noise"](), gaps(n, kind)
    series = np.column_stack([np.where(present, simulated(rng, system, n), 0.0), present, present * np.arange(n) / n])
    filter_ = KalmanFilter.of(system, present)
    shown = np.empty((3, filter_.shown))
    filter_.smooth(series, [FORCE], shown=shown)
    white = filter_.whiten(series)
    expected = white.T @ white
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(shown @ shown.T / np.outer(size, size), expected / np.outer(size, size), atol=1e-8)


def test_drawn_forces_and_readings_have_the_covariance_of_the_model() -> None:
    for name in ("learned, T-128, 0-120 Hz", "decoupled: a mode that shows its rate", "colored noise"):
        system = MODELS[name]()
        draws = ModelDraws.of(system, np.ones(4000, dtype=bool))
        weight = np.full(draws.reading.size, np.sqrt(draws.length / 2))
        weight[0] *= np.sqrt(2)
        weight[-1] *= np.sqrt(2) if draws.length % 2 == 0 else 1
        y, shared, own = (part / weight for part in (draws.reading, draws.shared, draws.own))
        stationary = settled(system)
        for lag in (0, 1, 7, 60, 300):
            A = np.linalg.matrix_power(system.transition, lag)
            h, f = system.observation, np.eye(len(A))[FORCE]
            pairs = (
                (y**2, h @ A @ stationary @ h + (lag == 0) * system.noise_variance, h, h),
                (np.abs(shared) ** 2 + own**2, f @ A @ stationary @ f, f, f),
                (shared * y, f @ A @ stationary @ h, f, h),
            )
            for spectrum, expected, one, other in pairs:
                size = np.sqrt((one @ stationary @ one) * (other @ stationary @ other))
                # of a draw that repeats itself the end hangs together with the start by so much
                assert abs(irfft(spectrum, draws.length)[lag] - expected) < 2 * FORGOTTEN * size


def settled(system: StateSpace) -> np.ndarray:
    """Covariance of a state long after the start: what each sample's noise still makes of it, one after the other."""
    whole, part = np.zeros_like(system.process_noise), system.process_noise
    while np.trace(part) > 1e-9 * np.trace(whole):
        whole, part = whole + part, system.transition @ part @ system.transition.T
    return whole
