"""Which column of a BALFIT file is what, by the row of symbols."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from aerobalance.recording.errors import ReadError

_TEMPERATURES: Final = ("t", "temp", "temperature", "tb", "tbal")


@dataclass(frozen=True, slots=True)
class BalfitColumns:
    """Columns of a BALFIT file, numbered from 0.

    Attributes
    ----------
    names, gauges
        Symbols of the c loads and of their bridges (without the ``r`` of the outputs).
    loads, outputs
        BalfitColumns of the c loads and of the c outputs in the same order.
    temperature
        Column of the temperature; None where there is none.
    first
        First column with a symbol; those before hold the name of the point and the series.
    """

    names: tuple[str, ...]
    gauges: tuple[str, ...]
    loads: tuple[int, ...]
    outputs: tuple[int, ...]
    temperature: int | None
    first: int

    @property
    def point(self) -> int:
        """Column of the point's name."""
        return max(self.first - 3, 0)

    @property
    def series(self) -> int:
        """Column of the load series, or of the series of natural zeros in their rows."""
        return self.point + 1 if self.first >= 2 else -1

    @property
    def zero(self) -> int:
        """Column of the series of natural zeros that a point refers to; -1 where there is none."""
        return self.point + 2 if self.first >= 3 else -1

    @property
    def roll(self) -> int:
        """Column of the roll angle in rows of natural zeros; -1 where there is none."""
        return self.zero

    def symbol(self, column: int) -> str:
        """Symbol of a column, for messages."""
        if column in self.loads:
            return self.names[self.loads.index(column)]
        if column in self.outputs:
            return f"r{self.gauges[self.outputs.index(column)]}"
        return "temperature"


def columns_of(path: Path, cells: Sequence[str], *, line: int) -> BalfitColumns:
    """Tell the columns apart by their symbols: a load N1 has an output rN1.

    Raises
    ------
    ReadError
        The row is no row of symbols, or loads and outputs do not belong together.
    """
    place = f"line {line} (symbols)"
    symbols = {i: cell for i, cell in enumerate(cells) if cell}
    plain = {i: cell.casefold() for i, cell in symbols.items()}
    by_name: dict[str, int] = {}
    for i, name in plain.items():
        if name in by_name:
            raise ReadError(
                path, place, f"the symbol {symbols[i]!r} stands in columns {by_name[name] + 1} and {i + 1}"
            )
        by_name[name] = i
    temperature = next((i for i, name in plain.items() if name in _TEMPERATURES), None)
    pairs = [(i, by_name[f"r{name}"]) for name, i in by_name.items() if f"r{name}" in by_name]
    if not pairs:
        raise ReadError(
            path,
            place,
            f"holds {', '.join(symbols.values())[:80]!r}, but no loads with their outputs; needed: a row of symbols "
            "such as ,,,,N1,N2,S1,S2,RM,AF,rN1,rN2,rS1,rS2,rRM,rAF",
        )
    start = min(min(pair) for pair in pairs)
    start = start if temperature is None else min(start, temperature)
    known = {column for pair in pairs for column in pair} | {temperature}
    alone = [symbols[i] for i in symbols if i not in known and i > start]
    if alone:
        raise ReadError(
            path,
            place,
            f"symbols without their other half: {', '.join(alone)[:80]}; every load NAME needs one output rNAME, and "
            f"beside them only a temperature ({', '.join(name.upper() for name in _TEMPERATURES[:3])}) is allowed",
        )
    if start < 1:
        raise ReadError(path, place, "leaves no column for the points' names; needed before the loads: name, series")
    loads = tuple(load for load, _ in pairs)
    outputs = tuple(output for _, output in pairs)
    return BalfitColumns(
        names=tuple(symbols[i] for i in loads),
        gauges=tuple(symbols[i][1:] for i in outputs),
        loads=loads,
        outputs=outputs,
        temperature=temperature,
        first=start,
    )
