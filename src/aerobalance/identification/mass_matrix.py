"""The rigid mass behind identified coupled dynamics, and whether they are those of a rigid mass on an elastic balance.

With a symmetric stiffness, A M = M A^T (A K = M). Its fifteen equations are linear in the ten numbers of a rigid mass
about the balance's centre and leave its scale open, which the weighed mass fixes. With a symmetric damping matrix
C = D A^-1 M as well there are fifteen more. Both are tested, not imposed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from aerobalance.channel import Array
from aerobalance.components import COMPONENTS, MOMENTS
from aerobalance.coupled import VECTORS, CoupledDynamics, RigidMass
from aerobalance.problems import FitError

LEAST_PROBABILITY: Final = 0.001
"""Probability of a departure by chance below which it is taken as real."""

LEVER: Final = 0.1
"""Length that brings moments to the size of forces in the numerics [m]."""

BARELY_FIXED: Final = 1e13
"""Condition of the equations beyond which they leave a part of the mass matrix open."""

_UPPER: Final = np.triu_indices(6, 1)
_SYMMETRIC: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


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
        return cls(square, degrees_of_freedom, float(chi2.sf(square, degrees_of_freedom)))


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
    problem = _Problem.of(dynamics, mass)
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


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The dynamics in units of newton and newton times the lever: values (72,), their covariance, and the mass."""

    values: Array
    covariance: Array
    scale: Array
    mass: float

    @classmethod
    def of(cls, dynamics: CoupledDynamics, mass: float) -> _Problem:
        lever = np.array([LEVER if name in MOMENTS else 1.0 for name in COMPONENTS])
        slowest = float(np.median(np.abs(dynamics.poles)))
        ratio = (lever[None, :] / lever[:, None]).ravel()
        scale = np.concatenate([ratio * slowest**2, ratio * slowest])
        values = np.concatenate([dynamics.inertia.ravel(), dynamics.damping.ravel()]) * scale
        covariance = dynamics.covariance * np.outer(scale, scale)
        if not covariance.any():
            covariance = np.eye(values.size)
        return cls(values, covariance, scale, mass)


@dataclass(frozen=True, slots=True, eq=False)
class _Adjusted:
    """Unknowns (static moments and inertia over mass and levers) that fulfil the equations at adjusted values."""

    unknowns: Array
    covariance: Array
    values: Array
    values_covariance: Array
    square: float


def _basis() -> Array:
    """Mass matrices of a unit mass and of unit values of the nine unknowns, in lever units, shape (10, 6, 6)."""
    turn = np.zeros((6, 6))
    for row, name in enumerate(COMPONENTS):
        turn[row, slice(3, 6) if name in MOMENTS else slice(0, 3)] = VECTORS[name]
    wholes = np.zeros((10, 6, 6))
    wholes[0, :3, :3] = np.eye(3)
    for axis in range(3):
        across = np.cross(np.eye(3), np.eye(3)[axis])
        wholes[1 + axis, :3, 3:] = across.T
        wholes[1 + axis, 3:, :3] = across
    for number, (i, j) in enumerate(_SYMMETRIC):
        wholes[4 + number, 3 + i, 3 + j] = wholes[4 + number, 3 + j, 3 + i] = 1.0
    return np.asarray(turn @ wholes @ turn.T)


def _skew(table: Array) -> Array:
    """The fifteen differences of a matrix and its transpose; leading axes are kept."""
    return np.asarray((table - np.swapaxes(table, -1, -2))[..., _UPPER[0], _UPPER[1]])


def _equations(values: Array, unknowns: Array, *, damping: bool) -> tuple[Array, Array, Array]:
    """Departures, and their derivatives by the values and by the unknowns."""
    basis = _basis()
    A, D = values.reshape(2, 6, 6)
    M = basis[0] + np.tensordot(unknowns, basis[1:], axes=1)
    unit = np.eye(36).reshape(36, 6, 6)
    departure = [_skew(A @ M)]
    by_values = [np.hstack([_skew(unit @ M).T, np.zeros((15, 36))])]
    by_unknowns = [_skew(A @ basis[1:]).T]
    if damping:
        inverse = np.linalg.inv(A)
        friction = D @ inverse
        departure.append(_skew(friction @ M))
        by_A = _skew(-friction @ unit @ inverse @ M).T
        by_values.append(np.hstack([by_A, _skew(unit @ inverse @ M).T]))
        by_unknowns.append(_skew(friction @ basis[1:]).T)
    return np.concatenate(departure), np.vstack(by_values), np.vstack(by_unknowns)


def _first(problem: _Problem) -> Array:
    """Unknowns with all fifteen equations of equal weight."""
    departure, _, slopes = _equations(problem.values, np.zeros(9), damping=False)
    return np.asarray(np.linalg.lstsq(slopes, -departure, rcond=None)[0])


def _adjusted(problem: _Problem, *, damping: bool, start: Array) -> _Adjusted:
    """Least change of the values, in their covariance, with which the equations hold (Gauss-Helmert).

    Raises
    ------
    FitError
        The adjustment does not settle.
    """
    unknowns, values = start, problem.values
    for _ in range(50):
        departure, B, X = _equations(values, unknowns, damping=damping)
        departure = departure + B @ (problem.values - values)
        spread = problem.covariance @ B.T
        weight = np.linalg.pinv(B @ spread, hermitian=True, rcond=1e-14)
        normal = X.T @ weight @ X
        if not np.linalg.cond(normal) < BARELY_FIXED:
            break
        move = -np.linalg.solve(normal, X.T @ weight @ departure)
        left = weight @ (departure + X @ move)
        change = problem.values - spread @ left - values
        unknowns, values = unknowns + move, values + change
        if np.abs(move).max() < 1e-10 * np.abs(unknowns).max() and np.abs(change).max() < 1e-10 * np.abs(values).max():
            covariance = np.linalg.inv(normal)
            inner = weight - weight @ X @ covariance @ X.T @ weight
            return _Adjusted(
                unknowns,
                np.asarray(covariance),
                values,
                problem.covariance - spread @ inner @ spread.T,
                float(left @ (B @ spread) @ left),
            )
    raise FitError(
        "the mass matrix behind the dynamics cannot be found: they are too uncertain, hardly coupled, or far from "
        "those of a rigid mass; add releases, or give mass, centre of gravity and inertia"
    )


def _rigid(adjusted: _Adjusted, mass: float, u_mass: float) -> RigidMass:
    """Mass, centre and inertia about it, with their covariance."""
    power = np.array([LEVER] * 3 + [LEVER**2] * 6)
    about = adjusted.unknowns * power  # over the mass
    centre = about[:3]
    steiner = np.eye(3) * (centre @ centre) - np.outer(centre, centre)
    inertia = np.zeros((3, 3))
    for number, (i, j) in enumerate(_SYMMETRIC):
        inertia[i, j] = inertia[j, i] = mass * (about[3 + number] - steiner[i, j])
    slopes = np.zeros((10, 10))  # of mass, centre, inertia by mass and the nine
    slopes[0, 0] = 1.0
    slopes[1:4, 1:4] = np.eye(3)
    for number, (i, j) in enumerate(_SYMMETRIC):
        row = slopes[4 + number]
        row[0] = inertia[i, j] / mass
        row[4 + number] = mass
        for axis in range(3):
            unit = np.eye(3)[axis]
            row[1 + axis] = -mass * (2 * (i == j) * centre[axis] - unit[i] * centre[j] - centre[i] * unit[j])
    covariance = np.zeros((10, 10))
    covariance[0, 0] = u_mass**2
    covariance[1:, 1:] = adjusted.covariance * np.outer(power, power)
    whole = slopes @ covariance @ slopes.T
    return RigidMass(mass, centre, inertia, (whole + whole.T) / 2)


def _constrained(
    dynamics: CoupledDynamics, problem: _Problem, adjusted: _Adjusted, rigid: RigidMass
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
