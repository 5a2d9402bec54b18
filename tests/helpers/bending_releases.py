"""Releases of a balance that has a bending mode besides."""

import warnings

import numpy as np
from scipy.linalg import expm

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.free_response import generator_of
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import si_unit
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording

RATE = 2500.0
SECONDS = 0.8
NAMES = ("NF", "AF")
HALF_RANGE = np.array([1000.0, 500.0])
RANGES = dict(zip(NAMES, HALF_RANGE.tolist(), strict=True))


def structure() -> tuple[Array, Array, Array, Array, Array]:
    """Mass, damping and stiffness of three degrees of freedom, and how loads enter and are felt; bends at 210 Hz."""
    M = np.array([[20.0, 2.0, 0.9], [2.0, 20.0, 0.4], [0.9, 0.4, 1.0]])
    K = np.diag(np.array([20.0, 20.0, 1.0]) * (2 * np.pi * np.array([90.0, 140.0, 210.0])) ** 2)
    K[0, 1] = K[1, 0] = 0.1 * np.sqrt(K[0, 0] * K[1, 1])
    C = 2e-5 * K + 3 * M
    into = np.array([[1.0, 0.0], [0.0, 1.0], [0.06, -0.02]])
    return M, C, K, into, K[:2]


def truth() -> CoupledDynamics:
    return in_loads(*structure())


def in_loads(M: Array, C: Array, K: Array, into: Array, felt: Array) -> CoupledDynamics:
    """A structure in loads: internal are such loads that none held makes."""
    at_rest = np.linalg.solve(K, into)
    unseen = np.cross(at_rest[:, 0], at_rest[:, 1])  # normal to both
    turn = np.vstack([felt, unseen * np.linalg.norm(felt) / np.linalg.norm(unseen)])
    back, flexible = np.linalg.inv(turn), turn @ np.linalg.inv(K)
    return CoupledDynamics(NAMES, flexible @ M @ back, flexible @ C @ back)


def recordings(dynamics: CoupledDynamics, rng: np.random.Generator, *, along=(0, 1), noise=1e-4) -> list[Recording]:
    """Releases of half the half range, by the matrix exponential of the motion."""
    spring = np.linalg.inv(dynamics.inertia)
    whole = generator_of(spring, spring @ dynamics.damping)
    made = []
    for number in along:
        held, instant = np.zeros(len(whole)), 0.05 + rng.uniform(0, 0.01)
        held[number] = 0.5 * HALF_RANGE[number]
        time = np.arange(round(SECONDS * RATE)) / RATE
        values = np.tile(held[:2], (time.size, 1))
        after = np.flatnonzero(time >= instant)
        state, step = expm(whole * (time[after[0]] - instant)) @ held, expm(whole / RATE)
        for row in after:
            values[row] = state[:2]
            state = step @ state
        values += noise * HALF_RANGE * rng.normal(size=values.shape)
        channels = {name: Channel(name, values[:, i].copy(), si_unit(name)) for i, name in enumerate(NAMES)}
        made.append(Recording.from_columns(time, channels, name=f"release {NAMES[number]}"))
    return made


def quietly(made: list[Recording], **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return identify_releases(made, components=NAMES, half_range=RANGES, **settings)
