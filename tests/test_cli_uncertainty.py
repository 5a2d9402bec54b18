"""The uncertainty as the command force gives it: numbers with their u, budget, Monte Carlo and page."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.recording.components import STANDARD_GRAVITY
from helpers.cable_cut import T128

MAP = """\
[file]
time = "time [s]"
[channels.AF]
column = "AF [N]"
[channels.pitch]
column = "pitch [deg]"
zero_uncertainty = 0.05
noise = 0.0
"""


@pytest.fixture
def here(tmp_path, monkeypatch, rng):
    """A folder with two tones and a weight at 5 degrees, a map that doubts the inclinometer's zero, and dynamics."""
    monkeypatch.chdir(tmp_path)
    time = np.arange(1200) / 1600
    force = 100 * np.sin(2 * np.pi * 9 * time) + 40 * np.sin(2 * np.pi * 23 * time)
    load = T128.balance_load(force, interval=1 / 1600) + T128.mass * STANDARD_GRAVITY * np.sin(np.deg2rad(5.0))
    columns = np.column_stack([time, load + 0.5 * rng.normal(size=time.size), np.full(time.size, 5.0)])
    np.savetxt("run.csv", columns, delimiter=",", header="time [s],AF [N],pitch [deg]", comments="", fmt="%.9g")
    Path("map.toml").write_text(MAP)
    relative = {"mass": (T128.mass, 2e-4), "stiffness": (T128.stiffness, 2e-4), "damping": (T128.damping, 1e-2)}
    entries = {name: {"value": value, "u": share * value} for name, (value, share) in relative.items()}
    Path("dynamics.json").write_text(json.dumps({"components": {"AF": entries}}))
    return tmp_path


def call(capsys, line):
    capsys.readouterr()
    code = main(f"force run.csv --map map.toml --dynamics dynamics.json -o f.csv {line}".split())
    out, err = capsys.readouterr()
    return code, out, err


def test_numbers_carry_their_uncertainty(here, capsys):
    code, out, _ = call(capsys, "--json --u-gravity 0.01")
    assert code == 0
    found = json.loads(out)["components"]["AF"]
    for name in ("mean", "rms_about_mean", "largest", "least"):
        assert isinstance(found[name], float)
        assert 0 < found[f"u_{name}"] < 5
    assert 0 <= found["instant_of_largest"] < 0.75
    rows = {row["name"]: row for row in found["budget"]}
    # M g cos(theta) u(theta) and M sin(theta) u(g), along the whole record
    weight = T128.mass * STANDARD_GRAVITY * np.cos(np.deg2rad(5.0))
    assert rows["pitch zero"]["u_mean"] == pytest.approx(weight * np.deg2rad(0.05), rel=1e-4)
    assert rows["gravity"]["rms"] == pytest.approx(T128.mass * np.sin(np.deg2rad(5.0)) * 0.01, rel=1e-4)
    assert rows["mass, stiffness, damping, delay"]["from"] == "dynamics.json"
    assert rows["noise of the readings"]["from"] == "AF, judged from the record"
    assert found["improve_first"].startswith(f"improve first {found['budget'][0]['name']}")
    density = found["spectrum"]
    assert len(density["frequency"]) == len(density["density"]) == len(density["u_force"]) == len(density["u_scatter"])


def test_monte_carlo_is_printed_and_repeats_itself(here, capsys):
    code, out, _ = call(capsys, "--monte-carlo 10 --seed 4 --verbose")
    assert code == 0
    assert "Monte Carlo of AF, 10 draws, seed 4" in out
    assert "uncertainty budget of AF [N]" in out
    accounts = [json.loads(call(capsys, f"--monte-carlo 10 --seed {seed} --json")[1]) for seed in (4, 4, 5)]
    one, same, other = (account["components"]["AF"]["monte_carlo"] for account in accounts)
    assert (one["draws"], one["seed"]) == (10, 4)
    assert one == same
    assert one["scalars"]["mean"] != other["scalars"]["mean"]
    low, high = one["scalars"]["mean"]["interval_95"]
    assert low < accounts[0]["components"]["AF"]["mean"] < high
    assert {"mass, stiffness, damping, delay", "pitch zero", "all together"} <= set(one["contributions"])


@pytest.mark.parametrize("option", ["", "--method paper", "--bandwidth 60"])
@pytest.mark.soak(first=1)
def test_page_stands_alone(option, here, capsys):
    code, _, _ = call(capsys, f"--report page.html --monte-carlo 10 {option}")
    assert code == 0
    page = Path("page.html").read_text()
    assert page.count("<svg") == 3
    assert not re.search(r"https?://", page)
    assert not re.search(r"\bnan\b|\binf\b|None", re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL))
    for text in ("Uncertainty budget", "Improve first", "pitch zero", "Monte Carlo", "run.csv", "map.toml"):
        assert text in page


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("--monte-carlo 3", "10"),
        ("--monte-carlo 10 --seed -1", "0"),
        ("--report run.csv", "is an input"),
        ("--report nowhere/page.html", "there is no folder nowhere"),
        ("--u-gravity -1", "0"),
    ],
)
def test_wrong_calls_are_refused(line, says, here, capsys):
    code, out, err = call(capsys, line)
    assert (code, out) == (2, "")
    assert says in err
    assert not Path("f.csv").exists()
