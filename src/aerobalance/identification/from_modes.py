"""Dynamics from poles and mode shapes that another program has found, as balance loads in every mode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.coupled.conclusions import rigid_of
from aerobalance.identification.coupled.era import from_modes
from aerobalance.identification.rigid_body import RigidMassFit
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError, warn_quality


def one_of_pole(pole: complex, component: str, *, mass: float | tuple[float, float]) -> Dynamics:
    """Return the dynamics of one component with this pole [rad/s] and a weighed mass.

    Of the pole no uncertainty is known, so that all that is stated is that of the mass.
    """
    value, u = mass if isinstance(mass, tuple) else (mass, 0.0)
    square, twice = abs(pole) ** 2, -2 * pole.real
    if not twice > 0:
        raise FitError(f"the pole {pole:.6g} 1/s does not decay")
    covariance = np.zeros((4, 4))
    by_mass = np.array([1.0, square, twice, 0.0])
    covariance += u**2 * np.outer(by_mass, by_mass)
    return Dynamics(component, value, value * square, value * twice, covariance=covariance)


def dynamics_of_modes(
    poles: NDArray[np.complex128],
    shapes: NDArray[np.complex128],
    *,
    mass: float | tuple[float, float] | None = None,
) -> tuple[CoupledDynamics, RigidMassFit | None]:
    """Return A and D of all six components that have these modes, Eq. (17) of [Gorbushin2020]_ with matrices.

    Parameters
    ----------
    poles
        Of the six modes, one of each pair, shape (6,) [rad/s].
    shapes
        Balance loads in any scale, a mode in each row, columns in the order of `COMPONENTS`, shape (6, 6).
    mass
        Weighed mass [kg], exact or with its standard uncertainty; it gives the mass matrix.

    Raises
    ------
    FitError
        There are not six modes with all six loads, they do not decay, or their shapes are not independent.
    """
    n = len(COMPONENTS)
    if poles.shape != (n,):
        raise FitError(f"{n} components need {n} modes, one for each; there are {poles.size}")
    if not np.isfinite(shapes).all():
        there = [bool(np.isfinite(column).all()) for column in shapes.T]
        lacking = [name for name, whole in zip(COMPONENTS, there, strict=True) if not whole]
        raise FitError(f"the shapes hold no {', '.join(lacking)}")
    if (poles.real >= 0).any():
        raise FitError("a mode does not decay")
    if not shapes.any(axis=1).all():
        raise FitError(
            "a mode has a shape of zeros; a mode that loads nothing is none: leave it out, or give its shape"
        )
    columns = (shapes / np.linalg.norm(shapes, axis=1, keepdims=True)).T
    found = from_modes(np.concatenate([poles, poles.conj()]), np.hstack([columns, columns.conj()]))
    if found is None or not all(np.isfinite(part).all() for part in found):
        raise FitError("the shapes of the modes are not independent of each other")
    spring, brake = found
    inertia = np.asarray(np.linalg.inv(spring), dtype=np.float64)
    try:
        dynamics = CoupledDynamics(COMPONENTS, inertia, inertia @ brake)
    except ValueError as problem:
        raise FitError(f"the modes make no dynamics: {problem}") from None
    warn_quality(
        "of poles and shapes no uncertainty is known; A and D count as exact, and so does what follows from them"
    )
    if mass is None:
        return dynamics, None
    rigid, notes = rigid_of(dynamics, mass)
    for note in notes:
        warn_quality(note)
    return dynamics, rigid
