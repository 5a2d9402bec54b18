"""Ground channels that are brought to what the load shows of the motion, on request."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli.program import main
from aerobalance.estimation.applied_force import Force
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.errors import DataQualityWarning
from faults.cases import all_cases
from faults.trials import recording_of, scores, worked_out
from seeds import trials

CASES = {case.name: case for case in all_cases()}


def tried(name: str, seed: int, *, align: bool) -> tuple[Force, dict[str, float]]:
    case = CASES[name]
    record = case.record(seed)
    force, said = worked_out(record, case.dynamics, {"align": align})
    assert force is not None, said
    return force, scores(force.only.values, force.only.uncertainty, record.force)


@pytest.mark.parametrize(
    "name",
    [
        "accelerometer 1 ms late, 0-60 Hz",
        "accelerometer 0.5 ms early, 0-60 Hz",
        "accelerometer 0.1 ms late, 0-20 Hz",
        "accelerometer gain 10 %, 0-60 Hz",
    ],
)
@pytest.mark.soak(first=0)
def test_a_fault_that_the_load_shows_clearly_leaves_nothing(name):
    _, before = tried(name, 0, align=False)
    force, after = tried(name, 0, align=True)
    assert after["error"] < 0.05 * before["error"]
    # as without the fault: a tenth of the 4000 samples is independent, and the noise is known to some per cent
    assert after["error"] / after["u"] == pytest.approx(1.0, abs=0.25)
    assert after["cover"] > 0.9
    (doubt,) = force.doubts
    assert doubt.effect == 0.0
    assert "taken into account, as asked" in doubt.text
    assert force.verdict == "fit for use"
    assert force.only.budget["alignment of ground_acceleration"] > 0


@pytest.mark.parametrize("name", ["pitch 20 ms late, 0-60 Hz", "pitch 20 ms late, step", "step, pitching"])
@pytest.mark.soak(first=1)
def test_what_is_not_known_of_an_alignment_counts(name):
    whole = []
    count = trials(2, 12)
    for seed in range(count):
        _, after = tried(name, seed, align=True)
        whole.append((after["error"] / after["u"]) ** 2)
    # a delay and a gain are two numbers, and the error of one record is theirs
    assert np.mean(whole) < 1 + 5 * np.sqrt(2 / (2 * count))


@pytest.mark.parametrize("name", ["pitch 20 ms late, 0-60 Hz", "pitch 20 ms late, step"])
@pytest.mark.soak(first=1)
def test_a_late_inclinometer_is_named_below_4_hz(name):
    force, found = tried(name, 0, align=False)
    doubt = max(force.doubts, key=lambda one: one.effect or 0.0)
    assert doubt.kind == "attitude delay"
    value, u = (float(part.split(" ms")[0]) for part in (doubt.text.split(" is ")[1], doubt.text.split("(u = ")[1]))
    assert value == pytest.approx(20.0, abs=4 * u)
    assert 0.5 < found["error"] / found["u"] < 2


def test_the_command_aligns_and_says_so(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    case = CASES["accelerometer 1 ms late, 0-60 Hz"]
    write_recording(tmp_path / "run.h5", recording_of(case.record(0), "run"))
    write_dynamics(tmp_path / "d.json", {"AF": case.dynamics})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        assert main(["force", "run.h5", "--dynamics", "d.json", "-o", "f.csv", "--json", "--align"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["verdict"] == "fit for use"
    (doubt,) = result["doubts"]
    assert doubt["kind"] == "ground delay"
    assert doubt["effect"] == 0
    assert "was 1 ms late" in doubt["text"]
