"""The rigid mass behind a shaken balance, and whether what was found is rigid, symmetric and as it was weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import null_space

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass, mass_basis, rigid_of
from aerobalance.identification.base_excitation.shaking_fit import (
    DELAY,
    MATRICES,
    ShakeParameters,
    chunks,
    evaluate,
    jacobian,
    known_rows,
    reduced,
    rows_of,
)
from aerobalance.identification.base_excitation.shaking_record import ShakeRecord
from aerobalance.identification.coupled.free_response import generator_of
from aerobalance.identification.rigid_body import LEVER, Departure, adjusted, lever_scale, symmetry_equations
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS


@dataclass(frozen=True, slots=True)
class ShakenMassSettings:
    """Thresholds of the tests of a mass found by base excitation.

    Attributes
    ----------
    loose
        Standard uncertainty that stands for none known of a number of the mass, over the mass and the lever.
    open
        Part of it above which the records leave a number open.
    well_known
        Uncertainty of a number over mass and lever above which the symmetry of the stiffness is brought in.
    exactly
        Relative standard uncertainty that stands for none in a weighed mass.
    independent
        Singular value of the parameters' rows over the largest from which they can do something of their own.
    told
        Part of a free element of the mass matrix beyond what the parameters can do, from which it is told.
    """

    loose: float = 30.0
    open: float = 0.3
    well_known: float = 0.05
    exactly: float = 1e-9
    independent: float = 1e-10
    told: float = 1e-5


SETTINGS: Final = ShakenMassSettings()
"""Thresholds that are used."""


_POWER: Final = np.array([1.0] + [LEVER] * 3 + [LEVER**2] * 6)


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A, D and the numbers of the mass together.

    Attributes
    ----------
    values
        A and D row by row [s^2, s], and ten numbers of the mass; shape (82,).
    covariance
        Shape (82, 82).
    open
        How many combinations of the numbers the records do not tell.
    about
        Size of the mass [kg].
    u_delay
        Standard uncertainty of the delay of the loads [s].
    """

    values: Array
    covariance: Array
    open: int
    about: float
    u_delay: float

    @classmethod
    def of(cls, fit: ShakeParameters, rows: Array, *, about: float) -> Joint:
        """From the rows of a settled fit; `about` is the size of the mass [kg]."""
        count = fit.values.size
        loose = np.zeros((10, count))
        loose[:, MATRICES:DELAY] = np.diag(1 / (SETTINGS.loose * about * _POWER))
        whole = np.vstack([rows[:, :count], loose])
        size = np.linalg.norm(whole, axis=0)
        root = np.linalg.inv(reduced(whole / size)) / size[:, None]
        everything = root @ root.T
        covariance, u_delay = everything[:DELAY, :DELAY], float(np.sqrt(everything[DELAY, DELAY]))
        numbers = covariance[MATRICES:, MATRICES:] / np.outer(_POWER, _POWER) / about**2
        unknown = int(np.count_nonzero(np.linalg.eigvalsh(numbers) > (SETTINGS.open * SETTINGS.loose) ** 2))
        return cls(fit.values[:DELAY], covariance, unknown, about, u_delay)

    def knowing(self, mass: float, u_mass: float) -> Joint:
        """With the weighed mass."""
        gain = self.covariance[:, MATRICES] / (self.covariance[MATRICES, MATRICES] + u_mass**2)
        values = self.values + gain * (mass - self.values[MATRICES])
        covariance = self.covariance - np.outer(gain, self.covariance[MATRICES])
        return Joint(values, (covariance + covariance.T) / 2, self.open, self.about, self.u_delay)

    def dynamics(self, mass: RigidMass | None = None) -> CoupledDynamics:
        """The dynamics."""
        covariance = self.covariance[:MATRICES, :MATRICES].copy()
        np.fill_diagonal(covariance, np.maximum(np.diag(covariance), 0.0))
        A, D = self.values[:MATRICES].reshape(2, 6, 6)
        return CoupledDynamics(COMPONENTS, A, D, covariance, mass)

    @property
    def decays(self) -> bool:
        """Whether every free oscillation of A and D dies out."""
        A, D = self.values[:MATRICES].reshape(2, 6, 6)
        spring = np.asarray(np.linalg.inv(A), dtype=np.float64)
        return bool((np.linalg.eigvals(np.array(generator_of(spring, spring @ D))).real < 0).all())

    @property
    def rigid(self) -> RigidMass | None:
        """The mass with these numbers; None where its mass matrix is not positive."""
        if not self.values[MATRICES] > 0:
            return None
        found = rigid_of(self.values[MATRICES:], self.covariance[MATRICES:, MATRICES:])
        positive = np.linalg.eigvalsh(found.inertia)[0] > 0 and np.linalg.eigvalsh(found.matrix)[0] > 0
        return found if positive else None

    @property
    def least_known(self) -> float:
        """Largest standard uncertainty of a combination of the numbers, over mass and lever."""
        numbers = self.covariance[MATRICES:, MATRICES:] / np.outer(_POWER, _POWER)
        return float(np.sqrt(np.linalg.eigvalsh(numbers)[-1]) / self.about)

    def symmetric(self, *, damping: bool) -> tuple[Joint, float] | None:
        """Least change of everything, in its covariance, that makes the stiffness (and damping) symmetric.

        Combinations of the numbers that the records leave open are free.

        Returns
        -------
        joint, square
            What comes out, and the sum of squares of the change; None where the adjustment does not settle.
        """
        scale = np.concatenate([lever_scale(self.dynamics()), 1 / _POWER / self.about])
        covariance = self.covariance * np.outer(scale, scale)
        free = np.zeros((DELAY, self.open))
        if self.open:
            free[MATRICES:] = np.linalg.eigh(covariance[MATRICES:, MATRICES:])[1][:, -self.open :]
            known = np.eye(DELAY) - free @ free.T
            covariance = known @ covariance @ known

        def equations(values: Array, unknowns: Array) -> tuple[Array, Array, Array]:
            both = values + free @ unknowns
            departure, *slopes = symmetry_equations(both[:MATRICES], both[MATRICES:], damping=damping)
            return departure, np.hstack(slopes), slopes[1] @ free[MATRICES:]

        departure, _, slopes = equations(self.values * scale, np.zeros(self.open))
        start = np.asarray(np.linalg.lstsq(slopes, -departure, rcond=None)[0], dtype=np.float64)
        found = adjusted(self.values * scale, covariance, equations, start=start)
        if found is None:
            return None
        cross = free @ found.cross
        spread = found.values_covariance + free @ found.covariance @ free.T + cross + cross.T
        values = found.values + free @ found.unknowns
        joint = replace(self, values=values / scale, covariance=spread / np.outer(scale, scale), open=0)
        return joint, found.square


@dataclass(frozen=True, slots=True, eq=False)
class ShakenMass:
    """The rigid mass that the ground's motion moves, and its tests.

    Attributes
    ----------
    mass
        Mass, centre of gravity and inertia with their covariance; None where no positive mass matrix was found.
    from_symmetry
        Whether the records leave a part of it open, so that it was taken from A M = M A^T, a symmetric stiffness.
    rigidity
        Whether the loads that the ground's motion makes are those of a rigid mass; up to 26 degrees of freedom.
    symmetry
        Whether A M = M A^T, up to 15 degrees of freedom.
    reciprocity
        Whether the damping is symmetric as well, 15 degrees of freedom.
    weighed
        Whether the mass found is the one that was weighed; None where none was given or none was found.
    implied
        Mass that the records imply without the weighed one, with its standard uncertainty [kg]; None where they leave
        it open.
    constrained
        The dynamics nearest to those found that have symmetric stiffness and damping; None where there are none.
    """

    mass: RigidMass | None
    from_symmetry: bool
    rigidity: Departure | None
    symmetry: Departure | None
    reciprocity: Departure | None
    weighed: Departure | None
    implied: tuple[float, float] | None
    constrained: CoupledDynamics | None


def mass_behind(
    joint: Joint, *, mass: tuple[float, float] | None, rigidity: Departure | None
) -> tuple[Joint, ShakenMass]:
    """Bring in the weighed mass, test the symmetries, and take the mass.

    Parameters
    ----------
    joint
        What the records tell.
    mass
        Weighed mass and its standard uncertainty [kg], or None.
    rigidity
        Test of the rigid mass.
    """
    weighed, implied = None, None
    u = float(np.sqrt(joint.covariance[MATRICES, MATRICES]))
    if u < SETTINGS.open * abs(joint.values[MATRICES]):
        implied = float(joint.values[MATRICES]), u
    if mass is not None:
        value, u_mass = mass[0], max(mass[1], SETTINGS.exactly * mass[0])
        if implied is not None:
            weighed = Departure.of((implied[0] - value) ** 2 / (u**2 + u_mass**2), 1)
        if weighed is None or weighed.chance:
            joint = joint.knowing(value, u_mass)
    plain, also_damping = joint.symmetric(damping=False), joint.symmetric(damping=True)
    if plain is None or also_damping is None:
        return joint, ShakenMass(joint.rigid, False, rigidity, None, None, weighed, implied, None)
    (stiff, square), (both, more) = plain, also_damping
    free = 15 - joint.open
    symmetry = Departure.of(square, free) if free > 0 else None
    reciprocity = Departure.of(max(more - square, 0.0), 15)
    constrained = both.dynamics(both.rigid) if both.decays else None
    taken = joint.open > 0 or joint.least_known > SETTINGS.well_known
    found = (stiff if taken else joint).rigid
    return joint, ShakenMass(found, taken, rigidity, symmetry, reciprocity, weighed, implied, constrained)


def rows_with_free_mass(records: Sequence[ShakeRecord], fit: ShakeParameters) -> Array:
    """Triangular rows of the derivatives by the parameters, and by what a mass matrix has beyond a rigid mass.

    Returns
    -------
    rows
        Columns for the parameters, for 26 free elements of the mass matrix, and minus the residual.
    """
    others = null_space(mass_basis().reshape(10, 36))
    known = known_rows(fit)
    rows = np.hstack([known[:, :-1], np.zeros((known.shape[0], others.shape[1])), known[:, -1:]])
    for record in records:
        for part in chunks(record):
            here = evaluate(part, fit)
            whole = (here.weight[:, :, :, None] * here.motion[:, None, None, :]).reshape(-1, 6, 36)
            both = np.concatenate([jacobian(part, here, fit), whole @ others], axis=2)
            rows = reduced(np.vstack([rows, rows_of(both, here.residual, record.share)]))
    return rows


def rigidity_test(rows: Array, count: int) -> Departure | None:
    """Whether a mass matrix with elements of its own explains the records better than that of a rigid mass.

    What is left by the fit is compared with what the elements beyond the rigid mass would change, once all that the
    parameters can do is taken out of both.

    Parameters
    ----------
    rows
        As `rows_with_free_mass` gives them.
    count
        Number of the parameters.
    """
    size = np.linalg.norm(rows[:, count:-1], axis=0)
    moving = size > SETTINGS.told * size.max(initial=0.0)
    rest = rows[:, count:-1][:, moving] / size[moving]
    left, values, _ = np.linalg.svd(rows[:, :count] / _sizes(rows[:, :count]), full_matrices=False)
    can = left[:, values > SETTINGS.independent * values[0]]
    rest, target = rest - can @ (can.T @ rest), rows[:, -1] - can @ (can.T @ rows[:, -1])
    free, values, _ = np.linalg.svd(rest, full_matrices=False)
    told = values > SETTINGS.told
    if not told.any():
        return None
    return Departure.of(float(np.sum((free[:, told].T @ target) ** 2)), int(np.count_nonzero(told)))


def _sizes(table: Array) -> Array:
    size = np.linalg.norm(table, axis=0)
    return np.where(size > 0, size, 1.0)
