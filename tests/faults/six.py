"""Records of six coupled components of known force, simulated apart from the package.

Forces and answers are periodic over more than the record and worked out by Fourier series: at every frequency
X = (1 + D s + A s^2)^-1 F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.recording import Recording
from faults.scene import Array, Clock, Maker, Record, band

HALF_RANGE: Final = np.array([2000.0, 120.0, 1000.0, 60.0, 40.0, 800.0])
"""In the order of `COMPONENTS` [N, N*m]."""

NOISE: Final = 1e-4
"""Noise of a reading over half range."""

SIX: Final = Clock(rate=8000.0, samples=4000, fine=4)

HIGHEST: Final = 347.0
"""1.2 times the highest natural frequency [Hz]."""


@lru_cache(maxsize=1)
def balance() -> CoupledDynamics:
    """Return the dynamics of the balance as they are: modes from 134 to 289 Hz."""
    mass, length = 9.0, np.array([1.0, 0.11, 1.0, 0.1, 0.045, 1.0])
    aft, right, up = 0.02, -0.006, 0.008
    inertia = mass * np.diag(length**2)
    # NF acts up, SF right, AF aft; a mass off the centre ties forces to moments
    arms = (("NF", "PM", -aft), ("SF", "YM", -aft), ("SF", "RM", up), ("AF", "PM", up), ("AF", "YM", right))
    for force, moment, arm in arms:
        i, j = COMPONENTS.index(force), COMPONENTS.index(moment)
        inertia[i, j] = inertia[j, i] = mass * arm
    own = 2 * np.pi * np.array([150.0, 190.0, 165.0, 215.0, 245.0, 275.0])
    size = np.sqrt(np.diag(inertia)) * own
    coupling = np.triu(np.random.default_rng(7).normal(0, 0.04, (6, 6)), 1)
    stiffness = np.outer(size, size) * (np.eye(6) + coupling + coupling.T)
    lower = np.linalg.cholesky(inertia)
    back = np.linalg.inv(lower)
    squares, turned = np.linalg.eigh(back @ stiffness @ back.T)
    ratios = np.array([0.006, 0.01, 0.02, 0.008, 0.012, 0.015])
    damping = lower @ turned @ np.diag(2 * ratios * np.sqrt(squares)) @ turned.T @ lower.T
    flexibility = np.linalg.inv(stiffness)
    return CoupledDynamics(COMPONENTS, inertia @ flexibility, damping @ flexibility)


def felt(dynamics: CoupledDynamics, force: Array, clock: Clock) -> Array:
    """Return the balance loads under forces on the fine clock, both of shape (count, 6).

    Of the state (X, s X) the response is a sum over its poles, which takes a tenth of the time of an inverse for each
    frequency.
    """
    back, nothing = np.linalg.inv(dynamics.inertia), np.zeros((6, 6))
    poles, shapes = np.linalg.eig(np.block([[nothing, np.eye(6)], [-back, -back @ dynamics.damping]]))
    driven = np.linalg.solve(shapes, np.vstack([nothing, back]))
    swing = np.fft.rfft(force, axis=0) @ driven.T
    swing /= 2j * np.pi * clock.frequency[:, None] - poles
    return np.fft.irfft(swing @ shapes[:6].T, clock.count, axis=0)


@lru_cache(maxsize=1)
def identified() -> CoupledDynamics:
    """Return what six releases say of the balance: the covariance is what is used."""
    records = []
    rng = np.random.default_rng(11)
    for place, name in enumerate(COMPONENTS):
        held = np.zeros(6)
        held[place] = 0.3 * HALF_RANGE[place]
        clock = replace(SIX, samples=8000)
        instant = 0.1 + 1e-3 * rng.random()
        back = 0.5 + 0.5 * np.cos(np.pi * np.clip((clock.time - clock.end - 0.1) / 1.5, 0, 1))
        force = -held * (np.where(clock.time > instant, 1.0, 0.0) * back)[:, None]
        load = felt(balance(), force, clock) + held
        values = np.column_stack([clock.sampled(column) for column in load.T])
        values = values + rng.normal(size=values.shape) * NOISE * HALF_RANGE
        records.append(recording_of(values, clock.rate, name=f"release along {name}"))
    ranges = dict(zip(COMPONENTS, HALF_RANGE.tolist(), strict=True))
    return identify_releases(records, half_range=ranges, modes=6).dynamics


def recording_of(values: Array, rate: float, *, name: str = "record") -> Recording:
    """Return readings of all components as a recording."""
    channels = {one: Channel(one, values[:, place].copy(), si_unit(one)) for place, one in enumerate(COMPONENTS)}
    return Recording.from_columns(np.arange(len(values)) / rate, channels, name=name)


@dataclass(frozen=True)
class SixScene:
    """How a record of six components is made.

    Attributes
    ----------
    forces
        The force of each component over its half range.
    common
        One load that acts in all components, as a gust or a release, in proportions of half range that are drawn.
    clock
        When it is read.
    """

    forces: Sequence[Maker] = field(default_factory=lambda: [band(0.1, 0, HIGHEST)] * 6)
    common: Maker | None = None
    clock: Clock = SIX

    def record(self, rng: np.random.Generator) -> Record:
        """Return the record and its truth, (samples, 6)."""
        clock = self.clock
        force = np.column_stack([maker(clock, rng) for maker in self.forces]) * HALF_RANGE
        if self.common is not None:
            force += np.multiply.outer(self.common(clock, rng), rng.uniform(-1, 1, 6) * HALF_RANGE)
        load = felt(balance(), force, clock)
        values = np.column_stack([clock.sampled(column) for column in load.T])
        values = values + rng.normal(size=values.shape) * NOISE * HALF_RANGE
        columns = {name: values[:, place].copy() for place, name in enumerate(COMPONENTS)}
        return Record(clock.rate, columns, np.column_stack([clock.sampled(column) for column in force.T]))


def drawn(rng: np.random.Generator) -> CoupledDynamics:
    """Return dynamics that are off by a draw from the covariance that six releases leave."""
    known, true = identified(), balance()
    size = np.sqrt(np.diag(known.covariance))
    level, vectors = np.linalg.eigh(known.covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(level, 0))
    error = (root @ rng.normal(size=72)).reshape(2, 6, 6)
    return replace(true, inertia=true.inertia + error[0], damping=true.damping + error[1], covariance=known.covariance)


def moved(known: CoupledDynamics, *, factor: float) -> CoupledDynamics:
    """Return dynamics whose modes all have so many times their frequencies."""
    return replace(known, inertia=known.inertia / factor**2, damping=known.damping / factor)
