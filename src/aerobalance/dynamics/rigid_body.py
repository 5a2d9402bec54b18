"""A rigid moving mass: its mass matrix, its weight and the loads that keep it turning."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

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
    def matrix(self) -> Array:
        """Mass matrix in the order and signs of `COMPONENTS`, shape (6, 6) [kg, kg*m, kg*m^2].

        Times the acceleration of the balance's centre, its moments turns, it is the load that the acceleration takes.
        """
        across = np.cross(np.eye(3), self.centre)  # rows e x r, so that across.T @ turn = turn x r
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
