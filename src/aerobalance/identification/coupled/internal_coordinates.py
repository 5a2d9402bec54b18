"""Coordinates that no channel shows, of a model or sting that bends, and what of the matrices no release can tell.

Z = [X; Y] are the n balance loads and e internal coordinates. Y may be any e functionals of the state [Z; Z'] that are
zero and at rest whenever the state is that of a load held, so that a release begins with [X; 0] at rest: there are 2 e
such functionals that are independent, and e of them to choose. So 2 e^2 directions of the matrices change no load
felt, and nothing that follows from them; with fewer than n releases from rest there are more, of which nothing is
known.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics, ModalForm
from aerobalance.identification.coupled.free_response import generator_of
from aerobalance.recording.channel import Array

SAME: Final = 1e-8
"""Part of a load let go, over the largest, that the others leave, below which it is no load of its own."""

DRAWS: Final = 32
"""Choices of the internal coordinates that are tried, of which the best conditioned is taken."""


def coordinates_of(matrices: Array) -> int:
    """Number of coordinates N of A^-1 and A^-1 D given row by row."""
    return round(float(np.sqrt(matrices.size / 2)))


def functionals(spring: Array, brake: Array, let_go: Array) -> Array:
    """Functionals of the state that are zero and at rest where these loads are held, rows, shape (k, 2 N).

    Parameters
    ----------
    spring, brake
        A^-1 and A^-1 D, shape (N, N).
    let_go
        States in which releases begin, columns, shape (2 N, r); those of loads at rest have zeros below the loads.
    """
    held = _independent(let_go)
    both = np.hstack([held, generator_of(spring, brake) @ held])
    return np.linalg.svd(both, full_matrices=True)[0][:, both.shape[1] :].T


def _independent(columns: Array) -> Array:
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return basis[:, sizes > SAME * sizes.max(initial=0.0)]


def held_states(loads: Array, size: int) -> Array:
    """States of loads held, the columns of shape (n, r), in N coordinates: shape (2 N, r)."""
    states = np.zeros((2 * size, loads.shape[1]))
    states[: loads.shape[0]] = loads
    return states


def invariances(matrices: Array, n: int, *, loads: Array) -> Array:
    """Directions of A^-1 and A^-1 D that change no reading when loads (columns, (n, r)) are let go; rows, (k, 2 N^2).

    With the internal row j of the coordinates changed by the functional r, their second derivatives change by
    e_j r G^2 - spring e_j r - brake e_j r G, with G the generator and e_j a column of the unit matrix, signs aside.
    """
    size = coordinates_of(matrices)
    if size == n:
        return np.zeros((0, matrices.size))
    spring, brake = matrices.reshape(2, size, size)
    G = generator_of(spring, brake)
    rows = []
    for functional in functionals(spring, brake, held_states(loads, size)):
        for number in range(n, size):
            change = spring[:, number, None] * functional + brake[:, number, None] * (functional @ G)
            change[number] += functional @ G @ G
            rows.append(-np.concatenate([change[:, :size].ravel(), change[:, size:].ravel()]))
    return np.array(rows).reshape(-1, matrices.size)


def pinned(directions: Array, scale: Array) -> Array:
    """Rows of unit size that hold a step back from directions, for parameters times `scale`."""
    if not len(directions):
        return directions
    return np.linalg.qr((directions * scale).T)[0].T


def renewed(matrices: Array, n: int, *, let_go: Array) -> tuple[Array, Array]:
    """Other internal coordinates, zero and at rest in the states (columns, (2 N, r)) in which releases begin.

    Returns
    -------
    matrices
        A^-1 and A^-1 D in the new coordinates, row by row.
    turn
        What turns the old state into the new one, shape (2 N, 2 N).
    """
    size = coordinates_of(matrices)
    spring, brake = matrices.reshape(2, size, size)
    G = generator_of(spring, brake)
    held = np.linalg.svd(let_go, full_matrices=False)[0][:, :n]  # what lies beyond n of them is noise
    both = np.hstack([held, G @ held])
    free = np.linalg.svd(both, full_matrices=True)[0][:, both.shape[1] :].T
    draws, best, turn = np.random.default_rng(0), np.inf, np.eye(2 * size)
    for _ in range(DRAWS):
        rows = np.linalg.qr(draws.normal(size=(len(free), size - n)))[0].T @ free
        trial = np.eye(2 * size)
        trial[n:size], trial[size + n :] = rows, rows @ G
        condition = float(np.linalg.cond(trial))
        if condition < best:
            best, turn = condition, trial
    lower = (turn @ G @ np.linalg.inv(turn))[size:]
    return -np.concatenate([lower[:, :size].ravel(), lower[:, size:].ravel()]), turn


def static_contributions(form: ModalForm) -> Array:
    """Modal contribution of every mode to the balance loads at rest, the slowest first, shape (N,).

    With poles p, shapes v and weights w these are the traces of -2 Re(v w' / p), which add up to the number of
    components: about 1 for a mode of a rigid model, little for one that shows little in the loads.
    """
    up = np.flatnonzero(form.poles.imag > 0)
    up = up[np.argsort(np.abs(form.poles[up]))]
    parts = np.sum(form.weights[up] * form.shapes[:, up].T, axis=1) / form.poles[up]
    return np.asarray(-2 * parts.real)


def slow_matrices(dynamics: CoupledDynamics) -> tuple[Array, Array, Array]:
    """A and D of F = X + D X' + A X'' to the second order in the frequency, and their whole covariance.

    With blocks 11 of the loads, 12 and 21 towards and from the internal ones, D = D_11 and A = A_11 - D_12 D_21,
    because the blocks off the diagonal have no part at rest. For a rigid model on a sting that bends, A is its mass
    matrix times the flexibility of balance and sting.
    """
    n, size = len(dynamics.components), len(dynamics.inertia)
    D = dynamics.damping
    slopes = np.zeros((2, n, n, 2, size, size))
    unit = np.eye(size)[:n]
    slopes[0, :, :, 0] = slopes[1, :, :, 1] = np.einsum("ia,jb->ijab", unit, unit)
    slopes[0, :, :, 1, :, n:] = -np.einsum("ia,hj->ijah", unit, D[n:, :n])
    slopes[0, :, :, 1, n:, :] -= np.einsum("ih,jb->ijhb", D[:n, n:], unit)
    flat = slopes.reshape(2 * n * n, 2 * size * size)
    return dynamics.inertia[:n, :n] - D[:n, n:] @ D[n:, :n], D[:n, :n], flat @ dynamics.total_covariance @ flat.T


def quasi_static(dynamics: CoupledDynamics) -> CoupledDynamics:
    """Dynamics of `slow_matrices`, of which `covariance` holds all that is not known.

    Raises
    ------
    ValueError
        These make a motion that grows.
    """
    if not dynamics.internal:
        return dynamics.with_calibration
    return CoupledDynamics(dynamics.components, *slow_matrices(dynamics))
