"""A rigid moving mass: its mass matrix, its weight and the loads that keep it turning.

As ten numbers, mass, static moments and inertia about the balance, its loads are linear in them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, DIRECTIONS, FROM_VECTORS, MOMENT_ROWS, STANDARD_GRAVITY
from aerobalance.recording.gravity import gravity_components

MASS_PARAMETERS: Final = (
    "mass",
    *(f"centre {axis}" for axis in AXES),
    *(f"inertia {axes}" for axes in ("aft-aft", "right-right", "up-up", "aft-right", "aft-up", "right-up")),
)
"""Order of the rows and columns of `RigidMass.covariance`."""

SMALL: Final = 1e-6
"""Relative change of the mass's parameters over which its slopes are taken; the matrix is a polynomial in them."""

FARTHEST: Final = 5.0
"""Distance of a centre of gravity from the balance's centre, or radius of gyration, from which on units are asked
about [m]: a model sits on its balance, and moments in N*mm that are called N*m put it a thousand times as far away."""

TOO_FAR: Final = (
    "no model is as large: forces and moments are in units that do not go together, such as N with N*mm, or some "
    "are of another balance"
)
"""What that says."""

UNITS_ADVICE: Final = "check the units of loads and capacities in the schedule of the calibration"
"""What to do about it."""


@dataclass(frozen=True, slots=True, eq=False)
class RigidMass:
    """A rigid moving mass about the balance's centre.

    Attributes
    ----------
    mass
        Mass [kg].
    centre
        Centre of gravity along aft, right and up, shape (3,) [m].
    inertia
        Moments of inertia about the centre of gravity, shape (3, 3), symmetric [kg*m^2].
    covariance
        Covariance of mass, centre and the inertia's aa, rr, uu, ar, au, ru, shape (10, 10); all zero where not given.
    """

    mass: float
    centre: Array
    inertia: Array
    covariance: Array = field(default_factory=lambda: np.zeros((10, 10)))

    def __post_init__(self) -> None:
        if not 0 < self.mass < np.inf:
            raise ValueError(f"mass must be positive and finite, not {self.mass}")
        for name, shape in (("centre", (3,)), ("inertia", (3, 3)), ("covariance", (10, 10))):
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"{name} must have shape {shape} and be finite")
        if not np.allclose(self.inertia, self.inertia.T, rtol=1e-9, atol=0):
            raise ValueError("inertia must be symmetric")

    @classmethod
    def of_values(cls, values: Array) -> RigidMass:
        """A mass from values of `MASS_PARAMETERS`, shape (10,), taken as known exactly."""
        aa, rr, uu, ar, au, ru = (float(value) for value in values[4:])
        inertia = np.array([[aa, ar, au], [ar, rr, ru], [au, ru, uu]])
        return cls(float(values[0]), np.array(values[1:4]), inertia)

    @property
    def values(self) -> Array:
        """Values of `MASS_PARAMETERS`, shape (10,)."""
        return np.array([self.mass, *self.centre, *self.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])

    @property
    def reach(self) -> float:
        """Distance of the centre of gravity from the balance's centre or largest radius of gyration [m]."""
        gyration = float(np.sqrt(max(float(np.max(np.diag(self.inertia))), 0.0) / self.mass))
        return max(float(np.linalg.norm(self.centre)), gyration)

    @property
    def matrix(self) -> Array:
        """Mass matrix in the order and signs of `COMPONENTS`, shape (6, 6) [kg, kg*m, kg*m^2].

        Times the acceleration of the balance's centre, its moments turns, it is the load that the acceleration takes.
        """
        x, y, z = self.centre
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # rows e x r, so that across.T @ turn = turn x r
        whole = np.zeros((6, 6))
        whole[:3, :3] = self.mass * np.eye(3)
        whole[:3, 3:] = self.mass * across.T
        whole[3:, :3] = self.mass * across
        whole[3:, 3:] = self.inertia + self.mass * across @ across.T
        return FROM_VECTORS @ whole @ FROM_VECTORS.T

    def weight(self, pitch: ArrayLike, roll: ArrayLike = 0.0, *, gravity: float = STANDARD_GRAVITY) -> Array:
        """Loads of the weight about the balance's centre, shape (n, 6) [N, N*m].

        Parameters
        ----------
        pitch, roll
            Angles nose up and right side down, shape (n,) or one [rad].
        gravity
            Acceleration of gravity [m/s^2].
        """
        return np.asarray(gravity_components(pitch, roll, gravity=gravity) @ self.matrix.T)

    def turning_load(self, rate: Array) -> Array:
        """Loads that keep the mass turning at a steady rate: m w x (w x r) and its moment, with w x I w.

        It is to be added to `matrix` times the acceleration of the balance's centre.

        Parameters
        ----------
        rate
            Turn of the ground end in the signs of PM, YM and RM, shape (n, 3) [rad/s].

        Returns
        -------
        loads
            Shape (n, 6) [N, N*m].
        """
        w = rate @ DIRECTIONS[list(MOMENT_ROWS)]
        force = self.mass * np.cross(w, np.cross(w, self.centre))
        moment = np.cross(self.centre, force) + np.cross(w, w @ self.inertia)
        return np.asarray(np.hstack([force, moment]) @ FROM_VECTORS.T)


@lru_cache(maxsize=4)  # the same for all components and all parts of a record
def mass_slopes(mass: RigidMass) -> list[Array]:
    """Derivatives of the mass matrix by mass, centre of gravity and the six elements of the inertia, (6, 6) each."""
    values = mass.values
    slopes = []
    for place in range(values.size):
        small = SMALL * max(abs(values[place]), 1e-3)
        more, less = values.copy(), values.copy()
        more[place] += small
        less[place] -= small
        slopes.append((RigidMass.of_values(more).matrix - RigidMass.of_values(less).matrix) / (2 * small))
    return slopes


NUMBERS: Final = 10
"""How many: mass [kg], mass times centre [kg*m], and the inertia's aa, rr, uu, ar, au, ru about the balance's centre
[kg*m^2], in the order of `MASS_PARAMETERS`."""

SYMMETRIC: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Rows and columns of the six numbers of a symmetric inertia."""


def mass_basis() -> Array:
    """Mass matrices of a unit of every number, shape (10, 6, 6)."""
    wholes = np.zeros((NUMBERS, 6, 6))
    wholes[0, :3, :3] = np.eye(3)
    for axis in range(3):
        across = np.cross(np.eye(3), np.eye(3)[axis])
        wholes[1 + axis, :3, 3:] = across.T
        wholes[1 + axis, 3:, :3] = across
    for number, (i, j) in enumerate(SYMMETRIC):
        wholes[4 + number, 3 + i, 3 + j] = wholes[4 + number, 3 + j, 3 + i] = 1.0
    return FROM_VECTORS @ wholes @ FROM_VECTORS.T


_BASIS: Final = mass_basis().transpose(2, 1, 0).reshape(6, -1)
"""The same as a table that an acceleration is multiplied with, shape (6, 60)."""


def inertial_loads(motion: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Loads of a unit of every number, shape (m, 6, 10), by accelerations of shape (m, 6) [m/s^2, rad/s^2]."""
    return np.asarray((motion @ _BASIS).reshape(-1, 6, NUMBERS))


def turning_basis(rate: Array) -> Array:
    """Loads that keep a unit of every number turning, shape (n, 6, 10), at rates of turn of shape (n, 3) [rad/s]."""
    loads = np.zeros((rate.shape[0], 6, NUMBERS))
    for axis in range(3):
        centre = np.eye(3)[axis]
        steiner = np.eye(3) - np.outer(centre, centre)  # a mass of 1 with a static moment of 1 and nothing else
        loads[:, :, 1 + axis] = RigidMass(1.0, centre, -steiner).turning_load(rate)
    for number, (i, j) in enumerate(SYMMETRIC):
        inertia = np.zeros((3, 3))
        inertia[i, j] = inertia[j, i] = 1.0
        loads[:, :, 4 + number] = RigidMass(1.0, np.zeros(3), inertia).turning_load(rate)
    return loads


def rigid_of(numbers: Array, covariance: Array) -> RigidMass:
    """The rigid mass with these numbers, its covariance to first order; shapes (10,) and (10, 10).

    Raises
    ------
    ValueError
        The mass is not positive.
    """
    mass, static = float(numbers[0]), numbers[1:4]
    slopes = np.zeros((NUMBERS, NUMBERS))
    slopes[0, 0] = 1.0
    slopes[1:4, 0] = -static / mass**2
    slopes[1:4, 1:4] = np.eye(3) / mass
    steiner = (np.eye(3) * (static @ static) - np.outer(static, static)) / mass
    inertia = np.zeros((3, 3))
    for number, (i, j) in enumerate(SYMMETRIC):
        inertia[i, j] = inertia[j, i] = numbers[4 + number] - steiner[i, j]
        row = slopes[4 + number]
        row[0] = steiner[i, j] / mass
        row[4 + number] = 1.0
        for axis in range(3):
            unit = np.eye(3)[axis]
            row[1 + axis] = -(2 * (i == j) * static[axis] - unit[i] * static[j] - static[i] * unit[j]) / mass
    whole = slopes @ covariance @ slopes.T
    return RigidMass(mass, static / mass, inertia, (whole + whole.T) / 2)
