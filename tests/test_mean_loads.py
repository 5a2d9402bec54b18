"""The mean loads of a run, in all axes and as coefficients, with all of their errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.app.campaign.definition import Axes, Placed
from aerobalance.app.campaign.reduction import RunSettings, flow_of, frames_of
from aerobalance.balance.reduction import reduce_outputs
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.frames import Frame, ResolvedLoads, angles_of_attitude, coefficients, wind_loads
from aerobalance.recording.recording import Recording
from aerobalance.simulation.calibration_stand import random_balance
from aerobalance.uncertainty.mean_in_axes import Flow, ReferenceSizes, mean_in_axes
from aerobalance.uncertainty.mean_loads import Errors, MeanLoads, mean_loads
from faults.six import SIX, SixScene, identified, recording_of
from helpers.axial_runs import run_of, spring
from seeds import trials

# half a second of a white load: two records of a hundred are doubted, and one of 500 is taken for other dynamics
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*depart from what the model:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*AF rings :UserWarning"),
]

REFERENCE = ReferenceSizes(area=0.3, chord=0.2, span=1.1)


def six_means(rng) -> MeanLoads:
    parts = {}
    for name, size in (("common", 0.3), ("zero", 0.1), ("tare", 0.15), ("run", 0.2), ("scatter", 0.5)):
        half = size * rng.normal(size=(6, 6))
        parts[name] = half @ half.T
    return MeanLoads(COMPONENTS, 100 * rng.normal(size=6), Errors(**parts), 11.0)


def test_attitude_makes_angles_of_the_wind():
    # level and pitched: the angle of attack is the pitch; rolled onto its right side, the wind comes from the right
    for pitch, roll, expected in ((0.1, 0.0, (0.1, 0.0)), (0.1, np.pi / 2, (0.0, 0.1)), (0.1, np.pi, (-0.1, 0.0))):
        np.testing.assert_allclose(angles_of_attitude(pitch, roll), expected, atol=1e-12)


def test_errors_go_through_axes_and_coefficients_as_one_covariance_does(rng):
    mean = six_means(rng)
    turned = Frame(np.array([0.1, 0.0, -0.02]), pitch=0.05, covariance=np.diag([0.0] * 3 + [0.002**2] * 3))
    centre = Frame(np.array([0.2, 0.0, 0.1]))
    flow = Flow(0.12, 0.05, u_angle=1e-3, u_angle_run=2e-3, pressure=900.0, u_pressure=3.0, u_pressure_run=4.0)
    found = mean_in_axes(mean, frames=[turned, centre], flow=flow, reference=REFERENCE)
    whole = ResolvedLoads(mean.values[None], mean.errors.whole[None])
    body = centre.loads(turned.loads(whole))
    both = (1e-3**2 + 2e-3**2) * np.eye(2)
    wind = wind_loads(body, angle_of_attack=0.12, sideslip=0.05, angle_covariance=both)
    of_wind = coefficients(wind, pressure=900.0, pressure_uncertainty=5.0, area=0.3, chord=0.2, span=1.1)
    for key, expected in (("body", body), ("wind", wind), ("C_wind", of_wind)):
        np.testing.assert_allclose(found[key].values, expected.values[0], rtol=1e-12)
        scale = np.sqrt(np.diag(expected.covariance[0]))
        np.testing.assert_allclose(
            found[key].errors.whole / np.outer(scale, scale),
            expected.covariance[0] / np.outer(scale, scale),
            atol=1e-10,
        )
    # what is drawn anew in each run has no part of what all runs share
    assert (found["C_wind"].errors.of_run() < found["C_wind"].errors.uncertainty()).all()
    # Welch and Satterthwaite: u^4 over the sum of u_i^4 / nu_i, of which the scatter alone is not exact
    share = np.diag(found["wind"].errors.scatter) / np.diag(found["wind"].errors.whole)
    np.testing.assert_allclose(found["wind"].freedom, 11.0 / share**2)


def test_a_component_alone_gives_what_it_makes_alone():
    mean = MeanLoads(("AF",), np.array([30.0]), Errors(*(np.eye(1) for _ in range(5))), 11.0)
    level = mean_in_axes(mean, flow=Flow(pressure=100.0), reference=REFERENCE)
    assert level["wind"].values[5] == pytest.approx(30.0)  # level, drag is the axial force
    assert level["C_wind"].values[5] == pytest.approx(30.0 / (100.0 * 0.3))
    pitched = mean_in_axes(mean, flow=Flow(alpha=0.1, pressure=100.0), reference=REFERENCE)
    assert np.isnan(pitched["wind"].values[[0, 5]]).all()  # lift and drag have a part of the normal force too
    assert pitched["C_body"].values[5] == pytest.approx(1.0)
    assert np.isnan(pitched["C_body"].values[:5]).all()


def test_the_mean_of_a_run_is_as_uncertain_as_said(rng):
    # the steady load of runs under a random load, whose share in the mean of so short a record is chance
    dynamics, scores, us = spring(), [], []
    count = trials(5, 16)
    for _ in range(count):
        found = mean_loads(estimate_force(run_of(rng, mean=200.0), dynamics, hum="keep"))
        us.append(found.errors.uncertainty()[0])
        scores.append((found.values[0] - 200.0) / us[-1])
    # white noise of 20 N over 800 samples; its spectrum by 12 tapers is known to 29 %, the mean of n to 29 % / sqrt n
    assert np.mean(np.square(us)) == pytest.approx(20.0**2 / 800, rel=5 * 0.29 / np.sqrt(count))
    # t with 11 degrees of freedom has a variance of 11/9, and its square a standard deviation of 2.3
    assert np.mean(np.square(scores)) < 11 / 9 + 5 * 2.3 / np.sqrt(count)
    assert np.mean(np.square(scores)) > 0.2


def test_means_that_an_angle_is_wrong_for_are_wrong_together(rng):
    """By the weight m g (sin p, cos p) along AF and NF, a pitch off by u moves them by m g (cos p, -sin p) u."""
    dynamics = {
        name: Dynamics(name, mass, mass * 500.0**2, 2 * 0.02 * mass * 500.0, covariance=np.diag([part, 0, 0, 0]))
        for name, mass, part in (("AF", 3.0, 1e-6), ("NF", 5.0, 4e-6))
    }
    count, pitch, u = 800, 0.3, 1e-3
    loads = {name: Channel(name, 50.0 + rng.normal(0, 0.1, count), "N") for name in dynamics}
    angle = Channel("pitch", np.full(count, pitch), "rad", zero_uncertainty=u)
    run = Recording.from_columns(np.arange(count) / 1600.0, {**loads, "pitch": angle}, name="run")
    force = estimate_force(run, dynamics_of(dynamics), method="paper")
    found = mean_loads(force)
    slopes = STANDARD_GRAVITY * np.array([3.0 * np.cos(pitch), 5.0 * np.sin(pitch)])
    # the masses, uncertain by 1e-3 and 4e-4 of the weight, are wrong each for itself
    assert abs(found.errors.common[0, 1]) == pytest.approx(u**2 * slopes[0] * slopes[1], rel=1e-6)


@pytest.mark.parametrize("weighed_once", [True, False])
def test_one_weighed_mass_of_two_forces_is_one_error(rng, weighed_once):
    """A mass that is off by u takes the weight g u too much, straight down: from lift alone, and nothing from drag."""
    mass, u, pitch, count = 20.0, 0.05, 0.5, 400

    def made(name, mass, u):
        # by ringing at a frequency that is known: stiffness and damping go with the mass
        slopes = np.array([1.0, 600.0**2, 2 * 0.02 * 600.0, 0.0])
        return Dynamics(name, *(mass * slopes[:3]), covariance=u**2 * np.outer(slopes, slopes))

    channels = {name: Channel(name, 50.0 + rng.normal(0, 0.1, count), "N") for name in ("AF", "NF")}
    channels["pitch"] = Channel("pitch", np.full(count, pitch), "rad")
    run = Recording.from_columns(np.arange(count) / 1600.0, channels, name="run")

    def wind(masses, u):
        dynamics = [made(name, *one) for name, one in zip(("AF", "NF"), zip(masses, u, strict=True), strict=True)]
        mean = mean_loads(estimate_force(run, dynamics_of(dynamics), method="paper"))
        return mean_in_axes(mean, flow=Flow(alpha=pitch))["wind"]

    us = (u, u if weighed_once else 1.01 * u)
    stated = np.sqrt(np.maximum(np.diag(wind((mass, mass), us).errors.common), 0.0))[[0, 5]]
    changes = [(mass + u, mass + u)] if weighed_once else [(mass + us[0], mass), (mass, mass + us[1])]
    before = wind((mass, mass), (0.0, 0.0)).values
    moved = [(wind(one, (0.0, 0.0)).values - before)[[0, 5]] for one in changes]
    # what cancels in a variance of 0.2 N^2 leaves 1e-16 of it, of which the root is 5e-9 N
    np.testing.assert_allclose(stated, np.linalg.norm(moved, axis=0), rtol=1e-5, atol=1e-7)
    if weighed_once:
        np.testing.assert_allclose(stated, [u * STANDARD_GRAVITY, 0.0], atol=1e-6)


def test_the_noise_of_a_tare_is_apart_from_what_all_runs_share(rng, seed):
    """A tare of 100 readings with noise s is known to s / 10: read anew it moves the means by so much."""
    balance, noise = replace(random_balance(seed), natural_zero=None), 2e-4  # [mV/V]
    names = [f"r{gauge}" for gauge in balance.gauges]

    def recorded(name, count):
        table = rng.normal(0, noise, (count, 6))
        channels = {one: Channel(one, column, "mV/V") for one, column in zip(names, table.T, strict=True)}
        return Recording.from_columns(np.arange(count) / 1000.0, channels, name=name)

    dynamics = dynamics_of([Dynamics(name, 1.0, 1e6, 20.0) for name in ("AF", "NF")])
    run, zero = recorded("run", 400), Zero(recorded("zero", 400), model_on=False)

    def loads(readings):
        return reduce_outputs(run, balance, zero=zero, model=dynamics, tare=[recorded("tare", readings)])

    place = [COMPONENTS.index(name) for name in dynamics.components]
    repeats = trials(30, 200)
    drawn = [loads(100) for _ in range(repeats)]
    stated = np.mean([np.diag(one.of_tare)[place] for one in drawn], axis=0)
    measured = np.var([one.values[:, place].mean(axis=0) for one in drawn], axis=0, ddof=1)
    # variances with 29 degrees of freedom; what is stated has 19 for each of the 30
    np.testing.assert_allclose(measured / stated, 1.0, atol=4 * np.sqrt(2 / (repeats - 1)))
    short, long = (
        mean_loads(estimate_force(one, dynamics, method="paper")).errors for one in (drawn[0], loads(10_000))
    )
    np.testing.assert_allclose(short.of_tare(), np.sqrt(np.diag(drawn[0].of_tare)[place]), rtol=1e-12)
    assert (long.of_tare() < 0.3 * short.of_tare()).all()  # 0.1, known to 20 %
    # with a tare that is known much better nothing else changes
    np.testing.assert_allclose(np.diag(long.common), np.diag(short.common), rtol=1e-2)


def at_rest(rng, balance, name, count, *, sway=0.0, offset=0.0):
    """Outputs of a balance at rest with a white noise of 2e-4 mV/V, and a sway that all bridges feel alike."""
    names = [f"r{gauge}" for gauge in balance.gauges]
    table = offset + rng.normal(0, 2e-4, (count, 6)) + sway * rng.normal(size=(count, 1))
    channels = {one: Channel(one, column, "mV/V") for one, column in zip(names, table.T, strict=True)}
    return Recording.from_columns(np.arange(count) / 1000.0, channels, name=name)


@pytest.mark.parametrize("pitched", [False, True])
@pytest.mark.soak(first=1)
def test_components_of_a_tare_err_together_as_its_readings_do(rng, seed, pitched):
    balance = replace(random_balance(seed), natural_zero=None)
    run, zero = at_rest(rng, balance, "run", 400), Zero(at_rest(rng, balance, "zero", 400), model_on=False)

    def at_pitch(given, pitch):
        if not pitched:
            return given
        channels = {**given.channels, "pitch": Channel("pitch", np.full(given.samples, pitch), "rad")}
        return replace(given, channels=channels)

    def loads():
        tares = [at_pitch(at_rest(rng, balance, "tare", 200, sway=1e-3), pitch) for pitch in (0.0, 0.1)]
        return reduce_outputs(at_pitch(run, 0.05), balance, zero=zero, tare=tares)

    repeats = trials(40, 200)
    drawn = [loads() for _ in range(repeats)]
    size = np.sqrt(np.mean([np.diag(one.of_tare) for one in drawn], axis=0))
    stated = np.mean([one.of_tare for one in drawn], axis=0) / np.outer(size, size)
    measured = np.cov([one.values.mean(axis=0) for one in drawn], rowvar=False) / np.outer(size, size)
    # at the middle of two pitch angles both count as if they erred alike: variances are twice what they are
    measured *= 2 if pitched else 1
    assert np.abs(stated - np.eye(6)).max() > 0.9  # sway is five times the noise
    np.testing.assert_allclose(measured, stated, atol=5 * np.sqrt(2 / (repeats - 1)))


@pytest.mark.soak(first=0)
def test_an_error_of_the_zero_that_a_tare_takes_off_with_it_is_not_counted(rng, seed):
    """Loads of a run less those of a tare, from zeros that are read anew: what is left of their errors is nothing."""
    balance = replace(random_balance(seed), natural_zero=None)
    run, tare = (at_rest(rng, balance, name, 400) for name in ("run", "tare"))
    dynamics = dynamics_of([Dynamics(name, 1.0, 1e6, 20.0) for name in ("AF", "NF")])

    def loads(**tares):
        zero = Zero(at_rest(rng, balance, "zero", 100), model_on=False)
        return reduce_outputs(run, balance, zero=zero, model=dynamics, **tares)

    with_tare, without = ([loads(**given) for _ in range(20)] for given in ({"tare": [tare]}, {}))
    moved = [np.std([one.values.mean(axis=0) for one in drawn], axis=0, ddof=1) for drawn in (with_tare, without)]
    assert (moved[0] < 0.02 * moved[1]).all()  # what the matrix changes by between loads as small as noise
    stated = [
        np.array([mean_loads(estimate_force(one, dynamics, method="paper")).errors.of_zero() for one in some])
        for some in (with_tare[:3], without[:12])
    ]
    assert (stated[0] < 1e-3 * stated[1][:3]).all()
    place = [without[0].components.index(name) for name in dynamics.components]
    # of white noise u is 1.32 times its standard deviation on average, and varies by 0.60, as some look as if they
    # drifted (40 000 records); 12 of them tell the mean to 13 %, 20 draws tell what moved to 16 %, and two components
    # both to less by the root of two
    relative = np.sqrt(np.mean((moved[1][place] / stated[1].mean(axis=0)) ** 2))
    assert relative == pytest.approx(1 / 1.32, rel=4 * np.hypot(0.13, 0.16) / np.sqrt(2))
    assert (with_tare[0].apart < without[0].apart).all()


def test_a_body_that_is_turned_in_its_balance_has_its_own_angles():
    pitch, pull = np.radians(10.0), 100.0
    balance = ResolvedLoads.of([[pull * np.sin(pitch), 0, 0, 0, 0, pull * np.cos(pitch)]])  # drag alone
    for axes in (Axes(body=Placed(pitch=2.0)), Axes(body=Placed(roll=90.0)), Axes(body=Placed(yaw=-3.0, pitch=1.0))):
        settings = RunSettings(axes=axes)
        flow = flow_of({}, {"pitch": pitch}, settings)
        body = frames_of(axes)[0].loads(balance)
        found = wind_loads(body, angle_of_attack=flow.alpha, sideslip=flow.beta).values[0, [0, 2, 5]]
        np.testing.assert_allclose(found, [0.0, 0.0, pull], atol=1e-9)  # no lift, no side force


def test_gains_of_two_channels_are_two_errors(rng):
    time = np.arange(3200) / 1600
    channels = {
        name: Channel(name, 100 + 2 * rng.normal(size=3200), "N", relative_uncertainty=0.01, zero_uncertainty=3.0)
        for name in ("AF", "NF")
    }
    dynamics = {name: Dynamics(name, mass=177.87, stiffness=3.093e7, damping=828.21) for name in channels}
    force = estimate_force(Recording.from_columns(time, channels, name="run"), dynamics_of(dynamics))
    common = mean_loads(force).errors.common
    assert np.diag(common) == pytest.approx([10.0, 10.0], rel=0.01)  # 1 % of 100 N and 3 N
    assert common[0, 1] == 0


@pytest.mark.soak(first=0)
def test_errors_of_coupled_dynamics_are_common_to_the_components(rng):
    record = SixScene().record(rng)
    force = estimate_force(recording_of(np.column_stack(list(record.columns.values())), SIX.rate), identified())
    # the mean errors of all components under independent numbers of variance 1, which are the same for all
    parts = [[one for one in part.contributions if one.source == "dynamics"] for part in force.values()]
    errors = np.array([(one.slopes @ one.numbers).mean(axis=0) for (one,) in parts])
    expected = errors @ errors.T
    assert mean_loads(force).errors.common == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())
    size = np.sqrt(np.diag(expected))
    assert np.abs(expected / np.outer(size, size) - np.eye(6)).max() > 0.1  # or else the test says nothing
