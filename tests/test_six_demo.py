"""The demonstration of six components, from the calibration stand to the page, on one balance."""

from __future__ import annotations

import hashlib
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.cli.program import with_files
from aerobalance.app.demos import six_demo
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.force import estimate_force
from aerobalance.io import read
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import warn_quality
from helpers.pages import ROOT, commands, python


@pytest.mark.slow
def test_six_components_from_millivolts_to_forces(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(six_demo, "DURATION", 0.2)  # a fifth of the run takes a fifth of the time
    monkeypatch.setattr(six_demo, "INSTANT", 0.12013)
    monkeypatch.setattr(six_demo, "RELEASE", 0.2)

    def doubted(*args: Any, **settings: Any) -> Force:
        warn_quality("the coupling is neglected")  # a run of a fifth of the length may show nothing of it
        return estimate_force(*args, **settings)

    monkeypatch.setattr(six_demo, "estimate_force", doubted)  # only the run that neglects the coupling calls it here
    # one seed: what is random about balances and noise is tested where each part is
    assert main(["demo", "--six", "--out", str(tmp_path), "--seed", "3", "--json"]) == 0
    account = json.loads(capsys.readouterr().out)
    for row in account["components"]:
        # 0.3 % of half range is what is promised; the ringing is some percent
        assert row["error_percent"] < 0.3, row
        assert row["error_percent"] < row["raw_percent"] / 20, row
        # an rms of correlated errors within a factor of three of what is said of it
        assert row["error_percent"] < 3 * row["uncertainty_percent"], row
        assert len(account["steps"][row["component"]]) == 1, row
    for mode in account["modes"]:
        assert mode["identified_frequency"] == pytest.approx(mode["natural_frequency"], rel=1e-4)
    # the zero of the calibration is taken, and the run that neglects the coupling says nothing of its own
    assert account["warnings"] == [], account["warnings"]
    truth, found = read(tmp_path / "truth.csv"), read(tmp_path / "force.csv")
    assert list(truth.channels) == list(COMPONENTS)
    inner = slice(round(0.05 * truth.samples), truth.samples - round(0.05 * truth.samples))  # as the page says
    calm = np.abs(truth.time[inner] - 0.12013) > 0.001
    for row in account["components"]:
        name, percent = row["component"], 100 / row["half_range"]
        error = percent * (found.channel(name).values - truth.channel(name).values)[inner]
        u = percent * found.channel(f"u_{name}").values[inner]
        # the files have the digits that matter
        assert row["error_percent"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-3), row
        assert row["calm_error_percent"] == pytest.approx(np.sqrt(np.mean(error[calm] ** 2)), rel=1e-3), row
        assert row["expanded_percent"] == pytest.approx(2 * np.sqrt(np.mean(u**2)), rel=1e-3), row
    page = (tmp_path / "six.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2
    assert "http" not in page
    for name in ("run.h5", "balance.json", "zero.h5", "dynamics.json", "truth.csv"):
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() in page, name
    monkeypatch.chdir(tmp_path)
    as_shown_on_the_pages(capsys)


def as_shown_on_the_pages(capsys: pytest.CaptureFixture[str]) -> None:
    """Run what the pages show in the folder of this demo; each way leads to the force that the demo wrote."""
    force = read("force.csv")
    made = [
        line for line in commands((ROOT / "docs/six.md").read_text(encoding="utf-8"), "bash") if " demo " not in line
    ]
    assert [line.split()[1] for line in made] == ["calibrate", "weigh", "identify", "force"]
    for line in made:
        assert main(with_files(shlex.split(line)[1:])) == 0, (line, capsys.readouterr().err)
    for name in COMPONENTS:
        again = read("force.csv").channel(name).values
        # what is written has the digits that matter
        np.testing.assert_allclose(
            again, force.channel(name).values, atol=0.01 * force.channel(f"u_{name}").values.min()
        )
    found: dict[str, Any] = {}
    for block in python((ROOT / "docs/python.md").read_text(encoding="utf-8")):
        exec(block, found)
    for name in COMPONENTS:
        u = force.channel(f"u_{name}").values
        assert np.max(np.abs(found["force"][name].values - force.channel(name).values) / u) < 0.01, name
    assert f"verdict: {found['force'].verdict}" in capsys.readouterr().out
    lift = found["found"]["C_wind"]
    assert lift.names[0] == "CL"
    # level wind at alpha, pressure and area as the page has them
    mean = {name: found["force"][name].values.mean() for name in ("NF", "AF")}
    by_hand = (mean["NF"] * np.cos(0.07) - mean["AF"] * np.sin(0.07)) / (1500.0 * 0.35)
    assert lift.values[0] == pytest.approx(by_hand, abs=4 * lift.errors.uncertainty()[0])


@pytest.mark.parametrize(
    ("errors", "verdict"),
    [((0.018, 0.019), "within U for every component"), ((0.018, 0.021), "beyond U: AF")],
)
def test_the_table_says_whether_an_error_is_within_the_expanded_uncertainty(
    errors: tuple[float, float], verdict: str
) -> None:
    rest = {"raw_percent": 5.0, "diagonal_percent": 1.0, "calm_error_percent": 0.01, "cover_percent": 95.0}
    rows = [
        {"component": name, "error_percent": error, "uncertainty_percent": 0.01, "expanded_percent": 0.02, **rest}
        for name, error in zip(("RM", "AF"), errors, strict=True)
    ]
    text = six_demo.summary({"modes": [], "components": rows, "page": "six.html", "seed": 4})
    assert "U (k = 2)" in text
    assert f"error of the coupled dynamics{': ' if 'within' in verdict else ' '}{verdict}" in text


def test_two_demonstrations_at_once_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["demo", "--six", "--tables", "--out", str(tmp_path)]) == 2
    assert "give one of them" in capsys.readouterr().err
