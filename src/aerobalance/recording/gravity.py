"""Gravity along the components: at the attitudes of a run, and of the zero that its loads count from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, COMPONENTS, FORCE_ROWS, driving_axis


class Attitudes(NamedTuple):
    """Pitch and roll of a recording, shape (n,) each [rad]; NaN where one is missing."""

    pitch: Array
    roll: Array


def weight_direction(pitch: ArrayLike, roll: ArrayLike) -> Array:
    """Share of gravity along aft, right and up, shape (n, 3) [1], for angles of shape (n,) [rad].

    Along the balance it is sin(pitch), to the right cos(pitch) sin(roll), up -cos(pitch) cos(roll).
    """
    theta, phi = np.broadcast_arrays(np.asarray(pitch, dtype=np.float64), np.asarray(roll, dtype=np.float64))
    return np.stack([np.sin(theta), np.cos(theta) * np.sin(phi), -np.cos(theta) * np.cos(phi)], axis=-1)


def gravity_share(component: str, *, pitch: Array, roll: Array) -> Array:
    """Share of gravity along a component, of the shape of the angles [1]; moments are driven along the balance."""
    return weight_direction(pitch, roll)[..., AXES.index(driving_axis(component))]


def gravity_components(pitch: ArrayLike, roll: ArrayLike, *, gravity: float) -> Array:
    """Gravity, per mass, in the order of the components, shape (n, 6) [m/s^2]; 0 for moments."""
    shares = np.atleast_2d(weight_direction(pitch, roll))
    pull = np.zeros((shares.shape[0], len(COMPONENTS)))
    pull[:, FORCE_ROWS] = gravity * shares
    return pull


class Gravity(NamedTuple):
    """Gravity, per mass, in the order of the components; 0 for moments.

    Attributes
    ----------
    acceleration
        Shape (n, 6) [m/s^2].
    slopes
        Its derivatives by ``pitch`` and ``roll``, shape (n, 6) each [m/s^2 per rad].
    """

    acceleration: Array
    slopes: Mapping[str, Array]

    @classmethod
    def of(cls, pitch: Array, roll: Array, *, gravity: float) -> Gravity:
        """Take angles of shape (n,) [rad] and the local acceleration of gravity [m/s^2]."""
        by_pitch, by_roll = np.zeros((2, pitch.size, len(COMPONENTS)))
        sine, cosine, nothing = np.sin(pitch), np.cos(pitch), np.zeros_like(pitch)
        by_pitch[:, FORCE_ROWS] = np.column_stack([cosine, -sine * np.sin(roll), sine * np.cos(roll)])
        by_roll[:, FORCE_ROWS] = np.column_stack([nothing, cosine * np.cos(roll), cosine * np.sin(roll)])
        slopes = {"pitch": gravity * by_pitch, "roll": gravity * by_roll}
        return cls(gravity_components(pitch, roll, gravity=gravity), slopes)


def _nothing() -> Array:
    return np.zeros(len(COMPONENTS))


@dataclass(frozen=True, slots=True, eq=False)
class GravityOnZero:
    """Gravity on the mass whose weight was taken out of the zero of loads; nothing where none was.

    What is wrong with the weight there is wrong in the loads too, with the other sign: it cancels as far as run and
    zero have the same attitude.

    Attributes
    ----------
    acceleration
        Along NF PM SF YM RM AF, shape (6,) [m/s^2].
    slopes
        Its change with ``pitch zero``, ``pitch gain``, ``roll zero`` and ``roll gain``, shape (6,) each.
    """

    acceleration: Array = field(default_factory=_nothing)
    slopes: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, attitudes: Sequence[Attitudes], *, gravity: float) -> GravityOnZero:
        """Take the mean over recordings."""
        accelerations, slopes = [], []
        for pitch, roll in attitudes:
            pull = Gravity.of(pitch, roll, gravity=gravity)
            by = {"pitch zero": pull.slopes["pitch"], "pitch gain": pull.slopes["pitch"] * pitch[:, None]}
            by |= {"roll zero": pull.slopes["roll"], "roll gain": pull.slopes["roll"] * roll[:, None]}
            accelerations.append(np.nanmean(pull.acceleration, axis=0))
            slopes.append({name: np.nanmean(slope, axis=0) for name, slope in by.items()})
        names = slopes[0] if slopes else {}
        return cls(
            np.mean(accelerations, axis=0) if accelerations else _nothing(),
            {name: np.mean([slope[name] for slope in slopes], axis=0) for name in names},
        )

    def slope(self, name: str) -> Array:
        """Change with something of the angles, shape (6,)."""
        return self.slopes.get(name, _nothing())
