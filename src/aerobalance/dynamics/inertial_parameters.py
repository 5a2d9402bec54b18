"""A rigid mass as ten numbers in which its loads are linear: mass, static moments and inertia about the balance."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array
from aerobalance.recording.components import FROM_VECTORS

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
