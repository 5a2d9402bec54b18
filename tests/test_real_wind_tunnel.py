"""A model on an internal balance in a real tunnel: calibration, weighing and loads from the files as they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main

DATA = Path(__file__).parents[2] / "shared" / "data" / "internal-balance"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not part of the project")

AXIAL_CAPACITY = 25 * 4.4482216152605  # 25 lbf
BRIDGES = {
    "rN1": "N1",
    "rN2": "N2",
    "rY1": "Y1",
    "rY2": "Y2",
    "rAx": "Axial",
    "rRoll": "Roll",
    "excitation": "Excitation",
}
ANGLES = ("-8.0", "0.0", "4.0", "8.0", "12.0", "16.0", "20.0")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Channel map and matrix."""
    here = tmp_path_factory.mktemp("tunnel")
    tables = [f'[channels.{name}]\ncolumn = "{column}"\nunit = "V"\n' for name, column in BRIDGES.items()]
    tables.append('[channels.pitch]\ncolumn = "Alpha"\nunit = "deg"\n')
    (here / "map.toml").write_text("\n".join(tables))
    assert main(["calibrate", str(DATA / "100lb_2025-06.vol"), "-o", str(here / "balance.json")]) == 0
    return here


def run(capsys, *arguments):
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_wind_off_runs_weigh_the_model(folder, capsys):
    off = [DATA / f"airOff_alpha_{angle}.tdms" for angle in ANGLES]
    options = ["--balance", folder / "balance.json", "--map", folder / "map.toml"]
    account = run(capsys, "weigh", *off, *options)
    mass = account["components"]["AF"]["mass"]
    # a line through the axial readings over sin(alpha) gave 0.553 kg, with a residual of 0.007 % of capacity
    assert mass["value"] == pytest.approx(0.553, rel=0.005)
    assert account["residual_standard_deviation"]["AF"]["value"] < 1e-4 * AXIAL_CAPACITY
    alone = run(capsys, "weigh", *off, *options, "--component", "AF")
    assert alone["mass"]["value"] == pytest.approx(0.553, rel=0.005)


def test_wind_on_runs_reduce_to_loads(folder, capsys, tmp_path):
    tares = [part for angle in ANGLES for part in ("--tare", DATA / f"airOff_alpha_{angle}.tdms")]
    options = ["--balance", folder / "balance.json", "--map", folder / "map.toml"]
    normal = []
    for angle in ANGLES:
        out = tmp_path / f"on{angle}.csv"
        account = run(capsys, "loads", DATA / f"airOn_alpha_{angle}.tdms", *options, *tares, "-o", out)
        assert list(account["components"]) == ["NF", "PM", "SF", "YM", "RM", "AF"]
        assert account["beyond_calibrated_range"] == {}
        normal.append(account["components"]["NF"]["mean"])
        still = run(capsys, "loads", DATA / f"airOff_alpha_{angle}.tdms", *options, *tares, "-o", out)
        for name, entry in still["components"].items():
            # its own wind-off loads taken off leave nothing: the mean of both is the same mean
            assert abs(entry["mean"]) < 1e-3 * entry["u_calibration_rms"] + 1e-6, name
    # lift grows with the angle of attack below stall, and the matrix and the zeros decide where it is nothing
    assert np.all(np.diff(normal) > 0)


def test_the_drifting_balance_is_refused(capsys):
    assert main(["calibrate", str(DATA / "50lb_drifting_bridges.vol")]) == 1
    error = capsys.readouterr().err
    assert all(name in error for name in ("Fwd_Pitch", "Fwd_Yaw", "Roll"))
