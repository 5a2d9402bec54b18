"""Gaps in the channels of the ground's motion: predicted, told by the load, and what is left is in the uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerobalance.estimation.force import estimate_force
from aerobalance.motion.gaps import MOST, predicted
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from faults.cases import all_cases
from faults.scene import Clock, band
from faults.trials import recording_of, scores, worked_out
from helpers.coupled_pair import NOISE, pair, shaken
from seeds import trials

CASES = {case.name: case for case in all_cases()}


def motion(rng: np.random.Generator, *, samples: int = 8000, noise: float = 0.05) -> tuple[np.ndarray, Channel]:
    """Noise of 5 to 60 Hz and rms 2, and readings of it."""
    clock = Clock(samples=samples, fine=1)
    true = clock.sampled(band(2.0, 5, 60)(clock, rng))
    return true, Channel("ground_acceleration", true + rng.normal(0, noise, samples), "m/s^2")


@pytest.mark.parametrize(("length", "fixed"), [(8, 20), (60, 20), (700, 4)])
def test_what_a_prediction_misses_is_as_large_as_it_says(length, fixed, rng):
    whole, count = [], trials(fixed, 60)
    for _ in range(count):
        true, channel = motion(rng)
        values = channel.values.copy()
        first = int(rng.integers(1000, 6000))
        values[first : first + length] = np.nan
        filled, errors = predicted(replace(channel, values=values))
        own = slice(first, first + length)
        assert not errors[:first].any()
        assert not errors[first + length :].any()
        missed = filled[own] - true[own]
        said = np.sqrt(np.sum(errors[own] ** 2, axis=1))
        whole.append(np.mean(missed**2) / np.mean(said**2))
    # one gap holds as many independent numbers as the band has in its time, 2 x 55 Hz of it, and at least one
    freedom = count * max(1.0, 110 * length / 1600)
    assert np.mean(whole) == pytest.approx(
        1.0, abs=5 * np.sqrt(2 / freedom) + 0.1
    )  # a tenth: the spectrum is estimated


def test_a_sample_between_others_is_known_better_than_a_reading(rng):
    missed = []
    for place in rng.integers(1000, 7000, 20):
        true, channel = motion(rng, noise=0.05)
        values = channel.values.copy()
        values[place] = np.nan
        filled, errors = predicted(replace(channel, values=values))
        missed.append(filled[place] - true[place])
        # noise that is judged too small is taken for motion that was missed
        assert 0 < np.sqrt(np.sum(errors[place] ** 2)) < 0.1
    assert np.sqrt(np.mean(np.square(missed))) < 0.05


def test_the_errors_are_few_and_as_large_as_all(rng):
    true, channel = motion(rng, samples=20_000)
    values = channel.values.copy()
    values[5_000:10_000] = np.nan
    filled, errors = predicted(replace(channel, values=values))
    assert errors.shape == (20_000, MOST)
    said = np.mean(np.sum(errors[5_500:9_500] ** 2, axis=1))
    # far from its ends nothing is known of it: the variance, to what 64 numbers tell of it
    assert said == pytest.approx(np.var(true), rel=5 * np.sqrt(2 / MOST))
    assert np.isfinite(filled).all()


@pytest.mark.parametrize("values", [np.full(100, 2.0), np.linspace(0, 1, 100)], ids=["constant", "slope"])
def test_what_does_not_move_is_predicted(values):
    given = values.copy()
    given[40:50] = np.nan
    filled, errors = predicted(Channel("pitch", given, "rad", noise=0.0))
    assert filled[40:50] == pytest.approx(values[40:50], abs=0.02)
    assert np.all(np.abs(filled - values) <= 5 * np.sqrt(np.sum(errors**2, axis=1)) + 1e-12)


@pytest.mark.parametrize("name", ["0-60 Hz", "step", "0-20 Hz"])
@pytest.mark.soak(first=1)
def test_a_gap_in_the_accelerometer_is_told_by_the_load_and_counted(name):
    case = CASES[f"accelerometer with a gap of 60 ms, {name}"]
    inside, outside, errors = [], [], []
    for seed in range(trials(2, 20)):
        record = case.record(seed)
        gap = np.isnan(record.columns["ground_acceleration"])
        force, said = worked_out(record, case.dynamics, case.settings)
        assert force is not None
        assert any("96 missing sample(s) are filled by what those about them predict" in text for text in said)
        assert force.verdict != "not usable"
        one = force.only
        assert one.budget["gap in ground_acceleration"] > 0
        here = scores(one.values[gap], one.uncertainty[gap], record.force[gap])
        inside.append(here["error"] ** 2 / here["u"] ** 2)
        errors.append(here["error"])
        z = (one.values - record.force)[~gap] / one.uncertainty[~gap]
        outside.append(np.mean(z**2))
    # a force of 60 Hz has 7 independent numbers in 60 ms, one of 20 Hz 3: five deviations of their mean square
    freedom = 3 * trials(2, 20)
    assert np.mean(inside) < 1 + 5 * np.sqrt(2 / freedom)
    assert np.mean(outside) < 1.2
    # the mass times what is missed is 356 N rms; the force itself has 60 N, and is all that is left unknown
    assert np.sqrt(np.mean(np.square(errors))) < 75.0


@pytest.mark.filterwarnings("ignore:.* shows turning")  # the pair is pitched for its weight alone
def test_a_gap_in_pitch_counts_for_coupled_components(rng):
    coupled = pair()
    force, loads, pitch = shaken(rng, coupled)
    loads = loads + NOISE * rng.normal(size=loads.shape)
    pitch = pitch + rng.normal(0, 1e-4, pitch.size)
    pitch[800:1000] = np.nan
    channels = {
        "NF": Channel("NF", loads[:, 0], "N"),
        "PM": Channel("PM", loads[:, 1], "N*m"),
        "pitch": Channel("pitch", pitch, "rad"),
    }
    run = Recording.from_columns(np.arange(len(loads)) / 4000.0, channels, name="run")
    with pytest.warns(DataQualityWarning, match="200 missing sample"):
        found = estimate_force(run, coupled)
    part = next(one for one in found["NF"].contributions if one.name == "gap in pitch")
    there, elsewhere = part.deviation[820:980], part.deviation[np.r_[0:600, 1200:2000]]
    assert there.mean() > 20 * elsewhere.mean() > 0
    z = (found["NF"].values - force[:, 0])[800:1000] / found["NF"].uncertainty[800:1000]
    assert np.sqrt(np.mean(z**2)) < 2  # one slow error fills it, so it is one number: two deviations and more


def test_a_direct_inverse_counts_a_gap_as_well():
    case = CASES["accelerometer with a gap of 60 ms, 0-60 Hz"]
    record = case.record(0)
    gap = np.isnan(record.columns["ground_acceleration"])
    force, _ = worked_out(record, case.dynamics, {"bandwidth": 120.0})
    assert force is not None
    one = force.only
    error = (one.values - record.force)[gap]
    # without the estimator nothing is told by the load: some 350 N are unknown, and that is said
    assert np.mean(one.uncertainty[gap]) > 150
    assert np.sqrt(np.mean(error**2)) < 3 * np.mean(one.uncertainty[gap])
    assert recording_of(record).channel("ground_acceleration").missing.sum() == 96
