"""Records that cannot carry a result, and what is said of them."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.balance.zeros import gauge_zero
from aerobalance.identification.base_excitation.rig import identify_rig
from aerobalance.identification.base_excitation.shaking import identify_shaking
from aerobalance.identification.base_excitation.sine_dwell import find_dwells
from aerobalance.identification.free_decay.ring_fit import _covariance
from aerobalance.identification.impact.shaker import identify_shaker
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.identification.step_relaxation.record import release_record
from aerobalance.motion.sensors import driving_sensors
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor
from aerobalance.simulation.calibration_stand import random_balance
from helpers.cable_cut import T128
from helpers.hammer import MASS, POINTS, one_tapped
from seeds import trials

GROUND = ("ground_acceleration", "ground_acceleration_y", "ground_acceleration_z")


@pytest.fixture
def shaken(rng: np.random.Generator) -> Recording:
    """Noise in all loads, and three axes of the ground that move up to some 100 Hz, a second at 2 kHz."""
    loads = {name: rng.normal(size=2000) for name in COMPONENTS}
    ground = {name: np.convolve(rng.normal(size=2019), np.ones(20), "valid") for name in GROUND}
    return Recording.from_arrays(np.arange(2000) / 2000, loads | ground, name="noise")


def changed(record: Recording, name: str, **values) -> Recording:
    """The record with another channel of this name."""
    return replace(record, channels={**record.channels, name: replace(record.channel(name), **values)})


def test_a_shaken_record_names_what_is_not_connected(shaken):
    still = changed(shaken, "YM", values=np.zeros(2000))
    with pytest.raises(FitError, match="the readings of YM never change"):
        identify_shaking([still])
    bare = replace(shaken, channels={name: shaken.channel(name) for name in COMPONENTS})
    with pytest.raises(FitError, match="no motion of the ground end is recorded"):
        identify_shaking([bare])


def test_a_band_beyond_the_record_is_named(shaken):
    with pytest.raises(FitError, match="at 0 frequencies of the record in the band"):
        identify_shaking([shaken], band=(1100.0, 1200.0))
    with pytest.raises(FitError, match="no frequencies of the record lie in the band 1100 to 1200 Hz"):
        identify_rig(shaken, component="AF", mass=1.0, band=(1100.0, 1200.0))


def test_dwells_need_a_record_without_gaps_and_a_ground_that_moves(shaken):
    with pytest.raises(FitError, match="channel AF has missing samples"):
        find_dwells(changed(shaken, "AF", values=np.where(np.arange(2000) == 7, np.nan, 1.0)), component="AF")
    with pytest.raises(FitError, match="channel ground_acceleration does not change"):
        find_dwells(changed(shaken, "ground_acceleration", values=np.zeros(2000)), component="AF")


def test_a_sensor_of_the_ground_without_a_reading_is_named(shaken):
    dead = changed(shaken, "ground_acceleration", values=np.full(2000, np.nan))
    with pytest.raises(FitError, match="noise: ground_acceleration has no reading; leave the channel out"):
        driving_sensors(dead, "AF")


def test_releases_of_two_sampling_rates_are_refused(shaken):
    slower = Recording.from_arrays(np.arange(2000) / 1000, {name: shaken.channel(name).values for name in COMPONENTS})
    with pytest.raises(ValueError, match="one sampling rate, not 1000 to 2000 Hz"):
        identify_releases([shaken, slower], components=COMPONENTS)


def test_readings_at_a_limit_are_left_out_of_a_release_and_told(rng):
    run = CableCut(sensors={"AF": Sensor(noise=2.0)}).run(3.0, rng).recording
    values = np.minimum(run.channel("AF").values, 700.0)  # it swings to 1020 N
    with pytest.warns(DataQualityWarning, match="readings of AF rest on a limit; they are left out of the fit"):
        kept = release_record(changed(run, "AF", values=values), ("AF",))
    limited = values == 700.0
    alone = limited & ~np.roll(limited, 1) & ~np.roll(limited, -1)  # a single reading there may be what it says
    left = np.isin(np.flatnonzero(limited & ~alone), np.round(kept.time * run.rate))
    assert not left.any()
    assert kept.time.size >= np.count_nonzero(~limited)


def test_a_zero_needs_samples_with_all_outputs():
    names = ("N1", "N2", "S1", "S2", "RM", "AF")
    channels = {f"r{name}": Channel(f"r{name}", np.zeros(100), "mV/V") for name in names}
    channels["rAF"] = Channel("rAF", np.full(100, np.nan), "mV/V")
    empty = Recording.from_columns(np.arange(100) / 1000, channels, name="zero")
    with pytest.raises(FitError, match="zero: no samples with all gauge outputs to take a zero from"):
        gauge_zero([empty], random_balance(1), model_on=False)


def test_a_zero_of_two_readings_has_the_uncertainty_of_their_mean():
    balance, readings = random_balance(1), np.array([0.01, 0.03])
    names = ("N1", "N2", "S1", "S2", "RM", "AF")
    channels = {f"r{name}": Channel(f"r{name}", readings, "mV/V") for name in names}
    found = gauge_zero([Recording.from_columns(np.arange(2) / 10, channels, name="two")], balance, model_on=False)
    # of two readings 2 d apart the standard deviation is d sqrt(2), and that of their mean d
    assert found.u == pytest.approx(np.full(6, 0.01))


def test_a_force_that_loads_another_component_is_named(rng):
    with pytest.raises(FitError, match="does not load AF"):
        identify_shaker(one_tapped(rng, blows=1), component="AF", mass=MASS, modes=1, point=POINTS[0])


def test_a_hammer_with_too_few_readings(rng):
    record = one_tapped(rng, blows=1)
    for count in (20, 0):
        force = np.full(record.samples, np.nan)
        force[:count] = 0.0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            with pytest.raises(FitError, match=f"has {count} readings; a tap needs many more"):
                ab.identify(changed(record, "impact_force", values=force), mass=MASS, excitation="impact")


@pytest.mark.soak(first=0)
def test_a_release_that_never_came(rng):
    """Whatever noise looks like: of 40 records one was too short a ringing for its band, and one for a single mean."""
    for _ in range(trials(40, 200)):
        values = rng.normal(0, 2.0, 3000)
        still = Recording.from_arrays(np.arange(3000) / 1600, {"AF": values}, name="still")
        with pytest.raises(FitError, match="still"):
            ab.identify(still, mass=(T128.mass, 0.05))


def test_a_number_of_which_nothing_is_seen_is_beyond_all_uncertainty(rng):
    """The end of a law that grows without end in noise had a column of 1e-169, and the user a warning of NumPy."""
    J = rng.normal(size=(400, 4))
    J[:, 2] *= 1e-169
    left = rng.normal(size=400)
    covariance, _ = _covariance(J, left, number=np.arange(400), turns=0.1, sizes=np.array([0.0, 0.0, 1.0]))
    assert np.isinf(covariance[2, 2])
    told = np.array([0, 1, 3])
    u = np.sqrt(np.diag(covariance)[told])
    # as of white noise of 1: 1 / sqrt(n) but for what chance makes of columns and noise, five times 1 / sqrt(2 n)
    assert u == pytest.approx(1 / 20, rel=5 / np.sqrt(800))
