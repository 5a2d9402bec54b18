"""Damped Gauss-Newton steps on Rosenbrock's valley, whose minimum is known."""

import numpy as np
import pytest

from aerobalance.identification.levenberg_marquardt import FACTOR, DampedStep, Settings, levenberg_marquardt


def residuals(point):
    x, y = point
    return np.array([10 * (y - x**2), 1 - x])


def cost(point):
    return float(np.sum(residuals(point) ** 2))


def step_in(dampings):
    """DampedStep of the valley, which notes the damping parameter of each."""

    def step(point, damping):
        dampings.append(damping)
        jacobian = np.array([[-20 * point[0], 10.0], [-1.0, 0.0]])
        rows = np.vstack([jacobian, damping * np.eye(2)])
        move = np.linalg.lstsq(rows, np.concatenate([-residuals(point), np.zeros(2)]))[0]
        promised = cost(point) - float(np.sum((residuals(point) + jacobian @ move) ** 2))
        return DampedStep(promised, lambda: (point + move, cost(point + move)))

    return step


START = np.array([-1.2, 1.0])
SETTINGS = Settings(most_steps=500, enough=1e-12, raised=1e-3)


@pytest.mark.parametrize("last", [False, True])
def test_the_minimum_is_found(last):
    settings = Settings(most_steps=500, enough=1e-12, raised=1e-3, last=last)
    found, costs, settled = levenberg_marquardt(START, cost(START), step_in([]), settings)
    assert settled
    # near the minimum the promised drop is the cost, (1 - x)^2 along the valley
    np.testing.assert_allclose(found, 1.0, atol=3e-6)
    assert (np.diff(costs) <= 0).all()


def test_a_step_that_misses_is_damped_more_and_one_that_hits_less():
    dampings = []
    _, costs, _ = levenberg_marquardt(START, cost(START), step_in(dampings), SETTINGS)
    missed = np.diff(costs) == 0
    assert missed.any() and not missed.all()
    for before, after, miss in zip(dampings, dampings[1:], missed, strict=False):
        if miss:
            assert after == max(FACTOR * before, SETTINGS.raised)
        else:
            assert after == (before / FACTOR if before > SETTINGS.negligible else 0.0)


def test_steps_that_are_used_up_have_not_settled():
    found, costs, settled = levenberg_marquardt(START, cost(START), step_in([]), Settings(most_steps=3, enough=1e-12))
    assert not settled
    assert len(costs) == 4
    assert costs[-1] == cost(found)


def test_a_flat_valley_is_settled():
    settings = Settings(most_steps=500, enough=0.0, raised=1e-3, valley=3, flat=2 * cost(START))
    _, costs, settled = levenberg_marquardt(START, cost(START), step_in([]), settings)
    assert settled
    assert len(costs) == 4
