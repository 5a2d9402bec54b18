"""Which column of a ``.vol`` file is what: bridges, loads and maximal loads matched by name, else by position."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.io.columns import split_label
from aerobalance.io.load_columns import load_conversion, load_key, load_unit_of, ratio_outputs
from aerobalance.io.vol_blocks import Entry, VolBlock, VolText
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError, warn_quality
from aerobalance.recording.units import conversion

_GENERIC: Final = re.compile(
    r"((ch|chan|channel|ai|ain|col|column|bridge|gauge|gage|in|input|sensor|signal|out|output|volt|voltage|v|adc)?"
    r"[\s_.#-]*\d*|.*/ai\d+)",
    re.I,
)
_EXCITATION: Final = re.compile(r"exc.*|ex|v_?ex.*|v_?supply|supply.*|bridge\s*(supply|voltage)", re.I)
_TEMPERATURE: Final = re.compile(r"temp.*", re.I)
_AMOUNT: Final = re.compile(r"(?P<number>[+-]?(\d[\d.,]*|[.,]\d+)([eE][+-]?\d+)?)\s*(?P<unit>.*)")


@dataclass(frozen=True, slots=True)
class VolReading:
    """A ``.vol`` file in the course of being read.

    Attributes
    ----------
    path
        The file.
    parts
        Its text, parsed.
    notes
        What had to be taken for granted so far.
    """

    path: Path
    parts: VolText
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class VolLayout:
    """Which column of a block is what.

    Attributes
    ----------
    load, excitation
        Numbers of these columns; None for the excitation where the outputs are ratios already.
    bridges
        Numbers of the c columns of outputs.
    names
        What their headers call them.
    factors, excitation_factor
        Value of their units in V, or of ratios in mV/V.
    unit
        Unit of the load; an empty string where the header has none.
    """

    load: int
    excitation: int | None
    bridges: tuple[int, ...]
    names: tuple[str, ...]
    factors: Array
    excitation_factor: float
    unit: str


def layout_of(reading: VolReading, block: VolBlock) -> VolLayout:
    """Tell the columns of a block apart."""
    place = f"line {block.header_line}"
    heads = [split_label(label) for label in block.labels]
    load = next((i for i, (name, _) in enumerate(heads) if name.casefold().startswith("load")), 0)
    named = [i for i, (name, _) in enumerate(heads) if i != load and _EXCITATION.fullmatch(name)]
    excitation = named[-1] if named else None
    last = len(heads) if excitation is None or excitation < load else excitation
    bridges = [i for i in range(last) if i not in (load, excitation) and not _TEMPERATURE.fullmatch(heads[i][0])]
    ratios = [bool(re.search(r"/", heads[i][1])) for i in bridges]
    if excitation is None and not (ratios and all(ratios)):
        expected = len(reading.parts.capacities) or 6
        if len(bridges) != expected + 1:
            raise ReadError(
                reading.path,
                place,
                f"block [{block.title}] has no column of the excitation voltage ({', '.join(block.labels)[:120]}); "
                f"needed: load, {expected} bridges, excitation, for example Exct.[Volt], or outputs in mV/V",
            )
        excitation = bridges.pop()
        ratios.pop()
    if not bridges:
        raise ReadError(
            reading.path, place, f"block [{block.title}] has no column of a bridge; needed: load, bridges, excitation"
        )
    if any(ratios) and not all(ratios):
        raise ReadError(reading.path, place, "has outputs in V and in mV/V side by side; allowed: one or the other")
    kind = "mV/V" if all(ratios) else "V"
    unused = [block.labels[i] for i in range(len(heads)) if i not in (load, excitation, *bridges)]
    if unused:
        reading.notes.append(f"columns that are not used: {', '.join(unused)}")
    if not all(heads[i][1] for i in bridges):
        reading.notes.append("headers of bridges have no unit: taken as V")
    supply = 1.0
    if excitation is not None and kind == "V":
        supply = _factor(reading, block, column=excitation, unit=heads[excitation][1], kind="V")
    return VolLayout(
        load=load,
        excitation=None if kind == "mV/V" else excitation,
        bridges=tuple(bridges),
        names=tuple(heads[i][0] for i in bridges),
        factors=np.array([_factor(reading, block, column=i, unit=heads[i][1], kind=kind) for i in bridges]),
        excitation_factor=supply,
        unit=heads[load][1],
    )


def _factor(reading: VolReading, block: VolBlock, *, column: int, unit: str, kind: str) -> float:
    """Value of a column's unit in V or mV/V; no unit stands for V."""
    try:
        return conversion(unit or "V", expected=kind).factor
    except ValueError as error:
        where = f"line {block.header_line}, column {column + 1} ({block.labels[column]!r})"
        raise ReadError(reading.path, where, str(error)) from None


@dataclass(frozen=True, slots=True)
class Naming:
    """Names of the components in the order of the columns, and which of them each block loads."""

    components: tuple[str, ...]
    blocks: tuple[int, ...]


def naming_of(reading: VolReading, layout: VolLayout) -> Naming:
    """Match blocks to columns."""
    loaded = list(dict.fromkeys(load_key(block.component) for block in reading.parts.blocks))
    titles = {key: next(b.component for b in reading.parts.blocks if load_key(b.component) == key) for key in loaded}
    columns = len(layout.names)
    if len(loaded) > columns:
        raise ReadError(
            reading.path,
            "",
            f"has blocks of {len(loaded)} components ({', '.join(titles.values())}), but columns of {columns} bridges "
            f"({', '.join(layout.names)}); every component needs a bridge",
        )
    generic = all(_GENERIC.fullmatch(name) for name in layout.names) or len(set(layout.names)) < columns
    if generic:
        names, found = _by_position(reading, titles, columns=columns)
    else:
        found = _by_name(reading, layout.names, titles=titles)
        loading = {i: titles[key] for key, i in found.items()}
        names = tuple(
            loading.get(i, name) if _GENERIC.fullmatch(name) else name for i, name in enumerate(layout.names)
        )
        names = names if len(set(names)) == columns else layout.names
    missing = [names[i] for i in range(columns) if i not in found.values()]
    if missing:
        reading.notes.append(f"no block loads {', '.join(missing)}: its loads are zero throughout")
    return Naming(tuple(names), tuple(found[load_key(block.component)] for block in reading.parts.blocks))


def _by_position(
    reading: VolReading, titles: dict[str, str], *, columns: int
) -> tuple[tuple[str, ...], dict[str, int]]:
    """Name bridges whose headers say nothing, by the order of the blocks or of the maximal loads."""
    listed = [load_key(entry.key) for entry in reading.parts.capacities]
    complete = len(set(listed)) == columns and set(titles) <= set(listed)
    if complete and len(titles) < columns:
        reading.notes.append("the headers do not name the bridges: taken in the order of the maximal loads")
        names = tuple(titles.get(key, entry.key) for key, entry in zip(listed, reading.parts.capacities, strict=True))
        return names, {key: listed.index(key) for key in titles}
    if complete and listed != list(titles):
        warn_quality(
            f"{reading.path}: the headers do not name the bridges, and the blocks come in another order "
            f"({', '.join(titles.values())}) than the maximal loads "
            f"({', '.join(entry.key for entry in reading.parts.capacities)}); the bridges are taken "
            "in the order of the blocks, so outputs may be given to the wrong component"
        )
    reading.notes.append("the headers do not name the bridges: taken in the order in which the blocks first appear")
    spare = [f"bridge {i + 1}" for i in range(len(titles), columns)]
    return (*titles.values(), *spare), {key: i for i, key in enumerate(titles)}


def _by_name(reading: VolReading, names: Sequence[str], *, titles: dict[str, str]) -> dict[str, int]:
    """Find the column of every loaded component by its name, and of what is left over by order."""
    keys = [load_key(name) for name in names]
    found: dict[str, int] = {}
    for key, title in titles.items():
        if title in names:
            found[key] = list(names).index(title)
        elif keys.count(key) == 1:
            found[key] = keys.index(key)
    left = [key for key in titles if key not in found]
    free = [i for i in range(len(names)) if i not in found.values()]
    if len(left) > len(free):
        raise ReadError(
            reading.path, "", f"blocks {', '.join(titles)} and bridges {', '.join(names)} do not belong together"
        )
    if left:
        pairs = ", ".join(f"[{titles[key]}] to {names[i]}" for key, i in zip(left, free, strict=False))
        reading.notes.append(f"blocks were given to bridges by their order: {pairs}")
        if len(left) < len(free):
            warn_quality(
                f"{reading.path}: blocks were given to bridges of other names by their order ({pairs}), and there are "
                "more bridges than blocks; the loads may stand at the wrong component"
            )
    return found | dict(zip(left, free, strict=False))


@dataclass(frozen=True, slots=True)
class Amount:
    """A capacity as the file has it; NaN where the number is missing."""

    value: float
    unit: str


def amount_in(text: str) -> Amount:
    """Read a number and its unit; commas between groups of three digits are none of the number's."""
    match = _AMOUNT.fullmatch(text.strip())
    if match is None:
        return Amount(np.nan, text.strip())
    number = match["number"].rstrip(",.")
    if re.fullmatch(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?", number):
        number = number.replace(",", "")
    try:
        value = float(number.replace(",", "."))
    except ValueError:
        value = np.nan
    return Amount(abs(value), match["unit"].strip())


def amounts_of(reading: VolReading, components: tuple[str, ...]) -> list[Amount | None]:
    """Maximal load of every component: by name, and by position for what is left over."""
    entries = list(reading.parts.capacities)
    keys = [load_key(entry.key) for entry in entries]
    found: dict[int, Entry] = {}
    for i, name in enumerate(components):
        if load_key(name) in keys:
            found[i] = entries[keys.index(load_key(name))]
    left = [i for i in range(len(components)) if i not in found]
    free = [entry for entry in entries if entry not in found.values()]
    if len(left) == len(free):
        found |= dict(zip(left, free, strict=True))
    return [amount_in(found[i].value) if i in found else None for i in range(len(components))]


@dataclass(frozen=True, slots=True)
class LoadUnits:
    """Units of the loads.

    Attributes
    ----------
    components
        Unit of each component.
    moments
        Which components are moments.
    blocks
        Unit of the loads in each block.
    """

    components: tuple[str, ...]
    moments: tuple[bool, ...]
    blocks: tuple[str, ...]


def load_units_of(
    reading: VolReading, naming: Naming, *, layouts: Sequence[VolLayout], amounts: Sequence[Amount | None]
) -> LoadUnits:
    """Find unit and kind of every load: from the headers of its blocks, else from its maximal load."""
    units = ["" for _ in naming.components]
    kinds = ["" for _ in naming.components]
    blocks: list[str] = []
    for block, layout, component in zip(reading.parts.blocks, layouts, naming.blocks, strict=True):
        amount = amounts[component]
        label = block.labels[layout.load]
        unit = layout.unit or units[component] or (amount.unit if amount else "")
        where = f"line {block.header_line}, column {layout.load + 1} ({label!r})"
        try:
            kind = load_conversion(unit).unit
        except ValueError as error:
            raise ReadError(reading.path, where, f"load of block [{block.title}]: {error}") from None
        name = naming.components[component]
        if amount and kind != load_unit_of(name) and load_unit_of(name) == _kind(amount.unit):
            warn_quality(
                f"{reading.path}: {where}: block [{block.title}] has its loads in [{unit}], but {name} is a "
                f"{'moment' if kind == 'N' else 'force'} by its name and its maximal load [{amount.unit}]; the loads "
                f"are taken in [{amount.unit}], so check them"
            )
            unit, kind = amount.unit, load_conversion(amount.unit).unit
        if kinds[component] not in ("", kind):
            raise ReadError(
                reading.path,
                where,
                f"unit [{unit}] of block [{block.title}] is not of the kind of the other blocks of {name}, "
                f"[{units[component]}]; allowed: a force or a moment throughout",
            )
        units[component], kinds[component] = units[component] or unit, kind
        blocks.append(unit)
    for i, name in enumerate(naming.components):
        if not kinds[i]:
            amount = amounts[i]
            units[i], kinds[i] = _unloaded(reading, name, unit=amount.unit if amount else "")
    return LoadUnits(tuple(units), tuple(kind == "N*m" for kind in kinds), tuple(blocks))


def _kind(unit: str) -> str | None:
    try:
        return load_conversion(unit).unit
    except ValueError:
        return None


def _unloaded(reading: VolReading, name: str, *, unit: str) -> tuple[str, str]:
    """Unit and kind of a component without loads."""
    kind = _kind(unit)
    if kind is not None:
        return unit, kind
    kind = load_unit_of(name) or "N"
    reading.notes.append(f"unit of {name} is not in the file: taken as {kind}")
    return kind, kind


def stated_capacities(
    reading: VolReading, naming: Naming, *, amounts: Sequence[Amount | None], units: LoadUnits
) -> Array:
    """Maximal loads that the file states [N, N*m], NaN where it does not."""
    stated = np.full(len(amounts), np.nan)
    for i, amount in enumerate(amounts):
        if amount is None or not amount.value > 0:
            continue
        expected = "N*m" if units.moments[i] else "N"
        try:
            change = conversion(amount.unit, expected=expected) if amount.unit else None
        except ValueError:
            change = None
        if change is None:
            change = conversion(units.components[i], expected=expected)
            given = f"in [{amount.unit}]" if amount.unit else "without a unit"
            reading.notes.append(
                f"capacity of {naming.components[i]} is given {given}: taken as {amount.value:g} "
                f"{units.components[i]}, the unit of its loads"
            )
        stated[i] = float(change.inside(amount.value))
    return stated


def block_outputs(reading: VolReading, block: VolBlock, *, layout: VolLayout, first: VolLayout) -> Array:
    """Outputs of a block, shape (n, c) [mV/V], in the order of the columns of the first block."""
    values = (block.values[:, layout.bridges] * layout.factors)[:, _order(reading, block, layout=layout, first=first)]
    if layout.excitation is None:
        return values
    excitation = block.values[:, layout.excitation] * layout.excitation_factor
    return ratio_outputs(reading.path, values, excitation=excitation, lines=block.lines)


def _order(reading: VolReading, block: VolBlock, *, layout: VolLayout, first: VolLayout) -> list[int]:
    """Where the columns of the first block stand among the columns of another."""
    if len(layout.names) != len(first.names):
        raise ReadError(
            reading.path,
            f"line {block.header_line}",
            f"block [{block.title}] has {len(layout.names)} bridges, the first block {len(first.names)}; all blocks "
            "need the same bridges",
        )
    if len(set(layout.names)) == len(layout.names) and set(layout.names) == set(first.names):
        return [layout.names.index(name) for name in first.names]
    if layout.names != first.names:
        reading.notes.append("headers of the blocks name the bridges differently: taken by position")
    return list(range(len(layout.names)))
