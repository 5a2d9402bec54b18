"""What `ab.write` writes is what the commands write, and `ab.read` finds it again."""

from __future__ import annotations

import json

import numpy as np
import pytest

import aerobalance as ab
from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io.artefacts import digest
from aerobalance.simulation import CableCut, Sensor
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_components import SixComponentRig
from helpers.coupled_pair import pair

RATE = 1600.0
SPRING = ab.Dynamics("AF", mass=177.87, stiffness=3.093e7, damping=828.21)


def calibrated(rng: np.random.Generator) -> tuple[BalanceMatrix, Calibration]:
    balance = random_balance(rng)
    noise = 1e-4 * float(balance.matrix.output_scale.min())
    schedule = CalibrationStand(balance.matrix, noise=noise, repeats=3).run(int(rng.integers(1 << 31))).schedule
    return balance.matrix, ab.calibrate(schedule, reading_noise=noise)


def recording(rng: np.random.Generator) -> ab.Recording:
    time = np.arange(2000) / RATE
    columns = {"AF": 60.0 + rng.normal(size=time.size), "pitch": np.full(time.size, 2.0)}
    return ab.Recording.from_arrays(time, columns, units={"pitch": "deg"})


@pytest.mark.parametrize("ending", ["csv", "h5"])
def test_recording(ending, tmp_path, rng):
    given = recording(rng)
    assert ab.write(str(tmp_path / f"run.{ending}"), given) == tmp_path / f"run.{ending}"
    found = ab.read(tmp_path / f"run.{ending}")
    assert isinstance(found, ab.Recording)
    for name in ("AF", "pitch"):  # pitch goes through degrees
        np.testing.assert_allclose(found.channel(name).values, given.channel(name).values, rtol=1e-14)


def test_calibration_and_its_matrix(tmp_path, rng):
    _, calibration = calibrated(rng)
    assert ab.write(tmp_path / "balance.json", calibration) == tmp_path / "balance.json"
    ab.write(tmp_path / "matrix.json", calibration.matrix)
    for name in ("balance.json", "matrix.json"):
        found = ab.read(tmp_path / name)
        assert isinstance(found, BalanceMatrix)
        np.testing.assert_array_equal(found.coefficients, calibration.matrix.coefficients)
        np.testing.assert_array_equal(found.covariance, calibration.matrix.covariance)
    assert json.loads((tmp_path / "balance.json").read_text())["points"] > 0


@pytest.mark.parametrize("form", [SPRING, [SPRING], {"AF": SPRING}], ids=["one", "sequence", "mapping"])
def test_dynamics_of_components_each_for_itself(form, tmp_path):
    ab.write(tmp_path / "dynamics.json", form)
    found = ab.read(tmp_path / "dynamics.json")
    assert list(found) == ["AF"]
    np.testing.assert_array_equal(found["AF"].values, SPRING.values)


def test_coupled_dynamics(tmp_path):
    ab.write(tmp_path / "dynamics.json", pair())
    found = ab.read(tmp_path / "dynamics.json")
    assert isinstance(found, CoupledDynamics)
    np.testing.assert_array_equal(found.inertia, pair().inertia)
    np.testing.assert_array_equal(found.damping, pair().damping)


def test_an_identification_is_written_with_its_dynamics_and_files(tmp_path, rng):
    rig = CableCut(sensors={"AF": Sensor(noise=10.0)})
    source = tmp_path / "cut.csv"
    ab.write(source, rig.run(2.0, rng).recording)
    found = ab.identify(ab.read(source), mass=rig.dynamics.mass)
    ab.write(tmp_path / "dynamics.json", found, inputs=[source])
    again = ab.read(tmp_path / "dynamics.json")["AF"]
    np.testing.assert_array_equal(again.values, found.dynamics.values)
    np.testing.assert_array_equal(again.covariance, found.dynamics.covariance)
    (entry,) = json.loads((tmp_path / "dynamics.json").read_text())["provenance"]["inputs"]
    assert entry == {"name": "cut.csv", "sha256": digest(source)}


def test_force_stands_beside_its_uncertainty(tmp_path, rng):
    force = ab.estimate_force(recording(rng), SPRING)
    ab.write(tmp_path / "force.h5", force)
    found = ab.read(tmp_path / "force.h5")
    np.testing.assert_array_equal(found.channel("AF").values, force["AF"].values)
    assert "u_AF" in (tmp_path / "force.h5").read_bytes().decode("latin-1")


def test_loads_keep_what_the_force_needs_beside_them(tmp_path, rng):
    balance = random_balance(rng)
    level = {name: lambda t: np.zeros(t.shape) for name in ("pitch", "roll")}
    run = SixComponentRig(balance, rate=10_000.0, **level).run(0.2, rng).recording
    with pytest.warns(UserWarning, match="natural zeros"):
        loads = ab.reduce_outputs(run, balance.matrix)
    ab.write(tmp_path / "loads.h5", loads)
    found = ab.read(tmp_path / "loads.h5")
    for place, name in enumerate(loads.components):
        np.testing.assert_array_equal(found.channel(name).values, loads.values[:, place])
    assert "pitch" in found


def test_what_has_no_file_is_refused(tmp_path):
    planned = ab.plan(SPRING, rate=RATE, noise=2.0)
    with pytest.raises(ValueError, match="Plan has no file; Recording, Loads"):
        ab.write(tmp_path / "plan.json", planned)
    with pytest.raises(ValueError, match=r"matrices, weighings and dynamics are written as \.json"):
        ab.write(tmp_path / "dynamics.csv", SPRING)
    with pytest.raises(ValueError, match="no folder"):
        ab.write(tmp_path / "none" / "run.csv", ab.Recording.from_arrays(np.arange(9.0), {"AF": np.zeros(9)}))
    assert not list(tmp_path.iterdir())
