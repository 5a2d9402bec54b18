"""Loads between points and axes: the work done is the same, there and back, and numbers worked by hand."""

import numpy as np
import pytest

from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.components import COMPONENTS, MOMENTS, VECTORS
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.frames import PLACEMENT, WIND_NAMES, Frame, ResolvedLoads, coefficients, wind_loads

NF, PM, SF, YM, RM, AF = range(6)


def loads(**values):
    return ResolvedLoads.of([[values.get(name, 0.0) for name in COMPONENTS]])


def test_force_at_a_lever_makes_the_moments_of_the_convention():
    # A force at aft 2, right 3, up 5 m from the balance's centre, read there: nose up is up x aft - aft x up,
    # nose right is right x aft - aft x right, right side down is up x right - right x up.
    place = np.array([2.0, 3.0, 5.0])
    read = Frame(-place).loads(loads(NF=7.0, SF=11.0, AF=13.0)).values[0]
    assert read[PM] == pytest.approx(5 * 13 - 2 * 7)
    assert read[YM] == pytest.approx(3 * 13 - 2 * 11)
    assert read[RM] == pytest.approx(5 * 11 - 3 * 7)
    np.testing.assert_allclose(read[[NF, SF, AF]], [7, 11, 13])


def test_moment_centre_on_the_line_of_action_has_no_moment():
    # 100 N up at 0.4 m before the balance: PM = +40 N*m about the balance, none about the place itself
    read = Frame(np.array([-0.4, 0, 0])).loads(loads(NF=100.0, PM=40.0)).values[0]
    np.testing.assert_allclose(read, [100, 0, 0, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("angle", "given", "expected"),
    [
        ("pitch", {"NF": 1.0}, {"AF": -1.0}),  # nose up by 90 degrees: its aft looks down
        ("yaw", {"AF": 1.0}, {"SF": 1.0}),  # nose right: its right looks aft
        ("roll", {"NF": 1.0}, {"SF": -1.0}),  # right side down: its right looks down
        ("roll", {"PM": 1.0}, {"YM": -1.0}),  # then nose up before is nose left for it
    ],
)
def test_quarter_turns(angle, given, expected):
    read = Frame(**{angle: np.pi / 2}).loads(loads(**given)).values
    np.testing.assert_allclose(read, loads(**expected).values, atol=1e-12)


def test_work_is_the_same_in_both_frames(rng):
    frame = Frame(rng.normal(size=3), *rng.uniform(-1.5, 1.5, 3))
    given, motion = rng.normal(size=(2, 50, 6))
    there = frame.loads(ResolvedLoads.of(given)).values
    # the oracle is the motion of a rigid body, v + w x p, in turned axes
    turn = np.array([VECTORS[name] for name in COMPONENTS], dtype=float)
    moments = [COMPONENTS.index(name) for name in MOMENTS]
    forces = [index for index in range(6) if index not in moments]
    velocity, spin = motion[:, forces] @ turn[forces], motion[:, moments] @ turn[moments]
    velocity, spin = (velocity + np.cross(spin, frame.point)) @ frame.rotation.T, spin @ frame.rotation.T
    moved = np.zeros_like(motion)
    moved[:, forces], moved[:, moments] = velocity @ turn[forces].T, spin @ turn[moments].T
    np.testing.assert_allclose(np.sum(there * moved, axis=1), np.sum(given * motion, axis=1), atol=1e-11)
    np.testing.assert_allclose(motion @ frame.motion_matrix.T, moved, atol=1e-11)


def test_mass_matrix_moves_with_the_frame(rng):
    # the mass matrix about another point and axes, T M T^T, is that of the same body seen from there
    frame = Frame(rng.normal(size=3), *rng.uniform(-1, 1, 3))
    half = rng.normal(size=(3, 3))
    body = RigidMass(3.0, rng.normal(size=3), half @ half.T)
    turned = frame.rotation @ body.inertia @ frame.rotation.T
    seen = RigidMass(3.0, frame.rotation @ (body.centre - frame.point), (turned + turned.T) / 2)
    np.testing.assert_allclose(frame.matrix @ body.matrix @ frame.matrix.T, seen.matrix, atol=1e-9)


def test_there_and_back_is_nothing(rng):
    frame = Frame(rng.normal(size=3), *rng.uniform(-1, 1, 3))
    back = Frame.of_rotation(frame.rotation.T, point=-frame.rotation @ frame.point)
    np.testing.assert_allclose(back.matrix @ frame.matrix, np.eye(6), atol=1e-12)


def test_angles_of_a_rotation_are_found_again(rng):
    angles = rng.uniform(-1.5, 1.5, 3)
    again = Frame.of_rotation(Frame(np.zeros(3), *angles).rotation)
    np.testing.assert_allclose([again.pitch, again.roll, again.yaw], angles, atol=1e-12)


def test_lift_and_drag_by_hand():
    # alpha = 30 degrees: L = NF cos - AF sin, D = AF cos + NF sin
    read = wind_loads(loads(NF=100.0, AF=10.0, SF=3.0), angle_of_attack=np.pi / 6).values[0]
    assert read[NF] == pytest.approx(100 * np.sqrt(0.75) - 5)
    assert read[AF] == pytest.approx(10 * np.sqrt(0.75) + 50)
    assert read[SF] == pytest.approx(3)
    assert (WIND_NAMES["NF"], WIND_NAMES["AF"]) == ("L", "D")


def test_drag_is_along_the_wind(rng):
    alpha, beta = rng.uniform(-1, 1, (2, 20))
    # the wind blows aft, from the right with positive sideslip, and up with the nose up
    wind = np.stack([np.cos(alpha) * np.cos(beta), -np.sin(beta), np.sin(alpha) * np.cos(beta)], axis=1)
    given = rng.normal(size=(20, 6))
    force = np.stack([given[:, AF], given[:, SF], given[:, NF]], axis=1)
    read = wind_loads(ResolvedLoads.of(given), angle_of_attack=alpha, sideslip=beta).values
    np.testing.assert_allclose(read[:, AF], np.sum(force * wind, axis=1), atol=1e-12)
    # lift has no part across the plane of symmetry
    lift = np.stack([-np.sin(alpha), np.zeros(20), np.cos(alpha)], axis=1)
    np.testing.assert_allclose(read[:, NF], np.sum(force * lift, axis=1), atol=1e-12)
    np.testing.assert_allclose(read[:, SF], np.sum(force * np.cross(lift, wind), axis=1), atol=1e-12)
    moments = np.stack([-given[:, RM], given[:, PM], -given[:, YM]], axis=1)
    np.testing.assert_allclose(-read[:, RM], np.sum(moments * wind, axis=1), atol=1e-12)
    np.testing.assert_allclose(-read[:, YM], np.sum(moments * lift, axis=1), atol=1e-12)


def test_wind_axes_are_a_frame_turned_back(rng):
    alpha, beta = rng.uniform(-1, 1, 2)
    given = ResolvedLoads.of(rng.normal(size=(3, 6)))
    body = Frame(pitch=alpha, yaw=-beta)  # the body in wind axes: nose left by the sideslip, then nose up
    back = wind_loads(body.loads(given), angle_of_attack=alpha, sideslip=beta)
    np.testing.assert_allclose(back.values, given.values, atol=1e-12)


def test_coefficients_by_hand():
    found = coefficients(
        loads(NF=1000.0, PM=300.0, YM=600.0, RM=-600.0, AF=100.0), pressure=500.0, area=2.0, chord=0.5, span=3.0
    )
    np.testing.assert_allclose(found.values[0], [1.0, 0.6, 0.0, 0.2, -0.2, 0.1])


def by_differences(function, values, covariance):
    """Covariance of a function's result, shape (m,), by central differences of its k arguments."""
    slopes = []
    for place, deviation in enumerate(np.sqrt(np.diag(covariance))):
        step = np.zeros(len(values))
        step[place] = 1e-5 * max(deviation, 1e-3)
        slopes.append((function(values + step) - function(values - step)) / (2 * step[place]))
    slopes = np.stack(slopes, axis=1)
    return slopes @ covariance @ slopes.T


def covariance_of(rng, sizes):
    half = rng.normal(size=(len(sizes),) * 2)
    whole = half @ half.T
    root = np.sqrt(np.diag(whole))
    return whole / np.outer(root, root) * np.outer(sizes, sizes)


def test_covariance_through_the_whole_chain_is_that_of_differences(rng):
    unknowns = np.concatenate([rng.normal(size=6) * 100, rng.normal(size=3), rng.uniform(-0.5, 0.5, 5), [400.0]])
    parts = covariance_of(rng, [1.0] * 6), covariance_of(rng, [1e-2] * 3 + [1e-3] * 3), covariance_of(rng, [1e-3] * 2)
    whole = np.zeros((15, 15))
    whole[:6, :6], whole[6:12, 6:12], whole[12:14, 12:14], whole[14, 14] = *parts, 4.0

    def chain(v, given):
        body = Frame(v[6:9], *v[9:12], covariance=parts[1]).loads(given)
        wind = wind_loads(body, angle_of_attack=v[12], sideslip=v[13], angle_covariance=parts[2])
        return coefficients(wind, pressure=v[14], area=0.3, chord=0.2, span=1.1, pressure_uncertainty=2.0)

    found = chain(unknowns, ResolvedLoads(unknowns[None, :6], parts[0][None]))
    direct = by_differences(lambda v: chain(v, ResolvedLoads.of(v[None, :6])).values[0], unknowns, whole)
    # central differences of step 1e-5 deviations: rounding of 1e-16 * 100 / 1e-8, relative 1e-6
    size = np.sqrt(np.diag(direct))
    np.testing.assert_allclose(found.covariance[0] / np.outer(size, size), direct / np.outer(size, size), atol=1e-5)
    np.testing.assert_allclose(found.uncertainty[0], size, rtol=1e-5)


def test_an_error_of_loads_and_angles_alike_goes_through_as_differences_have_it(rng):
    unknowns = np.concatenate([rng.normal(size=(2, 6)) * 100, rng.uniform(-0.5, 0.5, (2, 2))], axis=1)
    whole = covariance_of(rng, [1.0] * 6 + [1e-2] * 2)
    found = wind_loads(
        ResolvedLoads(unknowns[:, :6], np.stack([whole[:6, :6]] * 2)),
        angle_of_attack=unknowns[:, 6],
        sideslip=unknowns[:, 7],
        angle_covariance=whole[6:, 6:],
        cross_covariance=whole[:6, 6:],
    )

    def turned(v):
        return wind_loads(ResolvedLoads.of(v[None, :6]), angle_of_attack=v[6], sideslip=v[7]).values[0]

    for one, v in zip(found.covariance, unknowns, strict=True):
        direct = by_differences(turned, v, whole)
        size = np.sqrt(np.diag(direct))
        np.testing.assert_allclose(one / np.outer(size, size), direct / np.outer(size, size), atol=1e-5)


def test_correlation_matters():
    # lift and drag of two readings that share one error: 1 N in both, at 45 degrees, is sqrt(2) N and nothing
    alike = np.eye(6)
    alike[NF, AF] = alike[AF, NF] = 1.0
    sizes = [1.0, 0, 0, 0, 0, 1.0]
    given = ResolvedLoads.of(np.zeros((1, 6)), uncertainty=sizes, correlation=alike)
    found = wind_loads(given, angle_of_attack=np.pi / 4).uncertainty[0]
    np.testing.assert_allclose(found[[AF, NF]], [np.sqrt(2), 0], atol=1e-7)


def test_samples_have_their_own_angles_and_pressures(rng):
    alpha, q = rng.uniform(-0.3, 0.3, 5), rng.uniform(100, 200, 5)
    given = rng.normal(size=(5, 6))
    found = coefficients(
        wind_loads(ResolvedLoads.of(given, uncertainty=0.1), angle_of_attack=alpha),
        pressure=q,
        area=1.0,
        chord=1.0,
        span=1.0,
        pressure_uncertainty=1.0,
    )
    for row in range(5):
        one = coefficients(
            wind_loads(ResolvedLoads.of(given[[row]], uncertainty=0.1), angle_of_attack=alpha[row]),
            pressure=q[row],
            area=1.0,
            chord=1.0,
            span=1.0,
            pressure_uncertainty=1.0,
        )
        np.testing.assert_allclose(found.values[row], one.values[0], rtol=1e-13)
        np.testing.assert_allclose(found.covariance[row], one.covariance[0], rtol=1e-10, atol=1e-18)


def test_no_wind_has_no_coefficients():
    given = ResolvedLoads.of(np.ones((3, 6)))
    with pytest.warns(DataQualityWarning, match="1 of 3 samples"):
        found = coefficients(given, pressure=[0.0, 1.0, 2.0], area=1.0, chord=1.0, span=1.0)
    assert np.isnan(found.values[0]).all() and np.isfinite(found.values[1:]).all()
    with pytest.raises(ValueError, match="nowhere is"):
        coefficients(given, pressure=0.0, area=1.0, chord=1.0, span=1.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ResolvedLoads.of(np.zeros((3, 5))), "shape"),
        (lambda: ResolvedLoads.of(np.zeros((3, 6)), uncertainty=-1.0), "zero or more"),
        (lambda: ResolvedLoads.of(np.zeros((3, 6)), correlation=np.ones((6, 6)) - 3 * np.eye(6)), "ones"),
        (lambda: ResolvedLoads.of(np.zeros((3, 6)), correlation=2 * np.eye(6) - np.ones((6, 6))), "negative variance"),
        (lambda: Frame(np.zeros(2)), "three numbers"),
        (lambda: Frame(covariance=-np.eye(6)), "zero or more"),
        (lambda: Frame.of_rotation(np.diag([1.0, 1.0, -1.0])), "left-handed"),
        (lambda: Frame.of_rotation(2 * np.eye(3)), "right angles"),
        (lambda: coefficients(loads(), pressure=1.0, area=0.0, chord=1.0, span=1.0), "area"),
        (lambda: wind_loads(loads(), angle_of_attack=0.0, angle_covariance=np.eye(3)), "angle_covariance"),
        (
            lambda: wind_loads(
                loads(), angle_of_attack=0.0, angle_covariance=np.eye(2), cross_covariance=np.zeros((2, 6))
            ),
            "cross_covariance",
        ),
    ],
)
def test_wrong_calls_are_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_order_of_a_frames_covariance():
    assert PLACEMENT == ("aft", "right", "up", "pitch", "roll", "yaw")
    sure = Frame(covariance=np.diag([0.0, 0, 0, 1e-4, 0, 0])).loads(loads(NF=100.0)).uncertainty[0]
    # an angle of 0.01 rad turns 100 N up by 1 N along
    np.testing.assert_allclose(sure, [0, 0, 0, 0, 0, 1.0], atol=1e-9)
