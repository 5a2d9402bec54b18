"""Taps from the command line: recordings in, dynamics and universal files out, modes of another program in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import pyuff

from aerobalance.app.cli import main
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import read_coupled, read_dynamics
from aerobalance.io.modal_uff import load_direction, read_modes
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import ReadError
from aerobalance.simulation.hammer import Blow
from aerobalance.simulation.six_balance import random_balance
from helpers.hammer import DAMPING, MASS, ONE, POINTS, STIFFNESS, one_tapped, ranges, six_tapped


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(capsys, *words: str) -> dict:
    code = main([*words, "--json"])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    return json.loads(printed.out)


def test_taps_of_one_component_become_dynamics_and_response_functions(here, rng, capsys):
    bounced = one_tapped(rng, extra=lambda made: (Blow(made[0].instant + 0.03, 300.0, 0.004),))
    write_recording(Path("taps.csv"), bounced)
    found = answer(
        capsys,
        *("identify", "impact", "taps.csv", "--component", "AF", "--mass", f"{MASS}"),
        *("-o", "dynamics.json", "--responses", "taps.uff"),
    )
    assert found["verdict"] == "fit for use"
    assert [doubt["kind"] for doubt in found["doubts"]] == ["double hit"]
    fit = found["components"]["AF"]["fit"]
    assert [tap["used"] for tap in fit["taps"]] == ["nothing", *["force and ringing"] * 3]
    assert 0.9 < fit["coherence"][0]["mean"]["AF"] < 1
    read = read_dynamics("dynamics.json")["AF"]
    assert abs(read.stiffness - STIFFNESS) < 5 * read.uncertainty("stiffness")
    assert abs(read.damping - DAMPING) < 5 * read.uncertainty("damping")
    sets = pyuff.UFF("taps.uff").read_sets()
    assert [one["type"] for one in sets] == [164, 15, 58, 58]
    response, coherence = sets[2:]
    assert (response["func_type"], coherence["func_type"]) == (4, 6)
    assert (response["rsp_node"], response["rsp_dir"], response["ref_node"], response["ref_dir"]) == (1, 1, 2, 1)
    true = ONE.response(response["x"])[:, 0, 0]
    near = np.abs(response["x"] - 66.4) < 5
    # 2 N of noise in 7500 readings over the least impulse of three taps: 0.013 of |H| of up to 50 at low frequencies,
    # and more where a tip that pushes for 4 ms gives less. A complex error of six times that has the chance exp(-36)
    time = np.arange(0, 0.004, 1 / 5000)
    impulse = np.abs(np.exp(-2j * np.pi * np.outer(response["x"], time)) @ Blow(0.0, 1500.0, 0.004).force(time)) / 5000
    u = 2.0 * np.sqrt(7500) / 5000 / (np.sqrt(3) * impulse)
    assert u[near].max() < 0.02
    assert (np.abs(response["data"] - true) < 6 * u).all()
    # another way: the half-power width of what the modal program reads is that of the damping
    inside = response["x"][np.abs(response["data"]) > np.abs(response["data"]).max() / np.sqrt(2)]
    assert np.ptp(inside) == pytest.approx(2 * 0.01 * 66.4, abs=2 * (response["x"][1] - response["x"][0]))


def test_six_components_from_files_with_points_on_the_command_line_and_in_a_map(here, rng, capsys):
    balance = random_balance(rng)
    names, at, way = [], [], []
    for number, (record, point) in enumerate(zip(six_tapped(balance, rng), POINTS, strict=True)):
        names.append(f"point_{number}.h5")
        write_recording(Path(names[-1]), record)
        at += ["--at", ",".join(f"{value:g}" for value in point.place)]
        way += ["--direction", ",".join(f"{value:g}" for value in point.direction)]
    sizes = [word for name, size in ranges(balance).items() for word in ("--half-range", f"{name}={size:.6f}")]
    words = ["identify", "impact", *names, "--component", "all", "--modes", "6", *at, *way, *sizes]
    found = answer(capsys, *words, "--mass", f"{balance.mass.mass}", "-o", "six.json", "--responses", "six.uff")
    assert found["verdict"] == "fit for use"
    read = read_coupled("six.json")
    error = (read.inertia - balance.dynamics.inertia).ravel() / np.sqrt(np.diag(read.covariance))[:36]
    assert np.max(np.abs(error)) < 5.5
    assert read.mass.mass == pytest.approx(balance.mass.mass)
    sets = [one for one in pyuff.UFF("six.uff").read_sets() if one["type"] == 58 and one["func_type"] == 4]
    assert len(sets) == 36
    assert {one["rsp_dir"] for one in sets} == {load_direction(name) for name in COMPONENTS} == {3, 5, 2, -6, -4, 1}
    assert [one["ref_dir"] for one in sets[::6]] == [-3, -3, -2, -2, -3, 1]


def test_a_channel_map_says_where_the_hammer_pushes(here, rng, capsys):
    point = POINTS[5]
    record = one_tapped(rng, blows=1)
    table = np.column_stack([record.time, record.channel("AF").values, record.channel("impact_force").values])
    np.savetxt("daq.csv", table, delimiter=",", header="t,A1,H1", comments="", fmt="%.9g")
    settings = f'unit = "N"\nplace = {list(point.place)}\naxis = "aft"\nrelative_uncertainty = 0.02\n'
    Path("map.toml").write_text(
        '[file]\ntime = "t"\ntime_unit = "s"\n\n[channels.AF]\ncolumn = "A1"\nunit = "N"\n\n'
        f'[channels.impact_force]\ncolumn = "H1"\n{settings}'
    )
    words = ("identify", "impact", "daq.csv", "--map", "map.toml", "--component", "AF", "--mass", f"{MASS}")
    found = answer(capsys, *words)
    assert found["components"]["AF"]["fit"]["points"] == ["(-300, 0, 0) mm along (1, 0, 0)"]
    assert found["verdict"] == "fit for use"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--component", "all"], "where was the model tapped"),
        (["--component", "AF"], "Missing option '--mass'"),
        (["--mass", "1", "--at", "1,2", "--direction", "up"], "--at must be three numbers"),
        (["--mass", "1", "--at", "0,0,0"], "needs both --at and --direction"),
        (["--mass", "1", "--at", "0,0,0", "--direction", "north"], "--direction must be aft, right, up"),
        (["--mass", "1", "--u-at", "0.01"], "go with --at and --direction"),
        (["--mass", "1", "--half-range", "AF=1"], "--half-range goes with --component all"),
    ],
)
def test_wrong_calls_end_with_two_and_say_what_is_allowed(here, rng, capsys, words, said):
    write_recording(Path("taps.csv"), one_tapped(rng, blows=1))
    assert main(["identify", "impact", "taps.csv", *words]) == 2
    assert said in capsys.readouterr().err


def dataset_55(pole: complex, shape: np.ndarray, *, number: int, kind: int = 5) -> str:
    """A mode as the description of the format has it: node 1, six directions x, y, z and about them."""
    directions = [load_direction(name) for name in COMPONENTS]
    full = np.zeros(6, dtype=complex)
    for place, direction in enumerate(directions):
        full[abs(direction) - 1] = np.sign(direction) * shape[place]
    analysis = 3 if kind == 5 else 2
    values = np.column_stack([full.real, full.imag]).ravel() if kind == 5 else full.real
    rate = abs(pole)
    head = [pole.real, pole.imag, 1.0, 0.0, 0.0, 0.0] if kind == 5 else [rate / 2 / np.pi, 1.0, -pole.real / rate, 0.0]
    lines = ["    -1", "    55", "mode", *["NONE"] * 4]
    lines += ["".join(f"{value:10d}" for value in (1, analysis, 3, 8, kind, 6))]
    lines += ["".join(f"{value:10d}" for value in (2, 6 if kind == 5 else 4, 0, number))]
    lines += ["".join(f"{value:13.5E}" for value in head), f"{1:10d}"]
    lines += ["".join(f"{value:13.5E}" for value in values[first : first + 6]) for first in range(0, values.size, 6)]
    return "\n".join([*lines, "    -1"]) + "\n"


def test_poles_and_shapes_of_a_modal_program_become_six_components(here, rng, capsys):
    balance = random_balance(rng)
    truth = balance.dynamics
    form = truth.modal_form
    up = np.flatnonzero(form.poles.imag > 0)
    text = "".join(
        dataset_55(form.poles[place], form.shapes[:, place] / np.abs(form.shapes[:, place]).max(), number=number)
        for number, place in enumerate(up, 1)
    )
    Path("modes.uff").write_text(text)
    words = ("--component", "all", "--mass", f"{balance.mass.mass}", "-o", "d.json")
    found = answer(capsys, "identify", "modes", "modes.uff", *words)
    assert any("no uncertainty is known" in text for text in found["warnings"])
    read = read_coupled("d.json")
    size = balance.half_range
    for mine, true in ((read.inertia, truth.inertia), (read.damping, truth.damping)):
        scaled = (mine - true) * size / size[:, None]
        # five decimals of the mantissa in poles and shapes, for damping over some 1 % of damping
        assert np.abs(scaled).max() < 0.05 * np.abs(true * size / size[:, None]).max()
    mine, true = ([mode.natural_frequency for mode in one.modes] for one in (read, truth))
    assert mine == pytest.approx(true, rel=2e-5)


def test_a_real_mode_written_by_another_library_becomes_one_component(here, capsys):
    mode = pyuff.prepare_55(
        model_type=1, id1="NONE", id2="NONE", id3="NONE", id4="NONE", id5="NONE", analysis_type=2, data_ch=2,
        spec_data_type=8, data_type=2, n_data_per_node=3, r1=np.array([1.0]), r2=np.array([0.0]), r3=np.array([0.0]),
        load_case=0, mode_n=1, freq=66.4, modal_m=1.0, modal_damp_vis=0.01, modal_damp_his=0.0,
        node_nums=np.array([1]),
    )  # fmt: skip
    pyuff.UFF("modes.uff").write_sets([mode], mode="overwrite")
    found = answer(capsys, "identify", "modes", "modes.uff", "--mass", f"{MASS}")
    assert found["components"]["AF"]["stiffness"]["value"] == pytest.approx(STIFFNESS, rel=1e-5)
    assert found["components"]["AF"]["damping"]["value"] == pytest.approx(DAMPING, rel=1e-5)


def test_files_without_modes_are_named(here, capsys):
    Path("text.uff").write_text("no modes\n")
    with pytest.raises(ReadError, match="it is no universal file"):
        read_modes(Path("text.uff"))
    whole = dataset_55(-4 + 417j, np.ones(6), number=1)
    for end in range(0, len(whole.rstrip().removesuffix("-1").rstrip()), 7):
        Path("cut.uff").write_text(whole[:end] + "\n    -1\n")
        with pytest.raises(ReadError):
            read_modes(Path("cut.uff"))
    Path("two.uff").write_text(whole + dataset_55(-4 + 500j, np.ones(6), number=2))
    assert main(["identify", "modes", "two.uff", "--mass", "1"]) == 2
    assert "has 2 (66.37, 79.58 Hz): choose one with --mode 1" in capsys.readouterr().err
    assert main(["identify", "modes", "two.uff", "--mass", "1", "--mode", "2"]) == 0
