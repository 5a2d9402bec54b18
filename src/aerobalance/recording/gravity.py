"""Gravity along the axes of the balance: at the attitudes of a run, and at those of the zero its loads count from.

Components are in the order NF PM SF YM RM AF. "Gravity" is the force of gravity per mass [m/s^2].
"""

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
    """Direction of gravity along aft, right and up, a unit vector, shape (n, 3) [1], for angles of shape (n,) [rad].

    It is sin(pitch) aft, cos(pitch) sin(roll) to the right, and -cos(pitch) cos(roll) up.
    """
    theta, phi = np.broadcast_arrays(np.asarray(pitch, dtype=np.float64), np.asarray(roll, dtype=np.float64))
    return np.stack([np.sin(theta), np.cos(theta) * np.sin(phi), -np.cos(theta) * np.cos(phi)], axis=-1)


def gravity_share(component: str, *, pitch: Array, roll: Array) -> Array:
    """Share of gravity along the axis that drives a component, of the shape of the angles [1].

    A force is driven along its own axis, a moment of a single component along aft.
    """
    return weight_direction(pitch, roll)[..., AXES.index(driving_axis(component))]


def gravity_components(pitch: ArrayLike, roll: ArrayLike, *, gravity: float) -> Array:
    """Gravity in the order of the components, shape (n, 6) [m/s^2], for angles of shape (n,) [rad]; 0 for moments."""
    shares = np.atleast_2d(weight_direction(pitch, roll))
    pull = np.zeros((shares.shape[0], len(COMPONENTS)))
    pull[:, FORCE_ROWS] = gravity * shares
    return pull


class Gravity(NamedTuple):
    """Gravity in the order of the components, 0 for moments, and its derivatives by the angles.

    Attributes
    ----------
    acceleration
        Gravity, shape (n, 6) [m/s^2].
    slopes
        Its derivatives by ``pitch`` and ``roll``, shape (n, 6) each [m/s^2 per rad].
    """

    acceleration: Array
    slopes: Mapping[str, Array]

    @classmethod
    def of(cls, pitch: Array, roll: Array, *, gravity: float) -> Gravity:
        """Return it for angles of shape (n,) [rad] and the local acceleration of gravity [m/s^2]."""
        pull, by_pitch, by_roll = np.zeros((3, pitch.size, len(COMPONENTS)))
        sine, cosine, across, down = gravity * np.sin(pitch), gravity * np.cos(pitch), np.sin(roll), np.cos(roll)
        parts = (
            (pull, (sine, cosine * across, -cosine * down)),
            (by_pitch, (cosine, -sine * across, sine * down)),
            (by_roll, (np.zeros_like(sine), cosine * down, cosine * across)),
        )
        for whole, columns in parts:
            for row, column in zip(FORCE_ROWS, columns, strict=True):
                whole[:, row] = column
        return cls(pull, {"pitch": by_pitch, "roll": by_roll})


def _no_gravity() -> Array:
    """Zero for each component, shape (6,) [m/s^2]."""
    return np.zeros(len(COMPONENTS))


@dataclass(frozen=True, slots=True, eq=False)
class GravityOnZero:
    """Mean gravity at the attitudes of the zero of the loads, where the weight of the mass was taken out of that zero.

    It is zero where no weight was taken out. An error of the weight at the zero is in the loads too, with the other
    sign; so it cancels an error of the weight in the run as far as run and zero have the same attitude.

    Attributes
    ----------
    acceleration
        Mean gravity, shape (6,) [m/s^2].
    slopes
        Its derivatives by an error of the zero of an angle, ``pitch zero`` and ``roll zero`` [m/s^2 per rad], and by a
        relative error of its gain, ``pitch gain`` and ``roll gain`` [m/s^2], shape (6,) each.
    """

    acceleration: Array = field(default_factory=_no_gravity)
    slopes: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, attitudes: Sequence[Attitudes], *, gravity: float) -> GravityOnZero:
        """Return the mean over the recordings of the zero, of equal weight, NaN left out; gravity in [m/s^2]."""
        accelerations, slopes = [], []
        for pitch, roll in attitudes:
            pull = Gravity.of(pitch, roll, gravity=gravity)
            by_error = {"pitch zero": pull.slopes["pitch"], "pitch gain": pull.slopes["pitch"] * pitch[:, None]}
            by_error |= {"roll zero": pull.slopes["roll"], "roll gain": pull.slopes["roll"] * roll[:, None]}
            accelerations.append(np.nanmean(pull.acceleration, axis=0))
            slopes.append({name: np.nanmean(slope, axis=0) for name, slope in by_error.items()})
        names = slopes[0] if slopes else {}
        return cls(
            np.mean(accelerations, axis=0) if accelerations else _no_gravity(),
            {name: np.mean([slope[name] for slope in slopes], axis=0) for name in names},
        )

    def slope(self, name: str) -> Array:
        """Return the derivative by an error of an angle, a name of `slopes`, shape (6,); zero for another name."""
        return self.slopes.get(name, _no_gravity())
