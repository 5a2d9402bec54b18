"""What is passed on: the wheel runs by itself, and the source distribution holds all that makes it."""

from __future__ import annotations

import json
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


def built(kind: str, source: Path, out: Path) -> Path:
    """The distribution that is made of a folder."""
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(out)],
        cwd=source,
        check=True,
        capture_output=True,
    )
    (made,) = out.iterdir()
    return made


def contents(wheel: Path) -> dict[str, bytes]:
    """Files of the program in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist() if name.startswith("aerobalance/")}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    return built("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


def test_source_distribution_has_all_files_and_makes_the_same_wheel(wheel, tmp_path) -> None:
    with tarfile.open(built("sdist", ROOT, tmp_path / "sdist")) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # from Python 3.11.4 on
        archive.extractall(tmp_path)
    (source,) = tmp_path.glob("aerobalance-*")
    if (ROOT / ".git").exists():  # a checkout says which files are the project's
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
        kept = {name for name in listed.split("\0") if name and (ROOT / name).exists()}
        assert not {name for name in kept if not (source / name).exists()}
    assert contents(built("wheel", source, tmp_path / "again")) == contents(wheel)


def test_wheel_has_every_file_of_the_program(wheel) -> None:
    package = ROOT / "src" / "aerobalance"
    there = {
        path.relative_to(package.parent).as_posix()
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert set(contents(wheel)) == there
    assert "aerobalance/py.typed" in there


def test_the_module_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "aerobalance", "force", "none.csv"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "aerobalance force" in done.stderr


MASS, STIFFNESS, DAMPING, HELD, NOISE = 177.87, 3.4e7, 3000.0, 5000.0, 2.0
COMMAND = """
import sys
sys.path.insert(0, sys.argv.pop(1))
import aerobalance
from aerobalance.app.cli import run
print(aerobalance.__file__, file=sys.stderr)
run()
"""


def test_wheel_alone_makes_a_force_and_its_report(wheel, tmp_path, rng) -> None:
    installed = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(installed)
    time = np.arange(1600) / 1600.0
    rate = DAMPING / (2 * MASS)
    omega = np.sqrt(STIFFNESS / MASS - rate**2)
    since = np.clip(time - 0.5, 0, None)
    load = HELD * np.exp(-rate * since) * (np.cos(omega * since) + rate / omega * np.sin(omega * since))
    rows = np.column_stack([time, load + rng.normal(size=time.size) * NOISE])
    np.savetxt(tmp_path / "cut.csv", rows, fmt="%.9g", delimiter=",", header="time [s],AF [N]", comments="")
    values = {"mass": MASS, "stiffness": STIFFNESS, "damping": DAMPING}
    known = {name: {"value": value, "u": value * 1e-6} for name, value in values.items()}
    (tmp_path / "dynamics.json").write_text(json.dumps({"components": {"AF": known}}))
    words = ["force", "cut.csv", "--dynamics", "dynamics.json", "-o", "force.csv", "--report", "report.html"]
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, str(installed), *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert str(installed) in done.stderr  # it was the wheel that ran
    force = np.loadtxt(tmp_path / "force.csv", delimiter=",", skiprows=1)
    # means over 480 readings: five standard errors
    assert abs(force[(time > 0.1) & (time < 0.4), 1].mean() - HELD) < 5 * NOISE / np.sqrt(480)
    assert abs(force[(time > 0.6) & (time < 0.9), 1].mean()) < 5 * NOISE / np.sqrt(480)
    assert "<svg" in (tmp_path / "report.html").read_text(encoding="utf-8")
