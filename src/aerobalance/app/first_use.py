"""All that is compiled at the first use on a machine, compiled at once: what an installation may do beforehand."""

from __future__ import annotations

import numpy as np

from aerobalance.app.monitor.engine import warm_up
from aerobalance.balance._variance_kernels import FOUR, Quadratic, variances
from aerobalance.balance.inversion import inverted
from aerobalance.dynamics._kernels import add_mode, first_order
from aerobalance.estimation.checks._covariance_kernels import likeliest_covariances
from aerobalance.estimation.checks._level_kernels import ForceLines, likeliest_levels, likeliest_levels_and_noise
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.spectra._kernels import Search
from aerobalance.simulation.cable_cut import CableCut


def compile_all() -> None:
    """Run every compiled loop once, on a balance that rings and on polynomials."""
    warm_up()
    rig = CableCut()
    run = rig.run(1.5, np.random.default_rng(1))
    estimate_force(run.recording, rig.dynamics)
    first_order(0.5 + 0j, np.ones(2, dtype=complex))
    one = np.ones(1, dtype=complex)
    add_mode(0.5 + 0j, np.ones(2, dtype=complex), one, one, np.ones((2, 1)), 1, np.zeros((2, 1)))
    both = np.ones((2, 2), dtype=complex)
    levels = ForceLines(both, np.stack([both, both]), np.ones(2), np.ones((2, 2)), np.ones(2, dtype=bool), 0.01)
    likeliest_levels(levels, np.zeros(1, dtype=np.int64), 1, 0.02, np.empty(1))
    search = Search(np.empty(0), np.empty(0), 1, 0.02, 3.0, 0.01)
    likeliest_levels_and_noise(levels, np.ones((2, 2)), np.zeros(1, dtype=np.int64), search, np.empty(1))
    noise = np.tile(np.eye(2, dtype=complex), (2, 1, 1))
    likeliest_covariances(both, noise, np.zeros(1, dtype=np.int64), 1, noise[:1].copy(), np.empty(1))
    terms = np.array([0, 0, 2, 2]), np.array([0, 1, 0, 1]), np.array([0, 1, 0, 1])
    bent = np.array([[1.0, 0.0], [0.0, 1.0], [0.1, 0.0], [0.0, 0.1]])  # y = x + x^2 / 10
    inverted(terms, bent, np.eye(2), np.array([[0.1, 0.1], [50.0, 50.0]]))  # the second by Newton's method
    form, zeros = np.zeros((1, 1, FOUR)), np.zeros((1, 1, 3))
    plain = Quadratic(np.array([[0, 1, 1]]), form, np.ones(1), zeros, np.eye(1), np.eye(1))
    variances(np.ones((1, 1)), np.zeros(1, dtype=np.int64), plain, np.eye(1), 0.1, np.empty((1, 1)))
