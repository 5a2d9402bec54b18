"""From gauge outputs to coupled dynamics and forces, and what a calibration leaves in them, on the command line."""

from __future__ import annotations

import hashlib
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.demos.six_demo import PULLED, DemoFolder, bearable, still, weighed
from aerobalance.io import read
from aerobalance.io.balance_file import write_balance
from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import Release
from aerobalance.simulation.six_signals import Band, broadband
from seeds import new_seed

LEFT = 1e-5
"""Standard uncertainty of every coefficient of the matrix, over capacity."""


class Found(NamedTuple):
    """Files of a balance, and what `identify` printed of its six releases."""

    folder: Path
    balance: CoupledBalance
    releases: list[str]
    account: dict


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    rng = np.random.default_rng(new_seed())
    balance = random_balance(rng)
    folder = DemoFolder(tmp_path_factory.mktemp("calibration"), rng)
    count = len(balance.matrix.terms)
    known = replace(balance.matrix, covariance=np.tile(LEFT**2 * np.eye(count), (6, 1, 1)))
    for name in ("balance", "other"):
        wrong = known.coefficients + LEFT * rng.normal(size=known.coefficients.shape)
        write_balance(folder.path / f"{name}.json", replace(known, coefficients=wrong), found={})
    folder.record("zero", replace(still(balance, 0.0, 0.0), rate=10_000.0), 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        weighed(folder, balance, BalanceFiles.of(folder.path / "balance.json"))
    releases = []
    for place, name in enumerate(COMPONENTS):
        load = np.where(np.arange(6) == place, PULLED * balance.half_range, 0.0)
        let_go = Release(bearable(balance, load), instant=0.05)
        rig = replace(still(balance, 0.0, 0.0), releases=(let_go,), rate=10_000.0)
        releases.append(str(folder.record(f"release_{name}", rig, 0.4)[0]))
    gusts = broadband(rng, Band(20, 400), rms=0.05 * balance.half_range, period=0.5)
    folder.record("run", replace(still(balance, 0.0, 0.0), applied=gusts, rate=10_000.0), 0.1)
    account = identify(folder.path, releases, "--balance", str(folder.path / "balance.json"))
    return Found(folder.path, balance, releases, account)


def identify(folder: Path, releases: list[str], *options: str, out: str = "dynamics.json") -> dict:
    settings = ["--component", "all", "--mass", str(folder / "mass.json"), "--zero", str(folder / "zero.h5")]
    assert main(["identify", "decay", *releases, *settings, *options, "-o", str(folder / out)]) == 0
    return json.loads((folder / out).read_text())


def test_uncertainties_hold_what_the_calibration_leaves(found: Found) -> None:
    dynamics = read_coupled(found.folder / "dynamics.json")
    digest = hashlib.sha256((found.folder / "balance.json").read_bytes()).hexdigest()
    assert dynamics.balance == found.account["calibration"]["balance"] == digest
    names = [entry["name"] for entry in found.account["provenance"]["inputs"]]
    assert {"balance.json", "zero.h5", "mass.json", "release_NF.h5"} <= set(names)
    truth = found.balance.dynamics
    error = np.concatenate([(dynamics.inertia - truth.inertia).ravel(), (dynamics.damping - truth.damping).ravel()])
    u = np.sqrt(np.diag(dynamics.total_covariance))
    # of 72 errors that go together none is six deviations off
    assert np.max(np.abs(error / u)) < 6
    np.testing.assert_array_equal(np.ravel(found.account["inertia"]["u"]), u[:36])
    for test in ("rigidity", "reciprocity"):
        assert found.account["fit"]["tests"][test]["p_value"] > 1e-6


@pytest.mark.soak(first=0)
def test_loads_files_give_the_same_dynamics_and_know_no_calibration(found: Found) -> None:
    loads = []
    for path in found.releases:
        loads.append(path.replace(".h5", "_loads.h5"))
        given = ["--balance", str(found.folder / "balance.json"), "--zero", str(found.folder / "zero.h5")]
        mass = ["--mass", str(found.folder / "mass.json")]
        assert main(["loads", path, *given, *mass, "-o", loads[-1]]) == 0
    out = found.folder / "from_loads.json"
    assert main(["identify", "decay", *loads, "--component", "all", "-o", str(out)]) == 0
    ours, theirs = read_coupled(found.folder / "dynamics.json"), read_coupled(out)
    u = np.sqrt(np.diag(ours.covariance))
    both = [np.concatenate([one.inertia.ravel(), one.damping.ravel()]) for one in (ours, theirs)]
    assert np.max(np.abs(both[0] - both[1]) / u) < 0.1  # where two fits settle
    assert not theirs.covariance_of_calibration.any()


@pytest.mark.soak(first=0)
@pytest.mark.slow
def test_force_counts_the_calibration_of_another_balance_and_not_its_own(
    found: Found, capsys: pytest.CaptureFixture[str]
) -> None:
    budgets, forces = [], []
    dynamics = found.folder / "dynamics.json"
    plain = found.folder / "plain.json"
    contents = json.loads(dynamics.read_text())
    own = read_coupled(dynamics)
    del contents["calibration"]
    for kind, part in zip(("inertia", "damping"), np.sqrt(np.diag(own.covariance)).reshape(2, 6, 6), strict=True):
        contents[kind]["u"] = part.tolist()
    plain.write_text(json.dumps(contents))
    for balance, given in (("balance", dynamics), ("balance", plain), ("other", dynamics)):
        out = found.folder / "force.csv"
        settings = ["--balance", str(found.folder / f"{balance}.json"), "--zero", str(found.folder / "zero.h5")]
        arguments = [
            "force",
            str(found.folder / "run.h5"),
            "--dynamics",
            str(given),
            *settings,
            "-o",
            str(out),
            "--json",
        ]
        capsys.readouterr()
        assert main(arguments) == 0
        printed = capsys.readouterr()
        assert ("another balance matrix than other.json" in printed.err) == (balance == "other")
        parts = json.loads(printed.out)["components"]
        budgets.append(np.array([sum(_of_dynamics(parts[name])) for name in COMPONENTS]))
        values = np.column_stack([read(out).channel(name).values for name in COMPONENTS])
        forces.append(values)
    np.testing.assert_array_equal(forces[0], forces[1])
    np.testing.assert_array_equal(budgets[0], budgets[1])
    assert (budgets[2] > budgets[0]).all()


def _of_dynamics(part: dict) -> list[float]:
    return [u for name, u in part["uncertainty_budget_rms"].items() if "inertia" in name]


def test_a_weight_that_is_not_known_is_told(found: Found) -> None:
    bare = found.folder / "without_natural_zeros.json"
    write_balance(bare, replace(found.balance.matrix, natural_zero=None), found={})
    files = BalanceFiles.of(bare, zero=[found.folder / "zero.h5"])
    with pytest.warns(DataQualityWarning, match="Give a weighing of all loads"):
        files.identification_loads([read(found.releases[0])], None, channel_map=None, calibration_counts=False)


def test_a_matrix_that_does_not_know_its_errors_is_told(found: Found) -> None:
    write_balance(found.folder / "exact.json", found.balance.matrix, found={})
    files = BalanceFiles.of(found.folder / "exact.json", zero=[found.folder / "zero.h5"], model_on_zero="off")
    with (
        pytest.warns(DataQualityWarning, match=r"the balance matrix holds no covariance"),
        pytest.warns(DataQualityWarning, match=r"from the natural zeros of the calibration, beyond the weight"),
    ):  # the model was on it
        files.identification_loads([read(found.releases[0])], None, channel_map=None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--component", "all", "--zero", "zero.h5"], "go with --balance"),
        (
            ["--component", "all", "--balance", "balance.json", "--model-on-zero", "on"],
            "give its recordings with --zero",
        ),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    found: Found, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, options: list[str], words: str
) -> None:
    monkeypatch.chdir(found.folder)
    assert main(["identify", "decay", found.releases[0], *options]) == 2
    assert words in capsys.readouterr().err


def test_gauge_outputs_without_a_balance_are_told_what_they_want(
    found: Found, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", "decay", found.releases[0], "--component", "all"]) == 1
    assert "identify decay and rig, force and compare take --balance" in capsys.readouterr().err
    out = str(found.folder / "not_written.csv")
    assert main(["force", found.releases[0], "--dynamics", str(found.folder / "dynamics.json"), "-o", out]) == 1
    assert "identify decay and rig, force and compare take --balance" in capsys.readouterr().err
