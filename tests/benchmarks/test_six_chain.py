"""Six coupled components, from mV/V with calibration noise: calibrate, weigh, identify, force.

Random coupled balances as in test_six.py, but nothing of them is known: matrix, mass, A and D come from simulated
experiments. Loads of a broad band are as large as a balance can bear: 15 % rms of half range in the component that
feels most; and releases ring within half range. Beyond what was calibrated the matrix is extrapolated, which costs
more than all the rest.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.demos.six_demo import FELT, bearable, largest_felt, still
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.simulation.six_components import Release
from aerobalance.simulation.six_signals import Band, broadband
from helpers.accuracy_of_six import inner, wiener_bound
from helpers.six_chain import DURATION, RATE, chain

BALANCES = 6

RARE = 4
"""Standard uncertainties that the matrix is off by in one of 36 components once in 400 runs.

The bound knows no errors of calibration and identification. A calibration with a noise of 1e-4 of half range leaves
nonlinear terms that make offsets of some 1e-5 of shaking loads, and grow with the square of the frequency above the
lowest modes.
"""


@pytest.mark.parametrize(("gusts", "edge", "order"), [("from mV/V", 1.2, 0), ("soft gusts, from mV/V", 0.5, 2)])
def test_from_gauge_outputs_to_forces(gusts: str, edge: float, order: int, record, tmp_path: Path, *, rng) -> None:
    with_matrix, share, plateau = 0.0, 0.0, 0.0
    covered, alone, ratios = [], [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # of zeros not given, and of weakly excited modes
        for number in range(BALANCES):
            one = chain(tmp_path / str(number), rng)
            balance, level = one.balance, still(one.balance, 0.0, 0.0)
            band = Band(0, edge * max(mode.natural_frequency for mode in balance.dynamics.modes), order)
            part = FELT / largest_felt(balance, band)
            load = broadband(rng, band, rms=part * balance.half_range, period=2 * DURATION)
            recorded, simulation, values, u, matrix = one.run("gusts", replace(level, applied=load))
            error = inner(values - simulation.applied)
            rms, bound = np.sqrt(np.mean(error**2, axis=0)), wiener_bound(balance, band, gusts=part)
            ratios += (rms / bound).tolist()
            with_matrix = max(with_matrix, float(np.max(rms / np.hypot(1.4 * bound, RARE * matrix))))
            small = bound < 2e-3 * balance.half_range
            share = max(share, float(np.max((rms / balance.half_range)[small], initial=0.0)))
            covered += np.mean(np.abs(error) < 1.96 * inner(u), axis=0).tolist()
            apart = inner(one.by_diagonal(recorded, band=band.high) - simulation.applied)
            alone += (np.sqrt(np.mean(apart**2, axis=0)) / rms).tolist()

            pull = bearable(balance, balance.half_range * rng.uniform(-0.5, 0.5, 6))
            instant = 0.3 + rng.uniform(0, 0.1)
            _, simulation, values, *_ = one.run("release", replace(level, releases=(Release(pull, instant),)))
            away = np.abs(np.arange(values.shape[0]) / RATE - instant) > 2 / RATE
            left = np.sqrt(np.mean((values - simulation.applied)[away] ** 2, axis=0))
            plateau = max(plateau, float(np.max(left / balance.half_range)))
    cover = float(np.mean(covered))
    over = f"1.4 over the {{}} error of a component over the multi-channel Wiener bound, {gusts}"
    record(over.format("median"), 1.4 / float(np.median(ratios)), 1.0)
    record(over.format("worst"), 1.4 / max(ratios), 0.0)
    record(f"share of components within 1.4 of the bound, {gusts}", float(np.mean(np.array(ratios) < 1.4)), 0.9)
    record(f"1.4 of the bound and 4 u of the matrix over the worst error, {gusts}", 1 / with_matrix, 1.0)
    record(f"0.3 % over worst error in half range where the bound is under 0.2 %, {gusts}", 3e-3 / share, 1.0)
    record(f"0.05 % over the worst plateau in half range, {gusts}", 5e-4 / plateau, 1.0)
    record(f"least of cover over 93 % and 97 % over cover, {gusts}", min(cover / 0.93, 0.97 / cover), 1.0)
    record(f"median error of the diagonal model over that of the coupled one, {gusts}", float(np.median(alone)), 0.0)
    assert np.mean(np.array(ratios) < 1.4) > 0.9
    assert with_matrix < 1
    assert share < 3e-3
    assert plateau < 5e-4
    assert 0.93 < cover < 0.98  # the mean of 36, of which those where the matrix counts most go together
