"""The likelihood of a step from a few whitened shapes against that of the whitened response itself."""

import numpy as np
import pytest

from aerobalance.dynamics.single import Mode
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.statespace.kalman import KalmanFilter, StateSpace
from aerobalance.estimation.step_window import StepWindow
from helpers.butterworth import butterworth
from helpers.cable_cut import T128

INTERVAL = 1 / 1600
N = 4096
BALANCES = {
    "one mode": T128,
    "modes that show their rate": T128.with_modes(Mode(110.0, 0.03, 0.2, 4e-4), Mode(260.0, 0.4, -0.05, 1e-4)),
    "a mode beyond critical damping": T128.with_modes(Mode(90.0, 1.5, 0.1)),
    "a mode at critical damping": T128.with_modes(Mode(90.0, 1.0, 0.1)),
}


@pytest.mark.parametrize("gap", [True, False], ids=["gap", "no gap"])
@pytest.mark.parametrize("balance", BALANCES)
def test_squares_are_those_of_the_whitened_response(balance, gap, rng):
    dynamics, time = BALANCES[balance], np.arange(N) * INTERVAL
    values = 100 * dynamics.step_response(time - 1.2345, duration=0.003) + rng.normal(0, 0.5, N)
    if gap:
        values[1990:1995] = np.nan
    reading = Observation(values, INTERVAL, dynamics)
    force = butterworth(4, cutoff=60.0, density=1.0)
    system = StateSpace.of_balance(dynamics, force, interval=INTERVAL, noise=0.5, swing=100.0)
    filter_ = KalmanFilter.of(system, reading.present)
    window = StepWindow.of(reading, filter_, np.ones((N, 1)))
    assert filter_.has_no_gaps != gap
    white = filter_.whiten(np.column_stack([reading.filled, np.ones(N)]))
    basis = white[:, 1:] / np.linalg.norm(white[:, 1])
    left = white[:, 0] - basis @ (basis.T @ white[:, 0])
    tried = [(1.2345, 0.003), (1.2345, 0.0), (1.23, 0.02), (1.23, 0.4), (0.0, 0.0), (-0.001, 0.004)]
    for instant, duration in (*tried, (N * INTERVAL - 0.002, 0.001)):
        column = filter_.whiten(dynamics.step_response(time - instant, duration=duration)[:, None])
        column -= basis @ (basis.T @ column)
        expected = left @ left - (left @ column[:, 0]) ** 2 / (column[:, 0] @ column[:, 0])
        # 1e4 numbers of order 1 are squared and summed; an evidence of 1e-2 decides nothing
        assert window.squares(instant, duration) == pytest.approx(expected, abs=1e-2), (instant, duration)
