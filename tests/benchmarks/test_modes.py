"""A balance with a second mode: found in the decay and removed, or named where the dynamics lack it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.other_dynamics import other_dynamics_in
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor, Simulation
from helpers.accuracy import SHARP, SOFT, T128, inner, rms_of, smooth_run, wiener_bound

HALF_RANGE = 2000.0
ALLOWED = 0.02e-2 * HALF_RANGE
SHARES = (0.03, 0.08, -0.03, -0.08)
RUNS = 4


def balance(rng: np.random.Generator, share: float) -> Dynamics:
    return T128.with_modes(Mode(rng.uniform(120, 300), rng.uniform(0.004, 0.015), share))


def released(truth: Dynamics, rng: np.random.Generator, *, noise: float) -> Simulation:
    rig = CableCut(dynamics=truth, release=1 + rng.uniform(0, 1) / 1600, sensors={"AF": Sensor(noise=noise)})
    return rig.run(4.0, rng)


def identified(truth: Dynamics, rng: np.random.Generator, *, noise: float, modes: int | str = "auto") -> Dynamics:
    """Dynamics from a release of their own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        recording = released(truth, rng, noise=noise).recording
        return identify_decay(recording, mass=truth.mass, modes=modes).dynamics  # type: ignore[arg-type]


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_a_second_mode_is_found_and_removed(noise: float, record, rng) -> None:
    errors: list[Array] = []
    more = 0
    for share in SHARES:
        for _ in range(RUNS):
            truth = balance(rng, share)
            found = identified(truth, rng, noise=noise)
            assert found.further_modes, truth
            more += len(found.further_modes) > 1
            run = released(truth, rng, noise=noise)
            error = estimate_force(run.recording, found).only.values - run.applied
            errors.append(error[np.abs(run.recording.time - run.release) > 0.001])
    ratio = ALLOWED / rms_of(errors)
    record(f"0.02 % of half range over the error, second mode of 3-8 %, noise {noise:g} N", ratio, 1.0)
    assert ratio >= 1
    # what the noise makes up now and then has a share of less than a hundredth, and does no harm to the force
    record(f"share of releases without a mode that is not there, noise {noise:g} N", 1 - more / (4 * RUNS), 0.9)
    assert more <= 0.1 * 4 * RUNS


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_broadband_loads_through_two_modes_at_the_bound(noise: float, record, rng) -> None:
    bounds, errors = [], []
    for share in SHARES:
        truth = balance(rng, share)
        found = identified(truth, rng, noise=2.0)
        setup = {"dynamics": truth, "rate": 1600.0, "rms": 500.0, "noise": noise}
        run, force = smooth_run(rng, SHARP["0-300 Hz"], seconds=10.0, **setup)
        bound = wiener_bound(SHARP["0-300 Hz"], **setup)
        bounds.append(bound)
        errors.append(inner(estimate_force(run, found).only.values - force))
    ratio = float(np.sqrt(np.mean(np.square(bounds)))) / rms_of(errors)
    record(f"bound over error, 0-300 Hz through two modes, noise {noise:g} N", ratio, 0.9091)
    assert ratio >= 1 / 1.1


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_a_mode_left_out_is_named_after_a_release(noise: float, record, rng) -> None:
    worst, named = 0.0, 0
    for share in SHARES:
        for _ in range(RUNS):
            truth = balance(rng, share)
            found = identified(truth, rng, noise=noise, modes=1)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DataQualityWarning)
                run = released(truth, rng, noise=noise)
                force = estimate_force(run.recording, found)
            away = np.abs(run.recording.time - run.release) > 0.001
            error, u = (rms_of([values[away]]) for values in (force.only.values - run.applied, force.only.uncertainty))
            assert force.doubts or error < 3 * u, truth
            told = [doubt.text for doubt in force.doubts if doubt.kind == "missing mode"]
            if told:
                named += 1
                frequency = float(told[0].split(" mode at ")[1].split(" Hz")[0])
                worst = max(worst, abs(frequency / truth.further_modes[0].natural_frequency - 1))
    # a mode at twice the natural frequency looks like a spring that is not linear, and of 3 % below 10 N of noise it
    # may be no more than readings that are not explained
    record(f"share of missing modes that are named after a release, noise {noise:g} N", named / (4 * RUNS), 0.6)
    assert named >= 0.6 * 4 * RUNS
    record(f"1 % over the worst error of the frequency named, release, noise {noise:g} N", 0.01 / worst, 1.0)
    assert worst < 0.01


def test_a_mode_left_out_is_named_under_a_broadband_load(record, rng) -> None:
    worst, named = 0.0, 0
    for share in (0.05, 0.08, -0.05, -0.08):
        for _ in range(RUNS):
            truth = T128.with_modes(Mode(rng.uniform(140, 280), 0.008, share))
            run, _ = smooth_run(rng, SHARP["0-300 Hz"], dynamics=truth, rate=1600.0, rms=60.0, noise=2.0, seconds=10.0)
            shown = other_dynamics_in(force_record(run, T128).component_record("AF"), noise=2.0)
            if shown.missing is not None:
                named += 1
                error = shown.missing.natural_frequency / truth.further_modes[0].natural_frequency - 1
                worst = max(worst, abs(error))
    record("share of missing modes that are named, broadband load", named / (4 * RUNS), 1.0)
    record("1 % over the worst error of the frequency named, broadband load", 0.01 / worst, 1.0)
    assert named == 4 * RUNS
    assert worst < 0.01


def test_smooth_loads_and_releases_raise_no_doubt(record, rng) -> None:
    false = 0
    for shape in (SHARP | SOFT).values():
        for noise in (0.5, 2.0, 10.0):
            for _ in range(5):
                run, _ = smooth_run(rng, shape, dynamics=T128, rate=1600.0, rms=60.0, noise=noise, seconds=8.0)
                false += bool(
                    other_dynamics_in(force_record(run, T128).component_record("AF"), noise=noise).doubts(T128)
                )
    for _ in range(10):
        found = identified(T128, rng, noise=2.0)
        again = force_record(released(T128, rng, noise=2.0).recording, found)
        false += bool(other_dynamics_in(again.component_record("AF"), noise=2.0).doubts(found))
    record("records without a false doubt about the dynamics, of 100", (100 - false) / 100, 1.0)
    assert false == 0


def test_a_held_tone_is_no_mode(rng) -> None:
    time = np.arange(12_800) / 1600
    load = 500 * np.abs(T128.response(140.0)) * np.sin(2 * np.pi * 140 * time) + rng.normal(0, 2.0, time.size)
    run = Recording.from_columns(time, {"AF": Channel("AF", load, "N")}, name="tone")
    assert other_dynamics_in(force_record(run, T128).component_record("AF"), noise=2.0).missing is None
