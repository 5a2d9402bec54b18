"""Commands about recordings: info, convert, map."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from aerobalance.app.commands.answers import short
from aerobalance.app.commands.loads import convert_matrix
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, opened, raw_recording, table_text
from aerobalance.io import (
    check_output,
    column_names,
    hdf5_file,
    template,
    write_recording,
    writer_of,
)
from aerobalance.io.balance_file import is_matrix
from aerobalance.io.kinds import CONVERTED
from aerobalance.io.map_template import NO_CLOCK
from aerobalance.io.recording_columns import as_it_went_in
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Channel, SensorSpec
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.joining import account, join
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import LongRecord, parts_of
from aerobalance.recording.recording import Recording
from aerobalance.recording.units import conversion_for, edge_unit

if TYPE_CHECKING:
    from aerobalance.recording.clock_pair import Way

NO_TIME: Final = 1e-12
"""Share of the length of a recording below which an instant is zero but for rounding."""


LOOKED_AT_ONCE: Final = 1 << 19
"""Samples of a record that are looked at at once."""


def info(path: Path, *, channel_map: Path | None = None) -> Result:
    """Channels, units, rate, duration, gaps and saturation of a recording."""
    with collected_warnings() as collected, opened(path, channel_map) as record:
        told, gaps = PartWarnings(record), _Gaps(record.rate)
        found: dict[str, list[_Looked]] = {}
        for part in parts_of(record.samples, length=LOOKED_AT_ONCE, margin=0):
            with told.of(part):
                recording = record.part(part.first, part.stop)
            gaps.add(recording, part.first)
            for channel in recording:
                found.setdefault(channel.name, []).append(_Looked.at(channel))
        told.tell()
        duration = (record.samples - 1) / record.rate
        result: Result = {
            "file": path.name,
            "duration": duration,
            "rate": record.rate,
            "samples": record.samples,
            "start": record.start if abs(record.start) > NO_TIME * duration else 0.0,
            "epoch": None if record.epoch is None else str(record.epoch),
            "gaps": [{"start": start, "length": length} for start, length in gaps.found],
            "channels": {channel.name: _channel_result(channel, found[channel.name]) for channel in recording},
            "warnings": collected,
        }
    return {**result, "summary": summary(result)}


@dataclass(slots=True)
class _Gaps:
    """Gaps of a record of which the parts come one after the other: start and length of each [s]."""

    rate: float
    found: list[tuple[float, float]] = field(default_factory=list)
    _last: tuple[int, float] | None = None

    def add(self, recording: Recording, begin: int) -> None:
        """Take the next part, which begins at a sample."""
        rows = recording.rows + begin
        if not rows.size:
            return
        if self._last is not None and rows[0] - self._last[0] > 1:
            self.found.append((self._last[1], float((rows[0] - self._last[0] - 1) / self.rate)))
        self.found += recording.gaps
        self._last = int(rows[-1]), float(recording.stamps[-1])


@dataclass(frozen=True, slots=True)
class _Looked:
    """What a part of a channel is, in the unit that is calculated with; None where it has no or too few readings."""

    count: int
    least: float | None
    mean: float | None
    largest: float | None
    noise: float | None
    missing: int
    saturated: int

    @classmethod
    def at(cls, channel: Channel) -> _Looked:
        """Look at it."""
        known = channel.values[~channel.missing]
        there = known.size > 0
        return cls(
            known.size,
            float(known.min()) if there else None,
            float(known.mean()) if there else None,
            float(known.max()) if there else None,
            channel_noise(channel) if known.size >= 8 and float(np.ptp(known)) > 0 else None,
            int(channel.missing.sum()),
            int(channel.saturated.sum()),
        )


def _channel_result(channel: Channel, looked: Sequence[_Looked]) -> Result:
    """Plain data on a channel, in the unit of the file; under ``si`` the same in the unit that is calculated with.

    The noise is the median of those of its parts.
    """
    noises = [one.noise for one in looked if one.noise is not None]
    noise = float(np.median(noises)) if noises else None
    known = [one for one in looked if one.count]
    total = sum(one.count for one in known)
    inside: Result = {
        "least": min((one.least for one in known if one.least is not None), default=None),
        "mean": sum(one.count / total * one.mean for one in known if one.mean is not None) if known else None,
        "largest": max((one.largest for one in known if one.largest is not None), default=None),
    }
    unit = channel.file_unit or edge_unit(channel.name, channel.unit)
    change = conversion_for(channel.name, unit) if unit != channel.unit else None
    outside = {
        key: value if change is None or value is None else float(as_it_went_in(np.array([value]), change)[0])
        for key, value in inside.items()
    }
    return {
        "unit": unit,
        "si_unit": channel.unit,
        **outside,
        "noise": noise if change is None or noise is None else noise / abs(change.factor),
        "si": {"unit": channel.unit, **inside, "noise": noise},
        "missing": sum(one.missing for one in looked),
        "saturated": sum(one.saturated for one in looked),
    }


def summary(result: Result) -> str:
    """Short answer for people: how long and how fast, and a line for each channel, in the units of the file."""
    rows = [
        (
            name,
            found["unit"],
            *(short(found[key], 5) for key in ("mean", "least", "largest")),
            short(found["noise"], 2),
            str(found["missing"] or "-"),
            str(found["saturated"] or "-"),
        )
        for name, found in result["channels"].items()
    ]
    length = f"{short(result['duration'])} s at {short(result['rate'])} Hz"
    date = f", time zero is {result['epoch'].rstrip('0').rstrip('.')}" if result["epoch"] else ""
    title = f"{result['file']}: {result['samples']} samples, {length}{date}"
    heads = ("channel", "unit", "mean", "least", "largest", "noise", "missing", "saturated")
    lines = [table_text(title, heads, rows)]
    if result["gaps"]:
        longest = max(gap["length"] for gap in result["gaps"])
        count = len(result["gaps"])
        lines.append(f"{count} gap{'s' if count > 1 else ''}, the longest {short(longest, 4)} s")
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class AlignmentRequest:
    """How several files are brought together, as asked for: the way, and the channel."""

    way: str | None = None
    by: str | None = None


def convert(
    paths: Sequence[Path],
    out: Path,
    *,
    channel_maps: Sequence[Path] = (),
    how: AlignmentRequest = AlignmentRequest(),
) -> Result:
    """Write a recording, or several of one event made one, in another format; or a balance matrix."""
    if len(channel_maps) not in (0, 1, len(paths)):
        raise ValueError(
            f"--map is given {len(channel_maps)} times for {len(paths)} files: give one for all, or one each"
        )
    if len(paths) == 1 and (how.way or how.by):
        raise ValueError("--align and --by are for several files of one event; one file was given")
    if len(paths) == 1 and is_matrix(paths[0]):
        return convert_matrix(paths[0], out)
    check_output(out)
    check_out(out, *paths, *channel_maps, kind=CONVERTED if out.suffix.lower() in hdf5_file.SUFFIXES else "")
    maps = [*channel_maps, *[channel_maps[0] if channel_maps else None] * len(paths)][: len(paths)]
    joined = None
    with collected_warnings() as collected, ExitStack() as reading:
        record: LongRecord[Recording]
        if len(paths) == 1:
            record = reading.enter_context(opened(paths[0], maps[0]))
        else:
            recordings = [raw_recording(path, one) for path, one in zip(paths, maps, strict=True)]
            joined = join(recordings, way=cast("Way", how.way or "auto"), by=how.by)
            record = joined.recording
        beginning = write_recording(out, record)
        _say_lost(out, beginning)
    names, samples = list(beginning.channels), record.samples
    told = [] if joined is None else [one.told() for one in joined.alignments]
    title = " and ".join(path.name for path in paths)
    return {
        "file": paths[0].name,
        "files": [path.name for path in paths],
        "written": out.name,
        "samples": samples,
        "channels": names,
        "alignments": [] if joined is None else account(joined),
        "warnings": collected,
        "summary": "\n".join([f"{title}: {samples} samples of {', '.join(names)}", *told]) + "\n",
    }


def _say_lost(out: Path, recording: Recording) -> None:
    """Warn of what the format has no place for."""
    told = [channel.name for channel in recording if _described(channel)]
    if told and not writer_of(out).KEEPS_SENSORS:
        warn_quality(
            f"{out.name} has no place for how {', '.join(told)} was measured (noise, uncertainties, delay, "
            "coupling, filter, cross-axis sensitivity): write .h5 to keep it"
        )
    if recording.epoch is not None and not writer_of(out).KEEPS_EPOCH:
        warn_quality(
            f"{out.name} has no place for the date and time at which its time is zero ({recording.epoch}): write "
            ".h5 to keep it"
        )


def _described(channel: Channel) -> bool:
    """Whether more is known of a channel than its name, its unit and its readings."""
    return channel.known() != SensorSpec().known()


def channel_map_for(path: Path, out: Path | None, *, header_line: int | None = None) -> Result:
    """Make a channel map to fill in for a foreign file; its header is in `header_line`, or found."""
    check_out(out, path)
    text = template(path, header_line=header_line) + "\n"
    if out is not None:
        with replacing(out) as beside:
            beside.write_text(text, encoding="utf-8")
    columns = list(column_names(path, header_line=header_line))
    open_ones = len(re.findall(r"^# \[channels\..*\bunassigned\b", text, flags=re.MULTILINE))
    waiting = "1 waits for a person to say what it is"
    if open_ones != 1:
        waiting = f"{open_ones} wait for a person to say what they are" if open_ones else "all with a proposal"
    then = "info --map, or calibrate --map if it is a load schedule" if NO_CLOCK in text else "info --map"
    said = f"{path.name}: channel map of {len(columns)} columns, {waiting}; then check with {then}\n"
    result: Result = {"file": path.name, "columns": columns, "map": text}
    return {**result, "summary": text} if out is None else {**result, "summary": said, "details": text}
