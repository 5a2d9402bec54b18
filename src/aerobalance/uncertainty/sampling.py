"""Draws of what is not known exactly: normal numbers of a given covariance, and dynamics with such parameters.

A set of draws has exactly the mean and covariance that it stands for, if it has more than one draw beyond the numbers:
means and standard deviations of what follows linearly then need few draws. Quantiles do not gain by it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.rigid_body import MASS_PARAMETERS, RigidMass
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.linalg import covariance_root


def drawn_numbers(generator: np.random.Generator, covariance: Array, draws: int) -> Array:
    """Return draws of normal numbers of mean zero and this covariance, shape (draws, p); exact as above."""
    root = covariance_root(covariance)
    return np.asarray(standard_normals(generator, root.shape[1], draws) @ root.T)


def standard_normals(generator: np.random.Generator, count: int, draws: int) -> Array:
    """Standard normal numbers, shape (draws, count), of which mean and covariance are exact where draws suffice."""
    normals = generator.normal(size=(draws, count))
    if not 0 < count < draws - 1:
        return normals
    normals -= normals.mean(axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(normals.T @ normals / (draws - 1)), normals.T).T)


@dataclass(frozen=True, slots=True, eq=False)
class UncertainDynamics:
    """Dynamics, and their mass, whose parameters follow from some standard normal numbers, seen by one component.

    Attributes
    ----------
    dynamics
        The dynamics.
    parameters
        What the first numbers change the p parameters by, shape (p, any).
    mass
        What the others change the inertial parameters by, shape (10, any).
    """

    dynamics: BalanceDynamics
    parameters: Array
    mass: Array

    @classmethod
    def of(cls, dynamics: BalanceDynamics, rows: NDArray[np.intp]) -> UncertainDynamics:
        """Return those of dynamics with covariances.

        These rows of their parameters and the mass are drawn such that their covariance is exact; the other
        parameters follow as they hang together with them.
        """
        own = covariance_root(dynamics.covariance[np.ix_(rows, rows)])
        # pinv of the rows' root, in units in which their numbers are alike
        unit = np.sqrt(np.sum(own**2, axis=1, keepdims=True))
        unit[unit == 0] = 1.0
        whole = (dynamics.covariance[:, rows] / unit.T) @ np.linalg.pinv(own / unit).T
        mass = dynamics.mass
        of_mass = np.zeros((len(MASS_PARAMETERS), 0)) if mass is None else covariance_root(mass.covariance)
        return cls(dynamics, whole, of_mass)

    @property
    def count(self) -> int:
        """How many numbers there are."""
        return int(self.parameters.shape[1] + self.mass.shape[1])

    def at(self, numbers: Array) -> BalanceDynamics:
        """Return the dynamics at these numbers, shape (count,).

        Raises
        ------
        FitError
            They are not physical.
        """
        dynamics, own = self.dynamics, self.parameters.shape[1]
        try:
            return dynamics.with_parameters(
                dynamics.parameter_values + self.parameters @ numbers[:own],
                dynamics.mass and RigidMass.of_values(dynamics.mass.values + self.mass @ numbers[own:]),
            )
        except ValueError as error:
            raise FitError(
                f"the dynamics of {', '.join(dynamics.components)} are so uncertain that a draw is not physical "
                f"({error}); identify them better"
            ) from None
