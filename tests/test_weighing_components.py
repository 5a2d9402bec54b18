"""Weighing with all six loads: signs by physics, recovery, Monte Carlo, and what the angles cannot tell."""

import warnings

import numpy as np
import pytest
from scipy import stats

from aerobalance.balance.weighing import (
    LoadPoints,
    Weighing,
    WeightModel,
    fit_weight,
    points_from_recordings,
)
from aerobalance.balance.weighing.advice import PROPOSALS
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import AXES, COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.frames import rotation
from aerobalance.recording.gravity import Attitudes, weight_direction
from aerobalance.recording.recording import Recording
from seeds import trials

G = STANDARD_GRAVITY
MASS, CENTRE = 5.0, {"aft": -0.04, "right": 0.003, "up": 0.02}
OFFSETS = dict(zip(COMPONENTS, [1.0, -0.2, 0.5, 0.1, -0.05, 2.0], strict=True))
ANGLES = {"pitch": np.radians(0.3), "roll": np.radians(-0.2), "yaw": np.radians(0.4)}
NOISE = dict(zip(COMPONENTS, [0.05, 0.005, 0.05, 0.004, 0.006, 0.02], strict=True))
SWEEP = np.radians(np.arange(-10.0, 11, 2))


def grid(rolls=12):
    pitch, roll = np.meshgrid(np.radians([-15, -5, 0, 10, 20]), np.arange(rolls) * 2 * np.pi / rolls)
    return pitch.ravel(), roll.ravel()


def turned(pitch, roll):
    """Matrices from the earth's axes to body axes forward, right, down: pitch, then roll."""
    result = []
    for theta, phi in np.broadcast(pitch, roll):
        turn_pitch = np.array([[np.cos(theta), 0, -np.sin(theta)], [0, 1, 0], [np.sin(theta), 0, np.cos(theta)]])
        turn_roll = np.array([[1, 0, 0], [0, np.cos(phi), np.sin(phi)], [0, -np.sin(phi), np.cos(phi)]])
        result.append(turn_roll @ turn_pitch)
    return np.array(result)


def read(pitch, roll, *, masses=None, centres=None, offsets=OFFSETS, angles=None, mass=MASS):
    """Six loads in body axes forward, right, down, where the moments of flight mechanics are plain r x W.

    An oracle apart from the code: other axes, other signs, rotation matrices instead of closed forms. The balance is
    turned against the inclinometer by angles: nose right, then up, then right side down.
    """
    angles = {"pitch": 0.0, "roll": 0.0, "yaw": 0.0, **(angles or {})}
    yaw = angles["yaw"]
    turn_yaw = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    extra = turned(angles["pitch"], angles["roll"])[0] @ turn_yaw
    down = turned(pitch, roll) @ np.array([0, 0, G]) @ extra.T
    forces = {"AF": -down[:, 0], "SF": down[:, 1], "NF": -down[:, 2]}
    loads = {}
    for name in COMPONENTS:
        if name in forces:
            loads[name] = (masses or {}).get(name, mass) * forces[name]
            continue
        centre = (centres or {}).get(name, CENTRE)
        lever = np.array([-centre["aft"], centre["right"], -centre["up"]])
        loads[name] = mass * np.cross(lever, down)[:, ["RM", "PM", "YM"].index(name)]
    return np.column_stack([loads[name] + offsets[name] for name in COMPONENTS])


def noisy(rng, loads):
    return loads + rng.normal(size=loads.shape) * np.array(list(NOISE.values()))


def points(pitch, roll, loads, components=COMPONENTS, noise=None):
    columns = [COMPONENTS.index(name) for name in components]
    return LoadPoints(tuple(components), pitch, loads[:, columns], roll, noise)


def weigh_quietly(given):
    """Weigh; a disagreement by chance, once in a thousand times, is no failure of a test that looks at many draws."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return fit_weight(given)


@pytest.mark.parametrize(
    ("where", "pitch", "roll", "component", "sign"),
    [
        ("aft", 0, 0, "PM", 1),  # a weight behind the centre lifts the nose
        ("up", 90, 0, "PM", 1),  # nose to the sky: a weight on the back of the model pulls it over backwards
        ("right", 0, 0, "RM", 1),  # a weight on the right side pushes it down
        ("up", 0, 90, "RM", 1),  # right side down: a weight above the centre pulls the top to the right
        ("aft", 0, 90, "YM", -1),  # right side down: a weight behind the centre pulls the tail right, the nose left
        ("right", 90, 0, "YM", 1),  # nose to the sky: a weight on the right pulls the right side aft, the nose right
    ],
)
def test_signs_of_the_moments_by_physics(where, pitch, roll, component, sign):
    model = WeightModel(COMPONENTS)
    values = np.zeros(len(model.names))
    values[model.names.index("mass")] = 2.0
    values[model.names.index(f"moment.{where}")] = 2.0 * 0.1
    loads = model.loads(weight_direction(np.radians([pitch]), np.radians([roll])), values)[0]
    found = dict(zip(COMPONENTS, loads, strict=True))
    assert found[component] == pytest.approx(sign * 2.0 * G * 0.1, rel=1e-12)
    for name in {"PM", "YM", "RM"} - {component}:
        # cos(90 deg) is 6e-17 in floating point.
        assert abs(found[name]) < 1e-14


def test_model_agrees_with_flight_mechanics():
    pitch, roll = grid()
    model = WeightModel(COMPONENTS)
    values = [MASS, *(MASS * CENTRE[name.split(".")[1]] for name in model.names[1:4])]
    values = np.array([*values, *(OFFSETS[name] for name in COMPONENTS), *ANGLES.values()])
    np.testing.assert_allclose(
        model.loads(weight_direction(pitch, roll), values), read(pitch, roll, angles=ANGLES), rtol=0, atol=1e-12
    )


def test_jacobian_is_the_slope_of_the_loads():
    pitch, roll = grid(4)
    model = WeightModel(COMPONENTS, own_masses=True, own_centres=True)
    rng = np.random.default_rng(4)
    values, directions, step = rng.normal(size=len(model.names)), weight_direction(pitch, roll), 1e-5
    jacobian = model.jacobian(directions, values)
    for index in range(values.size):
        change = np.eye(values.size)[index] * step
        slope = (model.loads(directions, values + change) - model.loads(directions, values - change)) / (2 * step)
        # Central difference: step^2/6 times the third derivative (up to 20 for values of order one), and rounding.
        np.testing.assert_allclose(jacobian[:, :, index], slope, atol=2e-8)


def test_misalignment_is_a_rotation():
    matrix, _ = rotation(0.1, -0.2, 0.3)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(matrix) == pytest.approx(1, rel=1e-14)
    lifted, _ = rotation(0.1, 0, 0)
    np.testing.assert_allclose(lifted @ weight_direction(0.2, 0.0), weight_direction(0.3, 0.0), atol=1e-15)


def test_exact_without_noise():
    pitch, roll = grid(4)
    found = fit_weight(points(pitch, roll, read(pitch, roll, angles=ANGLES)))
    # Rounding of loads of 50 N is 1e-14; angles and levers are conditioned to within a factor of a hundred.
    assert found.mass == pytest.approx(MASS, rel=1e-11)
    assert found.centre_of_gravity == pytest.approx(CENTRE, rel=1e-10)
    assert found.offsets == pytest.approx(OFFSETS, rel=1e-9)
    assert found.misalignment == pytest.approx(ANGLES, rel=1e-9)
    assert {name: mass.mass for name, mass in found.masses.items()} == pytest.approx(
        dict.fromkeys(["NF", "SF", "AF"], MASS), rel=1e-11
    )
    assert found.unidentified == {}
    assert found.left_out == {}
    assert np.abs(found.residuals).max() < 1e-10
    assert found.degrees_of_freedom == 20 * 6 - 13


def test_uncertainties_are_right_by_monte_carlo(rng):
    pitch, roll = grid()
    clean = read(pitch, roll, angles=ANGLES)
    other_pitch, other_roll = np.radians([-30.0, 5, 40]), np.radians([20.0, 160, 275])
    expected = read(other_pitch, other_roll, angles=ANGLES)
    draws, scores, disagreements, load_scores = trials(10, 100), [], 0, []
    for _ in range(draws):
        found = weigh_quietly(points(pitch, roll, noisy(rng, clean)))
        disagreements += not (found.mass_agreement.agree and found.centre_agreement.agree)
        score = {"mass": (found.mass - MASS) / found.u_mass}
        for group, truth in (("centre_of_gravity", CENTRE), ("offsets", OFFSETS), ("misalignment", ANGLES)):
            values, u = getattr(found, group), getattr(found, f"u_{group}")
            score |= {name: (values[name] - truth[name]) / u[name] for name in truth}
        for name, mass in found.masses.items():
            score[f"mass {name}"] = (mass.mass - MASS) / mass.u
            score[f"offset {name}"] = (mass.offset - OFFSETS[name]) / mass.u_offset
        lean = found.masses["AF"]
        score["lean"] = (lean.misalignment["up"] + ANGLES["pitch"]) / lean.u_misalignment["up"]
        scores.append(list(score.values()))
        where = {"pitch": other_pitch, "roll": other_roll}
        load_scores.append(((found.loads(**where) - expected) / found.uncertainty(**where)).ravel())
    square = np.mean(np.column_stack([scores, load_scores]) ** 2, axis=0)
    # Mean square of as many scores: chi-squared, widened by 57/55 for noise estimated with some 57 degrees of freedom;
    # 1e-7 on either side of each of 39 scores fails once in 1e5 runs.
    low, high = stats.chi2.ppf(1e-7, draws) / draws, stats.chi2.isf(1e-7, draws) / draws * 57 / 55
    assert (square > low).all(), square
    assert (square < high).all(), square
    # Two tests a draw at 0.001: six false alarms, of 200 even, happen once in 1e5 runs.
    assert disagreements < 6


def test_p_values_are_even_where_the_components_agree(rng):
    pitch, roll = grid(4)
    clean = read(pitch, roll)
    found = [weigh_quietly(points(pitch, roll, noisy(rng, clean))) for _ in range(trials(20, 60))]
    for name in ("mass_agreement", "centre_agreement"):
        tests = [getattr(one, name) for one in found]
        assert {test.degrees_of_freedom for test in tests} == {2 if name == "mass_agreement" else 3}
        p_values = [test.p_value for test in tests]
        assert stats.kstest(p_values, stats.uniform().cdf).pvalue > 1e-5, name


def test_scatter_of_each_component_is_found(rng):
    pitch, roll = grid()
    found = weigh_quietly(points(pitch, roll, noisy(rng, read(pitch, roll))))
    for name, truth in NOISE.items():
        # At least 55 degrees of freedom: a standard deviation is good to 1/sqrt(110), five of those.
        assert found.deviations[name] == pytest.approx(truth, rel=5 / np.sqrt(110)), name


def test_live_ends_that_differ_are_found_and_kept_apart(rng):
    pitch, roll = grid()
    masses = {"AF": 5.1, "SF": 5.0, "NF": 4.9}
    clean = read(pitch, roll, masses=masses)
    with pytest.warns(DataQualityWarning, match=r"forces find different masses: NF 4\.[89].*SF (5|4\.9).*AF 5\.[01]"):
        found = fit_weight(points(pitch, roll, noisy(rng, clean)))
    assert not found.mass_agreement.agree
    for name, mass in masses.items():
        assert abs(found.masses[name].mass - mass) < 6 * found.masses[name].u
    assert found.model.own_masses
    # The common mass stands between them, with their scatter of 0.1 kg and no less as its uncertainty.
    assert 4.9 < found.mass < 5.1
    assert 0.03 < found.u_mass < 0.3
    where = {"pitch": np.radians([40.0, -30]), "roll": np.radians([10.0, 130])}
    off = np.abs(found.loads(**where) - read(*where.values(), masses=masses))
    assert (off < 6 * found.uncertainty(**where)).all()


def test_centres_that_differ_are_found_and_kept_apart(rng):
    pitch, roll = grid()
    centres = {"RM": {**CENTRE, "up": 0.03}}
    clean = read(pitch, roll, centres=centres)
    with pytest.warns(DataQualityWarning, match="moments find different centres of gravity"):
        found = fit_weight(points(pitch, roll, noisy(rng, clean)))
    assert not found.centre_agreement.agree
    assert found.model.own_centres
    values = dict(zip(found.parameters, found.values, strict=True))
    u = dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)), strict=True))
    for moment, up in (("PM", 0.02), ("RM", 0.03)):
        name = f"moment.{moment}.up"
        assert abs(values[name] - MASS * up) < 6 * u[name], name
    assert found.u_centre_of_gravity["up"] > 1e-3


def test_a_wrong_sign_of_a_moment_is_doubted():
    pitch, roll = grid()
    rng = np.random.default_rng(7)
    loads = noisy(rng, read(pitch, roll))
    loads[:, COMPONENTS.index("YM")] *= -1
    with pytest.warns(DataQualityWarning, match=r"moments find different.*a sign that is off"):
        fit_weight(points(pitch, roll, loads))


def test_a_pitch_sweep_names_what_it_cannot_tell(rng):
    clean = read(SWEEP, 0 * SWEEP, angles=ANGLES)
    found = weigh_quietly(points(SWEEP, None, noisy(rng, clean)))
    cannot = {
        "misalignment.roll",
        "mass.SF",
        "centre_of_gravity.YM.aft",
        "centre_of_gravity.RM.up",
    }
    assert cannot <= set(found.unidentified)
    assert all(found.unidentified[name].startswith("add readings at roll") for name in cannot)
    assert "SF" not in found.masses
    assert set(found.misalignment) <= {"pitch", "yaw"}  # yaw shows in SF, if barely
    assert "misalignment.roll" in found.left_out
    assert abs(found.mass - MASS) < 6 * found.u_mass
    for axis, value in found.centre_of_gravity.items():
        assert abs(value - CENTRE[axis]) < 6 * found.u_centre_of_gravity[axis], axis
    # Within the sweep the loads are known to about the noise; at roll 90 deg the normal force lacks the roll
    # misalignment, and the offset of the side force has taken it over: a degree of 49 N is 0.86 N.
    inside = found.uncertainty(pitch=np.radians([5.0]))
    assert (inside < 3 * np.array(list(NOISE.values()))).all()
    outside = {"pitch": 0.0, "roll": np.pi / 2}
    u = found.uncertainty(**outside)[0]
    side, normal = COMPONENTS.index("SF"), COMPONENTS.index("NF")
    assert u[side] > np.radians(1) * MASS * G * 0.9
    assert u[normal] > np.radians(1) * MASS * G * 0.9
    assert (np.abs(found.loads(**outside)[0] - read(0.0, np.pi / 2, angles=ANGLES)[0]) < 6 * u).all()


def test_the_advice_is_right(rng):
    clean = read(SWEEP, 0 * SWEEP)
    found = weigh_quietly(points(SWEEP, None, noisy(rng, clean)))
    proposals = {f"add readings at {text}": (pitch, roll) for text, pitch, roll in PROPOSALS}
    for name, advice in found.unidentified.items():
        pitch, roll = (np.radians(angles) for angles in proposals[advice])
        pitch, roll = np.append(SWEEP, pitch), np.append(0 * SWEEP, roll)
        better = weigh_quietly(points(pitch, roll, noisy(rng, read(pitch, roll))))
        assert name not in better.unidentified, advice


def test_uncertainty_covers_what_was_left_out(rng):
    noise = np.tile(list(NOISE.values()), (SWEEP.size, 1))
    where = {"pitch": np.radians([-20.0, 0, 8]), "roll": np.radians([0.0, 90, 180])}
    draws, scores = trials(8, 100), []
    for _ in range(draws):
        angles = {name: rng.normal(0, np.radians(1)) for name in ANGLES}
        loads = noisy(rng, read(SWEEP, 0 * SWEEP, angles=angles))
        found = weigh_quietly(points(SWEEP, None, loads, noise=noise))
        off = found.loads(**where) - read(*where.values(), angles=angles)
        scores.append((off / found.uncertainty(**where)).ravel())
    square = np.mean(np.square(scores), axis=0)
    # Chi-squared with 1e-7 on either side. Noise is known, so scatter only adds to it (with 7 degrees of freedom a
    # quarter on average in square): down to 0.75. The misalignments are drawn with the natural
    # scale of 1 deg; one that is fitted instead of left out is one more good score.
    assert (square < stats.chi2.isf(1e-7, draws) / draws).all(), square
    assert (square > 0.75 * stats.chi2.ppf(1e-7, draws) / draws).all(), square


def test_what_one_component_cannot_tell_is_taken_from_the_others():
    rng = np.random.default_rng(21)
    sweep = np.radians(np.arange(-40.0, 41, 5))
    loads = noisy(rng, read(sweep, 0 * sweep, masses={"NF": 5.5}))
    with pytest.warns(DataQualityWarning, match="different masses"):
        found = fit_weight(points(sweep, None, loads))
    assert "mass.SF" in found.left_out
    assert found.assumed["mass.SF"] == pytest.approx(found.mass, rel=1e-12)
    side = found.loads(pitch=0.0, roll=np.pi / 2, offsets=False)[0, COMPONENTS.index("SF")]
    assert side == pytest.approx(found.mass * G, rel=1e-3)
    # Known to within its natural scale, the mass itself, and no better.
    u = found.uncertainty(pitch=0.0, roll=np.pi / 2)[0, COMPONENTS.index("SF")]
    assert u > 0.9 * found.mass * G


def test_components_that_differ_in_a_pitch_sweep(rng):
    centres = {"RM": {**CENTRE, "right": 0.05}}
    for _ in range(trials(3, 20)):
        angles = {name: rng.normal(0, np.radians(1)) for name in ANGLES}
        clean = read(SWEEP, 0 * SWEEP, angles=angles, masses={"NF": 8.0}, centres=centres)
        found = weigh_quietly(points(SWEEP, None, noisy(rng, clean)))
        assert found.model.own_masses or found.model.own_centres
        off = np.abs(found.loads(pitch=SWEEP) - clean)
        # Within the sweep: noise of a dozen readings, weighted by a scatter known from 7 degrees of freedom only.
        # Student's t of those is above 12 with p = 6e-6, and 20 weighings have some thousand values between them.
        assert (off < 12 * np.array(list(NOISE.values()))).all()


def test_roll_alone_without_pitch():
    rng = np.random.default_rng(12)
    roll = np.radians(np.arange(0, 360, 30.0))
    found = weigh_quietly(points(0 * roll, roll, noisy(rng, read(0 * roll, roll))))
    assert set(found.masses) == {"NF", "SF"}
    assert found.unidentified["mass.AF"] == "add readings at pitch -15 and 15 deg"
    assert found.mass == pytest.approx(MASS, abs=6 * found.u_mass)


@pytest.mark.parametrize("components", [("NF", "AF"), ("AF", "PM"), ("NF", "PM", "SF"), ("RM", "SF"), ("YM", "AF")])
def test_any_components_with_a_force(components, rng):
    pitch, roll = grid()
    found = weigh_quietly(points(pitch, roll, noisy(rng, read(pitch, roll, angles=ANGLES)), components))
    assert found.components == components
    assert abs(found.mass - MASS) < 6 * found.u_mass
    for group, truth in (("centre_of_gravity", CENTRE), ("offsets", OFFSETS), ("misalignment", ANGLES)):
        for name, value in getattr(found, group).items():
            assert abs(value - truth[name]) < 6 * getattr(found, f"u_{group}")[name], (group, name)
    shown = {"PM": {"aft", "up"}, "YM": {"aft", "right"}, "RM": {"right", "up"}}
    assert set(found.centre_of_gravity) == set().union(*(shown.get(name, set()) for name in components))


def test_taking_off_the_weight_leaves_the_noise(rng):
    pitch, roll = grid()
    found = weigh_quietly(points(pitch, roll, noisy(rng, read(pitch, roll, angles=ANGLES))))
    later_pitch, later_roll = rng.uniform(-0.5, 0.5, 4000), rng.uniform(-np.pi, np.pi, 4000)
    run = noisy(rng, read(later_pitch, later_roll, angles=ANGLES))
    left = run - found.loads(pitch=later_pitch, roll=later_roll)
    u = found.uncertainty(pitch=later_pitch, roll=later_roll)
    for column, (name, noise) in enumerate(NOISE.items()):
        # The scatter of 4000 readings is good to 1/90 of itself; what weighing adds is six times its uncertainty.
        bound = np.hypot(noise, 6 * u[:, column].max()) * (1 + 6 / 90)
        assert noise * (1 - 6 / 90) < left[:, column].std() < bound, name
        assert abs(left[:, column].mean()) < 6 * (u[:, column].max() + noise / np.sqrt(4000)), name
    weight = found.loads(pitch=later_pitch, roll=later_roll, offsets=False)
    np.testing.assert_allclose(
        found.loads(pitch=later_pitch, roll=later_roll) - weight,
        np.broadcast_to([found.offsets[name] for name in COMPONENTS], weight.shape),
        atol=1e-12,
    )
    assert found.loads(pitch=0.1).shape == (1, 6)


def test_weight_that_was_in_the_zero_counts_by_the_difference_of_attitudes(rng):
    pitch, roll = grid()
    clean = read(pitch, roll, angles=ANGLES)
    run = Attitudes(np.radians([2.0, 12.0, 30.0]), np.radians([0.0, 5.0, 160.0]))
    zeros = [Attitudes(np.radians([2.0, 2.5, np.nan]), np.zeros(3)), Attitudes(np.radians([-1.0]), np.radians([3.0]))]
    nan_free = Attitudes(np.radians([2.0, 2.5]), np.zeros(2))

    def counted(loads):
        before = [loads(*zero).mean(axis=0) for zero in (nan_free, zeros[1])]
        return loads(*run) - np.mean(before, axis=0)

    expected = counted(lambda pitch, roll: read(pitch, roll, angles=ANGLES))
    draws, scores = trials(8, 100), []
    for _ in range(draws):
        found = weigh_quietly(points(pitch, roll, noisy(rng, clean)))
        u = found.uncertainty(pitch=run.pitch, roll=run.roll, since=zeros)
        off = counted(lambda pitch, roll, found=found: found.loads(pitch=pitch, roll=roll)) - expected
        scores.append((off / u).ravel())
        alone = found.uncertainty(pitch=run.pitch, roll=run.roll, offsets=False)
        assert (u[0] < 0.5 * alone[0]).all()  # 0.2 deg and 1.5 deg from the zeros, where alone it counts whole
    square = np.mean(np.square(scores), axis=0)
    # as in the Monte Carlo above, for 18 scores
    assert (square > stats.chi2.ppf(1e-7, draws) / draws).all(), square
    assert (square < stats.chi2.isf(1e-7, draws) / draws * 57 / 55).all(), square
    same = found.uncertainty(pitch=0.1, roll=0.2, since=[Attitudes(np.array([0.1]), np.array([0.2]))])
    assert same == pytest.approx(np.zeros((1, 6)), abs=1e-9)


def test_loads_of_a_long_run_are_those_of_its_parts():
    pitch, roll = grid(4)
    rng = np.random.default_rng(13)
    found = weigh_quietly(points(pitch, roll, noisy(rng, read(pitch, roll))))
    later = {"pitch": rng.uniform(-1, 1, 25_000), "roll": rng.uniform(-3, 3, 25_000)}
    parts = [{name: angle[i : i + 1] for name, angle in later.items()} for i in (0, 9_999, 10_000, 24_999)]
    for method in (found.loads, found.uncertainty):
        whole = method(**later)
        assert whole.shape == (25_000, 6)
        np.testing.assert_allclose(
            whole[[0, 9_999, 10_000, 24_999]], np.concatenate([method(**part) for part in parts]), rtol=1e-9
        )


def test_given_noise_counts_where_it_is_larger():
    pitch, roll = grid(4)
    loads = read(pitch, roll)
    noise = np.tile(list(NOISE.values()), (pitch.size, 1))
    found = fit_weight(points(pitch, roll, loads, noise=noise))
    model = WeightModel(COMPONENTS)
    truth = np.array([MASS, *(MASS * CENTRE[name.split(".")[1]] for name in model.names[1:4]), *[0.0] * 9])
    rows = (model.jacobian(weight_direction(pitch, roll), truth) / noise[:, :, None]).reshape(-1, truth.size)
    expected = np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(expected)), rtol=1e-8)
    assert found.parameters == model.names


@pytest.mark.parametrize(
    ("pitch", "roll", "said"),
    [
        ([0.0, 0, 0, 0], [0.0, 0, 0, 0], "share of gravity along NF, SF, AF is the same at all 4 points.*pitch"),
        ([0.1], [0.0], r"1 point\(s\) cannot tell"),
        (SWEEP[:2], [0.0, 0], "leave nothing to tell its noise"),
        ([0.1, np.nan], [0.0, 0], "pitch of point 2 is missing"),
        ([0.1, 0.2], [0.0, np.nan], "roll of point 2 is missing"),
    ],
)
def test_points_that_cannot_carry_the_mass(pitch, roll, said):
    pitch, roll = np.array(pitch), np.array(roll)
    with pytest.raises(FitError, match=said):
        fit_weight(points(pitch, roll, np.nan_to_num(read(pitch, roll))))


def test_too_much_noise_for_the_mass():
    pitch = np.radians([-1.0, 0, 1, 0, -1, 1])
    # Noise of 1 N against M g sin(1 deg) = 0.86 N at four points: u(M) = 1 / (2 g sin(1 deg)) = 2.9 kg of 5 kg.
    given = points(pitch, None, read(pitch, 0 * pitch), ["AF", "PM"], noise=np.ones((6, 2)))
    with pytest.raises(FitError, match=r"cannot tell the mass of AF from the offset; add readings at"):
        fit_weight(given)


def test_wrong_signs_of_forces():
    pitch, roll = grid(4)
    loads = read(pitch, roll)
    for name in ("NF", "SF", "AF"):
        wrong = loads.copy()
        wrong[:, COMPONENTS.index(name)] *= -1
        with pytest.raises(FitError, match=f"from {name}, which no mass is; check the signs of {name}"):
            fit_weight(points(pitch, roll, wrong))
    loads[3, 2] = np.nan
    with pytest.raises(FitError, match="SF of point 4 is missing"):
        fit_weight(points(pitch, roll, loads))


def test_wrong_calls():
    with pytest.raises(ValueError, match="no force among PM, RM"):
        fit_weight(LoadPoints(("PM", "RM"), SWEEP, np.zeros((11, 2))))
    with pytest.raises(ValueError, match=r"loads must have shape \(11, 1\)"):
        LoadPoints(("AF",), SWEEP, np.zeros((11, 2)))
    with pytest.raises(ValueError, match="components must be some of"):
        LoadPoints(("AF", "AF"), SWEEP, np.zeros((11, 2)))
    with pytest.raises(ValueError, match="noise must be zero or more"):
        LoadPoints(("AF",), SWEEP, np.zeros((11, 1)), noise=np.full((11, 1), -1.0))
    with pytest.raises(ValueError, match="roll must have shape"):
        LoadPoints(("AF",), SWEEP, np.zeros((11, 1)), roll=np.zeros(3))
    with pytest.raises(ValueError, match="gravity must be positive"):
        fit_weight(LoadPoints(("AF",), SWEEP, np.zeros((11, 1))), gravity=0)
    found = fit_weight(points(*grid(4), read(*grid(4))))
    fields = {name: getattr(found, name) for name in Weighing.__dataclass_fields__}
    with pytest.raises(ValueError, match="mass must be positive"):
        Weighing(**{**fields, "mass": -1.0})
    with pytest.raises(ValueError, match="covariance must be finite and of shape"):
        Weighing(**{**fields, "covariance": np.eye(2)})
    with pytest.raises(ValueError, match="must together be"):
        Weighing(**{**fields, "parameters": found.parameters[1:]})


def test_recordings_give_all_components_at_once():
    rng = np.random.default_rng(8)
    attitudes = [(p, r) for p in np.radians([-10.0, 0, 10]) for r in np.radians([0.0, 90, 180, 270])]
    recordings = []
    for number, (pitch, roll) in enumerate(attitudes):
        loads = noisy(rng, np.repeat(read(pitch, roll), 400, axis=0))
        channels = {
            name: Channel(name, loads[:, i], "N*m" if "M" in name else "N") for i, name in enumerate(COMPONENTS)
        }
        channels["pitch"] = Channel("pitch", np.full(400, pitch), "rad")
        channels["roll"] = Channel("roll", np.full(400, roll), "rad")
        recordings.append(Recording.from_columns(np.arange(400) / 1000, channels, name=f"{number}"))
    given = points_from_recordings(recordings, COMPONENTS)
    assert given.components == COMPONENTS
    assert given.loads.shape == given.noise.shape == (12, 6)
    # Means of 400 readings, from twenty batches: good to 1/sqrt(38) of itself, averaged over 12 points; six of those.
    np.testing.assert_allclose(
        given.noise.mean(axis=0), np.array(list(NOISE.values())) / 20, rtol=6 / np.sqrt(38 * 12) + 0.02
    )
    found = weigh_quietly(given)
    assert found.mass == pytest.approx(MASS, abs=6 * found.u_mass)
    one = points_from_recordings(recordings, ["PM"])
    np.testing.assert_array_equal(one.loads[:, 0], given.loads[:, COMPONENTS.index("PM")])
    assert set(found.centre_of_gravity) == set(AXES)


@pytest.mark.soak(first=0)
def test_errors_of_components_are_correlated_as_those_of_weighings_over_again(rng):
    """Errors of the loads at other attitudes over many weighings, each with noise of its own."""
    pitch, roll = grid(4)
    true = read(pitch, roll)
    later = {"pitch": np.radians([-8.0, 3.0, 12.0]), "roll": np.radians([0.0, 20.0, -10.0])}
    count = trials(200, 1000)
    noise = np.tile(list(NOISE.values()), (pitch.size, 1))
    weighed = [weigh_quietly(points(pitch, roll, noisy(rng, true), noise=noise)) for _ in range(count)]
    loads = np.array([one.loads(**later, offsets=False) for one in weighed])
    errors = loads - loads.mean(axis=0)
    covariance = np.einsum("nai,naj->ij", errors, errors, optimize=True) / (count - 1)
    size = np.sqrt(np.einsum("nai,nai->ai", errors, errors, optimize=True) / (count - 1))
    found = weighed[0].correlation(**later, offsets=False)
    assert np.abs(found - np.eye(6)).max() > 0.3
    # of n draws the deviation of a correlation is (1 - r^2) / sqrt(n) at most; 36 of them, four and a half of it
    assert np.abs(found - covariance / (size.T @ size)).max() < 4.5 / np.sqrt(count)
