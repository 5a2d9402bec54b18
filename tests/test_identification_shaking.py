"""Coupled dynamics from a shaken ground end: exact without noise, honest with it, refused where they stay open."""

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from aerobalance.app.cli import main
from aerobalance.app.commands.identify_shaking import identify_shaken
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.identification.base_excitation.shaking import identify_shaking
from aerobalance.identification.base_excitation.shaking_fit import first_guess, information_rows
from aerobalance.identification.base_excitation.shaking_fit import squares_of as squares_left
from aerobalance.identification.base_excitation.shaking_record import shake_record
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, MOMENTS, si_unit
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation.six_components import GROUND_CHANNELS, RATE_CHANNELS
from helpers.rigid_balance import HALF_RANGE, RANGES, balance, truth

RATE = 2500.0
SAMPLES = 3000
LEVEL = np.array([2.0, 15.0, 2.0, 15.0, 30.0, 2.0])
"""Rms of the ground's motions [m/s^2, rad/s^2]."""
GROUND_NOISE = np.array([0.02, 0.1, 0.02, 0.1, 0.1, 0.02])
STRAIGHT = np.array([float(name not in MOMENTS) for name in COMPONENTS])
NEVER = 1e-5
"""Probability with which a test of chance may fail for a fresh seed."""


def shaken(generator, *, noise=1.0, along=None, extra=None, dynamics=None, late=0.0, rates=False, name="shake"):
    """Middle of a periodic motion, so that its ends are in full motion; all sensors are at the balance's centre.

    The loads follow from the transforms of the motion and of what keeps the mass turning, line by line: the turns go
    up to 600 Hz, their products to 1200 Hz, below half the sampling rate. `extra` is what the mass matrix has beyond
    that of the rigid mass.
    """
    dynamics = truth() if dynamics is None else dynamics
    rigid = balance()[0] if dynamics.mass is None else dynamics.mass
    mass = rigid.matrix if extra is None else rigid.matrix + extra
    count = 2 * SAMPLES
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    inside = (frequency > 15) & (frequency < 600)
    drawn = generator.normal(size=(frequency.size, 6)) + 1j * generator.normal(size=(frequency.size, 6))
    level = LEVEL * (np.ones(6) if along is None else along)
    lines = drawn * inside[:, None] * level * count / np.sqrt(4 * np.count_nonzero(inside))
    slow = np.where(inside, 2j * np.pi * frequency, 1.0)[:, None]
    speed = np.fft.irfft(lines / slow, count, axis=0)
    turning = rigid.turning_load(speed[:, [COMPONENTS.index(name) for name in MOMENTS]])
    felt = -np.einsum("mij,mj->mi", dynamics.response(frequency), lines @ mass.T + np.fft.rfft(turning, axis=0))
    felt = felt * np.exp(-2j * np.pi * frequency * late)[:, None]
    part = slice(SAMPLES // 2, SAMPLES // 2 + SAMPLES)
    loads = np.fft.irfft(felt, count, axis=0)[part]
    motion = np.fft.irfft(lines, count, axis=0)[part]
    speed = speed[part]
    columns = {
        load: (column + generator.normal(0, noise * 1e-4 * size, SAMPLES), si_unit(load))
        for load, column, size in zip(COMPONENTS, loads.T, HALF_RANGE, strict=True)
    }
    for place, (channel, column) in enumerate(zip(GROUND_CHANNELS, motion.T, strict=True)):
        unit = "rad/s^2" if "turn" in channel else "m/s^2"
        if "turn" not in channel or not rates:
            columns[channel] = (column + generator.normal(0, noise * GROUND_NOISE[place], SAMPLES), unit)
    if rates:
        for channel in RATE_CHANNELS:
            place = COMPONENTS.index(channel[-2:])
            columns[channel] = (speed[:, place] + generator.normal(0, noise * 0.002, SAMPLES), "rad/s")
    time = np.arange(SAMPLES) / RATE
    channels = {key: Channel(name=key, values=values, unit=unit) for key, (values, unit) in columns.items()}
    return Recording.from_columns(time, channels, name=name)


def identified(*recordings, **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return identify_shaking(recordings, half_range=RANGES, **settings)


def squares(error, covariance):
    u = np.sqrt(np.diag(covariance))
    return float((error / u) @ np.linalg.solve(covariance / np.outer(u, u), error / u))


def squares_of(found):
    true = truth()
    error = [(found.dynamics.inertia - true.inertia).ravel(), (found.dynamics.damping - true.damping).ravel()]
    return squares(np.concatenate(error), found.dynamics.covariance)


def within(square, degrees):
    return chi2.ppf(NEVER, degrees) < square < chi2.isf(NEVER, degrees)


# The window passes 1e-7 of the loads. Near a mode A X'' is as large as X, while D X' is 2 zeta of it, 0.008 at least;
# the mass is told beside the modes, which ring up the rms of the loads sqrt(pi f / (4 zeta 585 Hz)), up to six times.
# A rate of turn that is integrated lacks a straight line, and its w x (w x r) and w x I w a tenth of themselves (the
# uncertainty that `Turning` gives it); left out they make up to 1.4e-5 of A and 1.2e-3 of D.
@pytest.mark.parametrize(("rates", "heavy", "slow"), [(True, 1e-7, 1e-7 / 0.008), (False, 1.4e-6, 1.2e-4)])
@pytest.mark.soak(first=1)
def test_without_noise_it_is_exact(rates, heavy, slow, rng):
    found = identified(shaken(rng, noise=0.0, rates=rates))
    true = truth()
    scale = HALF_RANGE[None, :] / HALF_RANGE[:, None]
    for kind, allowed in (("inertia", heavy), ("damping", slow)):
        ours, theirs = getattr(found.dynamics, kind) * scale, getattr(true, kind) * scale
        assert np.abs(ours - theirs).max() < allowed * np.abs(theirs).max(), kind
    assert found.rigid.mass.mass == pytest.approx(20.0, rel=10 * heavy)
    assert found.rigid.mass.centre == pytest.approx(true.mass.centre, abs=10 * heavy)


def test_errors_are_those_that_are_told(rng):
    found = identified(shaken(rng), mass=20.0)
    assert within(squares_of(found), 72)
    error = (found.rigid.mass.values - balance()[0].values)[1:]
    assert within(squares(error, found.rigid.mass.covariance[1:, 1:]), 9)
    assert found.rigid.rigidity.degrees_of_freedom == 26
    assert not found.rigid.from_symmetry
    frequency = [mode.natural_frequency for mode in truth().modes]
    z = (np.array([mode.natural_frequency for mode in found.modes]) - frequency) / found.u_natural_frequency
    assert np.abs(z).max() < 6  # six normal deviates pass 6 once in 1e8


def test_rates_of_turn_serve_too(rng):
    assert within(squares_of(identified(shaken(rng, rates=True), mass=20.0)), 72)


def test_straight_shaking_gives_the_inertia_by_symmetry(rng):
    found = identified(shaken(rng, along=STRAIGHT))
    assert "open (no turn in pitch (PM), turn in yaw (YM), turn in roll (RM))" in "".join(found.notes)
    assert found.rigid.from_symmetry
    assert found.rigid.symmetry.degrees_of_freedom == 9
    assert within(squares_of(found), 72)
    error = found.rigid.mass.values - balance()[0].values
    # the equations of symmetry are quadratic: a tenth of a deviation is left for that
    assert squares(error, found.rigid.mass.covariance) < 1.3 * chi2.isf(NEVER, 10)


def test_gains_of_the_sensors_are_brought_in_line_by_the_weighed_mass(rng):
    """Gains off by a percent, as their settings say, would be errors of the mass; A and D do not need them."""
    made = shaken(rng)
    channels = {
        name: replace(channel, values=channel.values * (1 + rng.normal(0, 0.01)), relative_uncertainty=0.01)
        if name in GROUND_CHANNELS
        else channel
        for name, channel in made.channels.items()
    }
    found = identified(replace(made, channels=channels), mass=20.0)
    assert within(squares_of(found), 72)
    error = (found.rigid.mass.values - balance()[0].values)[1:]
    # products of two gains, one in 10,000, are left out of the linear errors
    assert squares(error, found.rigid.mass.covariance[1:, 1:]) < 1.3 * chi2.isf(NEVER, 9)
    assert found.rigid.weighed.chance


def test_a_gain_of_one_record_is_no_matter_of_another(rng):
    plain, given = shake_record(shaken(rng)), shaken(rng, name="other")
    name = GROUND_CHANNELS[0]
    uncertain = replace(given.channel(name), relative_uncertainty=0.01, zero_uncertainty=0.1)
    other = shake_record(replace(given, channels={**given.channels, name: uncertain}))
    key = ("accelerometer gain", name)
    more = [one for one in other.slopes.keys() - plain.slopes.keys() if not one[0].startswith("weight that turns")]
    assert more == [key]  # the gain alone: a zero is no motion
    found = first_guess([plain, other], sizes=HALF_RANGE)
    place = list(dict.fromkeys([*plain.slopes, *other.slopes])).index(key) - len(plain.slopes | other.slopes)
    moved = found.at(found.values + 0.5 * np.eye(found.values.size)[place])
    squares = squares_left([plain], found)
    # half of its standard uncertainty is all that it costs, but for the rounding of the sum
    assert squares_left([plain], moved) - squares == pytest.approx(0.25, abs=1e-12 * squares)
    products = information_rows([plain], found)[:, place - 1]
    assert products @ products == pytest.approx(1.0)  # and what is known of it beforehand is all that tells it
    assert squares_left([other], moved) != pytest.approx(squares_left([other], found) + 0.25, abs=1e-3)


def test_two_records_tell_more_than_one(rng):
    first, second = shaken(rng, name="a"), shaken(rng, name="b", along=STRAIGHT)
    one, both = identified(first), identified(first, second)
    assert (np.diag(both.dynamics.covariance) < 1.05 * np.diag(one.dynamics.covariance)).all()
    assert both.force_error.sum() < 0.9 * one.force_error.sum()
    assert within(squares_of(both), 72)


def test_a_late_load_is_no_damping(rng):
    found = identified(shaken(rng, late=30e-6))
    assert "lag the ground's motion by" in "".join(found.notes)
    assert abs(found.delay[0] - 30e-6) < 6 * found.delay[1]
    assert within(squares_of(found), 72)


def test_a_wrong_mass_is_noticed(rng):
    found = identified(shaken(rng), mass=(21.0, 0.01))
    assert re.search(r"imply a mass of (19\.9|20\.0|20 ).*kg", "".join(found.notes))
    assert found.dynamics.mass.mass == pytest.approx(20.0, rel=1e-2)


@pytest.mark.parametrize("mass", [None, (20.0, 0.01)])
@pytest.mark.soak(first=1)
def test_a_wrong_sign_of_the_ground_is_noticed(mass, rng):
    recording = shaken(rng)
    turned = {
        name: replace(channel, values=-channel.values) if name in GROUND_CHANNELS else channel
        for name, channel in recording.channels.items()
    }
    found = identified(replace(recording, channels=turned), mass=mass)
    (note,) = found.notes
    assert re.search(r"imply a negative mass, -(19\.9|20\.0|20 ).*kg.* have the other sign", note)
    assert found.rigid.mass is None
    assert within(squares_of(found), 72)  # A and D do not depend on it


def test_a_band_that_is_asked_for_is_kept_to(rng):
    recording = shaken(rng)
    found = identified(recording, band=(30.0, 550.0))
    (shake,) = found.shakes
    assert 30.0 <= shake.band[0] < shake.band[1] <= 550.0
    assert within(squares_of(found), 72)
    with pytest.raises(FitError, match=r"at \d+ frequencies of the record in the band; at least 256"):
        identified(recording, band=(15.0, 60.0))


def test_the_longest_stretch_without_a_gap_is_used(rng):
    recording = shaken(rng)
    load = recording.channel("NF")
    values = load.values.copy()
    values[700:760] = np.nan
    made = replace(recording, channels={**recording.channels, "NF": replace(load, values=values)})
    with pytest.warns(DataQualityWarning, match="2240 of 3000 samples in a row are used"):
        found = identify_shaking([made])  # without half ranges as well: the largest changes of load serve
    (shake,) = found.shakes
    assert shake.duration == pytest.approx((SAMPLES - 760) / RATE, abs=1.5 / RATE)
    assert within(squares_of(found), 72)
    assert not found.half_range_given


def test_a_mass_that_is_not_rigid_is_noticed(rng):
    extra = np.zeros((6, 6))
    extra[0, 0] = 0.5  # heavier along NF, as a live end of its own is
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = identify_shaking([shaken(rng, extra=extra, name="odd")], half_range=RANGES)
    assert "not those of a rigid mass" in "".join(found.notes)
    assert [f"odd: {note}" for note in found.notes] == [
        str(one.message) for one in said if issubclass(one.category, DataQualityWarning)
    ]


def test_a_mode_at_rest_is_refused_with_the_shake_to_add(rng):
    mass, stiffness, _ = balance()
    # of equal inertia in pitch and yaw: then no turn of these two calls for a moment in roll
    level = RigidMass(mass.mass, np.zeros(3), np.diag([0.9, 0.8, 0.8]))
    alone = np.diag(np.diag(stiffness))
    dynamics = CoupledDynamics.of_rigid_mass(level, stiffness=alone, damping=1e-5 * alone)
    along = np.where(np.array(COMPONENTS) == "RM", 0.0, 1.0)
    with pytest.raises(FitError, match=r"no shake moves RM .*add a shake in the ground's turn in roll \(RM\)"):
        identified(shaken(rng, along=along, dynamics=dynamics))


def test_what_is_no_shaking_is_refused(rng):
    recording = shaken(rng)
    loads = {name: recording.channel(name) for name in COMPONENTS}
    with pytest.raises(FitError, match="no motion of the ground end is recorded"):
        identified(Recording.from_columns(recording.time, loads, name="loads alone"))
    with pytest.raises(FitError, match="has no AF; coupled components"):
        without = {name: channel for name, channel in recording.channels.items() if name != "AF"}
        identified(Recording.from_columns(recording.time, without, name="five"))
    with pytest.raises(FitError, match=r"the ground end does not move|shake harder"):  # noise may stand out by chance
        identified(shaken(rng, along=np.zeros(6)))
    with pytest.raises(ValueError, match="at least one recording"):
        identified()
    with pytest.raises(ValueError, match="two frequencies in rising order"):
        identified(recording, band=(100.0, 50.0))
    with pytest.raises(ValueError, match="half_range must give a positive value for PM, SF"):
        identify_shaking([recording], half_range={"NF": 1.0})
    with pytest.raises(FitError, match=r"no shake moves .*so [56] of 6 modes stay unknown"):
        noise = {name: replace(one, values=rng.normal(size=recording.samples)) for name, one in loads.items()}
        identified(replace(recording, channels={**recording.channels, **noise}))


def test_the_command_writes_what_force_reads(tmp_path, capsys, rng):
    file, out = tmp_path / "a.h5", tmp_path / "dynamics.json"
    write_recording(file, shaken(rng, name="a"))
    ranges = [part for name, size in RANGES.items() for part in ("--half-range", f"{name}={size:g}")]
    command = ["identify", "rig", str(file), "--component", "all", "--mass", "20", *ranges, "-o", str(out)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "rms of the ground's motion in each" in said
    assert "symmetric stiffness: holds" in said or "symmetric stiffness: does not hold" in said
    fit = json.loads(out.read_text())["fit"]
    assert len(fit["shakes"]) == 1
    assert set(fit["tests"]) == {"rigidity", "symmetry", "reciprocity", "mass"}
    dynamics = read_coupled(out)
    assert dynamics.mass.mass == pytest.approx(20.0, rel=1e-6)
    made = shaken(rng)
    found, expected = (CoupledRecord.of(made, one).from_ground for one in (dynamics, truth()))
    # A is known to a hundredth of a percent, and a tenth of a percent of A moves a mode by a tenth of its width
    off = np.sqrt(np.mean((found - expected) ** 2, axis=0))
    assert (off < 0.05 * np.sqrt(np.mean(expected**2, axis=0))).all()


def test_one_component_takes_one_record(tmp_path, capsys, rng):
    file = tmp_path / "a.h5"
    write_recording(file, shaken(rng))
    assert main(["identify", "rig", str(file), str(file), "--component", "AF"]) == 2
    assert "2 recordings were given" in capsys.readouterr().err
    assert main(["identify", "rig", str(file), "--component", "AF", "--half-range", "AF=500"]) == 2
    assert "--half-range goes with --component all" in capsys.readouterr().err
    with pytest.raises(ValueError, match="--mass must be a positive number"):
        identify_shaken([file], None, mass="-3")
