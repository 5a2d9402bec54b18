"""Every example of README, quickstart, how-to pages and ``--help`` runs as printed, in the folder of the demo."""

import functools
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from asammdf import MDF, Signal
from nptdms import ChannelObject, TdmsWriter

import aerobalance as ab
from aerobalance.acquisition.setup import setup_from
from aerobalance.app.campaign.definition import definition_from
from aerobalance.app.cli import main
from aerobalance.app.cli.program import app, with_files
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io.dynamics_file import read_dynamics
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.simulation.hammer import Blow, Tapping
from aerobalance.simulation.published import CABLE_CUT
from aerobalance.simulation.six_balance import random_balance
from helpers.pages import README, ROOT, commands, fenced, python

WAIT = 60.0
QUICKSTART = ROOT / "docs/start/quickstart.md"


def from_quickstart():
    """The way from the recorder's files to the force, which begins in the demo's folder."""
    way = QUICKSTART.read_text(encoding="utf-8").split("## In Python")[0]
    return [line for line in commands(way, "sh") if " demo " not in line]


def from_how_to():
    """What the pages for each kind of laboratory add to the quickstart and the examples of ``--help``."""
    pages = [QUICKSTART, *sorted((ROOT / "docs/howto").glob("*.md"))]
    lines = [line for page in pages for line in commands(page.read_text(encoding="utf-8"), "sh")]
    return [
        line
        for line in dict.fromkeys(lines)
        if line not in {*from_quickstart(), *from_help()} and " demo " not in line
    ]


@functools.cache
def from_help():
    """The example under the help of every command and group."""
    found, waiting = [], [typer.main.get_command(app)]
    while waiting:
        command = waiting.pop(0)
        waiting += getattr(command, "commands", {}).values()
        assert command.epilog, command.name
        found.append(command.epilog.removeprefix("Example: "))
    return tuple(dict.fromkeys(found))


ENDLESS = {"monitor", "publish"}
"""Commands that go on until they are told to end."""


@pytest.fixture(autouse=True)
def hears_ctrl_c():
    """Let children hear Ctrl-C even where the tests run in the background of a shell, which has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, demo_run):
    """A copy of what the demo wrote: examples write into it."""
    made = tmp_path_factory.mktemp("build") / "demo"
    shutil.copytree(demo_run[0], made)
    for more in sorted((made / "runs").glob("*"))[2:]:  # two of them show how several are worked out
        more.unlink()
    return made


def words_of(line):
    """Words as a shell gives them."""
    return with_files(shlex.split(line)[1:])


def test_quickstart_leads_from_the_recorders_files_to_the_force(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    lines = from_quickstart()
    assert 3 <= len(lines) <= 8
    assert set(commands(README.read_text(encoding="utf-8"))) <= {*lines, "aerobalance demo"}
    for line in lines:
        assert main(words_of(line)) == 0, (line, capsys.readouterr().err)
    assert lines[-1].split()[1] == "force"
    made = read_dynamics("dynamics.json")["AF"]
    for name in ("mass", "stiffness", "damping"):
        value, u = getattr(made, name), made.uncertainty(name)
        # the rig's own values; one of three leaves five of its standard uncertainties once in 600 000 demos
        assert abs(value - getattr(CABLE_CUT.dynamics, name)) < 5 * u, (name, value, u)
    force, truth = (np.loadtxt(name, delimiter=",", skiprows=1) for name in ("force.csv", "truth.csv"))
    error, u = force[:, 1] - truth[:, 1], force[:, 2]
    # the truth is that of the simulation; a third of the error is common to all samples, so its mean square scatters
    assert np.sqrt(np.mean(error**2)) < 3 * np.sqrt(np.mean(u**2))
    assert np.sqrt(np.mean(u**2)) < 1.0  # of a load of 200 N with gusts of 40 N through the resonance


def test_quickstart_in_python_gives_the_same_force(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    _, way = python(QUICKSTART.read_text(encoding="utf-8"))
    names = {}
    exec(way, names)
    assert "AF" in capsys.readouterr().out
    force = names["force"]["AF"]
    truth = np.loadtxt("truth.csv", delimiter=",", skiprows=1)[:, 1]
    # as on the command line
    assert np.sqrt(np.mean((force.values - truth) ** 2)) < 3 * np.sqrt(np.mean(force.uncertainty**2))
    assert np.sqrt(np.mean(force.uncertainty**2)) < 1.0


def block(page, place=0):
    """A Python block of a page."""
    return python((ROOT / page).read_text(encoding="utf-8"))[place]


def test_python_of_the_readme_gives_a_force_that_can_be_used(folder, monkeypatch):
    monkeypatch.chdir(folder)
    names = {}
    exec(block("README.md"), names)
    assert str(names["force"].verdict) == "fit for use"  # the dynamics are those that the rig was built with
    # and what speaks against a force is told, of one by other dynamics: a tenth is 5 % in frequency
    names |= {"run": names["run"], "dynamics": ab.Dynamics("AF", mass=177.87, stiffness=3.4e7, damping=828.21)}
    with pytest.warns(DataQualityWarning):
        exec(block("docs/doubts.md"), names)
    assert names["doubt"].component == "AF"
    assert names["doubt"].text


def test_python_of_the_page_on_planning_says_what_limits_a_test(capsys):
    names = {}
    exec(block("docs/planning.md"), names)
    *rows, advice = capsys.readouterr().out.splitlines()
    assert len(rows) == len(names["found"]["AF"].table)
    totals = [float(row.split()[1]) for row in rows]
    assert totals == sorted(totals)  # more bandwidth is more noise
    assert "AF" in advice


RATE, SECONDS = 25_000, 1


class Blocks:
    """A device that gives a recording in blocks, until there are no more."""

    def __init__(self, columns, size=500):
        self.columns, self.size, self.place = columns, size, 0

    def read(self):
        part = slice(self.place, self.place + self.size)
        self.place += self.size
        values = {name: column[part] for name, column in self.columns.items()}
        return SimpleNamespace(**values, columns=values) if self.place <= RATE * SECONDS else None


def test_python_of_the_page_on_live_forces_gives_them_as_readings_come(rng):
    # a steady load, whose force is the same
    noise = rng.normal(size=(3, RATE * SECONDS))
    source = Blocks({"load": 100 + noise[0], "acceleration": 1e-3 * noise[1], "pitch": 0 * noise[2]})
    seen = []
    names = {
        "dynamics": CABLE_CUT.dynamics,
        "source": source,
        "show": lambda *given: seen.append(given),
    }
    exec(block("docs/live.md"), names)
    count = sum(force.size for _, force, _, _ in seen) + names["found"].force.size
    assert 0.9 * RATE * SECONDS < count * names["live"].factor <= RATE * SECONDS
    # a mean of readings with 1 N of noise and, at most, the 1 mm/s^2 of the acceleration: five standard errors
    late = np.concatenate([force for time, force, _, _ in seen if time.size and time[0] > SECONDS / 2])
    count = late.size * names["live"].factor
    assert late.mean() == pytest.approx(100, abs=5 * np.hypot(1.0, 1e-3 * CABLE_CUT.dynamics.mass) / np.sqrt(count))
    assert seen[0][-1] is None  # nothing is known of its health before there is a force
    assert seen[-1][-1].missing == 0


def test_python_of_the_page_on_live_forces_gives_those_of_six_components(rng):
    dynamics = random_balance(rng).dynamics
    noise = {name: rng.normal(size=RATE * SECONDS) for name in dynamics.components}
    seen = []
    names = {"ab": ab, "dynamics": dynamics, "source": Blocks(noise), "show": lambda *given: seen.append(given)}
    exec(block("docs/live.md", 1), names)
    force, u, _ = seen[-1]
    assert force.size and np.isfinite(u).all()
    # of forces that are none and forces found from noise of 1 N*m alone, nine in ten within two u
    late = seen[len(seen) // 2 :]
    within = np.concatenate([np.abs(force) < 2 * u for force, u, _ in late])
    assert within.mean() > 0.9
    assert set(names["found"]) == set(dynamics.components)


def test_python_of_the_page_on_taps_tells_the_dynamics(rng):
    inertia = np.diag([1 / (2 * np.pi * f) ** 2 for f in (60.0, 80.0)])
    truth = CoupledDynamics(("NF", "SF"), inertia, 0.04 * np.sqrt(inertia))
    tapped = [((0.0, 0.0, 0.0), (0.0, 0.0, -1.0)), ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    recordings = []
    for place, direction in tapped:
        loads = ab.TapPoint(place, direction).loads[[0, 2]]
        blows = (Blow(0.2, 1000.0, 0.003),)
        one = Tapping(truth, loads, blows, noise=np.ones(2), rest=np.zeros(2), rate=4000.0)
        recordings.append(one.record(1.7, rng))
    names = {"recordings": recordings, "tapped": tapped, "mass": None}
    exec(block("docs/taps.md"), names)
    modes = names["found"].dynamics.modes
    assert [mode.natural_frequency for mode in modes] == pytest.approx([60.0, 80.0], rel=1e-3)
    assert names["found"].verdict == "fit for use"


def test_python_of_the_page_on_campaigns_reads_what_one_wrote(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    line = commands((ROOT / "docs/campaign.md").read_text(encoding="utf-8"))[0]
    assert main(words_of(line)) == 0, capsys.readouterr().err
    names = {}
    exec(block("docs/campaign.md"), names)
    assert (names["table"].status == "reduced").all()
    assert len(names["table"]) == len(list((folder / "runs").iterdir()))


def tables(page, *languages):
    """The blocks of a page that are TOML."""
    return [body for kind, body in fenced((ROOT / page).read_text(encoding="utf-8")) if kind in languages]


@pytest.mark.parametrize("page", ["docs/monitor.md", "docs/sources.md"])
def test_tables_of_the_pages_are_taken_by_a_set_up(page):
    found = tables(page, "toml")
    assert len(found) >= 3
    sources = [text for text in found if "[source]" in text]
    for text in found:
        # what a page shows of one table stands beside those that say where the readings come from
        setup_from(tomllib.loads(text if text in sources else f'{text}\n[source]\nkind = "simulated"\n'))


def test_the_test_file_of_the_page_on_campaigns_is_one():
    (text,) = [body for body in tables("docs/campaign.md", "") if "[[setups]]" in body]
    found = definition_from(tomllib.loads(text))
    assert [setup.balance for setup in found.setups] == ["balance.json", "balance_2.json"]
    assert re.search(found.runs.pattern, "runs/run_201_a-2.5.h5").groupdict() == {"run": "201", "alpha": "-2.5"}


def test_the_files_and_maps_of_the_page_on_files_are_read(tmp_path, rng):
    page = ROOT / "docs/files.md"
    first = next(body for body in tables(page, "") if body.startswith("time [s],AF [N]"))
    head, row = first.splitlines()[:2]
    assert row.startswith("0.000,")
    rows = [f"{k / 1000:.3f},{row.split(',', 1)[1]}" for k in range(40)]
    (tmp_path / "run.csv").write_text("\n".join([head, *rows]) + "\n")
    found = ab.read(tmp_path / "run.csv")
    assert {"AF", "ground_acceleration", "pitch"} <= set(found.channels)
    sensor = next(body for body in tables(page, "") if "cross_axis" in body)
    tap = next(body for body in tables("docs/taps.md", "") if "impact_force" in body)
    names = ["a_x", "a_y", "a_z", "Hammer"]
    rows = [",".join(f"{one:.6g}" for one in (k / 1000, *rng.normal(size=4))) for k in range(40)]
    (tmp_path / "lab.csv").write_text("\n".join([",".join(["time [s]", *names]), *rows]) + "\n")
    more = [f'[channels.ground_acceleration_{axis}]\ncolumn = "a_{axis}"\nunit = "g"\n' for axis in "yz"]
    (tmp_path / "map.toml").write_text("\n".join([sensor, tap, *more]))
    found = ab.read(tmp_path / "lab.csv", channel_map=tmp_path / "map.toml")
    ground = found.channel("ground_acceleration")
    assert ground.relative_uncertainty == 0.01
    assert [one.channel for one in ground.cross_axis] == ["ground_acceleration_z", "ground_acceleration_y"]
    assert found.channel("impact_force").place == (-0.25, 0.0, 0.02)


def test_the_line_of_the_page_on_files_makes_one_recording_of_two(tmp_path, rng, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (line,) = [one for one in commands((ROOT / "docs/files.md").read_text(encoding="utf-8")) if "loads.tdms" in one]

    def turned(rate):
        """Pitch of 0-40 Hz that both systems read [deg], and its times [s]."""
        time = np.arange(int(8 * rate)) / rate
        return time, sum(np.cos(2 * np.pi * f * time + phase) for f, phase in motion)

    motion = list(zip(rng.uniform(0.5, 40, 60), rng.uniform(0, 6, 60), strict=True))
    _, pitch = turned(2000.0)
    settings = {"wf_increment": 1 / 2000.0, "wf_xname": "Time", "wf_xunit_string": "s"}
    with TdmsWriter(tmp_path / "loads.tdms") as file:
        for name, values in (("Kanal 1", rng.normal(size=pitch.size)), ("Winkel", pitch)):
            file.write_segment([ChannelObject("run", name, values, properties=settings)])
    time, pitch = turned(1000.0)
    with MDF(version="4.10") as file:
        file.append([Signal(rng.normal(size=time.size), time, name="a_x"), Signal(pitch, time, name="angle")])
        file.save(tmp_path / "accelerations.mf4")
    angle = '[channels.pitch]\ncolumn = "{}"\nunit = "deg"\n'
    (tmp_path / "loads.toml").write_text(f'[channels.AF]\ncolumn = "Kanal 1"\nunit = "N"\n{angle.format("Winkel")}')
    (tmp_path / "accelerations.toml").write_text(
        f'[channels.ground_acceleration]\ncolumn = "a_x"\nunit = "m/s^2"\n{angle.format("angle")}'
    )
    assert main(words_of(line)) == 0, capsys.readouterr().err
    found = ab.read("run.h5")
    assert {"AF", "ground_acceleration", "pitch"} <= set(found.channels)
    assert found.rate == pytest.approx(2000.0)


def test_the_line_of_the_page_on_campaigns_takes_a_test_file(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(folder / "runs", "runs")
    shutil.copy(folder / "dynamics.json", ".")
    line = commands((ROOT / "docs/campaign.md").read_text(encoding="utf-8"))[1]
    (tmp_path / "test.toml").write_text('[runs]\nfiles = "runs/*"\n[[setups]]\ndynamics = "dynamics.json"\n')
    assert main(words_of(line)) == 0, capsys.readouterr().err
    assert (tmp_path / "results" / "summary.parquet").stat().st_size > 0


@pytest.mark.parametrize("line", from_how_to())
def test_line_of_how_to_runs_as_printed(line, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(words_of(line)) == 0, capsys.readouterr().err


@pytest.mark.parametrize("line", [line for line in from_help() if line.split()[1] not in {*ENDLESS, "record", "demo"}])
def test_example_of_help_runs_as_printed(line, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(words_of(line)) == 0, capsys.readouterr().err
    out = capsys.readouterr().out
    assert out.strip()
    if " -o " in line:
        name = line.split(" -o ")[1].split()[0]
        assert (folder / name).stat().st_size > 0
        assert re.search(rf"^(written|replaced): {re.escape(name)}$", out, flags=re.MULTILINE)


@pytest.mark.parametrize("line", [line for line in from_help() if "identify decay" in line or " plan " in line])
def test_help_has_no_words_of_a_programmer(line, capsys):
    command = line.split(" -")[0].split()[1:]
    assert main([*(word for word in command if "." not in word), "--help"]) == 0
    said = capsys.readouterr().out
    # one dot after another where several files may be given, as {REC}...
    assert not re.search(r"list\[|<str>|<int|<float|<Path|\.\.\.\}", said), said


def test_example_of_the_demo_is_the_one_that_is_made():
    assert "aerobalance demo --out build/demo" in from_help()
    assert "$(BIN)/aerobalance demo --out build/demo" in (ROOT / "Makefile").read_text()


def test_example_of_record_runs(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    (line,) = [line for line in from_help() if line.split()[1] == "record"]
    assert main([*words_of(line), "--seconds", "1"]) == 0  # it takes as long as it records
    assert re.search(r"^recorded\.h5: .* samples of each channel in \d+ blocks", capsys.readouterr().out)
    assert main(["info", line.split(" -o ")[1]]) == 0


@pytest.mark.parametrize("name", sorted(ENDLESS))
def test_example_without_an_end_runs_until_it_is_told_to_end(name, folder):
    if name == "publish":
        pytest.importorskip("opendaq", reason="openDAQ is an option that is not installed here")
    (line,) = [line for line in from_help() if line.split()[1] == name]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # other programs of this computer may have the port that is printed
    more = ["--port", str(port), *(["--no-browser"] if name == "monitor" else [])]
    command = [sys.executable, "-u", "-m", "aerobalance.app.cli", *words_of(line), *more]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        said = running.stdout.readline()
        running.send_signal(signal.SIGINT)
        rest, err = running.communicate(timeout=WAIT)
    assert running.returncode == 0, (said, rest, err)
    assert str(port) in said
