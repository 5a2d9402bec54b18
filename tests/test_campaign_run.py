"""One run reduced: its mean and coefficients with all of their errors, its bands, and its stiffness and damping."""

from __future__ import annotations

import numpy as np
import pytest

from aerobalance.app.campaign.definition import Axes, Placed, Pressure, Reference
from aerobalance.app.campaign.mean_loads import Errors, MeanLoads, mean_loads
from aerobalance.app.campaign.quality import trend
from aerobalance.app.campaign.reduction import RunSettings, reduce_run
from aerobalance.app.campaign.resolved import Flow, angles_of_attitude, frame_of, resolved
from aerobalance.estimation.force import estimate_force
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.frames import Frame, ResolvedLoads, coefficients, wind_loads
from helpers.axial_runs import RATE, run_of, spring

# a white load up to half the rate is more than the model of the force has been made for, which some records say
pytestmark = pytest.mark.filterwarnings("ignore:.*depart from what the model:UserWarning")

REFERENCE = Reference(area=0.3, chord=0.2, span=1.1)


def six_means(rng) -> MeanLoads:
    parts = {}
    for name, size in (("common", 0.3), ("zero", 0.1), ("run", 0.2), ("scatter", 0.5)):
        half = size * rng.normal(size=(6, 6))
        parts[name] = half @ half.T
    return MeanLoads(COMPONENTS, 100 * rng.normal(size=6), Errors(**parts), 11.0)


def test_attitude_makes_angles_of_the_wind():
    # level and pitched: the angle of attack is the pitch; rolled onto its right side, the wind comes from the right
    for pitch, roll, expected in ((0.1, 0.0, (0.1, 0.0)), (0.1, np.pi / 2, (0.0, 0.1)), (0.1, np.pi, (-0.1, 0.0))):
        np.testing.assert_allclose(angles_of_attitude(pitch, roll), expected, atol=1e-12)


def test_errors_go_through_axes_and_coefficients_as_one_covariance_does(rng):
    mean = six_means(rng)
    axes = Axes(body=Placed(point=(0.1, 0.0, -0.02), pitch=3.0, u_angle=0.1), moment_centre=(0.2, 0.0, 0.1))
    flow = Flow(0.12, 0.05, u_angle=1e-3, u_angle_run=2e-3, pressure=900.0, u_pressure=3.0, u_pressure_run=4.0)
    found = resolved(mean, axes=axes, flow=flow, reference=REFERENCE)
    whole = ResolvedLoads(mean.values[None], mean.errors.whole[None])
    body = Frame(np.array(axes.moment_centre)).loads(frame_of(axes.body).loads(whole))
    both = (1e-3**2 + 2e-3**2) * np.eye(2)
    wind = wind_loads(body, angle_of_attack=0.12, sideslip=0.05, angle_covariance=both)
    sizes = {"area": 0.3, "chord": 0.2, "span": 1.1}
    of_wind = coefficients(wind, pressure=900.0, pressure_uncertainty=5.0, **sizes)
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
    mean = MeanLoads(("AF",), np.array([30.0]), Errors(*(np.eye(1) for _ in range(4))), 11.0)
    level = resolved(mean, axes=Axes(), flow=Flow(pressure=100.0), reference=REFERENCE)
    assert level["wind"].values[5] == pytest.approx(30.0)  # level, drag is the axial force
    assert level["C_wind"].values[5] == pytest.approx(30.0 / (100.0 * 0.3))
    pitched = resolved(mean, axes=Axes(), flow=Flow(alpha=0.1, pressure=100.0), reference=REFERENCE)
    assert np.isnan(pitched["wind"].values[[0, 5]]).all()  # lift and drag have a part of the normal force too
    assert pitched["C_body"].values[5] == pytest.approx(1.0)
    assert np.isnan(pitched["C_body"].values[:5]).all()


def test_the_mean_of_a_run_is_as_uncertain_as_said(rng):
    # the steady load of runs under a random load, whose share in the mean of so short a record is chance
    dynamics, scores, us = spring(), [], []
    for _ in range(16):
        found = mean_loads(estimate_force(run_of(rng, mean=200.0), dynamics, hum="keep"))
        us.append(found.errors.uncertainty()[0])
        scores.append((found.values[0] - 200.0) / us[-1])
    # white noise of 20 N over 800 samples; its spectrum by 12 tapers is known to 29 %, the mean of 16 to 7 %
    assert np.mean(np.square(us)) == pytest.approx(20.0**2 / 800, rel=5 * 0.07)
    # t with 11 degrees of freedom has a variance of 11/9, and its square a standard deviation of 2.3: 16 of them
    assert np.mean(np.square(scores)) < 11 / 9 + 5 * 2.3 / np.sqrt(16)
    assert np.mean(np.square(scores)) > 0.2


def test_bands_make_up_the_whole(rng):
    bands = [(0.0, 50.0), (50.0, 300.0), (300.0, RATE / 2), (RATE, 2 * RATE)]
    run = run_of(rng, samples=1600)
    found = reduce_run(run, spring(), settings=RunSettings(bands=bands))
    levels, rms = found.bands["AF"], found.scalars["AF"]["rms_about_mean"].value
    assert levels[3].rms is None
    # segments leave the slowest out, and windows weigh the ends less: a tenth of the rms for a record of 8 segments
    assert np.sqrt(sum(one.rms**2 for one in levels[:3])) == pytest.approx(rms, rel=0.1)


def test_stiffness_and_damping_are_told_by_each_record(rng):
    # k = M w^2 and b = 2 M z w: a balance whose stiffness is 2 % higher, and its damping 1.5 times as large
    known = spring()
    other = spring(stiffness=1.02 * known.stiffness, damping=1.5 * known.damping)
    found = [reduce_run(run_of(rng, samples=6400, dynamics=other), known).resonances[0] for _ in range(6)]
    told = [one for one in found if one.stiffness is not None]
    assert len(told) >= 3
    of_k, of_b = trend_of([one.stiffness for one in told]), trend_of([one.damping for one in told])
    assert of_k.mean - np.log(1.02) == pytest.approx(0, abs=4 * of_k.u_mean)
    assert of_b.mean - np.log(1.5) == pytest.approx(0, abs=4 * of_b.u_mean + 0.1)  # to first order
    assert of_k.mean > 4 * of_k.u_mean  # where one record tells it with 2 or 3


def trend_of(values):
    return trend(range(len(values)), [one[0] for one in values], [one[1] for one in values])


def test_a_record_of_noise_says_nothing_of_the_resonance(rng):
    still = run_of(rng, samples=1600)
    quiet = type(still).from_arrays(still.time, {"AF": rng.normal(0, 0.5, still.samples)})
    (found,) = reduce_run(quiet, spring()).resonances
    assert found.stiffness is None
    assert found.damping is None


def test_what_is_asked_for_and_not_there_is_named(rng):
    run, dynamics = run_of(rng), spring()
    for settings, said in (
        (RunSettings(pressure=Pressure(column="q")), "should be in column q"),
        (RunSettings(pressure=Pressure(channel="q")), "should be in channel q"),
        (RunSettings(alpha="angle"), "alpha should be in column angle"),
    ):
        with pytest.raises(ValueError, match=said):
            reduce_run(run, dynamics, settings=settings)
    with pytest.raises(ValueError, match="above 0 Pa, not -1"):
        reduce_run(run, dynamics, columns={"q": -1}, settings=RunSettings(pressure=Pressure(column="q")))
    with pytest.raises(ValueError, match="column alpha must be a number of degrees, not 'up'"):
        reduce_run(run, dynamics, columns={"alpha": "up"})
