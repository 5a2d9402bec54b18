"""Coupled dynamics against mechanics of points, equations of motion in displacements, and single components."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.signal import lsim
from scipy.stats import chi2

from aerobalance.balance.weighing.model import WeightModel
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.gravity import weight_direction
from aerobalance.simulation import random_balance

AFT, RIGHT, UP = np.eye(3)
PLACE = {name: index for index, name in enumerate(COMPONENTS)}
SINGLE = (
    Dynamics("NF", 20.0, 2e7, 400.0),
    Dynamics("PM", 0.8, 3e5, 5.0),
    Dynamics("AF", 18.0, 3e7, 900.0),
)


def points(generator, count=7):
    """Point masses [kg] and where they are [m], and the same as a rigid mass."""
    masses, places = generator.uniform(0.5, 3, count), generator.uniform(-0.4, 0.4, (count, 3))
    total = masses.sum()
    centre = masses @ places / total
    away = places - centre
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, away, strict=True))
    return masses, places, RigidMass(float(total), centre, (inertia + inertia.T) / 2)


def six_loads(masses, places, accelerations):
    """Loads that take these accelerations, from the words of the conventions: nose up turns about right, and so on."""
    forces = masses[:, None] * accelerations
    force, moment = forces.sum(axis=0), np.cross(places, forces).sum(axis=0)
    found = {
        "NF": force @ UP,
        "SF": force @ RIGHT,
        "AF": force @ AFT,
        "PM": moment @ RIGHT,
        "YM": -moment @ UP,
        "RM": -moment @ AFT,
    }
    return np.array([found[name] for name in COMPONENTS])


def turn_vector(turns):
    """Right-handed turn from nose up, nose right, right side down."""
    return turns[0] * RIGHT - turns[1] * UP - turns[2] * AFT


def test_mass_matrix_is_that_of_accelerated_points(rng):
    masses, places, body = points(rng)
    acceleration = rng.normal(0, 1, 6)
    linear = acceleration[PLACE["AF"]] * AFT + acceleration[PLACE["SF"]] * RIGHT + acceleration[PLACE["NF"]] * UP
    turn = turn_vector([acceleration[PLACE[name]] for name in MOMENTS])
    expected = six_loads(masses, places, linear + np.cross(turn, places))
    # sums of a few terms of size up to 30: rounding only
    np.testing.assert_allclose(body.matrix @ acceleration, expected, atol=1e-12)
    np.testing.assert_allclose(body.matrix, body.matrix.T, atol=1e-14)
    assert (np.linalg.eigvalsh(body.matrix) > 0).all()


@pytest.mark.parametrize(
    ("centre", "force", "turn", "sign"),
    [
        ((-1, 0, 0), "NF", "PM", 1),  # turned nose up, a mass in the nose rises
        ((-1, 0, 0), "SF", "YM", 1),  # turned nose right, it goes to the right
        ((0, 1, 0), "NF", "RM", -1),  # turned right side down, a mass on the right sinks
        ((0, 0, 1), "AF", "PM", 1),  # turned nose up, a mass on top goes aft
        ((0, 0, 1), "SF", "RM", 1),  # turned right side down, it goes to the right
        ((0, 1, 0), "AF", "YM", 1),  # turned nose right, a mass on the right goes aft
    ],
)
def test_signs_of_the_mass_matrix(centre, force, turn, sign):
    body = RigidMass(2.0, np.array(centre, dtype=float), np.eye(3))
    assert body.matrix[PLACE[force], PLACE[turn]] == sign * 2.0


def test_turning_load_is_that_of_points_on_circles(rng):
    masses, places, body = points(rng)
    rates = rng.normal(0, 3, (4, 3))
    for rate, found in zip(rates, body.turning_load(rates), strict=True):
        w = turn_vector(rate)
        expected = six_loads(masses, places, np.cross(w, np.cross(w, places)))
        np.testing.assert_allclose(found, expected, atol=1e-11)


def test_weight_is_what_weighing_expects(rng):
    body = points(rng)[2]
    pitch, roll = rng.uniform(-1, 1, (2, 9))
    model = WeightModel(COMPONENTS)
    known = {"mass": body.mass} | {
        f"moment.{axis}": body.mass * lever for axis, lever in zip(("aft", "right", "up"), body.centre, strict=True)
    }
    values = np.array([known.get(name, 0.0) for name in model.names])
    expected = model.loads(weight_direction(pitch, roll), values)
    np.testing.assert_allclose(body.weight(pitch, roll), expected, atol=1e-11)


def test_response_is_that_of_mass_damper_and_spring(rng):
    balance = random_balance(rng)
    frequency = rng.uniform(0, 1000, 20)
    for f, found in zip(frequency, balance.dynamics.response(frequency), strict=True):
        w = 2 * np.pi * f
        dynamic = balance.stiffness + 1j * w * balance.damping - w**2 * balance.mass.matrix
        expected = balance.stiffness @ np.linalg.inv(dynamic)
        scale = np.outer(balance.half_range, 1 / balance.half_range)
        # condition of K and M over half range is about 1e3, of the response at resonance about 1e3: 1e-16 x 1e6
        assert np.abs((found - expected) / scale).max() < 1e-9 * np.abs(expected / scale).max()


@pytest.mark.parametrize("damped", [1, 150], ids=["as it is", "some poles real"])
def test_balance_load_is_the_exact_integral(rng, damped):
    """Against the matrix exponential of scipy in the coordinates of motion, for loads linear between samples."""
    balance = random_balance(rng)
    n, interval = 400, 1 / 10_000
    net = np.cumsum(rng.normal(0, 0.05, (n, 6)), axis=0) * balance.half_range + 0.3 * balance.half_range
    M, C, K = balance.mass.matrix, damped * balance.damping, balance.stiffness
    dynamics = replace(balance.dynamics, damping=damped * balance.dynamics.damping)
    assert (dynamics.poles.imag == 0).any() == (damped > 1)
    state = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    drive = np.vstack([np.zeros((6, 6)), np.linalg.inv(M)])
    start = np.concatenate([np.linalg.solve(K, net[0]), np.zeros(6)])
    output = np.hstack([K, np.zeros((6, 6))])
    _, expected, _ = lsim((state, drive, output, np.zeros((6, 6))), net, np.arange(n) * interval, start)
    found = dynamics.balance_load(net, interval=interval)
    np.testing.assert_array_equal(dynamics.balance_load(net, interval=interval, every=3), found[::3])
    # 400 steps of an exponential whose state is scaled by 1e7: about 1e-16 x 1e4 x 400
    assert np.abs((found - expected) / balance.half_range).max() < 1e-8


def test_modal_form_gives_the_response(rng):
    dynamics = random_balance(rng).dynamics
    poles, shapes, weights = dynamics.modal_form
    frequency = np.array([10.0, 150.0, 400.0])
    expected = dynamics.response(frequency)
    for f, response in zip(frequency, expected, strict=True):
        found = shapes @ np.diag(1 / (2j * np.pi * f - poles)) @ weights
        assert np.abs(found - response).max() < 1e-8 * np.abs(response).max()


def test_undamped_frequencies_are_those_of_mass_and_spring(rng):
    balance = random_balance(rng)
    # damping in proportion to stiffness leaves |pole| at the undamped frequency exactly
    dynamics = CoupledDynamics.of_rigid_mass(
        balance.mass, stiffness=balance.stiffness, damping=1e-5 * balance.stiffness
    )
    expected = np.sqrt(eigh(balance.stiffness, balance.mass.matrix, eigvals_only=True)) / (2 * np.pi)
    found = [mode.natural_frequency for mode in dynamics.modes]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    ratios = [mode.damping_ratio for mode in dynamics.modes]
    np.testing.assert_allclose(ratios, 0.5e-5 * 2 * np.pi * expected, rtol=1e-6)
    assert all(a.natural_frequency <= b.natural_frequency for a, b in pairwise(dynamics.modes))


def test_single_components_stay_what_they_are(rng):
    coupled = CoupledDynamics.of_components(SINGLE[::-1])
    assert coupled.components == ("NF", "PM", "AF")
    frequency = rng.uniform(0, 500, 10)
    response = coupled.response(frequency)
    net = rng.normal(0, 100, (500, 3))
    felt = coupled.balance_load(net, interval=1e-4)
    for column, part in enumerate(SINGLE):
        np.testing.assert_allclose(response[:, column, column], part.response(frequency), rtol=1e-10)
        expected = part.balance_load(net[:, column], interval=1e-4)
        np.testing.assert_allclose(felt[:, column], expected, atol=1e-8)
    np.testing.assert_array_equal(response[:, 0, 1:], 0)
    for mode, part in zip(coupled.modes, sorted(SINGLE, key=lambda d: d.natural_frequency), strict=True):
        assert mode.natural_frequency == pytest.approx(part.natural_frequency, rel=1e-12)
        assert mode.damping_ratio == pytest.approx(part.damping_ratio, rel=1e-9)


def test_uncertainty_of_single_components_is_carried_over():
    factor = np.diag([0.01, 1e4, 2.0, 1e-7]) @ np.array([[1, 0, 0, 0], [0.5, 1, 0, 0], [0, 0.3, 1, 0], [0, 0, 0, 1]])
    part = Dynamics("AF", 18.0, 3e7, 900.0, covariance=factor @ factor.T)

    def ratios(values):
        return np.array([values[0] / values[1], values[2] / values[1]])

    steps = np.array([1e-4, 1e2, 1e-2])
    slopes = np.zeros((2, 4))
    for column, step in enumerate(steps):
        change = np.zeros(4)
        change[column] = step
        slopes[:, column] = (ratios(part.values + change) - ratios(part.values - change)) / (2 * step)
    found = CoupledDynamics.of_components([part]).covariance
    # central differences with relative steps of about 1e-5: 1e-10, and rounding 1e-11
    np.testing.assert_allclose(found, slopes @ part.covariance @ slopes.T, rtol=1e-7)
    coupled = CoupledDynamics.of_components([part])
    u = [part.uncertainty("natural_frequency"), part.uncertainty("damping_ratio")]
    # both from the same derivatives in closed form; the poles are from an eigenvalue solver, to some 1e-12
    np.testing.assert_allclose(np.sqrt(np.diag(coupled.mode_covariance)), u, rtol=1e-9)


def numbers_of_modes(dynamics):
    """Frequencies, then damping ratios."""
    return np.array(
        [mode.natural_frequency for mode in dynamics.modes] + [mode.damping_ratio for mode in dynamics.modes]
    )


def test_modes_of_drawn_matrices_have_the_covariance_of_the_modes(rng):
    known = random_balance(rng).dynamics
    # 1e-7 of every element: what is of second order is below 1e-6 of the deviations unless modes are 1e-3 apart
    values = np.concatenate([known.inertia.ravel(), known.damping.ravel()])
    factor = 1e-7 * values[:, None] * rng.normal(0, 1, (72, 72))
    given = replace(known, covariance=factor @ factor.T)
    draws = 300
    moved = values + rng.normal(0, 1, (draws, 72)) @ factor.T
    found = np.array([numbers_of_modes(CoupledDynamics(COMPONENTS, *row.reshape(2, 6, 6))) for row in moved])
    u = np.sqrt(np.diag(given.mode_covariance))
    z = (found - numbers_of_modes(known)) / u
    total = np.sum(z * np.linalg.solve(given.mode_covariance / np.outer(u, u), z.T).T)
    # chi-squares of the draws: all together, and of each number by itself; 1e-7 beyond on either side
    for value, degrees in ((total, 12 * draws), *((part, draws) for part in np.sum(z**2, axis=0))):
        assert chi2.ppf(1e-7, degrees) < value < chi2.isf(1e-7, degrees), (value, degrees)


def test_modes_of_matrices_that_are_known_exactly_have_no_uncertainty():
    twins = CoupledDynamics(("NF", "AF"), 1e-6 * np.eye(2), 1e-5 * np.eye(2))  # two modes of one frequency
    assert not twins.mode_covariance.any()
    assert twins.mode_covariance.shape == (4, 4)
    known = replace(twins, covariance=np.diag([1e-20] + [0.0] * 7))
    # each mode is of one component: f = 1 / (2 pi sqrt(A)), so that a u(A) of 1e-4 of A makes 0.5e-4 of f
    u = np.sqrt(np.diag(known.mode_covariance))[:2] / twins.modes[0].natural_frequency
    np.testing.assert_allclose(np.sort(u), [0.0, 0.5e-4], atol=1e-15)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"components": ("PM", "NF")}, "in this order"),
        ({"components": ()}, "in this order"),
        ({"inertia": np.eye(3)}, r"damping must have shape \(3, 3\)"),
        ({"damping": np.full((2, 2), np.nan)}, "damping must have shape"),
        ({"damping": -1e-4 * np.eye(2)}, "grows or never ends"),
        ({"inertia": np.diag([-1e-6, 1e-6])}, "grows or never ends"),
        ({"inertia": np.full((2, 2), 1e-6)}, "inertia has no inverse"),
        ({"covariance": np.eye(3)}, r"covariance must have shape \(8, 8\)"),
        ({"covariance": -np.eye(8)}, "variances of zero or more"),
    ],
)
def test_what_is_not_physical_is_refused(settings, said):
    usual = {"components": ("NF", "PM"), "inertia": 1e-6 * np.eye(2), "damping": 1e-5 * np.eye(2)}
    with pytest.raises(ValueError, match=said):
        CoupledDynamics(**(usual | settings))
