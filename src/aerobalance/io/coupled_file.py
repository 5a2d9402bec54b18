"""dynamics.json of components that ring together: matrices with named rows and columns, covariance, rigid mass."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal, Unpack

import numpy as np
from pydantic import Field

from aerobalance.dynamics.coupled import CoupledDynamics, RigidMass, internal_names
from aerobalance.dynamics.single import Dynamics
from aerobalance.io.artefacts import (
    IN_EVERY_FILE,
    Covariance,
    Finite,
    Loose,
    NotNegative,
    Origin,
    PositiveValue,
    Value,
    check_unit,
    checked_covariance,
    load,
    write_artefact,
)
from aerobalance.io.dynamics_file import ListedMode, check_mode, read_dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import AXES, COMPONENTS, si_unit
from aerobalance.recording.errors import ReadError

KIND: Final = "coupled dynamics"
"""What the file calls itself; dynamics.json of components each for itself is of kind ``dynamics``."""

Kind = Literal["axial", "coupled"]
Matrix = Literal["inertia", "damping"]

_TIMES: Final[Mapping[Matrix, str]] = {"inertia": "s^2", "damping": "s"}
_INERTIA: Final = {"aa": (0, 0), "rr": (1, 1), "uu": (2, 2), "ar": (0, 1), "au": (0, 2), "ru": (1, 2)}
"""Moments of inertia by axes: aft, right, up."""


class _Matrix(Loose):
    rows: list[str] | None = None
    columns: list[str] | None = None
    units: list[list[str]] | None = None
    matrix: list[list[Finite]]
    u: list[list[NotNegative]] | None = None


class _Centre(Loose):
    aft: Value
    right: Value
    up: Value


class _Inertia(Loose):
    aa: PositiveValue
    rr: PositiveValue
    uu: PositiveValue
    ar: Value = Value(value=0.0)
    au: Value = Value(value=0.0)
    ru: Value = Value(value=0.0)


class RigidMassPart(Loose):
    """Mass, centre of gravity and inertia of a rigid mass in a file."""

    mass: PositiveValue
    centre: _Centre
    inertia: _Inertia
    covariance: Covariance | None = None


class _Calibration(Loose):
    balance: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")] = ""
    covariance: Covariance


class _CoupledFile(Loose):
    for_people = IN_EVERY_FILE | {"fit"}

    kind: Literal["coupled dynamics"] = "coupled dynamics"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    components: Annotated[list[str], Field(min_length=1)]
    inertia: _Matrix
    damping: _Matrix
    covariance: Covariance | None = None
    calibration: _Calibration | None = None
    mass: RigidMassPart | None = None
    modes: list[ListedMode] = Field(default_factory=list)


def matrix_units(components: Sequence[str], kind: Matrix) -> list[list[str]]:
    """Units of the elements of A (inertia) or D (damping): unit of the row over that of the column, times s^2 or s.

    An internal coordinate is taken as a force.
    """
    time = _TIMES[kind]
    table = {
        ("N", "N"): time,
        ("N*m", "N*m"): time,
        ("N", "N*m"): time + "/m",
        ("N*m", "N"): "m*" + time,
    }
    units = [si_unit(name) if name in COMPONENTS else "N" for name in components]
    return [[table[row, column] for column in units] for row in units]


def coupled_payload(dynamics: CoupledDynamics) -> dict[str, object]:
    """Give what dynamics.json says of coupled components, as plain data.

    The uncertainties ``u`` hold what the calibration of the balance leaves, which stands under ``calibration``;
    ``covariance`` does not.
    """
    n, names = len(dynamics.inertia), list(dynamics.coordinates)
    deviations = np.sqrt(np.diag(dynamics.total_covariance)).reshape(2, n, n)
    payload: dict[str, object] = {"components": list(dynamics.components)}
    for kind, deviation in zip(_TIMES, deviations, strict=True):
        payload[kind] = {
            "rows": names,
            "columns": names,
            "units": matrix_units(names, kind),
            "matrix": getattr(dynamics, kind),
            "u": deviation,
        }
    payload["modes"] = modes_payload(dynamics)
    if dynamics.mass is not None:
        payload["mass"] = _mass_payload(dynamics.mass)
    if dynamics.total_covariance.any():
        payload["covariance"] = {"parameters": list(dynamics.parameters), "matrix": dynamics.covariance}
    if dynamics.covariance_of_calibration.any():
        matrix = dynamics.covariance_of_calibration
        payload["calibration"] = {
            "balance": dynamics.balance,
            "covariance": {"parameters": list(dynamics.parameters), "matrix": matrix},
        }
    return payload


def modes_payload(dynamics: CoupledDynamics) -> list[dict[str, object]]:
    """Modes of coupled dynamics as plain data, each number with its standard uncertainty by the matrices' covariance.

    The keys are those of a mode of one component.
    """
    u = np.sqrt(np.maximum(np.diag(dynamics.mode_covariance), 0.0)).reshape(2, -1).T
    return [
        {
            "natural_frequency": mode.natural_frequency,
            "u_natural_frequency": u_frequency,
            "damping_ratio": mode.damping_ratio,
            "u_damping_ratio": u_ratio,
            "units": {"natural_frequency": "Hz", "damping_ratio": "1"},
        }
        for mode, (u_frequency, u_ratio) in zip(dynamics.modes, u.tolist(), strict=True)
    ]


def _mass_payload(mass: RigidMass) -> dict[str, object]:
    values = mass.values.tolist()
    deviations = np.sqrt(np.diag(mass.covariance))
    units = ("kg", *("m",) * 3, *("kg*m^2",) * 6)
    entries = [
        {"value": value, "u": u, "unit": unit} for value, u, unit in zip(values, deviations, units, strict=True)
    ]
    payload: dict[str, object] = {
        "mass": entries[0],
        "centre": dict(zip(AXES, entries[1:4], strict=True)),
        "inertia": dict(zip(_INERTIA, entries[4:], strict=True)),
    }
    if mass.covariance.any():
        payload["covariance"] = {"parameters": list(_mass_names()), "matrix": mass.covariance}
    return payload


def _mass_names() -> tuple[str, ...]:
    return ("mass", *(f"centre.{axis}" for axis in AXES), *(f"inertia.{axes}" for axes in _INERTIA))


def write_coupled(
    path: Path | str,
    dynamics: CoupledDynamics,
    *,
    details: Mapping[str, object] | None = None,
    **origin: Unpack[Origin],
) -> None:
    """Write dynamics.json of coupled components; the arguments are those of `write_dynamics`.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    fit = {"fit": dict(details)} if details else {}
    write_artefact(path, KIND, {**coupled_payload(dynamics), **fit}, **origin)


def read_coupled(path: Path | str) -> CoupledDynamics:
    """Read dynamics.json of coupled components, as written by `write_coupled` or by hand.

    By hand ``components``, ``inertia.matrix`` and ``damping.matrix`` are enough; where there are internal coordinates,
    ``inertia.rows`` names them behind the components: hidden 1, hidden 2 and so on.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical; the message names the key and what is allowed.
    """
    file = Path(path)
    if dynamics_kind(file) == "axial":
        raise ReadError(
            file,
            "components",
            "holds components that ring each for itself, but coupled dynamics are needed: components that were "
            "identified together, with the matrices inertia and damping",
        )
    contents = load(file, KIND, _CoupledFile)
    names = tuple(contents.components)
    if names != tuple(name for name in COMPONENTS if name in names):
        raise ReadError(file, "components", f"must be some of {', '.join(COMPONENTS)}, in this order and each once")
    internal = max(len(contents.inertia.rows or ()) - len(names), 0)
    coordinates = (*names, *internal_names(internal))
    matrices: dict[str, Array] = {}
    deviations: dict[str, float] = {}
    for kind in _TIMES:
        matrices[kind], u = _read_matrix(file, kind, getattr(contents, kind), coordinates)
        pairs = [f"{kind} {row}/{column}" for row in coordinates for column in coordinates]
        deviations |= dict(zip(pairs, u.ravel().tolist(), strict=True))
    covariance, of_calibration = _covariances(file, contents, deviations)
    balance = "" if contents.calibration is None else contents.calibration.balance
    mass = rigid_mass_from(file, contents.mass) if contents.mass else None
    try:
        dynamics = CoupledDynamics(
            names, matrices["inertia"], matrices["damping"], covariance, mass, of_calibration, balance
        )
    except np.linalg.LinAlgError:
        raise ReadError(file, "inertia.matrix", "cannot be inverted: some load would move no mass") from None
    except ValueError as error:
        raise ReadError(file, "", str(error)) from None
    _check_modes(file, contents.modes, dynamics)
    return dynamics


def _covariances(file: Path, contents: _CoupledFile, deviations: Mapping[str, float]) -> tuple[Array, Array]:
    """Covariance that the readings leave, and that of the calibration, whose sum has the uncertainties of the file."""
    if contents.calibration is None:
        covariance = checked_covariance(file, "covariance", contents.covariance, deviations)
        return covariance, np.zeros_like(covariance)
    given = {"covariance": contents.covariance, "calibration.covariance": contents.calibration.covariance}
    found = []
    for where, part in given.items():
        if part is None:  # no rounded difference of uncertainties can stand for it
            raise ReadError(file, where, "is needed beside calibration, as u holds both")
        diagonal = [abs(row[place]) ** 0.5 if place < len(row) else 0.0 for place, row in enumerate(part.matrix)]
        own = dict(zip(part.parameters, diagonal, strict=False))
        found.append(checked_covariance(file, where, part, {name: own.get(name, 0.0) for name in deviations}))
    u = np.sqrt(np.diag(found[0] + found[1]))
    for name, both, stated in zip(deviations, u, deviations.values(), strict=True):
        if abs(both - stated) > 1e-6 * max(both, stated):
            raise ReadError(
                file,
                "calibration.covariance.matrix",
                f"has with covariance.matrix the standard uncertainty {both:.6g} for {name}, but {name}.u is "
                f"{stated:.6g}; they must agree",
            )
    return found[0], found[1]


def _read_matrix(path: Path, kind: Matrix, given: _Matrix, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Matrix and standard uncertainties, both of shape (n, n)."""
    for side in ("rows", "columns"):
        found = getattr(given, side)
        if found is not None and tuple(found) != names:
            raise ReadError(
                path, f"{kind}.{side}", f"are {', '.join(found)}, but must be {', '.join(names)}, in this order"
            )
    n = len(names)
    expected = matrix_units(names, kind)
    if given.units is not None and given.units != expected:
        raise ReadError(path, f"{kind}.units", f"must be {expected} (artefacts are in SI units)")
    for name, table in (("matrix", given.matrix), ("u", given.u)):
        if table is not None and [len(row) for row in table] != [n] * n:
            raise ReadError(
                path, f"{kind}.{name}", f"must have {n} rows of {n} numbers, one for each of {', '.join(names)}"
            )
    u = np.zeros((n, n)) if given.u is None else np.array(given.u, dtype=np.float64)
    return np.array(given.matrix, dtype=np.float64), u


def rigid_mass_from(path: Path, given: RigidMassPart) -> RigidMass:
    """The rigid mass of a file.

    Raises
    ------
    ReadError
        A unit is not the one inside, or the covariance contradicts the uncertainties.
    """
    entries: dict[str, Value] = {"mass": given.mass}
    entries |= {f"centre.{axis}": getattr(given.centre, axis) for axis in AXES}
    entries |= {f"inertia.{axes}": getattr(given.inertia, axes) for axes in _INERTIA}
    for name, entry in entries.items():
        unit = "kg" if name == "mass" else "m" if name.startswith("centre") else "kg*m^2"
        check_unit(path, f"mass.{name}.unit", entry, unit)
    deviations = {name: entry.u for name, entry in entries.items()}
    inertia = np.zeros((3, 3))
    for axes, (i, j) in _INERTIA.items():
        inertia[i, j] = inertia[j, i] = entries[f"inertia.{axes}"].value
    return RigidMass(
        given.mass.value,
        np.array([entries[f"centre.{axis}"].value for axis in AXES]),
        inertia,
        checked_covariance(path, "mass.covariance", given.covariance, deviations),
    )


def _check_modes(path: Path, given: Sequence[ListedMode], dynamics: CoupledDynamics) -> None:
    """Refuse modes that contradict the matrices: one or the other was altered by mistake."""
    if not given:
        return
    modes = dynamics.modes
    if len(given) != len(modes):
        raise ReadError(path, "modes", f"are {len(given)}, but the matrices have {len(modes)}; leave modes out")
    words = "the matrices give", "correct what is wrong, or leave modes out"
    for number, (stated, own) in enumerate(zip(given, modes, strict=True)):
        check_mode(path, f"modes[{number}]", stated, own, words=words)


def dynamics_kind(path: Path | str) -> Kind | None:
    """Say whether a dynamics.json holds components each for itself (``"axial"``) or coupled ones; None if neither.

    Its kind says it, or, in a file by hand, its keys.
    """
    try:
        given = json.loads(Path(path).read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(given, dict):
        return None
    if "kind" in given:
        kinds: dict[object, Kind] = {KIND: "coupled", "dynamics": "axial"}
        return kinds.get(given["kind"]) if isinstance(given["kind"], str) else None
    if "inertia" in given or isinstance(given.get("components"), list):
        return "coupled"
    return "axial" if isinstance(given.get("components"), dict) else None


def read_any_dynamics(path: Path | str) -> dict[str, Dynamics] | CoupledDynamics:
    """Read a dynamics.json of either kind: components each for itself by name, or coupled ones.

    Raises
    ------
    ReadError
        As `read_dynamics` and `read_coupled`.
    """
    return read_coupled(path) if dynamics_kind(path) == "coupled" else read_dynamics(path)
