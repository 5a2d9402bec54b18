"""Point and direction of a hammer tap, and the balance loads of a force of 1 N there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.identification.impact.tap_model import Point
from aerobalance.recording.channel import IMPACT_FORCE, Array
from aerobalance.recording.components import COMPONENTS, FROM_VECTORS
from aerobalance.recording.recording import Recording

U_PLACE: Final = 0.001
"""Default standard uncertainty of each coordinate of a point [m]."""

U_DIRECTION: Final = float(np.deg2rad(1.0))
"""Default standard uncertainty of a direction about each of two axes perpendicular to it [rad]."""

U_GAIN: Final = 0.01
"""Default relative standard uncertainty of the gain of a measured force, where its channel states none [1]."""


@dataclass(frozen=True, slots=True)
class TapPoint:
    """Point and direction of the taps on the model.

    Attributes
    ----------
    place
        Coordinates aft, right and up from the balance's centre [m].
    direction
        Unit vector of the force on the model: its components aft, right and up [1].
    u_place
        Standard uncertainty of each coordinate of `place` [m].
    u_direction
        Standard uncertainty of the direction about each of two axes perpendicular to it [rad].
    """

    place: tuple[float, float, float]
    direction: tuple[float, float, float]
    u_place: float = U_PLACE
    u_direction: float = U_DIRECTION

    def __post_init__(self) -> None:
        for name in ("place", "direction"):
            given = getattr(self, name)
            if len(given) != 3 or not np.isfinite(given).all():
                raise ValueError(f"{name} must be three finite numbers, aft, right, up, not {given}")
        if abs(float(np.linalg.norm(self.direction)) - 1) > 1e-3:
            raise ValueError(f"direction must be a vector aft, right, up of length 1, not {self.direction}")
        if not (0 <= self.u_place < 1 and 0 <= self.u_direction < 1):
            raise ValueError("u_place [m] and u_direction [rad] must be zero or more and below 1")

    @property
    def loads(self) -> Array:
        """Balance loads of 1 N about the balance's centre, in the order of `COMPONENTS`, shape (6,) [N, N*m]."""
        return wrench(np.array(self.place), np.array(self.direction))

    @property
    def root(self) -> Array:
        """Square root R of the covariance R R^T of `loads`, shape (6, 12) [N, N*m].

        It has the terms of first order, and those of second order of point times direction and direction squared.
        """
        place, direction = np.array(self.place), np.array(self.direction)
        across = np.linalg.svd(direction[None])[2][1:]
        moved = [FROM_VECTORS @ np.concatenate([np.zeros(3), np.cross(unit, direction)]) for unit in np.eye(3)]
        turned = [wrench(place, unit) for unit in across]
        both = [
            FROM_VECTORS @ np.concatenate([np.zeros(3), np.cross(unit, turn)]) for unit in np.eye(3) for turn in across
        ]
        return np.column_stack(
            [
                self.u_place * np.array(moved).T,
                self.u_direction * np.array(turned).T,
                self.u_place * self.u_direction * np.array(both).T,
                1.5
                * self.u_direction**2
                * self.loads,  # 1 - cos of both angles: mean u^2, deviation u^2, rms 1.41 u^2
            ]
        )

    def __str__(self) -> str:
        place = ", ".join(f"{1000 * value:.4g}" for value in self.place)
        direction = ", ".join(f"{value:.3g}" for value in self.direction)
        return f"({place}) mm along ({direction})"


def wrench(place: Array, force: Array) -> Array:
    """Return the balance loads of a force [N] at a place [m], in the order of `COMPONENTS`, shape (6,) [N, N*m]."""
    return np.asarray(FROM_VECTORS @ np.concatenate([force, np.cross(place, force)]))


def point_of(recording: Recording, given: TapPoint | None) -> TapPoint | None:
    """Return point and direction of a recording's taps: as given, or of its channel of the force; None else."""
    if given is not None or IMPACT_FORCE not in recording:
        return given
    channel = recording.channel(IMPACT_FORCE)
    if channel.axis is None or channel.place is None:
        return None
    return TapPoint(channel.place, channel.axis, u_place=channel.place_uncertainty or U_PLACE)


def fit_point(point: TapPoint | None, components: Sequence[str], sizes: Array) -> Point:
    """Return the loads of 1 N on some components over their sizes, with a root of their covariance.

    Without a point, the force acts along the one component.
    """
    if point is None:
        return Point(f"along {components[0]}", 1 / sizes, np.zeros((1, 0)))
    rows = [COMPONENTS.index(name) for name in components]
    root = point.root[rows] / sizes[:, None]
    left, size, _ = np.linalg.svd(root, full_matrices=False)
    kept = size > 1e-9 * max(float(size.max()), 1e-300)
    return Point(str(point), point.loads[rows] / sizes, left[:, kept] * size[kept])
