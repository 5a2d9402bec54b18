"""What no record can show: named with what it would do to the force, which is what it does."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.app.cli.program import main
from aerobalance.app.commands.uncertainty import force_text
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, si_unit
from aerobalance.recording.doubts import Verdict
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.simulation.six_balance import random_balance
from aerobalance.uncertainty.mean_loads import mean_loads
from faults.cases import Case, all_cases, dynamics
from faults.trials import recording_of, worked_out
from helpers.cable_cut import T128

CASES = {case.name: case for case in all_cases()}


def tried(case: Case, seed: int = 0) -> tuple[Force, float]:
    """The force of a case, and how far it is off [N rms]."""
    record = case.record(seed)
    force, said = worked_out(record, case.dynamics, case.settings)
    assert force is not None, said
    return force, float(np.sqrt(np.mean((force.only.values - record.force) ** 2)))


def effects(force: Force) -> dict[str, float]:
    return {one.kind: one.effect for one in force.assumed}


@pytest.mark.parametrize(
    ("name", "kind", "times"),
    [
        # the corner that is assumed is that of the case, 0.4 of 1600 Hz
        ("load behind a filter of 640 Hz, 0-100 Hz", "load filter", 1.0),
        # 0.05 of a motion across, which is 2.9 degrees
        ("accelerometer 3 deg across, 0-60 Hz", "cross-axis", np.degrees(0.05)),
        # 5 N of amplitude over the 2 N rms that are assumed
        ("hum of 5 N at 50 Hz that drifts by 0 Hz, 0-100 Hz", "hum", 5 / 2**0.5 / 2),
        # half a percent of the stiffness is a quarter of a percent of the frequency
        ("stiffness 0.5 %, broad, 2.5 s", "natural frequency", 0.5),
        ("damping 20 %, broad, 2.5 s", "damping ratio", 1.0),
        ("load behind a filter of 640 Hz, step", "load filter", 1.0),
        ("accelerometer 3 deg across, step", "cross-axis", np.degrees(0.05)),
    ],
)
@pytest.mark.soak(first=5)
def test_the_effect_is_what_the_fault_does(name, kind, times):
    force, error = tried(CASES[name])
    # to first order, of one realisation: within a third
    assert times * effects(force)[kind] == pytest.approx(error, rel=0.35)
    assert all(f"{one.effect:.2g} N rms" in one.text for one in force.assumed)


def test_a_load_below_the_natural_frequency_does_not_tell_it():
    """The ends of the record hold some force at the natural frequency, which once passed for knowledge of it."""
    force, error = tried(replace(CASES["bandwidth 100 Hz, stiffness +5 %, 0-60 Hz"], settings={}))
    # 5 % of stiffness is 2.5 % of the frequency, five times as much; to first order, of one realisation
    assert 5 * effects(force)["natural frequency"] == pytest.approx(error, rel=0.35)


@pytest.mark.parametrize("settings", [{"bandwidth": 100.0}, {"method": "paper"}])
def test_a_direct_inverse_assumes_as_much(settings):
    case = CASES["bandwidth 100 Hz, stiffness +5 %, 0-60 Hz"]
    force, _ = tried(replace(case, settings=settings))
    optimal, _ = tried(replace(case, settings={}))
    assert set(effects(force)) == {"load filter", "gain", "zero drift", "natural frequency", "damping ratio"}
    for kind, effect in effects(force).items():
        # of one record, its steps found or not
        assert effect == pytest.approx(effects(optimal)[kind], rel=0.1), kind


def test_a_gain_changes_the_force_by_as_much():
    case = CASES["0-100 Hz, 200 N"]
    record = case.record(0)
    force, _ = worked_out(record, case.dynamics, {})
    more, _ = worked_out(record.with_column("AF", 1.01 * record.columns["AF"]), case.dynamics, {})
    assert force is not None
    assert more is not None
    change = float(np.sqrt(np.mean((more.only.values - force.only.values) ** 2)))
    assert effects(force)["gain"] == pytest.approx(change, rel=0.05)


def test_a_zero_that_drifts_changes_the_force_by_as_much():
    """What is seen of 0.1 % of the largest reading that is added steadily."""
    case = CASES["0-100 Hz, 200 N"]
    record = case.record(0)
    load = record.columns["AF"]
    drift = 0.001 * np.max(np.abs(load)) * np.linspace(0, 1, load.size)
    force, _ = worked_out(record, case.dynamics, {})
    drifted, _ = worked_out(record.with_column("AF", load + drift), case.dynamics, {})
    assert force is not None
    assert drifted is not None
    change = float(np.sqrt(np.mean((drifted.only.values - force.only.values) ** 2)))
    # the inverse is linear, and next to 1 below the natural frequency; the readings are rounded
    assert effects(force)["zero drift"] == pytest.approx(change, rel=0.05)


@pytest.mark.parametrize("angle", [0.3, 0.02])
@pytest.mark.soak(first=1)
def test_zero_of_the_pitch_and_the_mass_change_the_force_by_as_much(angle):
    """0.1 degree and 1 % of the mass, on a balance whose model is swept in pitch about an angle."""
    own = replace(dynamics(), covariance=np.zeros((0, 0)))
    time = np.arange(4000) / 1600
    pitch = angle + 0.05 * np.sin(2 * np.pi * 0.5 * time)
    weight = own.mass * STANDARD_GRAVITY * np.sin(pitch)  # slow: the balance follows
    noise = np.random.default_rng(5).normal(0, 0.3, time.size)
    columns = {"AF": (weight + noise, "N"), "pitch": (pitch, "rad")}

    def force(run: ab.Recording, used: ab.Dynamics) -> Force:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            return ab.estimate_force(run, used)

    run = record_of(time, columns)
    found = force(run, own)
    turned = force(record_of(time, columns | {"pitch": (pitch + np.radians(0.1), "rad")}), own)
    heavier = force(run, replace(own, mass=1.01 * own.mass, stiffness=1.01 * own.stiffness))
    for kind, other in (("pitch zero", turned), ("mass", heavier)):
        change = float(np.sqrt(np.mean((other.only.values - found.only.values) ** 2)))
        assert effects(found)[kind] == pytest.approx(change, rel=0.05)
    # what is stated is in the uncertainty instead
    stated = replace(run.channel("pitch"), zero_uncertainty=0.001)
    told = force(
        replace(run, channels={**run.channels, "pitch": stated}), replace(own, covariance=np.diag([1.0, 0, 0, 0]))
    )
    assert not {"pitch zero", "mass"} & set(effects(told))


@pytest.mark.soak(first=0)
def test_gain_and_mass_of_coupled_components_change_the_forces_by_as_much(rng):
    """1 % of all gauge outputs, and of the mass, of a balance whose model is swept in pitch under a slow load."""
    balance = random_balance(rng)
    own = balance.dynamics
    time = np.arange(4000) / 1600
    pitch, roll = 0.3 + 0.05 * np.sin(2 * np.pi * 0.5 * time), np.zeros(time.size)
    weight = np.column_stack(
        [own.weight(name, pitch=pitch, roll=roll, gravity=STANDARD_GRAVITY) for name in COMPONENTS]
    )
    applied = 0.2 * balance.half_range * np.sin(2 * np.pi * 0.4 * time)[:, None]
    loads = weight + applied  # slow: the balance follows
    noise = 1e-4 * balance.matrix.output_scale * rng.normal(size=loads.shape)
    matrix = replace(balance.matrix, natural_zero=None)
    outputs = balance.outputs(loads) - balance.outputs(np.zeros((1, 6))) + noise
    nothing = ab.Zero((), model_on=False)

    def force(outputs: np.ndarray, used: CoupledDynamics, gain: float = 0.0) -> Force:
        channels = {
            f"r{name}": Channel(f"r{name}", one, "mV/V", relative_uncertainty=gain)
            for name, one in zip(matrix.gauges, outputs.T, strict=True)
        }
        run = ab.Recording.from_columns(time, {**channels, "pitch": Channel("pitch", pitch, "rad")}, name="run")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            return ab.estimate_force(run, used, balance=matrix, zero=nothing)

    found, mass = force(outputs, own), own.mass
    told = {(one.kind, one.component): one.effect for one in found.assumed}
    heavier = replace(own, mass=replace(mass, mass=1.01 * mass.mass, inertia=1.01 * mass.inertia))
    for kind, other in (("gain", force(1.01 * outputs, own)), ("mass", force(outputs, heavier))):
        changes = {name: np.sqrt(np.mean((other[name].values - found[name].values) ** 2)) for name in COMPONENTS}
        named = {name: effect for (one, name), effect in told.items() if one == kind}
        assert "AF" in named
        for name, effect in named.items():
            # interactions of second order are some percent of a load
            assert effect == pytest.approx(changes[name], rel=0.1), (kind, name)
    # what is stated is in the uncertainty instead
    covariance = np.zeros((10, 10))
    covariance[0, 0] = (0.01 * mass.mass) ** 2
    stated = force(outputs, replace(own, mass=replace(mass, covariance=covariance)), gain=0.01)
    assert not {"gain", "mass"} & {one.kind for one in stated.assumed}


@pytest.mark.soak(first=0)
def test_bridges_that_are_read_one_after_the_other_change_the_forces_by_as_much(rng):
    """Six components in a steady state of many sines, each read 10 us after the one before: the readings are exact."""
    balance = random_balance(rng)
    own, half_range = balance.dynamics, balance.half_range
    rate, count = 5000.0, 10_000
    time = np.arange(count) / rate
    lines = np.arange(20.0, 300.0, 1.0)
    size = 0.02 * half_range * np.exp(2j * np.pi * rng.random((lines.size, 6)))
    loads = np.einsum("mij,mj->mi", own.response(lines), size)
    noise = 1e-4 * half_range * rng.normal(size=(count, 6))

    def force(late: np.ndarray, *, delay: float = 0.0) -> Force:
        phase = np.exp(2j * np.pi * np.multiply.outer(time, lines))
        moved = loads * np.exp(-2j * np.pi * lines[:, None] * late)
        readings = (phase @ moved).real + noise
        channels = {
            name: Channel(name, one, si_unit(name), delay=delay)
            for name, one in zip(COMPONENTS, readings.T, strict=True)
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # the late ones are doubted now and then
            return ab.estimate_force(ab.Recording.from_columns(time, channels, name="run"), own)

    found, late = force(np.zeros(6)), force(1e-5 * np.arange(6))
    told = {one.component: one.effect for one in found.assumed if one.kind == "time of reading"}
    assert told
    for name, effect in told.items():
        error = np.sqrt(np.mean((late[name].values - found[name].values) ** 2))
        # to first order in the delay; and the late readings have a spectrum and steps of their own
        assert effect == pytest.approx(error, rel=0.1), name
    # nothing is assumed where it is stated
    assert "time of reading" not in {one.kind for one in force(np.zeros(6), delay=1e-6).assumed}


def record_of(time: np.ndarray, columns: dict[str, tuple[np.ndarray, str]]) -> ab.Recording:
    channels = {name: Channel(name, values, unit) for name, (values, unit) in columns.items()}
    return ab.Recording.from_columns(time, channels, name="run")


def test_what_is_declared_or_shown_is_not_assumed():
    case = CASES["0-100 Hz, 200 N, shaken"]
    run = recording_of(case.record(0))
    load = replace(run.channel("AF"), filter=AntiAlias("butterworth", 2, 700.0), relative_uncertainty=1e-3)
    declared = replace(run, channels={**run.channels, "AF": load})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # nothing of it is true
        kinds = set(effects(ab.estimate_force(declared, case.dynamics)))
    assert kinds <= {"cross-axis", "zero drift", "natural frequency", "damping ratio", "colored noise", "hum"}
    # ringing tells the frequency and the damping
    assert not {"natural frequency", "damping ratio"} & set(effects(tried(CASES["step alone"])[0]))
    # so does a covariance that says how far it is off
    vague = dynamics()
    vague = replace(vague, covariance=1e5 * vague.covariance)
    assert "natural frequency" not in effects(
        tried(replace(CASES["stiffness 0.5 %, broad, 2.5 s"], dynamics=vague))[0]
    )


def test_it_is_in_the_budget_without_a_share():
    force, _ = tried(CASES["0-100 Hz, 200 N"])
    rows = ab.budget(force)["AF"]
    assumed = [row for row in rows if row.assumed]
    assert [row.name for row in assumed] == [f"assumed: {one.kind}" for one in force.assumed]
    assert [row.rms for row in assumed] == [one.effect for one in force.assumed]
    assert sum(row.share for row in rows) == pytest.approx(1.0)
    assert not any(row.share for row in assumed)


def test_the_command_and_the_report_list_it_once(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    case = CASES["0-100 Hz, 200 N, shaken"]
    write_recording(tmp_path / "run.h5", recording_of(case.record(0), "run"))
    write_dynamics(tmp_path / "d.json", {"AF": case.dynamics})
    assert main(["force", "run.h5", "--dynamics", "d.json", "-o", "f.csv", "--json", "--report", "r.html"]) == 0
    found = json.loads(capsys.readouterr().out)["assumed"]
    assert {one["kind"] for one in found} >= {"load filter", "gain", "cross-axis"}
    assert all(set(one) == {"kind", "component", "text", "effect", "unit"} for one in found)
    page = Path("r.html").read_text(encoding="utf-8")
    assert page.count("No analog filter or amplifier is declared for AF") == 1
    assert main(["force", "run.h5", "--dynamics", "d.json", "-o", "g.csv"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("assumed: no analog filter or amplifier is declared for AF") == 1


def test_several_components_are_told_in_one_line():
    found = {
        "file": "run.h5",
        "components": {
            name: {"uncertainty_rms": u, "assumptions": [], "unit": "N", "steps": [], "improve_first": "", "u_mean": u}
            | dict.fromkeys(("mean", "rms_about_mean", "u_rms_about_mean", "largest", "u_largest"), 1.0)
            | {"least": 1.0, "u_least": u}
            for name, u in (("NF", 1.0), ("AF", 0.1))
        },
        "assumed": [
            {"kind": "gain", "component": "NF", "text": "of NF", "effect": 2.0, "unit": "N"},
            {"kind": "gain", "component": "AF", "text": "of AF", "effect": 1.0, "unit": "N"},
        ],
        "components_without_dynamics": [],
    }
    found["assumed"].append({"kind": "mass", "component": "NF", "text": "of mass", "effect": 0.9, "unit": "N"})
    lines = [line for line in force_text(found).split("\n") if line.startswith(("assumed", "not in u"))]
    assert lines == [
        "assumed: of AF (alike for NF)",  # ten times its uncertainty, and twice that of NF
        "assumed: of mass",
        "not in u, and larger than it, is what is assumed of: gain of AF, 10 times",
    ]
    found["assumed"] = found["assumed"][-1:]
    assert "not in u" not in force_text(found)


@pytest.mark.parametrize("first", [True, False])
def test_where_no_readings_are_up_to_an_end_the_force_is_as_uncertain_as_it_is_large(first: bool, rng) -> None:
    """400 N all along, of 4000 samples 1000 without readings at an end: 400 N, but for a period of 24 samples."""
    read = 400.0 + rng.normal(0, 2.0, 4000)

    def force(missing: slice) -> ab.Force:
        values = read.copy()
        values[missing] = np.nan
        channels = {"AF": Channel("AF", values, "N")}
        return ab.estimate_force(Recording.from_columns(np.arange(4000) / 1600.0, channels, name="run"), T128)

    with pytest.warns(DataQualityWarning, match="0.625 s is not known" if first else "from 1.875 s to 2.5 s"):
        found = force(slice(0, 1000) if first else slice(3000, 4000))
    (told,) = found.doubts
    assert (told.kind, found.verdict) == ("no readings", Verdict.DOUBTFUL)
    u = found.only.uncertainty[slice(0, 960) if first else slice(3040, 4000)]
    assert u == pytest.approx(400.0, rel=0.01)
    assert found.only.uncertainty[1100 if first else 2900] < 5.0
    # of the mean a quarter is not known
    assert mean_loads(found).errors.uncertainty()[0] == pytest.approx(100.0, rel=0.02)
    assert not force(slice(1000, 2000)).doubts  # readings follow, which show a step in it
