"""A channel map to be completed by hand, made from what a foreign file says of its columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from aerobalance.io.channel_names import Proposal, proposals
from aerobalance.io.columns import Heading
from aerobalance.io.schedule_names import MARKS, mark_of
from aerobalance.io.text_clock import is_time_name, is_time_unit
from aerobalance.io.text_layout import TextLayout, separator_word
from aerobalance.io.toml_file import quoted
from aerobalance.recording.channel import QUANTITIES
from aerobalance.recording.units import readable

NO_CLOCK: Final = "# No clock found: give one of these, and remove the # before it. A load schedule needs none."
"""What a map says where its file does not tell the time."""


def map_text(file: Path, headings: Sequence[Heading], *, found: TextLayout | None = None) -> str:
    """Write a channel map for a foreign file, made from its headings, to be completed by hand.

    Parameters
    ----------
    file
        The foreign file.
    headings
        What it says of its columns.
    found
        How it is laid out, where it is a text file.

    Returns
    -------
    str
        TOML with comments; a column that is not the time is a table where its name and unit leave no doubt what it
        is, and a commented table where a person has to say it.
    """
    clocked = any(heading.clocked for heading in headings)
    time = None if clocked else _time(headings)
    blocks = [_HEAD.format(names=", ".join(QUANTITIES), file=quoted(file.name)[1:-1])]
    clock = [_OWN_CLOCKS] if clocked else _clock(headings, time, found)
    blocks += clock
    blocks += [] if found is None else _layout(found)
    blocks.append(f"\n{_CHANNEL_KEYS}")
    labels = [heading.label for heading in headings]
    headings = [heading if labels.count(heading.label) == 1 else replace(heading, label="") for heading in headings]
    others = [heading for heading in headings if time is None or heading.number != time.number]
    for heading, proposal in zip(others, proposals(others), strict=True):
        blocks.append(_block(heading, proposal, of_schedule=NO_CLOCK in clock))
    return "\n".join(blocks)


def _time(headings: Sequence[Heading]) -> Heading | None:
    told = next((heading for heading in headings if heading.time), None)
    named = (heading for heading in headings if heading.usable and is_time_name(heading.name))
    return told or next((heading for heading in named if is_time_unit(heading.unit)), None)


def _clock(headings: Sequence[Heading], time: Heading | None, found: TextLayout | None) -> list[str]:
    """Lines of the clock, as far as the file says it; never a rate that it does not state."""
    clock = None if found is None else found.clock
    stated = None if found is None else found.stated
    lines = []
    if clock is not None and clock.second_time is not None:
        second, label = clock.second_time, quoted(headings[clock.second_time].label)
        lines.append(f"# column {second + 1} ({label}) is a time too, of another rate: a map for the channels of each")
    if time is not None and not (clock is not None and clock.stamps and stated is not None):
        key = _key(time)
        note = "date and time; seconds since the first" if clock is not None and clock.stamps else ""
        if clock is not None and clock.rate is not None and not note:
            note = f"steps by {clock.interval:.6g} {clock.unit}: {clock.rate:.6g} Hz"
        lines.append(f"time = {key}" + (f"  # {note}" if note else ""))
        if not time.unit and not (clock is not None and clock.stamps):
            step = "" if clock is None else f" (it steps by {clock.interval:.6g})"
            lines.append(f'# time_unit = "?"  # unknown: the file does not say it{step}; s, ms, us or min')
        return lines
    if stated is not None:
        lines.append(f"rate = {stated.rate!r}  # Hz; line {stated.line}: {_printable(stated.text)[:60]}")
        return lines
    lines.append(NO_CLOCK)
    lines.append("# time =             # header text or number of the column of times")
    lines.append("# rate =             # samples per second [Hz]; only where nothing in the file says the time")
    return lines


def _layout(found: TextLayout) -> list[str]:
    """Lines of the layout as found; a file that is laid out otherwise needs them changed, or left out."""
    lines = [
        f"header_line = {found.header_line}" + ("  # no header: columns by number" if not found.header_line else ""),
        f"skip_lines = {found.skip_lines}  # lines between the header and the first row of numbers",
        f"separator = {quoted(separator_word(found.separator))}",
    ]
    lines.append(
        f'decimal = "{found.decimal}"' if found.decimal else '# decimal = "."  # no number at the head has one'
    )
    if found.encoding != "ascii":  # plain letters are the same in all
        lines.append(f"encoding = {quoted(found.encoding)}")
    if found.header_line:
        lines.append(
            "# Without header_line and skip_lines each file's own are recognised, where preambles differ in length."
        )
    return lines


def _key(heading: Heading) -> str:
    """How a map names a column: by its header, or its number."""
    return str(heading.number) if not heading.label or heading.label == str(heading.number) else quoted(heading.label)


def _printable(text: str) -> str:
    return "".join(sign if sign.isprintable() else " " for sign in text)


def _block(heading: Heading, proposal: Proposal, *, of_schedule: bool) -> str:
    """Lines of one column; `of_schedule` where the file may be a load schedule, as it has no clock."""
    unit, mark = heading.unit, mark_of(heading.name)
    if of_schedule and mark in _WITHOUT_UNIT and not proposal.name:
        table = f"# [channels.{mark}]  # of a load schedule"
        return "\n".join(["", table, f"# column = {_key(heading)}"])
    if not heading.usable:
        name = _printable(quoted(heading.label))
        return f"\n# left out: column {heading.number} ({name}): {_printable(heading.note) or 'it holds text'}"
    notes = [note for note in (_printable(heading.note),) if note]
    if not proposal.name:
        notes.append("unassigned" + (f"; perhaps {proposal.hint}" if proposal.hint else ""))
    name = proposal.name or f"column_{heading.number}"
    lines = [f"[channels.{name}]" + (f"  # {'; '.join(notes)}" if notes else ""), f"column = {_key(heading)}"]
    if unit and readable(unit):
        lines.append(f"unit = {quoted(unit)}")
    elif unit:
        lines.append(f"unit = {quoted(unit)}  # not a unit that is known: write what it is")
    else:
        lines.append(f'{"# " if proposal.name else ""}unit = "?"  # unknown: the file does not say it')
    return "\n".join(["", *(line if proposal.name else f"# {line}" for line in lines)])


_WITHOUT_UNIT: Final = frozenset(MARKS) - {"temperature", "excitation"}
"""Columns of a load schedule that say what a point is: words or numbers."""

_HEAD: Final = """\
# Channel map for {file}, as far as the file says what it holds.
# Unassigned columns: put what it is for column_N, and remove the "# " before each line of its table:
#   {names}
# and r with any other component as the balance names it (rN1, rAxial) for a gauge output.
# Any other name is passed on untouched. Columns without a table are ignored.

[file]"""

_OWN_CLOCKS: Final = """\
# The file states the rate of every channel; the fastest of those below gives the clock, slower ones are interpolated.
# time = "group/channel"  # only where that is wrong: a channel that is the time, or
# rate =                  # samples per second, for channels of one length"""

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
