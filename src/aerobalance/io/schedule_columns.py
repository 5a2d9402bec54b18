"""Which column of a load schedule is what: by the names in its header, or by a channel map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from aerobalance.balance.load_formats import role_of
from aerobalance.io.channel_map import ChannelMap, MappedChannel
from aerobalance.io.columns import split_label
from aerobalance.io.load_columns import load_conversion
from aerobalance.io.schedule_names import MARKS, is_output_of, mark_of
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, argument
from aerobalance.recording.units import conversion

_MAPPED: Final = ("column", "unit", "scale", "offset", "sign", "excitation", "shunt_expected", "shunt_measured")
"""What a channel map may say of a column of a schedule; what else it says is of recordings."""


@dataclass(frozen=True, slots=True)
class ScheduleColumn:
    """One column of a schedule.

    Attributes
    ----------
    name
        What it is: a load, ``r`` and the load whose bridge it is the output of, or one of `MARKS`.
    label
        Its header as the file has it.
    unit
        Its unit; an empty string where there is none.
    number
        Position in the file, counted from 1.
    scale, offset
        A value is scale * cell + offset, in `unit`.
    excitation
        Nominal excitation of an output in volts [V]; None where a column says it.
    gain
        Factor of an output by its shunt readings.
    """

    name: str
    label: str
    unit: str
    number: int
    scale: float = 1.0
    offset: float = 0.0
    excitation: float | None = None
    gain: float = 1.0

    @property
    def place(self) -> str:
        """The column as a place in an error message."""
        return f"column {self.number} ({self.label!r})"

    def scaled(self, cells: Array) -> Array:
        """Return values of cells, in `unit`."""
        return cells if (self.scale, self.offset) == (1.0, 0.0) else self.scale * cells + self.offset


Pairs = tuple[tuple[ScheduleColumn, ScheduleColumn], ...]
Found = tuple[Pairs, dict[str, ScheduleColumn], list[ScheduleColumn]]
"""Loads and outputs, the other columns that are used, and those that are not."""


def pairs_in(cells: Sequence[str]) -> bool:
    """Return whether the cells of a row name a load and the output of its bridge."""
    names = [split_label(cell)[0] for cell in cells if cell]
    if any(is_output_of(name, load) for load in names for name in names if mark_of(load) is None):
        return True
    twice = [name for name in dict.fromkeys(names) if names.count(name) == 2]  # once as a load, once as its output
    return any(role_of(name) for name in twice)


def header_by_map(chosen: ChannelMap) -> Callable[[Sequence[str]], bool]:
    """Return what says whether the cells of a row are the header that a channel map speaks of."""
    wanted = [channel.column.strip() for channel in chosen.channels.values() if isinstance(channel.column, str)]

    def is_header(cells: Sequence[str]) -> bool:
        names = {*cells, *(split_label(cell)[0] for cell in cells)}
        return all(name in names for name in wanted) if wanted else pairs_in(cells)

    return is_header


def columns_by_name(path: Path, line: int, columns: Sequence[ScheduleColumn]) -> Found:
    """Find loads, outputs and the other columns by their names.

    Raises
    ------
    ReadError
        A load has no output or an output no load; a name comes twice.
    """
    marks: dict[str, ScheduleColumn] = {}
    rest: list[ScheduleColumn] = []
    for column in columns:
        mark = mark_of(column.name) if column.name else None
        if mark is None and column.label:
            rest.append(column)
        elif mark in marks:
            raise _twice(path, line, column, marks[mark])
        elif mark is not None:
            marks[mark] = column
    pairs = _pairs(path, line, rest)
    used = {column.number for pair in pairs for column in pair}
    unused = [column for column in rest if column.number not in used]
    for column in unused:
        if _is_load_or_output(column):
            raise ReadError(
                path,
                f"line {line}, {column.place}",
                f"{column.name!r} is neither a load with an output r{column.name}, nor the output of a load that is "
                f"there; columns beside NAME [lbf] and rNAME [uV/V]: {', '.join(MARKS)}; a channel map "
                f"({argument('channel_map')}) says "
                "which column is what where the header does not",
            )
    return pairs, marks, unused


def _twice(path: Path, line: int, column: ScheduleColumn, other: ScheduleColumn) -> ReadError:
    return ReadError(path, f"line {line}, {column.place}", f"column {column.name} already stands at {other.place}")


def _pairs(path: Path, line: int, columns: Sequence[ScheduleColumn]) -> Pairs:
    """Put every load beside the output of its bridge: names that fit to the letter go first."""
    free = list(columns)
    pairs: list[tuple[ScheduleColumn, ScheduleColumn]] = []
    named: dict[str, ScheduleColumn] = {}
    for column in columns:
        alike = named.get(column.name)
        if alike is not None and _is_output(alike) == _is_output(column):
            raise _twice(path, line, column, alike)
        named.setdefault(column.name, column)
    for fits in (lambda output, load: output == f"r{load}", is_output_of, lambda output, load: output == load):
        for load in [*free]:
            for output in [*free]:
                if load in free and output in free and output is not load and fits(output.name, load.name):
                    if output.name == load.name and not _is_output(output):
                        continue
                    pairs.append((load, replace(output, name=_output_name(output.name, load.name))))
                    free.remove(load)
                    free.remove(output)
    return tuple(sorted(pairs, key=lambda pair: pair[0].number))


def _output_name(name: str, load: str) -> str:
    """Return the name of an output as recordings have it."""
    return name if name == f"r{load}" else f"r{load}"


def _is_output(column: ScheduleColumn) -> bool:
    """Return whether the unit is that of an output."""
    for kind in ("mV/V", "V"):
        try:
            conversion(column.unit, expected=kind)
        except ValueError:
            continue
        return True
    return False


def _is_load_or_output(column: ScheduleColumn) -> bool:
    """Return whether a column looks like a load or an output, by its name or its unit."""
    if role_of(column.name) or role_of(column.name.removeprefix("r")):
        return True
    if "/" in column.unit:
        return _is_output(column)
    try:
        load_conversion(column.unit)
    except ValueError:
        return False
    return True


def columns_by_map(path: Path, line: int, columns: Sequence[ScheduleColumn], chosen: ChannelMap) -> Found:
    """Find loads, outputs and the other columns where a channel map says which they are.

    Raises
    ------
    ReadError
        A column is not there; the map names a load without its output, an output without its load, or no load.
    """
    found = {name: _mapped(path, line, columns, name, channel) for name, channel in chosen.channels.items()}
    marks = {name: column for name, column in found.items() if name in MARKS}
    loads = [name for name in found if name not in MARKS and f"r{name}" in found]
    outputs = {f"r{name}" for name in loads}
    for name in found:
        if name not in marks and name not in loads and name not in outputs:
            raise ReadError(
                chosen.path,
                f"channels.{name}",
                f"is neither a load with an output r{name}, nor the output of a load; a map of a schedule has loads, "
                f"outputs and {', '.join(MARKS)}",
            )
    if not loads:
        raise ReadError(chosen.path, "channels", "has no load and its output, such as N1 and rN1")
    for name, channel in chosen.channels.items():
        ignored = sorted(channel.model_fields_set - set(_MAPPED))
        if ignored:
            raise ReadError(
                chosen.path,
                f"channels.{name}.{ignored[0]}",
                f"is for recordings; a column of a schedule has {', '.join(_MAPPED)}",
            )
    used = {column.number for column in found.values()}
    return (
        tuple((found[name], found[f"r{name}"]) for name in loads),
        marks,
        [column for column in columns if column.number not in used and column.label],
    )


def _mapped(
    path: Path, line: int, columns: Sequence[ScheduleColumn], name: str, channel: MappedChannel
) -> ScheduleColumn:
    """The column of a channel of the map."""
    key = channel.column
    if isinstance(key, int):
        fitting = [column for column in columns if column.number == key]
    else:
        fitting = [column for column in columns if column.label == key.strip()]
        fitting = fitting or [column for column in columns if column.name == key.strip()]
    if len(fitting) != 1:
        labels = ", ".join(repr(column.label) for column in columns)
        what = "there is no column" if not fitting else f"{len(fitting)} columns are called"
        raise ReadError(path, f"line {line}", f"{what} {key!r}; the file has {labels}; a number may be given as well")
    return replace(
        fitting[0],
        name=name,
        unit=channel.unit or fitting[0].unit,
        scale=channel.sign * channel.scale,
        offset=channel.sign * channel.offset,
        excitation=channel.excitation,
        gain=channel.shunt_ratio,
    )
