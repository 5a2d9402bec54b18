"""Coupled dynamics from weighing, stiffness and geometry, to stand beside those identified from releases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.identification.rigid_body import Departure
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS

INDEPENDENT: Final = 1e-10
"""Variance of a combination of elements, over the largest, below which it is rounding."""

_LOWER = np.tril_indices(6)


@dataclass(frozen=True, slots=True)
class ElementDifference:
    """One element of A or D, found in two ways.

    Attributes
    ----------
    name
        ``"inertia row/column"`` or ``"damping row/column"``.
    first, second
        The two values [SI].
    u
        Standard uncertainty of their difference.
    ratio
        Second less first over `u`; NaN where neither has an uncertainty.
    """

    name: str
    first: float
    second: float
    u: float
    ratio: float


def coupled_from_stiffness(
    stiffness: ArrayLike,
    mass: RigidMass,
    *,
    damping_ratios: ArrayLike,
    u_stiffness: ArrayLike | None = None,
    u_damping_ratios: ArrayLike | None = None,
) -> CoupledDynamics:
    """Dynamics of a rigid mass on a balance of known stiffness, with a damping ratio for each mode.

    A = M K^-1 and D = C K^-1 with the mass and stiffness of Eq. (8) of [Gorbushin2020]_ as matrices.

    Parameters
    ----------
    stiffness
        K in the order of `COMPONENTS`, shape (6, 6), symmetric and positive: loads over displacements of the
        balance's centre and turns [N/m, N, N*m].
    mass
        The moving mass.
    damping_ratios
        Damping ratio of every mode, the slowest first, or one for all.
    u_stiffness
        Standard uncertainty of every element of K, shape (6, 6); zero where not given.
    u_damping_ratios
        Standard uncertainties of the damping ratios.

    Raises
    ------
    ValueError
        The stiffness is not symmetric and positive, or a ratio is not between 0 and 1.
    """
    K = np.asarray(stiffness, dtype=np.float64)
    if K.shape != (6, 6) or not np.allclose(K, K.T, rtol=1e-9, atol=0) or np.linalg.eigvalsh(K)[0] <= 0:
        raise ValueError("stiffness must be a symmetric, positive matrix of shape (6, 6)")
    ratios = np.broadcast_to(np.asarray(damping_ratios, dtype=np.float64), (6,))
    if not ((ratios > 0) & (ratios < 1)).all():
        raise ValueError(f"damping_ratios must lie between 0 and 1, not {ratios}")
    u_K = np.zeros((6, 6)) if u_stiffness is None else np.broadcast_to(np.asarray(u_stiffness, dtype=float), (6, 6))
    u_ratios = np.broadcast_to(np.asarray(0.0 if u_damping_ratios is None else u_damping_ratios, dtype=float), (6,))
    inputs = np.concatenate([K[_LOWER], mass.values, ratios])
    spread = np.zeros((37, 37))
    spread[:21, :21] = np.diag(u_K[_LOWER] ** 2)
    spread[21:31, 21:31] = mass.covariance
    spread[31:, 31:] = np.diag(u_ratios**2)
    slopes = _slopes(_matrices, inputs, spread)
    A, D = _matrices(inputs).reshape(2, 6, 6)
    covariance = slopes @ spread @ slopes.T
    return CoupledDynamics(COMPONENTS, A, D, (covariance + covariance.T) / 2, mass)


def compare_coupled(first: CoupledDynamics, second: CoupledDynamics) -> tuple[ElementDifference, ...]:
    """Compare A and D found in two ways, element by element, in combined standard uncertainties.

    Raises
    ------
    ValueError
        The components are not the same.
    """
    if first.components != second.components:
        raise ValueError(
            f"the dynamics have different components: {', '.join(first.components)} and {', '.join(second.components)}"
        )
    if first.inertia.shape != second.inertia.shape:
        raise ValueError("one of the dynamics has modes beyond the components; element by element they differ by them")
    ours = np.concatenate([first.inertia.ravel(), first.damping.ravel()])
    theirs = np.concatenate([second.inertia.ravel(), second.damping.ravel()])
    u = np.sqrt(np.diag(first.total_covariance) + np.diag(second.total_covariance))
    ratio = np.divide(theirs - ours, u, out=np.full(u.size, np.nan), where=u > 0)
    rows = zip(first.parameters, ours, theirs, u, ratio, strict=True)
    return tuple(ElementDifference(name, float(a), float(b), float(c), float(d)) for name, a, b, c, d in rows)


def agreement(first: CoupledDynamics, second: CoupledDynamics, *, damping: bool) -> Departure | None:
    """Test whether A, and D where it is found twice, are the same; None where neither has an uncertainty.

    Combinations of elements in which neither has one must not be told apart by rounding, and are left out.
    """
    count = first.inertia.size * (2 if damping else 1)
    ours = np.concatenate([first.inertia.ravel(), first.damping.ravel()])[:count]
    theirs = np.concatenate([second.inertia.ravel(), second.damping.ravel()])[:count]
    together = (first.total_covariance + second.total_covariance)[:count, :count]
    u = np.sqrt(np.diag(together))
    known = u > 0
    if not known.any():
        return None
    z = (theirs - ours)[known] / u[known]
    values, directions = np.linalg.eigh(together[np.ix_(known, known)] / np.outer(u[known], u[known]))
    told = values > INDEPENDENT * values[-1]
    return Departure.of(float(np.sum((directions.T @ z)[told] ** 2 / values[told])), int(np.count_nonzero(told)))


def _matrices(inputs: Array) -> Array:
    """A and D row by row, from the lower triangle of K, the numbers of the mass, and the damping ratios."""
    K = np.zeros((6, 6))
    K[_LOWER] = inputs[:21]
    K = K + np.tril(K, -1).T
    M = RigidMass.of_values(inputs[21:31]).matrix
    squares, shapes = eigh(K, M)
    C = M @ shapes @ np.diag(2 * inputs[31:] * np.sqrt(squares)) @ shapes.T @ M
    return np.concatenate([np.linalg.solve(K, M).T.ravel(), np.linalg.solve(K, C).T.ravel()])


def _slopes(function: Callable[[Array], Array], inputs: Array, spread: Array) -> Array:
    """Derivatives of a function by the inputs that are uncertain, by central differences over a part of that."""
    slopes = np.zeros((function(inputs).size, inputs.size))
    for number, u in enumerate(np.sqrt(np.diag(spread))):
        if u > 0:
            step = np.zeros(inputs.size)
            step[number] = 0.1 * u
            slopes[:, number] = (function(inputs + step) - function(inputs - step)) / (0.2 * u)
    return slopes
