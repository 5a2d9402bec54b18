"""Uncertainty of a mass from gauge outputs: over many balances its error is as large as it says."""

import warnings

import numpy as np
import pytest
from scipy import stats

from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.weighing import WeightModel, fit_weight, points_from_recordings, with_matrix_errors
from aerobalance.balance.zeros import GaugeZero
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.gravity import weight_direction
from aerobalance.recording.recording import Recording
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_balance import random_balance
from seeds import trials

NOISE, SAMPLES = 1e-4, 100
"""Noise of a bridge over its output at half of range, and samples of a point."""


def scores(rng, balances, *, model, components, rolls, known_noise=False):
    """Error of the mass over its uncertainty, of balances drawn, calibrated and weighed anew, shape (balances,)."""
    pitch, roll = (angle.ravel() for angle in np.meshgrid(np.radians(np.arange(-12.0, 13, 4)), np.radians(rolls)))
    found = []
    for _ in range(balances):
        balance = random_balance(rng)
        truth, mass = balance.matrix, balance.mass
        noise = NOISE * float(truth.output_scale.min())
        schedule = CalibrationStand(truth, noise=noise, repeats=2).run(int(rng.integers(1 << 31))).schedule
        matrix = calibrate(schedule, model=model, reading_noise=noise if known_noise else 0.0).matrix
        values = np.array([mass.mass, *(mass.mass * mass.centre), *np.zeros(9)])
        loads = WeightModel(COMPONENTS).loads(weight_direction(pitch, roll), values)
        zero = noise / np.sqrt(SAMPLES) * rng.standard_normal(6)
        nothing = np.zeros(6)
        felt = []
        for number, row in enumerate(truth.outputs(loads)):
            outputs = row + noise * rng.standard_normal((SAMPLES, 6))
            channels = {f"r{name}": Channel(f"r{name}", outputs[:, i], "mV/V") for i, name in enumerate(COMPONENTS)}
            angles = {"pitch": pitch[number], "roll": roll[number]}
            still = {name: Channel(name, np.full(SAMPLES, angle), "rad") for name, angle in angles.items()}
            run = Recording.from_columns(np.arange(SAMPLES) / 1000, channels | still, name=f"{number}")
            felt.append(loads_of_outputs(run, matrix, zero=GaugeZero(zero, nothing, "zero", nothing, model_on=False)))
        points = with_matrix_errors(points_from_recordings([one.recording for one in felt], components), felt)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            weighing = fit_weight(points)
        found.append((weighing.mass - mass.mass) / weighing.u_mass)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
@pytest.mark.parametrize(
    ("components", "rolls"), [(("AF",), (0.0,)), (COMPONENTS, (0.0, 90.0, 180.0, 270.0))], ids=["AF", "all"]
)
@pytest.mark.parametrize(("model", "known_noise"), [("96", False), ("quadratic", True)], ids=["right", "wrong"])
@pytest.mark.soak(first=1)
def test_the_error_of_a_mass_is_as_large_as_its_uncertainty(rng, components, rolls, model, known_noise):
    balances = trials(2, 12)
    found = scores(rng, balances, model=model, components=components, rolls=rolls, known_noise=known_noise)
    square = np.mean(found**2)
    # chi-squared, 1e-4 on either side. What a fit of the wrong terms leaves is even in the loads and cancels between
    # opposite rolls; its length of likeness holds for what is odd too and is then on the safe side.
    low, high = (stats.chi2.ppf(p, balances) / balances for p in (1e-4, 1 - 1e-4))
    assert square < high
    assert square > low or (known_noise and len(rolls) > 1)


def test_errors_of_the_matrix_count_from_the_load_that_the_zero_was_read_under(rng):
    """None of them is left there, whether the weight or another load hung on the balance."""
    truth = random_balance(rng).matrix
    noise = NOISE * float(truth.output_scale.min())
    schedule = CalibrationStand(truth, noise=noise).run(int(rng.integers(1 << 31))).schedule
    matrix = calibrate(schedule, model="quadratic").matrix
    held, nothing = 0.3 * matrix.load_scale, np.zeros(6)
    outputs = np.tile(matrix.outputs(held[None]), (SAMPLES, 1))
    channels = {f"r{name}": Channel(f"r{name}", outputs[:, i], "mV/V") for i, name in enumerate(COMPONENTS)}
    pitch = Channel("pitch", np.zeros(SAMPLES), "rad")
    run = Recording.from_columns(np.arange(SAMPLES) / 1000, channels | {"pitch": pitch}, name="held")
    shared = []
    for zero in (
        GaugeZero(nothing, nothing, "zero", nothing, model_on=True, operating_point=held),
        GaugeZero(nothing, nothing, "zero", nothing, model_on=False),
    ):
        felt = loads_of_outputs(run, matrix, zero=zero)
        points = with_matrix_errors(points_from_recordings([felt.recording], COMPONENTS), [felt])
        shared.append(np.sqrt(np.abs(np.einsum("ncnc->nc", points.shared)[0])) / matrix.load_scale)
    # loads come back to 1e-12 of capacity, and the error goes with the load: 0.3 of capacity to 1e-11 of it
    assert (shared[0] < 1e-9 * shared[1]).all()
    assert (shared[1] > 0).all()
