"""mass.json: what a weighing found, of one force or of all components.

``components`` holds the mass of every force by itself: all that a file by hand needs. ``model`` holds the weight of
all components together, with which later runs are corrected; older files of one component have none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal, Unpack

import numpy as np
from pydantic import Field

from aerobalance.balance.weighing import Agreement, MovingMass, Weighing, WeightModel
from aerobalance.io import artefacts
from aerobalance.io.artefacts import Finite, NotNegative, PositiveValue, Value
from aerobalance.recording.channel import Array
from aerobalance.recording.components import FORCE_AXES, STANDARD_GRAVITY, mass_unit, si_unit
from aerobalance.recording.errors import ReadError

UNITS: Final[Mapping[str, str]] = {"mass": "kg", "moment": "kg*m", "misalignment": "rad"}
"""Units of the parameters by kind; offsets have that of their component."""


class _ComponentMass(artefacts.Loose):
    mass: PositiveValue
    offset: Value = Value(value=0.0)
    misalignment: dict[str, Value] = Field(default_factory=dict)
    covariance: artefacts.Covariance | None = None
    residuals: list[Finite] = Field(default_factory=list)
    degrees_of_freedom: Annotated[int, Field(ge=0)] = 0
    gravity: PositiveValue = PositiveValue(value=STANDARD_GRAVITY)


class _Agreement(artefacts.Loose):
    for_people = frozenset({"agree"})

    chi2: NotNegative
    degrees_of_freedom: Annotated[int, Field(ge=1)]
    p_value: Annotated[float, Field(ge=0, le=1)]


class _Agreements(artefacts.Loose):
    mass: _Agreement | None = None
    centre_of_gravity: _Agreement | None = None


class _Model(artefacts.Loose):
    components: Annotated[list[str], Field(min_length=1)]
    own_masses: bool
    own_centres: bool
    gravity: PositiveValue
    parameters: dict[str, Value]
    covariance: list[list[Finite]]
    left_out: dict[str, Value] = Field(default_factory=dict)
    absorbed: list[list[Finite]]
    degrees_of_freedom: Annotated[int, Field(ge=0)] = 0
    residuals: list[list[Finite]] = Field(default_factory=list)


class _MassFile(artefacts.Loose):
    for_people = artefacts.IN_EVERY_FILE

    kind: Literal["mass"] = "mass"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    components: Annotated[dict[str, _ComponentMass], Field(min_length=1)]
    common_mass: PositiveValue | None = None
    centre_of_gravity: dict[str, Value] = Field(default_factory=dict)
    offsets: dict[str, Value] = Field(default_factory=dict)
    misalignment: dict[str, Value] = Field(default_factory=dict)
    residual_standard_deviation: dict[str, artefacts.NotNegativeValue] = Field(default_factory=dict)
    agreement: _Agreements = _Agreements()
    unidentified: dict[str, str] = Field(default_factory=dict)
    model: _Model | None = None


def parameter_unit(name: str) -> str:
    """Return the unit of a fitted parameter."""
    kind, _, rest = name.partition(".")
    return si_unit(rest) if kind == "offset" else UNITS[kind]


def _mass_payload(mass: MovingMass) -> dict[str, object]:
    unit = si_unit(mass.component)
    return {
        "mass": {"value": mass.mass, "u": mass.u, "unit": mass_unit(mass.component)},
        "offset": {"value": mass.offset, "u": mass.u_offset, "unit": unit},
        "misalignment": {
            axis: {"value": angle, "u": mass.u_misalignment[axis], "unit": "rad"}
            for axis, angle in mass.misalignment.items()
        },
        "covariance": {"parameters": list(mass.parameters), "matrix": mass.covariance.tolist()},
        "residuals": mass.residuals.tolist(),
        "degrees_of_freedom": mass.degrees_of_freedom,
        "gravity": {"value": mass.gravity, "u": 0.0, "unit": "m/s^2"},
    }


def weighing_payload(weighing: Weighing) -> dict[str, object]:
    """Return the contents of mass.json beside its provenance, as plain data."""

    def quantities(values: Mapping[str, float], u: Mapping[str, float], unit: str | None) -> dict[str, object]:
        return {name: {"value": value, "u": u[name], "unit": unit or si_unit(name)} for name, value in values.items()}

    deviations = {name: {"value": value, "unit": si_unit(name)} for name, value in weighing.deviations.items()}
    return {
        "components": {name: _mass_payload(mass) for name, mass in weighing.masses.items()},
        "common_mass": {"value": weighing.mass, "u": weighing.u_mass, "unit": "kg"},
        "centre_of_gravity": quantities(weighing.centre_of_gravity, weighing.u_centre_of_gravity, "m"),
        "offsets": quantities(weighing.offsets, weighing.u_offsets, None),
        "misalignment": quantities(weighing.misalignment, weighing.u_misalignment, "rad"),
        "agreement": {
            "mass": _agreement_payload(weighing.mass_agreement),
            "centre_of_gravity": _agreement_payload(weighing.centre_agreement),
        },
        "residual_standard_deviation": deviations,
        "unidentified": dict(weighing.unidentified),
        "model": _model_payload(weighing),
    }


def _agreement_payload(agreement: Agreement | None) -> dict[str, object] | None:
    if agreement is None:
        return None
    return {
        "chi2": agreement.chi2,
        "degrees_of_freedom": agreement.degrees_of_freedom,
        "p_value": agreement.p_value,
        "agree": agreement.agree,
    }


def _model_payload(weighing: Weighing) -> dict[str, object]:
    deviations = np.sqrt(np.diag(weighing.covariance)).tolist()
    rows = zip(weighing.parameters, weighing.values.tolist(), deviations, strict=True)
    return {
        "components": list(weighing.components),
        "own_masses": weighing.model.own_masses,
        "own_centres": weighing.model.own_centres,
        "gravity": {"value": weighing.gravity, "u": 0.0, "unit": "m/s^2"},
        "parameters": {name: {"value": value, "u": u, "unit": parameter_unit(name)} for name, value, u in rows},
        "covariance": weighing.covariance.tolist(),
        "left_out": {
            name: {"value": weighing.assumed[name], "u": size, "unit": parameter_unit(name)}
            for name, size in weighing.left_out.items()
        },
        "absorbed": weighing.absorbed.tolist(),
        "degrees_of_freedom": weighing.degrees_of_freedom,
        "residuals": weighing.residuals.tolist(),
    }


def write_weighing(path: Path | str, weighing: Weighing, **origin: Unpack[artefacts.Origin]) -> None:
    """Write mass.json.

    Parameters
    ----------
    path
        The file.
    weighing
        What was found.
    origin
        What it was computed from.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    artefacts.write_artefact(path, "mass", weighing_payload(weighing), **origin)


def read_masses(path: Path | str) -> dict[str, MovingMass]:
    """Return the masses [kg] in mass.json, by force; by hand ``components.AF.mass.value`` is enough.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical; the message names the key and what is allowed.
    """
    return _masses(Path(path), artefacts.load(Path(path), "mass", _MassFile))


def _masses(file: Path, contents: _MassFile) -> dict[str, MovingMass]:
    result = {}
    entries = artefacts.entries_of(file, contents.components, FORCE_AXES, what="component that can be weighed")
    for name, key, entry in entries:
        artefacts.check_unit(file, f"{key}.mass.unit", entry.mass, mass_unit(name))
        artefacts.check_unit(file, f"{key}.offset.unit", entry.offset, si_unit(name))
        others = dict(entry.misalignment)
        deviations = {"mass": entry.mass.u, "offset": entry.offset.u, **{axis: v.u for axis, v in others.items()}}
        result[name] = MovingMass(
            component=name,
            mass=entry.mass.value,
            u=entry.mass.u,
            offset=entry.offset.value,
            u_offset=entry.offset.u,
            misalignment={axis: value.value for axis, value in others.items()},
            u_misalignment={axis: value.u for axis, value in others.items()},
            parameters=tuple(deviations),
            covariance=artefacts.checked_covariance(file, f"{key}.covariance", entry.covariance, deviations),
            residuals=np.array(entry.residuals, dtype=np.float64),
            degrees_of_freedom=entry.degrees_of_freedom,
            gravity=entry.gravity.value,
        )
    return result


def read_weighing(path: Path | str) -> Weighing:
    """Return the whole weighing in mass.json, with which later runs are corrected.

    Raises
    ------
    ReadError
        The file is no such JSON, holds masses alone, or its numbers are not physical.
    """
    file = Path(path)
    contents = artefacts.load(file, "mass", _MassFile)
    model, mass = contents.model, contents.common_mass
    if model is None or mass is None:
        raise ReadError(
            file,
            "model" if model is None else "common_mass",
            "is missing: the file holds masses alone; weigh again, with all loads, to correct later runs",
        )
    _check_units(file, contents, model)
    names = list(model.parameters)
    deviations = {name: value.u for name, value in model.parameters.items()}
    given = artefacts.Covariance(parameters=names, matrix=model.covariance)
    covariance = artefacts.checked_covariance(file, "model.covariance", given, deviations)
    try:
        return Weighing(
            model=WeightModel(
                tuple(model.components), model.own_masses, model.own_centres, gravity=model.gravity.value
            ),
            masses=_masses(file, contents),
            mass=mass.value,
            u_mass=mass.u,
            centre_of_gravity=_values(contents.centre_of_gravity),
            u_centre_of_gravity=_deviations(contents.centre_of_gravity),
            offsets=_values(contents.offsets),
            u_offsets=_deviations(contents.offsets),
            misalignment=_values(contents.misalignment),
            u_misalignment=_deviations(contents.misalignment),
            mass_agreement=_agreement(contents.agreement.mass),
            centre_agreement=_agreement(contents.agreement.centre_of_gravity),
            parameters=tuple(names),
            values=np.array(list(_values(model.parameters).values())),
            covariance=covariance,
            left_out=_deviations(model.left_out),
            assumed=_values(model.left_out),
            absorbed=_matrix(file, "model.absorbed", model.absorbed, (len(names), len(model.left_out))),
            residuals=_matrix(file, "model.residuals", model.residuals, (-1, len(model.components))),
            deviations=_values(contents.residual_standard_deviation),
            degrees_of_freedom=model.degrees_of_freedom,
            unidentified=contents.unidentified,
        )
    except ValueError as error:
        raise ReadError(file, "model", str(error)) from None


def _check_units(file: Path, contents: _MassFile, model: _Model) -> None:
    for group, unit in (("centre_of_gravity", "m"), ("misalignment", "rad")):
        for name, value in getattr(contents, group).items():
            artefacts.check_unit(file, f"{group}.{name}.unit", value, unit)
    for key, entries in (("model.parameters", model.parameters), ("model.left_out", model.left_out)):
        for name, value in entries.items():
            kind, _, rest = name.partition(".")
            if kind not in {*UNITS, "offset"} or (kind == "offset" and rest not in model.components):
                raise ReadError(file, f"{key}.{name}", "is no parameter of this model")
            artefacts.check_unit(file, f"{key}.{name}.unit", value, parameter_unit(name))


def _values(entries: Mapping[str, Value]) -> dict[str, float]:
    return {name: entry.value for name, entry in entries.items()}


def _deviations(entries: Mapping[str, Value]) -> dict[str, float]:
    return {name: entry.u for name, entry in entries.items()}


def _agreement(given: _Agreement | None) -> Agreement | None:
    return None if given is None else Agreement(given.chi2, given.degrees_of_freedom, given.p_value)


def _matrix(file: Path, where: str, rows: Sequence[Sequence[float]], shape: tuple[int, int]) -> Array:
    """Make a matrix of rows of the same length."""
    count, width = shape
    if any(len(row) != width for row in rows) or count not in {-1, len(rows)}:
        expected = f"rows of {width} numbers" if count < 0 else f"{count} rows of {width} numbers"
        raise ReadError(file, where, f"must have {expected}")
    return np.array(rows, dtype=np.float64).reshape(len(rows), width)
