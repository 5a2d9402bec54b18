"""Load schedules as tables: loads and outputs in columns, a point a row, as laboratories write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.schedule import Schedule
from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.columns import split_label
from aerobalance.io.load_columns import (
    Capacities,
    balance_type_of,
    load_conversion,
    ratio_outputs,
    settle_capacities,
)
from aerobalance.io.schedule_columns import ScheduleColumn, columns_by_map, columns_by_name, header_by_map, pairs_in
from aerobalance.io.schedule_names import FALSE, TRUE
from aerobalance.io.sheet_cells import Row, Sheet, sheets_of
from aerobalance.io.text_cells import MISSING, number_in
from aerobalance.io.text_layout import Layout
from aerobalance.recording.channel import Array
from aerobalance.recording.components import is_gauge
from aerobalance.recording.errors import ReadError, argument
from aerobalance.recording.units import conversion, readable

NAME: Final = "table of loads and outputs"
"""What to call the format in messages."""

_NO_UNIT: Final = ("", "-", "–", "—", "1")
"""Cells of a row of units that say that a column has none."""


def read_table_schedule(
    path: Path, *, capacities: Capacities | None = None, channel_map: ChannelMap | None = None
) -> Schedule:
    """Read a table: columns of loads ``N1 [lbf]`` and outputs ``rN1 [uV/V]``, one row a point.

    Lines above the header, a row of units below it, and rows without readings are recognised. Further columns may be
    ``series`` and ``point`` (words or numbers), ``confirmation`` and ``natural_zero`` (0 or 1), ``temperature [degC]``
    and ``excitation [V]``, by these or other usual names; with the latter the outputs may be in V. Rows of natural
    zeros need no loads. The capacity of a component is the largest load where `capacities` does not give it.

    Parameters
    ----------
    path
        A text file, or an .xlsx workbook.
    capacities
        Largest allowed loads.
    channel_map
        Which column is what; recognised by the header where left out.

    Raises
    ------
    ReadError
        The file is no such table; the message says where and what is allowed.
    ValueError
        `capacities` does not fit the file's loads.
    """
    table = _table(path, channel_map)
    zero = _flags(table, "natural_zero")
    loads, moments = _loads(table, points=~zero)
    outputs = _outputs(table)
    names = tuple(load.name for load, _ in table.pairs)
    series, series_names = _series(table, ~zero)
    given = settle_capacities(names, loads, moments=moments, stated=np.full(len(names), np.nan), given=capacities)
    return Schedule(
        name=path.name,
        components=names,
        gauges=tuple(output.name[1:] for _, output in table.pairs),
        loads=loads,
        outputs=outputs[~zero],
        series=series,
        series_names=series_names,
        points=_points(table, ~zero, series),
        capacities=given.values,
        moments=np.array(moments, dtype=np.bool_),
        load_units=tuple(load.unit for load, _ in table.pairs),
        natural_zeros=outputs[zero],
        confirmation=_flags(table, "confirmation")[~zero],
        temperature=_temperature(table, ~zero),
        balance_type=balance_type_of(names),
        assumptions=(*table.notes, *given.assumptions),
    )


@dataclass(frozen=True, slots=True)
class Framed:
    """A sheet cut into its parts.

    Attributes
    ----------
    header
        Line of the header; 0 where there is none.
    labels
        Its cells.
    units
        Cells of the row of units, blank where there is none.
    rows
        What stands below.
    notes
        What was passed over.
    """

    header: int
    labels: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


def framed(sheet: Sheet, layout: Layout, *, is_header: Callable[[Sequence[str]], bool]) -> Framed | None:
    """Return header, units and rows of a sheet, what stands above them left out; None where it has no header.

    Parameters
    ----------
    sheet
        The sheet.
    layout
        Line of the header, and lines to skip after it, where they are given.
    is_header
        Says whether the cells of a row are a header.
    """
    rows = list(sheet.rows)
    if layout.header_line == 0:
        width = max((len(row.cells) for row in rows), default=0)
        below = [row for row in rows if row.line > (layout.skip_lines or 0)]
        return Framed(0, tuple(str(i + 1) for i in range(width)), ("",) * width, tuple(below))
    if layout.header_line is not None:
        at = next((i for i, row in enumerate(rows) if row.line == layout.header_line), None)
    else:
        at = next((i for i, row in enumerate(rows) if is_header(row.cells)), None)
    if at is None:
        return None
    labels, header = rows[at].cells, rows[at].line
    rest = [row for row in rows[at + 1 :] if row.line > header + (layout.skip_lines or 0)]
    units: tuple[str, ...] = ()
    notes: list[str] = []
    if rest and _are_units(rest[0].cells):
        units = rest.pop(0).cells
    while rest and not any(_is_number(cell, sheet.decimal) for cell in rest[0].cells):
        skipped = rest.pop(0)
        notes.append(f"line {skipped.line} below the header holds no number and is passed over: {_shown(skipped)}")
    units = tuple(unit.strip("[]() ") for unit in units) + ("",) * max(len(labels) - len(units), 0)
    return Framed(header, labels, units, tuple(rest), tuple(notes))


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether the cells of a row are units, or blank for columns that have none."""
    bare = [cell.strip("[]() ") for cell in cells]
    given = [cell for cell in bare if cell not in _NO_UNIT]
    known = [cell for cell in given if readable(cell)]
    return len(known) > 1 and 2 * len(known) > len(given)


def _is_number(cell: str, decimal: str) -> bool:
    return number_in(cell, decimal=decimal) is not None


def _shown(row: Row) -> str:
    text = "; ".join(cell for cell in row.cells if cell)
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


@dataclass(frozen=True, slots=True)
class _Table:
    """Rows with readings, and what the columns are.

    Attributes
    ----------
    path
        The file.
    rows
        Rows that hold a load or an output.
    pairs
        Every load and the output of its bridge.
    marks
        The other columns that are used, by name.
    decimal
        Decimal sign.
    notes
        What was taken for granted; grows while the columns are read.
    """

    path: Path
    rows: tuple[Row, ...]
    pairs: tuple[tuple[ScheduleColumn, ScheduleColumn], ...]
    marks: dict[str, ScheduleColumn]
    decimal: str
    notes: list[str]

    def texts(self, column: ScheduleColumn) -> list[str]:
        """Cells of a column."""
        for row in self.rows:
            if len(row.cells) < column.number:
                raise ReadError(
                    self.path,
                    f"line {row.line}",
                    f"has {len(row.cells)} cell(s), and {column.place} is needed; every row needs a cell a column",
                )
        return [row.cells[column.number - 1] for row in self.rows]

    def numbers(self, column: ScheduleColumn, *, needed: NDArray[np.bool_]) -> Array:
        """Cells of a column as numbers, in its unit and sign; all there where they are needed, else NaN."""
        values = np.full(len(self.rows), np.nan)
        for i, cell in enumerate(self.texts(column)):
            value = number_in(cell.replace("−", "-"), decimal=self.decimal)
            if value is None and cell.casefold() not in MISSING:
                raise ReadError(
                    self.path,
                    f"line {self.rows[i].line}, {column.place}",
                    f"{cell[:40]!r} is no number; allowed: numbers such as -12{self.decimal}5 or 1{self.decimal}2e-3, "
                    "without signs between thousands",
                )
            values[i] = np.nan if value is None else value
        missing = np.flatnonzero(needed & ~np.isfinite(values))
        if missing.size:
            raise ReadError(
                self.path,
                f"line {self.rows[missing[0]].line}, {column.place}",
                f"the number is missing ({missing.size} row(s) like it); a calibration point needs every load and "
                "output",
            )
        return column.scaled(values)


def _table(path: Path, chosen: ChannelMap | None) -> _Table:
    """Find the header, what its columns are, and the rows with readings."""
    layout = Layout() if chosen is None else chosen.layout
    is_header = pairs_in if chosen is None else header_by_map(chosen)
    sheets = sheets_of(path, layout)
    wanted = None if chosen is None else chosen.file.sheet
    if wanted is not None and wanted not in [sheet.name for sheet in sheets]:
        raise ReadError(path, f"sheet {wanted!r}", f"is not there; the file has {_sheet_names(sheets)}")
    asked = [sheet for sheet in sheets if wanted in (None, sheet.name)]
    found = [(sheet, part) for sheet in asked if (part := framed(sheet, layout, is_header=is_header)) is not None]
    if not found:
        raise _no_header(path, asked, chosen)
    if len(found) > 1:
        raise ReadError(
            path,
            "",
            f"holds a schedule on sheets {' and '.join(repr(sheet.name) for sheet, _ in found)}; name one in a "
            f'channel map ({argument("channel_map")}): sheet = "NAME" under [file]',
        )
    sheet, part = found[0]
    return _with_columns(path, sheet, part, chosen)


def _with_columns(path: Path, sheet: Sheet, part: Framed, chosen: ChannelMap | None) -> _Table:
    """Return what the columns of a sheet are."""
    columns = []
    for i, label in enumerate(part.labels):
        name, unit = split_label(label)
        below = part.units[i]
        if unit and below not in (*_NO_UNIT, unit):
            raise ReadError(
                path,
                f"line {part.header}, column {i + 1} ({label!r})",
                f"the row of units below has {below!r}; one unit a column is needed",
            )
        columns.append(ScheduleColumn(name, label, unit or ("" if below in _NO_UNIT else below), i + 1))
    if chosen is None:
        pairs, marks, unused = columns_by_name(path, part.header, columns)
    else:
        pairs, marks, unused = columns_by_map(path, part.header, columns, chosen)
    used = [column.number for pair in pairs for column in pair]
    rows = [row for row in part.rows if any(row.cells[at - 1] for at in used if at <= len(row.cells))]
    others = [row for row in part.rows if row not in rows]
    notes = [*part.notes]
    if unused:
        notes.append(f"columns that are not used: {', '.join(repr(column.label) for column in unused)}")
    if others:
        lines = ", ".join(str(row.line) for row in others[:5]) + (" ..." if len(others) > 5 else "")
        notes.append(f"lines without readings are passed over: {lines} ({_shown(others[0])})")
    if not rows:
        raise ReadError(
            path, f"after line {part.header}", "there are no rows of numbers; a header and rows are needed"
        )
    return _Table(path, tuple(rows), pairs, marks, sheet.decimal, notes)


def _sheet_names(sheets: Sequence[Sheet]) -> str:
    return ", ".join(repr(sheet.name) for sheet in sheets if sheet.name) or "no sheets: it is a text file"


def _no_header(path: Path, sheets: Sequence[Sheet], chosen: ChannelMap | None) -> ReadError:
    """Return the error of a file in which no row is a header."""
    rows = [row for sheet in sheets for row in sheet.rows]
    if not rows:
        return ReadError(path, "", "is empty; a header line and rows of numbers are needed")
    if chosen is not None and chosen.file.header_line is not None:
        return ReadError(
            path, f"line {chosen.file.header_line}", "is blank or not there; the channel map puts the header in it"
        )
    names = "no line has all columns of the channel map: " if chosen else "no line names loads and their outputs: "
    widest = max(rows, key=lambda row: sum(bool(cell) and not _is_number(cell, ".") for cell in row.cells))
    wanted = (
        ", ".join(repr(channel.column) for channel in chosen.channels.values())
        if chosen
        else "pairs such as N1 [lbf] and rN1 [uV/V] (rNAME is the output of NAME's bridge), or a channel map "
        f"({argument('channel_map')}) that says which column is what, which `aerobalance map FILE` makes"
    )
    return ReadError(path, "header", f"{names}needed are {wanted}; line {widest.line} has {_shown(widest)}")


def _flags(table: _Table, name: str) -> NDArray[np.bool_]:
    """Rows that a column marks."""
    column = table.marks.get(name)
    if column is None:
        return np.zeros(len(table.rows), dtype=np.bool_)
    marked = np.zeros(len(table.rows), dtype=np.bool_)
    for i, cell in enumerate(table.texts(column)):
        value = number_in(cell, decimal=table.decimal)
        plain = cell.casefold() if value is None else f"{value:g}"
        if plain not in (*TRUE, *FALSE, *MISSING):
            raise ReadError(
                table.path,
                f"line {table.rows[i].line}, {column.place}",
                f"holds {cell[:40]!r}; allowed: 0 and 1, or words such as no and yes",
            )
        marked[i] = plain in TRUE
    return marked


def _loads(table: _Table, *, points: NDArray[np.bool_]) -> tuple[Array, list[bool]]:
    """Loads of the points, shape (n, c) [N, N*m], and which are moments."""
    if not points.any():
        raise ReadError(table.path, "", "holds natural zeros only; rows with loads are needed")
    loads, moments = [], []
    for column, _ in table.pairs:
        try:
            change = load_conversion(column.unit)
        except ValueError as error:
            raise ReadError(table.path, f"header, {column.place}", _of_unit(column, error)) from None
        loads.append(change.inside(table.numbers(column, needed=points))[points])
        moments.append(change.unit == "N*m")
    return np.column_stack(loads), moments


def _of_unit(column: ScheduleColumn, error: ValueError) -> str:
    """Return what is wrong with a unit, or that there is none."""
    if column.unit:
        return str(error)
    unit = "mV/V" if is_gauge(column.name) else "N"
    return (
        f"has no unit; it belongs in the header ({column.name} [{unit}]), in a row of units below it, or in a channel "
        f"map ({argument('channel_map')})"
    )


def _outputs(table: _Table) -> Array:
    """Outputs of all rows, shape (n, c) [mV/V]."""
    everywhere = np.ones(len(table.rows), dtype=np.bool_)
    excitation = table.marks.get("excitation")
    values, used = [], False
    for _, column in table.pairs:
        cells = table.numbers(column, needed=everywhere)
        if "/" in column.unit:
            values.append(_inside(table, column, cells, "mV/V") * column.gain)
            continue
        if excitation is None and column.excitation is None:
            values.append(_inside(table, column, cells, "mV/V", hint="; outputs in V need a column excitation [V]"))
            continue
        volts = _inside(table, column, cells, "V")
        if column.excitation is not None:
            supply = np.full(len(table.rows), column.excitation)
        elif excitation is not None:
            used = True
            supply = _inside(table, excitation, table.numbers(excitation, needed=everywhere), "V")
        lines = [row.line for row in table.rows]
        values.append(ratio_outputs(table.path, volts[:, None], excitation=supply, lines=lines)[:, 0] * column.gain)
    if excitation is not None and not used:
        table.notes.append("outputs are ratios already: the excitation is not used")
    return np.column_stack(values)


def _inside(table: _Table, column: ScheduleColumn, cells: Array, kind: str, *, hint: str = "") -> Array:
    """Cells of a column in the unit used inside."""
    try:
        return conversion(column.unit, expected=kind).inside(cells)
    except ValueError as error:
        raise ReadError(table.path, f"header, {column.place}", f"{_of_unit(column, error)}{hint}") from None


def _named(table: _Table, column: ScheduleColumn) -> list[str]:
    """Words or numbers of a column, numbers without needless digits."""
    cells = table.texts(column)
    numbers = [number_in(cell, decimal=table.decimal) for cell in cells]
    return [cell if value is None else f"{value:.15g}" for cell, value in zip(cells, numbers, strict=True)]


def _series(table: _Table, points: NDArray[np.bool_]) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Series of the points, numbered from 0 in the order of the file, and their names."""
    column = table.marks.get("series")
    if column is None:
        table.notes.append("there is no column series: all points are taken as one series")
        return np.zeros(int(points.sum()), dtype=np.intp), ("1",)
    names, blank, above = [], 0, ""
    for row, name, point in zip(table.rows, _named(table, column), points, strict=True):
        above = name or above
        if not point:
            continue
        if not above:
            raise ReadError(
                table.path,
                f"line {row.line}, {column.place}",
                "is blank; the series of a point is a word or a number, which may be left out where it is that of the "
                "row above",
            )
        blank += not name
        names.append(above)
    if blank:
        table.notes.append(f"{blank} rows do not name their series: they are of that of the row above")
    order = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], dtype=np.intp), tuple(order)


def _points(table: _Table, points: NDArray[np.bool_], series: NDArray[np.intp]) -> tuple[str, ...]:
    """Names of the points: the file's own, else their lines; one that comes twice in its series has its line."""
    column = table.marks.get("point")
    lines = [table.rows[int(i)].line for i in np.flatnonzero(points)]
    if column is None:
        return tuple(f"line {line}" for line in lines)
    given = [name for name, point in zip(_named(table, column), points, strict=True) if point]
    keys = list(zip(series.tolist(), given, strict=True))
    return tuple(
        f"line {line}" if not name else f"{name} (line {line})" if keys.count(key) > 1 else name
        for line, name, key in zip(lines, given, keys, strict=True)
    )


def _temperature(table: _Table, points: NDArray[np.bool_]) -> Array | None:
    """Temperature of the points [degC]; None where there is no such column."""
    column = table.marks.get("temperature")
    if column is None:
        return None
    return _inside(table, column, table.numbers(column, needed=points), "degC")[points]
