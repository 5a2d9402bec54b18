"""What a person meets in the terminal: short answers, outputs that exist, pipes, units, slips of the pen."""

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.commands.answers import rounded
from aerobalance.app.commands.weighing import mass_number
from aerobalance.io import read_table
from aerobalance.io.results_file import force_columns, writing
from aerobalance.recording.channel import Channel
from aerobalance.recording.recording import Recording

HAND_MADE = {
    "components": {"AF": {"mass": {"value": 42.0}, "stiffness": {"value": 5.6e6}, "damping": {"value": 250.0}}}
}
SIX = ("NF", "PM", "SF", "YM", "RM", "AF")
RATE, COUNT = 1000.0, 400


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a recording in kN and degrees, static points and a dynamics.json written by hand."""
    monkeypatch.chdir(tmp_path)
    generator = np.random.default_rng(8)
    time = np.arange(COUNT) / RATE
    load = 0.2 + 0.01 * generator.normal(size=COUNT)
    rows = [f"{t:.4g},{f:.7g},2" for t, f in zip(time, load, strict=True)]
    Path("run.csv").write_text("\n".join(["time [s],AF [kN],pitch [deg]", *rows]) + "\n")
    pitch = np.array([-10.0, -5, 0, 5, 10])
    points = 3 + 42 * 9.80665 * np.sin(np.radians(pitch)) + generator.normal(size=5) * 0.1
    rows = [f"{angle:g},{value:.6g}" for angle, value in zip(pitch, points, strict=True)]
    Path("points.csv").write_text("\n".join(["pitch [deg],AF [N]", *rows]) + "\n")
    Path("dynamics.json").write_text(json.dumps(HAND_MADE))
    return tmp_path


def call(capsys, *words):
    capsys.readouterr()
    code = main([*words])
    return code, *capsys.readouterr()


def columns(name="run.csv"):
    return np.loadtxt(name, delimiter=",", skiprows=1).T


# --- short answers


@pytest.mark.parametrize(
    ("value", "u", "texts"),
    [
        (177.871234, 0.0123, ("177.871", "0.012")),
        (30930123.0, 123.4, ("30930120", "120")),
        (123456.0, 45000.0, ("123000", "45000")),
        (-0.00001, 0.0996, ("0.00", "0.10")),  # rounded first: two digits of 0.0996 are 0.10
        (2.5, 0.0, ("2.5", "0")),
        (1 / 3, float("nan"), ("0.333333", "-")),
        (-0.0, float("nan"), ("0", "-")),
    ],
)
def test_a_value_is_rounded_to_the_digits_of_its_uncertainty(value, u, texts):
    assert rounded(value, u) == texts


def test_info_is_in_the_units_of_the_file(here, capsys):
    _, load, _ = columns()
    code, out, _ = call(capsys, "info", "run.csv", "--json")
    found = json.loads(out)["channels"]
    assert code == 0
    assert (found["AF"]["unit"], found["pitch"]["unit"]) == ("kN", "deg")
    for name, true in (("least", load.min()), ("mean", load.mean()), ("largest", load.max())):
        assert found["AF"][name] == pytest.approx(true, rel=1e-12)
        assert found["AF"]["si"][name] == pytest.approx(1000 * true, rel=1e-12)
        assert found["pitch"][name] == pytest.approx(2.0, rel=1e-12)
        assert found["pitch"]["si"][name] == pytest.approx(np.deg2rad(2.0), rel=1e-12)
    # the noise of white samples, 10 N, from 400 of them
    assert found["AF"]["noise"] == pytest.approx(0.01, rel=0.25)
    assert found["AF"]["si"]["noise"] == pytest.approx(1000 * found["AF"]["noise"])
    _, out, _ = call(capsys, "info", "run.csv")
    assert re.search(r"^ AF +kN +0\.1998\d ", out, re.MULTILINE)
    assert re.search(r"^ pitch +deg +2 +2 +2 ", out, re.MULTILINE)


COMMANDS = {
    "force": ("force", "run.csv", "--dynamics", "dynamics.json", "--method", "paper", "-o", "out/f.csv"),
    "weigh": ("weigh", "points.csv", "-o", "out/m.json"),
    "convert": ("convert", "run.csv", "-o", "out/c.h5"),
    "map": ("map", "run.csv", "-o", "out/m.toml"),
    "info": ("info", "run.csv"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_answer_is_short_and_all_of_it_comes_with_verbose(name, here, capsys):
    Path("out").mkdir()
    words = COMMANDS[name]
    code, out, err = call(capsys, *words)
    assert code == 0, err
    assert len(out.splitlines()) <= 14
    assert not re.search(r"e-1[5-9]|summary|<bool>|(?<![\w.])-0(\.0*)?(?![\d.])", out)
    if "-o" in words:
        assert out.splitlines()[-1] == f"written: {words[-1]}"  # with its folder
    code, more, _ = call(capsys, *words, "--verbose")
    assert code == 0
    assert more.startswith(out[: out.rindex("\n", 0, -1) + 1] if "-o" in words else out)
    assert not re.search(r"^(summary|details)\b|^[a-z_.0-9]+ *$", more, re.MULTILINE)  # no key without a value
    _, out, _ = call(capsys, *words, "--json")
    account = json.loads(out)
    assert not {"summary", "details"} & set(account)
    assert account.get("replaced") == ([words[-1]] if "-o" in words else None)


def test_weighing_tells_mass_with_two_digits_of_its_uncertainty(here, capsys):
    _, out, _ = call(capsys, "weigh", "points.csv", "-o", "m.json")
    found = json.loads(Path("m.json").read_text())["components"]["AF"]["mass"]
    value, u = re.search(r"^ mass +(\S+) +(\S+) +kg$", out, re.MULTILINE).groups()
    assert len(u.strip("0.")) == 2
    assert abs(float(u) - found["u"]) <= 0.05 * found["u"]
    assert abs(float(value) - found["value"]) <= 0.05 * found["u"]


def test_table_of_forces_has_the_digits_that_mean_something(tmp_path):
    generator = np.random.default_rng(2)
    time = np.arange(5000) / 5000.0
    values = 250 + 60 * generator.normal(size=(5000, 1))
    u = 0.03 + 0.02 * generator.random(size=(5000, 1))
    recording = Recording.from_columns(time, {"AF": Channel("AF", values[:, 0], "N")}, name="run")
    file = tmp_path / "f.csv"
    with writing(file, samples=5000) as append:
        append(force_columns(file, recording, slice(0, 5000), {"AF": values[:, 0]}, {"AF": u[:, 0]}))
    table = read_table(tmp_path / "f.csv", required=("time", "AF", "u_AF"))
    assert np.array_equal(table.values("time"), time)
    assert np.max(np.abs(table.values("AF") - values[:, 0]) / u[:, 0]) < 1e-3
    assert np.max(np.abs(table.values("u_AF") - u[:, 0]) / u[:, 0]) < 1e-3
    rows = np.column_stack([time, values, u]).tolist()
    whole = sum(len(",".join(repr(cell) for cell in row)) + 1 for row in rows)
    assert (tmp_path / "f.csv").stat().st_size < 0.6 * whole


# --- outputs that exist


def test_a_result_replaces_an_earlier_one_of_its_kind_and_says_so(here, capsys):
    for words in (COMMANDS["force"], COMMANDS["weigh"], COMMANDS["convert"], COMMANDS["map"]):
        line = [*words[:-1], words[-1].removeprefix("out/")]
        assert "written: " in call(capsys, *line)[1]
        code, out, err = call(capsys, *line)
        assert code == 0, err
        assert out.splitlines()[-1] == f"replaced: {line[-1]}"


@pytest.mark.parametrize("name", ["force", "weigh", "convert", "map"])
def test_anything_else_is_replaced_with_replace_only(name, here, capsys):
    Path("out").mkdir()
    words = COMMANDS[name]
    out = Path(words[-1])
    raw = Path("run.csv").read_bytes()
    out.write_bytes(raw)  # the laboratory's own recording
    code, text, err = call(capsys, *words)
    assert (code, text) == (2, "")
    assert str(out) in err
    assert "--replace" in err
    assert "nothing was written" in err
    assert out.read_bytes() == raw
    code, text, err = call(capsys, *words, "--replace")
    assert code == 0, err
    assert f"replaced: {out}" in text
    assert out.read_bytes() != raw


def test_results_of_another_kind_and_edited_maps_are_kept(here, capsys):
    assert main(["weigh", "points.csv", "-o", "m.json"]) == 0
    assert main(["convert", "run.csv", "-o", "c.csv"]) == 0
    assert main(["map", "run.csv", "-o", "m.toml"]) == 0
    Path("m.toml").write_text(Path("m.toml").read_text() + "# by hand\n")
    Path("other.csv").write_text(Path("run.csv").read_text().replace(",2\n", ",3\n"))
    before = {name: Path(name).read_bytes() for name in ("m.json", "c.csv", "m.toml", "dynamics.json")}
    for words in (
        ("identify", "decay", "run.csv", "--mass", "42", "-o", "m.json"),
        ("weigh", "points.csv", "-o", "dynamics.json"),
        ("force", "run.csv", "--dynamics", "dynamics.json", "-o", "c.csv"),
        ("convert", "other.csv", "-o", "c.csv"),
        ("map", "run.csv", "-o", "m.toml"),
    ):
        code, _, err = call(capsys, *words)
        assert code == 2, words
        assert "--replace" in err
    assert {name: Path(name).read_bytes() for name in before} == before
    Path("empty.json").touch()
    assert main(["weigh", "points.csv", "-o", "empty.json"]) == 0


def test_dynamics_of_either_kind_replace_each_other(here, capsys):
    Path("K.csv").write_text(
        ",NF,PM,SF,YM,RM,AF\n"
        + "".join(",".join([name, *("1e6" if name == other else "0" for other in SIX)]) + "\n" for name in SIX)
    )
    Path("rigid.toml").write_text(
        "mass = 20.0\n[centre]\naft = 0.0\nright = 0.0\nup = 0.0\n[inertia]\naa = 0.3\nrr = 0.9\nuu = 0.8\n"
    )
    words = ("identify", "stiffness", "K.csv", "--mass", "rigid.toml", "--ratios", "0.01", "-o", "d.json")
    assert main([*words]) == 0
    code, out, err = call(capsys, *words)
    assert code == 0, err
    assert out.endswith("replaced: d.json\n")


def test_an_input_is_never_replaced(here, capsys):
    for words in (("convert", "run.csv", "-o", "run.csv"), ("weigh", "points.csv", "-o", "./points.csv")):
        code, _, err = call(capsys, *words, "--replace")
        assert code == 2
        assert "is an input" in err


@pytest.mark.skipif(os.name == "nt", reason="the limit is that of POSIX")
def test_a_late_failure_says_what_was_written(here, capsys):
    words = [
        "force",
        "run.csv",
        "--dynamics",
        "dynamics.json",
        "--method",
        "paper",
        "-o",
        "f.csv",
        "--report",
        "f.html",
    ]
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))  # more than the forces, less than the page
    try:
        code, _, err = call(capsys, *words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert code == 2, err
    (line,) = [row for row in err.splitlines() if row.startswith("error: ")]
    assert line.endswith("f.csv was written, f.html was not")
    assert sorted(path.suffix for path in here.iterdir()) == [".csv", ".csv", ".csv", ".json"]


# --- pipes


def test_dash_is_standard_input_and_output(here, monkeypatch, capsysbinary):
    command = [sys.executable, "-m", "aerobalance.app.cli", "convert", "-", "-o", "-"]
    done = subprocess.run(command, input=Path("run.csv").read_bytes(), capture_output=True, check=True)
    assert np.array_equal(np.loadtxt(io.BytesIO(done.stdout), delimiter=",", skiprows=1).T, columns())
    assert b"400 samples of AF, pitch" in done.stderr

    def piped(content, *words):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
        code = main([*words])
        return code, *capsysbinary.readouterr()

    code, out, err = piped(Path("points.csv").read_bytes(), "weigh", "-", "-o", "-")
    assert (code, json.loads(out)["kind"]) == (0, "mass")
    assert b"mass" in err
    code, _, err = piped(b"no,table\n1,x\n", "info", "-")
    assert code == 2
    assert b"standard-input" not in err
    assert b"\nerror: standard input: " in err
    assert sorted(path.name for path in here.iterdir()) == ["dynamics.json", "points.csv", "run.csv"]


# --- what is typed


@pytest.mark.parametrize(
    ("text", "mass"),
    [("42", 42.0), ("42,1", 42.1), ("42.1 kg", 42.1), ("42,1kg", 42.1), ("420 g", 0.42), ("100 lb", 45.359237)],
)
def test_a_mass_takes_a_unit_and_a_decimal_comma(text, mass):
    assert mass_number(text) == pytest.approx(mass, rel=1e-12)  # the pound is 0.45359237 kg by definition


@pytest.mark.parametrize(("text", "says"), [("1,234", "two ways"), ("42 N", "is a force"), ("42 xy", "unknown unit")])
def test_a_mass_that_is_none_is_refused(text, says):
    with pytest.raises(ValueError, match=says):
        mass_number(text)


def test_a_component_may_be_written_small_and_a_flag_takes_no_value(here, capsys):
    assert main(["weigh", "points.csv", "--component", "af"]) == 0
    code, _, err = call(capsys, "info", "run.csv", "--json", "true")
    assert code == 2
    assert "--json is a flag and takes no value; leave out 'true'" in err
    assert call(capsys, "-V")[1].startswith("aerobalance ")
    _, out, _ = call(capsys, "weigh", "--help")
    assert "bool" not in out
    assert "--help" in out
    assert "-h" in out


def test_shells_complete_the_commands(here):
    done = subprocess.run(
        [sys.executable, "-m", "aerobalance.app.cli"],
        env={"PATH": "", "PYTHONPATH": ":".join(sys.path), "_AEROBALANCE_COMPLETE": "complete_bash"}
        | {"COMP_WORDS": "aerobalance iden", "COMP_CWORD": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["identify"]


# --- files written by hand


def by_hand(change):
    given = json.loads(json.dumps(HAND_MADE))
    change(given)
    return json.dumps(given)


SLIPS = {
    "schema_version": (lambda d: d.update(schema_version=1), r"schema_version: is not known; did you mean schema\?"),
    "stifness": (lambda d: d["components"]["AF"].update(stifness=1), r"components\.AF\.stifness: .*mean stiffness\?"),
    "inner": (
        lambda d: d["components"]["AF"]["mass"].update(uu=1),
        r"AF\.mass\.uu: is not known.*allowed: value, u, unit",
    ),
}


@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_of_the_pen_is_named_with_what_was_meant(name, here, capsys):
    change, says = SLIPS[name]
    Path("dynamics.json").write_text(by_hand(change))
    code, _, err = call(capsys, "plan", "--dynamics", "dynamics.json", "--noise", "1", "--rate", "1000")
    assert code == 2
    assert re.search(says, err)


def test_what_the_program_wrote_is_read_whatever_it_says_besides(here, capsys):
    assert main(["weigh", "points.csv", "-o", "m.json"]) == 0
    written = json.loads(Path("m.json").read_text())
    written["components"]["AF"]["a_later_key"] = 1
    for found in (written, {key: value for key, value in written.items() if key != "provenance"}):
        Path("m.json").write_text(json.dumps(found))
        code, _, err = call(capsys, "identify", "decay", "run.csv", "--mass", "m.json")
        assert ("a_later_key" in err) == ("provenance" not in found)
        assert code == (1 if "provenance" in found else 2)  # no release in this recording


BOMBS = {
    "digits.json": ('{"schema": ' + "9" * 5000 + "}", "digits.json: holds a number of thousands of digits"),
    "deep.json": ("[" * 200_000, "deep.json: is nested too deeply"),
    "digits.toml": ("a = " + "9" * 5000, "digits.toml: holds a number of thousands of digits"),
    "deep.toml": ("a = " + "[" * 100_000, "deep.toml: is nested too deeply"),
    "dots.toml": ("a." * 100_000 + "b = 1", "has a key of more than 50 parts"),
    "large.toml": ("#" * 2_000_000, "large.toml: is larger than 1 MB"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_file_that_no_parser_bears_is_a_wrong_call(name, here, capsys):
    text, says = BOMBS[name]
    Path(name).write_text(text)
    words = (
        ("info", "run.csv", "--map", name)
        if name.endswith("toml")
        else ("identify", "decay", "run.csv", "--mass", name)
    )
    code, out, err = call(capsys, *words)
    assert (code, out) == (2, "")
    assert says in err


LONG = "n" * 300


@pytest.mark.parametrize(
    "words",
    [
        ("record", "-o", f"{LONG}.h5", "--seconds", "1"),
        ("force", "run.csv", "--dynamics", "dynamics.json", "-o", f"{LONG}.csv"),
        ("force", "run.csv", "--dynamics", f"{LONG}.json", "-o", "f.csv"),
        ("force", "run.csv", "--dynamics", "dynamics.json", "-o", "f.csv", "--report", f"{LONG}.html"),
        ("identify", "decay", "run.csv", "--mass", f"{LONG}.json"),
        ("weigh", f"{LONG}.csv", "-o", "m.json"),
        ("demo", "--out", LONG),
    ],
)
def test_a_name_that_is_too_long_is_a_wrong_call(words, here, capsys):
    code, out, err = call(capsys, *words)
    assert (code, out) == (2, "")
    assert re.search("too long", err)
    assert LONG[:50] in err
    assert "fault" not in err


def test_gaps_are_told_with_their_length(here, capsys):
    rows = Path("run.csv").read_text().splitlines()
    Path("gap.csv").write_text("\n".join([*rows[:101], *rows[151:]]) + "\n")
    _, out, _ = call(capsys, "info", "gap.csv")
    assert "1 gap, the longest 0.05 s\n" in out  # 50 samples of 1 ms


def test_repeated_time_stamps_are_named(here, capsys):
    rows = Path("run.csv").read_text().splitlines()
    rows[201] = rows[200]
    Path("twice.csv").write_text("\n".join(rows) + "\n")
    code, _, err = call(capsys, "info", "twice.csv")
    assert code == 0
    assert "samples 200 and 201 are both at 0.199 s" in err


@pytest.mark.parametrize("words", ["--help", "force --help", "--version"])
def test_a_reader_of_help_that_has_seen_enough_is_no_failure(words):
    """Parser and help end by a code of 1 where nobody reads any more: ``true`` reads nothing, and is gone by then."""
    line = f"(sleep 0.2; {sys.executable} -m aerobalance.app.cli {words}) | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_standard_input_in_the_place_of_dynamics_is_said_not_to_be_read(here, capsys):
    code, _, err = call(capsys, "force", "run.csv", "--dynamics", "-", "-o", "f.csv")
    assert code == 2
    assert "error: -: standard input is not read here; give a file" in err


def test_a_reader_that_has_seen_enough_is_no_failure(here):
    rows = (f"{i / 1000:.3f},{i}.125" for i in range(20_000))  # more than a pipe holds
    Path("long.csv").write_text("\n".join(["time [s],AF [N]", *rows]) + "\n")
    line = f"{sys.executable} -m aerobalance.app.cli convert long.csv -o - | head -n 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, "Error" in done.stderr) == (0, False), done.stderr
    assert done.stdout.count("\n") == 1
