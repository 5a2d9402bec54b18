"""The dynamics of a balance of n components: one linear model from applied forces to balance loads, n x n.

Coupled components are described by matrices (`aerobalance.dynamics.coupled`). Components that are not coupled, each
with its own mass, stiffness and damping, are the case of diagonal matrices (`aerobalance.dynamics.independent`), and
one component is that case with n = 1. The estimators use this interface only and need not know which case it is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.modal import ModalModel, Modes
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array


class ForceSlopes(NamedTuple):
    """Sensitivity of the force of one component to the parameters of the dynamics, and their covariance.

    Attributes
    ----------
    slopes
        Derivative of the force by each of p parameters, per unit of each of n applied forces, at m frequencies,
        shape (m, p, n).
    covariance
        Covariance of these parameters, shape (p, p).
    """

    slopes: NDArray[np.complex128]
    covariance: Array


class BalanceDynamics(ABC):
    """Linear dynamics of a balance of n components.

    Rows and columns of all matrices are in the order of the components.
    """

    __slots__ = ()

    @property
    @abstractmethod
    def components(self) -> tuple[str, ...]:
        """Names of the n components."""

    @property
    @abstractmethod
    def modes(self) -> Modes:
        """All modes of free motion."""

    @property
    def leading_frequencies(self) -> tuple[float, ...]:
        """Natural frequencies of the modes [Hz], only the first one of each component where they are not coupled."""
        return tuple(mode.natural_frequency for mode in self.modes)

    @property
    @abstractmethod
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the response [rad/s]."""

    @property
    @abstractmethod
    def zeros(self) -> NDArray[np.complex128]:
        """Transmission zeros of the response, which are the poles of the inverse response [rad/s]."""

    @abstractmethod
    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Frequency response, balance loads over applied forces, shape (m, n, n), at m frequencies [Hz]."""

    @abstractmethod
    def inverse_response(self, frequency: Array) -> NDArray[np.complex128]:
        """Inverse response, applied forces over balance loads, shape (m, n, n), at m frequencies [Hz]."""

    @abstractmethod
    def force_slopes(self, frequency: Array) -> Iterator[ForceSlopes]:
        """Sensitivity of each component's force to the parameters, at m frequencies [Hz], in the components' order."""

    @property
    @abstractmethod
    def quadratic(self) -> tuple[Array, Array]:
        """Matrices D [s] and A [s^2] of F = X + D X' + A X'', shape (n, n) each, without terms of further modes."""

    # ---- the mass that gravity and the motion of the ground end act on

    @property
    @abstractmethod
    def mass(self) -> RigidMass | None:
        """The moving mass as a rigid body; None where it is not known as one."""

    @property
    @abstractmethod
    def mass_rows(self) -> Array:
        """Balance loads per unit of each acceleration of the ground end, shape (n, 6); zero for one without a mass."""

    @property
    @abstractmethod
    def moved_by(self) -> NDArray[np.bool_]:
        """Accelerations of the ground end for which the mass is known, shape (6,)."""

    @property
    @abstractmethod
    def delays(self) -> Array:
        """Times by which the loads lag the acceleration of the ground end, shape (n,) [s]."""

    @property
    @abstractmethod
    def row_covariance(self) -> Array:
        """Covariance of the concatenated rows of A, D and `mass_rows`, by component, shape (n, 2n + 6, 2n + 6)."""

    @abstractmethod
    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight along a component [N, N*m] at attitudes [rad], shape (m,) each; zero where no mass is known."""

    # ---- one component after the other

    @abstractmethod
    def decoupled(self, component: str, *, noise: Array) -> DecoupledChannel:
        """Return how one component is decoupled from the others.

        Parameters
        ----------
        component
            Name of the component.
        noise
            Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]; the ratios are what matters.

        Raises
        ------
        ValueError
            A transmission zero is not stable: an internal coordinate would move for ever, and no bridge would show it.
        """

    @abstractmethod
    def own_response(self, component: str) -> ModalModel:
        """Response of one component's reading to its own force alone: all modes with their modal contributions.

        Raises
        ------
        FitError
            A mode does not oscillate.
        """

    @property
    def blocks(self) -> tuple[BalanceDynamics, ...]:
        """Groups of components that are not coupled with each other."""
        return (self,)

    def block_of(self, component: str) -> BalanceDynamics:
        """Return the group of coupled components that a component belongs to."""
        return next(block for block in self.blocks if component in block.components)

    def estimable(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the components whose force can be estimated: all components of their group are among `names`."""
        return tuple(name for block in self.blocks if set(block.components) <= set(names) for name in block.components)

    # ---- what is not known exactly

    @property
    @abstractmethod
    def parameter_values(self) -> Array:
        """Values of the parameters without those of `mass`, shape (p,)."""

    @property
    @abstractmethod
    def covariance(self) -> Array:
        """Covariance of the parameters, shape (p, p)."""

    @abstractmethod
    def with_parameters(self, values: Array, mass: RigidMass | None = None) -> Self:
        """Return the dynamics with other parameter values, shape (p,), taken as exact, and with this mass.

        Raises
        ------
        ValueError
            A value is not physical.
        """

    @property
    @abstractmethod
    def exact(self) -> Self:
        """The dynamics with parameters that are taken as exact: their covariance is zero."""

    @property
    def calibration(self) -> str | None:
        """SHA-256 of the balance matrix whose calibration errors act on the parameters and are not in `covariance`.

        It is empty where that matrix is not known, and None where the parameters have no such errors.
        """
        return None

    @property
    def with_calibration(self) -> BalanceDynamics:
        """The dynamics with errors of the calibration in `covariance`, for use without that balance matrix."""
        return self
