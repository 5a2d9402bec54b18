"""The bound that no estimate of six components can be below."""

from __future__ import annotations

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.recording.channel import Array
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import CoupledBalance
from aerobalance.simulation.six_components import SixSimulation
from aerobalance.simulation.six_signals import Band, broadband

RATE, DURATION, GUSTS = 25_000.0, 1.0, 0.1


def wiener_bound(
    balance: CoupledBalance, band: Band, *, gusts: float = GUSTS, dynamics: CoupledDynamics | None = None
) -> Array:
    """Rms error of the best linear estimate from all channels, shape (6,): (S^-1 + H* R^-1 H)^-1 over frequency.

    The loads have the rms `gusts`, over half range.
    """
    frequency = np.linspace(0, RATE / 2, 6251)
    response = (dynamics or balance.dynamics).response(frequency)
    noise = (balance.noise * balance.half_range) ** 2 / RATE
    force = np.maximum(band.density(frequency)[:, None] / 2, 1e-12) * (gusts * balance.half_range) ** 2
    known = np.einsum("mji,j,mjk->mik", response.conj(), 1 / noise, response)
    known[:, range(6), range(6)] += 1 / force
    error = np.real(np.linalg.inv(known)[:, range(6), range(6)])
    return np.sqrt(2 * np.sum(error, axis=0) * (frequency[1] - frequency[0]))


def gusts(balance: CoupledBalance, rng: np.random.Generator) -> tuple[SixSimulation, Band]:
    band = Band(0, 1.2 * max(mode.natural_frequency for mode in balance.dynamics.modes))
    load = broadband(rng, band, rms=GUSTS * balance.half_range, period=2 * DURATION)
    return SixComponentRig(balance, applied=load, output="loads").run(DURATION, rng), band


def inner(values: Array) -> Array:
    ends = values.shape[0] // 20
    return values[ends:-ends]
