"""Load schedules as plain text tables: a header ``NAME [unit]`` per load and ``rNAME [unit]`` per gauge output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.channel import Array
from aerobalance.io.columns import RawColumn, RawColumns
from aerobalance.io.load_columns import (
    Capacities,
    balance_type_of,
    load_conversion,
    ratio_outputs,
    settle_capacities,
)
from aerobalance.io.text_table import read_text_columns
from aerobalance.io.units import conversion
from aerobalance.problems import ReadError
from aerobalance.schedule import Schedule

NAME: Final = "plain table of loads and outputs"
"""What to call the format in messages."""

_MARKS: Final = ("series", "point", "confirmation", "natural_zero", "temperature", "excitation")


def read_table_schedule(path: Path, *, capacities: Capacities | None = None) -> Schedule:
    """Read a plain table: columns of loads ``N1 [lbf]`` and outputs ``rN1 [uV/V]``, one row a point.

    Further columns may be ``series``, ``point``, ``confirmation`` and ``natural_zero`` (0 or 1), ``temperature
    [degC]`` and ``excitation [V]``; with the latter the outputs may be in V. Rows of natural zeros need no loads.
    The capacity of a component is the largest load where `capacities` does not give it.

    Raises
    ------
    ReadError
        The file is no such table; the message says where and what is allowed.
    ValueError
        `capacities` does not fit the file's loads.
    """
    raw = read_text_columns(path)
    pairs = _pairs(raw)
    zero = _flags(raw, "natural_zero")
    notes: list[str] = []
    outputs = _outputs(raw, [pair.output for pair in pairs], notes=notes)
    loads, units, moments = _loads(raw, [pair.load for pair in pairs], points=~zero)
    names = tuple(pair.load.name for pair in pairs)
    series, series_names = _series(raw, ~zero, notes=notes)
    temperature = _temperature(raw, ~zero)
    stated = np.full(len(names), np.nan)
    table = settle_capacities(names, loads, moments=moments, stated=stated, given=capacities)
    return Schedule(
        name=path.name,
        components=names,
        gauges=tuple(pair.output.name[1:] for pair in pairs),
        loads=loads,
        outputs=outputs[~zero],
        series=series,
        series_names=series_names,
        points=_points(raw, ~zero),
        capacities=table.values,
        moments=np.array(moments, dtype=np.bool_),
        load_units=units,
        natural_zeros=outputs[zero],
        confirmation=_flags(raw, "confirmation")[~zero],
        temperature=temperature,
        balance_type=balance_type_of(names),
        assumptions=(*notes, *table.assumptions),
    )


@dataclass(frozen=True, slots=True)
class _Pair:
    """A load and the output of its bridge."""

    load: RawColumn
    output: RawColumn


def _pairs(raw: RawColumns) -> list[_Pair]:
    """Find the loads and the outputs that belong to them."""
    named: dict[str, RawColumn] = {}
    for column in raw.columns:
        if not column.label and not np.isfinite(column.values).any():
            continue  # the separator at the end of every line that some programs write
        if not column.name:
            raise ReadError(raw.path, f"header, {column.place}", "has no name; needed: NAME [unit]")
        if column.name in named:
            raise ReadError(
                raw.path,
                f"header, {column.place}",
                f"column {column.name} already stands at {named[column.name].place}",
            )
        named[column.name] = column
    rest = {name: column for name, column in named.items() if name.casefold() not in _MARKS}
    pairs = [_Pair(column, rest[f"r{name}"]) for name, column in rest.items() if f"r{name}" in rest]
    paired = {column.name for pair in pairs for column in (pair.load, pair.output)}
    for name, column in rest.items():
        if name not in paired:
            raise ReadError(
                raw.path,
                f"header, {column.place}",
                f"{name!r} is neither a load with an output r{name}, nor the output of a load that is there; columns "
                f"allowed beside NAME [lbf] and rNAME [uV/V]: {', '.join(_MARKS)}",
            )
    if not pairs:
        raise ReadError(
            raw.path,
            "header",
            f"has no loads and outputs; needed: pairs such as N1 [lbf] and rN1 [uV/V]; the file has {raw.labels()}",
        )
    return pairs


def _optional(raw: RawColumns, name: str) -> RawColumn | None:
    return next((column for column in raw.columns if column.name.casefold() == name), None)


def _complete(raw: RawColumns, column: RawColumn, *, needed: NDArray[np.bool_]) -> Array:
    """Cells of a column, all there where they are needed."""
    missing = np.flatnonzero(needed & ~np.isfinite(column.values))
    if missing.size:
        raise ReadError(
            raw.path,
            f"line {raw.lines[missing[0]]}, {column.place}",
            f"the number is missing ({missing.size} row(s) like it); a calibration point needs every load and output",
        )
    return column.values


def _flags(raw: RawColumns, name: str) -> NDArray[np.bool_]:
    """Rows that a column of 0 and 1 marks."""
    column = _optional(raw, name)
    if column is None:
        return np.zeros(raw.rows, dtype=np.bool_)
    values = np.where(np.isnan(column.values), 0.0, column.values)
    wrong = np.flatnonzero((values != 0) & (values != 1))
    if wrong.size:
        raise ReadError(
            raw.path, f"line {raw.lines[wrong[0]]}, {column.place}", f"holds {values[wrong[0]]:g}; allowed: 0 and 1"
        )
    return np.asarray(values == 1)


def _loads(
    raw: RawColumns, columns: Sequence[RawColumn], *, points: NDArray[np.bool_]
) -> tuple[Array, tuple[str, ...], list[bool]]:
    """Loads of the points, shape (n, c) [N, N*m], their units, and which are moments."""
    if not points.any():
        raise ReadError(raw.path, "", "holds natural zeros only; rows with loads are needed")
    loads, moments = [], []
    for column in columns:
        try:
            change = load_conversion(column.unit)
        except ValueError as error:
            raise ReadError(raw.path, f"header, {column.place}", str(error)) from None
        loads.append(change.inside(_complete(raw, column, needed=points))[points])
        moments.append(change.unit == "N*m")
    return np.column_stack(loads), tuple(column.unit for column in columns), moments


def _outputs(raw: RawColumns, columns: Sequence[RawColumn], *, notes: list[str]) -> Array:
    """Outputs of all rows, shape (n, c) [mV/V]."""
    everywhere = np.ones(raw.rows, dtype=np.bool_)
    excitation = _optional(raw, "excitation")
    ratios = ["/" in column.unit for column in columns]
    kind = "mV/V" if all(ratios) or excitation is None else "V"
    values = []
    for column in columns:
        try:
            change = conversion(column.unit, expected=kind)
        except ValueError as error:
            hint = "; outputs in V need a column excitation [V]" if excitation is None else ""
            raise ReadError(raw.path, f"header, {column.place}", f"{error}{hint}") from None
        values.append(change.inside(_complete(raw, column, needed=everywhere)))
    outputs = np.column_stack(values)
    if excitation is None:
        return outputs
    if kind == "mV/V":
        notes.append("outputs are ratios already: the excitation is not used")
        return outputs
    try:
        volts = conversion(excitation.unit, expected="V").inside(_complete(raw, excitation, needed=everywhere))
    except ValueError as error:
        raise ReadError(raw.path, f"header, {excitation.place}", str(error)) from None
    return ratio_outputs(raw.path, outputs, excitation=volts, lines=[int(line) for line in raw.lines])


def _series(
    raw: RawColumns, points: NDArray[np.bool_], *, notes: list[str]
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Series of the points, numbered from 0 in the order of the file, and their names."""
    column = _optional(raw, "series")
    if column is None:
        notes.append("there is no column series: all points are taken as one series")
        return np.zeros(int(points.sum()), dtype=np.intp), ("1",)
    names = [f"{value:.15g}" for value in _complete(raw, column, needed=points)[points]]
    order = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], dtype=np.intp), tuple(order)


def _points(raw: RawColumns, points: NDArray[np.bool_]) -> tuple[str, ...]:
    """Names of the points: the file's own, else their lines."""
    column = _optional(raw, "point")
    if column is None:
        return tuple(f"line {raw.lines[int(i)]}" for i in np.flatnonzero(points))
    return tuple(f"{value:.15g}" for value in _complete(raw, column, needed=points)[points])


def _temperature(raw: RawColumns, points: NDArray[np.bool_]) -> Array | None:
    """Temperature of the points [degC]; None where there is no such column."""
    column = _optional(raw, "temperature")
    if column is None:
        return None
    try:
        change = conversion(column.unit, expected="degC")
    except ValueError as error:
        raise ReadError(raw.path, f"header, {column.place}", str(error)) from None
    return change.inside(_complete(raw, column, needed=points)[points])
