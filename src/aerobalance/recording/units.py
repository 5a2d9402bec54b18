"""Units at the edge: what a file says, turned into the SI units used inside.

Inside, forces are in N, moments in N*m, accelerations in m/s^2 and rad/s^2, angles in rad, gauge outputs in mV/V,
voltages in V, temperatures in degC, times in s, frequencies in Hz. `conversion` also tells units apart that have the
same dimension but do not mean the same (an angle, a ratio and a gauge output), and reads ``g`` and ``lb`` by what is
expected.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.recording.channel import QUANTITIES, Array, unit_inside
from aerobalance.recording.components import COMPONENTS, is_gauge
from aerobalance.recording.errors import WITH_A_MATRIX, quiet_libraries

if TYPE_CHECKING:
    import pint

ALLOWED: Final = {
    "N": "N, kN, lbf, kgf",
    "N*m": "N*m, kN*m, in-lbf, ft-lbf, kgf*m",
    "m/s^2": "m/s^2, m/s2, g",
    "rad/s^2": "rad/s^2, rad/s2, deg/s^2",
    "m/s": "m/s, mm/s, km/h, ft/s",
    "m": "m, mm, in, ft",
    "rad": "deg, rad, mrad",
    "rad/s": "rad/s, deg/s",
    "mV/V": "mV/V, uV/V, V/V",
    "s": "s, ms, us, min",
    "Hz": "Hz, kHz",
    "1": "1, %",
    "V": "V, mV, uV, kV",
    "degC": "degC, degF, K",
    "kg": "kg, g, t, lb",
    "kg*m": "kg*m, g*m, lb*ft",
}
"""Units that may be given where the unit inside is the key; others of the same kind are read too."""

_MEASURES: Final = {
    "N": "a force",
    "N*m": "a moment",
    "m/s^2": "an acceleration",
    "rad/s^2": "an angular acceleration",
    "m/s": "a velocity",
    "m": "a length",
    "rad": "an angle",
    "rad/s": "a rate of turn",
    "mV/V": "a gauge output",
    "s": "a time",
    "Hz": "a frequency",
    "1": "a ratio",
    "V": "a voltage",
    "degC": "a temperature",
    "kg": "a mass",
    "kg*m": "a mass times its lever",
}

_EXPECTED: Final = {
    **QUANTITIES,
    "time": "s",
    "frequency": "Hz",
    "amplitude": "1",
    "phase": "rad",
}

_SPELLINGS: Final = {
    "Nm": "N*m",
    "kNm": "kN*m",
    "Ncm": "N*cm",
    "Nmm": "N*mm",
    "sec": "s",
    "secs": "s",
    "msec": "ms",
    "usec": "us",
    "lbs": "lb",
    "%": "percent",
    "1": "dimensionless",
    "-": "dimensionless",
    "G": "g",
    "gn": "g",
    "g0": "g",
    "g_n": "g",
    "g_0": "g",
    "V/V": "volt/V",
    "degs": "deg",
    "Volt": "V",
    "Volts": "V",
    "deg*C": "degC",
    "deg*F": "degF",
}

_WORDS: Final = (
    (re.compile(r"(?<=[A-Za-z])\.$"), ""),
    (re.compile(r"(?<![A-Za-z])(lbs|Lbs?|LBS?|pounds?|Pounds?)(?![A-Za-z])"), "lb"),
    (re.compile(r"(?<![A-Za-z])(lbsf|lbfs|LBF|Lbf)(?![A-Za-z])"), "lbf"),
    (re.compile(r"(?<![A-Za-z])(IN|In|inch|Inch|inches|Inches|INCHES)(?![A-Za-z])"), "in"),
    (re.compile(r"(?<![A-Za-z])(FT|Ft)(?![A-Za-z])"), "ft"),
    (re.compile(r"(?<![A-Za-z])(in|ft)(lbf?)s?(?![A-Za-z])"), r"\1*\2"),
    (re.compile(r"(?<![A-Za-z])(Volts?|VOLTS?|volts)(?![A-Za-z])"), "volt"),
)
"""Words for units in test halls: plurals, capitals, and dots that only end an abbreviation."""

_IMPLIED: Final = {
    ("g", "m/s^2"): "standard_gravity",
    ("mg", "m/s^2"): "millistandard_gravity",
    ("lb", "N"): "lbf",
    ("in*lb", "N*m"): "in*lbf",
    ("lb*in", "N*m"): "in*lbf",
    ("ft*lb", "N*m"): "ft*lbf",
    ("lb*ft", "N*m"): "ft*lbf",
}
"""Units that name a mass in the SI but a force or an acceleration in a test hall."""

_USUAL: Final = {
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "lbf": ("N", 4.4482216152605005),
    "N*m": ("N*m", 1.0),
    "kN*m": ("N*m", 1e3),
    "m/s**2": ("m/s^2", 1.0),
    "standard_gravity": ("m/s^2", 9.80665),
    "rad/s**2": ("rad/s^2", 1.0),
    "rad": ("rad", 1.0),
    "deg": ("rad", 0.017453292519943295),
    "rad/s": ("rad/s", 1.0),
    "mV/V": ("mV/V", 1.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "Hz": ("Hz", 1.0),
    "dimensionless": ("1", 1.0),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "kg": ("kg", 1.0),
    "m": ("m", 1.0),
    "degC": ("degC", 1.0),
}
"""Kind and factor of units that most files hold, as the unit library has them, which takes a third of a second."""

_READABLE: Final = re.compile(r"[A-Za-z_%0-9*/^(). -]{1,40}")
_WILD_POWER: Final = re.compile(r"\*\*(?!-?[1-4](?![0-9.*(]))|\d{4}")
"""Powers that no unit has, and that a parser could take for ever over."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """How values in a file's unit become values in the unit used inside.

    Attributes
    ----------
    unit
        Unit inside; the file's own where the program has no use for the quantity.
    factor
        Value of one of the file's units in `unit`.
    offset
        What the file's scale reads where the value inside is zero: 32 for degF, 273.15 for K, and 0 for whatever is
        no temperature.
    """

    unit: str
    factor: float
    offset: float = 0.0

    def inside(self, values: ArrayLike) -> Array:
        """Turn values of a file into values inside."""
        given = np.asarray(values, dtype=np.float64)
        if self.offset:
            given = given - self.offset
        if self.factor == 1.0:
            return given
        inverse = 1 / self.factor
        # Dividing by 1000 keeps 0.625 ms the float 0.000625 s; multiplying by 0.001 would not.
        return given / round(inverse) if _whole(inverse) else given * self.factor

    def outside(self, values: ArrayLike) -> Array:
        """Turn values inside into values of a file."""
        given = np.asarray(values, dtype=np.float64)
        if self.factor != 1.0:
            inverse = 1 / self.factor
            given = given * round(inverse) if _whole(inverse) else given / self.factor
        return given + self.offset if self.offset else given


def _whole(number: float) -> bool:
    return number >= 1 and abs(number - round(number)) < 1e-9 * number


def expected_unit(name: str) -> str | None:
    """Return the unit that a column of this name has inside; None where any unit will do.

    A column ``u_NAME`` is the standard uncertainty of ``NAME`` and has its unit. A gauge output may be in V as well,
    as long as it has not been divided by the excitation; see `conversion_for`.
    """
    bare = name.removeprefix("u_")
    return "mV/V" if is_gauge(bare) else unit_inside(bare) or _EXPECTED.get(bare)


def edge_unit(name: str, inside: str) -> str:
    """Return the unit in which a quantity is written where its file gave none: degrees for angles."""
    return "deg" if expected_unit(name) == "rad" else inside


def conversion(text: str, *, expected: str | None = None) -> Conversion:
    """Find the conversion from a unit, as written in a file, to the unit used inside.

    Parameters
    ----------
    text
        The unit as the file has it.
    expected
        The unit inside, a key of `ALLOWED`; None when any unit will do, which then is kept as it is.

    Raises
    ------
    ValueError
        The unit is unknown, or is not of the kind expected; the message says what is allowed.
    """
    if expected is not None and expected not in ALLOWED:
        raise ValueError(f"expected must be one of {', '.join(ALLOWED)}, not {expected!r}")
    given = text.strip()
    spelled = _spelled(given)
    spelled = _IMPLIED.get((spelled, expected or ""), spelled)
    hint = f"; allowed: {ALLOWED[expected]}" if expected else "; examples: N, N*m, m/s^2, deg, mV/V, s, Hz, 1"
    if not _is_unit(spelled):
        raise ValueError(f"unknown unit [{given}]{hint}")
    if expected is None:
        return Conversion(given, 1.0)
    kind = _kind(spelled)
    if kind != expected:
        found = f"is {_MEASURES[kind]}" if kind else f"is not {_MEASURES[expected]}"
        raise ValueError(f"unit [{given}] {found}, but {_MEASURES[expected]} is expected{hint}")
    if spelled in _USUAL:
        return Conversion(*_USUAL[spelled])
    return _of_temperature(spelled) if expected == "degC" else Conversion(expected, _factor(spelled, expected))


def conversion_for(name: str, text: str) -> Conversion:
    """Find the conversion from a unit, as written in a file, for a column of this name.

    A gauge output in plain volts stays in V inside. An uncertainty of a temperature is a difference: 1 K is 1 degC.

    Parameters
    ----------
    name
        Name of the column, such as ``AF``, ``rN1`` or ``u_AF``.
    text
        The unit as the file has it.

    Raises
    ------
    ValueError
        The unit is unknown, or is not of the kind that the name asks for; the message says what is allowed.
    """
    bare = name.removeprefix("u_")
    if is_gauge(bare):
        with contextlib.suppress(ValueError):
            return conversion(text, expected="V")
        try:
            return conversion(text, expected="mV/V")
        except ValueError as error:
            raise ValueError(f"{error}; or V, mV, uV beside a channel excitation [V]") from None
    try:
        found = conversion(text, expected=expected_unit(name))
    except ValueError as error:
        if bare not in COMPONENTS or not _electric(text):
            raise
        raise ValueError(
            f"{error}; the output of a bridge is named r{bare}, and to have loads of it {WITH_A_MATRIX}"
        ) from None
    return replace(found, offset=0.0) if bare != name else found


def _electric(text: str) -> bool:
    """Return whether a text is the unit of a gauge output or of a voltage."""
    return readable(text) and _kind(_spelled(text.strip())) in {"mV/V", "V"}


def readable(text: str) -> bool:
    """Return whether a text is a unit."""
    return _is_unit(_spelled(text.strip()))


@cache
def _registry() -> pint.UnitRegistry[float]:
    import pint  # noqa: PLC0415 - takes a third of a second, and only reading and writing files need it

    return pint.UnitRegistry(cache_folder=None)


@lru_cache(maxsize=1024)  # every part of a long record asks for the same few
def _spelled(text: str) -> str:
    """Rewrite the usual spellings of test halls into those of the unit library."""
    text = text.replace("⁻", "^-").replace("^-²", "^-2").replace("^-¹", "^-1")
    for old, new in (("µ", "u"), ("μ", "u"), ("°C", "degC"), ("°", "deg"), ("·", "*"), ("⋅", "*"), ("•", "*")):
        text = text.replace(old, new)
    for old, new in (("²", "^2"), ("³", "^3"), ("−", "-"), ("‰", "permille")):
        text = text.replace(old, new)
    for spelt, unit in _WORDS:
        text = spelt.sub(unit, text)
    text = re.sub(r"(?<=[A-Za-z0-9])[ .]*[-. ](?=[A-Za-z])", "*", text)
    text = re.sub(r"(?<![A-Za-z0-9_^])([A-Za-z]+)(-?[1-4])(?![0-9A-Za-z_])", r"\1^\2", text)
    text = text.replace("**", "^").replace("^", "**").replace(" ", "")
    text = _SPELLINGS.get(text, text)
    return text.replace("Nm/", "N*m/")


def _is_unit(spelled: str) -> bool:
    return spelled in _USUAL or _parsed(spelled) is not None


@cache
def _parsed(text: str) -> pint.Unit | None:
    """Parse a unit; None where it is none."""
    if not _READABLE.fullmatch(text) or _WILD_POWER.search(text):
        return None
    with quiet_libraries():
        try:
            return _registry().parse_units(text)
        except Exception:  # noqa: BLE001 - the parser of the unit library fails in a dozen ways on text that is no unit
            return None


_ROOTS: Final = {
    "N": "kg*m/s**2",
    "N*m": "kg*m**2/s**2",
    "m/s^2": "m/s**2",
    "rad/s^2": "rad/s**2",
    "rad/s": "rad/s",
    "m/s": "m/s",
    "m": "m",
    "s": "s",
    "Hz": "1/s",
    "rad": "rad",
    "1": "dimensionless",
    "V": "V",
    "degC": "K",
    "kg": "kg",
    "kg*m": "kg*m",
}


@cache
def _kind(spelled: str) -> str | None:
    """Return which of the units inside a unit belongs to; None if to none."""
    if spelled in _USUAL:
        return _USUAL[spelled][0]
    unit = _registry().parse_units(spelled)
    if re.fullmatch(r"\(?[a-zA-Z]*(V|volt)\)?/\(?(V|volt)\)?", spelled):
        return "mV/V"
    if "decibel" in str(unit) or "neper" in str(unit):
        return None
    root = _registry().get_root_units(unit)[1]
    for kind, text in _ROOTS.items():
        if root == _registry().get_root_units(_registry().parse_units(text))[1]:
            return kind
    return None


@cache
def _factor(spelled: str, kind: str) -> float:
    """Value of one unit in the unit inside."""
    registry = _registry()
    unit = registry.parse_units(spelled)
    if kind == "mV/V":
        return _root(unit) * 1e3
    inside = registry.parse_units({"m/s^2": "m/s**2", "rad/s^2": "rad/s**2", "1": "dimensionless"}.get(kind, kind))
    factor = _root(unit) / _root(inside)
    short = float(f"{factor:.12g}")
    # A factor that is a rounding error from a short decimal (N*m by way of grams) is that decimal.
    return short if abs(short - factor) < 4e-16 * factor else factor


def _of_temperature(spelled: str) -> Conversion:
    """Find factor and offset between a scale of temperature and degC."""
    unit = _registry().parse_units(spelled)
    zero, one = (float(str(_registry().Quantity(value, "degC").to(unit).magnitude)) for value in (0.0, 1.0))
    # The scales are defined by short decimals; the library returns them with rounding errors.
    return Conversion("degC", 1 / float(f"{one - zero:.10g}"), float(f"{zero:.10g}"))


def _root(unit: pint.Unit) -> float:
    """Value of one unit in the root units of the library."""
    return float(str(_registry().get_root_units(unit)[0]))
