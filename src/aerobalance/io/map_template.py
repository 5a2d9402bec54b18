"""A channel map to be completed by hand, made from what a foreign file says of its columns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from aerobalance.channel import QUANTITIES
from aerobalance.components import is_gauge
from aerobalance.io.columns import Heading
from aerobalance.io.units import readable


def map_text(file: Path, headings: Sequence[Heading], *, text: bool = True) -> str:
    """Write a channel map for a foreign file, made from its headings, to be completed by hand.

    Parameters
    ----------
    file
        The foreign file.
    headings
        What it says of its columns.
    text
        Whether it is a text file, for which separator and the like may be given.

    Returns
    -------
    str
        TOML with comments; every column that is not the time is a commented table.
    """
    clocked = any(heading.clocked for heading in headings)
    time = None if clocked else next((heading for heading in headings if _is_time(heading)), None)
    blocks = [_HEAD.format(names=", ".join(QUANTITIES), file=_quoted(file.name)[1:-1])]
    if clocked:
        blocks.append(_OWN_CLOCKS)
    elif time is None:
        blocks.append(
            "# time = 1          # header text or number of the time column, or give the rate\nrate = 1000.0  # Hz"
        )
    else:
        blocks.append(f"time = {_quoted(time.label)}")
        if not time.unit:
            blocks.append('time_unit = "s"')
    blocks.append(f"{_TEXT_KEYS}\n\n{_CHANNEL_KEYS}" if text else f"\n{_CHANNEL_KEYS}")
    named: set[str] = set()
    for heading in headings:
        if heading is not time:
            known = heading.usable and heading.name not in named
            known = known and (heading.name in QUANTITIES or is_gauge(heading.name))
            named.add(heading.name)
            blocks.append(_block(heading, known=known))
    return "\n".join(blocks)


def _is_time(heading: Heading) -> bool:
    return heading.name.lower().startswith("time") and (
        not heading.unit or (readable(heading.unit) and heading.unit in ("s", "ms", "us", "min", "sec"))
    )


def _quoted(text: str) -> str:
    """Write a TOML string."""
    escaped = "".join(
        "\\\\" if sign == "\\" else '\\"' if sign == '"' else sign if sign.isprintable() else f"\\u{ord(sign):04x}"
        for sign in text
    )
    return f'"{escaped}"'


def _block(heading: Heading, *, known: bool) -> str:
    label, unit = heading.label, heading.unit
    key = heading.name if known else f"column_{heading.number}"
    note = "".join(sign if sign.isprintable() else " " for sign in heading.note)
    lines = [f"[channels.{key}]" + (f"  # {note}" if note else "")]
    lines.append(f"column = {_quoted(label) if label else heading.number}")
    lines.append(f"unit = {_quoted(unit)}" if unit else 'unit = "N"  # the header does not say it')
    return "\n".join(["", *(line if known else f"# {line}" for line in lines)])


_HEAD: Final = """\
# Channel map for {file}.
# Rename each table that is needed to what the channel is, and remove the "# " before it:
#   {names}
# and r with any other component as the balance names it (rN1, rAxial) for a gauge output.
# Any other name is passed on untouched. Columns without a table are ignored.

[file]"""

_OWN_CLOCKS: Final = """\
# The file states the rate of every channel; the fastest of those below gives the clock, slower ones are interpolated.
# time = "group/channel"  # only where that is wrong: a channel that is the time, or
# rate = 1000.0           # samples per second, for channels of one length"""

_TEXT_KEYS: Final = """\
# separator = "tab"   # comma, semicolon, tab, space; recognised if left out
# decimal = "."       # or ","
# header_line = 1     # 0: no header, columns by number
# skip_lines = 0      # lines between the header and the first row of numbers
# encoding = "utf-8" """

_CHANNEL_KEYS: Final = """\
# Every channel may have, beside column and unit:
#   scale = 1.0, offset = 0.0, sign = 1   value = sign * (scale * cell + offset), in unit
#   delay = 0.0                 time by which the readings lag the clock [s]
#   noise = 0.1                 standard uncertainty of one reading, in unit; estimated if left out
#   relative_uncertainty = 0.0  standard uncertainty of the gain [1]
#   zero_uncertainty = 0.0      standard uncertainty of the zero, in unit
#   derivative = 0              1: a velocity, 2: a position, to be turned into an acceleration
#   filter = { kind = "butterworth", order = 8, corner = "500 Hz" }   analog low-pass, or kind = "bessel"; is undone
#   cross_axis = { ground_acceleration_z = 0.02 }   of an accelerometer, to another; or { value = 0, u = 0.02 }
#   place = [0.5, 0.0, 0.1], axis = "up"   of ground_acceleration*: aft, right, up of the balance's centre [m], and
#                               which way it reads positive: aft, right, up or [aft, right, up]; place_uncertainty [m]
#   coupling = "kinematic"      or "dc" (reads gravity too) or "ac" (then corner = high-pass corner [Hz])
# and a gauge output (rAF, rN1) moreover:
#   excitation = 10.0           nominal [V], for outputs in V where the excitation was not recorded
#   shunt_expected = 1.0, shunt_measured = 1.0   shunt readings [mV/V], of the calibration and before this run"""
