"""Weight model: six loads [N, N*m] from mass, centre of gravity, offsets and misalignment.

Axes are aft, right, up, a right-handed triple. The weight W acts at r = (a, y, u) from the centre of the balance, so
its moment is r x W, of which the part about right turns the nose up, the part about up turns it left and the part
about aft turns the right side up:

    PM = u W_aft - a W_up,    YM = y W_aft - a W_right,    RM = u W_right - y W_up.

With the static moments M a, M y, M u in place of r, all six loads are linear in everything but the misalignment.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.components import (
    ANGLES,
    AXES,
    AXIS_VECTORS,
    COMPONENTS,
    FORCE_AXES,
    MOMENTS,
    STANDARD_GRAVITY,
    VECTORS,
)
from aerobalance.recording.frames import rotation


def _levers(moment: str) -> dict[str, tuple[float, str]]:
    found = {}
    for lever, pull in itertools.product(reversed(AXES), AXES):
        sign = float(np.dot(VECTORS[moment], np.cross(AXIS_VECTORS[lever], AXIS_VECTORS[pull])))
        if sign:
            found[lever] = sign, pull
    return found


LEVERS: Final = {moment: _levers(moment) for moment in MOMENTS}
"""Moment by coordinate of the centre of gravity: sign, and the share of the weight that pulls on this lever."""


@dataclass(frozen=True, slots=True)
class WeightModel:
    """Weight (tare) model: loads [N, N*m] as a function of attitude and parameters.

    Attributes
    ----------
    components
        Components that are read.
    own_masses
        Whether every force has a mass of its own (``mass.AF``) rather than one for all (``mass``).
    own_centres
        Whether every moment has a centre of gravity of its own (``moment.PM.aft``) rather than one for all
        (``moment.aft``).
    gravity
        Acceleration of gravity [m/s^2].
    """

    components: tuple[str, ...]
    own_masses: bool = False
    own_centres: bool = False
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        unknown = [name for name in self.components if name not in COMPONENTS]
        if unknown or len(set(self.components)) < len(self.components):
            raise ValueError(
                f"components must be some of {', '.join(COMPONENTS)}, each once, not {', '.join(self.components)}"
            )
        if not 0 < self.gravity < np.inf:
            raise ValueError(f"gravity must be positive and finite, not {self.gravity}")

    def weight_terms(self, component: str) -> dict[str, tuple[float, int]]:
        """Parameters that carry the weight into a component: sign, and index of the share of gravity."""
        if component not in MOMENTS:
            name = f"mass.{component}" if self.own_masses else "mass"
            return {name: (1.0, AXES.index(FORCE_AXES[component]))}
        stem = f"moment.{component}" if self.own_centres else "moment"
        return {f"{stem}.{lever}": (sign, AXES.index(pull)) for lever, (sign, pull) in LEVERS[component].items()}

    def mass_of(self, component: str) -> str:
        """Name of the mass that a component is read with; of a moment that of the first force."""
        own = f"mass.{component}"
        return own if own in self.names else next(name for name in self.names if name.startswith("mass"))

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters: masses [kg], static moments [kg*m], offsets [N, N*m], misalignment [rad]."""
        return _names(self)

    def loads(self, directions: Array, values: Array) -> Array:
        """Loads, shape (n, c) [N, N*m], from `weight_direction` and all parameters, shape (p,)."""
        turn, _ = rotation(*values[-3:])
        weights, offsets = _structure(self)
        result: Array = directions @ (turn.T @ (weights @ values)) + offsets @ values
        return result

    def jacobian(self, directions: Array, values: Array) -> Array:
        """Derivatives of the loads by all parameters, shape (n, c, p)."""
        turn, derivatives = rotation(*values[-3:])
        weights, offsets = _structure(self)
        result: Array = np.einsum("nk,kcp->ncp", directions @ turn.T, weights) + offsets
        for index, derivative in enumerate(derivatives):
            result[:, :, index - 3] = directions @ (derivative.T @ (weights @ values))
        return result


@cache
def _names(model: WeightModel) -> tuple[str, ...]:
    """Names of all parameters, which a fit asks for a hundred times."""
    weights = dict.fromkeys(name for component in model.components for name in model.weight_terms(component))
    ordered = sorted(weights, key=lambda name: not name.startswith("mass"))
    offsets = [f"offset.{component}" for component in model.components]
    return (*ordered, *offsets, *(f"misalignment.{angle}" for angle in ANGLES))


@cache
def _structure(model: WeightModel) -> tuple[Array, Array]:
    """How gravity's shares, shape (3, c, p), and the offsets, shape (c, p), enter the components."""
    names = model.names
    weights = np.zeros((3, len(model.components), len(names)))
    offsets = np.zeros((len(model.components), len(names)))
    for row, component in enumerate(model.components):
        for name, (sign, share) in model.weight_terms(component).items():
            weights[share, row, names.index(name)] = sign * model.gravity
        offsets[row, names.index(f"offset.{component}")] = 1.0
    return weights, offsets
