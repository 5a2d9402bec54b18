"""A and D from releases in mV/V, through calibrations with noise: errors over their uncertainties.

The balances of test_six_chain.py, as far as their dynamics. Readings alone leave far less than the calibration does,
which shows in the combinations of elements that the readings know best: the tests of a rigid mass look at these.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np

from aerobalance.io.dynamics_file import read_coupled
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import DataQualityWarning
from helpers.six_chain import chain

BALANCES = 6

TESTS = ("rigidity", "reciprocity", "centre_of_gravity")
"""Tests that hold for the simulated balances."""


def test_errors_of_dynamics_from_gauge_outputs(record, tmp_path: Path, rng) -> None:
    squares: dict[str, list[Array]] = {"A": [], "D": [], "A by the readings": [], "D by the readings": []}
    whitened, passed = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # of zeros not given, and of weakly excited modes
        for number in range(BALANCES):
            one = chain(tmp_path / str(number), rng)
            found, truth = read_coupled(one.dynamics), one.balance.dynamics
            parts = [getattr(found, kind) - getattr(truth, kind) for kind in ("inertia", "damping")]
            error = np.concatenate([part.ravel() for part in parts])
            u = np.sqrt(np.diag(found.total_covariance))
            z, of_readings = error / u, error / np.sqrt(np.diag(found.covariance))
            for name, place in (("A", slice(36)), ("D", slice(36, None))):
                squares[name].append(z[place] ** 2)
                squares[f"{name} by the readings"].append(of_readings[place] ** 2)
            whitened.append(float(z @ np.linalg.solve(found.total_covariance / np.outer(u, u), z)) / z.size)
            tests = json.loads(one.dynamics.read_text())["fit"]["tests"]
            passed += [tests[name]["holds"] for name in TESTS]
    rms = {name: float(np.sqrt(np.mean(parts))) for name, parts in squares.items()}
    for name in ("A", "D"):
        record(
            f"least of rms z of {name} over 0.5 and 1.5 over it, from mV/V", min(rms[name] / 0.5, 1.5 / rms[name]), 1
        )
        told = f"rms error of {name} over what the readings alone leave, from mV/V"
        record(told, rms[f"{name} by the readings"], 0.0)
    record("1.6 over the mean chi2 per degree of freedom of A and D, from mV/V", 1.6 / float(np.mean(whitened)), 1.0)
    record("share of the tests of a rigid mass that hold, from mV/V", float(np.mean(passed)), 0.9)
    print(rms, whitened, passed)  # noqa: T201
    assert all(0.5 < rms[name] < 1.5 for name in ("A", "D"))
    assert 0.4 < float(np.mean(whitened)) < 1.6
    assert np.mean(passed) > 0.9
