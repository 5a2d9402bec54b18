"""Loads from one point and set of axes to another: balance, body, wind; and coefficients.

Loads are in the order and signs of the components. Axes are aft, right, up, a right-handed triple. Moved to a point at
p and turned by R, force and moment become R F and R (M - p x F), so that the work done in any rigid motion is the same
in both. Every step carries the full covariance of the six loads of each sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.recording.channel import Array
from aerobalance.recording.components import ANGLES, AXES, COMPONENTS, FROM_VECTORS, VECTORS
from aerobalance.recording.errors import warn_quality

WIND_NAMES: Final[Mapping[str, str]] = {"NF": "L", "SF": "Y", "AF": "D", "PM": "PM", "YM": "YM", "RM": "RM"}
"""Names of the components in wind axes: lift, side force, drag, and the moments about the wind's axes."""

PLACEMENT: Final = (*AXES, *ANGLES)
"""Order of the rows of a frame's covariance."""


@dataclass(frozen=True, slots=True, eq=False)
class ResolvedLoads:
    """Six loads, or their coefficients, of every sample, with covariance.

    Attributes
    ----------
    values
        Shape (n, 6) [N, N*m; 1 for coefficients].
    covariance
        Shape (n, 6, 6).
    """

    values: Array
    covariance: Array

    def __post_init__(self) -> None:
        samples = self.values.shape[0] if self.values.ndim == 2 else -1
        if self.values.shape != (samples, 6) or self.covariance.shape != (samples, 6, 6):
            raise ValueError(
                f"loads must have shape (n, 6) and their covariance (n, 6, 6), not {self.values.shape} and "
                f"{self.covariance.shape}"
            )

    @classmethod
    def of(
        cls, values: ArrayLike, *, uncertainty: ArrayLike = 0.0, correlation: ArrayLike | None = None
    ) -> ResolvedLoads:
        """Return loads from the standard uncertainty of each and the correlation between them.

        Parameters
        ----------
        values
            Shape (n, 6) [N, N*m].
        uncertainty
            Of one shape with them, or one for all samples, shape (6,).
        correlation
            Shape (6, 6); none between the components if left out.

        Raises
        ------
        ValueError
            A shape is wrong, an uncertainty negative, or the correlation impossible.
        """
        loads = np.asarray(values, dtype=np.float64)
        if loads.ndim != 2 or loads.shape[1] != 6:
            raise ValueError(f"loads must have shape (n, 6), in the order {', '.join(COMPONENTS)}, not {loads.shape}")
        sizes = np.broadcast_to(np.asarray(uncertainty, dtype=np.float64), loads.shape)
        if (sizes < 0).any():
            raise ValueError("uncertainty must be zero or more")
        alike = np.eye(6) if correlation is None else np.asarray(correlation, dtype=np.float64)
        if alike.shape != (6, 6) or not np.allclose(alike, alike.T) or not np.allclose(np.diag(alike), 1):
            raise ValueError("correlation must be symmetric, of shape (6, 6), with ones on its diagonal")
        if np.linalg.eigvalsh(alike)[0] < -1e-9:
            raise ValueError("correlation is impossible: some sum of the loads would have a negative variance")
        return cls(loads, sizes[:, :, None] * alike * sizes[:, None, :])

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty of every value, shape (n, 6)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    def transformed(
        self,
        matrix: Array,
        *,
        slopes: Array | None = None,
        parameter_covariance: Array | None = None,
        cross_covariance: Array | None = None,
    ) -> ResolvedLoads:
        """Return the loads times a matrix, with the uncertainty of the k quantities that the matrix depends on.

        Parameters
        ----------
        matrix
            Shape (6, 6), or (n, 6, 6).
        slopes
            Derivative of the result by these quantities, shape (n, 6, k).
        parameter_covariance
            Their covariance, shape (k, k) or (n, k, k).
        cross_covariance
            Covariance of the loads and these quantities, shape (6, k) or (n, 6, k); none where left out.
        """
        values = np.einsum("...ij,...j->...i", matrix, self.values)
        covariance = matrix @ self.covariance @ np.swapaxes(matrix, -1, -2)
        if slopes is not None and parameter_covariance is not None:
            covariance = covariance + slopes @ parameter_covariance @ np.swapaxes(slopes, -1, -2)
        if slopes is not None and cross_covariance is not None:
            both = matrix @ cross_covariance @ np.swapaxes(slopes, -1, -2)
            covariance = covariance + both + np.swapaxes(both, -1, -2)
        return ResolvedLoads(values, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A reference point and axes, given in those of another frame: a body in its balance, a moment centre in a body.

    It is rotated against the other frame nose right by yaw, then nose up by pitch, then right side down by roll.

    Attributes
    ----------
    point
        Its reference point, aft, right and up of the other's along the other's axes, shape (3,) [m].
    pitch, roll, yaw
        Its angles [rad].
    covariance
        Covariance of point and angles in the order of `PLACEMENT` [m, rad], shape (6, 6); all zero where not given.
    """

    point: Array = field(default_factory=lambda: np.zeros(3))
    pitch: float = 0.0
    roll: float = 0.0
    yaw: float = 0.0
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", np.array(self.point, dtype=np.float64))
        if self.point.shape != (3,) or not np.isfinite(self.point).all():
            raise ValueError("point must be three numbers [m]: aft, right, up")
        if not np.isfinite([self.pitch, self.roll, self.yaw]).all():
            raise ValueError("pitch, roll and yaw must be finite [rad]")
        if self.covariance.shape != (6, 6) or not np.isfinite(self.covariance).all():
            raise ValueError(f"covariance must have shape (6, 6), for {', '.join(PLACEMENT)}, and be finite")
        if (np.diag(self.covariance) < 0).any():
            raise ValueError("covariance must have variances of zero or more")

    @classmethod
    def of_rotation(cls, rotation: Array, *, point: ArrayLike = (0.0, 0.0, 0.0)) -> Frame:
        """Return the frame of a rotation matrix, which takes vectors from the other frame's axes into its own.

        Parameters
        ----------
        rotation
            Shape (3, 3): rows are the frame's aft, right and up in the other's axes.
        point
            Its reference point, shape (3,) [m].
        """
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9):
            raise ValueError("rotation must have shape (3, 3), its rows of length 1 and at right angles")
        if np.linalg.det(rotation) < 0:
            raise ValueError("rotation makes a left-handed triple of a right-handed one: an axis has a wrong sign")
        pitch = float(np.arcsin(np.clip(-rotation[0, 2], -1, 1)))
        yaw = float(np.arctan2(-rotation[0, 1], rotation[0, 0]))
        roll = float(np.arctan2(-rotation[1, 2], rotation[2, 2]))
        return cls(np.asarray(point, dtype=np.float64), pitch, roll, yaw)

    @property
    def rotation(self) -> Array:
        """Matrix from the other frame's axes to its own, shape (3, 3)."""
        return rotation(self.pitch, self.roll, self.yaw)[0]

    @property
    def matrix(self) -> Array:
        """Matrix from loads in the other frame to loads in this one, shape (6, 6)."""
        return _load_matrix(self.rotation, self.point)

    @property
    def motion_matrix(self) -> Array:
        """Matrix from motions (small, or rates) of the other frame's point to those of its own, shape (6, 6).

        It is the inverse of `matrix`, transposed: the work of any loads in any motion is the same in both frames.
        """
        return np.asarray(np.linalg.inv(self.matrix).T)

    def loads(self, given: ResolvedLoads) -> ResolvedLoads:
        """Return loads in this frame [N, N*m].

        Parameters
        ----------
        given
            Loads in the other frame.
        """
        if not self.covariance.any():
            return given.transformed(self.matrix)
        return given.transformed(self.matrix, slopes=self._slopes(given.values), parameter_covariance=self.covariance)

    def _slopes(self, values: Array) -> Array:
        """Return the derivative of the loads by point and angles, shape (n, 6, 6)."""
        turned, by_angles = rotation(self.pitch, self.roll, self.yaw)
        slopes = []
        for axis in range(3):
            moved = FROM_VECTORS[:, 3:] @ turned @ _cross(np.eye(3)[axis]) @ FROM_VECTORS[:, :3].T
            slopes.append(values @ -moved.T)
        slopes += [values @ _load_matrix(by_angle, self.point).T for by_angle in by_angles]
        return np.stack(slopes, axis=2)


def angles_of_attitude(pitch: float, roll: float, body: Frame | None = None) -> tuple[float, float]:
    """Return angle of attack and sideslip of a body whose balance is pitched up, then rolled, in a level wind [rad].

    Parameters
    ----------
    pitch, roll
        Attitude of the balance, whose nose points into the wind but for these [rad].
    body
        The body in the balance; None for one with the axes of the balance.
    """
    turned = rotation(pitch, roll, 0.0)[0]
    aft, right, up = (turned if body is None else body.rotation @ turned) @ np.array([1.0, 0.0, 0.0])
    return float(np.arctan2(up, aft)), float(-np.arcsin(np.clip(right, -1.0, 1.0)))


def wind_loads(
    body: ResolvedLoads,
    *,
    angle_of_attack: ArrayLike,
    sideslip: ArrayLike = 0.0,
    angle_covariance: ArrayLike | None = None,
    cross_covariance: ArrayLike | None = None,
) -> ResolvedLoads:
    """Return lift, side force and drag in the places of NF, SF and AF, and moments about the wind's axes [N, N*m].

    Drag is along the wind, positive downstream; lift is at right angles to it in the body's plane of symmetry,
    positive up; side force is at right angles to both, positive to the right. The reference point stays.

    Parameters
    ----------
    body
        Loads in body axes.
    angle_of_attack
        Positive with the nose up against the wind, shape (n,) or one [rad].
    sideslip
        Positive with the wind from the right (nose left), shape (n,) or one [rad].
    angle_covariance
        Covariance of both angles, shape (2, 2) or (n, 2, 2) [rad^2].
    cross_covariance
        Covariance of the loads and both angles, shape (6, 2) or (n, 6, 2) [N*rad, N*m*rad], where one error is in
        both, as that of an inclinometer by which the weight is taken off; needs `angle_covariance`.
    """
    samples = body.values.shape[0]
    alpha, beta = (
        np.broadcast_to(np.asarray(angle, dtype=np.float64), (samples,)) for angle in (angle_of_attack, sideslip)
    )
    (pitch, by_pitch), (yaw, by_yaw) = _about("pitch", alpha), _about("yaw", -beta)
    back, by_alpha = np.swapaxes(pitch, -1, -2), np.swapaxes(by_pitch, -1, -2)
    aside, by_beta = np.swapaxes(yaw, -1, -2), -np.swapaxes(by_yaw, -1, -2)
    matrix = _load_matrix(aside @ back, np.zeros(3))
    if angle_covariance is None:
        return body.transformed(matrix)
    slopes = [
        np.einsum("nij,nj->ni", _load_matrix(turn, np.zeros(3)), body.values)
        for turn in (aside @ by_alpha, by_beta @ back)
    ]
    unknowns = np.asarray(angle_covariance, dtype=np.float64)
    if unknowns.shape not in ((2, 2), (samples, 2, 2)):
        raise ValueError(f"angle_covariance must have shape (2, 2) or ({samples}, 2, 2), not {unknowns.shape}")
    both = np.zeros((6, 2)) if cross_covariance is None else np.asarray(cross_covariance, dtype=np.float64)
    if both.shape not in ((6, 2), (samples, 6, 2)):
        raise ValueError(f"cross_covariance must have shape (6, 2) or ({samples}, 6, 2), not {both.shape}")
    return body.transformed(
        matrix, slopes=np.stack(slopes, axis=2), parameter_covariance=unknowns, cross_covariance=both
    )


def coefficients(
    loads: ResolvedLoads,
    *,
    pressure: ArrayLike,
    area: float,
    chord: float,
    span: float,
    pressure_uncertainty: ArrayLike = 0.0,
) -> ResolvedLoads:
    """Return the coefficients: forces over q S, pitching moment over q S c, yawing and rolling moment over q S b [1].

    Parameters
    ----------
    loads
        In any axes.
    pressure
        Dynamic pressure q, shape (n,) or one [Pa].
    area
        Reference area S [m^2].
    chord, span
        Reference lengths c of the pitching moment and b of the others [m].
    pressure_uncertainty
        Standard uncertainty of q, shape (n,) or one [Pa].

    Returns
    -------
    coefficients
        In the order of the components; NaN where the pressure is not positive.

    Raises
    ------
    ValueError
        A reference quantity, or every pressure, is not positive.
    """
    for name, size in (("area", area), ("chord", chord), ("span", span)):
        if not 0 < size < np.inf:
            raise ValueError(f"{name} must be positive and finite, not {size}")
    samples = loads.values.shape[0]
    q, u_q = (
        np.broadcast_to(np.asarray(given, dtype=np.float64), (samples,)) for given in (pressure, pressure_uncertainty)
    )
    if (u_q < 0).any():
        raise ValueError("pressure_uncertainty must be zero or more")
    flowing = q > 0
    if not flowing.any():
        raise ValueError("pressure must be positive [Pa]; it nowhere is")
    if not flowing.all():
        warn_quality(
            f"the dynamic pressure is not positive in {int(np.count_nonzero(~flowing))} of {samples} samples, which "
            "have no coefficients"
        )
    q = np.where(flowing, q, np.nan)
    lengths = {"PM": chord, "YM": span, "RM": span}
    scale = area * np.array([lengths.get(name, 1.0) for name in COMPONENTS])
    over = 1 / (q[:, None] * scale)
    values = loads.values * over
    relative = (u_q / q)[:, None, None]
    covariance = over[:, :, None] * loads.covariance * over[:, None, :]
    return ResolvedLoads(values, covariance + relative**2 * values[:, :, None] * values[:, None, :])


def rotation(pitch: float, roll: float, yaw: float) -> tuple[Array, Array]:
    """Return the matrix from fixed axes to those of a body, and its derivatives by the three angles.

    The body is turned nose right by yaw, then nose up by pitch, then right side down by roll [rad].

    Returns
    -------
    matrix, derivatives
        Shapes (3, 3) and (3, 3, 3) [1, 1/rad], the derivatives in the order of `ANGLES`.
    """
    (pitched, by_pitch), (rolled, by_roll), (yawed, by_yaw) = (
        _about(name, angle) for name, angle in zip(ANGLES, (pitch, roll, yaw), strict=True)
    )
    by_angles = [rolled @ by_pitch @ yawed, by_roll @ pitched @ yawed, rolled @ pitched @ by_yaw]
    return np.asarray(rolled @ pitched @ yawed), np.stack(by_angles)


def _about(name: str, angle: ArrayLike) -> tuple[Array, Array]:
    """Matrices that take a fixed vector into axes turned by angles, and their derivatives, shape (..., 3, 3).

    Rodrigues' formula for the turn of the balance by the other way, as the fixed vector is seen from it.
    """
    along, plane, across = _parts_of_turn(name)
    given = np.asarray(angle, dtype=np.float64)[..., None, None]
    matrix = along + np.cos(given) * plane - np.sin(given) * across
    return matrix, -np.sin(given) * plane - np.cos(given) * across


@cache
def _parts_of_turn(name: str) -> tuple[Array, Array, Array]:
    """Matrices that keep what is along an axis, what is across it, and what is across turned by a right angle."""
    axis = np.array(VECTORS[ANGLES[name]], dtype=np.float64)
    along = np.outer(axis, axis)
    return along, np.eye(3) - along, _cross(axis)


def _cross(vector: Array) -> Array:
    """Matrix of the product with a vector on its left, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _load_matrix(rotation: Array, point: Array) -> Array:
    """Matrix of loads, in the order of the components, for rotations of shape (..., 3, 3), shape (..., 6, 6)."""
    whole = np.zeros((*rotation.shape[:-2], 6, 6))
    whole[..., :3, :3] = rotation
    whole[..., 3:, 3:] = rotation
    whole[..., 3:, :3] = -rotation @ _cross(point)
    return FROM_VECTORS @ whole @ FROM_VECTORS.T
