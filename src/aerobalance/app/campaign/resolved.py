"""Mean loads in balance, body and wind axes about a moment centre, and coefficients, each with all of its errors.

Every step is that of `aerobalance.recording.frames`; here the parts of the covariance go through it side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.app.campaign.definition import Axes, Placed, Pressure, Reference
from aerobalance.app.campaign.mean_loads import Errors, MeanLoads
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.frames import WIND_NAMES, Frame, ResolvedLoads, coefficients, rotation, wind_loads

BODY_COEFFICIENTS: Final = tuple(f"C{name}" for name in COMPONENTS)
"""Coefficients in body axes about the moment centre, in the order of the components."""

WIND_COEFFICIENTS: Final = ("CL", "CPM_wind", "CY", "CYM_wind", "CRM_wind", "CD")
"""Coefficients in wind axes in the order of the components: lift, side force and drag in the places of NF, SF, AF."""

EXACT: Final = 1e-12
"""Share of a component in a result below which it has none."""


@dataclass(frozen=True, slots=True)
class Flow:
    """Angles and dynamic pressure of a run with their standard uncertainties.

    Attributes
    ----------
    alpha, beta
        Angle of attack and of sideslip [rad].
    u_angle, u_angle_run
        Standard uncertainty of both, the same error in all runs, and drawn anew in each [rad].
    pressure
        Dynamic pressure [Pa]; None where it is not known.
    u_pressure, u_pressure_run
        The same of it [Pa].
    known
        Whether table or recording say the angles; else they are taken as zero.
    """

    alpha: float = 0.0
    beta: float = 0.0
    u_angle: float = 0.0
    u_angle_run: float = 0.0
    pressure: float | None = None
    u_pressure: float = 0.0
    u_pressure_run: float = 0.0
    known: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """Six results of a run in one set of axes.

    Attributes
    ----------
    names
        What they are called, in the order of the components.
    unit
        Their units.
    values
        Shape (6,); NaN where a component that it takes was not measured.
    errors
        Their covariance.
    freedom
        Degrees of freedom of each standard uncertainty, shape (6,), by Welch and Satterthwaite.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    errors: Errors
    freedom: Array


def angles_of_attitude(pitch: float, roll: float) -> tuple[float, float]:
    """Angle of attack and sideslip [rad] of a body pitched up and then rolled in a level wind that blows aft."""
    aft, right, up = rotation(pitch, roll, 0.0)[0] @ np.array([1.0, 0.0, 0.0])
    return float(np.arctan2(up, aft)), float(-np.arcsin(np.clip(right, -1.0, 1.0)))


def resolved(mean: MeanLoads, *, axes: Axes, flow: Flow, reference: Reference | None) -> dict[str, Resolved]:
    """Return mean loads in ``"body"`` and ``"wind"`` axes [N, N*m], and coefficients ``"C_body"``, ``"C_wind"`` [1].

    Parameters
    ----------
    mean
        In the balance's axes.
    axes
        The body in the balance, and the moment centre in the body.
    flow
        Angles and dynamic pressure.
    reference
        Area and lengths; None where there are to be no coefficients.
    """
    place = [COMPONENTS.index(name) for name in mean.components]
    body, centre = (
        frame_of(axes.body),
        Frame(np.array(axes.moment_centre), covariance=np.diag([axes.u_moment_centre**2] * 3 + [0.0] * 3)),
    )
    exact_body, exact_centre = Frame(body.point, body.pitch, body.roll, body.yaw), Frame(centre.point)

    def in_body(given: ResolvedLoads, kind: str) -> ResolvedLoads:
        if kind == "common":
            return centre.loads(body.loads(given))
        return exact_centre.loads(exact_body.loads(given))

    def in_wind(given: ResolvedLoads, kind: str) -> ResolvedLoads:
        u = {"common": flow.u_angle, "run": flow.u_angle_run}.get(kind, 0.0)
        covariance = u**2 * np.eye(2)
        return wind_loads(given, angle_of_attack=flow.alpha, sideslip=flow.beta, angle_covariance=covariance)

    def over(given: ResolvedLoads, kind: str) -> ResolvedLoads:
        if reference is None or flow.pressure is None:
            raise ValueError("coefficients need reference quantities and a dynamic pressure")
        u = {"common": flow.u_pressure, "run": flow.u_pressure_run}.get(kind, 0.0)
        sizes = {"area": reference.area, "chord": reference.chord, "span": reference.span}
        return coefficients(given, pressure=flow.pressure, pressure_uncertainty=u, **sizes)

    units = tuple("N*m" if name in ("PM", "YM", "RM") else "N" for name in COMPONENTS)
    ones = ("1",) * 6
    wanted: dict[str, tuple[tuple[str, ...], tuple[str, ...], Callable[[ResolvedLoads, str], ResolvedLoads]]] = {
        "body": (COMPONENTS, units, in_body),
        "wind": (tuple(WIND_NAMES[name] for name in COMPONENTS), units, lambda g, k: in_wind(in_body(g, k), k)),
    }
    if reference is not None and flow.pressure is not None:
        wanted["C_body"] = (BODY_COEFFICIENTS, ones, lambda g, k: over(in_body(g, k), k))
        wanted["C_wind"] = (WIND_COEFFICIENTS, ones, lambda g, k: over(in_wind(in_body(g, k), k), k))
    return {key: _through(mean, place, names, unit, work) for key, (names, unit, work) in wanted.items()}


def frame_of(placed: Placed) -> Frame:
    """Return a frame of what the test file says of it."""
    pitch, roll, yaw = (float(np.radians(angle)) for angle in (placed.pitch, placed.roll, placed.yaw))
    spread = [placed.u_point**2] * 3 + [float(np.radians(placed.u_angle)) ** 2] * 3
    return Frame(np.array(placed.point), pitch, roll, yaw, np.diag(spread))


def _through(
    mean: MeanLoads,
    place: list[int],
    names: tuple[str, ...],
    units: tuple[str, ...],
    work: Callable[[ResolvedLoads, str], ResolvedLoads],
) -> Resolved:
    """The parts of the covariance through the same step."""
    values = np.zeros((1, 6))
    values[0, place] = mean.values
    found: dict[str, ResolvedLoads] = {}
    for kind, part in mean.errors.parts.items():
        covariance = np.zeros((1, 6, 6))
        covariance[0][np.ix_(place, place)] = part
        found[kind] = work(ResolvedLoads(values, covariance), kind)
    lacking = [row for row in range(6) if row not in place]
    unknown = np.zeros(6, dtype=bool)
    if lacking:
        none = np.zeros((6, 6, 6))
        shares = np.abs(work(ResolvedLoads(np.eye(6), none), "scatter").values)  # row i: what component i alone makes
        unknown = (shares[lacking] > EXACT * shares.max()).any(axis=0)
    result = np.where(unknown, np.nan, found["common"].values[0])
    errors = Errors(**{kind: one.covariance[0] for kind, one in found.items()})
    whole, scatter = np.diag(errors.whole), np.diag(errors.scatter)
    share = np.where(whole > 0, scatter / np.where(whole > 0, whole, 1.0), 0.0)
    return Resolved(names, units, result, errors, mean.freedom / np.maximum(share, 1e-3) ** 2)


def pressure_of(rule: Pressure | None, columns: Mapping[str, object], means: Mapping[str, float]) -> float | None:
    """Dynamic pressure of a run [Pa]; None where none is asked for.

    Raises
    ------
    ValueError
        The column or the channel is missing, or is no pressure.
    """
    if rule is None:
        return None
    if rule.value is not None:
        return rule.value
    if rule.column is not None:
        found = columns.get(rule.column)
        where = f"column {rule.column}"
    else:
        found, where = means.get(rule.channel or ""), f"channel {rule.channel}"
    if found is None:
        raise ValueError(f"the dynamic pressure should be in {where}, which this run does not have")
    if not isinstance(found, int | float) or isinstance(found, bool) or not 0 < found < np.inf:
        raise ValueError(f"the dynamic pressure in {where} must be above 0 Pa, not {found!r}")
    return float(found)
