"""Names, units and capacities of the loads in a calibration: what all files of load schedules have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.balance.load_formats import BalanceType, role_of
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError
from aerobalance.recording.units import ALLOWED, Conversion, conversion

Capacities = Mapping[str, tuple[float, str]]
"""Largest allowed load by component: value and unit."""

UNITS_ASSUMED: Final = (
    "the units of all loads are as the file says, which no capacity shows: lbf called N make all forces of a run 4.4 "
    "times too small, kgf 9.8 times, and in-lbf called N*m all moments 8.9 times too large. A capacity of the data "
    "sheet for each load shows it, and for forces the mass by weighing beside that on scales"
)
"""What is taken for granted of a schedule without capacities."""

_SIDES: Final = (("forward", "fwd"), ("front", "fwd"), ("fore", "fwd"), ("rear", "aft"), ("back", "aft"))
_ENDINGS: Final = ("bendingmoment", "moment", "force", "load", "bridge", "gauge", "gage")
_SHORT: Final = {
    **{"a": "AF", "fa": "AF", "fx": "AF", "l": "RM", "rollmoment": "RM"},
    **{"n": "NF", "fz": "NF", "normal": "NF", "s": "SF", "y": "SF", "fy": "SF", "side": "SF"},
    **{"my": "PM", "pitch": "PM", "pitching": "PM", "mz": "YM", "yaw": "YM", "yawing": "YM", "rolling": "RM"},
    **{"nf1": "forward normal", "nf2": "aft normal", "sf1": "forward side", "sf2": "aft side"},
    **{"fwdpitching": "forward pitch", "aftpitching": "aft pitch", "fwdyawing": "forward yaw", "aftyawing": "aft yaw"},
}
_TYPES: Final[Mapping[str, BalanceType]] = {
    **dict.fromkeys(("forward normal", "aft normal", "forward side", "aft side"), "force"),
    **dict.fromkeys(("forward pitch", "aft pitch", "forward yaw", "aft yaw"), "moment"),
    **dict.fromkeys(("NF", "PM", "SF", "YM"), "direct"),
}
LEAST_EXCITATION: Final = 1e-6
"""Excitation voltages below this are none [V]."""


def load_key(name: str) -> str:
    """Return what names of the same load have in common: Ax, Axial and AxialForce all give AF.

    Names that stand for no known load give themselves, in small letters without spaces and signs.
    """
    plain = "".join(sign for sign in name.casefold() if sign.isalnum())
    for old, new in _SIDES:
        if plain.startswith(old):
            plain = new + plain.removeprefix(old)
    for text in (plain, *(plain.removesuffix(end) for end in _ENDINGS if plain.endswith(end))):
        role = role_of(text) or _SHORT.get(text)
        if role:
            return role
    return plain


def balance_type_of(names: Sequence[str]) -> BalanceType:
    """Return from the names of the loads which loads the gauges measure."""
    found = {_TYPES[key] for key in map(load_key, names) if key in _TYPES}
    return found.pop() if len(found) == 1 else "unknown"


def load_unit_of(name: str) -> str | None:
    """Return from the name of a load whether it is a force or a moment: N or N*m; None where the name is not known."""
    key = load_key(name)
    if key in ("RM", "PM", "YM") or key.endswith((" pitch", " yaw")):
        return "N*m"
    return "N" if key in ("AF", "NF", "SF") or key in _TYPES else None


def load_conversion(unit: str) -> Conversion:
    """Find the conversion from a unit of force or moment to N or N*m.

    Raises
    ------
    ValueError
        The unit is of neither kind; the message says what is allowed.
    """
    for expected in ("N", "N*m"):
        try:
            return conversion(unit, expected=expected)
        except ValueError:
            continue
    raise ValueError(
        f"unit [{unit.strip()}] is neither a force nor a moment; allowed: {ALLOWED['N']}, lb; {ALLOWED['N*m']}, in-lb"
    )


@dataclass(frozen=True, slots=True)
class CapacityTable:
    """Capacities of the components of a schedule, and what had to be taken for granted.

    Attributes
    ----------
    values
        Shape (c,) [N, N*m].
    assumptions
        Which of them the file did not say.
    """

    values: Array
    assumptions: tuple[str, ...]


def settle_capacities(
    components: Sequence[str], loads: Array, *, moments: Sequence[bool], stated: Array, given: Capacities | None
) -> CapacityTable:
    """Settle the capacity of every component: as given by the caller, else as stated, else the largest load.

    Where none is given or stated nothing stands against the units of the loads, which is among what is assumed.

    Parameters
    ----------
    components
        Names of the c loads.
    loads
        Loads applied, shape (n, c) [N, N*m].
    moments
        Which components are moments.
    stated
        What the file says, shape (c,) [N, N*m]; NaN where it says nothing.
    given
        What the caller says, by component.

    Raises
    ------
    ValueError
        A capacity is given for no component, in a wrong unit, or is not positive.
    """
    values, assumptions = np.array(stated, dtype=np.float64), []
    overrides = _given(components, moments, given=given or {})
    largest = np.abs(loads).max(axis=0, initial=0.0)
    for i, name in enumerate(components):
        unit = "N*m" if moments[i] else "N"
        if i in overrides:
            values[i] = overrides[i]
        elif not (np.isfinite(values[i]) and values[i] > 0):
            values[i] = largest[i] if largest[i] > 0 else 1.0
            what = (
                "its largest load" if largest[i] > 0 else "there is no load either, so it stands for percentages only"
            )
            assumptions.append(f"capacity of {name} is not in the file: taken as {values[i]:.6g} {unit}, {what}")
    if len(assumptions) == len(components) > 0:
        assumptions.append(UNITS_ASSUMED)
    return CapacityTable(values, tuple(assumptions))


def _given(components: Sequence[str], moments: Sequence[bool], *, given: Capacities) -> dict[int, float]:
    """Capacities that the caller gave, by number of the component."""
    keys = [load_key(name) for name in components]
    found = {}
    for name, (value, unit) in given.items():
        matches = [i for i, known in enumerate(components) if known == name] or [
            i for i, key in enumerate(keys) if key == load_key(name)
        ]
        if len(matches) != 1:
            raise ValueError(f"a capacity is given for {name!r}; the loads are {', '.join(components)}")
        i = matches[0]
        try:
            inside = float(conversion(unit, expected="N*m" if moments[i] else "N").inside(value))
        except ValueError as error:
            raise ValueError(f"capacity of {name}: {error}") from None
        if not 0 < inside < np.inf:
            raise ValueError(f"capacity of {name} must be positive and finite, not {value} {unit}")
        found[i] = inside
    return found


def ratio_outputs(path: Path, volts: Array, *, excitation: Array, lines: Sequence[int]) -> Array:
    """Divide bridge voltages by the excitation: outputs in mV/V.

    Parameters
    ----------
    path
        The file, for messages.
    volts
        Shape (n, c) [V].
    excitation
        Shape (n,) [V].
    lines
        Line of every row.

    Raises
    ------
    ReadError
        The excitation is zero in some row.
    """
    dead = np.flatnonzero(~(np.abs(excitation) > LEAST_EXCITATION))
    if dead.size:
        raise ReadError(
            path,
            f"line {lines[dead[0]]}",
            f"the excitation is {excitation[dead[0]]:.3g} V ({dead.size} row(s) like it); outputs are voltages over "
            "excitation, so it must be a voltage other than zero",
        )
    return volts / excitation[:, None] * 1e3
