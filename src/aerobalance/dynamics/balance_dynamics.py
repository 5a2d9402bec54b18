"""The dynamics of a balance of n components: one linear model from forces applied to loads felt, n x n.

Coupled components have it by matrices (`aerobalance.dynamics.coupled`); components that are not coupled, each by its
own mass, stiffness and damping, are the case whose rows are apart already (`aerobalance.dynamics.independent`), and
one component is n = 1 of it. What works with forces takes this model and does not ask which.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array


class ForceSlopes(NamedTuple):
    """What the parameters of the dynamics do to the force of one component.

    Attributes
    ----------
    slopes
        Change of the force with each of p parameters, over each of n forces applied, at m frequencies, (m, p, n).
    covariance
        Covariance of these parameters, shape (p, p).
    """

    slopes: NDArray[np.complex128]
    covariance: Array


class BalanceDynamics(ABC):
    """Dynamics of n components.

    Rows and columns of all matrices are in the order of the components; s is i times the angular frequency.
    """

    __slots__ = ()

    @property
    @abstractmethod
    def components(self) -> tuple[str, ...]:
        """Names of the n components."""

    @property
    @abstractmethod
    def modes(self) -> tuple[Mode, ...]:
        """All modes of free motion."""

    @property
    def leading_frequencies(self) -> tuple[float, ...]:
        """Natural frequencies of the modes without the further ones of a component that is not coupled [Hz]."""
        return tuple(mode.natural_frequency for mode in self.modes)

    @property
    @abstractmethod
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the response [rad/s]."""

    @property
    @abstractmethod
    def zeros(self) -> NDArray[np.complex128]:
        """Motions in which no component shows anything: poles of the inverse response [rad/s]."""

    @abstractmethod
    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Loads felt over forces applied at frequencies of shape (m,) [Hz], shape (m, n, n)."""

    @abstractmethod
    def inverse_response(self, frequency: Array) -> NDArray[np.complex128]:
        """Forces applied over loads felt at frequencies of shape (m,) [Hz], shape (m, n, n)."""

    @abstractmethod
    def force_slopes(self, frequency: Array) -> Iterator[ForceSlopes]:
        """What the parameters do to the forces at frequencies of shape (m,) [Hz], one component after the other."""

    @property
    @abstractmethod
    def quadratic(self) -> tuple[Array, Array]:
        """D [s] and A [s^2] of F = X + D X' + A X'', shape (n, n) each; without what further modes add to it."""

    # ---- the mass that gravity and the motion of the ground end act on

    @property
    @abstractmethod
    def mass(self) -> RigidMass | None:
        """The moving mass as a rigid body; None where it is not known as one."""

    @property
    @abstractmethod
    def mass_rows(self) -> Array:
        """Loads by a unit of each acceleration of the ground end, shape (n, 6); zero for one that is not known."""

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
        """Covariance of a row of A, of D and of `mass_rows`, one behind the other, shape (n, 2n + 6, 2n + 6)."""

    @abstractmethod
    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight along a component [N, N*m], shape (n,), at attitudes of shape (n,) [rad]; zero without a mass."""

    # ---- one component after the other

    @abstractmethod
    def decoupled(self, component: str, *, noise: Array) -> DecoupledChannel:
        """Return how one component is decoupled from the others.

        Parameters
        ----------
        component
            Which of them.
        noise
            Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]; the ratios are what matters.

        Raises
        ------
        ValueError
            An internal coordinate moves without end while no component shows anything.
        """

    @abstractmethod
    def own_response(self, component: str) -> ModalModel:
        """One component's reading under its own force alone: every mode with its share of a steady load.

        Raises
        ------
        FitError
            A mode does not oscillate.
        """

    @property
    def blocks(self) -> tuple[BalanceDynamics, ...]:
        """Parts that have nothing to do with each other."""
        return (self,)

    def block_of(self, component: str) -> BalanceDynamics:
        """Return the part that a component belongs to."""
        return next(block for block in self.blocks if component in block.components)

    def estimable(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the components whose force can be worked out from channels of these names."""
        return tuple(name for block in self.blocks if set(block.components) <= set(names) for name in block.components)

    # ---- what is not known exactly

    @property
    @abstractmethod
    def parameter_values(self) -> Array:
        """Values of the parameters but for those of `mass`, shape (p,)."""

    @property
    @abstractmethod
    def covariance(self) -> Array:
        """Covariance of the parameters, shape (p, p)."""

    @abstractmethod
    def with_parameters(self, values: Array, mass: RigidMass | None = None) -> Self:
        """Return the same with other values of the parameters, shape (p,), known exactly, and with this mass.

        Raises
        ------
        ValueError
            A value is not physical.
        """

    @property
    @abstractmethod
    def exact(self) -> Self:
        """The same, taken as known exactly."""

    @property
    def calibration(self) -> str | None:
        """SHA-256 of the balance matrix whose calibration left in the parameters what is not in `covariance`.

        It is empty where that is not known, and None where there is nothing of that kind.
        """
        return None

    @property
    def with_calibration(self) -> BalanceDynamics:
        """The same with all that is not known in `covariance`: what does not know that calibration needs it."""
        return self
