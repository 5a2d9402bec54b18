"""Dynamics of several components of which each rings for itself, and what stands for dynamics of any kind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS


@dataclass(frozen=True, slots=True)
class IndependentDynamics(Mapping[str, Dynamics]):
    """Dynamics of n components that are not coupled.

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

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of a component's own moving mass along it [N], shape (n,), at attitudes of shape (n,) [rad]."""
        return self.parts[name].weight(name, pitch=pitch, roll=roll, gravity=gravity)

    def inverse_response(self, frequency: Array) -> NDArray[np.complex128]:
        """Force over balance load at frequencies of shape (m,) [Hz], shape (m, n, n): a diagonal."""
        found = np.zeros((frequency.size, len(self), len(self)), dtype=np.complex128)
        for place, part in enumerate(self.parts.values()):
            found[:, place, place] = 1 / part.response(frequency)
        return found


class Identified(Protocol):
    """What an identification gives: a result that holds the dynamics."""

    @property
    def dynamics(self) -> Dynamics | CoupledDynamics:
        """The dynamics that were found."""


AnyDynamics = Dynamics | Mapping[str, Dynamics] | Sequence[Dynamics] | CoupledDynamics | Identified
"""Dynamics as functions take them: of one component, of several each by itself, coupled, or as identified."""


def dynamics_of(given: AnyDynamics) -> IndependentDynamics | CoupledDynamics:
    """Dynamics of n components, one component being n = 1.

    Raises
    ------
    ValueError
        A component is given twice, or under the name of another.
    """
    if isinstance(given, IndependentDynamics | CoupledDynamics):
        return given
    if isinstance(given, Dynamics | Mapping | Sequence):
        return _independent(given)
    found = given.dynamics
    return found if isinstance(found, CoupledDynamics) else _independent(found)


def _independent(given: Dynamics | Mapping[str, Dynamics] | Sequence[Dynamics]) -> IndependentDynamics:
    if isinstance(given, Dynamics):
        parts = [given]
    elif isinstance(given, Mapping):
        wrong = [name for name, part in given.items() if name != part.component]
        if wrong:
            raise ValueError(f"dynamics of {given[wrong[0]].component} are given under the name {wrong[0]}")
        parts = list(given.values())
    else:
        parts = list(given)
    names = [part.component for part in parts]
    twice = [name for name in COMPONENTS if names.count(name) > 1]
    if twice or not names:
        raise ValueError(f"dynamics are given twice of {twice[0]}" if twice else "no dynamics are given")
    return IndependentDynamics({part.component: part for part in parts})
