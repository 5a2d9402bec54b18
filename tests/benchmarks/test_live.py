"""The live force against the attainable bound of whole records, through a cable cut, and against the clock.

The process of the force is learned on the first part of a record and used live on the rest of it.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.decoupled_record import balance_load
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.simulation import CableCut, Sensor
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_signals import Band, broadband
from helpers.accuracy import RIG, RUNS, SHARP, SOFT, T128, WIDE, drawn, inner, rms_of, smooth_run, wiener_bound

ALL = LiveSettings(samples_a_period=np.inf)
"""Without decimation."""

LEARNING = {1600.0: 20.0, 25_000.0: 4.0}
"""Seconds that the process is learned from, by sampling rate."""


def learned_first(readings: Array, dynamics: Dynamics, *, rate: float) -> tuple[SpectralPrior, Array, int]:
    """The process from the first part of a record, the readings of the rest, and where it begins."""
    begin = round(LEARNING[rate] * rate)
    process = fit_prior(Observation(readings[:begin], 1 / rate, dynamics), columns=np.ones((begin, 1)))
    return process, readings[begin:], begin


def pushed(live: LiveForce, readings: Array, *, chunk: int = 53) -> tuple[Array, Array]:
    """Force and uncertainty; the last lag of samples, which has less than its lag of readings, is left out."""
    parts = [live.push(readings[k : k + chunk])["AF"] for k in range(0, readings.size, chunk)]
    return np.concatenate([p.force for p in parts]), np.concatenate([p.uncertainty for p in parts])


@pytest.mark.parametrize("noise", [0.5, 2.0, 10.0])
@pytest.mark.parametrize("name", [*SHARP, *SOFT])
def test_live_at_the_bound(name: str, noise: float, record, rng) -> None:
    shape = (SHARP | SOFT)[name]
    setup = {"dynamics": T128, "rate": 1600.0, "rms": 500.0, "noise": noise}
    errors = []
    # the lag alone costs 1.10 in one case (docs/live.md), so that more runs are needed to tell 1.12 from 1.15
    for _ in range(4 * RUNS if (name, noise) == ("0-120 Hz", 0.5) else RUNS):
        run, force = smooth_run(rng, shape, seconds=10.0 + LEARNING[1600.0], **setup)
        process, readings, begin = learned_first(run.channel("AF").values, T128, rate=1600.0)
        live = LiveForce(T128, rate=1600, learned={"AF": process})
        values, _ = pushed(live, readings)
        assert abs(live.lag * T128.natural_frequency - 5) < 0.5 / 1600 * T128.natural_frequency
        assert not live.steps["AF"]
        errors.append(inner(values - force[begin : begin + values.size]))
    ratio = wiener_bound(shape, **setup) / rms_of(errors)
    record(f"bound over live error, T-128, {name}, noise {noise:g} N", ratio, round(1 / 1.15, 4))
    assert ratio >= 1 / 1.15


@pytest.mark.parametrize("noise", [0.05, 0.5, 2.0])
def test_live_rig_at_the_bound(noise: float, record, rng) -> None:
    setup = {"dynamics": RIG, "rate": 25_000.0, "rms": 100.0, "noise": noise}
    errors = []
    for _ in range(RUNS // 2):
        run, force = smooth_run(rng, WIDE["0-900 Hz"], seconds=2.0 + LEARNING[25_000.0], **setup)
        process, readings, begin = learned_first(run.channel("AF").values, RIG, rate=25_000.0)
        values, _ = pushed(LiveForce(RIG, rate=25_000, learned={"AF": process}, settings=ALL), readings, chunk=833)
        errors.append(inner(values - force[begin : begin + values.size]))
    ratio = wiener_bound(WIDE["0-900 Hz"], **setup) / rms_of(errors)
    record(f"bound over live error, rig at 25 kHz, 0-900 Hz, noise {noise:g} N", ratio, round(1 / 1.15, 4))
    assert ratio >= 1 / 1.15


@pytest.mark.parametrize("kind", ["sharp", "soft"])
def test_live_intervals_cover(kind: str, record, rng) -> None:
    covered = []
    for shape in (SHARP if kind == "sharp" else SOFT).values():
        for noise in (0.5, 2.0, 10.0):
            for _ in range(6):
                seconds = 5.0 + LEARNING[1600.0]
                run, force = smooth_run(
                    rng, shape, dynamics=T128, rate=1600.0, rms=500.0, noise=noise, seconds=seconds
                )
                dynamics = drawn(rng, noise=noise)
                process, readings, begin = learned_first(run.channel("AF").values, dynamics, rate=1600.0)
                values, uncertainty = pushed(LiveForce(dynamics, rate=1600, learned={"AF": process}), readings)
                error = values - force[begin : begin + values.size]
                covered.append(np.mean(np.abs(inner(error)) < 1.96 * inner(uncertainty)))
    average = float(np.mean(covered))
    record(f"least of live cover over 93 % and 97 % over it, {kind} spectra", min(average / 0.93, 0.97 / average), 1.0)
    assert 0.93 <= average <= 0.97


@pytest.mark.parametrize(("noise", "allowed"), [(2.0, 0.3), (10.0, 1.5)])
def test_live_plateaus_of_a_cable_cut(noise: float, allowed: float, record, rng) -> None:
    """Allowed is what 121 readings after the cut tell of it, its instant and level free too: 0.15 of the noise."""
    errors, instants = [], []
    for _ in range(RUNS):
        rig = CableCut(release=3 + rng.uniform(0, 1) / 1600, sensors={"AF": Sensor(noise=noise)})
        run = rig.run(6.0, rng)
        live = LiveForce(T128, rate=1600)  # learns by itself after 2 s
        values, _ = pushed(live, run.recording.channel("AF").values)
        (step,) = live.steps["AF"]
        time_ = run.recording.time[: values.size]
        plateau = (time_ > 2.5) & (np.abs(time_ - run.release) > 0.001)
        errors.append((values - run.applied[: values.size])[plateau])
        instants.append((step.instant - run.release) * 1600)
    ratio = allowed / rms_of(errors)
    record(f"{allowed} N over the plateaus' error live, cable cut, noise {noise:g} N", ratio, 1.0)
    record(f"0.1 sample over the instant's error live, noise {noise:g} N", 0.1 / float(np.std(instants)), 1.0)
    assert ratio >= 1
    assert np.max(np.abs(instants)) < 0.1


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_live_step_under_a_broadband_load(noise: float, record, rng) -> None:
    setup = {"dynamics": T128, "rate": 1600.0, "rms": 60.0, "noise": noise}
    errors = []
    for _ in range(RUNS):
        run, force = smooth_run(rng, SHARP["0-120 Hz"], seconds=LEARNING[1600.0] + 5.0, **setup)
        instant = LEARNING[1600.0] + 2 + rng.uniform(0, 1) / 1600
        load = run.channel("AF").values + 1020 * T128.step_response(run.time - instant)
        process, readings, begin = learned_first(load, T128, rate=1600.0)
        live = LiveForce(T128, rate=1600, learned={"AF": process})
        values, _ = pushed(live, readings)
        (step,) = live.steps["AF"]
        assert isinstance(step, Step)
        here = slice(begin, begin + values.size)
        error = values - force[here] - 1020 * (run.time[here] >= instant)
        errors.append(inner(error[np.abs(run.time[here] - instant) > 0.001]))
    ratio = wiener_bound(SHARP["0-120 Hz"], **setup) / rms_of(errors)
    record(f"bound over live error, step under 60 N rms of 0-120 Hz, noise {noise:g} N", ratio, round(1 / 1.15, 4))
    assert ratio >= 1 / 1.15


def test_no_false_step_live(record, rng) -> None:
    """One a day is allowed: in 24 smooth records of 40 s chance brings 0.011, and two with a probability of 6e-5."""
    found = 0
    for name in (*SHARP, *SOFT):
        shape = (SHARP | SOFT)[name]
        for _ in range(4):
            run, _ = smooth_run(rng, shape, dynamics=T128, rate=1600.0, rms=500.0, noise=2.0, seconds=60.0)
            process, readings, _ = learned_first(run.channel("AF").values, T128, rate=1600.0)
            live = LiveForce(T128, rate=1600, learned={"AF": process})
            pushed(live, readings)
            found += len(live.steps["AF"])
    record("2 over 1 and the false steps in 16 minutes of smooth loads", 2 / (found + 1), 1.0)
    assert found <= 1


@pytest.mark.alone
def test_six_components_at_25_khz_on_one_core(record, rng) -> None:
    run, _ = smooth_run(rng, WIDE["0-900 Hz"], dynamics=RIG, rate=25_000.0, rms=100.0, noise=0.05, seconds=8.0)
    process, readings, _ = learned_first(run.channel("AF").values, RIG, rate=25_000.0)
    live = LiveForce(RIG, rate=25_000, learned={"AF": process}, settings=ALL)
    pushed(live, readings[:5000], chunk=833)  # compiles the kernels
    live = LiveForce(RIG, rate=25_000, learned={"AF": process}, settings=ALL)
    spent = []
    for part in np.array_split(readings, 120):  # pushes of 33 ms
        begin = time.process_time()
        live.push(part)
        spent.append(time.process_time() - begin)
    cores = 6 * sum(spent) / (readings.size / 25_000)
    settled = 6 * sum(spent[60:]) / (readings.size / 50_000)
    states = process.shaping.order + 2
    record(f"2 cores over six components at 25 kHz, {states} states, first 4 s", 2 / cores, 1.0)
    record(f"1 core over six components at 25 kHz, {states} states, settled", 1 / settled, 1.0)
    assert settled < 1
    assert cores < 2


@pytest.mark.alone
@pytest.mark.parametrize("rate", [12_500.0, 25_000.0])
def test_six_coupled_components_on_one_core(rate: float, record, rng) -> None:
    """A balance with modes up to 600 Hz; the page thins 25 kHz to 12.5 kHz for it."""
    balance = random_balance(rng)
    force = broadband(rng, Band(0, 300), rms=0.05 * balance.half_range, period=8.0)
    deviation = balance.noise * balance.half_range
    time_ = np.arange(round(8 * rate)) / rate
    exact = balance_load(balance.dynamics, force(time_), interval=1 / rate)
    readings = exact + deviation * rng.standard_normal(exact.shape)
    settings = LiveSettings(learn_inside=False, samples_a_period=np.inf)
    live = LiveForce(balance.dynamics, rate=rate, settings=settings)
    spent = []
    for number, part in enumerate(np.array_split(readings, 240)):  # pushes of 33 ms
        if number == 60:
            for name in live.components:
                live.adopt(live.snapshot(name).learn())
        begin = time.process_time()
        live.push(part)
        spent.append(time.process_time() - begin)
    cores = sum(spent[1:60]) / (59 / 30)
    settled = sum(spent[180:]) / (60 / 30)  # a spectrum with sharp edges takes some seconds until the gain is steady
    print(f"{cores:.2f} cores before learning, {settled:.2f} settled, six coupled components at {rate:g} Hz")  # noqa: T201
    target = rate / 25_000
    record(f"1.3 cores over six coupled components at {rate:g} Hz before learning", 1.3 / cores, 1.0)
    record(f"{target:g} cores over six coupled components at {rate:g} Hz, settled", target / settled, 1.0)
    assert settled < target
    assert cores < 1.3
