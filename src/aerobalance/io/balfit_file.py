"""Load schedules in the layout of BALFIT: symbols, units, capacities, natural zeros and points, cells and commas."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_formats import BalanceType
from aerobalance.balance.schedule import Schedule
from aerobalance.io.balfit_symbols import BalfitColumns, columns_of
from aerobalance.io.load_columns import Capacities, balance_type_of, load_conversion, settle_capacities
from aerobalance.io.safe_write import replacing
from aerobalance.io.text_cells import number_in, separator_of, split_line
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality
from aerobalance.recording.units import Conversion, conversion

NAME: Final = "BALFIT load schedule"
"""What to call the format in messages."""

_SIGN: Final = re.compile(
    r"""^[ \t",;]*(FILE_TYPE\s*"?\s*[,\t]|BALANCE_NAME\s*"?\s*[,\t])|^[ \t",]*(NZ|P|CP)-\w+\s*"?\s*[,\t]""",
    re.I | re.M,
)
_COMMENT: Final = re.compile(r'[\s"]*;')
_KEYWORD: Final = re.compile(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)+|DESCRIPTION|COMMENT|DATE")
_HINT: Final = re.compile(r"(?P<forces>\d)\s*F\s*[-/]?\s*(?P<moments>\d)\s*M", re.I)
_HINTED: Final[dict[str, BalanceType]] = {"51": "force", "15": "moment", "33": "direct"}


def can_read(text: str) -> bool:
    """Return whether a text is a schedule in this layout."""
    return _SIGN.search(text[:50000]) is not None


@dataclass(frozen=True, slots=True)
class _Row:
    """One line that is no comment.

    Attributes
    ----------
    line
        Its number, counted from 1.
    cells
        Its cells; trailing empty ones left out.
    """

    line: int
    cells: tuple[str, ...]

    def cell(self, number: int) -> str:
        return self.cells[number] if 0 <= number < len(self.cells) else ""


@dataclass(frozen=True, slots=True)
class _Reading:
    """A file in the course of being read."""

    path: Path
    columns: BalfitColumns
    loads: tuple[Conversion, ...]
    outputs: tuple[Conversion, ...]
    notes: list[str] = field(default_factory=list)


def read_balfit(path: Path, text: str, *, capacities: Capacities | None = None) -> Schedule:
    """Make a schedule of a text in the layout of BALFIT.

    Natural zeros are averaged for each of their series. Where points refer to natural zeros of several series,
    outputs are moved by the difference of the averages (over the roll angles that both series have), so that all
    share the natural zeros of the first series; only these are returned.

    Parameters
    ----------
    path
        The file, for messages.
    text
        Its text.
    capacities
        Largest allowed loads by component, in place of the file's.

    Raises
    ------
    ReadError
        The text is no such schedule; the message says where and what is allowed.
    ValueError
        `capacities` does not fit the file's loads.

    Warns
    -----
    DataQualityWarning
        The file is cut off, or points refer to natural zeros that the file does not hold or that cannot be compared.
    """
    keywords, rows = _rows(text)
    if not rows:
        raise ReadError(path, "", "has no row of symbols; needed: one such as ,,,,N1,N2,S1,S2,RM,AF,rN1,...,rAF")
    columns = columns_of(path, rows[0].cells, line=rows[0].line)
    reading = _units(path, columns, rows=rows[1:2])
    stated, used = _capacities(reading, rows[2:3])
    zeros, points = _sorted(reading, rows[2 + used :], torn=not text.endswith("\n"))
    outputs, natural = _one_zero(reading, points, zeros=zeros)
    loads = _block(reading, points, numbers=columns.loads, changes=reading.loads)
    moments = [change.unit == "N*m" for change in reading.loads]
    table = settle_capacities(columns.names, loads, moments=moments, stated=stated, given=capacities)
    series = [row.cell(columns.series) or "1" for row in points]
    order = {name: i for i, name in enumerate(dict.fromkeys(series))}
    return Schedule(
        name=path.name,
        components=columns.names,
        gauges=columns.gauges,
        loads=loads,
        outputs=outputs,
        series=np.array([order[name] for name in series], dtype=np.intp),
        series_names=tuple(order),
        points=tuple(row.cell(columns.point) for row in points),
        capacities=table.values,
        moments=np.array(moments, dtype=np.bool_),
        load_units=tuple(rows[1].cell(i) for i in columns.loads),
        natural_zeros=natural,
        confirmation=np.array([_is_confirmation(row.cell(columns.point)) for row in points], dtype=np.bool_),
        temperature=_temperature(reading, points, units=rows[1]),
        balance_type=_balance_type(reading, keywords),
        assumptions=(*reading.notes, *table.assumptions),
    )


def _rows(text: str) -> tuple[dict[str, str], list[_Row]]:
    """Parse a text: lines KEYWORD,value, and the rows; comments and empty lines are left out."""
    keywords: dict[str, str] = {}
    rows: list[_Row] = []
    sign = _SIGN.search(text)
    separator = "\t" if sign is not None and separator_of(sign[0]) == "\t" else ","
    for number, line in enumerate(text.split("\n"), start=1):
        if _COMMENT.match(line) or not line.strip(' \t,"'):
            continue
        cells = [cell.strip() for cell in split_line(line, separator)]
        while cells and not cells[-1]:
            cells.pop()
        first = next((cell for cell in cells if cell), "")
        if not first:
            continue
        keyed = _KEYWORD.fullmatch(first.upper()) and (cells[0] or sum(map(bool, cells)) <= 2)
        if not rows and keyed:
            keywords[first.upper()] = ", ".join(cell for cell in cells[cells.index(first) + 1 :] if cell)
        else:
            rows.append(_Row(number, tuple(cells)))
    return keywords, rows


def _units(path: Path, columns: BalfitColumns, *, rows: Sequence[_Row]) -> _Reading:
    """Read the row of units."""
    if not rows:
        raise ReadError(path, "", "ends after the row of symbols; needed next: units, capacities and points")
    row = rows[0]
    changes: list[Conversion] = []
    for column in (*columns.loads, *columns.outputs):
        try:
            unit = row.cell(column)
            changes.append(load_conversion(unit) if column in columns.loads else conversion(unit, expected="mV/V"))
        except ValueError as error:
            raise ReadError(path, f"line {row.line} (units), column {column + 1}", str(error)) from None
    c = len(columns.loads)
    return _Reading(path, columns, tuple(changes[:c]), tuple(changes[c:]))


def _capacities(reading: _Reading, rows: Sequence[_Row]) -> tuple[Array, int]:
    """Read the row of capacities [N, N*m]; NaN, and no row used, where the next row is one of data."""
    c = len(reading.columns.loads)
    stated = np.full(c, np.nan)
    if not rows or any(rows[0].cell(i) for i in range(reading.columns.first)):
        return stated, 0
    for i, column in enumerate(reading.columns.loads):
        text = rows[0].cell(column)
        value = number_in(text)
        if text and (value is None or value <= 0):
            raise ReadError(
                reading.path,
                f"line {rows[0].line} (capacities), column {column + 1} ({reading.columns.names[i]})",
                f"{text[:40]!r} is no capacity; allowed: positive numbers",
            )
        if value is not None:
            stated[i] = float(reading.loads[i].inside(value))
    return stated, 1


def _is_confirmation(point: str) -> bool:
    return point.upper().startswith(("CP", "C-"))


def _sorted(reading: _Reading, rows: Sequence[_Row], *, torn: bool) -> tuple[list[_Row], list[_Row]]:
    """Tell natural zeros from points, and leave a last row out that is cut off."""
    columns, path = reading.columns, reading.path
    kept = list(rows)
    if kept and _is_torn(columns, kept, torn=torn):
        warn_quality(
            f"{path}: line {kept[-1].line}: the file ends in the middle of a row: it is cut off, and only the "
            f"{len(kept) - 1} complete row(s) are used"
        )
        kept.pop()
    zeros: list[_Row] = []
    points: list[_Row] = []
    for row in kept:
        name = row.cell(columns.point)
        if not name:
            raise ReadError(
                path,
                f"line {row.line}, column {columns.point + 1}",
                f"the row ({', '.join(row.cells)[:40]!r}) has no name; needed: NZ-... for natural zeros, P-... for "
                "points, CP-... for confirmation points",
            )
        (zeros if name.upper().startswith("NZ") else points).append(row)
    if not points:
        raise ReadError(path, "", "has no points; needed: rows such as ,P-0001,1,A, and the loads and outputs")
    return zeros, points


def _is_torn(columns: BalfitColumns, rows: Sequence[_Row], *, torn: bool) -> bool:
    """Whether the last row is cut off: cells lack, or the last number is shorter than all above it."""
    last = max((*columns.loads, *columns.outputs))
    row = rows[-1]
    if len(row.cells) <= last:
        return True
    others = [len(other.cells[-1]) for other in rows[:-1] if len(other.cells) > last]
    cut = number_in(row.cells[-1]) is None or (bool(others) and len(row.cells[-1]) < min(others))
    return torn and cut


def _block(reading: _Reading, rows: Sequence[_Row], *, numbers: Sequence[int], changes: Sequence[Conversion]) -> Array:
    """Read some columns of some rows, in the units inside, shape (n, c)."""
    values = np.empty((len(rows), len(numbers)))
    for i, row in enumerate(rows):
        for j, column in enumerate(numbers):
            value = number_in(row.cell(column))
            if value is None:
                raise ReadError(
                    reading.path,
                    f"line {row.line}, column {column + 1} ({reading.columns.symbol(column)})",
                    f"{row.cell(column)[:40]!r} is no number; allowed: numbers such as -12.5 or 1.2E-3",
                )
            values[i, j] = value
    return np.column_stack([change.inside(values[:, j]) for j, change in enumerate(changes)])


def _one_zero(reading: _Reading, points: Sequence[_Row], *, zeros: Sequence[_Row]) -> tuple[Array, Array]:
    """Outputs of the points [mV/V] on the natural zeros of the first series, and these natural zeros."""
    columns = reading.columns
    outputs = _block(reading, points, numbers=columns.outputs, changes=reading.outputs)
    if not zeros:
        return outputs, np.empty((0, len(columns.names)))
    values = _block(reading, zeros, numbers=columns.outputs, changes=reading.outputs)
    groups = np.array([row.cell(columns.series) for row in zeros])
    rolls = np.array([row.cell(columns.roll) for row in zeros])
    refers = np.array([row.cell(columns.zero) for row in points])
    first = str(groups[0])
    for group in dict.fromkeys(str(name) for name in refers):
        if group == first:
            continue
        shift = _difference(values, groups=groups, rolls=rolls, pair=(first, group))
        if shift is None:
            what = "has no roll angle in common with" if (groups == group).any() else "is not in the file, unlike"
            if group or columns.zero >= 0:
                warn_quality(
                    f"{reading.path}: {int((refers == group).sum())} point(s) refer to the natural zeros {group!r}, "
                    f"which {what} {first!r}; their outputs are taken on the natural zeros {first!r} as they are, so "
                    "a drift of the zeros between them goes into the loads"
                )
            continue
        outputs[refers == group] += shift
        reading.notes.append(
            f"outputs of points on the natural zeros {group!r} are moved onto those of {first!r}, by "
            f"{np.abs(shift).max():.3g} mV/V at most"
        )
    return outputs, values[groups == first]


def _difference(
    values: Array, *, groups: NDArray[np.str_], rolls: NDArray[np.str_], pair: tuple[str, str]
) -> Array | None:
    """Mean of the first group of natural zeros less that of the second, over common roll angles; None without."""
    first, second = groups == pair[0], groups == pair[1]
    common = [roll for roll in dict.fromkeys(rolls[first]) if roll in rolls[second]]
    if not common:
        return None
    steps = [
        values[first & (rolls == roll)].mean(axis=0) - values[second & (rolls == roll)].mean(axis=0) for roll in common
    ]
    return np.asarray(np.mean(steps, axis=0))


def _temperature(reading: _Reading, points: Sequence[_Row], *, units: _Row) -> Array | None:
    """Temperatures of the points [degC]; None where there is no such column."""
    column = reading.columns.temperature
    if column is None:
        return None
    try:
        change = conversion(units.cell(column), expected="degC")
    except ValueError as error:
        raise ReadError(reading.path, f"line {units.line} (units), column {column + 1}", str(error)) from None
    return _block(reading, points, numbers=[column], changes=[change])[:, 0]


def write_balfit_schedule(path: Path | str, schedule: Schedule) -> None:
    """Write a schedule in the layout of BALFIT, loads in the units they had, outputs in microV/V.

    Numbers have 15 significant digits, so a file that is read and written again has the same numbers. The layout has
    no place for distances of gauges and names of series: these are numbered from 1, names that are no numbers stand
    in comments.

    Parameters
    ----------
    path
        The file.
    schedule
        What to write.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    loads = [load_conversion(unit) for unit in schedule.load_units]
    output = conversion("microV/V", expected="mV/V")
    with replacing(Path(path)) as beside, beside.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerows((["FILE_TYPE", "DATA_FOR_ITERATIVE_REGRESSION_ANALYSIS"], ["BALANCE_NAME", schedule.name]))
        symbols = (*schedule.components, *(f"r{name}" for name in schedule.components))
        units = (*schedule.load_units, *["microV/V"] * len(loads))
        heated = schedule.temperature is not None
        rows.writerow(["", "", "", "", *symbols, *(["T"] if heated else [])])
        rows.writerow(["", "", "", "", *units, *(["degC"] if heated else [])])
        capacities = [change.outside(value) for change, value in zip(loads, schedule.capacities, strict=True)]
        rows.writerow(["", "", "", "", *_printed(capacities), *[""] * len(loads)])
        for i, zeros in enumerate(schedule.natural_zeros):
            rows.writerow(["", f"NZ-{i + 1:02d}", "A", "", *[""] * len(loads), *_printed(output.outside(zeros))])
        numbered = [name if name.isdecimal() else str(i + 1) for i, name in enumerate(schedule.series_names)]
        if len(set(numbered)) < len(numbered):
            numbered = [str(i + 1) for i in range(len(numbered))]
        for number, name in zip(numbered, schedule.series_names, strict=True):
            if number != name:
                file.write(f"; series {number} is {' '.join(name.split())}\n")
        for i in range(len(schedule.points)):
            applied = [change.outside(value) for change, value in zip(loads, schedule.loads[i], strict=True)]
            heat = [] if schedule.temperature is None else [schedule.temperature[i]]
            values = _printed([*applied, *output.outside(schedule.outputs[i]), *heat])
            rows.writerow(["", _point(schedule, i), numbered[schedule.series[i]], "A", *values])


def _printed(values: Iterable[float | Array]) -> list[str]:
    return [f"{float(value):.15g}" for value in values]


def _point(schedule: Schedule, number: int) -> str:
    """Name of a point that reads back as what it is: with CP for confirmation, else without CP, C- and NZ."""
    name = " ".join(schedule.points[number].split())
    marked = _is_confirmation(name)
    foul = not name or name.upper().startswith("NZ") or name[0] in ';"'
    if foul or marked != bool(schedule.confirmation[number]):
        return f"{'CP' if schedule.confirmation[number] else 'P'}-{number + 1:04d}"
    return name


def _balance_type(reading: _Reading, keywords: dict[str, str]) -> BalanceType:
    """Which loads the gauges measure: by their names, else by a hint such as 5F1M in the balance's name."""
    found = balance_type_of(reading.columns.names)
    hint = _HINT.search(keywords.get("BALANCE_NAME", ""))
    hinted = _HINTED.get(hint["forces"] + hint["moments"], "unknown") if hint else "unknown"
    if found == "unknown" and hinted != "unknown":
        reading.notes.append(f"that this is a {hinted} balance is taken from its name")
        return hinted
    if hinted not in ("unknown", found):
        reading.notes.append(
            f"the balance's name hints at a {hinted} balance; the loads are those of a {found} balance"
        )
    return found
