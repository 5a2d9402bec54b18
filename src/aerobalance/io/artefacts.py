"""The JSON artefacts: dynamics.json and mass.json, with covariance and provenance."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NoReturn, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from aerobalance import __version__
from aerobalance.components import COMPONENTS, STANDARD_GRAVITY, mass_unit, si_unit
from aerobalance.dynamics import MODE_PARAMETERS, PARAMETERS, Dynamics, Mode
from aerobalance.io.messages import first_fault
from aerobalance.io.safe_write import replacing
from aerobalance.problems import ReadError
from aerobalance.recording import Array
from aerobalance.weighing import AXES, MovingMass

SCHEMA: Final = 1
"""Version of the structure of the artefacts."""

FREQUENCY_AGREEMENT: Final = 0.01
"""Relative difference up to which a natural frequency in dynamics.json may be a rounded one."""

SHARE_AGREEMENT: Final = 1e-6
"""Departure from 1 of the sum of the shares of the modes that rounding in a file may make."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Model = TypeVar("_Model", bound=BaseModel)


class Loose(BaseModel):
    """Part of an artefact; keys that are not known are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)


class Value(Loose):
    """A number with its standard uncertainty and unit."""

    value: Finite
    u: NotNegative = 0.0
    unit: str | None = None


class PositiveValue(Value):
    """A number above zero."""

    value: Positive


class NotNegativeValue(Value):
    """A number of zero or more."""

    value: NotNegative


class Covariance(Loose):
    """A covariance matrix with the names of its rows."""

    parameters: list[str]
    matrix: list[list[Finite]]


class _Mode(Loose):
    natural_frequency: Positive
    u_natural_frequency: NotNegative = 0.0
    damping_ratio: NotNegative
    u_damping_ratio: NotNegative = 0.0
    share: Finite
    u_share: NotNegative = 0.0


class _ComponentDynamics(Loose):
    mass: PositiveValue
    stiffness: PositiveValue
    damping: NotNegativeValue
    delay: Value = Value(value=0.0)
    natural_frequency: PositiveValue | None = None
    modes: list[_Mode] = []
    covariance: Covariance | None = None


class _ComponentMass(Loose):
    mass: PositiveValue
    offset: Value = Value(value=0.0)
    misalignment: dict[str, Value] = {}
    covariance: Covariance | None = None
    residuals: list[Finite] = []
    degrees_of_freedom: Annotated[int, Field(ge=0)] = 0
    gravity: PositiveValue = PositiveValue(value=STANDARD_GRAVITY)


class _DynamicsFile(Loose):
    kind: Literal["dynamics"] = "dynamics"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    components: Annotated[dict[str, _ComponentDynamics], Field(min_length=1)]


class MassFile(Loose):
    """What every mass.json holds."""

    kind: Literal["mass"] = "mass"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    components: Annotated[dict[str, _ComponentMass], Field(min_length=1)]


def dynamics_units(component: str) -> dict[str, str]:
    """Units of the parameters in dynamics.json."""
    return {
        "mass": mass_unit(component),
        "stiffness": "N/m",
        "damping": "N*s/m",
        "natural_frequency": "Hz",
        "damping_ratio": "1",
        "delay": "s",
    }


def dynamics_payload(dynamics: Dynamics, *, details: Mapping[str, object] | None = None) -> dict[str, object]:
    """Give the entry of one component in dynamics.json, as plain data.

    Parameters
    ----------
    dynamics
        Dynamics of the component.
    details
        How the fit went; written under ``fit``.
    """
    entry: dict[str, object] = {}
    for name, unit in dynamics_units(dynamics.component).items():
        value, u = float(getattr(dynamics, name)), dynamics.uncertainty(name)
        if name != "delay" or value or u:
            entry[name] = {"value": value, "u": u, "unit": unit}
    if dynamics.further_modes:
        entry["modes"] = [_mode_payload(dynamics, number) for number in range(1, 1 + len(dynamics.modes))]
    entry["covariance"] = {"parameters": list(dynamics.parameters), "matrix": dynamics.covariance.tolist()}
    if details:
        entry["fit"] = dict(details)
    return entry


def _mode_payload(dynamics: Dynamics, number: int) -> dict[str, object]:
    """One mode: its numbers, each with its standard uncertainty; its share is that of a steady load."""
    mode, suffix = dynamics.modes[number - 1], "" if number == 1 else f"_{number}"
    entry: dict[str, object] = {}
    for name in MODE_PARAMETERS:
        entry[name] = float(getattr(mode, name))
        entry[f"u_{name}"] = dynamics.uncertainty(name + suffix)
    return {**entry, "units": {"natural_frequency": "Hz", "damping_ratio": "1", "share": "1"}}


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


def write_dynamics(
    path: Path | str,
    dynamics: Mapping[str, Dynamics],
    *,
    details: Mapping[str, Mapping[str, object]] | None = None,
    inputs: Sequence[Path] = (),
    settings: Mapping[str, object] | None = None,
    warnings: Sequence[str] = (),
) -> None:
    """Write dynamics.json.

    Parameters
    ----------
    path
        The file.
    dynamics
        Dynamics by component.
    details
        How each fit went, by component.
    inputs
        Files the result was computed from; their SHA-256 is noted.
    settings
        Settings of the computation.
    warnings
        What was warned about.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    components = {name: dynamics_payload(item, details=(details or {}).get(name)) for name, item in dynamics.items()}
    _write_artefact(path, "dynamics", components, inputs=inputs, settings=settings, warnings=warnings)


def write_mass(
    path: Path | str,
    masses: Mapping[str, MovingMass],
    *,
    inputs: Sequence[Path] = (),
    settings: Mapping[str, object] | None = None,
    warnings: Sequence[str] = (),
) -> None:
    """Write mass.json; the arguments are those of `write_dynamics`.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    components = {name: mass_payload(item) for name, item in masses.items()}
    _write_artefact(path, "mass", components, inputs=inputs, settings=settings, warnings=warnings)


def _write_artefact(
    path: Path | str,
    kind: str,
    components: Mapping[str, object],
    *,
    inputs: Sequence[Path],
    settings: Mapping[str, object] | None,
    warnings: Sequence[str],
) -> None:
    payload = {
        "kind": kind,
        "schema": SCHEMA,
        "components": components,
        "warnings": list(warnings),
        "provenance": provenance(inputs, settings=settings),
    }
    write_json(path, payload)


def provenance(inputs: Sequence[Path], *, settings: Mapping[str, object] | None = None) -> dict[str, object]:
    """Say what a result was computed from, by which program, with which settings, and when (UTC).

    Files are named without their folders, so that the same inputs give the same text on every machine.
    """
    return {
        "program": f"aerobalance {__version__}",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": [{"name": Path(file).name, "sha256": _digest(Path(file))} for file in inputs],
        "settings": dict(settings or {}),
    }


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ReadError(path, "", f"cannot be read: {error.strerror or error}") from None


def write_json(path: Path | str, payload: Mapping[str, object]) -> None:
    """Write JSON whole or not at all; numbers that are not finite become null.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    with replacing(path) as beside:
        beside.write_text(json_text(payload), encoding="utf-8")


def json_text(payload: Mapping[str, object]) -> str:
    """Give the text of a JSON object: keys in the order given, numbers that are not finite as null."""
    return json.dumps(_plain(payload), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(item: object) -> object:
    """Turn arrays, numpy numbers, paths and what is not finite into plain data."""
    if isinstance(item, Mapping):
        return {str(key): _plain(value) for key, value in item.items()}
    if isinstance(item, (list, tuple, np.ndarray)):
        return [_plain(value) for value in item]
    if isinstance(item, np.generic):
        return _plain(item.item())
    if isinstance(item, Path):
        return item.name
    if isinstance(item, float):
        return item if np.isfinite(item) else None
    if item is None or isinstance(item, (str, int, bool)):
        return item
    raise ValueError(f"cannot write a {type(item).__name__} as JSON")


def read_dynamics(path: Path | str) -> dict[str, Dynamics]:
    """Read dynamics.json, as written by `write_dynamics` or by hand.

    By hand ``components.AF.{mass,stiffness,damping}.value`` is enough; ``u`` is 0 where left out.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical; the message names the key and what is allowed.
    """
    file = Path(path)
    contents = load(file, "dynamics", _DynamicsFile)
    result = {}
    for name, entry in contents.components.items():
        key = f"components.{name}"
        if name not in COMPONENTS:
            raise ReadError(file, key, f"is no component; allowed: {', '.join(COMPONENTS)}")
        units = dynamics_units(name)
        given = {parameter: getattr(entry, parameter) for parameter in PARAMETERS}
        for parameter, value in given.items():
            check_unit(file, f"{key}.{parameter}.unit", value, units[parameter])
        deviations = {parameter: value.u for parameter, value in given.items()}
        for number, mode in enumerate(entry.modes[1:], start=2):
            deviations |= {f"{item}_{number}": getattr(mode, f"u_{item}") for item in MODE_PARAMETERS}
        covariance = checked_covariance(file, f"{key}.covariance", entry.covariance, deviations)
        try:
            result[name] = Dynamics(
                component=name,
                mass=entry.mass.value,
                stiffness=entry.stiffness.value,
                damping=entry.damping.value,
                delay=entry.delay.value,
                covariance=covariance,
                further_modes=tuple(
                    Mode(mode.natural_frequency, mode.damping_ratio, mode.share) for mode in entry.modes[1:]
                ),
            )
        except ValueError as error:
            raise ReadError(file, key, str(error)) from None
        _check_frequency(file, key, entry, result[name])
        _check_modes(file, key, entry.modes, result[name])
    return result


def _check_modes(path: Path, key: str, modes: Sequence[_Mode], dynamics: Dynamics) -> None:
    """Refuse modes whose first is not that of mass and stiffness, or whose shares do not add to 1."""
    if not modes:
        return
    first, own = modes[0], dynamics.modes[0]
    for name, allowed in (("natural_frequency", own.natural_frequency), ("damping_ratio", own.damping_ratio)):
        if abs(getattr(first, name) - allowed) > FREQUENCY_AGREEMENT * allowed:
            raise ReadError(
                path,
                f"{key}.modes[0].{name}",
                f"is {getattr(first, name):g}, but mass, stiffness and damping give {allowed:g}; the first mode is "
                "theirs",
            )
    if abs(first.share - own.share) > SHARE_AGREEMENT:
        raise ReadError(
            path, f"{key}.modes", f"have shares that add to {sum(mode.share for mode in modes):g}; they must add to 1"
        )


def _check_frequency(path: Path, key: str, entry: _ComponentDynamics, dynamics: Dynamics) -> None:
    """Refuse a natural frequency that contradicts mass and stiffness: one of the three was altered by mistake."""
    given = entry.natural_frequency
    if given is not None and abs(given.value / dynamics.natural_frequency - 1) > FREQUENCY_AGREEMENT:
        raise ReadError(
            path,
            f"{key}.natural_frequency.value",
            f"is {given.value:g} Hz, but mass and stiffness give {dynamics.natural_frequency:g} Hz; "
            "correct the one that is wrong, or leave natural_frequency out",
        )


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
    for name, entry in contents.components.items():
        key = f"components.{name}"
        if name not in AXES:
            raise ReadError(file, key, f"is no component that can be weighed; allowed: {', '.join(AXES)}")
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


_JSON_NAMES: Final = {list: "an array", str: "a string", int: "a number", float: "a number", bool: "true or false"}


def load(path: Path, kind: str, model: type[_Model]) -> _Model:
    """Read and check a JSON file.

    Raises
    ------
    ReadError
        The file is no such JSON.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise ReadError(path, "", "there is no such file") from None
    except OSError as error:
        raise ReadError(path, "", f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ReadError(path, "", f"is no JSON text; a {kind}.json is needed") from None
    if not text.strip():
        raise ReadError(path, "", f"is empty; a {kind}.json is needed")

    def refuse(word: str) -> NoReturn:
        raise ReadError(path, "", f"holds {word}, which is no number in JSON; finite numbers are needed")

    try:
        given: Any = json.loads(text, parse_constant=refuse)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise ReadError(path, where, f"is broken or cut off JSON: {error.msg}; a {kind}.json is needed") from None
    except RecursionError:
        raise ReadError(path, "", f"is nested too deeply; a {kind}.json is needed") from None
    if not isinstance(given, dict):
        raise ReadError(
            path, "", f"holds {_JSON_NAMES.get(type(given), 'null')}, not an object; a {kind}.json is needed"
        )
    if "kind" in given and given["kind"] != kind:
        raise ReadError(path, "kind", f"is {given['kind']!r}, but a file of kind {kind!r} is needed")
    if "schema" in given and (given["schema"] != SCHEMA or isinstance(given["schema"], bool)):
        raise ReadError(path, "schema", f"is {given['schema']!r}; this program reads schema {SCHEMA}")
    try:
        return model.model_validate(given)
    except ValidationError as error:
        where, what = first_fault(error, model)
        raise ReadError(path, where, what) from None


def check_unit(path: Path, where: str, value: Value, unit: str) -> None:
    """Refuse a unit other than the one inside.

    Raises
    ------
    ReadError
        With the key.
    """
    if value.unit is not None and value.unit != unit:
        raise ReadError(path, where, f"is {value.unit!r}; allowed: {unit!r} (artefacts are in SI units)")


def checked_covariance(path: Path, where: str, given: Covariance | None, deviations: Mapping[str, float]) -> Array:
    """Put a covariance in the order of the parameters; without one, the uncertainties are uncorrelated.

    Raises
    ------
    ReadError
        It is no covariance, or contradicts the uncertainties.
    """
    names = list(deviations)
    if given is None:
        return np.diag(np.array(list(deviations.values())) ** 2)
    if len(set(given.parameters)) != len(given.parameters) or not set(given.parameters) <= set(names):
        raise ReadError(path, f"{where}.parameters", f"must name some of {', '.join(names)}, each once")
    size = len(given.parameters)
    if [len(row) for row in given.matrix] != [size] * size:
        raise ReadError(path, f"{where}.matrix", f"must have {size} rows of {size} numbers, one for each parameter")
    matrix = np.array(given.matrix, dtype=np.float64).reshape(size, size)
    variances = np.diag(matrix)
    if (variances < 0).any():
        raise ReadError(path, f"{where}.matrix", "has a negative variance; variances of zero or more are needed")
    scale = np.outer(np.sqrt(variances), np.sqrt(variances))
    if (np.abs(matrix - matrix.T) > 1e-9 * scale).any():
        raise ReadError(path, f"{where}.matrix", "is not symmetric")
    correlation = np.divide(matrix, scale, out=np.zeros_like(matrix), where=scale > 0)
    if (np.abs(matrix[scale == 0]) > 0).any() or (size and np.linalg.eigvalsh(correlation)[0] < -1e-6):
        raise ReadError(
            path, f"{where}.matrix", "is no covariance: a combination of parameters has a negative variance"
        )
    for name, variance in zip(given.parameters, variances, strict=True):
        if abs(np.sqrt(variance) - deviations[name]) > 1e-6 * max(np.sqrt(variance), deviations[name]):
            raise ReadError(
                path,
                f"{where}.matrix",
                f"has the standard uncertainty {np.sqrt(variance):.6g} for {name}, but {name}.u is "
                f"{deviations[name]:.6g}; they must agree (or leave the covariance out)",
            )
    full = np.zeros((len(names), len(names)))
    index = [names.index(name) for name in given.parameters]
    full[np.ix_(index, index)] = matrix
    return full
