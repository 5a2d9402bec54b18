"""What the uncertainty of identified coupled dynamics leaves in the force, for a load that is stated."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.channel import Array
from aerobalance.coupled import CoupledDynamics

BEYOND: Final = 1.2
"""Upper end of the band of the stated load, over the highest natural frequency."""

PANEL: Final = np.polynomial.legendre.leggauss(8)
"""Nodes and weights of an integral over one panel of frequencies."""


def predicted_force_error(
    dynamics: CoupledDynamics, *, sizes: ArrayLike, band: tuple[float, float] | None = None
) -> Array:
    """Error of the force that comes from the uncertainty of the dynamics alone, rms by component.

    The force is taken from noise-free loads felt by F = X + D X' + A X'', so what remains is dD X' + dA X''. No
    smoother stands between, which would damp the error where noise dominates.

    Parameters
    ----------
    dynamics
        Dynamics with their covariance.
    sizes
        Rms of the load applied in every component, shape (n,) [N, N*m]; components are independent of each other.
    band
        Frequencies between which the load is white [Hz]; where not given, from zero to 1.2 times the highest mode.

    Returns
    -------
    error
        Rms error of every component, shape (n,) [N, N*m].
    """
    return error_of(dynamics.covariance, motion_power(dynamics, sizes=sizes, band=band))


def error_of(covariance: Array, power: Array) -> Array:
    """Rms error of the force by component, from the covariance of the dynamics and the power of `motion_power`."""
    n = power.shape[0] // 2
    whole = covariance.reshape(2, n, n, 2, n, n)
    rows = np.einsum("aibcid->iabcd", whole)  # of row i of inertia and damping
    square = np.einsum("iabcd,abcd->i", rows, power.reshape(2, n, 2, n))
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def true_force_error(dynamics: CoupledDynamics, truth: CoupledDynamics, *, power: Array) -> Array:
    """Rms error of the force by component when these dynamics stand for the true ones, shape (n,)."""
    rows = np.hstack([dynamics.inertia - truth.inertia, dynamics.damping - truth.damping])
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, power, rows), 0.0)))


def motion_power(dynamics: CoupledDynamics, *, sizes: ArrayLike, band: tuple[float, float] | None = None) -> Array:
    """Mean products of the loads' second and first derivatives under a load white in a band, shape (2 n, 2 n)."""
    n = len(dynamics.components)
    sizes = np.asarray(sizes, dtype=np.float64)
    if sizes.shape != (n,) or not (np.isfinite(sizes).all() and (sizes >= 0).all()):
        raise ValueError(f"sizes must be {n} numbers, zero or more, not {sizes}")
    low, high = (0.0, highest_of(dynamics)) if band is None else band
    if not 0 <= low < high:
        raise ValueError(f"band must rise from zero or more, not {low:g} to {high:g} Hz")
    frequency, weight = _grid(dynamics, low, high)
    s = 2j * np.pi * frequency[:, None, None]
    felt = dynamics.response(frequency) * sizes
    both = np.concatenate([s**2 * felt, s * felt], axis=1)
    flat = np.transpose(both * np.sqrt(weight / (high - low))[:, None, None], (1, 0, 2)).reshape(2 * n, -1)
    return np.asarray(np.real(flat @ flat.conj().T))


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
