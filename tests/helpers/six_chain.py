"""A balance of six components from its calibration to its dynamics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.force import force
from aerobalance.app.demos.six_demo import DemoFolder, calibrated, identified, weighed
from aerobalance.estimation.force import estimate_force
from aerobalance.io import read
from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import SixSimulation

RATE, DURATION = 25_000.0, 1.0
MATRIX = ("balance matrix, zeros and tares", "curvature of the balance matrix, ringing")
"""Contributions of the matrix."""


class Chain(NamedTuple):
    """One balance, and what was found of it."""

    folder: DemoFolder
    balance: CoupledBalance
    files: BalanceFiles
    dynamics: Path

    def run(self, name: str, rig: SixComponentRig) -> tuple[Path, SixSimulation, Array, Array, Array]:
        """Record, and work out forces, their uncertainty, shape (n, 6) each, and what of it the matrix has, (6,)."""
        recorded, simulation = self.folder.record(name, rig, DURATION)
        out = self.folder.path / f"{name}_force.csv"
        account = force(recorded, out, dynamics=self.dynamics, files=self.files)
        parts = [account["components"][name]["uncertainty_budget_rms"] for name in COMPONENTS]
        found = read(out)
        values, u = (
            np.column_stack([found.channel(f"{prefix}{name}").values for name in COMPONENTS]) for prefix in ("", "u_")
        )
        matrix = [np.hypot(*(part.get(name, 0.0) for name in MATRIX)) for part in parts]
        return recorded, simulation, values, u, np.array(matrix)

    def by_diagonal(self, recorded: Path, *, band: float) -> Array:
        """The forces with the diagonals of the matrices found, limited to a band, shape (n, 6)."""
        known = read_coupled(self.dynamics)
        alone = replace(
            known,
            inertia=np.diag(np.diag(known.inertia)),
            damping=np.diag(np.abs(np.diag(known.damping))),
            covariance=np.zeros_like(known.covariance),
        )
        loads = replace(self.files.loads(read(recorded), model=alone).recording, from_outputs=False)
        found = estimate_force(loads, alone, bandwidth=band)
        return np.column_stack([found[name].values for name in COMPONENTS])


def chain(path: Path, rng: np.random.Generator) -> Chain:
    """Calibrate, weigh and identify a random balance from six releases."""
    path.mkdir()
    folder, balance = DemoFolder(path, rng), random_balance(rng)
    files = calibrated(folder, balance)
    return Chain(folder, balance, files, identified(folder, balance, files, weighed(folder, balance, files)))
