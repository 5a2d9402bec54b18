"""A stiffness matrix of a balance, and a rigid mass written by hand: what dynamics follow from without a recording."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.io import artefacts
from aerobalance.io.artefacts import Finite, NotNegative
from aerobalance.io.messages import first_fault
from aerobalance.io.opening import opened_file
from aerobalance.io.rigid_mass_part import RigidMassPart, rigid_mass_from
from aerobalance.io.toml_file import read_toml
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import ReadError, warn_quality

DOUBTFUL: Final = 5.0
"""Difference of two elements that should be equal, in standard uncertainties, from which it is warned of."""

ASYMMETRIC: Final = 0.01
"""The same over the stiffness of the two components, where no uncertainty is given."""


class _StiffnessTable(artefacts.Loose):
    rows: list[str] = Field(default_factory=lambda: list(COMPONENTS))
    columns: list[str] = Field(default_factory=lambda: list(COMPONENTS))
    matrix: list[list[Finite]]
    u: list[list[NotNegative]] | None = None


class _StiffnessFile(artefacts.Loose):
    kind: Literal["stiffness"] = "stiffness"
    stiffness: _StiffnessTable


def read_stiffness(path: Path | str) -> tuple[Array, Array]:
    """Read a stiffness matrix, load over displacement and turn of the balance's centre.

    As JSON ``{"stiffness": {"matrix": [[...], ...], "u": [[...], ...]}}``, with ``rows`` and ``columns`` where they
    are not in the order of `COMPONENTS`. As CSV a header with the six components, each row beginning with its load,
    and below, in rows that begin with ``u NF`` and so on, the standard uncertainties where they are known.

    Returns
    -------
    stiffness, u
        Symmetric, in the order of `COMPONENTS`, shape (6, 6) each [N/m, N, N*m]. Elements that should be equal are
        averaged.

    Raises
    ------
    ReadError
        The file holds no such matrix.
    """
    file = Path(path)
    rows, columns, matrix, u = _of_json(file) if file.suffix.lower() == ".json" else _of_csv(file)
    for side, names in (("rows", rows), ("columns", columns)):
        if sorted(names) != sorted(COMPONENTS):
            raise ReadError(file, side, f"must be {', '.join(COMPONENTS)}, not {', '.join(names) or 'none'}")
    order = np.ix_([rows.index(name) for name in COMPONENTS], [columns.index(name) for name in COMPONENTS])
    stiffness, u_stiffness = matrix[order], u[order]
    mean = (stiffness + stiffness.T) / 2
    _warn_of_asymmetry(file, stiffness, u_stiffness)
    if np.linalg.eigvalsh(mean)[0] <= 0:
        raise ReadError(file, "matrix", "is not positive: some load would move the balance against itself")
    own = np.diag(np.diag(u_stiffness))
    return mean, np.asarray(np.hypot(u_stiffness, u_stiffness.T) / 2 * (1 - np.eye(6)) + own)


def _warn_of_asymmetry(file: Path, stiffness: Array, u: Array) -> None:
    size = np.sqrt(np.abs(np.outer(np.diag(stiffness), np.diag(stiffness))))
    allowed = np.where(u + u.T > 0, DOUBTFUL * np.hypot(u, u.T), ASYMMETRIC * size)
    over = np.abs(stiffness - stiffness.T) / np.where(allowed > 0, allowed, np.inf)
    row, column = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[row, column] > 1:
        first, second = COMPONENTS[row], COMPONENTS[column]
        warn_quality(
            f"{file}: the stiffness is not symmetric: {first}/{second} is {stiffness[row, column]:.5g} and "
            f"{second}/{first} {stiffness[column, row]:.5g}; their mean is taken, which may be as wrong"
        )


def _of_json(file: Path) -> tuple[list[str], list[str], Array, Array]:
    given = artefacts.load(file, "stiffness", _StiffnessFile).stiffness
    tables = [given.matrix] if given.u is None else [given.matrix, given.u]
    for name, table in zip(("matrix", "u"), tables, strict=False):
        if [len(row) for row in table] != [len(COMPONENTS)] * len(COMPONENTS):
            raise ReadError(file, f"stiffness.{name}", "must have 6 rows of 6 numbers, one for each component")
    arrays = [np.array(table, dtype=np.float64) for table in tables]
    return given.rows, given.columns, arrays[0], arrays[1] if len(arrays) > 1 else np.zeros((6, 6))


def _of_csv(file: Path) -> tuple[list[str], list[str], Array, Array]:
    with opened_file(file) as stream:
        content = stream.read()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReadError(file, "", f"is no text in UTF-8: {error}") from None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"]
    if not lines:
        raise ReadError(file, "", "is empty; a header with the six components and a row for each are needed")
    separator = ";" if ";" in lines[0][1] else ","
    header, *body = [[cell.strip() for cell in row] for row in csv.reader([t for _, t in lines], delimiter=separator)]
    values: dict[str, list[float]] = {}
    for (line, _), cells in zip(lines[1:], body, strict=True):
        try:
            values[cells[0]] = [float(cell.replace(",", ".") if separator == ";" else cell) for cell in cells[1:]]
        except ValueError:
            raise ReadError(file, f"line {line}", "holds a cell that is no number") from None
        if len(cells) != len(header) or not np.isfinite(values[cells[0]]).all():
            raise ReadError(file, f"line {line}", f"must have a name and {len(header) - 1} finite numbers")
    rows = [name for name in values if not name.startswith("u ")]
    doubted = [values.get(f"u {name}") for name in rows]
    if any(doubted) and not all(doubted):
        raise ReadError(file, "", "has standard uncertainties ('u NF' and so on) for some rows; all six need them")
    matrix = np.array([values[name] for name in rows], dtype=np.float64).reshape(len(rows), -1)
    u = np.array(doubted, dtype=np.float64) if all(doubted) else np.zeros(matrix.shape)
    if (u < 0).any():
        raise ReadError(file, "", "has a standard uncertainty below zero")
    return rows, header[1:], matrix, u


def read_rigid_mass(path: Path | str) -> RigidMass:
    """Read mass, centre of gravity and moments of inertia about it, as TOML or JSON by hand or in a dynamics.json.

    ``mass = {value = 20.1, u = 0.01}``, and tables ``centre`` (aft, right, up) and ``inertia`` (aa, rr, uu, and ar,
    au, ru where they are not zero) of such values, in kg, m and kg*m^2; a bare number has no uncertainty. The matrix
    ``covariance`` may be given with the names of its rows.

    Raises
    ------
    ReadError
        The file holds no such mass.
    """
    file = Path(path)
    given = read_toml(file, what="a description of a rigid mass") if file.suffix.lower() == ".toml" else _json(file)
    if isinstance(given.get("mass"), dict) and "mass" in given["mass"]:
        given = given["mass"]
    if "inertia" not in given or "centre" not in given:
        weighed = "; a weighing tells mass and centre of gravity only" if "components" in given else ""
        raise ReadError(
            file,
            "centre" if "inertia" in given else "inertia",
            f"is missing{weighed}: mass, centre and inertia are needed, each a number or {{value, u}}",
        )
    try:
        part = RigidMassPart.model_validate(_with_values(given))
    except ValidationError as error:
        raise ReadError(file, *first_fault(error, RigidMassPart)) from None
    try:
        return rigid_mass_from(file, part)
    except ValueError as error:
        raise ReadError(file, "", str(error)) from None


def _json(file: Path) -> dict[str, Any]:
    with opened_file(file) as stream:
        content = stream.read()
    try:
        given = json.loads(content.decode("utf-8-sig"))
    except ValueError as error:
        raise ReadError(file, "", f"is no JSON: {error}") from None
    if not isinstance(given, dict):
        raise ReadError(file, "", "must be a JSON object with mass, centre and inertia")
    return given


def _with_values(given: dict[str, Any]) -> dict[str, Any]:
    """The same with bare numbers as values of no uncertainty."""

    def value(item: object) -> object:
        return {"value": float(item)} if isinstance(item, int | float) and not isinstance(item, bool) else item

    found = dict(given)
    found["mass"] = value(given.get("mass"))
    for name in ("centre", "inertia"):
        if isinstance(given[name], dict):
            found[name] = {key: value(item) for key, item in given[name].items()}
    return found
