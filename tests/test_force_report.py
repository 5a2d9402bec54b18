"""The page of a force says what was used and how the mean load becomes the mean force."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from aerobalance.app.cli.program import main
from aerobalance.app.reports.force_curves import BEFORE, CLOSE, ForceCurves
from aerobalance.app.reports.page import sentence
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.parts import parts_of
from aerobalance.recording.recording import Recording
from aerobalance.uncertainty.budget import beyond_its_extremes

MASS, STIFFNESS, PITCH, FORCE = 178.0, 3.09e7, np.radians(2.5), 200.0


def cells(page: str) -> list[list[str]]:
    """Cells of all rows of all tables."""
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", page, flags=re.DOTALL)
    return [
        [unescape(re.sub(r"<[^>]+>", "", one)).strip() for one in re.findall(r"<t[hd].*?</t[hd]>", row)]
        for row in rows
    ]


def reported(folder: Path, monkeypatch, capsys, dynamics, *, components=("AF",), tones=()) -> tuple[dict, str]:
    """A steady force under the weight, as the command works it out; 1 N of noise on a reading; tones in Hz and N."""
    generator = np.random.default_rng(11)
    time = np.arange(3200) / 1600
    weight = MASS * STANDARD_GRAVITY * np.sin(PITCH)
    channels = {"pitch": Channel("pitch", np.full(time.size, PITCH), "rad")}
    for name in components:
        load = FORCE + (weight if name == "AF" else 0.0) + generator.normal(0, 1, time.size)
        load += sum(size * np.sin(2 * np.pi * frequency * time) for frequency, size in tones)
        channels[name] = Channel(name, load, si_unit(name))
    run = Recording.from_columns(time, channels, name="run")
    monkeypatch.chdir(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        write_recording(folder / "run.h5", replace(run, epoch=np.datetime64("2024-03-12T08:30:00", "us")))
        write_dynamics(folder / "d.json", dynamics)
        assert main(["force", "run.h5", "--dynamics", "d.json", "-o", "f.csv", "--json", "--report", "r.html"]) == 0
    return json.loads(capsys.readouterr().out), Path("r.html").read_text(encoding="utf-8")


def test_the_page_says_what_was_used_and_leads_from_load_to_force(tmp_path, monkeypatch, capsys) -> None:
    damping = 2 * 0.006 * np.sqrt(STIFFNESS * MASS)
    own = Dynamics("AF", MASS, STIFFNESS, damping, covariance=np.diag([0.25, 1e8, 4.0, 0.0]))
    found, page = reported(tmp_path, monkeypatch, capsys, {"AF": own})
    part = found["components"]["AF"]
    weight = MASS * STANDARD_GRAVITY * np.sin(PITCH)
    # six standard deviations of a mean of 3200 readings
    assert part["mean_load"] == pytest.approx(FORCE + weight, abs=6 / np.sqrt(3200))
    assert part["mean_weight"] == pytest.approx(weight, rel=1e-9)
    assert part["mean_load"] - part["mean_weight"] == pytest.approx(part["mean"], abs=6 * part["u_mean"])
    rows = cells(page)
    assert ["AF", "Mass", "178.00 ± 0.50", "kg"] in rows
    assert ["AF", "Stiffness", "30900000 ± 10000", "N/m"] in rows
    # the root of (2 / 890)^2 + (0.5 / 178 / 2)^2 + (1e4 / 3.09e7 / 2)^2 of the damping ratio
    assert ["AF", "Damping ratio", "0.006000 ± 0.000016", ""] in rows
    assert ["record", "Duration", "2", "s"] in rows
    assert ["record", "Sampling rate", "1600", "Hz"] in rows
    assert ["record", "First sample", "2024-03-12 08:30:00.000", ""] in rows
    assert [row[1] for row in rows if row[0] == "Mean weight in it, taken off"] == ["76.141"]
    assert "ground_acceleration is not recorded" in page


def test_an_rms_beyond_the_largest_value_is_explained_where_it_stands(tmp_path, monkeypatch, capsys) -> None:
    """A steady force: the estimate is all but flat, and what may be there unseen is as large as its uncertainty."""
    damping = 2 * 0.006 * np.sqrt(STIFFNESS * MASS)
    found, page = reported(tmp_path, monkeypatch, capsys, {"AF": Dynamics("AF", MASS, STIFFNESS, damping)})
    part = found["components"]["AF"]
    farthest = max(part["largest"] - part["mean"], part["mean"] - part["least"])
    assert part["rms_about_mean"] > farthest
    text = (
        f"rms about the mean, {part['rms_about_mean']:.3g} N, is more than the largest and the least value are from "
        f"the mean, {farthest:.2g} N, as these are of the estimate"
    )
    assert text in page
    assert main(["force", "run.h5", "--dynamics", "d.json", "-o", "f.csv"]) == 0
    assert f"AF: the {text}" in capsys.readouterr().out
    loud = part | {"largest": part["mean"] + 1.01 * part["rms_about_mean"]}
    assert beyond_its_extremes(loud, "N") == ""


def test_steady_tones_are_listed_with_their_amplitudes_in_the_force(tmp_path, monkeypatch, capsys) -> None:
    damping = 2 * 0.006 * np.sqrt(STIFFNESS * MASS)
    own = Dynamics("AF", MASS, STIFFNESS, damping)
    driven = ((8.0, 90.0), (16.0, 45.0), (24.0, 30.0))
    found, page = reported(tmp_path, monkeypatch, capsys, {"AF": own}, tones=driven)
    tones = found["components"]["AF"]["tones"]
    shown = [[f"{one['frequency']:.5g}", f"{one['amplitude']:.4g}"] for one in tones]
    assert [row for row in cells(page) if row in shown] == shown
    # 1 N of noise in 3200 readings leaves 0.025 N of an amplitude, and as much by its frequency: eight times as much
    for (frequency, size), one in zip(driven, tones, strict=True):
        assert one["amplitude"] == pytest.approx(size / abs(own.response(frequency)), abs=0.4)
        assert one["frequency"] == pytest.approx(frequency, abs=0.01)


def test_of_coupled_components_the_modes_are_listed(tmp_path, monkeypatch, capsys) -> None:
    rate = 2 * np.pi * np.array([60.0, 90.0])
    inertia = np.diag(1 / rate**2)
    dynamics = CoupledDynamics(("NF", "PM"), inertia, np.diag(2 * 0.01 / rate))
    found, page = reported(tmp_path, monkeypatch, capsys, dynamics, components=("NF", "PM"))
    rows = [row for row in cells(page) if row[0] == "NF, PM"]
    assert [row[1] for row in rows] == ["Mode 1", "Mode 2"]
    assert rows[0][2].startswith("60 Hz, damping ratio 0.01")
    assert found["components"]["NF"]["mean_weight"] == 0.0  # no mass is known
    units = [found["components"][name]["spectrum"]["unit"] for name in ("NF", "PM")]
    assert units == ["N^2/Hz", "(N*m)^2/Hz"]


def test_a_sentence_begins_with_a_capital_but_not_in_a_channels_name() -> None:
    assert sentence("no filter is declared") == "No filter is declared"
    assert sentence("ground_acceleration is not recorded") == "ground_acceleration is not recorded"
    assert sentence("") == ""


def curves_of(load, force):
    """What a page keeps of a record of one part, by its load and force."""
    (part,) = parts_of(force.size, length=force.size, margin=0)
    one = SimpleNamespace(values=force, uncertainty=np.ones(force.size))

    class Found(dict):
        recording = SimpleNamespace(channel=lambda _: SimpleNamespace(values=load))

    given = SimpleNamespace(
        force=Found(AF=one), own=slice(0, force.size), part=part, first=0,
        values={"AF": force}, uncertainty={"AF": one.uncertainty},
    )  # fmt: skip
    curves = ForceCurves(force.size, 0.0)
    curves.add(given, "AF")
    return curves


@pytest.mark.parametrize("count", [2000, 200_000])
def test_missing_samples_leave_the_rest_of_a_curve(rng, count):
    load = rng.normal(size=count)
    load[::150] = np.nan
    load[count // 2 + 1 : count // 2 + 1000] = np.nan
    curves = curves_of(load, np.zeros(count))
    if curves.width == 1:
        np.testing.assert_array_equal(curves.load, load)
        return
    pieces = load[: count // curves.width * curves.width].reshape(-1, curves.width)
    known = np.isfinite(pieces)
    ends = [np.where(known, pieces, np.inf).min(axis=1), np.where(known, pieces, -np.inf).max(axis=1)]
    expected = np.where(known.any(axis=1), ends, np.nan)
    assert 1 <= np.isnan(expected[0]).sum() <= 1000 / curves.width
    np.testing.assert_array_equal(curves.load, expected.T.ravel())


def test_a_gap_in_the_force_is_no_step():
    force = np.zeros(20_000)
    force[3000:3400] = np.nan
    force[12_000:] = 1000.0
    view = curves_of(np.zeros(20_000), force).closer(SimpleNamespace(steps=("one",)))
    assert (view.first, view.size) == (11_999 - int(BEFORE * CLOSE), 1000.0)
