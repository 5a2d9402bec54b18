"""The command line from outside: exit codes, streams, files and what they hold."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from aerobalance.app.cli import main
from aerobalance.app.cli.program import with_files

MASS, STIFFNESS, DAMPING = 177.87, 3.4e7, 3000.0
RATE, COUNT, RELEASE, HELD = 1600.0, 2400, 0.3, 5000.0
TREADMILL = Path(__file__).parents[2] / "shared" / "data" / "treadmill"
COMMANDS = ["demo", "info", "convert", "map", "calibrate", "compare-calibrations", "loads", "weigh", "identify decay"]
COMMANDS += ["identify rig", "identify frf", "force", "plan", "compare"]
HAND_MADE = {
    "components": {
        "AF": {
            "mass": {"value": MASS, "u": 0.01},
            "stiffness": {"value": STIFFNESS, "u": 100.0},
            "damping": {"value": DAMPING, "u": 1.0},
        }
    }
}


@pytest.fixture
def here(tmp_path, monkeypatch, rng):
    """A folder with a free decay, a table of points, a table of a response and a dynamics.json, all with noise."""
    monkeypatch.chdir(tmp_path)
    time = np.arange(COUNT) / RATE
    Path("cut.csv").write_text(table("time [s],AF [N]", time, decay(time) + rng.normal(size=COUNT) * 5))
    pitch = np.array([-10.0, -5, 0, 5, 10, 15])
    load = 12 + MASS * 9.80665 * np.sin(np.radians(pitch)) + rng.normal(size=6) * 0.1
    Path("points.csv").write_text(table("pitch [deg],AF [N]", pitch, load))
    Path("dynamics.json").write_text(json.dumps(HAND_MADE))
    return tmp_path


def decay(time):
    """Load of a mass on a damped spring, held by a force and let go: the closed form."""
    rate = DAMPING / (2 * MASS)
    omega = np.sqrt(STIFFNESS / MASS - rate**2)
    since = np.clip(time - RELEASE, 0, None)
    return HELD * np.exp(-rate * since) * (np.cos(omega * since) + rate / omega * np.sin(omega * since))


def table(header, *columns):
    rows = (",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))
    return "\n".join([header, *rows]) + "\n"


def call(capsys, line, *more):
    """Run a command in process: exit code, standard output, standard error."""
    capsys.readouterr()
    code = main([*line.split(), *map(str, more)])
    out, err = capsys.readouterr()
    return code, out, err


def refused(capsys, line, *, code, says):
    """Run a command that must fail: one `error:` line, an empty standard output, and OUT as it was before."""
    out = Path(line.split(" -o ")[1].split()[0]) if " -o " in line else None
    guarded = out is not None and out.parent.is_dir() and not out.is_dir() and not out.exists()
    before = sorted(path.name for path in Path.cwd().iterdir())
    for content in [None, "as it was"] if guarded else [None]:
        if content is not None:
            out.write_text(content)
        got, text, err = call(capsys, line if content is None else f"{line} --replace")
        assert (got, text) == (code, ""), err
        assert len([row for row in err.splitlines() if row.startswith("error: ")]) == 1, err
        assert all(row.startswith(("error: ", "warning: ")) for row in err.splitlines()), err
        assert re.search(says, err), err
        if content is None:
            assert sorted(path.name for path in Path.cwd().iterdir()) == before
        else:
            assert out.read_text() == content
            out.unlink()


@pytest.mark.parametrize("command", COMMANDS)
def test_help_gives_an_example(command, capsys):
    code, out, err = call(capsys, command + " --help")
    assert (code, err) == (0, "")
    assert f"Example: aerobalance {command} " in " ".join(out.split())


def test_installed_command_tells_its_version_and_its_exit_code(tmp_path):
    program = Path(sys.executable).parent / "aerobalance"
    if not program.exists():
        pytest.skip("the command is not installed beside this Python")
    done = subprocess.run([program, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"aerobalance \d+\.\d+\S*\n", done.stdout)
    failed = subprocess.run([program, "info", tmp_path / "none.csv"], capture_output=True, text=True, check=False)
    assert (failed.returncode, failed.stdout) == (2, "")
    assert failed.stderr.startswith("error: ")
    assert failed.stderr.endswith("none.csv: there is no such file\n")


WRONG_CALLS = {
    "nonsense": "No such command 'nonsense'",
    "identify nonsense": "No such command",
    "info": "Missing argument 'FILE'; see aerobalance info --help",
    "info --bogus cut.csv": "No such option: --bogus",
    "info none.csv": "none.csv: there is no such file",
    "info .": "is a folder",
    "identify decay cut.csv -o OUT.json": "Missing option '--mass'",
    "identify decay cut.csv --mass -3 -o OUT.json": "--mass must be a positive number or a mass.json, not -3",
    "identify decay cut.csv --mass 0 -o OUT.json": "--mass must be a positive number",
    "identify decay cut.csv --mass nan -o OUT.json": "--mass must be a positive number",
    "identify decay cut.csv --mass none.json -o OUT.json": "none.json: there is no such file",
    "identify decay cut.csv --mass 1 --component XX -o OUT.json": "--component must be one of NF, PM, SF, YM, RM, AF",
    "identify decay cut.csv --mass 1 -o nowhere/OUT.json": "there is no folder nowhere",
    "identify decay cut.csv --mass 1 -o cut.csv": "cut.csv is an input",
    "identify decay cut.csv --mass 1 -o .": "is a folder",
    "identify frf cut.csv --mass 1 -o OUT.json": "no column frequency",
    "weigh points.csv --component XX -o OUT.json": "--component must be one of",
    "weigh points.csv -o points.csv": "points.csv is an input",
    "map cut.csv -o cut.csv": "cut.csv is an input",
    "convert cut.csv -o OUT.xyz": "'.xyz' stands for no known format; allowed: ",
    "convert cut.csv -o cut.csv": "cut.csv is an input",
    "force cut.csv --dynamics dynamics.json": "Missing option '-o'",
    "force cut.csv --dynamics none.json -o OUT.csv": "none.json: there is no such file",
    "force cut.csv --dynamics cut.csv -o OUT.csv": "a dynamics.json is needed",
    "force cut.csv --dynamics dynamics.json -o OUT": "stands for no known format",
    "force cut.csv --dynamics dynamics.json -o cut.csv": "cut.csv is an input",
    "force cut.csv --dynamics dynamics.json -o nowhere/OUT.csv": "there is no folder nowhere",
    "force cut.csv --dynamics dynamics.json --bandwidth abc -o OUT.csv": "Invalid value for '--bandwidth'",
    "force cut.csv --dynamics dynamics.json --bandwidth -1 -o OUT.csv": "bandwidth must lie between 0 and",
    "force cut.csv --dynamics dynamics.json --bandwidth 801 -o OUT.csv": "half the sampling rate",
    "force cut.csv --dynamics dynamics.json --method best -o OUT.csv": "'smoother', 'paper'",
    "force cut.csv --dynamics dynamics.json --map none.toml -o OUT.csv": "none.toml: there is no such file",
    "force points.csv --dynamics dynamics.json -o OUT.csv": "no column time",
}


@pytest.mark.parametrize("line", WRONG_CALLS)
def test_wrong_call_is_told_and_writes_nothing(line, here, capsys):
    refused(capsys, line, code=2, says=re.escape(WRONG_CALLS[line]))


LACKING = {
    "identify decay cut.csv --mass 1 --component NF -o OUT.json": "no channel NF; it has AF",
    "identify rig cut.csv -o OUT.json": "no channel ground_acceleration",
    "weigh cut.csv -o OUT.json": "no channel pitch",
}


@pytest.mark.parametrize("line", LACKING)
def test_data_that_cannot_carry_the_result_give_exit_code_1(line, here, capsys):
    refused(capsys, line, code=1, says=re.escape(LACKING[line]))


HEADER = "time [s],AF [N]"
BAD_FILES = {
    "empty": ("", 2, "is empty"),
    "no rows": (HEADER + "\n", 2, "no rows"),
    "ragged": (HEADER + "\n0,1\n1\n2,3\n", 2, "line 3"),
    "no unit": ("time [s],AF\n0,1\n1,2\n", 2, r"column 2 \('AF'\): the unit is missing"),
    "no number": (HEADER + "\n0,1\n1,abc\n2,3\n", 2, r"line 3, column 2 .*'abc' is no number"),
    "reversed": (HEADER + "\n2,1\n1,1\n0,1\n", 2, "line 3.*time must increase"),
    "binary": ("\x00\x01\x02" * 500, 2, "binary"),
    "wrong dimension": ("time [s],AF [m]\n0,1\n1,2\n", 2, "a length, but a force is expected"),
    "too short": (HEADER + "\n" + "".join(f"{i},{i % 3}\n" for i in range(9)), 1, "9 .*readings of AF"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_recording_is_told_and_writes_nothing(name, here, capsys):
    content, code, says = BAD_FILES[name]
    Path("bad.csv").write_text(content)
    for line in (
        "force bad.csv --dynamics dynamics.json -o OUT.csv",
        "force bad.csv --dynamics dynamics.json --method paper -o OUT.csv",
        "identify decay bad.csv --mass 1 -o OUT.json",
    ):
        refused(capsys, line, code=code, says=says)


BAD_DYNAMICS = {
    "stiffness": ({"value": -1.0}, "components.AF.stiffness.value: must be greater than 0"),
    "mass": ({"value": 0.0}, "components.AF.mass.value: must be greater than 0"),
    "damping": ({"value": "much"}, "components.AF.damping.value: must be a number"),
    "natural_frequency": ({"value": 1.0}, "mass and stiffness give 69.5838 Hz"),
    "covariance": ({"parameters": ["mass"], "matrix": [[1.0]]}, "components.AF.covariance"),
}


@pytest.mark.parametrize("key", BAD_DYNAMICS)
def test_unphysical_dynamics_are_told_with_their_key(key, here, capsys):
    entry, says = BAD_DYNAMICS[key]
    Path("d.json").write_text(json.dumps({"components": {"AF": HAND_MADE["components"]["AF"] | {key: entry}}}))
    refused(capsys, "force cut.csv --dynamics d.json -o OUT.csv", code=2, says=re.escape(says))


def test_broken_dynamics_are_told_with_their_place(here, capsys):
    Path("d.json").write_text(json.dumps(HAND_MADE)[:60])
    refused(capsys, "force cut.csv --dynamics d.json -o OUT.csv", code=2, says="line 1, column 6.*cut off JSON")


def test_numbers_out_of_range_are_no_traceback(here, capsys):
    entry = {"mass": {"value": 1e-300}, "stiffness": {"value": 1e300}, "damping": {"value": 0.0}}
    Path("d.json").write_text(json.dumps({"components": {"AF": entry}}))
    refused(capsys, "force cut.csv --dynamics d.json --method paper -o OUT.csv", code=1, says="leave the range")


def test_record_that_is_mostly_gap_is_bridged_or_refused_whole(here, capfd):
    rows = Path("cut.csv").read_text().splitlines()
    Path("gap.csv").write_text("\n".join([*rows[:100], *rows[-100:]]) + "\n")
    code, out, err = call(capfd, "force gap.csv --dynamics dynamics.json -o OUT.csv --json")
    assert "warning: gap.csv: 2201 sample(s) are missing from the time column in 1 gap(s)" in err
    assert (code, out == "", Path("OUT.csv").exists()) in {(0, False, True), (1, True, False)}, err


def test_doubts_are_single_lines_on_standard_error_and_in_the_result(here, capsys):
    rows = Path("cut.csv").read_text().splitlines()
    rows[100] = rows[100].split(",")[0] + ",NaN"
    del rows[1500:1503]
    Path("gap.csv").write_text("\n".join(rows) + "\n")
    for line in (
        "info gap.csv --json",
        "identify decay gap.csv --mass 177.87 --json",
        "convert gap.csv -o c.csv --json",
    ):
        code, out, err = call(capsys, line)
        told = err.splitlines()
        assert code == 0
        assert len(told) == len(set(told)) >= 1
        assert all(row.startswith("warning: gap.csv: ") for row in told), err
        assert json.loads(out)["warnings"] == [row.removeprefix("warning: ") for row in told]
    refused(capsys, "force gap.csv --dynamics dynamics.json --method paper -o OUT.csv", code=1, says="missing")


def test_info_tells_duration_rate_and_channels(here, capsys):
    code, out, err = call(capsys, "info cut.csv --json")
    account = json.loads(out)
    assert (code, err) == (0, "")
    assert account["duration"] == pytest.approx((COUNT - 1) / RATE)
    assert account["rate"] == pytest.approx(RATE)
    assert account["channels"]["AF"]["unit"] == "N"
    code, out, _ = call(capsys, "info cut.csv")
    assert code == 0
    assert out.startswith("cut.csv: 2400 samples, 1.49937 s at 1600 Hz\n")
    assert re.search(r"^ AF +N( +-?\d\S*){4} +- +-$", out, re.MULTILINE)


def test_weighed_mass_goes_into_the_decay_with_its_uncertainty(here, capsys):
    code, out, err = call(capsys, "weigh points.csv -o mass.json --json")
    weighed = json.loads(out)
    assert (code, err) == (0, "")
    written = json.loads(Path("mass.json").read_text())["components"]["AF"]
    assert written["mass"] == weighed["mass"]
    code, out, err = call(capsys, "identify decay cut.csv --mass mass.json -o d.json --json")
    assert (code, err) == (0, ""), f"{err}"
    found = json.loads(Path("d.json").read_text())
    assert json.loads(out)["components"] == found["components"]
    assert {entry["name"] for entry in found["provenance"]["inputs"]} == {"cut.csv", "mass.json"}
    entry = found["components"]["AF"]
    assert entry["mass"]["u"] == pytest.approx(weighed["mass"]["u"])
    frequency = np.sqrt(STIFFNESS / MASS) / (2 * np.pi)
    # Six standard uncertainties: one draw in 500 million lies outside.
    off = abs(entry["natural_frequency"]["value"] - frequency)
    assert off < 6 * entry["natural_frequency"]["u"]
    assert entry["natural_frequency"]["u"] < 1e-3 * frequency


@pytest.mark.parametrize(("unit", "factor"), [("lbf", 4.4482216152605), ("kN", 1000.0), ("N", 1.0)])
@pytest.mark.soak(first=2)
def test_force_keeps_time_name_and_unit(unit, factor, here, capsys):
    time = np.arange(COUNT) / RATE
    load = 50 * np.sin(2 * np.pi * 20 * time)  # without the release of the others, which is looked into at length
    Path("r.csv").write_text(table(f"time [ms],AF [{unit}]", time * 1000, load / factor))
    for option in ("--method paper", "--bandwidth 200"):
        code, out, err = call(capsys, f"force r.csv --dynamics dynamics.json {option} -o f.csv --json")
        assert (code, err) == (0, "")
        assert Path("f.csv").read_text().splitlines()[0] == f"time [ms],AF [{unit}],u_AF [{unit}]"
        given, got = (np.loadtxt(name, delimiter=",", skiprows=1) for name in ("r.csv", "f.csv"))
        assert np.array_equal(given[:, 0], got[:, 0])
        assert (got[:, 2] > 0).all()
        part = json.loads(out)["components"]["AF"]
        assert [text.split()[0] for text in part["assumptions"]] == ["ground_acceleration", "pitch"]
        assert part["mean"] == pytest.approx(got[:, 1].mean() * factor, abs=5e-4 * factor * got[:, 2].min())


def test_smoother_finds_the_force_that_was_let_go(here, capsys):
    code, _, err = call(capsys, "force cut.csv --dynamics dynamics.json -o f.csv")
    assert code == 0, err
    time, force, _ = np.loadtxt("f.csv", delimiter=",", skiprows=1).T
    late = time > RELEASE + 0.05
    # The promise for a step with 2 N noise is 0.2 % of half range from 50 ms after the release; here it is 5 N noise.
    assert np.sqrt(np.mean(force[late] ** 2)) < 2.5 * 0.002 * HELD / 2
    assert force[time < RELEASE - 0.05].mean() == pytest.approx(HELD, abs=5)


def test_same_inputs_give_the_same_bytes_but_for_the_time(here, capsys):
    lines = {
        "weigh points.csv -o OUT.json": "OUT.json",
        "identify decay cut.csv --mass 177.87 -o OUT.json": "OUT.json",
        "force cut.csv --dynamics dynamics.json --bandwidth 100 -o OUT.csv": "OUT.csv",
        "convert cut.csv -o OUT.csv": "OUT.csv",
        "map cut.csv -o OUT.toml": "OUT.toml",
    }
    for line, name in lines.items():
        written = []
        for _ in range(2):
            assert call(capsys, line)[0] == 0
            text = Path(name).read_text()
            assert text.endswith("\n")
            written.append(re.sub(r'"created": "[^"]+"', "", text))
            Path(name).unlink()
        assert written[0] == written[1], line


def test_response_table_gives_dynamics(here, capsys, rng):
    frequency = np.linspace(10, 140, 14)
    s = 2j * np.pi * frequency
    response = STIFFNESS / (MASS * s**2 + DAMPING * s + STIFFNESS)
    u_amplitude, u_phase = 0.002 * abs(response), np.full(14, 0.1)
    columns = (
        frequency,
        abs(response) + u_amplitude * rng.normal(size=14),
        u_amplitude,
        np.degrees(np.angle(response)) + u_phase * rng.normal(size=14),
        u_phase,
    )
    header = "frequency [Hz],amplitude [1],u_amplitude [1],phase [deg],u_phase [deg]"
    Path("table.csv").write_text(table(header, *columns))
    code, _, err = call(capsys, "identify frf table.csv --mass 177.87 -o d.json")
    assert code == 0, err
    entry = json.loads(Path("d.json").read_text())["components"]["AF"]
    for name, true in (("stiffness", STIFFNESS), ("damping", DAMPING)):
        assert abs(entry[name]["value"] - true) < 6 * entry[name]["u"]


@pytest.mark.skipif(not TREADMILL.is_dir(), reason="the treadmill trials are not here")
@pytest.mark.parametrize(
    ("trial", "limit"),
    # a minute and a quarter of an hour: force looks for a release in a record that is none
    [
        pytest.param(trial, limit, marks=pytest.mark.long)
        for trial, limit in (("RandomSlowSpeed1", 1.23), ("RandomFastSpeed1", 1.60))
    ],
)
def test_treadmill_moment_is_freed_of_the_belt(trial, limit, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    raw = TREADMILL / f"{trial}.txt"
    time, moment, velocity = np.loadtxt(raw, skiprows=1).T
    Path("map.toml").write_text(
        '[file]\ntime = "Timestamp (s)"\n[channels.PM]\ncolumn = "Pitch Moment (Nm)"\nunit = "Nm"\n'
        '[channels.ground_acceleration]\ncolumn = "Belt Velocity (m/s)"\nunit = "m/s"\nsign = -1\nderivative = 1\n'
    )
    acceleration = -np.gradient(velocity, np.median(np.diff(time)))
    header = "time [s],PM [N*m],ground_acceleration [m/s^2]"
    Path("plain.csv").write_text(table(header, time, moment, acceleration))
    low_pass = butter(2, 6 / 50)
    for recording, methods in ((["plain.csv"], ("smoother", "paper")), ([raw, "--map", "map.toml"], ("paper",))):
        code, _, err = call(capsys, "identify rig --component PM -o d.json", *recording)
        assert code == 0, err
        assert "the damping is hardly identifiable here" in err
        for method in methods:
            code, _, err = call(capsys, f"force --dynamics d.json --method {method} -o f.csv", *recording)
            assert code == 0, err
            slow = filtfilt(*low_pass, np.loadtxt("f.csv", delimiter=",", skiprows=1)[:, 1])
            assert np.sqrt(np.mean(slow**2)) <= limit, method


def test_patterns_of_files_are_those_files_where_a_shell_leaves_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("cut_2.csv", "cut_1.csv", "other.csv"):
        Path(name).touch()
    assert with_files(["weigh", "cut_*.csv", "no_*.csv", "-o", "m.json"]) == [
        "weigh",
        "cut_1.csv",
        "cut_2.csv",
        "no_*.csv",
        "-o",
        "m.json",
    ]
