"""Dynamics of one component with its mass, from matrices of one component and what no channel shows."""

from __future__ import annotations

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array


def one_component(coupled: CoupledDynamics, mass: float, u_mass: float) -> Dynamics:
    """Return the dynamics of one component with its mass, from the matrices of one; further modes become its own."""
    name = coupled.components[0]
    values = _modal_values(coupled.inertia, coupled.damping)
    size = len(coupled.inertia)
    flat = np.concatenate([coupled.inertia.ravel(), coupled.damping.ravel()])
    u = np.sqrt(np.diag(coupled.total_covariance))
    slopes = np.zeros((values.size, flat.size))
    for place in np.flatnonzero(u > 0):
        step = np.zeros(flat.size)
        step[place] = max(1e-3 * u[place], 1e-7 * abs(flat[place]))
        above, below = (_modal_values(*(flat + sign * step).reshape(2, size, size)) for sign in (1, -1))
        slopes[:, place] = (above - below) / (2 * step[place])
    rate2, twice = float(values[0]), float(values[1])
    by = slopes.copy()
    by[:2] *= mass
    covariance = np.zeros((values.size + 2, values.size + 2))
    rows = [1, 2, *range(4, values.size + 2)]
    covariance[np.ix_(rows, rows)] = by @ coupled.total_covariance @ by.T
    with_mass = np.zeros(values.size + 2)
    with_mass[:3] = 1.0, rate2, twice
    covariance += u_mass**2 * np.outer(with_mass, with_mass)
    further = tuple(Mode(*map(float, row)) for row in values[2:].reshape(-1, 3))
    return Dynamics(
        name, mass, mass * rate2, mass * twice, covariance=(covariance + covariance.T) / 2, further_modes=further
    )


def _modal_values(inertia: Array, damping: Array) -> Array:
    """Square of the first mode's rate, twice its decay rate; then frequency, ratio and share of each further one.

    The first is the one that carries most of a steady load.
    """
    form = CoupledDynamics(("AF",), inertia, damping).modal_form
    up = np.flatnonzero(form.poles.imag > 0)
    shares = np.real(-2 * form.weights[up, 0] * form.shapes[0, up] / form.poles[up])
    order = up[np.argsort(-shares)]
    sorted_shares = np.sort(shares)[::-1]
    first = form.poles[order[0]]
    values = [abs(first) ** 2, -2 * first.real]
    for pole, share in zip(form.poles[order[1:]], sorted_shares[1:], strict=True):
        values += [abs(pole) / (2 * np.pi), -pole.real / abs(pole), share]
    return np.array(values)
