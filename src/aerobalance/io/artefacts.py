"""Artefacts: the JSON files that hold a result for later use, such as dynamics.json, mass.json and balance.json.

Here is what all of them share: numbers with standard uncertainty and unit, covariance matrices, provenance (from which
files, with which settings, by which version), reading with checks, and writing. What each of them holds is in the
module of its name, such as `dynamics_file`; docs/formats.md lists the keys.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, NoReturn, TypedDict, TypeVar, Unpack

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from aerobalance.io.messages import first_fault
from aerobalance.io.opening import opened_file
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError
from aerobalance.recording.version import VERSION

BY_HAND: Final = "by hand"
"""Key in the context of pydantic's validation; its value says whether a person wrote the file."""

SCHEMA: Final = 1
"""Version of the structure of the artefacts."""

_ASYMMETRY: Final = 1e-9
"""Difference of opposite elements of a covariance, over the product of the standard deviations, up to which it counts
as symmetric [1]: rounding to ten digits."""

_NOT_NEGATIVE: Final = -1e-6
"""Least eigenvalue with which a correlation matrix counts as positive semidefinite [1]: rounding to six digits."""

_SAME_DEVIATION: Final = 1e-6
"""Relative difference up to which a standard uncertainty agrees with its variance [1]: rounding to six digits."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Model = TypeVar("_Model", bound=BaseModel)
_Entry = TypeVar("_Entry")


class Loose(BaseModel):
    """Part of an artefact, with types checked strictly, and loose in one thing: keys that it does not know.

    An unknown key is passed over where this program wrote the file, since a later version may have added it, and
    refused where a person did, since it may be a typing error that would leave a setting without effect.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    for_people: ClassVar[frozenset[str]] = frozenset()
    """Keys for people to read: the program writes them and does not read them, and they may stand in any file."""

    @model_validator(mode="before")
    @classmethod
    def _without_unknown_keys(cls, given: Any, info: ValidationInfo) -> Any:
        """Leave out what may be passed over; what is left and unknown is refused by ``extra="forbid"``."""
        if not isinstance(given, dict):
            return given
        known = {field.alias or name for name, field in cls.model_fields.items()}
        if (info.context or {}).get(BY_HAND):
            return {key: value for key, value in given.items() if key in known or key not in cls.for_people}
        return {key: value for key, value in given.items() if key in known}


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
    """A covariance matrix with the names of its rows, in the units of the parameters."""

    parameters: list[str]
    matrix: list[list[Finite]]


class Origin(TypedDict, total=False):
    """What a result was computed from.

    Attributes
    ----------
    inputs
        Files; their SHA-256 is noted.
    settings
        Settings of the computation.
    warnings
        What was warned about.
    """

    inputs: Sequence[Path]
    settings: Mapping[str, object] | None
    warnings: Sequence[str]


def write_artefact(
    path: Path | str,
    kind: str,
    contents: Mapping[str, object],
    **origin: Unpack[Origin],
) -> None:
    """Write an artefact whole or not at all.

    Parameters
    ----------
    path
        The file.
    kind
        What it holds: dynamics, mass or balance.
    contents
        Its own keys, as plain data.
    origin
        What it was computed from.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    payload = {
        "kind": kind,
        "schema": SCHEMA,
        **contents,
        "warnings": list(origin.get("warnings", ())),
        "provenance": provenance(origin.get("inputs", ()), settings=origin.get("settings")),
    }
    write_json(path, payload)


def provenance(inputs: Sequence[Path], *, settings: Mapping[str, object] | None = None) -> dict[str, object]:
    """Return what a result was computed from, by which program, with which settings, and when (UTC).

    Files are named without their folders, so that the same inputs give the same text on every machine.
    """
    return {
        "program": f"aerobalance {VERSION}",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": [{"name": Path(file).name, "sha256": digest(Path(file))} for file in inputs],
        "settings": dict(settings or {}),
    }


def digest(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal text; of a folder, that of the names and digests of its files.

    Raises
    ------
    ReadError
        It cannot be read.
    """
    if path.is_dir():
        files = sorted(one for one in path.rglob("*") if one.is_file())
        lines = [f"{one.relative_to(path).as_posix()} {digest(one)}\n" for one in files]
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    with opened_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
    """Return the text of a JSON object: keys in the order given, numbers that are not finite as null."""
    return json.dumps(_plain(payload), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(item: object) -> object:
    """Return what JSON can hold: arrays as lists, paths as names, numbers that are not finite as None."""
    if isinstance(item, Mapping):
        return {str(key): _plain(value) for key, value in item.items()}
    if isinstance(item, (list, tuple)):
        return [_plain(value) for value in item]
    if isinstance(item, (np.ndarray, np.generic)):
        return _plain(item.tolist())
    if isinstance(item, Path):
        return item.name
    if isinstance(item, float):
        return item + 0.0 if isfinite(item) else None  # no minus before a zero
    if item is None or isinstance(item, (str, int, bool)):
        return item
    raise ValueError(f"cannot write a {type(item).__name__} as JSON")


IN_EVERY_FILE: Final = frozenset({"schema", "warnings", "provenance", "description", "comment"})
"""Keys for people that every artefact may have; `for_people` of its parts adds their own."""

_JSON_NAMES: Final = {list: "an array", str: "a string", int: "a number", float: "a number", bool: "true or false"}


def load(path: Path, kind: str, model: type[_Model], *, former: str = "") -> _Model:
    """Return the checked contents of a JSON artefact.

    Parameters
    ----------
    path
        The file.
    kind
        What it has to hold, as its key ``kind`` says, where it has one.
    model
        The class that checks it.
    former
        What earlier versions called this kind; an empty string for no other name.

    Raises
    ------
    ReadError
        The file is no such JSON.
    """
    with opened_file(path) as file:
        content = file.read()
    try:
        text = content.decode("utf-8-sig")
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
    except ValueError:  # the interpreter converts no whole number of more than 4300 digits
        raise ReadError(path, "", f"holds a number of thousands of digits; a {kind}.json is needed") from None
    if not isinstance(given, dict):
        raise ReadError(
            path, "", f"holds {_JSON_NAMES.get(type(given), 'null')}, not an object; a {kind}.json is needed"
        )
    if "kind" in given and given["kind"] not in (kind, former):
        raise ReadError(path, "kind", f"is {given['kind']!r}, but a file of kind {kind!r} is needed")
    if "schema" in given and (given["schema"] != SCHEMA or isinstance(given["schema"], bool)):
        raise ReadError(path, "schema", f"is {given['schema']!r}; this program reads schema {SCHEMA}")
    try:
        return model.model_validate(given, context={BY_HAND: not _by_program(given)})
    except ValidationError as error:
        where, what = first_fault(error, model)
        raise ReadError(path, where, what) from None


def _by_program(given: Mapping[str, Any]) -> bool:
    """Whether this program wrote a file, in any version."""
    origin = given.get("provenance")
    return isinstance(origin, dict) and str(origin.get("program", "")).startswith("aerobalance ")


def entries_of(
    path: Path, components: Mapping[str, _Entry], allowed: Collection[str], *, what: str = "component"
) -> Iterator[tuple[str, str, _Entry]]:
    """Yield for each component of an artefact its name, its place in the file for messages, and what stands there.

    Raises
    ------
    ReadError
        A name is not among those allowed.
    """
    for name, entry in components.items():
        if name not in allowed:
            raise ReadError(path, f"components.{name}", f"is no {what}; allowed: {', '.join(allowed)}")
        yield name, f"components.{name}", entry


def check_unit(path: Path, where: str, value: Value, unit: str) -> None:
    """Refuse a unit other than the SI unit that the program works in; a value without a unit is taken to be in it.

    Raises
    ------
    ReadError
        The unit is another one; the message says at which key.
    """
    if value.unit is not None and value.unit != unit:
        raise ReadError(path, where, f"is {value.unit!r}; allowed: {unit!r} (artefacts are in SI units)")


def checked_covariance(path: Path, where: str, given: Covariance | None, deviations: Mapping[str, float]) -> Array:
    """Return the covariance matrix of parameters in the order of `deviations`, shape (p, p).

    Parameters that it does not name are uncorrelated with all others; without a covariance all are.

    Parameters
    ----------
    path, where
        The file and the key, for messages.
    given
        The covariance as the file has it.
    deviations
        Standard uncertainty of each parameter, by name.

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
    if (np.abs(matrix - matrix.T) > _ASYMMETRY * scale).any():
        raise ReadError(path, f"{where}.matrix", "is not symmetric")
    correlation = np.divide(matrix, scale, out=np.zeros_like(matrix), where=scale > 0)
    if (np.abs(matrix[scale == 0]) > 0).any() or (size and np.linalg.eigvalsh(correlation)[0] < _NOT_NEGATIVE):
        raise ReadError(
            path, f"{where}.matrix", "is no covariance: a combination of parameters has a negative variance"
        )
    for name, variance in zip(given.parameters, variances, strict=True):
        if abs(np.sqrt(variance) - deviations[name]) > _SAME_DEVIATION * max(np.sqrt(variance), deviations[name]):
            raise ReadError(
                path,
                f"{where}.matrix",
                f"has the standard uncertainty {np.sqrt(variance):.6g} for {name}, but {name}.u is "
                f"{deviations[name]:.6g}; they must agree (or leave the covariance out)",
            )
    full = np.diag(np.array(list(deviations.values())) ** 2)  # of those that the covariance does not name
    index = [names.index(name) for name in given.parameters]
    full[np.ix_(index, index)] = matrix
    return full
