"""Mean loads in balance, body and wind axes about a moment centre, and coefficients, each with all of its errors.

Every step is that of `aerobalance.recording.frames`; here the parts of the covariance go through it side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Final

import numpy as np

from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.frames import WIND_NAMES, Frame, ResolvedLoads, coefficients, wind_loads
from aerobalance.uncertainty.mean_loads import Errors, MeanLoads

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
    by_sensors
        What the standard uncertainty of each error of the sensors that the angles are from, the same in all runs,
        makes of both angles [rad]; by the name of the error, such as ``pitch zero``.
    """

    alpha: float = 0.0
    beta: float = 0.0
    u_angle: float = 0.0
    u_angle_run: float = 0.0
    pressure: float | None = None
    u_pressure: float = 0.0
    u_pressure_run: float = 0.0
    known: bool = True
    by_sensors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ReferenceSizes:
    """What loads are divided by for coefficients, beside the dynamic pressure.

    Attributes
    ----------
    area
        Reference area [m^2].
    chord, span
        Reference lengths of the pitching moment and of the others [m].
    """

    area: float
    chord: float
    span: float


@dataclass(frozen=True, slots=True, eq=False)
class MeanInAxes:
    """Six mean loads of a run, or their coefficients, in one set of axes.

    Attributes
    ----------
    names, units
        What they are called and their units, in the order of the components.
    values
        Shape (6,) [N, N*m; 1 for coefficients]; NaN where a component that it takes was not measured.
    errors
        Their covariance.
    freedom
        Degrees of freedom of each standard uncertainty, shape (6,), by Welch and Satterthwaite.
    lacking
        Components that were not measured, of each result that takes them, by its name.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    errors: Errors
    freedom: Array
    lacking: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


Step = Callable[[ResolvedLoads, str], ResolvedLoads]
"""Takes loads from one set of axes to the next, with the errors that the step adds to a part of the covariance."""


def mean_in_axes(
    mean: MeanLoads,
    *,
    frames: Sequence[Frame] = (),
    flow: Flow | None = None,
    reference: ReferenceSizes | None = None,
) -> dict[str, MeanInAxes]:
    """Return mean loads in ``"body"`` and ``"wind"`` axes [N, N*m], and coefficients ``"C_body"``, ``"C_wind"`` [1].

    Parameters
    ----------
    mean
        In the balance's axes.
    frames
        From the balance to the body and its moment centre, one in the other; errors of them are the same in all runs.
    flow
        Angles and dynamic pressure; angles of zero if left out.
    reference
        Area and lengths; there are no coefficients without them, or without a dynamic pressure.
    """
    flow = Flow() if flow is None else flow
    exact = [Frame(one.point, one.pitch, one.roll, one.yaw) for one in frames]
    of_sensors, in_both = _errors_of_sensors(mean, flow)
    for frame in exact:
        in_both = frame.matrix @ in_both

    def in_body(given: ResolvedLoads, kind: str) -> ResolvedLoads:
        for frame in frames if kind == "common" else exact:
            given = frame.loads(given)
        return given

    def in_wind(given: ResolvedLoads, kind: str) -> ResolvedLoads:
        u = {"common": flow.u_angle, "run": flow.u_angle_run}.get(kind, 0.0)
        held = 1.0 if kind == "common" else 0.0
        return wind_loads(
            in_body(given, kind),
            angle_of_attack=flow.alpha,
            sideslip=flow.beta,
            angle_covariance=u**2 * np.eye(2) + held * of_sensors,
            cross_covariance=held * in_both,
        )

    units = tuple(si_unit(name) for name in COMPONENTS)
    found = {
        "body": _through(mean, COMPONENTS, units, in_body),
        "wind": _through(mean, tuple(WIND_NAMES[name] for name in COMPONENTS), units, in_wind),
    }
    if reference is None or flow.pressure is None:
        return found
    pressure, sizes = flow.pressure, asdict(reference)

    def over_pressure(step: Step) -> Step:
        def divided(given: ResolvedLoads, kind: str) -> ResolvedLoads:
            u = {"common": flow.u_pressure, "run": flow.u_pressure_run}.get(kind, 0.0)
            return coefficients(step(given, kind), pressure=pressure, pressure_uncertainty=u, **sizes)

        return divided

    ones = ("1",) * 6
    found["C_body"] = _through(mean, BODY_COEFFICIENTS, ones, over_pressure(in_body))
    found["C_wind"] = _through(mean, WIND_COEFFICIENTS, ones, over_pressure(in_wind))
    return found


def _errors_of_sensors(mean: MeanLoads, flow: Flow) -> tuple[Array, Array]:
    """Covariance of both angles by their sensors, and of the loads and them, shape (2, 2) and (6, 2).

    An inclinometer that is off turns the loads by a wrong angle, and takes a wrong part of the weight off them.
    """
    place = [COMPONENTS.index(name) for name in mean.components]
    of_sensors, in_both = np.zeros((2, 2)), np.zeros((6, 2))
    for name, angles in flow.by_sensors.items():
        of_sensors += np.outer(angles, angles)
        if name in mean.by_sensors:
            in_both[place] += np.outer(mean.by_sensors[name], angles)
    return of_sensors, in_both


def _through(mean: MeanLoads, names: tuple[str, ...], units: tuple[str, ...], step: Step) -> MeanInAxes:
    """The parts of the covariance through the same steps."""
    place = [COMPONENTS.index(name) for name in mean.components]
    values = np.zeros((1, 6))
    values[0, place] = mean.values
    found: dict[str, ResolvedLoads] = {}
    for kind, part in mean.errors.parts.items():
        covariance = np.zeros((1, 6, 6))
        covariance[0][np.ix_(place, place)] = part
        found[kind] = step(ResolvedLoads(values, covariance), kind)
    absent = [row for row in range(6) if row not in place]
    lacking: dict[str, tuple[str, ...]] = {}
    if absent:
        none = np.zeros((6, 6, 6))
        shares = np.abs(step(ResolvedLoads(np.eye(6), none), "scatter").values)  # row i: what component i alone makes
        taken = shares > EXACT * shares.max()
        lacking = {
            name: tuple(COMPONENTS[row] for row in absent if taken[row, column])
            for column, name in enumerate(names)
            if taken[absent, column].any()
        }
    unknown = np.array([name in lacking for name in names])
    result = np.where(unknown, np.nan, found["common"].values[0])
    errors = Errors(**{kind: one.covariance[0] for kind, one in found.items()})
    whole, scatter = np.diag(errors.whole), np.diag(errors.scatter)
    share = np.where(whole > 0, scatter / np.where(whole > 0, whole, 1.0), 0.0)
    return MeanInAxes(names, units, result, errors, mean.freedom / np.maximum(share, 1e-3) ** 2, lacking)
