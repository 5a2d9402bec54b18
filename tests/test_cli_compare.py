"""The commands compare and demo --tables from outside: table, page, errors and exit codes."""

import contextlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.commands.compare import compare, table_of, words_for_table
from aerobalance.app.demos import tables
from aerobalance.app.reports.compare_report import _limits, _running_rms, comparison_figure, components_figure
from aerobalance.dynamics.modal import Mode
from aerobalance.io import read, write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Channel
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.simulation.published import CABLE_CUT, TABLE_1, TABLE_2
from aerobalance.validation.baselines import BASELINES, THIS, TUNED, BaselineEstimate
from aerobalance.validation.scores import Truth
from seeds import new_seed

T128 = CABLE_CUT.dynamics


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a cable cut, its truth, a second cut, a smooth load and hand-made dynamics."""
    folder, rng = tmp_path_factory.mktemp("compare"), np.random.default_rng(new_seed())
    with contextlib.chdir(folder):
        write_files(rng)
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch):
    """A copy of that folder."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_files(rng):
    save("cut", CableCut(release=0.5003).run(2.0, rng))
    save("lab", CableCut(release=0.3002, cable_force=700.0).run(2.0, rng))
    load = band_noise(rng, low=0, high=60, rms=200.0, period=4.0)
    save("smooth", CableCut(cable_force=0.0, applied=load, sensors={"AF": Sensor(noise=2.0)}).run(1.0, rng))
    values = {"mass": T128.mass, "stiffness": T128.stiffness, "damping": T128.damping}
    Path("dynamics.json").write_text(
        json.dumps({"components": {"AF": {key: {"value": value} for key, value in values.items()}}})
    )


def save(name, simulation):
    write_recording(Path(f"{name}.csv"), simulation.recording)
    truth = {"AF": Channel("AF", simulation.applied, "N")}
    write_recording(Path(f"{name}_truth.csv"), Recording.from_columns(simulation.recording.time, truth))


def call(capsys, line):
    capsys.readouterr()
    code = main(line.split())
    out, err = capsys.readouterr()
    return code, out, err


def test_help_gives_an_example(capsys):
    code, out, err = call(capsys, "compare --help")
    assert (code, err) == (0, "")
    assert "Example: aerobalance compare run.csv --dynamics dynamics.json --truth" in " ".join(out.split())


def test_moments_keep_their_unit(here, capsys):
    dynamics = json.loads(Path("dynamics.json").read_text())
    dynamics["components"] = {"PM": dynamics["components"]["AF"]}
    Path("moment.json").write_text(json.dumps(dynamics))
    for name in ("smooth", "smooth_truth"):
        text = Path(f"{name}.csv").read_text()
        Path(f"pitching_{name}.csv").write_text(text.replace("AF [N]", "PM [N*m]", 1))
    line = "compare pitching_smooth.csv --dynamics moment.json --component PM --truth pitching_smooth_truth.csv"
    code, out, err = call(capsys, line)
    assert code == 0, err
    assert re.search(r"^rms: this estimator is first, \S+ N\*m; next is", out, flags=re.MULTILINE), out


def test_table_with_truth(here, capsys):
    line = "compare cut.csv --dynamics dynamics.json --truth cut_truth.csv --half-range 2000 --json"
    code, out, err = call(capsys, line)
    assert code == 0, err
    account = json.loads(out)
    rows = {(row["name"], row["setting"]): row for row in account["rivals"]}
    assert [name for name, setting in rows if setting == "customary"] == list(BASELINES)
    assert {name for name, setting in rows if setting == "tuned on the truth"} == set(TUNED)
    own = rows[THIS, "customary"]
    assert own["plateau"] < 1.0  # total variation and a parametric step reach 0.2 to 0.8 N at 10 N of noise
    assert rows["central differences", "customary"]["plateau"] == pytest.approx(352, rel=0.15)
    assert own["percent_of_half_range"]["rms"] == pytest.approx(own["rms"] / 20)
    assert account["half_range"] == {"value": 2000.0, "unit": "N", "from": "given"}
    assert account["jumps"] is True
    assert any(text.startswith(f"rms: {THIS} is first") for text in account["verdict"]), account["verdict"]
    assert "model's own response" in rows["FIR deconvolution", "customary"]["settings"]
    # the edges of a jump are where a linear filter must fail: one sample half way is 510 N off
    assert rows["low-pass", "tuned on the truth"]["edge"] > 50


def test_measured_step_makes_the_black_box_inverse(here, capsys):
    code, out, err = call(
        capsys, "compare cut.csv --dynamics dynamics.json --truth cut_truth.csv --step lab.csv --json"
    )
    assert code == 0, err
    account = json.loads(out)
    row = next(row for row in account["rivals"] if row["name"] == "FIR deconvolution")
    assert "step response in lab.csv" in row["settings"]
    raw = next(row for row in account["rivals"] if row["name"] == "raw reading")
    assert row["plateau"] < raw["plateau"] / 10
    # half of the truth's span is half of the step
    assert account["half_range"]["value"] == pytest.approx(510.0)


def test_text_names_what_could_not_be_run(here, capsys):
    code, out, err = call(capsys, "compare smooth.csv --dynamics dynamics.json --truth smooth_truth.csv")
    assert (code, "Traceback" in err) == (0, False)
    assert re.search(r"accelerometer correction\s+not run: .*live_acceleration", out)
    assert re.search(r"^low-pass \*", out, flags=re.MULTILINE)
    assert re.search(r"^rms: this estimator is ", out, flags=re.MULTILINE)


def test_two_modes_are_labelled_and_used(here, seed):
    two = T128.with_modes(Mode(165.0, 0.012, 0.05))
    write_dynamics("two.json", {"AF": two})
    save("two", CableCut(dynamics=two, release=0.5003).run(2.0, np.random.default_rng(seed)))
    truth, step = Path("two_truth.csv"), Path("two.csv")
    account = compare(Path("two.csv"), dynamics=Path("two.json"), truth=truth, step=step)
    out = account["summary"]
    assert "natural frequency 66.368 Hz, further 165 Hz (share 0.05)" in out
    assert "central differences: knows one mode only, M, b and k are those of the first: 165 Hz left out" in out
    assert account["further_modes"] == [{"natural_frequency": 165.0, "damping_ratio": 0.012, "share": 0.05}]
    rows = {row["name"]: row for row in account["rivals"] if row["setting"] == "customary"}
    assert "notch at 66.37 Hz, 33.2 Hz wide, notch at 165 Hz, 82.5 Hz wide" in rows["notch and low-pass"]["settings"]
    assert "165 Hz left out" in rows["central differences"]["settings"]
    # at 10 N of noise the one-mode plateau is known to a newton (see above), and a second mode adds none
    assert rows[THIS]["plateau"] < 1.0


def test_without_truth_only_differences_are_shown(here, capsys):
    code, out, _ = call(capsys, "compare smooth.csv --dynamics dynamics.json --json")
    account = json.loads(out)
    assert (code, account["verdict"], account["half_range"]) == (0, [], None)
    own = account["rivals"][-1]
    assert (own["name"], own["apart_from_this_estimator_rms"]) == (THIS, 0.0)
    assert all("rms" not in row for row in account["rivals"])


@pytest.mark.parametrize("truth", ["--truth cut_truth.csv", ""])
@pytest.mark.soak(first=1)
def test_page_stands_alone(here, capsys, truth):
    code, out, err = call(capsys, f"compare cut.csv --dynamics dynamics.json {truth} -o page.html")
    assert code == 0, err
    page = Path("page.html").read_text()
    assert "<svg" in page
    assert not re.search(r"https?://|<script|url\((?!#)|src=", page)
    assert "$\\mathdefault" not in page
    for name in BASELINES:
        assert name in page
    assert page.count("SHA-256") == (3 if truth else 2)
    assert "written: page.html" in out


@pytest.mark.parametrize("known", [True, False])
def test_an_estimate_with_a_gap_is_drawn_with_a_gap(known, rng):
    recording = CableCut(release=0.5003).run(1.0, rng).recording
    values = recording.channel("AF").values
    gap = np.where(np.arange(values.size) // 160 == 6, np.nan, values)
    truth = Truth.of(values, rate=1600.0, natural_frequency=T128.natural_frequency) if known else None
    found = [BaselineEstimate("raw reading", gap), BaselineEstimate("low-pass", gap), BaselineEstimate(THIS, values)]
    whole = slice(0, values.size)
    drawn = comparison_figure(found, recording=recording, dynamics=T128, truth=truth, window=whole)
    assert "<svg" in drawn
    truths = {} if truth is None else {"AF": truth}
    assert "<svg" in components_figure({"AF": found}, recording=recording, truths=truths, window=whole)


def test_errors_and_axes_leave_missing_samples_out():
    error = np.full(1000, 3.0)
    error[100] = np.nan
    found = _running_rms(error, 10)
    assert np.flatnonzero(np.isnan(found)).tolist() == [100]
    # the constant itself, but for the rounding of a running sum over 1000 samples
    np.testing.assert_allclose(np.delete(found, 100), 3.0, rtol=1e-12)
    curve, missing = np.array([-1.0, np.nan, 3.0]), np.full(3, np.nan)
    assert _limits(np.array([0.0, np.nan, 4.0]), [curve, missing]) == (-1.25, 4.25)
    assert _limits(missing, [missing]) == (-1.0, 1.0)


@pytest.mark.parametrize(
    ("line", "code", "says"),
    [
        ("--truth late.csv", 1, "0.4 of a sample apart"),
        ("--truth slow.csv", 1, "sampled at 800 Hz and cut.csv at 1600 Hz"),
        ("--truth short.csv", 1, "not all of cut.csv"),
        ("--truth none.csv", 2, "none.csv"),
        ("--half-range 0", 2, "--half-range must be positive"),
        ("--component SF", 1, "has no SF; it has AF"),
        ("--component XX", 2, "--component must be one of"),
        ("--step quiet.csv", 1, "no step or impulse stands out"),
        ("-o cut.csv", 2, "is an input and would be overwritten"),
    ],
)
def test_refused_with_a_reason(here, capsys, rng, *, line, code, says):
    time = np.arange(3200) / 1600
    for name, clock in (("late", time + 0.4 / 1600), ("slow", time[::2]), ("short", time[:1000])):
        truth = {"AF": Channel("AF", np.zeros(clock.size), "N")}
        write_recording(Path(f"{name}.csv"), Recording.from_columns(clock, truth))
    noise = {"AF": Channel("AF", rng.normal(size=3200), "N")}
    write_recording(Path("quiet.csv"), Recording.from_columns(time, noise))
    before = Path("cut.csv").read_text()
    got, out, err = call(capsys, f"compare cut.csv --dynamics dynamics.json {line}")
    assert (got, out) == (code, ""), err
    assert re.search(f"^error: .*{re.escape(says)}", err, flags=re.MULTILINE), err
    assert Path("cut.csv").read_text() == before


def test_half_range_of_a_truth_that_is_zero(here, capsys):
    truth = {"AF": Channel("AF", np.zeros(800), "N")}
    write_recording(Path("zero.csv"), Recording.from_columns(np.arange(800) / 1600, truth))
    write_recording(Path("brief.csv"), read("smooth.csv").part(0, 800))
    code, out, _ = call(capsys, "compare brief.csv --dynamics dynamics.json --truth zero.csv --json")
    account = json.loads(out)
    assert code == 0
    assert "give --half-range" in account["half_range"]["from"]
    assert account["rivals"][0]["percent_of_half_range"]["rms"] is None


@pytest.fixture
def short_tables(monkeypatch):
    """Both tables with the step and one shaken record only: the whole takes half a minute."""

    def tunnel(generator):
        step = CABLE_CUT.excitation.value
        return [tables.Experiment("step", CABLE_CUT, CableCut().run(2.5, generator), step, "step")]

    monkeypatch.setattr(tables, "tunnel_experiments", tunnel)
    monkeypatch.setattr(tables, "rig_experiments", lambda generator: [])


@pytest.mark.soak(first=0)
def test_tables_have_printed_and_measured_rows_and_repeat_themselves_with_a_seed(short_tables, tmp_path, capsys, seed):
    code, out, err = call(capsys, f"demo --tables --out {tmp_path} --seed {seed} --json")
    assert code == 0, err
    account = json.loads(out)
    assert [row["percent"] for row in account["table_1"]["printed"]] == [row.deviation.value for row in TABLE_1]
    assert [row["percent"] for row in account["table_2"]["printed"]] == [row.deviation.value for row in TABLE_2]
    mean = {(row["method"], row["setting"]): row["percent"]["step"] for row in account["table_1"]["measured"]}
    momentary = {
        (row["method"], row["setting"]): row["percent"]["step"] for row in account["table_2"]["measured_of_half_range"]
    }
    assert {name for name, _ in mean} == set(BASELINES)
    # the paper's own rows, 0.2 % of the step and 3 % of half range, at its own noise
    assert mean[THIS, "customary"] < 0.2, account["seed"]
    assert momentary[THIS, "customary"] < 3.0, account["seed"]
    assert momentary["central differences", "customary"] > 30, account["seed"]
    page = (tmp_path / "tables.html").read_text()
    assert "Table 2: momentary force" in page
    assert not re.search(r"https?://|<script|src=", page)
    code, out, err = call(capsys, f"demo --tables --out {tmp_path} --seed {seed}")
    assert code == 0, err
    assert "[7]: harmonic force, two balances compared (correction factor)" in out
    assert f"seed: {seed}" in out
    assert (tmp_path / "tables.html").read_text() == page


def test_deviations_of_the_tables_are_percentages():
    simulation = CableCut(release=0.5003).run(2.0, np.random.default_rng(1))
    experiment = tables.Experiment("step", CABLE_CUT, simulation, 1020.0, "step")
    truth = tables.Truth.of(simulation.applied, rate=1600.0, natural_frequency=66.4)
    time = simulation.recording.time
    error = np.where(time > 0.55, 2.0, 0.0)
    error[np.abs(time - 0.5003) < 0.004] = 500.0  # within 5 ms of the release nothing counts
    error[900] = 60.0  # 0.5625 s
    got = experiment.deviations(simulation.applied + error, truth)
    count = np.count_nonzero(truth.scored & (time >= 0.5503))
    assert got["mean_percent"] == pytest.approx(100 * (2 + 58 / count) / 1020, rel=1e-6)
    assert got["momentary_percent_of_half_range"] == pytest.approx(3.0)
    assert got["momentary_percent_of_excitation"] == pytest.approx(100 * 60 / 1020)


@pytest.mark.parametrize(
    ("known", "expected"), [(100.0, {"NF": 0.2, "PM": 0.5}), (float("nan"), {"NF": 2.0, "PM": 0.5})]
)
def test_the_table_of_all_components_has_one_kind_of_number(known, expected):
    """NF departs by 2 N of half range 1000 N, and PM by 0.5 N*m of 100 N*m, or of a range that is not known."""
    parts = {}
    for name, half, rms in (("NF", 1000.0, 2.0), ("PM", known, 0.5)):
        row = {"name": THIS, "setting": "customary", "lacking": None, "rms": rms}
        row["percent_of_half_range"] = {"rms": 100 * rms / half}
        parts[name] = {"half_range": {"value": half, "from": "given"}, "rivals": [row]}
    result = {"components": parts}
    (row,) = table_of(result)
    assert row["numbers"] == pytest.approx(expected)
    words = "in percent of half range" if np.isfinite(known) else "each in its own unit"
    assert words in words_for_table(result)
