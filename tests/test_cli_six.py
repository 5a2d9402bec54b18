"""The commands on coupled components, from files to files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.io import read, write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import Release, SixSimulation
from seeds import new_seed


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CoupledBalance, SixSimulation]:
    """A folder with the record of a release, run.h5, and the balance's dynamics.json."""
    rng = np.random.default_rng(new_seed())
    balance = random_balance(rng)
    rig = SixComponentRig(balance, releases=(Release(0.3 * balance.half_range, 0.1001),), output="loads")
    simulation = rig.run(0.25, rng)
    folder = tmp_path_factory.mktemp("six")
    write_recording(folder / "run.h5", simulation.recording)
    write_dynamics(folder / "dynamics.json", replace(balance.dynamics, mass=balance.mass))
    return folder, balance, simulation


@pytest.mark.soak(first=0)
def test_force_takes_a_file_of_coupled_dynamics(
    cut: tuple[Path, CoupledBalance, SixSimulation], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, balance, simulation = cut
    out = folder / "force.csv"
    assert (
        main(["force", str(folder / "run.h5"), "--dynamics", str(folder / "dynamics.json"), "-o", str(out), "--json"])
        == 0
    )
    account = json.loads(capsys.readouterr().out)
    found = read(out)
    for place, name in enumerate(COMPONENTS):
        steps = account["components"][name]["steps"]
        assert [step["instant"] for step in steps] == pytest.approx([0.1001], abs=4e-6), name
        error = found.channel(name).values - simulation.applied[:, place]
        error[np.abs(found.time - 0.1001) < 1e-4] = 0
        # 0.05 % of half range on the plateaus is what is promised
        assert np.sqrt(np.mean(error**2)) < 5e-4 * balance.half_range[place], name
        assert f"u_{name}" in found


def test_force_says_which_component_lacks(
    cut: tuple[Path, CoupledBalance, SixSimulation], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder, _, simulation = cut
    recording = simulation.recording
    channels = {name: channel for name, channel in recording.channels.items() if name != "RM"}
    write_recording(tmp_path / "five.h5", replace(recording, channels=channels))
    arguments = ["force", str(tmp_path / "five.h5"), "--dynamics", str(folder / "dynamics.json")]
    assert main([*arguments, "-o", str(tmp_path / "f.csv")]) == 1
    assert "has no RM" in capsys.readouterr().err
    assert not (tmp_path / "f.csv").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--component", "all", "--modes", "2"], "modes must be auto or 6 to 9"),
        (["--component", "all", "--half-range", "NF=x"], "such as NF=2000"),
        (["--component", "all", "--half-range", "NF=2000"], "PM, SF, YM, RM, AF are needed too"),
        (["--component", "AF"], "Missing option '--mass'"),
        (["--component", "AF", "--mass", "1", "--half-range", "AF=1"], "goes with --component all"),
    ],
)
def test_identify_decay_refuses_what_does_not_go_together(
    cut: tuple[Path, CoupledBalance, SixSimulation],
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    words: str,
) -> None:
    folder, *_ = cut
    assert main(["identify", "decay", str(folder / "run.h5"), *options]) == 2
    assert words in capsys.readouterr().err


def test_one_component_is_identified_from_one_recording(
    cut: tuple[Path, CoupledBalance, SixSimulation], capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(cut[0] / "run.h5")
    assert main(["identify", "decay", run, run, "--mass", "1"]) == 2
    assert "one component is identified from one" in capsys.readouterr().err
