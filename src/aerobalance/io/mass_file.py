"""mass.json of a weighing by one force component."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Unpack

import numpy as np
from pydantic import Field

from aerobalance.balance.weighing import MovingMass
from aerobalance.io.artefacts import (
    IN_EVERY_FILE,
    Covariance,
    Finite,
    Loose,
    Origin,
    PositiveValue,
    Value,
    check_unit,
    checked_covariance,
    entries_of,
    load,
    write_artefact,
)
from aerobalance.recording.components import FORCE_AXES, STANDARD_GRAVITY, mass_unit, si_unit


class _ComponentMass(Loose):
    mass: PositiveValue
    offset: Value = Value(value=0.0)
    misalignment: dict[str, Value] = Field(default_factory=dict)
    covariance: Covariance | None = None
    residuals: list[Finite] = Field(default_factory=list)
    degrees_of_freedom: Annotated[int, Field(ge=0)] = 0
    gravity: PositiveValue = PositiveValue(value=STANDARD_GRAVITY)


class MassFile(Loose):
    """What every mass.json holds."""

    for_people = IN_EVERY_FILE | {
        "common_mass",
        "centre_of_gravity",
        "offsets",
        "misalignment",
        "residual_standard_deviation",
        "agreement",
        "unidentified",
        "model",
    }

    kind: Literal["mass"] = "mass"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    components: Annotated[dict[str, _ComponentMass], Field(min_length=1)]


def mass_payload(mass: MovingMass) -> dict[str, object]:
    """Give the entry of one component in mass.json, as plain data."""
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


def write_mass(
    path: Path | str,
    masses: Mapping[str, MovingMass],
    **origin: Unpack[Origin],
) -> None:
    """Write mass.json; the arguments are those of `write_dynamics`.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    components = {name: mass_payload(item) for name, item in masses.items()}
    write_artefact(path, "mass", {"components": components}, **origin)


def read_mass(path: Path | str) -> dict[str, MovingMass]:
    """Read mass.json, as written by `write_mass` or by hand (``components.AF.mass.value`` is enough).

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical; the message names the key and what is allowed.
    """
    file = Path(path)
    contents = load(file, "mass", MassFile)
    result = {}
    for name, key, entry in entries_of(file, contents.components, FORCE_AXES, what="component that can be weighed"):
        check_unit(file, f"{key}.mass.unit", entry.mass, mass_unit(name))
        check_unit(file, f"{key}.offset.unit", entry.offset, si_unit(name))
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
            covariance=checked_covariance(file, f"{key}.covariance", entry.covariance, deviations),
            residuals=np.array(entry.residuals, dtype=np.float64),
            degrees_of_freedom=entry.degrees_of_freedom,
            gravity=entry.gravity.value,
        )
    return result
