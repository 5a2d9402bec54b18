"""Curved bridges read a load by what else hangs on them: the weight that a zero was read under, known or not."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.weighing import weigh
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.dynamics.single import Dynamics
from aerobalance.io import read, write_recording
from aerobalance.io.balance_file import write_balance
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.recording import Recording
from aerobalance.simulation.six_balance import CoupledBalance, random_balance

ANGLES = np.radians([-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0])
SHARE = 0.4
"""Weight over the range of NF: what a model has that the balance just bears."""
LEVER = 0.02
"""Place of the mass, aft of the balance's centre [m]."""
DRIFT = 1e-3
"""What the bridges' zeros have moved since the calibration, over their range."""
ROUNDED = 1e-9
"""Rounding of outputs in files of nine digits, and of the rounds of weighing that settle to 1e-9."""


class Stand:
    """A balance of curved bridges, without noise, under a weight."""

    def __init__(self, folder: Path, rng: np.random.Generator, *, natural_zeros: bool) -> None:
        self.folder = folder
        self.balance: CoupledBalance = random_balance(rng)
        self.matrix: BalanceMatrix = self.balance.matrix
        self.mass = SHARE * self.balance.half_range[0] / STANDARD_GRAVITY
        self.drift = DRIFT * self.matrix.output_scale * rng.choice([-1, 1], 6)
        known = self.matrix if natural_zeros else replace(self.matrix, natural_zero=None)
        write_balance(folder / "balance.json", known, found={})

    def weight(self, pitch: Array) -> Array:
        """Loads of the weight, shape (n, 6)."""
        level = np.zeros_like(pitch)
        loads = np.zeros((pitch.size, 6))
        for name in ("NF", "AF"):
            share = gravity_share(name, pitch=pitch, roll=level)
            loads[:, COMPONENTS.index(name)] = self.mass * STANDARD_GRAVITY * share
        loads[:, 1] = -LEVER * loads[:, 0]  # weight aft of the centre pitches the nose up
        return loads

    def record(self, name: str, loads: Array, pitch: Array) -> Path:
        """Write gauge outputs under loads of shape (n, 6) at pitch of shape (n,)."""
        outputs = self.balance.outputs(loads) + self.drift
        channels = {f"r{part}": Channel(f"r{part}", outputs[:, i], "mV/V") for i, part in enumerate(COMPONENTS)}
        channels["pitch"] = Channel("pitch", pitch, "rad")
        path = self.folder / f"{name}.h5"
        write_recording(path, Recording.from_columns(np.arange(pitch.size) / 100.0, channels, name=name))
        return path

    def at_rest(self, name: str, angle: float) -> Path:
        pitch = np.full(50, angle)
        return self.record(name, self.weight(pitch), pitch)

    def pulled(self) -> tuple[Path, Array]:
        """Write a record in which AF swings over half of its range, and give AF less the weight."""
        swing = self.balance.half_range[5] / 2 * np.sin(np.linspace(0, 20, 400))
        loads = self.weight(np.zeros(400))
        loads[:, 5] += swing
        return self.record("pulled", loads, np.zeros(400)), swing


@pytest.mark.parametrize(("natural_zeros", "component"), [(True, None), (False, "AF"), (True, "AF"), (False, None)])
@pytest.mark.soak(first=2)
def test_weighing_puts_back_the_weight_that_its_zero_was_read_under(
    tmp_path: Path, natural_zeros: bool, component: str | None, rng
) -> None:
    stand = Stand(tmp_path, rng, natural_zeros=natural_zeros)
    paths = [stand.at_rest(f"pitch_{number}", angle) for number, angle in enumerate(ANGLES)]
    files = BalanceFiles.of(tmp_path / "balance.json", zero=[stand.at_rest("zero", 0.0)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # this matrix has no covariance
        account = weigh(paths, tmp_path / "mass.json", component=component, files=files)
    found = account["mass"] if component else account["components"]["AF"]["mass"]
    # the matrix and the zero are exact but for the rounding
    assert found["value"] == pytest.approx(stand.mass, rel=1e3 * ROUNDED)


@pytest.mark.parametrize("natural_zeros", [True, False])
def test_weighing_knows_a_zero_of_the_bare_balance(tmp_path: Path, natural_zeros: bool, rng) -> None:
    stand = Stand(tmp_path, rng, natural_zeros=natural_zeros)
    paths = [stand.at_rest(f"pitch_{number}", angle) for number, angle in enumerate(ANGLES)]
    bare = stand.record("zero", np.zeros((50, 6)), np.zeros(50))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        account = weigh(paths, None, files=BalanceFiles.of(tmp_path / "balance.json", zero=[bare]))
    assert account["components"]["AF"]["mass"]["value"] == pytest.approx(stand.mass, rel=1e3 * ROUNDED)
    assert [text for text in [*account["warnings"], *map(str, said)] if "model off" in text]


def test_natural_zeros_tell_where_bridges_are_where_no_weighing_does(tmp_path: Path, rng) -> None:
    stand = Stand(tmp_path, rng, natural_zeros=True)
    path, swing = stand.pulled()
    files = BalanceFiles.of(tmp_path / "balance.json", zero=[stand.at_rest("zero", 0.0)])
    felt = files.loads(read(path))
    error = float(np.max(np.abs(felt.values[:, 5] - swing))) / stand.balance.half_range[5]
    # the drift passes for a load of 0.1 % of range, over which sensitivities change by less than 10 % of that
    assert error < 0.1 * DRIFT * 0.5


def test_a_weight_that_nothing_tells_is_told(tmp_path: Path, rng) -> None:
    stand = Stand(tmp_path, rng, natural_zeros=False)
    path, _ = stand.pulled()
    files = BalanceFiles.of(tmp_path / "balance.json", zero=[stand.at_rest("zero", 0.0)])
    with pytest.warns(DataQualityWarning, match=r"zero.h5: the weight that hung on the balance .* is not known"):
        files.identification_loads([read(path)], None, channel_map=None, calibration_counts=False)


def test_a_zero_of_the_bare_balance_is_no_weight(tmp_path: Path, rng) -> None:
    stand = Stand(tmp_path, rng, natural_zeros=True)
    zero = stand.record("zero", np.zeros((50, 6)), np.zeros(50))
    path, swing = stand.pulled()
    recording = read(path)
    felt = BalanceFiles.of(tmp_path / "balance.json", zero=[zero]).loads(recording)
    assert felt.zero.operating_point is None
    loads = stand.weight(np.zeros(400))
    loads[:, 5] += swing
    np.testing.assert_allclose(felt.values, loads, atol=1e3 * ROUNDED * stand.balance.half_range.max())


@pytest.mark.parametrize("part", [0.0, 0.01, -0.03])
@pytest.mark.parametrize("model_on", [False, True])
def test_a_zero_of_another_day_is_held_against_the_natural_zeros(
    tmp_path: Path, part: float, model_on: bool, rng
) -> None:
    """A zero whose bridges read as under a load that nobody applied: all loads of the run are less by that load."""
    stand = Stand(tmp_path, rng, natural_zeros=True)
    stand.drift = np.zeros(6)
    path, swing = stand.pulled()
    model = Dynamics("AF", mass=stand.mass, stiffness=1e7, damping=0.0)
    moved = part * stand.balance.half_range[5]
    level = np.zeros(50)
    loads = (stand.weight(level) if model_on else np.zeros((50, 6))) + moved * np.eye(6)[5]
    zero = read(stand.record("zero", loads, level))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        felt = ab.reduce_outputs(read(path), stand.matrix, zero=ab.Zero(zero, model_on=model_on), model=model)
    told = felt.recording.zero_from_natural.get("AF", 0.0)
    assert told == pytest.approx(moved, rel=1e-5)
    assert np.mean(felt.values[:, felt.components.index("AF")] - swing) == pytest.approx(
        -moved, abs=0.02 * abs(moved) + 1e-6 * stand.balance.half_range[5]
    )  # bridges are read from a wrong place on their curves
    doubts = [doubt for doubt in felt.doubts if doubt.component == "AF" and "natural zeros" in doubt.text]
    assert bool(doubts) == (abs(part) > 0.02)
