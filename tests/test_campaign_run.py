"""One run reduced: its bands, its stiffness and damping, and what it lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.app.campaign.assignment import OF_RESULTS, Run
from aerobalance.app.campaign.definition import Axes, Placed, Pressure, Reference
from aerobalance.app.campaign.reduction import RunSettings, flow_of, frames_of, reduce_run
from aerobalance.app.campaign.rows import row_of
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.estimation.forces import ForceSettings
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.uncertainty.repeats import trend
from helpers.axial_runs import RATE, run_of, spring
from seeds import trials

# a white load up to half the rate is more than the model of the force has been made for, which some records say
pytestmark = pytest.mark.filterwarnings("ignore:.*depart from what the model:UserWarning")


def test_bands_make_up_the_whole(rng):
    bands = [(0.0, 50.0), (50.0, 300.0), (300.0, RATE / 2), (RATE, 2 * RATE)]
    run = run_of(rng, samples=1600)
    found = reduce_run(run, spring(), settings=RunSettings(bands=bands))
    levels, rms = found.bands["AF"], found.scalars["AF"]["rms_about_mean"].value
    assert levels[3].rms is None
    # segments leave the slowest out, and windows weigh the ends less: a tenth of the rms for a record of 8 segments
    assert np.sqrt(sum(one.rms**2 for one in levels[:3])) == pytest.approx(rms, rel=0.1)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # the dynamics are others
@pytest.mark.soak(first=0)
def test_stiffness_and_damping_are_told_by_each_record(rng):
    # k = M w^2 and b = 2 M z w: a balance whose stiffness is 2 % higher, and its damping 1.5 times as large
    known = spring()
    other = spring(stiffness=1.02 * known.stiffness, damping=1.5 * known.damping)
    found = [reduce_run(run_of(rng, samples=6400, dynamics=other), known).resonances[0] for _ in range(trials(4, 6))]
    told = [one for one in found if one.stiffness is not None]
    assert len(told) >= 3
    of_k, of_b = trend_of([one.stiffness for one in told]), trend_of([one.damping for one in told])
    assert of_k.mean - np.log(1.02) == pytest.approx(0, abs=4 * of_k.u_mean)
    assert of_b.mean - np.log(1.5) == pytest.approx(0, abs=4 * of_b.u_mean + 0.1)  # to first order
    assert of_k.mean > 4 * of_k.u_mean  # where one record tells it with 2 or 3


def trend_of(values):
    return trend(range(len(values)), [one[0] for one in values], [one[1] for one in values])


def test_body_and_moment_centre_are_frames():
    body, centre = frames_of(
        Axes(
            body=Placed(point=(0.1, 0, -0.02), pitch=3.0, roll=-2.0, yaw=1.0, u_point=1e-3, u_angle=0.1),
            moment_centre=(0.2, 0, 0.1),
            u_moment_centre=2e-3,
        )
    )
    assert body.point.tolist() == [0.1, 0, -0.02]
    assert (body.pitch, body.roll, body.yaw) == pytest.approx(np.radians([3.0, -2.0, 1.0]))
    np.testing.assert_allclose(np.sqrt(np.diag(body.covariance)), [1e-3] * 3 + [np.radians(0.1)] * 3)
    assert centre.point.tolist() == [0.2, 0, 0.1]
    np.testing.assert_allclose(np.sqrt(np.diag(centre.covariance)), [2e-3] * 3 + [0] * 3)


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


@pytest.mark.parametrize(("unit", "reading"), [("Pa", 1500.0), ("kPa", 1.5), ("mbar", 15.0)])
@pytest.mark.soak(first=2)
def test_a_pressure_that_was_recorded_is_taken_in_its_own_unit(rng, unit, reading):
    run = run_of(rng)
    values = np.full(run.samples, reading)
    values[10:20] = np.nan
    recorded = replace(run, channels={**run.channels, "q": Channel("q", values, unit)})
    found = reduce_run(recorded, spring(), settings=RunSettings(pressure=Pressure(channel="q")))
    assert found.flow.pressure == pytest.approx(1500.0, rel=1e-12)


def test_a_channel_in_no_unit_of_pressure_is_no_pressure(rng):
    run = run_of(rng)
    recorded = replace(run, channels={**run.channels, "q": Channel("q", np.ones(run.samples), "V")})
    with pytest.raises(ValueError, match="in channel q, which is in V; allowed: Pa, hPa, kPa"):
        reduce_run(recorded, spring(), settings=RunSettings(pressure=Pressure(channel="q")))


def test_zero_and_gain_of_the_angle_count_where_the_angle_is_from_it(rng):
    """By an angle that is off by u, lift L and drag D are off by -D u and (L - W) u, W being a small weight."""
    samples, pitch, u, gain = 800, np.radians(10.0), np.radians(0.3), 0.02
    dynamics = {name: ab.Dynamics(name, mass=1e-3, stiffness=1e5, damping=0.4) for name in ("AF", "NF")}

    def found(columns, **stated):
        channels = {name: Channel(name, 50.0 + rng.normal(0, 0.1, samples), "N") for name in dynamics}
        channels["pitch"] = Channel("pitch", np.full(samples, pitch), "rad", **stated)
        run = ab.Recording.from_columns(np.arange(samples) / RATE, channels)
        return reduce_run(run, dynamics_of(dynamics), columns=columns)

    off = np.hypot(u, gain * pitch)
    wind = found({}, zero_uncertainty=u, relative_uncertainty=gain).axes["wind"]
    lift, drag = wind.values[[0, 5]]
    covariance = wind.errors.common[np.ix_([0, 5], [0, 5])]
    slopes = [-drag, lift - 1e-3 * STANDARD_GRAVITY]
    expected = off**2 * np.outer(slopes, slopes)
    np.testing.assert_allclose(covariance, expected, atol=1e-4 * off**2 * lift**2)
    of_table = found({"alpha": 10.0, "beta": 0.0}, zero_uncertainty=u, relative_uncertainty=gain)
    assert of_table.flow.by_sensors == {"pitch zero": (0.0, 0.0), "pitch gain": (0.0, 0.0)}


def test_an_angle_of_roll_is_sideslip_by_the_sine_of_pitch():
    # sin(beta) = sin(pitch) sin(roll) and tan(alpha) = tan(pitch) cos(roll) of a body with the axes of its balance
    pitch = 0.3
    u = {"pitch zero": 1e-3, "roll gain": 2e-3}
    found = flow_of({}, {"pitch": pitch, "roll": 0.0}, RunSettings(), u_attitude=u).by_sensors
    np.testing.assert_allclose(found["pitch zero"], (1e-3, 0.0), atol=1e-12)  # by differences: 1e-16 of 1e-6
    np.testing.assert_allclose(found["roll gain"], (0.0, 2e-3 * np.sin(pitch)), atol=1e-12)


@pytest.mark.parametrize(("method", "lift"), [("paper", -300.0), ("smoother", 300.0)])
@pytest.mark.soak(first=1)
def test_an_inclinometer_that_is_off_is_one_error_of_weight_and_axes(rng, method, lift):
    """By a pitch that is off by u, drag is off by (L - M g) u and lift by -D u: the weight counts with its sign."""
    samples, pitch, mass, drag, u, gain = 400, np.radians(10.0), 20.0, 30.0, np.radians(0.05), 0.01
    dynamics = {
        name: ab.Dynamics(name, mass, stiffness=mass * 600.0**2, damping=0.04 * mass * 600.0) for name in ("AF", "NF")
    }
    weight = mass * STANDARD_GRAVITY
    sine, cosine = np.sin(pitch), np.cos(pitch)
    felt = {
        "AF": drag * cosine - lift * sine + weight * sine + rng.normal(0, 0.1, samples),
        "NF": lift * cosine + drag * sine - weight * cosine + rng.normal(0, 0.1, samples),
    }

    def wind(angle):
        channels = {name: Channel(name, values, "N") for name, values in felt.items()}
        channels["pitch"] = Channel(
            "pitch", np.full(samples, angle), "rad", zero_uncertainty=u, relative_uncertainty=gain
        )
        run = ab.Recording.from_columns(np.arange(samples) / RATE, channels)
        found = reduce_run(run, dynamics_of(dynamics), settings=RunSettings(force=ForceSettings(method=method)))
        return found.axes["wind"]

    found = wind(pitch)
    stated = np.sqrt(np.diag(found.errors.common))[[0, 5]]
    off = np.hypot(u, gain * pitch)
    moved = (wind(pitch + off).values - wind(pitch - off).values)[[0, 5]] / 2
    np.testing.assert_allclose(stated, np.abs(moved), rtol=1e-4)  # a third-order error of off: 2e-6
    # 0.1 N in 400 samples leave 5e-3 N of the forces
    np.testing.assert_allclose(stated, off * np.abs([drag, lift - weight]), atol=5 * 5e-3 * off)


def test_zero_and_gain_of_the_recorded_pressure_are_in_its_uncertainty(rng):
    run = run_of(rng)
    recorded = Channel("q", np.full(run.samples, 1.5), "kPa", zero_uncertainty=0.004, relative_uncertainty=0.002)
    settings = RunSettings(pressure=Pressure(channel="q", u=12.0))
    flow = reduce_run(replace(run, channels={**run.channels, "q": recorded}), spring(), settings=settings).flow
    assert flow.u_pressure == pytest.approx(np.sqrt(4.0**2 + 3.0**2 + 12.0**2), rel=1e-12)


def test_no_column_of_a_table_is_called_as_one_of_the_results(rng):
    settings = RunSettings(
        reference=Reference(area=0.1, chord=0.2, span=0.5), pressure=Pressure(value=1e3), bands=[(1.0, 10.0)]
    )
    found = reduce_run(run_of(rng), spring(), settings=settings)
    row = row_of(Run("a", 1, "a.h5", columns={"alpha": 2, "L": 1.0}), found, [])
    told = {name for name in row if not OF_RESULTS.fullmatch(name)}
    assert told == {"file", "alpha", "L"}  # those of the table, and the file, which it names
