"""A release recorded as gauge outputs: identified for one component with the balance and the zeros of the day."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.simulation import Sweep, VibrationRig

MASS, FREQUENCY, RATIO = 20.0, 25.0, 0.01
SENSITIVITY = np.array([[0.01, 0.002], [-0.001, 0.05]])
"""rAF and rRM over AF and RM [mV/V/N, mV/V/(N*m)]."""

NATURAL = np.array([0.3, -0.2])
NOISE = 1e-5


def write(path: str, header: str, table: np.ndarray) -> None:
    Path(path).write_text("\n".join([header, *(",".join(f"{x:.12g}" for x in row) for row in table)]) + "\n")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Schedule, zeros before and after, and a release of 100 N; loads ring at 25 Hz with a damping ratio of 1 %."""
    monkeypatch.chdir(tmp_path)
    generator = np.random.default_rng(20260102)

    def outputs(loads: np.ndarray) -> np.ndarray:
        return loads @ SENSITIVITY.T + NATURAL + generator.normal(0, NOISE, loads.shape)

    steps = np.array([0, 0.5, 1, 0.5, 0, -0.5, -1, -0.5, 0])
    loads = np.zeros((18, 2))
    loads[:9, 0], loads[9:, 1] = 200 * steps, 10 * steps
    series = np.repeat([[1.0], [2.0]], 9, axis=0)
    schedule = np.hstack([series, loads, outputs(loads)])
    write("schedule.csv", "series,AF [N],RM [N*m],rAF [mV/V],rRM [mV/V]", schedule)
    time = np.arange(3000) / 1000.0
    since = np.maximum(time - 0.5, 0)
    w = 2 * np.pi * FREQUENCY
    turn = w * np.sqrt(1 - RATIO**2)
    ring = np.exp(-RATIO * w * since) * (np.cos(turn * since) + RATIO * w / turn * np.sin(turn * since))
    felt = np.column_stack([100 * ring, np.zeros(time.size)])
    header = "time [s],rAF [mV/V],rRM [mV/V]"
    write("release.csv", header, np.column_stack([time, outputs(felt)]))
    for name in ("before.csv", "after.csv"):
        write(name, header, np.column_stack([time[:400], outputs(np.zeros((400, 2)))]))
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    code = main([*arguments, "--json"])
    captured = capsys.readouterr()
    assert code == 0, captured.err
    return json.loads(captured.out)


def test_a_release_of_gauge_outputs_is_identified_with_the_balance(here, capsys):
    run(capsys, "calibrate", "schedule.csv", "--model", "linear", "-o", "balance.json")
    files = ("--balance", "balance.json", "--zero", "before.csv", "--zero-after", "after.csv")
    decay = ("identify", "decay", "release.csv", "--component", "AF", "--mass", str(MASS), *files)
    found = run(capsys, *decay, "--model-on-zero", "off", "-o", "dynamics.json")
    entry = found["components"]["AF"]
    stiffness = MASS * (2 * np.pi * FREQUENCY) ** 2
    for key, truth in (("stiffness", stiffness), ("damping", 2 * RATIO * MASS * 2 * np.pi * FREQUENCY)):
        assert entry[key]["u"] < 0.05 * truth
        assert entry[key]["value"] == pytest.approx(truth, abs=4 * entry[key]["u"]), key
    artefact = json.loads(Path("dynamics.json").read_text())
    names = [item["name"] for item in artefact["provenance"]["inputs"]]
    assert names == ["release.csv", "balance.json", "before.csv", "after.csv"]
    assert "sensitivity" in artefact["components"]["AF"]["fit"]["calibration_of_balance"]

    # the scale of the load drops out: a balance that reads 10 % too much gives the same dynamics
    balance = json.loads(Path("balance.json").read_text())
    balance["matrix"]["load_scale"] = [1.1 * scale for scale in balance["matrix"]["load_scale"]]
    Path("other.json").write_text(json.dumps(balance))
    other = run(capsys, *("other.json" if part == "balance.json" else part for part in decay))["components"]["AF"]
    assert other["stiffness"]["value"] == pytest.approx(entry["stiffness"]["value"], rel=1e-6)
    assert other["damping"]["value"] == pytest.approx(entry["damping"]["value"], rel=1e-4)


def test_the_advice_for_gauge_outputs_is_taken_by_the_next_command(here, capsys):
    run(capsys, "calibrate", "schedule.csv", "--model", "linear", "-o", "balance.json")
    decay = ("identify", "decay", "release.csv", "--component", "AF", "--mass", str(MASS))
    assert main([*decay]) == 1
    said = capsys.readouterr().err
    assert "identify decay and rig" in said
    assert "take --balance" in said
    assert main([*decay, "--balance", "balance.json", "--zero", "before.csv", "-o", "one.json"]) == 0
    # and the other way that it names, for commands without --balance
    assert "aerobalance loads --balance" in said
    assert main(["loads", "release.csv", "--balance", "balance.json", "--zero", "before.csv", "-o", "loads.csv"]) == 0
    assert main(["identify", "decay", "loads.csv", "--component", "AF", "--mass", str(MASS), "-o", "two.json"]) == 0
    one, two = (json.loads(Path(name).read_text())["components"]["AF"] for name in ("one.json", "two.json"))
    assert one["stiffness"]["value"] == pytest.approx(two["stiffness"]["value"], rel=1e-5)


def test_a_shaken_rig_of_gauge_outputs_has_the_sensitivity_in_its_mass(here, capsys):
    """The mass that a shaken record tells is in proportion to the sensitivity: 1 % of that is 1 % of the mass."""
    run(capsys, "calibrate", "schedule.csv", "--model", "linear", "-o", "balance.json")
    drive = Sweep(550.0, 850.0, 1.0)
    recording = VibrationRig().run(drive, np.random.default_rng(20260103)).recording
    load, ground = (recording.channel(name).values for name in ("AF", "ground_acceleration"))
    time = np.arange(load.size) / recording.rate
    outputs = np.column_stack([load, np.zeros(load.size)]) @ SENSITIVITY.T
    table = np.column_stack([time, outputs, ground])
    write("rig.csv", "time [s],rAF [mV/V],rRM [mV/V],ground_acceleration [m/s^2]", table)
    rig = ("identify", "rig", "rig.csv", "--component", "AF", "--zero", "none", "--balance")
    exact = run(capsys, *rig, "balance.json")["components"]["AF"]["mass"]
    balance = json.loads(Path("balance.json").read_text())
    matrix = balance["matrix"]
    own = matrix["coefficients"][0][0]
    matrix["covariance"][0][0][0] = (0.01 * own) ** 2
    Path("one percent.json").write_text(json.dumps(balance))
    found = run(capsys, *rig, "one percent.json")["components"]["AF"]["mass"]
    assert found["value"] == pytest.approx(exact["value"], rel=1e-6)
    assert np.hypot(exact["u"], 0.01 * exact["value"]) == pytest.approx(found["u"], rel=0.05)
