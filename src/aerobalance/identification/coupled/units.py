"""Units of a fit of coupled components, and A and D in SI units with their covariance from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.identification.coupled.internal_coordinates import coordinates_of
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """Units of the fit: loads over `sizes` [N, N*m], shape (n,), and times `rate` [1/s]."""

    sizes: Array
    rate: float

    def matrices(self, spring: Array, brake: Array) -> Array:
        """A^-1 [1/s^2] and A^-1 D [1/s] in these units, row by row."""
        ratio = 1 / self.ratio(len(spring))
        return np.concatenate([(spring * ratio / self.rate**2).ravel(), (brake * ratio / self.rate).ravel()])

    def bare(self, spring: Array, brake: Array) -> tuple[Array, Array]:
        """A^-1 [1/s^2] and A^-1 D [1/s] from these units."""
        ratio = self.ratio(len(spring))
        return spring * ratio * self.rate**2, brake * ratio * self.rate

    def ratio(self, size: int) -> Array:
        """Unit of row over that of column in N coordinates, shape (N, N)."""
        sizes = with_hidden(self.sizes, size)
        return sizes[:, None] / sizes[None, :]


def with_hidden(sizes: Array, size: int) -> Array:
    """Sizes of the loads, and the largest of them for each internal coordinate, shape (N,)."""
    return np.concatenate([sizes, np.full(size - sizes.size, sizes.max())])


def physical_covariance(information: Array, matrices: Array, units: Units) -> Array:
    """Covariance of A and D [SI], row by row, from information on A^-1 and A^-1 D."""
    slopes = physical_slopes(matrices, units)
    size = np.linalg.norm(information, axis=0)
    root = np.linalg.solve((information / size).T, (slopes / size).T)  # triangular: covariance is root' root
    return root.T @ root


def physical_slopes(matrices: Array, units: Units) -> Array:
    """Derivatives of A and D [SI], row by row, by A^-1 and A^-1 D in the units of the fit, shape (2 N^2, 2 N^2)."""
    n = coordinates_of(matrices)
    spring, brake = matrices.reshape(2, n, n)
    A = np.linalg.inv(spring)
    D = A @ brake
    slopes = np.zeros((2 * n * n, 2 * n * n))
    slopes[: n * n, : n * n] = -np.kron(A, A.T)
    slopes[n * n :, : n * n] = -np.kron(A, D.T)
    slopes[n * n :, n * n :] = np.kron(A, np.eye(n))
    ratio = units.ratio(n).ravel()
    return np.asarray(slopes * np.concatenate([ratio / units.rate**2, ratio / units.rate])[:, None])


def dynamics_of(matrices: Array, information: Array, units: Units, names: tuple[str, ...]) -> CoupledDynamics:
    """Return A and D with their covariance, of A^-1 and A^-1 D in the units of the fit and the information on them."""
    size = coordinates_of(matrices)
    spring, brake = matrices.reshape(2, size, size)
    A = np.linalg.inv(spring)
    ratio = units.ratio(size)
    covariance = physical_covariance(information, matrices, units)
    return CoupledDynamics(names, A * ratio / units.rate**2, A @ brake * ratio / units.rate, covariance)
