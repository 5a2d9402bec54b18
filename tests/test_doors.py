"""Inputs that cannot be what they are said to be: refused with the reason, or doubted by name."""

from __future__ import annotations

import datetime
import json
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import aerobalance as ab
from aerobalance.app.cli.program import main
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.estimation.checks.impossible_channels import impossible_channels
from aerobalance.estimation.force import estimate_force
from aerobalance.io import load_channel_map
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Channel
from aerobalance.recording.doubts import KINDS, Doubt, Verdict
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError
from aerobalance.recording.recording import Recording
from faults.cases import all_cases, dynamics
from faults.scene import FREQUENCY, Record
from faults.trials import recording_of as frames
from faults.trials import worked_out
from helpers.cable_cut import T128
from helpers.coupled_pair import NOISE as PAIR_NOISE
from helpers.coupled_pair import pair, recording_of, shaken
from seeds import trials

CASES = {case.name: case for case in all_cases()}
RATE = 1600.0


def made(name: str, seed: int = 0) -> Record:
    return CASES[name].record(seed)


@pytest.mark.parametrize("over", [0.97, 1.03])
def test_a_record_shorter_than_a_period_is_refused(over):
    whole = made("soft 30 Hz, 100 N")
    # 4000 samples in so many periods
    record = replace(whole, rate=4000 * FREQUENCY / over)
    force, said = worked_out(record, dynamics(), {})
    if over > 1:
        assert force is not None
        return
    assert force is None
    rate = 4000 * FREQUENCY / over
    assert said[0].startswith(f"record: the record takes 0.0146 s ({rate:.6g} samples a second), less than one period")
    assert said[0].endswith("of AF, 0.0151 s (66.37 Hz): check the unit of the time and the dynamics")


def test_of_coupled_components_the_slowest_mode_counts(rng):
    coupled = pair()
    slowest = min(mode.natural_frequency for mode in coupled.modes)
    values = rng.normal(size=(200, 2))
    run = recording_of(values)
    fast = replace(run, rate=1.1 * 200 * slowest)
    with pytest.raises(FitError, match="less than one period of the slowest mode"):
        estimate_force(fast, coupled)


@pytest.mark.parametrize("lost", [0, 7])
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us")])
def test_times_in_another_unit_than_they_say_are_refused(factor, unit, lost):
    run = made("soft 30 Hz, 100 N")
    load = run.columns["AF"].copy()
    load[500 : 500 + lost] = np.nan
    force, said = worked_out(replace(run.with_column("AF", load), rate=RATE / factor), dynamics(), {})
    assert force is None
    assert said[0].startswith(
        f"record: AF rings at {FREQUENCY / factor:.4g} Hz by a clock of {RATE / factor:.6g} samples"
    )
    assert f"a natural frequency of the dynamics, {FREQUENCY:.4g} Hz, and this is above half the rate" in said[0]
    assert f'time_unit = "{unit}"' in said[0]
    assert worked_out(made("soft 30 Hz, 100 N"), dynamics(), {})[0] is not None


def test_of_coupled_components_one_mode_that_rings_tells_the_unit_of_the_times(rng):
    # of thirty periods, in which the largest ordinate may be the second or third from the natural frequency
    for _ in range(trials(5, 20)):
        _, loads, pitch = shaken(rng, pair())
        run = recording_of(loads + PAIR_NOISE * rng.normal(size=loads.shape), pitch=pitch)
        slow = replace(run, rate=run.rate / 1000)
        with pytest.raises(FitError, match=r'That is 1/1000 of a natural frequency .* put time_unit = "ms"'):
            estimate_force(slow, pair())


@pytest.mark.parametrize("period", [None, 45.0])
def test_a_slow_record_of_steady_loads_is_no_wrong_unit(rng, period):
    # twice a second FREQUENCY / 1000 could be seen and nothing rings there; steps every 45 s have a harmonic near
    time = np.arange(1000) / 2.0
    load = 300.0 + rng.normal(0, 0.2, time.size)
    load += 50.0 * (np.sin(2e-3 * np.pi * time) if period is None else np.sign(np.sin(2 * np.pi * time / period)))
    if period is not None:
        assert 3 / period == pytest.approx(FREQUENCY / 1000, rel=0.02)
    run = Recording.from_columns(time, {"AF": Channel("AF", load, "N")})
    found = ab.estimate_force(run, dynamics()).only.values
    # far below the natural frequency the force is the balance load
    assert np.mean(found) == pytest.approx(np.mean(load), abs=0.1)


def test_a_part_of_a_long_record_may_be_shorter_than_a_period(rng):
    known = dynamics(frequency=0.05)
    whole = Recording.from_columns(np.arange(60_000) / RATE, {"AF": Channel("AF", rng.normal(size=60_000), "N")})
    # 37 s of 20 s a period; a part of 10 s
    assert ab.estimate_force(whole.part(0, 16_000), known).only.values.size == 16_000


STAMPS = np.datetime64("2026-11-23T10:00:00.123456") + (np.arange(400) * 625).astype("timedelta64[us]")


@pytest.mark.parametrize(
    "stamps",
    [
        STAMPS,
        STAMPS.astype("datetime64[ns]"),
        STAMPS - STAMPS[0],
        [datetime.datetime(2026, 11, 23) + datetime.timedelta(microseconds=625 * i) for i in range(400)],
        pd.to_datetime(STAMPS).tz_localize("Europe/Berlin").to_numpy(),
    ],
    ids=["us", "ns", "differences", "Python", "with a zone"],
)
def test_dates_and_times_become_seconds_since_the_first(stamps):
    recording = Recording.from_arrays(stamps, {"AF": np.arange(400.0)})
    # microseconds are exact in doubles to 1e-16 of half a second
    assert recording.rate == pytest.approx(RATE, rel=1e-12)
    assert recording.start == pytest.approx(0.0, abs=1e-15)
    again = Recording.from_columns(stamps, dict(recording.channels))
    assert again.rate == recording.rate


def test_a_data_frame_with_dates_has_a_clock():
    frame = pd.DataFrame({"AF": np.arange(400.0)}, index=pd.DatetimeIndex(STAMPS))
    assert Recording.from_dataframe(frame).rate == pytest.approx(RATE, rel=1e-12)


def test_stamps_that_are_no_times_are_refused():
    missing = STAMPS.copy()
    missing[7] = np.datetime64("NaT")
    with pytest.raises(ValueError, match=r"time stamp 8 of 400 is missing \(NaT\)"):
        Recording.from_arrays(missing, {"AF": np.arange(400.0)})
    with pytest.raises(ValueError, match="must be seconds, or dates and times"):
        Recording.from_arrays(np.array(["one", "two"]), {"AF": np.arange(2.0)})
    mixed = [datetime.datetime(2026, 1, 1), datetime.datetime(2026, 1, 2, tzinfo=datetime.UTC)]
    with pytest.raises(ValueError, match="not all with a time zone"):
        Recording.from_arrays(np.array(mixed, dtype=object), {"AF": np.arange(2.0)})


def test_a_channel_under_another_name_is_refused():
    channel = Channel("NF", np.arange(100.0), "N")
    with pytest.raises(ValueError, match="channel AF is called NF"):
        Recording.from_columns(np.arange(100) / 10, {"AF": channel})


def test_an_angle_beyond_a_quarter_turn_is_told():
    record = made("step, pitching")
    degrees = np.degrees(record.columns["pitch"]) + 2.0
    force, said = worked_out(record.with_column("pitch", degrees), dynamics(), {})
    assert force is not None
    assert force.doubts[0].kind == "attitude range"
    assert any(f"pitch is up to {np.degrees(np.max(np.abs(degrees))):.4g} deg" in text for text in said)
    assert force.verdict is not Verdict.FIT


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, 0.3])
def test_angles_that_can_be_are_not_told(pitch):
    given = Recording.from_arrays(np.arange(64) / RATE, {"AF": np.arange(64.0), "pitch": np.full(64, pitch)})
    assert not [doubt for doubt in impossible_channels(given, dynamics_of(T128)) if doubt.kind == "attitude range"]


@pytest.mark.parametrize(("reading", "verdict"), [(100.0, "not usable"), (0.0, "doubtful")])
def test_a_dead_load_is_named(reading, verdict):
    record = made("step").with_column("AF", np.full(4000, reading))
    force, said = worked_out(record, dynamics(), {})
    assert force is not None
    assert [doubt.kind for doubt in force.doubts] == ["stuck channel"]
    assert str(force.verdict) == verdict
    assert any(f"AF reads {reading:g} N in all 4000 samples: the channel is dead" in text for text in said)


def test_a_dead_accelerometer_is_named():
    record = made("step").with_column("ground_acceleration", np.zeros(4000))
    force, _ = worked_out(record, dynamics(), {})
    assert force is not None
    assert [doubt.kind for doubt in force.doubts] == ["stuck channel"]
    assert str(force.verdict) == "doubtful"


def test_a_reading_that_is_exact_may_be_still():
    still = Channel("AF", np.full(64, 5.0), "N", noise=0.0)
    given = Recording.from_columns(np.arange(64) / RATE, {"AF": still})
    assert impossible_channels(given, dynamics_of(T128)) == ()


@pytest.mark.parametrize("reading", [0.0, 30.0])
@pytest.mark.soak(first=1)
def test_one_dead_channel_of_coupled_components_is_named_for_all(reading, rng):
    coupled = pair()
    _, loads, _ = shaken(rng, coupled, pitching=False)
    loads = loads + PAIR_NOISE * rng.normal(size=loads.shape)
    loads[:, 1] = reading
    with pytest.warns(
        DataQualityWarning, match=f"PM reads {reading:g} N\\*m in all 2000 samples: the channel is dead"
    ):
        force = estimate_force(recording_of(loads), coupled)
    dead = [(doubt.component, doubt.effect) for doubt in force.doubts if doubt.kind == "stuck channel"]
    assert dead == [("NF", None), ("PM", reading or None)]
    assert force.verdict is not Verdict.FIT


@pytest.mark.parametrize(
    ("heading", "status", "advice"),
    [
        ("AF [mV/V]", 2, "the output of a bridge is named rAF, and to have loads of it give --balance balance.json"),
        ("AF [mV]", 2, "the output of a bridge is named rAF, and to have loads of it give --balance balance.json"),
        ("rAF [mV/V]", 1, "gauge outputs become loads by a balance matrix: weigh, identify decay and rig, force"),
        ("Waage Fx [N]", 1, "`aerobalance map FILE -o map.toml` writes one to complete, and --map takes it"),
    ],
)
def test_a_load_that_is_not_there_is_told_what_gives_it(tmp_path, capsys, heading, status, advice):
    run, known, out = (str(tmp_path / name) for name in ("run.csv", "d.json", "out.csv"))
    rows = "".join(f"{i / RATE},{np.cos(i):.4f}\n" for i in range(200))
    (tmp_path / "run.csv").write_text(f"time [s],{heading}\n{rows}")
    write_dynamics(known, {"AF": dynamics()})
    identify = ["identify", "decay", run, "--component", "AF", "--mass", "177"]
    for command in (["force", run, "--dynamics", known, "-o", out], identify, ["weigh", run]):
        assert main(command) == status
        assert advice in capsys.readouterr().err


def test_a_unit_of_another_kind_and_a_load_beside_others_are_told_as_before(tmp_path):
    (tmp_path / "run.csv").write_text("time [s],AF [m]\n0,1\n1,2\n")
    with pytest.raises(ReadError, match=r"a length, but a force is expected; allowed: N, kN, lbf, kgf$"):
        ab.read(tmp_path / "run.csv")
    run = Recording.from_columns(np.arange(3) / RATE, {"AF": Channel("AF", np.zeros(3), "N")}, name="run")
    with pytest.raises(FitError, match=r"^run has no channel PM; it has AF$"):
        run.channel("PM")


def test_a_force_is_printed_with_its_verdict_and_what_is_doubted():
    case = CASES["2 % clipped above, 0-20 Hz"]
    force, _ = worked_out(case.record(0), case.dynamics, {})
    *_, verdict, doubted = repr(force).splitlines()
    assert verdict == "verdict: fit for use"
    assert doubted == f"doubted, AF: {KINDS['clipping']}"
    assert f"<p>{verdict}</p><p>{doubted}</p>" in force._repr_html_()
    # of more kinds than are named the number of the others is said
    (part,) = force.values()
    kinds = ("clipping", "hum", "turning", "zero", "resolution")
    doubts = tuple(Doubt(kind, "AF", "") for kind in (*kinds, "hum"))
    shown = repr(replace(force, parts={"AF": replace(part, doubts=doubts)})).splitlines()
    assert shown[-5:-1] == [
        "verdict: doubtful",
        *(f"doubted, AF: {KINDS[kind]}" for kind in ("clipping", "hum", "turning")),
    ]
    assert shown[-1] == "doubted: 2 more, in doubts"


def test_a_clipped_channel_is_told_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    case = CASES["2 % clipped above, 0-20 Hz"]
    run = frames(case.record(0), "run")
    table = np.column_stack([run.time, run.channel("AF").values])
    np.savetxt("run.csv", table, delimiter=",", header="time [s],AF [N]", comments="")
    write_dynamics(tmp_path / "d.json", {"AF": case.dynamics})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        assert main(["force", "run.csv", "--dynamics", "d.json", "-o", "f.csv", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [doubt["kind"] for doubt in result["doubts"]] == ["clipping"]
    assert sum("limit" in text for text in result["warnings"]) == 1
    with pytest.warns(DataQualityWarning, match="AF rests on its limit"):  # who only reads is told as well
        ab.read("run.csv")


def test_a_mass_in_words_is_refused_by_what_is_allowed():
    time = np.arange(400) / RATE
    load = 50.0 * np.exp(-4.0 * time) * np.cos(2 * np.pi * 66.0 * time)
    record = Recording.from_columns(time, {"AF": Channel("AF", load, "N")})
    with pytest.raises(ValueError, match=r"mass is a number \[kg\].*not '12,8 kg'"):
        ab.identify(record, mass="12,8 kg")


def test_a_force_that_is_not_there_is_told_with_those_that_are():
    noise = np.random.default_rng(0).normal(size=800)
    record = Recording.from_columns(np.arange(800) / RATE, {"AF": Channel("AF", noise, "N")})
    force = estimate_force(record, T128)
    with pytest.raises(KeyError, match="no force along 'NF'; there are AF"):
        force["NF"]
    assert "NF" not in force
    assert force.get("NF") is None


def test_a_channel_map_is_taken_as_it_is_or_as_its_file(tmp_path):
    (tmp_path / "run.csv").write_text("t,load\n" + "".join(f"{i / 100},{i % 7}\n" for i in range(50)))
    (tmp_path / "map.toml").write_text(
        '[file]\ntime = "t"\ntime_unit = "s"\n\n[channels.AF]\ncolumn = "load"\nunit = "N"\n'
    )
    by_file = ab.read(tmp_path / "run.csv", channel_map=tmp_path / "map.toml")
    as_it_is = ab.read(tmp_path / "run.csv", channel_map=load_channel_map(tmp_path / "map.toml"))
    np.testing.assert_array_equal(by_file.channel("AF").values, as_it_is.channel("AF").values)
