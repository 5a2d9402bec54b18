"""Weighing: Eq. (1), against numpy's least squares, by Monte Carlo, and with the masses of the paper."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from aerobalance.balance.weighing import MovingMass, points_from_recordings, weigh
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording

G = STANDARD_GRAVITY
SWEEP = np.radians([-15, -10, -5, 0, 5, 10, 15])


def rotated_gravity(pitch, roll):
    """Weight per kilogram in balance axes (aft, right, up), by rotation matrices: an oracle for the closed forms.

    Body axes forward, right, down; gravity is down in earth axes; yaw, pitch, roll in that order.
    """
    result = []
    for theta, phi in np.broadcast(pitch, roll):
        turn_pitch = np.array([[np.cos(theta), 0, -np.sin(theta)], [0, 1, 0], [np.sin(theta), 0, np.cos(theta)]])
        turn_roll = np.array([[1, 0, 0], [0, np.cos(phi), np.sin(phi)], [0, -np.sin(phi), np.cos(phi)]])
        forward, right, down = turn_roll @ turn_pitch @ np.array([0, 0, G])
        result.append([-forward, right, -down])
    return np.array(result)


def grid():
    pitch, roll = np.meshgrid(np.radians([-20, -10, 0, 10, 20]), np.radians([-90, -45, 0, 45, 90, 180]))
    return pitch.ravel(), roll.ravel()


def test_pitch_sweep_gives_mass_and_offset():
    rng_error = np.array([1, -1, 0, 0, 0, -1, 1]) * 1e-3
    found = weigh(SWEEP, 0.68 * G * np.sin(SWEEP) + 3 + rng_error)
    design = np.column_stack([G * np.sin(SWEEP), np.ones(7)])
    (mass, offset), square, *_ = np.linalg.lstsq(design, 0.68 * G * np.sin(SWEEP) + 3 + rng_error, rcond=None)
    covariance = np.linalg.inv(design.T @ design) * square[0] / 5
    assert found.mass == pytest.approx(mass, rel=1e-12)
    assert found.offset == pytest.approx(offset, rel=1e-12)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9, atol=1e-20)
    assert found.degrees_of_freedom == 5
    assert found.misalignment == {}
    assert found.u == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-9)


@pytest.mark.parametrize(("component", "column"), [("AF", 0), ("SF", 1), ("NF", 2)])
def test_pitch_and_roll_give_misalignment_too(component, column):
    pitch, roll = grid()
    axes = ["aft", "right", "up"]
    lean = {axis: angle for axis, angle in zip(axes, [0.003, -0.005, 0.008], strict=True) if axis != axes[column]}
    gravity = rotated_gravity(pitch, roll)
    load = 5 * (gravity[:, column] + sum(a * gravity[:, axes.index(axis)] for axis, a in lean.items())) - 2
    found = weigh(pitch, load, roll=roll, component=component)
    # Linear in the parameters and without noise: exact but for rounding.
    assert found.mass == pytest.approx(5, rel=1e-12)
    assert found.offset == pytest.approx(-2, rel=1e-10)
    assert found.misalignment == pytest.approx(lean, rel=1e-9)
    assert found.parameters == ("mass", "offset", *lean)


def test_misalignment_that_the_angles_cannot_show_is_left_out():
    pitch, roll = np.tile(SWEEP, 2), np.repeat(np.radians([0, 180]), 7)
    gravity = rotated_gravity(pitch, roll)
    found = weigh(pitch, 5 * (gravity[:, 0] + 0.01 * gravity[:, 2]), roll=roll)
    assert found.misalignment == pytest.approx({"up": 0.01}, rel=1e-9)
    assert found.mass == pytest.approx(5, rel=1e-12)


@pytest.mark.parametrize(
    ("masses", "noise"),
    # Live end and load of the vibration rig, live end and model of the tunnel test, and the standard deviations
    # of the balances' static calibrations, as printed in [Gorbushin2020]_.
    [((0.12, 0.56), 0.32), ((8.33, 169.54), 2.0)],
)
def test_masses_of_the_paper_are_covered(masses, noise, rng):
    pitch = np.radians(np.linspace(-90, 90, 13))
    true = sum(masses)
    trials, score = 400, []
    for _ in range(trials):
        found = weigh(pitch, true * G * np.sin(pitch) + rng.normal(0, noise, 13))
        score.append((found.mass - true) / found.u)
    inside = np.mean(np.abs(score) < stats.t.ppf(0.975, 11))
    # 95 % of 400: 4.5 standard deviations of the binomial on either side.
    assert abs(inside - 0.95) < 4.5 * np.sqrt(0.95 * 0.05 / trials)


def test_uncertainties_are_right_by_monte_carlo(rng):
    pitch, roll = grid()
    gravity = rotated_gravity(pitch, roll)
    clean = 5 * (gravity[:, 0] + 0.004 * gravity[:, 1] - 0.006 * gravity[:, 2]) + 1
    scores = []
    for _ in range(500):
        found = weigh(pitch, clean + rng.normal(0, 0.1, pitch.size), roll=roll)
        truth = {"right": 0.004, "up": -0.006}
        scores.append(
            [
                (found.mass - 5) / found.u,
                (found.offset - 1) / found.u_offset,
                *((found.misalignment[axis] - truth[axis]) / found.u_misalignment[axis] for axis in truth),
            ]
        )
    for column in np.array(scores).T:
        # Scores follow Student's distribution with 26 degrees of freedom; a right one fails once in 1e5 draws.
        assert stats.kstest(column, stats.t(26).cdf).pvalue > 1e-5


def test_given_noise_counts_where_it_is_larger():
    load = G * np.sin(SWEEP) + np.array([1, -1, 1, 0, -1, 1, -1]) * 1e-3
    design = np.column_stack([G * np.sin(SWEEP), np.ones(7)])
    expected = np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    assert weigh(SWEEP, load, noise=0.32).u == pytest.approx(0.32 * expected, rel=1e-9)
    assert weigh(SWEEP, load, noise=1e-9).u == pytest.approx(weigh(SWEEP, load).u, rel=1e-9)
    assert weigh(SWEEP, load, noise=np.full(7, 0.32)).u == pytest.approx(0.32 * expected, rel=1e-9)


def test_two_points_need_the_noise():
    pitch = np.radians([-10, 10])
    with pytest.raises(FitError, match=r"2 points fix the 2 parameters exactly.*noise"):
        weigh(pitch, G * np.sin(pitch))
    with pytest.raises(FitError, match="exactly"):
        weigh(pitch, G * np.sin(pitch), noise=0.0)
    found = weigh(pitch, G * np.sin(pitch), noise=0.1)
    assert found.mass == pytest.approx(1, rel=1e-12)
    # Half the difference of two readings over g sin(10 deg).
    assert found.u == pytest.approx(0.1 / np.sqrt(2) / (G * np.sin(np.radians(10))), rel=1e-12)


@pytest.mark.parametrize(
    ("pitch", "load", "said"),
    [
        ([0.1], [1.0], "1 point.*2 parameters.*other pitch angles"),
        ([], [], "0 point.*other pitch angles"),
        ([0.1, 0.1, 0.1], [1, 2, 3], "same at all 3 points.*other pitch angles"),
        ([0.1, 0.2, np.nan], [1, 2, 3], "pitch of point 3 is missing"),
        ([0.1, 0.2, 0.3], [1, np.nan, 3], "load of point 2 is missing"),
        ([0, 0.1, 0.2, 0.3], [0, -1, -2, -3], "signs of AF"),
        ([0, 0.01, 0.02], [0, 1, 0.1], "standard uncertainty.*further apart"),
    ],
)
def test_points_that_cannot_carry_the_mass(pitch, load, said):
    with pytest.raises(FitError, match=said):
        weigh(pitch, load)


def test_roll_is_asked_for_where_the_component_needs_it():
    with pytest.raises(FitError, match="other roll angles"):
        weigh(np.zeros(4), np.ones(4), component="SF", roll=np.zeros(4))


def test_wrong_calls():
    with pytest.raises(ValueError, match="AF, SF, NF"):
        weigh(SWEEP, SWEEP, component="PM")
    with pytest.raises(ValueError, match="same shape"):
        weigh(SWEEP, SWEEP[1:])
    with pytest.raises(ValueError, match="roll must have shape"):
        weigh(SWEEP, SWEEP, roll=[0.0])
    with pytest.raises(ValueError, match="noise"):
        weigh(SWEEP, SWEEP, noise=-1)
    with pytest.raises(ValueError, match="gravity"):
        weigh(SWEEP, SWEEP, gravity=0)
    with pytest.raises(ValueError, match="mass must be positive"):
        MovingMass("AF", -1, 0, 0, 0, {}, {}, (), np.zeros((0, 0)), np.zeros(0), 0)


def recording(pitch, load, roll=None, name="sweep"):
    channels = {"AF": Channel("AF", load, "N"), "pitch": Channel("pitch", pitch, "rad")}
    if roll is not None:
        channels["roll"] = Channel("roll", roll, "rad")
    return Recording.from_columns(np.arange(pitch.size) / 1000, channels, name=name)


def swept(rng, angles, hold=2000, move=500, noise=1e-5):
    pieces = [np.full(hold, angles[0])]
    for before, after in pairwise(angles):
        pieces += [np.linspace(before, after, move), np.full(hold, after)]
    return np.concatenate(pieces) + rng.normal(0, noise, sum(map(len, pieces)))


@pytest.mark.parametrize("pitch_noise", [0.0, 1e-5, 2e-3])
def test_one_recording_is_split_at_its_plateaus(pitch_noise, rng):
    angles = np.radians([0, 5, 10, -5, -10])
    pitch = swept(rng, angles, noise=pitch_noise)
    load = 100 * np.sin(pitch) + rng.normal(0, 0.5, pitch.size)
    points = points_from_recordings([recording(pitch, load)], "AF")
    assert points.pitch.size == 5
    # Means of 1900 samples or more of the pitch noise, eight standard deviations.
    np.testing.assert_allclose(points.pitch, angles, atol=8 * pitch_noise / np.sqrt(1900) + 1e-12)
    assert points.roll is None
    assert weigh(points.pitch, points.load).mass == pytest.approx(100 / G, rel=0.01)


def test_one_point_a_recording_with_roll():
    rng = np.random.default_rng(1)
    records = [
        recording(np.full(500, p), np.full(500, p) + rng.normal(0, 1, 500), np.full(500, r), f"{p}")
        for p, r in [(0.0, 0.0), (0.1, 0.5), (0.2, 1.0)]
    ]
    points = points_from_recordings(records, "AF")
    np.testing.assert_allclose(points.pitch, [0, 0.1, 0.2], atol=1e-15)
    np.testing.assert_allclose(points.roll, [0, 0.5, 1], atol=1e-15)


def test_uncertainty_of_a_mean_holds_for_correlated_noise(rng):
    from scipy.signal import lfilter

    scores = []
    for _ in range(300):
        noise = lfilter([1], [1, -0.9], rng.normal(size=4500))[500:]  # mean of 4000, correlated over 10 samples
        points = points_from_recordings([recording(np.zeros(4000), noise)], "AF")
        scores.append(points.load[0] / points.noise[0])
    # Twenty batch means: Student with 19 degrees of freedom. Neighbouring batches of 200 samples share about 1/20
    # of their variance, which widens the scores by 5 %; white-noise uncertainty would make them 4 times too wide.
    spread = np.std(scores) / stats.t(19).std()
    assert 0.85 < spread < 1.25


def test_a_recording_that_keeps_moving_is_refused():
    pitch = np.linspace(-0.3, 0.3, 20000)
    with pytest.raises(FitError, match="sweep: pitch is nowhere steady"):
        points_from_recordings([recording(pitch, pitch)], "AF")


def test_channels_that_are_missing_are_named():
    still = Recording.from_columns(np.arange(100.0), {"AF": Channel("AF", np.ones(100), "N")}, name="one.csv")
    with pytest.raises(FitError, match=r"one\.csv has no channel pitch; it has AF"):
        points_from_recordings([still], "AF")
    both = [
        recording(np.zeros(100), np.zeros(100), np.zeros(100), "a"),
        recording(np.zeros(100), np.zeros(100), name="b"),
    ]
    with pytest.raises(FitError, match="b has no channel roll"):
        points_from_recordings(both, "AF")


def test_missing_samples_are_left_out_of_the_means():
    rng = np.random.default_rng(2)
    pitch, load = np.full(1000, 0.1), rng.normal(5, 1, 1000)
    pitch[100:120], load[300:310] = np.nan, np.nan
    points = points_from_recordings([recording(pitch, load)], "AF")
    assert points.pitch == pytest.approx([0.1], abs=1e-14)
    assert points.load == pytest.approx([np.nanmean(load)], rel=1e-12)
