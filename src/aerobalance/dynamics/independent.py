"""Dynamics of several components of which each rings for itself, and what stands for dynamics of any kind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from aerobalance.dynamics.balance_dynamics import BalanceDynamics, ForceSlopes
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.modal import Modes
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, COMPONENTS, FORCE_ROWS, MOMENTS, driving_axis

ROUNDING: Final = 1e-9
"""Relative difference that rounding may make of one number on its way through identifications and files."""


@dataclass(frozen=True, slots=True)
class IndependentDynamics(Mapping[str, Dynamics], BalanceDynamics):
    """Dynamics of n components that are not coupled: all matrices are diagonal.

    Their parameters are known each for itself, but for one mass that several forces carry.

    Attributes
    ----------
    parts
        Dynamics by component.
    """

    parts: Mapping[str, Dynamics]

    def __getitem__(self, name: str) -> Dynamics:
        return self.parts[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.parts)

    def __len__(self) -> int:
        return len(self.parts)

    @property
    def components(self) -> tuple[str, ...]:
        """Components whose dynamics are known."""
        return tuple(self.parts)

    @property
    def modes(self) -> Modes:
        """Modes of all components, those of one after the other, its first mode first."""
        parts = [part.modes for part in self.parts.values()]
        return Modes(
            (mode for part in parts for mode in part), lambda: np.vstack([part.uncertainties for part in parts])
        )

    @property
    def leading_frequencies(self) -> tuple[float, ...]:
        """Natural frequency of the first mode of each component [Hz]."""
        return tuple(part.natural_frequency for part in self.parts.values())

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the responses [rad/s]."""
        return np.array([pole for mode in self.modes for pole in mode.poles], dtype=np.complex128)

    @property
    def zeros(self) -> NDArray[np.complex128]:
        """Zeros of the responses, which are the poles of their inverse [rad/s]."""
        found = [np.polynomial.polynomial.polyroots(part.polynomials[0]) for part in self.parts.values()]
        return np.concatenate([np.zeros(0), *found]).astype(np.complex128)

    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Balance loads over forces applied at frequencies of shape (m,) [Hz], shape (m, n, n)."""
        return _diagonal([part.response(frequency) for part in self.parts.values()])

    def inverse_response(self, frequency: Array) -> NDArray[np.complex128]:
        """Forces applied over balance loads at frequencies of shape (m,) [Hz], shape (m, n, n)."""
        return _diagonal([1 / part.response(frequency) for part in self.parts.values()])

    def force_slopes(self, frequency: Array) -> Iterator[ForceSlopes]:
        """What the parameters do to the forces at frequencies of shape (m,) [Hz], one component after the other."""
        for place, part in enumerate(self.parts.values()):
            slopes = np.zeros((frequency.size, len(part.parameters), len(self)), dtype=np.complex128)
            slopes[:, :, place] = part.force_slopes(frequency)
            yield ForceSlopes(slopes, part.covariance)

    @property
    def quadratic(self) -> tuple[Array, Array]:
        """D [s] and A [s^2] of the first modes, shape (n, n) each."""
        damping, inertia = np.array([part.quadratic for part in self.parts.values()]).reshape(-1, 2).T
        return np.diag(damping), np.diag(inertia)

    @property
    def mass(self) -> RigidMass | None:
        """None: of every component the mass along its own axis is known, and no rigid body."""
        return None

    @property
    def _driving(self) -> list[int]:
        """Which of the six accelerations drives each component."""
        return [FORCE_ROWS[AXES.index(driving_axis(name))] for name in self.parts]

    @property
    def mass_rows(self) -> Array:
        """The moving masses along the axes that drive the components, shape (n, 6)."""
        rows = np.zeros((len(self), len(COMPONENTS)))
        rows[np.arange(len(self)), self._driving] = [part.mass for part in self.parts.values()]
        return rows

    @property
    def moved_by(self) -> NDArray[np.bool_]:
        """Accelerations for which the mass is known, shape (6,): those along the driving axes."""
        return np.isin(np.arange(len(COMPONENTS)), self._driving)

    @property
    def delays(self) -> Array:
        """Times by which the loads lag the acceleration of the ground end, shape (n,) [s]."""
        return np.array([part.delay for part in self.parts.values()])

    @property
    def row_covariance(self) -> Array:
        """Covariance of a row of A = M / k, of D = b / k and of the masses, shape (n, 2n + 6, 2n + 6)."""
        n = len(self)
        covariance = np.zeros((n, 2 * n + 6, 2 * n + 6))
        for place, (part, column) in enumerate(zip(self.parts.values(), self._driving, strict=True)):
            M, k, b = part.mass, part.stiffness, part.damping
            slopes = np.zeros((2 * n + 6, 3))  # by mass, stiffness and damping
            slopes[place, :2] = 1 / k, -M / k**2
            slopes[n + place, 1:] = -b / k**2, 1 / k
            slopes[2 * n + column, 0] = 1.0
            covariance[place] = slopes @ part.covariance[:3, :3] @ slopes.T
        return covariance

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of a component's own moving mass along it [N], shape (n,), at attitudes of shape (n,) [rad]."""
        return self.parts[name].weight(name, pitch=pitch, roll=roll, gravity=gravity)

    def have_one_mass(self, one: str, other: str) -> bool:
        """Whether two forces state the same mass with the same uncertainty: one mass, whose error they share."""
        if {one, other} & set(MOMENTS):  # whose mass has a lever
            return False
        first, second = self.parts[one], self.parts[other]
        pairs = ((first.mass, second.mass), (first.uncertainty("mass"), second.uncertainty("mass")))
        return all(abs(own - theirs) <= ROUNDING * own for own, theirs in pairs)

    def decoupled(self, component: str, *, noise: Array) -> DecoupledChannel:
        """The component's own reading, which no other has a part in."""
        return DecoupledChannel.apart(self.parts[component], self.components.index(component), count=len(self))

    def own_response(self, component: str) -> Dynamics:
        """The dynamics of one component."""
        return self.parts[component]

    @property
    def blocks(self) -> tuple[BalanceDynamics, ...]:
        """Every component alone."""
        return tuple(IndependentDynamics({name: part}) for name, part in self.parts.items())

    @property
    def parameter_values(self) -> Array:
        """Values of the parameters of all components, shape (p,)."""
        return np.concatenate([np.zeros(0), *(part.values for part in self.parts.values())])

    @property
    def covariance(self) -> Array:
        """Covariance of these, shape (p, p)."""
        return np.asarray(block_diag(np.zeros((0, 0)), *(part.covariance for part in self.parts.values())))

    def with_parameters(self, values: Array, mass: RigidMass | None = None) -> IndependentDynamics:
        """The same with other values of the parameters, shape (p,), known exactly."""
        ends = np.cumsum([len(part.parameters) for part in self.parts.values()])
        own = np.split(values, ends)[:-1]
        parts = zip(self.parts.items(), own, strict=True)
        return IndependentDynamics({name: part.with_parameters(some) for (name, part), some in parts})

    @property
    def exact(self) -> IndependentDynamics:
        """The same, taken as known exactly."""
        return IndependentDynamics({name: part.exact for name, part in self.parts.items()})


NO_DYNAMICS: Final = IndependentDynamics({})
"""Where no component's dynamics are known."""


def _diagonal(entries: Sequence[NDArray[np.complex128]]) -> NDArray[np.complex128]:
    """Matrices of these diagonals: n entries of shape (m,), shape (m, n, n)."""
    rows = np.stack(entries, axis=-1)
    return np.asarray(rows[..., None] * np.eye(len(entries)), dtype=np.complex128)


class Identified(Protocol):
    """What an identification gives: a result that holds the dynamics."""

    @property
    def dynamics(self) -> Dynamics | BalanceDynamics:
        """The dynamics that were found."""


AnyDynamics = Dynamics | Mapping[str, Dynamics] | Sequence[Dynamics] | BalanceDynamics | Identified
"""Dynamics as functions take them: of one component, of several each by itself, coupled, or as identified."""


def dynamics_of(given: AnyDynamics) -> BalanceDynamics:
    """Dynamics of n components, one component being n = 1.

    Raises
    ------
    ValueError
        A component is given twice, or under the name of another.
    """
    if isinstance(given, BalanceDynamics):
        return given
    if isinstance(given, Dynamics | Mapping | Sequence):
        return _independent(given)
    return dynamics_of(given.dynamics)


def _independent(given: Dynamics | Mapping[str, Dynamics] | Sequence[Dynamics]) -> IndependentDynamics:
    """Dynamics of components that are not coupled, one component being n = 1.

    Raises
    ------
    ValueError
        A component is given twice, or under the name of another, or there is none.
    """
    parts = [given] if isinstance(given, Dynamics) else [*(given.values() if isinstance(given, Mapping) else given)]
    other = [type(part).__name__ for part in parts if not isinstance(part, Dynamics)]
    if other or not parts:
        raise ValueError(
            "dynamics must be Dynamics, several of them as a mapping or a sequence, or CoupledDynamics, not "
            + (f"{other[0]} among them" if other else "empty")
        )
    names = [part.component for part in parts]
    wrong = (
        [pair for pair in zip(given, names, strict=True) if pair[0] != pair[1]] if isinstance(given, Mapping) else []
    )
    if wrong:
        raise ValueError(f"dynamics of {wrong[0][1]} are given under the name {wrong[0][0]}")
    twice = [name for name in COMPONENTS if names.count(name) > 1]
    if twice:
        raise ValueError(f"dynamics are given twice of {twice[0]}")
    return IndependentDynamics({part.component: part for part in parts})
