r"""Weighing: the moving mass from static readings at several pitch (and roll) angles, Eq. (1) of [Gorbushin2020]_.

At rest every force component reads the weight along its own axis. In balance axes (aft, right, up), with pitch
theta nose up and roll phi right side down, the weight is

    M g (sin(theta), cos(theta) sin(phi), -cos(theta) cos(phi)),

so AF = M g sin(theta), SF = M g cos(theta) sin(phi) and NF = -M g cos(theta) cos(phi), each with an offset. An axis
that leans by small angles toward the other two reads those shares of the weight besides.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, FORCE_AXES, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError
from aerobalance.recording.gravity import weight_direction

ROLL_NEEDED: Final = np.radians(1.0)
"""Spread of roll from which misalignment is fitted [rad]."""

IDENTIFIABLE: Final = 0.02
"""Least rms of a misalignment's own share of gravity, over all points, for it to be fitted [g]."""

LARGEST_RELATIVE_UNCERTAINTY: Final = 0.5
"""Relative standard uncertainty of the mass from which the angles do not carry it."""


@dataclass(frozen=True, slots=True, eq=False)
class MovingMass:
    """Moving mass of one component, as weighed by Eq. (1) of [Gorbushin2020]_.

    Attributes
    ----------
    component
        Force component that was read.
    mass, u
        Mass M and its standard uncertainty [kg].
    offset, u_offset
        Reading without weight and its standard uncertainty [N].
    misalignment, u_misalignment
        Angles by which the measuring axis leans toward the other axes (``"aft"``, ``"right"``, ``"up"``), and their
        standard uncertainties [rad]; empty where roll did not vary, and without those the angles cannot show.
    parameters, covariance
        Names of the fitted parameters and their covariance, shape (p, p), in the units above.
    residuals
        Reading less fit at every point, shape (n,) [N].
    degrees_of_freedom
        Number of points less number of parameters; the uncertainties are not widened for few of them (multiply
        by the factor of Student's distribution for an interval).
    gravity
        Acceleration of gravity used [m/s^2].
    """

    component: str
    mass: float
    u: float
    offset: float
    u_offset: float
    misalignment: Mapping[str, float]
    u_misalignment: Mapping[str, float]
    parameters: tuple[str, ...]
    covariance: Array
    residuals: Array
    degrees_of_freedom: int
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        if self.component not in FORCE_AXES:
            raise ValueError(f"component must be one of {', '.join(FORCE_AXES)}, not {self.component!r}")
        for name in ("mass", "gravity"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, not {getattr(self, name)}")
        if not 0 <= self.u < np.inf:
            raise ValueError(f"u must be zero or more and finite, not {self.u}")


def weigh(
    pitch: ArrayLike,
    load: ArrayLike,
    *,
    roll: ArrayLike | None = None,
    component: str = "AF",
    gravity: float = STANDARD_GRAVITY,
    noise: ArrayLike | None = None,
) -> MovingMass:
    """Find the moving mass from static readings, Eq. (1) of [Gorbushin2020]_, by linear least squares.

    Parameters
    ----------
    pitch
        Pitch of every point, shape (n,) [rad].
    load
        Reading of the component, shape (n,) [N].
    roll
        Roll of every point, shape (n,) [rad]; zero if left out. Where it varies, the misalignment of the measuring
        axis is found too.
    component
        ``"AF"``, ``"SF"`` or ``"NF"``.
    gravity
        Local acceleration of gravity [m/s^2].
    noise
        Standard uncertainty of a reading, one or n of them [N]. The scatter of the residuals takes its place where
        it is larger, or where none is given.

    Raises
    ------
    FitError
        The angles cannot carry the mass; the message says which to add.
    ValueError
        The arguments do not fit together.
    """
    angles, readings, rolls, given = _arguments(pitch, load, roll, noise)
    if component not in FORCE_AXES:
        raise ValueError(f"component must be one of {', '.join(FORCE_AXES)} (moments need the centre of gravity too)")
    if not 0 < gravity < np.inf:
        raise ValueError(f"gravity must be positive and finite, not {gravity}")
    names, design = _design(angles, rolls, FORCE_AXES[component], gravity)
    count, size = design.shape
    if count < size:
        raise FitError(f"{count} point(s) for {size} parameters ({', '.join(names)}); {_more_angles(component)}")
    weight = design[:, 0] - design[:, 0].mean()
    if np.sqrt(np.mean(weight**2)) < 1e-4 * gravity:
        raise FitError(
            f"the share of gravity along {component} is the same at all {count} points; {_more_angles(component)}"
        )
    freedom = count - size
    if freedom == 0 and given is None:
        raise FitError(
            f"{count} points fix the {size} parameters exactly and leave nothing to tell their uncertainty; "
            "add a point, or give the noise of a reading"
        )
    inverse = np.linalg.pinv(design)
    solution = inverse @ readings
    residuals = readings - design @ solution
    scatter = np.sqrt(residuals @ residuals / freedom) if freedom else 0.0
    deviation = np.maximum(np.full(count, scatter), 0.0 if given is None else given)
    covariance = (inverse * deviation**2) @ inverse.T
    return _result(component, names, solution, covariance, residuals=residuals, gravity=gravity)


def _arguments(
    pitch: ArrayLike, load: ArrayLike, roll: ArrayLike | None, noise: ArrayLike | None
) -> tuple[Array, Array, Array, Array | None]:
    angles, readings = np.array(pitch, dtype=np.float64), np.array(load, dtype=np.float64)
    if angles.ndim != 1 or angles.shape != readings.shape:
        raise ValueError(f"pitch and load must have the same shape (n,), not {angles.shape} and {readings.shape}")
    rolls = np.zeros_like(angles) if roll is None else np.array(roll, dtype=np.float64)
    if rolls.shape != angles.shape:
        raise ValueError(f"roll must have shape {angles.shape} as pitch has, not {rolls.shape}")
    given = None if noise is None else np.broadcast_to(np.asarray(noise, dtype=np.float64), angles.shape)
    if given is not None and not (np.isfinite(given) & (given >= 0)).all():
        raise ValueError("noise must be zero or more and finite")
    for name, values in (("pitch", angles), ("load", readings), ("roll", rolls)):
        if not np.isfinite(values).all():
            point = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise FitError(f"the {name} of point {point} is missing; leave the point out or repeat it")
    if given is not None and not given.any():
        given = None
    return angles, readings, rolls, given


def _design(pitch: Array, roll: Array, axis: str, gravity: float) -> tuple[tuple[str, ...], Array]:
    """Names of the parameters, and the design matrix: M, offset, and M times the misalignments that can show."""
    weight = dict(zip(AXES, gravity * weight_direction(pitch, roll).T, strict=True))
    names, columns = ["mass", "offset"], [weight[axis], np.ones_like(pitch)]
    if np.ptp(roll) < ROLL_NEEDED if roll.size else True:
        return tuple(names), np.column_stack(columns)
    for other in (name for name in weight if name != axis):
        if pitch.size <= len(columns):
            break
        design = np.column_stack(columns)
        own = weight[other] - design @ np.linalg.lstsq(design, weight[other], rcond=None)[0]
        rest = np.column_stack([*columns[1:], weight[other]])
        left = weight[axis] - rest @ np.linalg.lstsq(rest, weight[axis], rcond=None)[0]
        # A misalignment that looks like the offset, or like the mass itself, is left out rather than guessed.
        if min(np.sqrt(np.mean(own**2)), np.sqrt(np.mean(left**2))) > IDENTIFIABLE * gravity:
            names.append(other)
            columns.append(weight[other])
    return tuple(names), np.column_stack(columns)


def _more_angles(component: str) -> str:
    if component == "AF":
        return "add readings at other pitch angles, for example -10, -5, 0, 5, 10 deg"
    return "add readings at other roll angles, for example 0, 90, 180, 270 deg"


def _result(
    component: str, names: tuple[str, ...], solution: Array, covariance: Array, *, residuals: Array, gravity: float
) -> MovingMass:
    """Turn the linear parameters (M, offset, M times misalignment) into mass, offset and angles."""
    mass = float(solution[0])
    deviation = float(np.sqrt(covariance[0, 0]))
    if mass <= 0:
        raise FitError(
            f"the mass comes out as {mass:.4g} kg, which no mass is; check the signs of {component} (AF positive aft, "
            "SF to the right, NF up) and of pitch (positive nose up)"
        )
    if deviation > LARGEST_RELATIVE_UNCERTAINTY * mass:
        raise FitError(
            f"the mass comes out as {mass:.4g} kg with a standard uncertainty of {deviation:.4g} kg; "
            f"{_more_angles(component)}, further apart"
        )
    jacobian = np.eye(len(names))
    values = solution.copy()
    for index in range(2, len(names)):
        values[index] = solution[index] / mass
        jacobian[index, 0], jacobian[index, index] = -values[index] / mass, 1 / mass
    spread = jacobian @ covariance @ jacobian.T
    spread = (spread + spread.T) / 2
    deviations = np.sqrt(np.diag(spread))
    return MovingMass(
        component=component,
        mass=mass,
        u=deviation,
        offset=float(values[1]),
        u_offset=float(deviations[1]),
        misalignment={name: float(values[i]) for i, name in enumerate(names) if i > 1},
        u_misalignment={name: float(deviations[i]) for i, name in enumerate(names) if i > 1},
        parameters=names,
        covariance=spread,
        residuals=residuals,
        degrees_of_freedom=residuals.size - len(names),
        gravity=gravity,
    )
