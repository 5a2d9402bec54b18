"""What the uncertainty of identified coupled dynamics leaves in the force, for a load that is stated."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.recording.channel import Array

BEYOND: Final = 1.2
"""Upper end of the band of the stated load, over the highest natural frequency."""

PANEL: Final = np.polynomial.legendre.leggauss(8)
"""Nodes and weights of an integral over one panel of frequencies."""


def error_of(covariance: Array, weights: Array) -> Array:
    """Rms error of the force by component, from the covariance of the dynamics and what `force_weights` gives."""
    square = np.einsum("ipq,pq->i", weights, covariance)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def true_force_error(
    dynamics: CoupledDynamics, truth: CoupledDynamics, *, sizes: ArrayLike, band: tuple[float, float] | None = None
) -> Array:
    """Rms error of the force by component when these dynamics stand for the true ones, shape (n,)."""
    frequency, weight, sizes = _load(truth, sizes, band)
    change = dynamics.inverse_response(frequency) - truth.inverse_response(frequency)
    error = change @ (truth.response(frequency) * sizes)
    return np.asarray(np.sqrt(np.einsum("f,fij->i", weight, np.abs(error) ** 2)))


def force_weights(dynamics: CoupledDynamics, *, sizes: ArrayLike, band: tuple[float, float] | None = None) -> Array:
    """What turns errors of A and D into squares of errors of the force under a load white in a band.

    The force is F = L (Z + D Z' + A Z''), where Z are the balance loads with the internal coordinates that go with
    them, and L = [1, -P_12 P_22^-1] with the blocks of P = 1 + D s + A s^2. Without internal ones it is
    F = X + D X' + A X''. No smoother stands between, which would damp the error where noise dominates.

    Parameters
    ----------
    dynamics
        Coupled dynamics.
    sizes
        Rms of the load applied in every component, shape (n,) [N, N*m]; components are independent of each other.
    band
        Frequencies between which the load is white [Hz]; where not given, from zero to 1.2 times the highest mode.

    Returns
    -------
    weights
        Shape (n, 2 N^2, 2 N^2), with rows and columns in the order of `CoupledDynamics.parameters`.
    """
    n, size = len(dynamics.components), len(dynamics.inertia)
    frequency, weight, sizes = _load(dynamics, sizes, band)
    s = 2j * np.pi * frequency
    whole = dynamics.equation(s)
    moved = np.linalg.inv(whole)[:, :, :n] * sizes
    both = np.concatenate([s[:, None, None] ** 2 * moved, s[:, None, None] * moved], axis=1)
    power = np.einsum("f,fak,fbk->fab", weight, both, both.conj(), optimize=True)
    taken = np.zeros((frequency.size, n, size), dtype=np.complex128)
    taken[:, :, :n] = np.eye(n)
    if dynamics.internal:
        taken[:, :, n:] = -np.swapaxes(
            np.linalg.solve(np.swapaxes(whole[:, n:, n:], 1, 2), np.swapaxes(whole[:, :n, n:], 1, 2)), 1, 2
        )
    found = np.empty((n, 2 * size * size, 2 * size * size))
    for row in range(n):
        left = np.einsum("fa,fb->fab", taken[:, row], taken[:, row].conj()).reshape(frequency.size, -1)
        table = np.real(left.T @ power.reshape(frequency.size, -1)).reshape(size, size, 2, size, 2, size)
        found[row] = np.transpose(table, (2, 0, 3, 4, 1, 5)).reshape(found[row].shape)
    return found


def _load(dynamics: CoupledDynamics, sizes: ArrayLike, band: tuple[float, float] | None) -> tuple[Array, Array, Array]:
    """Frequencies, weights of a mean over the band, and the sizes of the load, checked."""
    n = len(dynamics.components)
    sizes = np.asarray(sizes, dtype=np.float64)
    if sizes.shape != (n,) or not (np.isfinite(sizes).all() and (sizes >= 0).all()):
        raise ValueError(f"sizes must be {n} numbers, zero or more, not {sizes}")
    low, high = (0.0, highest_of(dynamics)) if band is None else band
    if not 0 <= low < high:
        raise ValueError(f"band must rise from zero or more, not {low:g} to {high:g} Hz")
    frequency, weight = _grid(dynamics, low, high)
    return frequency, weight / (high - low), sizes


def highest_of(dynamics: CoupledDynamics) -> float:
    """Upper end of the band of the stated load [Hz]: 1.2 times the highest natural frequency."""
    return BEYOND * float(np.abs(dynamics.poles).max()) / (2 * np.pi)


def _grid(dynamics: CoupledDynamics, low: float, high: float) -> tuple[Array, Array]:
    """Frequencies and weights of an integral that resolves every resonance."""
    reach = np.concatenate([[0.0], 0.5 * 2.0 ** np.arange(12)])
    edges = [np.linspace(low, high, 65)]
    for pole in dynamics.poles:
        centre, width = abs(pole.imag) / (2 * np.pi), abs(pole.real) / (2 * np.pi)
        edges += [centre + width * reach, centre - width * reach]
    cuts = np.unique(np.clip(np.concatenate(edges), low, high))
    half = np.diff(cuts) / 2
    middle = (cuts[1:] + cuts[:-1]) / 2
    return (middle[:, None] + half[:, None] * PANEL[0]).ravel(), (half[:, None] * PANEL[1]).ravel()
