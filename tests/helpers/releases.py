"""Six releases of a balance whose dynamics are known."""

import warnings

import numpy as np
from scipy.linalg import expm
from scipy.stats import chi2

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from helpers.rigid_balance import RANGES

RATE = 2500.0
SECONDS = 0.6
NEVER = 1e-5
"""Probability with which a test of chance may fail for a fresh seed."""


def felt(dynamics: CoupledDynamics, held: Array, *, instant: float, duration: float = 0.0) -> Array:
    """Balance loads when `held` is let go, by the matrix exponential; over a duration by its exact mean."""
    n = len(dynamics.components)
    generator = np.zeros((2 * n, 2 * n))
    generator[:n, n:] = np.eye(n)
    generator[n:, :n] = -np.linalg.inv(dynamics.inertia)
    generator[n:, n:] = -np.linalg.solve(dynamics.inertia, dynamics.damping)
    time = np.arange(round(SECONDS * RATE)) / RATE
    start = np.concatenate([held, np.zeros(n)])
    values = np.tile(held, (time.size, 1))
    if duration:  # X = L0 - (1/T) int_0^t (1 - exp(G s)) ds h while it falls, a free decay behind
        during = (time > instant) & (time < instant + duration)
        integral = [_integral(generator, t - instant) @ start for t in time[during]]
        values[during] -= ((time[during] - instant)[:, None] * held - np.array(integral)[:, :n]) / duration
        start = _integral(generator, duration) @ start / duration
    after = np.flatnonzero(time >= instant + duration)
    state = expm(generator * (time[after[0]] - instant - duration)) @ start
    step = expm(generator / RATE)
    for row in after:
        values[row] = state[:n]
        state = step @ state
    return values


def _integral(generator: Array, span: float) -> Array:
    return np.linalg.solve(generator, expm(generator * span) - np.eye(len(generator)))


def recording(values: Array, name: str, components: tuple[str, ...] = COMPONENTS) -> Recording:
    channels = {c: Channel(c, values[:, i].copy(), si_unit(c)) for i, c in enumerate(components)}
    return Recording.from_columns(np.arange(len(values)) / RATE, channels, name=name)


def quietly(recordings: list[Recording], **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return identify_releases(recordings, half_range=RANGES, **settings)


def errors(found: CoupledDynamics, true: CoupledDynamics) -> Array:
    return np.concatenate([(found.inertia - true.inertia).ravel(), (found.damping - true.damping).ravel()])


def between(value: float, degrees: int) -> bool:
    return chi2.ppf(NEVER / 2, degrees) < value < chi2.isf(NEVER / 2, degrees)
