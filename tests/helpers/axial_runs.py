"""Runs of one component on the disk: a folder for campaigns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import aerobalance as ab
from aerobalance.dynamics.single import Dynamics
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.recording import Recording

RATE = 1600.0


def spring(**changed: float) -> Dynamics:
    """The paper's balance, or one with another stiffness or damping."""
    return ab.Dynamics("AF", **{"mass": 177.87, "stiffness": 3.093e7, "damping": 828.21, **changed})


def run_of(
    rng: np.random.Generator, *, mean: float = 200.0, samples: int = 800, dynamics: Dynamics | None = None
) -> Recording:
    """A run at rest under a steady and a random load that excites the resonance."""
    dynamics = spring() if dynamics is None else dynamics
    before = 400
    load = mean + rng.normal(0, 20.0, samples + before)
    felt = dynamics.balance_load(load, interval=1 / RATE)[before:] + rng.normal(0, 0.5, samples)
    return ab.Recording.from_arrays(np.arange(samples) / RATE, {"AF": felt})


def axial_folder(folder: Path, rng: np.random.Generator, *, count: int = 4, samples: int = 800) -> tuple[Path, Path]:
    """Folder of runs ``run_1.h5`` ..., and the dynamics beside it."""
    runs, dynamics = folder / "runs", folder / "dynamics.json"
    runs.mkdir(parents=True)
    for number in range(1, count + 1):
        write_recording(runs / f"run_{number}.h5", run_of(rng, mean=100.0 * number, samples=samples))
    write_dynamics(dynamics, {"AF": spring()})
    return runs, dynamics
