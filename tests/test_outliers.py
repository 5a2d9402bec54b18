"""Wild, stuck and clipped samples: found where they are, and nowhere else."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.balance.loads import Loads
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.zeros import GaugeZero
from aerobalance.estimation.checks.outliers import without_wild_samples
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.stuck_samples import stuck_samples
from aerobalance.recording.wild_samples import wild_samples
from aerobalance.simulation.calibration_stand import random_balance
from faults.cases import all_cases
from faults.trials import scores, worked_out
from helpers.cable_cut import T128
from seeds import seed_from

RATE = 1600.0
TIME = np.arange(4000) / RATE
CASES = {case.name: case for case in all_cases()}


def ringing(rng: np.random.Generator, *, noise: float = 2.0) -> np.ndarray:
    """Readings of a balance after a sudden force of 1000 N."""
    return 1000 * T128.step_response(TIME - 1.0003) + rng.normal(0, noise, TIME.size)


def test_single_wild_samples_are_found_where_they_are(rng):
    values = ringing(rng)
    places = rng.choice(np.arange(10, 3990, 12), 20, replace=False)
    # a departure scatters by 1.4 times the noise, is judged by the median of 24 of them, which may be 2.5 times that,
    # two of them wild ones too, and is found from 9 times that: 63 N, and twice as much is clear
    values[places] += 120.0 * rng.choice([-1.0, 1.0], places.size)
    assert np.flatnonzero(wild_samples(values)).tolist() == sorted(places.tolist())


@pytest.mark.parametrize("length", [2, 3])
def test_two_or_three_in_a_row_are_found(length, rng):
    values = ringing(rng)
    values[2000 : 2000 + length] = 0.0
    assert np.flatnonzero(wild_samples(values)).tolist() == list(range(2000, 2000 + length))


def test_noise_steps_blows_and_tones_have_no_wild_sample(rng):
    fine = np.arange(TIME.size * 16) / (16 * RATE)
    blow = 5e4 * ((fine > 1.2) & (fine < 1.2005))  # 25 N s within a sample
    for values in (
        rng.normal(0, 1.0, 200_000),
        ringing(rng),
        ringing(rng, noise=0.0),
        T128.balance_load(blow, interval=1 / (16 * RATE))[::16] + rng.normal(0, 2.0, TIME.size),
        np.sin(2 * np.pi * 700 * TIME),
        np.round(5 * np.sin(20 * TIME) + rng.normal(0, 0.05, TIME.size)),  # few steps
        np.full(500, 3.0),
        np.zeros(10),
    ):
        assert not wild_samples(values).any()


@pytest.mark.parametrize("per_period", [3.2, 3.7, 5.0, 8.0])
def test_a_mode_that_rings_in_few_samples_a_period_has_no_wild_sample(per_period, rng):
    """Closed form: the step response of a mode of 1.2 %, whose ringing no cubic through its neighbours follows."""
    angle, ratio = 2 * np.pi / per_period, 0.012
    since = np.maximum(np.arange(4000) - 1000.3, 0.0)
    damped = angle * np.sqrt(1 - ratio**2)
    rings = np.exp(-ratio * angle * since) * (np.cos(damped * since) + ratio * angle / damped * np.sin(damped * since))
    values = 100 * (1 - rings) + rng.normal(0, 0.2, since.size)
    assert not wild_samples(values).any()
    values[[1200, 1400]] += 60.0  # the ringing has died away to 0.5 by the second
    assert 1400 in np.flatnonzero(wild_samples(values))


def test_missing_readings_are_no_wild_ones_and_hide_none(rng):
    values = ringing(rng)
    values[500:520] = np.nan
    values[700] += 200.0
    assert np.flatnonzero(wild_samples(values)).tolist() == [700]


def test_a_run_of_equal_readings_is_stuck(rng):
    values = ringing(rng)
    values[1500:1530] = values[1500]
    assert np.flatnonzero(stuck_samples(values)).tolist() == list(range(1501, 1530))


def test_few_steps_and_no_change_are_not_stuck(rng):
    assert not stuck_samples(np.round(rng.normal(0, 0.3, 4000))).any()
    assert not stuck_samples(np.round(rng.normal(0, 30.0, 100_000))).any()
    assert not stuck_samples(np.full(1000, 2.0)).any()
    assert not stuck_samples(np.zeros(1)).any()


def test_what_rests_by_its_nature_is_not_stuck(rng):
    rough = rng.normal(0, 1.0, 4000)
    for values in (
        np.round(0.18 * rough),  # a step of the converter is five times the noise
        np.floor(np.arange(4000) / 40),  # an encoder that turns
        np.repeat(rough[:40], 100),  # each reading of a slower converter held
    ):
        assert not stuck_samples(values).any()


@pytest.mark.parametrize("digits", [None, 9, 6, 3])
def test_a_step_without_noise_rests_before_it_and_is_not_stuck(digits):
    """As simulated, and as that is written to a text file with some digits after the point."""
    values = 700 * T128.step_response(TIME - 1.0001)
    assert not stuck_samples(values if digits is None else np.round(values, digits)).any()


def test_with_noise_of_a_step_of_the_converter_it_was_stuck(rng):
    """Noise of half a step, 24 bits: of two readings of a still load four in ten are equal, and 1600 never."""
    values = 700 * T128.step_response(TIME - 1.0001)
    step = 10 * np.ptp(values) / 2**24
    noisy = step * np.round((values + rng.normal(0, 0.5 * step, TIME.size)) / step)
    noisy[:1601] = noisy[0]
    assert np.flatnonzero(stuck_samples(noisy))[:1600].tolist() == list(range(1, 1601))


def test_an_angle_that_rests_is_not_stuck(rng):
    pitch = np.where(TIME < 1.2, 0.0, 0.1)
    channels = {"AF": Channel("AF", ringing(rng), "N"), "pitch": Channel("pitch", pitch, "rad")}
    given = Recording.from_columns(TIME, channels, name="run")
    clean, doubts = without_wild_samples(given, ["AF"])
    assert clean is given
    assert not doubts


def test_a_spike_is_filled_from_sound_neighbours_alone(rng):
    smooth = np.sin(2 * np.pi * 20 * TIME)
    seen = smooth + rng.normal(0, 1e-3, TIME.size)
    seen[1500:1530] = seen[1500]  # stuck, and no neighbour of what follows
    seen[[1532, TIME.size - 4]] += 5.0  # the latter with three neighbours on its far side
    channels = {
        "AF": Channel("AF", ringing(rng), "N"),
        "ground_acceleration": Channel("ground_acceleration", seen, "m/s^2"),
    }
    clean, _ = without_wild_samples(Recording.from_columns(TIME, channels, name="run"), ["AF"])
    assert isinstance(clean, Recording)
    filled = clean.channel("ground_acceleration").values
    assert np.isnan(filled[1501:1530]).all()
    # a straight line through the two and eight readings beside it: the curvature of the sine over 5 ms
    assert filled[1532] == pytest.approx(smooth[1532], abs=0.5 * (2 * np.pi * 20 * 5e-3) ** 2)
    assert filled[TIME.size - 4] == pytest.approx(smooth[TIME.size - 4], abs=0.02)


@pytest.mark.parametrize("share", [0.6, 0.8])
@pytest.mark.soak(first=1)
def test_a_clipped_accelerometer_is_named_and_costs_little(share, rng):
    case, seed = CASES["0-100 Hz, 200 N, shaken"], seed_from(rng)
    record = case.record(seed)
    sound, _ = worked_out(record, case.known(seed), case.settings)
    motion = record.columns["ground_acceleration"]
    limit = share * np.abs(motion).max()
    # it stays at the limit for two samples and more, so that this is seen
    record.columns["ground_acceleration"] = np.clip(motion, -limit, limit)
    force, _ = worked_out(record, case.known(seed), case.settings)
    assert force is not None
    assert sound is not None
    found = scores(force.only.values, force.only.uncertainty, record.force)
    best = scores(sound.only.values, sound.only.uncertainty, record.force)
    kinds = {doubt.kind for doubt in force.doubts}
    assert kinds & {"clipping", "wild samples"}
    assert not kinds & {"ground gain", "ground delay"}
    # the force is told by the load what the accelerometer missed: gaps of a few samples each, up to 7 % of the record.
    # Of a sound record it scatters by a fifth about u, by which a lucky one is not to count against the clipped one
    assert found["error"] < 1.5 * found["u"]
    assert found["error"] < 1.5 * max(best["error"], best["u"])
    assert found["cover"] > 0.85


def test_a_channel_that_was_stuck_nearly_all_the_time_is_refused(rng):
    values = ringing(rng)
    values[100:] = values[100]
    run = Recording.from_columns(TIME, {"AF": Channel("AF", values, "N")}, name="run")
    with pytest.raises(FitError, match=r"3899 samples of 4000 of AF repeat the one before"):
        without_wild_samples(run, ["AF"])


def test_the_ground_motion_is_filled_and_not_missing(rng):
    smooth = np.sin(2 * np.pi * 20 * TIME)
    seen = smooth + rng.normal(0, 1e-3, TIME.size)
    seen[[900, 2100]] += 5.0
    channels = {
        "AF": Channel("AF", ringing(rng), "N"),
        "ground_acceleration": Channel("ground_acceleration", seen, "m/s^2"),
    }
    given = Recording.from_columns(TIME, channels, name="run")
    clean, doubts = without_wild_samples(given, ["AF"])
    assert isinstance(clean, Recording)
    filled = clean.channel("ground_acceleration").values
    assert filled[[900, 2100]] == pytest.approx(smooth[[900, 2100]], abs=6e-3)  # six deviations of the noise
    (doubt,) = doubts
    assert doubt.kind == "wild samples"
    assert doubt.text.startswith("2 samples of ground_acceleration far from their neighbours (at 0.5625, 1.3125 s)")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("40 spikes of 300 N, 0-20 Hz", "wild samples"),
        ("1 spikes of 99999 N, step", "wild samples"),
        ("5 dropouts to zero, 0-100 Hz", "wild samples"),
        ("5 spikes in the accelerometer, step", "wild samples"),
        ("stuck for 0.02 s, step", "stuck channel"),
        ("0.3 % clipped both, 0-100 Hz", "clipping"),
        ("2 % clipped above, 0-20 Hz", "clipping"),
    ],
)
@pytest.mark.soak(first=0)
def test_the_force_is_as_good_as_without_the_fault(name, kind):
    case = CASES[name]
    record = case.record(0)
    force, said = worked_out(record, case.dynamics, case.settings)
    assert force is not None, said
    assert [doubt.kind for doubt in force.doubts] == [kind]
    assert force.doubts[0].effect == 0.0
    assert str(force.verdict) == "fit for use"
    one = force.only
    found = scores(one.values, one.uncertainty, record.force)
    # the same draws without the fault: where 2 % of the readings are missing, all else is as it was
    sound = replace(case, change=None).record(0)
    best, said = worked_out(sound, case.dynamics, case.settings)
    assert best is not None, said
    clean = scores(best.only.values, best.only.uncertainty, sound.force)
    assert found["error"] < 1.5 * clean["error"]
    assert found["u"] < 1.5 * clean["u"]


def test_outliers_can_be_kept(rng):
    case = CASES["1 spikes of 99999 N, step"]
    record = case.record(0)
    force, _ = worked_out(record, case.dynamics, {"keep_outliers": True})
    assert force is not None
    assert np.std(force.only.values - record.force) > 10


def test_where_an_output_of_a_bridge_is_wild_all_loads_are_missing(rng):
    """Each load needs all bridges, and in most of them the error is too small to be seen beside their noise."""
    matrix = replace(random_balance(seed_from(rng)), natural_zero=None)
    native = np.zeros((TIME.size, 6))
    native[:, 5] = ringing(rng)
    outputs = matrix.outputs(native) + rng.normal(0, 1e-4, native.shape)  # mV/V
    outputs[700, 5] += 0.2  # AF reads to some mV/V
    names = ("rN1", "rN2", "rS1", "rS2", "rRM", "rAF")
    channels = {name: Channel(name, outputs[:, place], "mV/V") for place, name in enumerate(names)}
    still = GaugeZero(np.zeros(6), np.zeros(6), "known", np.zeros(6), model_on=False)
    loads = loads_of_outputs(Recording.from_columns(TIME, channels, name="run"), matrix, zero=still)
    clean, doubts = without_wild_samples(loads, loads.components)
    assert isinstance(clean, Loads)
    missing = np.isnan(clean.values)
    assert missing.all(axis=1).nonzero()[0].tolist() == [700]
    assert np.count_nonzero(missing) == missing.shape[1]
    assert "AF" in {doubt.component for doubt in doubts}
    assert {doubt.kind for doubt in doubts} == {"wild samples"}
    for place, name in enumerate(clean.components):  # loads and channels are one
        np.testing.assert_array_equal(clean.values[:, place], clean.recording.channel(name).values)
    untouched = loads.values[~missing]
    np.testing.assert_array_equal(clean.values[~missing], untouched)


def test_stuck_readings_are_missing_and_told(rng):
    values = ringing(rng)
    values[1500:1530] = values[1500]
    run = Recording.from_arrays(TIME, {"AF": values})
    clean, (doubt,) = without_wild_samples(run, ["AF"])
    assert np.flatnonzero(clean.channel("AF").missing).tolist() == list(range(1501, 1530))
    assert doubt.kind == "stuck channel"
    assert "29 samples of AF repeat the one before" in doubt.text


@pytest.mark.parametrize(
    ("times", "mass", "said"),
    [
        (1.0, 178.0, []),
        (1000.0, 178.0, ["times the largest load that its dynamics were identified with"]),
        (1.0, 178e3, ["the weight of 178000 kg along AF"]),
    ],
)
@pytest.mark.soak(first=1)
def test_a_wrong_unit_or_mass_is_asked_about(times, mass, said, rng, tmp_path):
    """A release of 500 N and a step of 200 N at 2.5 degrees; 1 N of noise, closed form of the ringing."""
    time = np.arange(4000) / 1600
    rate, decay, pitch = 2 * np.pi * 66.0, 2.0, np.radians(2.5)
    weight = 178.0 * STANDARD_GRAVITY * np.sin(pitch)
    ringing = np.where(time > 0.5, np.exp(-decay * (time - 0.5)) * np.cos(rate * (time - 0.5)), 1.0)

    def record(load: np.ndarray) -> Recording:
        noisy = load + rng.normal(0, 1, time.size)
        channels = {"AF": Channel("AF", noisy, "N"), "pitch": Channel("pitch", np.full(time.size, pitch), "rad")}
        return Recording.from_columns(time, channels, name="run")

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        found = ab.identify(record(weight + 500 * ringing), mass=mass, components=["AF"]).dynamics
        write_dynamics(tmp_path / "d.json", {"AF": found})
        known = ab.read(tmp_path / "d.json")
        force = ab.estimate_force(record(times * (weight + 200 * (1 - ringing))), known)
    texts = [doubt.text for doubt in force.doubts if doubt.kind == "units"]
    assert len(texts) == len(said)
    assert all(part in text for part, text in zip(said, texts, strict=True))
    assert not said or force.verdict == "doubtful"


def test_packets_that_are_lost_are_stuck(rng):
    """Four readings that repeat one, of a channel whose noise is 1e5 times what lies between its readings."""
    places, values = (900, 1500, 2600), ringing(rng)
    held = values.copy()
    for place in places:
        held[place + 1 : place + 5] = held[place]
    expected = [place + k for place in places for k in range(1, 5)]
    assert np.flatnonzero(stuck_samples(held)).tolist() == expected
    # as zeros, and a mean that the signal never leaves at once: the first of them is no reading either
    lost = values + 20 * np.ptp(np.diff(values))
    for place in places:
        lost[place : place + 5] = 0.0
    assert np.flatnonzero(stuck_samples(lost)).tolist() == [place + k for place in places for k in range(5)]


def test_readings_that_are_held_twice_are_stuck_where_there_are_several(rng):
    """Of finely resolved readings three in a row are equal once in 1e8 records: one may be chance, ten are not."""
    places, values = np.arange(100, 3700, 360), ringing(rng)
    held = values.copy()
    for later in (1, 2):
        held[places + later] = held[places]
    assert np.flatnonzero(stuck_samples(held)).tolist() == sorted([*(places + 1), *(places + 2)])
    once = values.copy()
    once[101:103] = once[100]
    assert not stuck_samples(once).any()


def test_packets_that_read_zero_are_lost_from_their_first_reading(rng):
    """Four zeros at three places, where the signal passes zero: none of them is a reading."""
    values = ringing(rng)
    near = np.flatnonzero(np.diff(np.sign(values[200:3500]))) + 200
    places = near[[10, near.size // 2, -10]]
    lost = values.copy()
    for place in places:
        lost[place : place + 4] = 0.0
    assert np.flatnonzero(stuck_samples(lost)).tolist() == [place + k for place in places for k in range(4)]


def test_readings_of_five_digits_repeat_where_they_are_large(rng):
    """A text with five digits has steps of 0.0001 N about 1 N, and of 0.1 N about 1000 N, where equal ones are chance.

    Of 20,000 readings of which one in thirty equals the next, now and then four in a row are equal.
    """
    drift = 1500 * np.sin(2 * np.pi * np.arange(20_000) / 20_000)
    values = np.array([float(f"{one:.5g}") for one in drift + rng.normal(0, 0.5, 20_000)])
    # above 1000 N, half of the time, 0.1 / (2 sqrt(pi) 0.5) of them
    assert np.count_nonzero(np.diff(values) == 0) > 300
    assert not stuck_samples(values).any()


def test_equal_readings_of_steps_and_of_what_is_worked_out_of_them_are_chance(rng):
    for step in (0.1, 0.5, 2.0, 4.0):
        values = np.round(rng.normal(0, 1.0, 20_000) / step) * step
        for one in (values, values * 1.234 + 7.7e3, values - 0.1 * values[0]):
            assert not stuck_samples(one).any()


def through_bridges(change, rng) -> Loads:
    """Loads of 20 s at 1 kHz by a bridge of each component, that of AF changed; a broad load of a third of range."""
    matrix = replace(random_balance(seed_from(rng)), natural_zero=None)
    smooth = [np.convolve(rng.normal(size=20_049), np.hanning(50), mode="valid") for _ in range(6)]
    native = np.column_stack(smooth)
    native /= native.std(axis=0) / (0.3 * matrix.load_scale)
    outputs = matrix.outputs(native) + rng.normal(0, 1e-4, native.shape)
    outputs[:, 5] = change(outputs[:, 5])
    names = ("rN1", "rN2", "rS1", "rS2", "rRM", "rAF")
    channels = {name: Channel(name, outputs[:, place], "mV/V") for place, name in enumerate(names)}
    still = GaugeZero(np.zeros(6), np.zeros(6), "known", np.zeros(6), model_on=False)
    run = Recording.from_columns(np.arange(len(outputs)) / 1000, channels, name="run")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return loads_of_outputs(run, matrix, zero=still)


def test_all_loads_are_missing_where_a_contact_was_lost(rng):
    """A bridge that now and then reads the end of its amplifier; each load needs its reading."""
    away = (np.arange(20_000) % 3100) < 50
    loads = through_bridges(lambda own: np.where(away, -2.9, own), rng)
    clean, doubts = without_wild_samples(loads, loads.components)
    lost = np.isnan(clean.values)
    assert (lost == lost[:, :1]).all()
    assert lost[away, 0].all()
    assert np.count_nonzero(lost[~away, 0]) <= 2 * 7 * len(loads.components)  # wild ones beside the seven
    assert {doubt.component for doubt in doubts if doubt.kind == "stuck channel"} == set(loads.components)
    assert all("rAF" in doubt.text and doubt.effect == 0 for doubt in doubts if doubt.kind == "stuck channel")
    assert not loads.doubts


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.soak(first=0)
def test_a_bridge_that_rests_on_a_limit_too_often_is_doubted(side, rng):
    """A limit at a third of the standard deviation lets no more than 63 % pass."""
    loads = through_bridges(lambda own: side * np.minimum(side * own, own.std() / 3), rng)
    clean, _ = without_wild_samples(loads, loads.components)
    assert np.isfinite(clean.values).mean() > 0.99
    told = [doubt for doubt in loads.doubts if doubt.kind == "clipping"]
    assert {doubt.component for doubt in told} == set(loads.components)
    assert all("rAF rest on one value" in doubt.text and doubt.effect is None for doubt in told)


@pytest.mark.parametrize("soft", [True, False])
def test_an_amplifier_that_limits_softly_is_named(soft, rng):
    """By tanh, from one standard deviation on, in steps of a converter of 20 bits: readings crowd before its limit."""

    def change(own):
        start = own.std()
        limited = start + 0.1 * start * np.tanh((own - start) / (0.1 * start))
        step = 2.0**-19 * 3
        return np.round(np.where(own > start, limited if soft else own, own) / step) * step

    told = {doubt.kind: doubt for doubt in through_bridges(change, rng).doubts}
    assert ("clipping" in told) == soft
    assert not soft or "rAF crowd before the value" in told["clipping"].text
