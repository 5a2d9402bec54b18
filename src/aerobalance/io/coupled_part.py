"""What dynamics.json says of coupled components: their names, and matrices with named rows and columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from aerobalance.dynamics.coupled import CoupledDynamics, internal_names
from aerobalance.dynamics.modal import Mode
from aerobalance.io.artefacts import (
    IN_EVERY_FILE,
    Covariance,
    Finite,
    Loose,
    NotNegative,
    Positive,
    checked_covariance,
)
from aerobalance.io.rigid_mass_part import RigidMassPart, rigid_mass_from, rigid_mass_payload
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import ReadError

FREQUENCY_AGREEMENT: Final = 0.01
"""Relative difference up to which a natural frequency in dynamics.json may be a rounded one."""

FORMER: Final = "coupled dynamics"
"""Kind that files of coupled components had in earlier versions."""

Matrix = Literal["inertia", "damping"]

_TIMES: Final[Mapping[Matrix, str]] = {"inertia": "s^2", "damping": "s"}


class ListedMode(Loose):
    """What every dynamics.json says of a mode."""

    for_people = frozenset({"units"})

    natural_frequency: Positive
    u_natural_frequency: NotNegative = 0.0
    damping_ratio: Finite
    u_damping_ratio: NotNegative = 0.0


class _Matrix(Loose):
    rows: list[str] | None = None
    columns: list[str] | None = None
    units: list[list[str]] | None = None
    matrix: list[list[Finite]]
    u: list[list[NotNegative]] | None = None


class _Calibration(Loose):
    balance: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")] = ""
    covariance: Covariance


class CoupledFile(Loose):
    """Coupled components; files of earlier versions call their kind coupled dynamics."""

    for_people = IN_EVERY_FILE | {"fit"}

    kind: Literal["dynamics", "coupled dynamics"] = "dynamics"
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
    """Return what dynamics.json says of coupled components, as plain data.

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
        payload["mass"] = rigid_mass_payload(dynamics.mass)
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
    modes = dynamics.modes
    return [
        {
            "natural_frequency": mode.natural_frequency,
            "u_natural_frequency": u_frequency,
            "damping_ratio": mode.damping_ratio,
            "u_damping_ratio": u_ratio,
            "units": {"natural_frequency": "Hz", "damping_ratio": "1"},
        }
        for mode, (u_frequency, u_ratio) in zip(modes, modes.uncertainties.tolist(), strict=True)
    ]


def coupled_from(file: Path, contents: CoupledFile) -> CoupledDynamics:
    """Return the coupled dynamics that a file holds, checked against each other.

    Raises
    ------
    ReadError
        Its numbers are not physical; the message names the key and what is allowed.
    """
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
    _check_coupled_modes(file, contents.modes, dynamics)
    return dynamics


def _covariances(file: Path, contents: CoupledFile, deviations: Mapping[str, float]) -> tuple[Array, Array]:
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


def _check_coupled_modes(path: Path, given: Sequence[ListedMode], dynamics: CoupledDynamics) -> None:
    """Refuse modes that contradict the matrices: one or the other was altered by mistake."""
    if not given:
        return
    modes = dynamics.modes
    if len(given) != len(modes):
        raise ReadError(path, "modes", f"are {len(given)}, but the matrices have {len(modes)}; leave modes out")
    words = "the matrices give", "correct what is wrong, or leave modes out"
    for number, (stated, own) in enumerate(zip(given, modes, strict=True)):
        check_mode(path, f"modes[{number}]", stated, own, words=words)


def check_mode(path: Path, key: str, given: ListedMode, own: Mode, *, words: tuple[str, str]) -> None:
    """Refuse a mode that is not what the rest of the file gives; the words say what gives it, and what to do.

    Raises
    ------
    ReadError
        With the key.
    """
    for name in ("natural_frequency", "damping_ratio"):
        found, allowed = getattr(given, name), getattr(own, name)
        if abs(found - allowed) > FREQUENCY_AGREEMENT * allowed:
            raise ReadError(path, f"{key}.{name}", f"is {found:g}, but {words[0]} {allowed:g}; {words[1]}")
