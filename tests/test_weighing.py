"""Weighing with one force: Eq. (1) against numpy's least squares, by Monte Carlo, and with the masses of the paper."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from aerobalance import weigh
from aerobalance.balance.weighing import LoadPoints, MovingMass, fit_weight, points_from_recordings
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.estimation.checks.impossible_channels import impossible_channels
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, MOMENTS, STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import FitError
from aerobalance.recording.gravity import weight_direction
from aerobalance.recording.recording import Recording
from seeds import trials

G = STANDARD_GRAVITY
SWEEP = np.radians([-15, -10, -5, 0, 5, 10, 15])


def points(pitch, load, roll=None, component="AF", noise=None):
    """Points of one component; the noise is one number, or one of each point."""
    load = np.array(load, dtype=float)
    given = None if noise is None else np.broadcast_to(noise, load.shape)[:, None]
    return LoadPoints((component,), pitch, load[:, None], roll, given)


def alone(pitch, load, **more):
    """The mass of one component, weighed by itself."""
    (mass,) = fit_weight(points(pitch, load, **more)).masses.values()
    return mass


def grid():
    pitch, roll = np.meshgrid(np.radians([-20, -10, 0, 10, 20]), np.radians([-90, -45, 0, 45, 90, 180]))
    return pitch.ravel(), roll.ravel()


def test_pitch_sweep_gives_mass_and_offset():
    error = np.array([1, -1, 0, 0, 0, -1, 1]) * 1e-3
    load = 0.68 * G * np.sin(SWEEP) + 3 + error
    found = fit_weight(points(SWEEP, load))
    design = np.column_stack([G * np.sin(SWEEP), np.ones(7)])
    solution, square, *_ = np.linalg.lstsq(design, load, rcond=None)
    covariance = np.linalg.inv(design.T @ design) * square[0] / 5
    np.testing.assert_allclose([found.mass, found.offsets["AF"]], solution, rtol=1e-12)
    mass = found.masses["AF"]
    assert mass.degrees_of_freedom == found.degrees_of_freedom == 5
    assert mass.misalignment == {}
    assert mass.u == found.u_mass == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-9)
    # A turn of the balance, 1 deg as like as not, reads its share of the weight, which no pitch sweep tells from an
    # offset; the mean of cos(pitch) is 0.98 here. Of the turns, AF does not feel that about its own axis.
    tilt = np.radians(1) * 0.68 * G * np.mean(np.cos(SWEEP))
    assert mass.u_offset == pytest.approx(np.hypot(np.sqrt(covariance[1, 1]), tilt), rel=1e-9)
    assert set(found.unidentified) == {"misalignment.pitch", "misalignment.yaw"}
    np.testing.assert_allclose(found.loads(pitch=SWEEP)[:, 0], design @ solution, rtol=1e-12)


def test_a_turned_balance_is_covered_where_the_sweep_goes_one_way():
    sweep, scores = np.radians([0, 5, 10, 15, 20.0]), []
    for tilt in np.radians([-0.2, 0.2]):
        found = fit_weight(points(sweep, 100 * G * np.sin(sweep - tilt), noise=0.05))
        assert "misalignment.pitch" in found.left_out
        scores.append((found.mass - 100) / found.u_mass)
    # A fifth of the natural scale of a tilt is a fifth of a standard deviation; noise is a fortieth of it, and the
    # tilt's second order 0.2 deg over the 10 deg of the mean attitude.
    np.testing.assert_allclose(scores, [-0.2, 0.2], rtol=0.03)


@pytest.mark.parametrize(("component", "lean"), [("AF", "up"), ("SF", "up"), ("NF", "aft")])
def test_pitch_and_roll_give_misalignment_too(component, lean):
    pitch, roll = grid()
    pitch_angle, roll_angle = {"AF": (-0.008, 0.0), "SF": (0.0, -0.008), "NF": (0.008, 0.0)}[component]
    # turned nose up or right side down by hand: another pitch, or another roll
    directions = weight_direction(pitch, roll)
    angle, (first, second) = (pitch_angle, (0, 2)) if pitch_angle else (roll_angle, (1, 2))
    turned = directions.copy()
    turned[:, first] = np.cos(angle) * directions[:, first] - np.sin(angle) * directions[:, second]
    turned[:, second] = np.sin(angle) * directions[:, first] + np.cos(angle) * directions[:, second]
    load = 5 * G * turned[:, ["AF", "SF", "NF"].index(component)] - 2
    found = alone(pitch, load, roll=roll, component=component)
    # Without noise: exact but for rounding.
    assert found.mass == pytest.approx(5, rel=1e-11)
    assert found.offset == pytest.approx(-2, rel=1e-9)
    assert found.misalignment[lean] == pytest.approx(0.008, rel=1e-8)
    assert found.parameters == ("mass", "offset", *found.misalignment)
    assert len(found.misalignment) == 2


def test_misalignment_that_the_angles_cannot_show_is_left_out():
    pitch, roll = np.tile(SWEEP, 2), np.repeat(np.radians([0, 180]), 7)
    aft, _, up = weight_direction(pitch, roll).T
    found = alone(pitch, 5 * G * (np.cos(0.01) * aft + np.sin(0.01) * up), roll=roll)
    assert found.misalignment == pytest.approx({"up": 0.01}, rel=1e-9)
    assert found.mass == pytest.approx(5, rel=1e-12)


@pytest.mark.parametrize(
    ("masses", "noise"),
    # Live end and load of the vibration rig, live end and model of the tunnel test, and the standard deviations
    # of the balances' static calibrations, as printed in [Gorbushin2020]_.
    [((0.12, 0.56), 0.32), ((8.33, 169.54), 2.0)],
)
@pytest.mark.soak(first=1)
@pytest.mark.filterwarnings("ignore:point .* does not go with the others")  # of one series in a thousand by chance
def test_masses_of_the_paper_are_covered(rng, masses, noise):
    pitch = np.radians(np.linspace(-90, 90, 13))
    true = sum(masses)
    count, inside = trials(60, 200), 0
    for _ in range(count):
        found = alone(pitch, true * G * np.sin(pitch) + rng.normal(0, noise, 13))
        inside += abs(found.mass - true) < found.u * stats.t.ppf(0.975, found.degrees_of_freedom)
    # 95 % of them: 4.5 standard deviations of the binomial on either side.
    assert abs(inside / count - 0.95) < 4.5 * np.sqrt(0.95 * 0.05 / count)


def test_given_noise_counts_where_it_is_larger():
    load = G * np.sin(SWEEP) + np.array([1, -1, 1, 0, -1, 1, -1]) * 1e-3
    design = np.column_stack([G * np.sin(SWEEP), np.ones(7)])
    expected = np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    assert alone(SWEEP, load, noise=0.1).u == pytest.approx(0.1 * expected, rel=1e-9)
    assert alone(SWEEP, load, noise=1e-9).u == pytest.approx(alone(SWEEP, load).u, rel=1e-9)


def test_readings_of_different_noise_count_by_their_weight():
    noise = np.array([0.02, 0.02, 0.02, 0.5, 0.5, 0.5, 0.5])
    design = np.column_stack([G * np.sin(SWEEP), np.ones(7)]) / noise[:, None]
    expected = np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    found = fit_weight(points(SWEEP, G * np.sin(SWEEP), noise=noise))
    u = found.covariance[0, 0] - (found.absorbed[0] @ np.array(list(found.left_out.values()))) ** 2
    assert np.sqrt(u) == pytest.approx(expected, rel=1e-9)


def test_two_points_need_the_noise():
    pitch = np.radians([-10, 10])
    for noise in (None, 0.0):
        with pytest.raises(FitError, match=r"2 points are fitted exactly by AF.*give the uncertainty u_AF"):
            alone(pitch, G * np.sin(pitch), noise=noise)
    found = alone(pitch, G * np.sin(pitch), noise=0.1)
    assert found.mass == pytest.approx(1, rel=1e-12)
    # Half the difference of two readings over g sin(10 deg).
    assert found.u == pytest.approx(0.1 / np.sqrt(2) / (G * np.sin(np.radians(10))), rel=1e-12)


@pytest.mark.parametrize(
    ("pitch", "load", "said"),
    [
        ([], [], "0 point.*other pitch angles"),
        ([0.1, 0.1, 0.1], [1, 2, 3], "same at all 3 points.*other pitch angles"),
        ([0.1, 0.2, 0.3], [1, np.nan, 3], "AF of point 2 is missing"),
        ([0, 0.1, 0.2, 0.3], [0, -1, -2, -3], "signs of AF"),
        ([0, 0.01, 0.02], [0, 1, 0.1], "mass of AF comes out as .* with a standard uncertainty of .*; "),
    ],
)
def test_points_that_cannot_carry_the_mass(pitch, load, said):
    with pytest.raises(FitError, match=said):
        alone(pitch, load)


def test_roll_is_asked_for_where_the_component_needs_it():
    with pytest.raises(FitError, match="other roll angles"):
        alone(np.zeros(4), np.ones(4), component="SF", roll=np.zeros(4))


def test_wrong_calls():
    with pytest.raises(ValueError, match="AF, SF or NF"):
        alone(SWEEP, SWEEP, component="PM")
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
    given = points_from_recordings([recording(pitch, load)], ["AF"])
    assert given.pitch.size == 5
    # Means of 1900 samples or more of the pitch noise, eight standard deviations.
    np.testing.assert_allclose(given.pitch, angles, atol=8 * pitch_noise / np.sqrt(1900) + 1e-12)
    assert given.roll is None
    assert fit_weight(given).mass == pytest.approx(100 / G, rel=0.01)


def test_one_point_a_recording_with_roll():
    rng = np.random.default_rng(1)
    records = [
        recording(np.full(500, p), np.full(500, p) + rng.normal(0, 1, 500), np.full(500, r), f"{p}")
        for p, r in [(0.0, 0.0), (0.1, 0.5), (0.2, 1.0)]
    ]
    given = points_from_recordings(records, ["AF"])
    np.testing.assert_allclose(given.pitch, [0, 0.1, 0.2], atol=1e-15)
    np.testing.assert_allclose(given.roll, [0, 0.5, 1], atol=1e-15)


def test_roll_at_the_end_of_the_range_of_its_sensor_is_that_angle(rng):
    """A reading of -180 to 180 deg jumps by a turn with the noise there, and its mean is nowhere."""
    noise, count = 1e-4, 400
    true = np.pi + rng.normal(0, noise, count)
    roll = (true + np.pi) % (2 * np.pi) - np.pi
    roll[5] = np.nan
    assert np.ptp(roll[6:]) > 6
    given = points_from_recordings([recording(np.zeros(count), np.ones(count), roll)], ("AF",))
    # the mean of 400 readings within five standard deviations, whatever turn it is on
    assert abs(np.angle(np.exp(1j * (given.roll[0] - np.pi)))) < 5 * noise / np.sqrt(count)


def test_uncertainty_of_a_mean_holds_for_correlated_noise(rng):
    from scipy.signal import lfilter

    scores = []
    for _ in range(300):
        noise = lfilter([1], [1, -0.9], rng.normal(size=4500))[500:]  # mean of 4000, correlated over 10 samples
        given = points_from_recordings([recording(np.zeros(4000), noise)], ["AF"])
        scores.append(given.loads[0, 0] / given.noise[0, 0])
    # Twenty batch means: Student with 19 degrees of freedom. Neighbouring batches of 200 samples share about 1/20
    # of their variance, which widens the scores by 5 %; white-noise uncertainty would make them 4 times too wide.
    spread = np.std(scores) / stats.t(19).std()
    assert 0.85 < spread < 1.25


def test_uncertainty_of_a_short_mean_counts_readings_that_are_repeated_once(rng):
    scores = []
    for _ in range(400):
        given = points_from_recordings([recording(np.zeros(30), np.repeat(rng.normal(size=15), 2))], ["AF"])
        scores.append(given.loads[0, 0] / given.noise[0, 0])
    # 15 means of two readings each: Student with 14 degrees of freedom, kurtosis 3.6, so that the standard deviation
    # of 400 scatters by sqrt(2.6 / 1600), 4 %; 30 readings that count one each make them 1.41 times as wide
    assert np.std(scores) / stats.t(14).std() == pytest.approx(1, abs=0.2)


def test_a_recording_that_keeps_moving_is_refused():
    pitch = np.linspace(-0.3, 0.3, 20000)
    with pytest.raises(FitError, match="sweep: pitch is nowhere steady"):
        points_from_recordings([recording(pitch, pitch)], ["AF"])


def test_channels_that_are_missing_are_named():
    still = Recording.from_columns(np.arange(100.0), {"AF": Channel("AF", np.ones(100), "N")}, name="one.csv")
    with pytest.raises(FitError, match=r"one\.csv has no channel pitch; it has AF"):
        points_from_recordings([still], ["AF"])
    both = [
        recording(np.zeros(100), np.zeros(100), np.zeros(100), "a"),
        recording(np.zeros(100), np.zeros(100), name="b"),
    ]
    with pytest.raises(FitError, match="b has no channel roll"):
        points_from_recordings(both, ["AF"])


def test_missing_samples_are_left_out_of_the_means():
    rng = np.random.default_rng(2)
    pitch, load = np.full(1000, 0.1), rng.normal(5, 1, 1000)
    pitch[100:120], load[300:310] = np.nan, np.nan
    given = points_from_recordings([recording(pitch, load)], ["AF"])
    assert given.pitch == pytest.approx([0.1], abs=1e-14)
    assert given.loads[:, 0] == pytest.approx([np.nanmean(load)], rel=1e-12)


def test_short_records_at_rest_are_a_point_each(rng):
    """Twelve readings are too few to look for stretches at rest in: a record that stands still is one."""
    records = []
    for angle in SWEEP:
        load = 0.68 * G * np.sin(angle) + rng.normal(0, 1e-3, 12)
        columns = {"AF": Channel("AF", load, "N"), "pitch": Channel("pitch", np.full(12, angle), "rad")}
        records.append(Recording.from_columns(np.arange(12) / 10, columns, name=f"{angle:.2f}"))
    found = weigh(records)
    assert found.masses["AF"].degrees_of_freedom == SWEEP.size - 2
    assert abs(found.mass - 0.68) < 6 * found.u_mass
    # 6.4e-5 kg, or 2.2e-4 if the readings of a record count as one; of five degrees of freedom up to 2.7 times as much
    assert found.u_mass < 6e-4
    moving = records[0].channel("pitch").values + np.linspace(0, 0.1, 12)
    with pytest.raises(FitError, match="pitch is nowhere steady with AF recorded"):
        weigh(replace(records[0], channels={"AF": records[0].channel("AF"), "pitch": Channel("pitch", moving, "rad")}))
    with pytest.raises(FitError, match="has no balance loads; with gauge outputs give the balance matrix"):
        weigh(replace(records[0], channels={"pitch": records[0].channel("pitch")}))


def test_stretches_without_loads_and_short_stops_are_no_points(rng):
    """Four blocks, of 200 of the record, must stand still between the two beside a move."""
    angles = np.radians([0, 5, 10, -5, -10])
    pitch = np.concatenate([swept(rng, angles), np.full(300, 0.3), np.linspace(0.3, 0.5, 500), np.full(2000, 0.5)])
    load = 100 * np.sin(pitch) + rng.normal(0, 0.5, pitch.size)
    load[2500:4500] = np.nan  # all the while at 5 degrees
    given = points_from_recordings([recording(pitch, load)], ["AF"])
    # means of 1900 samples or more of the pitch noise, eight standard deviations
    np.testing.assert_allclose(given.pitch, [*np.delete(angles, 1), 0.5], atol=8 * 1e-5 / np.sqrt(1900))


def test_a_roll_that_was_never_read_is_no_attitude():
    never = recording(np.zeros(1000), np.zeros(1000), np.full(1000, np.nan))
    with pytest.raises(FitError, match="nowhere steady"):
        points_from_recordings([never], ["AF"])


@pytest.mark.parametrize("unit", [1.0, 1000.0], ids=["N*m", "N*mm"])
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_moments_in_another_unit_put_the_model_farther_away_than_any_is(unit):
    """40 kg, 0.06 m ahead of the balance and 0.02 m above it: moments a thousand times too large are 63 m away."""
    body = RigidMass(40.0, np.array([-0.06, 0.0, 0.02]), np.diag([1.0, 4.0, 4.5]))
    pitch, roll = grid()
    loads = body.weight(pitch, roll) * np.where([name in MOMENTS for name in COMPONENTS], unit, 1.0)
    noise = np.random.default_rng(0).normal(0, 0.01, loads.shape)
    found = fit_weight(LoadPoints(COMPONENTS, pitch, loads + noise, roll, None))
    told = {doubt.component for doubt in found.doubts if doubt.kind == "units"}
    assert told == (set(MOMENTS) if unit > 1 else set())
    assert (found.verdict == "fit for use") == (unit == 1)
    # and the force that is worked out with a mass like that, whose stiffness was read in the same unit
    scaled = np.where([name in MOMENTS for name in COMPONENTS], unit, 1.0)
    stiffness = np.diag([1e6, 1e5, 2e6, 2e5, 1e5, 5e6])
    own = CoupledDynamics.of_rigid_mass(body, stiffness=stiffness, damping=1e-4 * stiffness)
    mass = RigidMass(40.0, body.centre * unit, body.inertia * unit**2)
    dynamics = replace(
        own,
        inertia=scaled[:, None] * own.inertia / scaled,
        damping=scaled[:, None] * own.damping / scaled,
        mass=mass,
    )
    channels = {name: Channel(name, np.zeros(100), si_unit(name)) for name in COMPONENTS}
    run = Recording.from_columns(np.arange(100) / 1000, channels)
    kinds = {(doubt.kind, doubt.component) for doubt in impossible_channels(run, dynamics) if doubt.kind == "units"}
    assert kinds == ({("units", name) for name in MOMENTS} if unit > 1 else set())
