"""Records that are hard to read take a bounded time: over that of a record of the same length that is easy.

All in processor time of one run, warm.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.model_check import checked
from aerobalance.estimation.force import Force, estimate_force
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from faults.cases import all_cases
from faults.trials import recording_of
from helpers.accuracy import RIG, SOFT, T128, rms_of, smooth_run
from helpers.yardstick import spent

RATE, SECONDS = 1600.0, 3.5


def recorded(load: Array, *, rate: float = RATE) -> Recording:
    return Recording.from_columns(np.arange(load.size) / rate, {"AF": Channel("AF", load, "N")}, name="record")


def stepped(
    changes: list[tuple[float, float, float]],
    rng: np.random.Generator,
    *,
    dynamics: Dynamics = T128,
    rate: float = RATE,
    seconds: float = SECONDS,
    noise: float = 2.0,
) -> Recording:
    """Record under changes of the force: instant [s], height [N] and duration [s] each."""
    t = np.arange(round(rate * seconds)) / rate
    felt = [height * dynamics.step_response(t - instant, duration=late) for instant, height, late in changes]
    return recorded(np.sum(felt, axis=0) + rng.normal(0, noise, t.size), rate=rate)


def smooth(rng: np.random.Generator, *, seconds: float = SECONDS, noise: float = 2.0) -> Recording:
    shape = SOFT["4th-order roll-off, 60 Hz"]
    return smooth_run(rng, shape, dynamics=T128, rate=RATE, rms=300.0, noise=noise, seconds=seconds)[0]


def of_force(run: Recording, dynamics: Dynamics = T128) -> float:
    return spent(lambda: estimate_force(run, dynamics), runs=2)


@cache
def of_a_smooth_record(seconds: float = SECONDS) -> float:
    return of_force(smooth(np.random.default_rng(0), seconds=seconds))


@cache
def of_a_step(seconds: float = SECONDS) -> float:
    return of_force(stepped([(1.0001, 700.0, 0.0)], np.random.default_rng(0), seconds=seconds))


FIVE = [(0.5001, 300.0, 0.0), (1.0002, -500.0, 0.002), (1.5, 20.0, 0.0), (2.2003, 800.0, 0.004), (2.8, -300.0, 0.0)]
TWENTY = [(0.3 + 0.5001 * k, 250.0 * (1 + k % 3) * (-1) ** k, 0.002 * (k % 3)) for k in range(20)]


def with_gaps(run: Recording) -> Recording:
    values = run.channel("AF").values.copy()
    values[1900:2300] = values[4000:4300] = np.nan
    return recorded(values)


def clipped(run: Recording) -> Recording:
    return recorded(np.clip(run.channel("AF").values, -100, 900))


@pytest.mark.parametrize(
    ("name", "made", "allowed"),
    [
        ("noise-free", lambda rng: smooth(rng, noise=0.0), 3),
        ("all zero", lambda rng: recorded(np.zeros(5600)), 3),
        ("constant", lambda rng: recorded(np.full(5600, 7.0)), 3),
        ("with a gap of half a second", lambda rng: with_gaps(smooth(rng)), 10),
        ("of undamped ringing", lambda rng: recorded(300 * np.sin(416 * np.arange(5600) / RATE)), 40),
        ("of two slow ramps", lambda rng: stepped([(0.7, 500.0, 0.3), (2.0, -300.0, 0.5)], rng), 60),
    ],
)
def test_records_without_steps(name, made, allowed, record, rng) -> None:
    ratio = of_force(made(rng)) / of_a_smooth_record()
    record(f"{allowed} over time of a record {name}, over that of a smooth one", allowed / ratio, 1.0)
    assert ratio < 3 * allowed


@pytest.mark.parametrize(
    ("name", "made", "allowed"),
    [
        ("noise-free", lambda rng: stepped([(1.0001, 700.0, 0.0)], rng, noise=0.0), 3),
        ("clipped at its peaks", lambda rng: clipped(stepped([(1.0001, 700.0, 0.0)], rng)), 15),
        ("and a slow ramp", lambda rng: stepped([(1.0001, 700.0, 0.0), (2.0, 300.0, 0.5)], rng), 10),
    ],
)
def test_records_of_a_step(name, made, allowed, record, rng) -> None:
    ratio = of_force(made(rng)) / of_a_step()
    record(f"{allowed} over time of a step, {name}, over that of one alone", allowed / ratio, 1.0)
    assert ratio < 3 * allowed


@pytest.mark.parametrize("stiffness", [1.002, 1.01, 1.034, 1.1])
def test_a_release_of_another_balance(stiffness: float, record, rng) -> None:
    run = stepped([(1.0001, -1020.0, 0.0)], rng)
    ratio = of_force(run, replace(T128, stiffness=stiffness * T128.stiffness)) / of_a_step()
    record(f"15 over time of a step, stiffness {stiffness:g} of the true one, over that of one alone", 15 / ratio, 1.0)
    assert ratio < 45


@pytest.mark.parametrize(("share", "allowed"), [(1 / 1000, 3), (1 / 100, 10)])
def test_single_missing_readings(share: float, allowed: float, record, rng) -> None:
    """Of 6 s at 12.8 kHz: on its own clock each took 15 ms, a hundredth of them twenty times the force of the rest."""
    rate, seconds = 12_800.0, 6.0
    run = smooth_run(
        rng, SOFT["4th-order roll-off, 60 Hz"], dynamics=T128, rate=rate, rms=300.0, noise=2.0, seconds=seconds
    )[0]
    values = run.channel("AF").values.copy()
    values[rng.choice(values.size, round(share * values.size), replace=False)] = np.nan
    ratio = of_force(recorded(values, rate=rate)) / of_force(run)
    record(
        f"{allowed} over time of a record that lacks 1 reading in {round(1 / share)}, over it", allowed / ratio, 1.0
    )
    assert ratio < 3 * allowed


@pytest.mark.parametrize("name", ["five", "five beside gaps", "twenty", "59 of a square wave"])
def test_each_further_step_takes_what_the_first_takes(name: str, record, rng) -> None:
    seconds = {"twenty": 12.0, "59 of a square wave": 6.0}.get(name, SECONDS)
    edges = [(0.1 * k + rng.uniform(0, 1) / RATE, 700.0 * (-1) ** k, 0.0) for k in range(1, 60)]
    changes = {"twenty": TWENTY, "59 of a square wave": edges}.get(name, FIVE)
    run = stepped(changes, rng, seconds=seconds)
    ratio = of_force(with_gaps(run) if "gaps" in name else run) / of_a_step(seconds) / len(changes)
    allowed = 5 if "gaps" in name else 2
    record(f"{allowed} over time of a step among {name}, over that of one alone", allowed / ratio, 1.0)
    assert ratio < 3 * allowed


def test_a_minute_of_a_square_wave(record, rng) -> None:
    """Too many edges for a record of this length: it ends soon, and is no worse than inverses tuned with the truth."""
    edges = [(0.1 * k + rng.uniform(0, 1) / RATE, 700.0 * (-1) ** k, 0.0) for k in range(1, 600)]
    run = stepped(edges, rng, seconds=60.0)
    ratio = of_force(run) / of_a_smooth_record(60.0)
    record("10 over time of a minute of a square wave, over that of a smooth load", 10 / ratio, 1.0)
    assert ratio < 30
    force = np.zeros(run.samples)
    for instant, height, _ in edges:
        force += height * (run.time >= instant)
    inside = slice(1600, -1600)
    with pytest.warns(DataQualityWarning, match="too many for a record of this length"):
        error = rms_of([(estimate_force(run, T128).only.values - force)[inside]])
    with warnings.catch_warnings():
        # a spectrum of lines looks like another resonance, or none, where no steps are looked for
        warnings.filterwarnings("ignore", ".* (another natural frequency|does not ring)", DataQualityWarning)
        inverses = [estimate_force(run, T128, bandwidth=b).only.values for b in (200.0, 250.0, 300.0, 350.0, 400.0)]
    best = min(rms_of([(values - force)[inside]]) for values in inverses)
    record("error of the best band-limited inverse over this one's, a minute of a square wave", best / error, 1.0)
    assert error < best


def test_looking_at_a_record_that_is_no_release(record, rng) -> None:
    """What contradicts the dynamics is looked for in a time like that of the force itself."""
    heights = 40 * np.array([0.2, 0.4, -0.7, 2.0, -0.6, -0.8, 1.1, 0.5])
    eight = [(0.05 + 0.09 * k, height, 0.0) for k, height in enumerate(heights.tolist())]
    cases: dict[str, tuple[Recording, Dynamics]] = {
        "eight steps at 25 kHz": (stepped(eight, rng, dynamics=RIG, rate=25e3, seconds=0.8, noise=0.3), RIG),
        "twenty steps": (stepped(TWENTY, rng, seconds=12.0), T128),
        "ramps and turbulence": (
            recorded(
                smooth(rng, seconds=SECONDS).channel("AF").values
                + stepped([(0.7, 500.0, 0.3), (2.2, 200.0, 0.001)], rng).channel("AF").values
            ),
            T128,
        ),
    }
    for name, (run, dynamics) in cases.items():
        force: list[Force] = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            begin = time.process_time()
            force.append(estimate_force(run, dynamics))
            whole = time.process_time() - begin
        ratio = spent(lambda force=force: checked(force[0]), runs=2) / whole
        record(f"1 over time of holding it against its model over that of the force, {name}", 1 / ratio, 1.0)
        assert ratio < 3


def test_share_of_the_checks(record, monkeypatch, seed) -> None:
    """What holds sound records against their dynamics takes a quarter of the whole, over all kinds of them."""
    spent_on: dict[str, float] = {}

    def timed(force: Force) -> Force:
        begin = time.process_time()
        found = checked(force)
        spent_on["checks"] = spent_on.get("checks", 0.0) + time.process_time() - begin
        return found

    monkeypatch.setattr("aerobalance.estimation.force.checked", timed)
    for name, chosen in {"one component": False, "six components": True}.items():
        spent_on.clear()
        for case in all_cases():
            if case.group == "sound" and case.name.startswith("six") is chosen:
                run, known = recording_of(case.record(seed)), case.known(seed)  # which is identified, the first time
                begin = time.process_time()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", DataQualityWarning)
                    estimate_force(run, known, **case.settings)
                spent_on["all"] = spent_on.get("all", 0.0) + time.process_time() - begin
        share = spent_on["checks"] / spent_on["all"]
        record(
            f"a quarter over the share of the checks in the time of a force, all kinds of sound records, {name}",
            0.25 / share,
            1.0,
        )
        assert share < 0.5
