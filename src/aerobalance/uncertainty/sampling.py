"""Draws of what is not known exactly: normal numbers of a given covariance, and dynamics with such parameters.

The draws are sets that have exactly the mean and covariance they stand for, so that few of them suffice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import MASS_PARAMETERS, CoupledDynamics, RigidMass
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError
from aerobalance.recording.linalg import covariance_root


def drawn_numbers(generator: np.random.Generator, covariance: Array, draws: int) -> Array:
    """Draws of normal numbers, shape (draws, p), whose mean is zero and whose covariance is exactly that given."""
    root = covariance_root(covariance)
    return np.asarray(_normals(generator, root.shape[1], draws) @ root.T)


def _normals(generator: np.random.Generator, count: int, draws: int) -> Array:
    """Standard normal numbers, shape (draws, count), of which mean and covariance are exact where draws suffice."""
    normals = generator.normal(size=(draws, count))
    if not 0 < count < draws - 1:
        return normals
    normals -= normals.mean(axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(normals.T @ normals / (draws - 1)), normals.T).T)


def drawn_dynamics(generator: np.random.Generator, dynamics: Dynamics, draws: int) -> list[Dynamics]:
    """Draws of the dynamics from the covariance of their parameters.

    Raises
    ------
    FitError
        A draw is not physical.
    """
    changes = drawn_numbers(generator, dynamics.covariance, draws)
    try:
        return [dynamics.with_parameters(dynamics.values + change) for change in changes]
    except ValueError as error:
        raise FitError(
            f"the dynamics of {dynamics.component} are so uncertain that a draw is not physical ({error}); "
            "identify them better"
        ) from None


def drawn_coupled(
    generator: np.random.Generator, dynamics: CoupledDynamics, rows: NDArray[np.intp], draws: int
) -> list[CoupledDynamics]:
    """Draws of coupled dynamics and of their mass from the covariance of the parameters.

    Parameters
    ----------
    generator
        Source of randomness.
    dynamics
        The coupled components.
    rows
        Which of their parameters matter: these and the mass are drawn such that their covariance is exact; the others
        follow as they hang together with them.
    draws
        How many.

    Raises
    ------
    FitError
        A draw is not physical.
    """
    size, mass = len(dynamics.inertia), dynamics.mass
    own = covariance_root(dynamics.covariance[np.ix_(rows, rows)])
    # pinv of the rows' root, in units in which their numbers are alike
    unit = np.sqrt(np.sum(own**2, axis=1, keepdims=True))
    unit[unit == 0] = 1.0
    whole = (dynamics.covariance[:, rows] / unit.T) @ np.linalg.pinv(own / unit).T
    of_mass = np.zeros((len(MASS_PARAMETERS), 0)) if mass is None else covariance_root(mass.covariance)
    normals = _normals(generator, own.shape[1] + of_mass.shape[1], draws)
    found = []
    try:
        for numbers in normals:
            inertia, damping = (whole @ numbers[: own.shape[1]]).reshape(2, size, size)
            change = of_mass @ numbers[own.shape[1] :]
            drawn = replace(
                dynamics,
                inertia=dynamics.inertia + inertia,
                damping=dynamics.damping + damping,
                covariance=np.zeros_like(dynamics.covariance),
                mass=None if mass is None else RigidMass.of_values(mass.values + change),
            )
            found.append(drawn)
    except ValueError as error:
        raise FitError(
            f"the dynamics of {', '.join(dynamics.components)} are so uncertain that a draw is not physical "
            f"({error}); identify them better"
        ) from None
    return found
