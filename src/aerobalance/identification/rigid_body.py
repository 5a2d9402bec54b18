"""The rigid mass behind identified coupled dynamics, and whether they are those of a rigid mass on an elastic balance.

With a symmetric stiffness, A M = M A^T (A K = M). Its fifteen equations are linear in the ten numbers of a rigid mass
about the balance's centre and leave its scale open, which the weighed mass fixes. With a symmetric damping matrix
C = D A^-1 M as well there are fifteen more. Both are tested, not imposed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import chdtrc

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass, mass_basis, rigid_of
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.errors import FitError

LEAST_PROBABILITY: Final = 0.001
"""Probability of a departure by chance below which it is taken as real."""

LEVER: Final = 0.1
"""Length that brings moments to the size of forces in the numerics [m]."""

BARELY_FIXED: Final = 1e13
"""Condition of the equations beyond which they leave a part of the mass matrix open."""

SETTLED: Final = 1e-8
"""Change of the adjusted values, over the largest of them, at which an adjustment has settled."""

Equations = Callable[[Array, Array], tuple[Array, Array, Array]]
"""Departures from equations at values and unknowns, and their derivatives by both."""

_UPPER: Final = np.triu_indices(6, 1)


@dataclass(frozen=True, slots=True)
class Departure:
    """Test of equations that hold without noise.

    Attributes
    ----------
    chi2
        Sum of squares that the noise of the dynamics would need to explain the departure.
    degrees_of_freedom
        Its expectation where the equations hold.
    p_value
        Probability of a chi2 as large by chance.
    """

    chi2: float
    degrees_of_freedom: int
    p_value: float

    @property
    def chance(self) -> bool:
        """Whether the departure can be chance (a probability of 0.001 or more)."""
        return self.p_value >= LEAST_PROBABILITY

    @classmethod
    def of(cls, square: float, degrees_of_freedom: int) -> Departure:
        """Test a sum of squares."""
        return cls(square, degrees_of_freedom, float(chdtrc(degrees_of_freedom, square)))


@dataclass(frozen=True, slots=True, eq=False)
class RigidMassFit:
    """The rigid mass behind coupled dynamics.

    Attributes
    ----------
    mass
        Mass, centre of gravity and inertia with their covariance; found from A and the weighed mass alone.
    rigidity
        Whether A is that of a rigid mass on a balance of symmetric stiffness, 6 degrees of freedom; None without a
        covariance of the dynamics.
    reciprocity
        Whether the damping matrix C is symmetric as well, 15 degrees of freedom; None likewise.
    constrained
        The dynamics that are exactly those of a rigid mass with symmetric stiffness and damping, nearest to the ones
        given, with the smaller covariance that this knowledge leaves; with the mass that belongs to them. To be used
        where both tests pass.
    """

    mass: RigidMass
    rigidity: Departure | None
    reciprocity: Departure | None
    constrained: CoupledDynamics


def rigid_mass_of(dynamics: CoupledDynamics, mass: float, *, u_mass: float = 0.0) -> RigidMassFit:
    """Find the rigid mass behind coupled dynamics from A M = M A^T and its weighed mass.

    Parameters
    ----------
    dynamics
        Dynamics of all six components with their covariance; without one, all equations count alike.
    mass
        Weighed mass [kg].
    u_mass
        Its standard uncertainty [kg].

    Raises
    ------
    ValueError
        There are not six components, or mass or uncertainty are impossible.
    FitError
        No positive mass matrix belongs to the dynamics.
    """
    if dynamics.components != COMPONENTS:
        raise ValueError(f"a rigid mass needs all of {', '.join(COMPONENTS)}, not {', '.join(dynamics.components)}")
    if not (0 < mass < np.inf and 0 <= u_mass < np.inf):
        raise ValueError(f"mass must be positive, its uncertainty zero or more: {mass}, {u_mass}")
    problem = _ScaledDynamics.of(dynamics, mass)
    rigid = _adjusted(problem, damping=False, start=_first(problem))
    both = _adjusted(problem, damping=True, start=rigid.unknowns)
    known = bool(dynamics.covariance.any())
    found = _rigid(rigid, mass, u_mass)
    matrix = np.linalg.eigvalsh(found.matrix)
    if matrix[0] <= 0 or np.linalg.eigvalsh(found.inertia)[0] <= 0:
        raise FitError(
            "the mass matrix behind the dynamics is not positive: they are too uncertain for it, or the mass is not "
            "rigid; add releases, or give mass, centre of gravity and inertia"
        )
    return RigidMassFit(
        mass=found,
        rigidity=Departure.of(rigid.square, 6) if known else None,
        reciprocity=Departure.of(max(both.square - rigid.square, 0.0), 15) if known else None,
        constrained=_constrained(dynamics, problem, both, _rigid(both, mass, u_mass)),
    )


def centre_agreement(rigid: RigidMass, centre: Array, *, covariance: Array) -> Departure:
    """Test whether the centre of gravity is the one that weighing found.

    Parameters
    ----------
    rigid
        Mass found from dynamics.
    centre
        Weighing's centre of gravity along aft, right and up, shape (3,) [m].
    covariance
        Its covariance, shape (3, 3) [m^2].
    """
    difference = rigid.centre - np.asarray(centre, dtype=np.float64)
    together = rigid.covariance[1:4, 1:4] + np.asarray(covariance, dtype=np.float64)
    return Departure.of(float(difference @ np.linalg.pinv(together, hermitian=True) @ difference), 3)


def lever_scale(dynamics: CoupledDynamics) -> Array:
    """What brings A and D, row by row, to units of newton, newton times the lever, and one; shape (72,)."""
    lever = np.array([LEVER if name in MOMENTS else 1.0 for name in COMPONENTS])
    slowest = float(np.median(np.abs(dynamics.poles)))
    ratio = (lever[None, :] / lever[:, None]).ravel()
    return np.concatenate([ratio * slowest**2, ratio * slowest])


@dataclass(frozen=True, slots=True, eq=False)
class _ScaledDynamics:
    """The dynamics in units of newton and newton times the lever: values (72,), their covariance, and the mass."""

    values: Array
    covariance: Array
    scale: Array
    mass: float

    @classmethod
    def of(cls, dynamics: CoupledDynamics, mass: float) -> _ScaledDynamics:
        scale = lever_scale(dynamics)
        values = np.concatenate([dynamics.inertia.ravel(), dynamics.damping.ravel()]) * scale
        covariance = dynamics.covariance * np.outer(scale, scale)
        if not covariance.any():
            covariance = np.eye(values.size)
        return cls(values, covariance, scale, mass)


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Unknowns that fulfil equations at adjusted values.

    Attributes
    ----------
    unknowns, covariance
        Shape (k,) and (k, k).
    values, values_covariance
        Shape (n,) and (n, n).
    cross
        Covariance of unknowns and values, shape (k, n).
    square
        Sum of squares of the change of the values.
    """

    unknowns: Array
    covariance: Array
    values: Array
    values_covariance: Array
    cross: Array
    square: float


def _skew(table: Array) -> Array:
    """The fifteen differences of a matrix and its transpose; leading axes are kept."""
    return (table - np.swapaxes(table, -1, -2))[..., _UPPER[0], _UPPER[1]]


def symmetry_equations(values: Array, numbers: Array, *, damping: bool) -> tuple[Array, Array, Array]:
    """Departures from symmetry of A M, and of D A^-1 M where the damping is to be symmetric too.

    Parameters
    ----------
    values
        A and D row by row, shape (72,).
    numbers
        Ten numbers of the mass behind M = sum numbers `mass_basis`.
    damping
        Whether the damping is looked at.

    Returns
    -------
    departure, by_values, by_numbers
        Fifteen or thirty differences, and their derivatives by the values, and by the numbers.
    """
    basis = mass_basis()
    A, D = values.reshape(2, 6, 6)
    M = np.tensordot(numbers, basis, axes=1)
    unit = np.eye(36).reshape(36, 6, 6)
    departure = [_skew(A @ M)]
    by_values = [np.hstack([_skew(unit @ M).T, np.zeros((15, 36))])]
    by_numbers = [_skew(A @ basis).T]
    if damping:
        inverse = np.linalg.inv(A)
        friction = D @ inverse
        departure.append(_skew(friction @ M))
        by_A = _skew(-friction @ unit @ inverse @ M).T
        by_values.append(np.hstack([by_A, _skew(unit @ inverse @ M).T]))
        by_numbers.append(_skew(friction @ basis).T)
    return np.concatenate(departure), np.vstack(by_values), np.vstack(by_numbers)


def _equations(values: Array, unknowns: Array, *, damping: bool) -> tuple[Array, Array, Array]:
    """The same for a mass of one whose other nine numbers are the unknowns."""
    departure, by_values, by_numbers = symmetry_equations(values, np.append(1.0, unknowns), damping=damping)
    return departure, by_values, by_numbers[:, 1:]


def _first(problem: _ScaledDynamics) -> Array:
    """Unknowns with all fifteen equations of equal weight."""
    departure, _, slopes = _equations(problem.values, np.zeros(9), damping=False)
    return np.asarray(np.linalg.lstsq(slopes, -departure, rcond=None)[0])


def _adjusted(problem: _ScaledDynamics, *, damping: bool, start: Array) -> Adjusted:
    """Least change of the dynamics with which the equations of symmetry hold.

    Raises
    ------
    FitError
        The adjustment does not settle.
    """
    found = adjusted(problem.values, problem.covariance, lambda v, u: _equations(v, u, damping=damping), start=start)
    if found is None:
        raise FitError(
            "the mass matrix behind the dynamics cannot be found: they are too uncertain, hardly coupled, or far from "
            "those of a rigid mass, as where bridges are exchanged, have another sign or matrix, or are late against "
            "each other; look at these, add releases, or give mass, centre of gravity and inertia"
        )
    return found


def adjusted(given: Array, covariance: Array, equations: Equations, *, start: Array) -> Adjusted | None:
    """Least change of values, in their covariance, with which equations hold (Gauss-Helmert); None if none settles.

    Parameters
    ----------
    given, covariance
        Values, shape (n,), and their covariance.
    equations
        Departures at values and unknowns, with their derivatives by both.
    start
        Unknowns to begin with, shape (k,).
    """
    unknowns, values = start, given
    for _ in range(50):
        departure, B, X = equations(values, unknowns)
        departure = departure + B @ (given - values)
        spread = covariance @ B.T
        weight = np.linalg.pinv(B @ spread, hermitian=True, rcond=1e-14)
        normal = X.T @ weight @ X
        if unknowns.size and not np.linalg.cond(normal) < BARELY_FIXED:
            break
        move = -np.linalg.solve(normal, X.T @ weight @ departure)
        left = weight @ (departure + X @ move)
        change = given - spread @ left - values
        unknowns, values = unknowns + move, values + change
        settled = np.abs(change).max() < SETTLED * np.abs(values).max()
        if settled and np.abs(move).max(initial=0.0) <= SETTLED * np.abs(unknowns).max(initial=0.0):
            own = np.linalg.inv(normal)
            inner = weight - weight @ X @ own @ X.T @ weight
            return Adjusted(
                unknowns,
                np.asarray(own),
                values,
                covariance - spread @ inner @ spread.T,
                -own @ X.T @ weight @ spread.T,
                float(left @ (B @ spread) @ left),
            )
    return None


def _rigid(adjusted: Adjusted, mass: float, u_mass: float) -> RigidMass:
    """Mass, centre and inertia about it, with their covariance."""
    power = np.array([LEVER] * 3 + [LEVER**2] * 6)
    about = adjusted.unknowns * power  # over the mass
    slopes = np.zeros((10, 10))  # of the ten numbers by mass and the nine
    slopes[:, 0] = np.append(1.0, about)
    slopes[1:, 1:] = mass * np.eye(9)
    covariance = np.zeros((10, 10))
    covariance[0, 0] = u_mass**2
    covariance[1:, 1:] = adjusted.covariance * np.outer(power, power)
    return rigid_of(mass * np.append(1.0, about), slopes @ covariance @ slopes.T)


def _constrained(
    dynamics: CoupledDynamics, problem: _ScaledDynamics, adjusted: Adjusted, rigid: RigidMass
) -> CoupledDynamics:
    """The adjusted dynamics."""
    values = adjusted.values / problem.scale
    covariance = adjusted.values_covariance / np.outer(problem.scale, problem.scale)
    covariance = (covariance + covariance.T) / 2
    np.fill_diagonal(covariance, np.maximum(np.diag(covariance), 0.0))
    return replace(
        dynamics,
        inertia=values[:36].reshape(6, 6),
        damping=values[36:].reshape(6, 6),
        covariance=covariance if dynamics.covariance.any() else dynamics.covariance,
        mass=rigid,
    )
