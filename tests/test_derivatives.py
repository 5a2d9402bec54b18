"""A force as a sum of what moves with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from aerobalance.estimation.error_sources import Contribution, Noise, Systematic
from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.uncertainty.regression import regress

SAMPLES = 1200
TIME = np.arange(SAMPLES) / SAMPLES
SWING = {"constant": 1.0, "angle": np.sin(2 * np.pi * 20 * TIME), "rate": np.cos(2 * np.pi * 20 * TIME)}
TRUTH = np.array([40.0, -7.0, 0.5])


def _force(values: Array, *parts: Contribution) -> ComponentForce:
    none = np.zeros(values.size)
    return ComponentForce("PM", values, none, "given", noise=0.0, bandwidth=0.0, noise_gain=1.0, contributions=parts)


def _columns() -> Array:
    return np.column_stack([np.broadcast_to(column, SAMPLES) for column in SWING.values()])


def test_coefficients_of_an_exact_sum_come_back() -> None:
    found = regress(_force(_columns() @ TRUTH), SWING)
    # rounding of sums of 1200 numbers of size 50
    np.testing.assert_allclose(found.values, TRUTH, rtol=0, atol=1e-12 * 50)
    assert found.of("rate") == (pytest.approx(0.5), pytest.approx(0, abs=1e-10))
    assert found.residual.shape == (SAMPLES,)


def test_white_noise_gives_the_covariance_of_least_squares() -> None:
    white = Noise("noise", "PM", np.full(SAMPLES, 0.3), np.ones(1))
    columns = _columns()
    found = regress(_force(columns @ TRUTH, white), SWING)
    # closed form: sigma^2 (R^T R)^-1
    np.testing.assert_allclose(found.measured, 0.09 * np.linalg.inv(columns.T @ columns), atol=1e-12)
    np.testing.assert_allclose(found.measured_uncertainty, np.sqrt(np.diag(found.measured)))


def test_a_gain_that_is_not_known_moves_all_coefficients_together() -> None:
    values = _columns() @ TRUTH
    gain = Systematic("gain", "PM", ("gain",), values[:, None], np.array([[1e-6]]))
    found = regress(_force(values, gain), SWING)
    np.testing.assert_allclose(found.measured, 1e-6 * np.outer(TRUTH, TRUTH), atol=1e-15 * 1600)


def test_one_sum_has_the_variance_that_a_contribution_gives_it(rng) -> None:
    red = Noise("noise", "PM", 1 + TIME, 1 / np.linspace(1, 30, 601))
    weights = rng.normal(size=(3, SAMPLES))
    found = red.covariance_of(weights)
    for place in range(3):
        assert found[place, place] == pytest.approx(red.variance_of(weights[place]))
    both = red.variance_of(weights[0] + weights[1])
    assert found[:2, :2].sum() == pytest.approx(both)


def _buffeting(rng: np.random.Generator, keep: float) -> Array:
    """First-order autoregression of unit variance, in its stationary state: power mostly below a corner."""
    from scipy.signal import lfilter

    white = rng.normal(size=SAMPLES + 400) * np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white)[400:])


@pytest.mark.soak(first=0)
@pytest.mark.parametrize("keep", [0.0, 0.8])
def test_uncertainty_from_what_is_left_is_that_of_many_runs(keep: float, rng) -> None:
    runs, columns = 300, _columns()
    scores = []
    for _ in range(runs):
        found = regress(_force(columns @ TRUTH + 3 * _buffeting(rng, keep)), SWING)
        scores.append((found.values - TRUTH) / found.uncertainty)
        freedom = found.degrees_of_freedom
    # t-distributed with the freedom that is stated; the mean square of 300 of them scatters by the fourth moment, and
    # 4.5 standard deviations are allowed, with 10 % for the slope of the spectrum over the tapers' band
    for place, name in enumerate(SWING):
        square = float(np.mean(np.array(scores)[:, place] ** 2)) / stats.t(freedom[place]).var()
        spread = 4.5 * np.sqrt((2 + 6 / (freedom[place] - 4)) / runs)
        assert abs(square - 1) < 0.1 + spread, f"{name}: {square}"


def test_a_mean_over_a_span_uses_only_the_span() -> None:
    values = np.where(TIME < 0.5, 1e6, 2.0)
    white = Noise("noise", "PM", np.where(TIME < 0.5, 1e6, 0.1), np.ones(1))
    found = regress(_force(values, white), {"mean": 1.0}, span=slice(700, 1100))
    value, u = found.of("mean")
    assert value == pytest.approx(2.0)
    assert u == pytest.approx(0.1 / np.sqrt(400), rel=1e-6)
    assert found.residual.size == 400


def test_wrong_calls_and_poor_data_are_named() -> None:
    force = _force(_columns() @ TRUTH)
    with pytest.raises(FitError, match="regressor twice is zero or a linear combination"):
        regress(force, {**SWING, "twice": 2 * SWING["angle"]})
    with pytest.raises(FitError, match="too few for 1 regressors"):
        regress(force, {"mean": 1.0}, span=slice(0, 40))
    with pytest.raises(ValueError, match="must have shape"):
        regress(force, {"angle": np.ones(3)})
    with pytest.raises(ValueError, match="not finite"):
        regress(force, {"angle": np.full(SAMPLES, np.nan)})
    with pytest.raises(ValueError, match="consecutive samples"):
        regress(force, SWING, span=slice(0, 1000, 2))
    with pytest.raises(ValueError, match="no regressor drag"):
        regress(force, SWING).of("drag")
