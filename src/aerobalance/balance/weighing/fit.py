r"""Weighing: the moving mass from static loads at several pitch and roll angles, Eq. (1) of [Gorbushin2020]_.

At rest every force reads the weight along its own axis: AF = M g sin(pitch), SF = M g cos(pitch) sin(roll) and
NF = -M g cos(pitch) cos(roll), each with an offset; every moment reads the moment of that weight about the centre of
the balance. The balance may be turned against the inclinometer by small angles. Each component has a live end of its
own mass, so the mass of every force and the centre of gravity of every moment are found by themselves, tested for
agreement, and replaced by common ones where they agree. One force alone is the same with one component.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import fdtrc

from aerobalance.balance.weighing.adjustment import Adjustment, Readings, adjust
from aerobalance.balance.weighing.advice import unidentified, what_would_help
from aerobalance.balance.weighing.model import LEVERS, WeightModel
from aerobalance.balance.weighing.point_doubts import doubts_of_points
from aerobalance.balance.weighing.points import LoadPoints
from aerobalance.balance.weighing.result import Agreement, MovingMass, Weighing, centre_of
from aerobalance.dynamics.rigid_body import FARTHEST, TOO_FAR, UNITS_ADVICE
from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, FORCE_AXES, MOMENTS, STANDARD_GRAVITY
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, argument, warn_quality
from aerobalance.recording.gravity import weight_direction

LEAST_SHARE: Final = 1e-4
"""Least rms change of a force's share of gravity from which a mass can be guessed [g]."""

WHOLE: Final = 1e-6
"""Rounding of degrees of freedom that are a whole number."""

LARGEST_RELATIVE_UNCERTAINTY: Final = 0.5
"""Standard uncertainty of the mass, over the mass, from which the readings do not carry it."""

SCALES_DIFFER: Final = 0.1
"""Difference between the mass by weighing and that on scales, over the latter, up to which it may be the balance's own
live end, which scales do not weigh."""

SCALES_IN_U: Final = 3.0
"""The same over the uncertainty of the weighing."""

FORCE_UNITS: Final = {4.448222: "lbf and N", 9.80665: "kgf and N", 1000.0: "a unit and a thousand of it"}
"""Factors between units of force that are mistaken for each other."""

LEANS: Final[Mapping[str, Mapping[str, tuple[float, str]]]] = {
    "AF": {"right": (-1.0, "yaw"), "up": (-1.0, "pitch")},
    "SF": {"aft": (1.0, "yaw"), "up": (-1.0, "roll")},
    "NF": {"aft": (1.0, "pitch"), "right": (1.0, "roll")},
}
"""Lean of every force's axis toward the other axes when the balance is turned: sign and angle."""


def fit_weight(points: LoadPoints, *, gravity: float = STANDARD_GRAVITY) -> Weighing:
    """Return mass [kg], centre of gravity [m], offsets [N, N*m] and tilt [rad] from static loads.

    Eq. (1) of [Gorbushin2020]_, by weighted non-linear least squares over all points and components; every component
    is weighted by its own scatter, or by the given noise where that is larger. A parameter that the attitudes cannot
    show is left out, named, and counted in the uncertainty of the others with the size that it may well have.

    Parameters
    ----------
    points
        Loads at rest of one force at least, and of any other components.
    gravity
        Local acceleration of gravity [m/s^2].

    Returns
    -------
    Weighing
        The result; where components disagree, each keeps its own mass or centre of gravity in ``loads``.

    Raises
    ------
    FitError
        The readings cannot carry the mass; the message says what to add.
    ValueError
        No force is among the components, or gravity is not positive.

    Warns
    -----
    DataQualityWarning
        The masses or the centres of gravity of the components differ; a point does not go with the others, or loads
        depend on the way the points were reached.
    """
    components = points.components
    if not any(name in FORCE_AXES for name in components):
        raise ValueError(f"no force among {', '.join(components)}; the mass needs AF, SF or NF")
    separate_model = WeightModel(components, own_masses=True, own_centres=True, gravity=gravity)
    common_model = WeightModel(components, gravity=gravity)
    lead, readings = _readings(points, gravity)
    separate, common = adjust(separate_model, readings), adjust(common_model, readings)
    for adjustment, name in ((separate, f"mass.{lead}"), (common, "mass")):
        _check_carried(adjustment, readings, name)
    _check_signs(separate)
    masses = _agreement(separate, _mass_pairs(separate))
    centres = _agreement(separate, _centre_pairs(separate))
    chosen = common
    if not (masses is None or masses.agree) or not (centres is None or centres.agree):
        own_masses = masses is not None and not masses.agree
        own_centres = centres is not None and not centres.agree
        _warn(separate, own_masses=own_masses, own_centres=own_centres)
        model = WeightModel(components, own_masses=own_masses, own_centres=own_centres, gravity=gravity)
        chosen = adjust(model, readings, assumed=_common_values(model, common))
    doubts = doubts_of_points(chosen.model, readings, chosen)
    for doubt in doubts:
        warn_quality(str(doubt))
    found = _result(readings, separate=separate, common=common, chosen=chosen, agreements=(masses, centres))
    return replace(found, doubts=(*doubts, *_far_away(found)))


def _far_away(found: Weighing) -> Iterator[Doubt]:
    """Yield a doubt of units for each moment where the centre of gravity is farther away than any model's."""
    away = float(np.linalg.norm(list(found.centre_of_gravity.values())))
    if away > FARTHEST:
        text = f"the centre of gravity comes out {away:.3g} m from the centre of the balance; {TOO_FAR}"
        warn_quality(f"{text}; {UNITS_ADVICE}")
        for name in found.components:
            if name in MOMENTS:
                yield Doubt("units", name, text, UNITS_ADVICE, None, "kg")


def against_scales(found: Weighing, scales: float) -> Weighing:
    """Return a weighing held against the mass of the same on scales [kg], with a doubt where it is another.

    Raises
    ------
    ValueError
        That is no mass.

    Warns
    -----
    DataQualityWarning
        They differ by more than the balance's own live end may be.
    """
    if not 0 < scales < np.inf:
        raise ValueError(f"{argument('scales')} must be a positive and finite mass in kg, not {scales}")
    ratio, u = found.mass / scales, found.u_mass / scales
    if abs(ratio - 1) <= max(SCALES_DIFFER, SCALES_IN_U * u):
        return found
    alike = [
        words
        for factor, words in FORCE_UNITS.items()
        if abs(abs(np.log(ratio)) - np.log(factor)) < np.log(1 + SCALES_DIFFER)
    ]
    like = f", which is a factor between {' or '.join(alike)}" if alike else ""
    text = (
        f"weighing finds {found.mass:.4g} kg, {ratio:.3g} times the {scales:.4g} kg on scales{like}: all loads may be "
        "wrong by that factor"
    )
    advice = (
        "check the units of loads and capacities in the schedule of the calibration, the unit of the gauge outputs, "
        "and what was on the scales"
    )
    warn_quality(f"{text}; {advice}")
    doubts = [Doubt("mass", name, text, advice, abs(found.mass - scales), "kg") for name in found.components]
    return replace(found, doubts=(*found.doubts, *doubts))


def _readings(points: LoadPoints, gravity: float) -> tuple[str, Readings]:
    """Check the points; find the force that shows the mass best, and about how large that is."""
    rolls = np.zeros_like(points.pitch) if points.roll is None else points.roll
    tables = {"pitch": points.pitch[:, None], "roll": rolls[:, None], "load": points.loads}
    for name, values in tables.items():
        lacking = np.argwhere(~np.isfinite(values))
        if lacking.size:
            what = points.components[int(lacking[0, 1])] if name == "load" else name
            raise FitError(
                f"the {what} of point {int(lacking[0, 0]) + 1} is missing; leave the point out or repeat it"
            )
    directions = weight_direction(points.pitch, rolls)
    if points.pitch.size < 2:
        raise FitError(f"{points.pitch.size} point(s) cannot tell weight from offset; {_basic_advice(points)}")
    shares = {name: directions[:, AXES.index(FORCE_AXES[name])] for name in points.components if name in FORCE_AXES}
    lead = max(shares, key=lambda name: float(np.std(shares[name])))
    if float(np.std(shares[lead])) < LEAST_SHARE:
        raise FitError(
            f"the share of gravity along {', '.join(shares)} is the same at all {points.pitch.size} points; "
            f"{_basic_advice(points)}"
        )
    share = shares[lead] - shares[lead].mean()
    load = points.loads[:, points.components.index(lead)]
    mass = float(share @ (load - load.mean()) / (share @ share) / gravity)
    if mass <= 0:
        raise _wrong_sign(lead, mass)
    noise = np.zeros_like(points.loads) if points.noise is None else points.noise
    return lead, Readings(directions, points.loads, noise, mass, points.shared)


def _basic_advice(points: LoadPoints) -> str:
    if "AF" in points.components:
        return "add readings at other pitch angles, for example -10, -5, 0, 5, 10 deg"
    return "add readings at other roll angles, for example 0, 90, 180, 270 deg"


def _wrong_sign(component: str, mass: float) -> FitError:
    return FitError(
        f"the mass comes out as {mass:.4g} kg from {component}, which no mass is; check the signs of {component} "
        "(AF positive aft, SF to the right, NF up), of pitch (positive nose up) and of roll (positive right side down)"
    )


def _check_carried(adjustment: Adjustment, readings: Readings, name: str) -> None:
    """Refuse readings that cannot carry a mass: by their attitudes, or by how they scatter about the fit."""
    found = name in adjustment.parameters
    value = adjustment.values[adjustment.model.names.index(name)]
    u = np.sqrt(adjustment.covariance.diagonal()[adjustment.parameters.index(name)]) if found else np.inf
    said = name.replace(".", " of ")
    if not found:
        advice = what_would_help(
            adjustment.model, readings, values=adjustment.values, sigma=adjustment.sigma, name=name
        )
        raise FitError(f"these attitudes cannot tell the {said} from the offset; {advice}")
    if 0 < LARGEST_RELATIVE_UNCERTAINTY * value < u:
        raise FitError(
            f"the {said} comes out as {value:.4g} kg with a standard uncertainty of {u:.4g} kg, so much do the points "
            "scatter; check their loads and angles, or add points at angles further apart"
        )


def _check_signs(separate: Adjustment) -> None:
    for name, value in zip(separate.parameters, separate.values[separate.kept], strict=True):
        if name.startswith("mass") and value <= 0:
            raise _wrong_sign(name.removeprefix("mass."), float(value))


def _mass_pairs(separate: Adjustment) -> list[tuple[str, str]]:
    found = [name for name in separate.parameters if name.startswith("mass")]
    return [(found[0], other) for other in found[1:]]


def _centre_pairs(separate: Adjustment) -> list[tuple[str, str]]:
    pairs = []
    for axis in AXES:
        names = [f"moment.{moment}.{axis}" for moment, levers in LEVERS.items() if axis in levers]
        if all(name in separate.parameters for name in names):
            pairs.append((names[0], names[1]))
    return pairs


def _agreement(separate: Adjustment, pairs: Sequence[tuple[str, str]]) -> Agreement | None:
    """Test the differences of pairs of parameters together."""
    if not pairs:
        return None
    contrast = np.zeros((len(pairs), separate.kept.size))
    for row, (first, second) in enumerate(pairs):
        contrast[row, separate.parameters.index(first)] = 1.0
        contrast[row, separate.parameters.index(second)] = -1.0
    difference = contrast @ separate.values[separate.kept]
    spread = contrast @ separate.covariance @ contrast.T
    chi2 = float(difference @ np.linalg.solve(spread, difference))
    compared = {name.split(".")[1] for pair in pairs for name in pair}
    # The components have noises of their own; the least known of them bounds how well the spread is known.
    freedom = min(separate.freedom[separate.model.components.index(name)] for name in compared)
    freedom = max(float(freedom), 1.0)
    return Agreement(chi2, len(pairs), float(fdtrc(len(pairs), freedom, chi2 / len(pairs))))


def _warn(separate: Adjustment, *, own_masses: bool, own_centres: bool) -> None:
    deviations = np.sqrt(np.diag(separate.covariance))
    said = {
        name: f"{value:.5g} (u = {deviation:.2g})"
        for name, value, deviation in zip(separate.parameters, separate.values[separate.kept], deviations, strict=True)
    }
    cause = "live ends of their own mass, a sensitivity or a sign that is off, or cross effects"
    if own_masses:
        masses = ", ".join(f"{name.removeprefix('mass.')} {text} kg" for name, text in said.items() if "mass" in name)
        warn_quality(
            f"the forces find different masses: {masses} ({cause}); each is corrected with its own, and the common "
            "mass is uncertain by their scatter"
        )
    if own_centres:
        moments = ", ".join(
            f"{name.removeprefix('moment.').replace('.', ' ')} {text} kg*m"
            for name, text in said.items()
            if name.startswith("moment")
        )
        warn_quality(
            f"the moments find different centres of gravity; mass times coordinate is {moments} ({cause}); each is "
            "corrected with its own, and the common centre is uncertain by their scatter"
        )


def _common_values(model: WeightModel, common: Adjustment) -> Array:
    """Return the prior of each component: what all have in common, for where it cannot be told by itself."""
    values = np.zeros(len(model.names))
    for index, name in enumerate(model.names):
        parts = name.split(".")
        shared = {"mass": "mass", "moment": f"moment.{parts[-1]}"}.get(parts[0])
        if shared is not None:
            values[index] = common.values[common.model.names.index(shared)]
    return values


def _widening(agreement: Agreement | None) -> float:
    """Birge ratio where components disagree, else one."""
    if agreement is None or agreement.agree:
        return 1.0
    return float(np.sqrt(agreement.chi2 / agreement.degrees_of_freedom))


def _moving_masses(separate: Adjustment) -> dict[str, MovingMass]:
    """Mass, offset and leans of every force, with their covariance."""
    names = separate.parameters
    values = dict(zip(names, separate.values[separate.kept], strict=True))
    result = {}
    for column, component in enumerate(separate.model.components):
        if f"mass.{component}" not in names:
            continue
        leans = {
            axis: (sign, f"misalignment.{angle}")
            for axis, (sign, angle) in LEANS[component].items()
            if f"misalignment.{angle}" in names
        }
        sources = [(1.0, f"mass.{component}"), (1.0, f"offset.{component}"), *leans.values()]
        select = np.zeros((len(sources), len(names)))
        for row, (sign, name) in enumerate(sources):
            select[row, names.index(name)] = sign
        covariance = select @ separate.covariance @ select.T
        deviations = np.sqrt(np.diag(covariance))
        result[component] = MovingMass(
            component=component,
            mass=float(values[f"mass.{component}"]),
            u=float(deviations[0]),
            offset=float(values[f"offset.{component}"]),
            u_offset=float(deviations[1]),
            misalignment={axis: float(sign * values[name]) for axis, (sign, name) in leans.items()},
            u_misalignment={axis: float(deviations[row]) for row, axis in enumerate(leans, 2)},
            parameters=("mass", "offset", *leans),
            covariance=(covariance + covariance.T) / 2,
            residuals=separate.residuals[:, column].copy(),
            degrees_of_freedom=int(max(np.floor(separate.freedom[column] + WHOLE), 0)),
            gravity=separate.model.gravity,
        )
    return result


def _result(
    readings: Readings,
    *,
    separate: Adjustment,
    common: Adjustment,
    chosen: Adjustment,
    agreements: tuple[Agreement | None, Agreement | None],
) -> Weighing:
    pooled = dict(zip(common.parameters, common.values[common.kept].tolist(), strict=True))
    mass_u = float(np.sqrt(common.covariance[common.parameters.index("mass")][common.parameters.index("mass")]))
    centre, centre_u = centre_of(pooled, common.covariance)
    widening = _widening(agreements[1])
    offsets, u_offsets = _group(chosen, "offset")
    angles, u_angles = _group(chosen, "misalignment")
    names = chosen.model.names
    return Weighing(
        model=chosen.model,
        masses=_moving_masses(separate),
        mass=pooled["mass"],
        u_mass=mass_u * _widening(agreements[0]),
        centre_of_gravity=centre,
        u_centre_of_gravity={axis: u * widening for axis, u in centre_u.items()},
        offsets=offsets,
        u_offsets=u_offsets,
        misalignment=angles,
        u_misalignment=u_angles,
        mass_agreement=agreements[0],
        centre_agreement=agreements[1],
        parameters=chosen.parameters,
        values=chosen.values[chosen.kept],
        covariance=(chosen.covariance + chosen.covariance.T) / 2,
        left_out={names[index]: float(size) for index, size in zip(chosen.left_out, chosen.scales, strict=True)},
        assumed={names[index]: float(chosen.values[index]) for index in chosen.left_out},
        absorbed=chosen.absorbed,
        residuals=chosen.residuals,
        deviations=dict(zip(chosen.model.components, chosen.deviations.tolist(), strict=True)),
        degrees_of_freedom=chosen.residuals.size - chosen.kept.size,
        unidentified=unidentified(readings, chosen=chosen, common=common, separate=separate),
    )


def _group(adjustment: Adjustment, stem: str) -> tuple[dict[str, float], dict[str, float]]:
    """Values and standard uncertainties of the parameters of one kind, by the last part of their names."""
    deviations = np.sqrt(np.diag(adjustment.covariance))
    values, uncertainties = {}, {}
    for name, value, u in zip(
        adjustment.parameters, adjustment.values[adjustment.kept].tolist(), deviations.tolist(), strict=True
    ):
        if name.startswith(f"{stem}."):
            values[name.removeprefix(f"{stem}.")], uncertainties[name.removeprefix(f"{stem}.")] = value, u
    return values, uncertainties
