"""Voltage calibration files (``.vol``): loads on one component at a time, bridge voltages and excitation.

``key--> value`` lines describe the balance; then comes a block for each component and each sign of its load,
``[N1 pos]``, with a header and rows of load, bridge voltages and excitation. The sign of the loads is that of the
block's title.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.balance.load_formats import BalanceType, Geometry
from aerobalance.balance.schedule import Schedule
from aerobalance.io.load_columns import Capacities, balance_type_of, load_conversion, load_key, settle_capacities
from aerobalance.io.vol_blocks import VolBlock, parse_vol
from aerobalance.io.vol_columns import (
    VolReading,
    amount_in,
    amounts_of,
    block_outputs,
    layout_of,
    load_units_of,
    naming_of,
    stated_capacities,
)
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.units import conversion

NAME: Final = "voltage calibration file (.vol)"
"""What to call the format in messages."""

_RECOGNISED_BY: Final = re.compile(
    r"voltage\s+calibration\s+file|number\s*of\s*loads\s*-+>|\[\s*maximal\s+balance\s+loads", re.I
)
_FORCES_AND_MOMENTS: Final = re.compile(r"(?P<forces>\d+)\s*f(orces?)?\W*(?P<moments>\d+)\s*m(oments?)?", re.I)
_DISTANCE: Final = re.compile(r"distance\s*(from|of)?\s*(?P<name>.+?)\s+to\b(?P<rest>.*)", re.I)
_GAUGE_POSITIONS: Final = {
    **dict.fromkeys(("forward normal", "forward pitch"), "forward_normal"),
    **dict.fromkeys(("aft normal", "aft pitch"), "aft_normal"),
    **dict.fromkeys(("forward side", "forward yaw"), "forward_side"),
    **dict.fromkeys(("aft side", "aft yaw"), "aft_side"),
}


def can_read(text: str) -> bool:
    """Return whether a text is a voltage calibration file."""
    return _RECOGNISED_BY.search(text[:20000]) is not None  # one of them stands at the beginning


def read_vol(path: Path, text: str, *, capacities: Capacities | None = None) -> Schedule:
    """Return the load schedule of a voltage calibration file, its loads in N and N*m and its outputs in mV/V.

    Every block is a series of its own. Outputs are bridge voltages over excitation.

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
        The text is no such file; the message says where and what is allowed.
    ValueError
        `capacities` does not fit the file's loads.

    Warns
    -----
    DataQualityWarning
        The file is cut off, signs within a block contradict its title, or names had to be guessed.
    """
    reading = VolReading(path, parse_vol(path, text))
    blocks = reading.parts.blocks
    layouts = [layout_of(reading, block) for block in blocks]
    naming = naming_of(reading, layouts[0])
    c = len(naming.components)
    amounts = amounts_of(reading, naming.components)
    units = load_units_of(reading, naming, layouts=layouts, amounts=amounts)
    loads, outputs = [], []
    for block, layout, component, unit in zip(blocks, layouts, naming.blocks, units.blocks, strict=True):
        applied = np.zeros((len(block.lines), c))
        written = _signed(reading, block, loads=block.values[:, layout.load])
        applied[:, component] = load_conversion(unit).inside(written)
        loads.append(applied)
        outputs.append(block_outputs(reading, block, layout=layout, first=layouts[0]))
    stated = stated_capacities(reading, naming, amounts=amounts, units=units)
    all_loads = np.concatenate(loads)
    table = settle_capacities(naming.components, all_loads, moments=units.moments, stated=stated, given=capacities)
    sizes = [len(block.lines) for block in blocks]
    return Schedule(
        name=path.name,
        components=naming.components,
        gauges=naming.components,
        loads=all_loads,
        outputs=np.concatenate(outputs),
        series=np.repeat(np.arange(len(sizes), dtype=np.intp), sizes),
        series_names=tuple(block.title for block in blocks),
        points=tuple(f"{block.title} {i + 1}" for block in blocks for i in range(len(block.lines))),
        capacities=table.values,
        moments=np.array(units.moments, dtype=np.bool_),
        load_units=units.components,
        natural_zeros=np.empty((0, c)),
        confirmation=np.zeros(sum(sizes), dtype=np.bool_),
        balance_type=_balance_type(reading, naming.components, moments=units.moments),
        geometry=_geometry(reading),
        assumptions=(*dict.fromkeys(reading.notes), *table.assumptions),
    )


def _signed(reading: VolReading, block: VolBlock, *, loads: Array) -> Array:
    """Return loads with the sign of their block's title, and warn where signs in its rows contradict the title."""
    if block.sign == 0:
        reading.notes.append(f"block [{block.title}] says neither pos nor neg: loads have the signs of the file")
        return loads
    wrong = np.flatnonzero(loads * block.sign < 0)
    right = np.flatnonzero(loads * block.sign > 0)
    if block.sign < 0 and wrong.size and not right.size:
        reading.notes.append(f"block [{block.title}] lists magnitudes: its loads are taken as negative")
    elif wrong.size:
        lines = ", ".join(str(block.lines[i]) for i in wrong[:8]) + (" ..." if wrong.size > 8 else "")
        word = "positive" if block.sign > 0 else "negative"
        what = "mixes signs" if right.size else f"lists {'negative' if block.sign > 0 else 'positive'} loads"
        warn_quality(
            f"{reading.path}: block [{block.title}] {what} (line(s) {lines}); all of its loads are taken as {word}, "
            f"as the title says; if the title is wrong, so is the sensitivity to {block.component}"
        )
    return block.sign * np.abs(loads) + 0.0  # adding zero makes 0 of -0, which would be printed with its sign


def _balance_type(reading: VolReading, names: Sequence[str], *, moments: Sequence[bool]) -> BalanceType:
    """Return which loads the gauges measure, by the units of six loads, or else by their names.

    A balance type in the file that contradicts the units is warned of.
    """
    # Of six gauges a force balance measures five forces and RM, a moment balance five moments and AF.
    kinds: dict[int, BalanceType] = {1: "force", 3: "direct", 5: "moment"}
    found: BalanceType = kinds.get(sum(moments), "unknown") if len(moments) == 6 else balance_type_of(names)
    entry = next((e for e in reading.parts.description if e.key.casefold().startswith("balance type")), None)
    said = _FORCES_AND_MOMENTS.search(entry.value) if entry else None
    counts_all = said is not None and int(said["forces"]) + int(said["moments"]) == len(moments)
    if entry and said and counts_all and int(said["moments"]) != sum(moments):
        warn_quality(
            f"{reading.path}: line {entry.line}: the balance type is {entry.value!r}, but by their units "
            f"{sum(moments)} of the {len(moments)} loads are moments; the units are believed, so check them"
        )
    return found


def _geometry(reading: VolReading) -> Geometry | None:
    """Return the distances of the gauges from the balance centre [m]; None, with a note, where any is missing."""
    found: dict[str, float] = {}
    for entry in reading.parts.distances:
        match = _DISTANCE.fullmatch(entry.key)
        place = _GAUGE_POSITIONS.get(load_key(match["name"])) if match else None
        amount = amount_in(entry.value)
        if match is None or place is None or not amount.value > 0:
            continue
        # The unit stands beside the number, or ends the key: "... to centre in mm", "... to centre [mm]".
        named = re.search(r"\bin\s+([A-Za-z]+)\W*$", match["rest"]) or re.search(
            r"[\[(]([A-Za-z]+)[\])]", match["rest"]
        )
        unit = amount.unit or (named[1] if named else "")
        try:
            found[place] = float(conversion(unit, expected="m").inside(amount.value))
        except ValueError:
            reading.notes.append(
                f"line {entry.line}: unit of the distance [{unit}] is not a length, so it is not used"
            )
    missing = [name for name in Geometry.__slots__ if name not in found]
    if missing:
        reading.notes.append(
            f"distances of the gauges are not (all) in the file ({', '.join(missing)}): loads cannot be turned into "
            "those of another kind of balance"
        )
        return None
    return Geometry(**found)
