"""Commands about recordings: info, convert, map."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from aerobalance.channel import Channel
from aerobalance.commands.loads import convert_matrix
from aerobalance.commands.shared import Account, check_out, doubts, raw_recording
from aerobalance.io import (
    check_output,
    column_names,
    hdf5_file,
    template,
    write_recording,
)
from aerobalance.io.matrix_file import is_matrix
from aerobalance.io.safe_write import replacing
from aerobalance.noise import channel_noise
from aerobalance.problems import DoubtWarning


def info(path: Path, *, channel_map: Path | None = None) -> Account:
    """Channels, units, rate, duration, gaps and saturation of a recording."""
    with doubts() as collected:
        recording = raw_recording(path, channel_map)
    channels = {}
    for channel in recording:
        known = channel.values[~channel.missing]
        enough = known.size >= 8 and float(np.ptp(known)) > 0
        channels[channel.name] = {
            "unit": channel.file_unit or channel.unit,
            "si_unit": channel.unit,
            "least": float(known.min()) if known.size else None,
            "mean": float(known.mean()) if known.size else None,
            "largest": float(known.max()) if known.size else None,
            "noise": channel_noise(channel) if enough else None,
            "missing": int(channel.missing.sum()),
            "saturated": int(channel.saturated.sum()),
        }
    return {
        "file": path.name,
        "duration": recording.duration,
        "rate": recording.rate,
        "samples": recording.samples,
        "start": recording.start,
        "gaps": [{"start": start, "length": length} for start, length in recording.gaps],
        "channels": channels,
        "warnings": collected,
    }


def convert(path: Path, out: Path, *, channel_map: Path | None = None) -> Account:
    """Write a recording in another format, or a balance matrix in the other layout."""
    if is_matrix(path):
        return convert_matrix(path, out)
    check_output(out)
    check_out(out, path, channel_map)
    with doubts() as collected:
        recording = raw_recording(path, channel_map)
        kept = out.suffix.lower() in hdf5_file.SUFFIXES
        told = [] if kept else [channel.name for channel in recording if _described(channel)]
        if told:
            warnings.warn(
                f"{out.name} has no place for how {', '.join(told)} was measured (noise, uncertainties, delay, "
                "coupling, filter, cross-axis sensitivity): write .h5 to keep it",
                DoubtWarning,
                stacklevel=2,
            )
    write_recording(out, recording)
    return {
        "file": path.name,
        "written": out.name,
        "samples": recording.samples,
        "channels": list(recording.channels),
        "warnings": collected,
    }


def _described(channel: Channel) -> bool:
    """Whether more is known of a channel than its name, its unit and its readings."""
    bare = Channel(channel.name, channel.values, channel.unit, file_unit=channel.file_unit)
    slots = (slot for slot in Channel.__slots__ if slot != "values")
    return any(getattr(channel, slot) != getattr(bare, slot) for slot in slots)


def channel_map_for(path: Path, out: Path | None, *, header_line: int | None = None) -> Account:
    """Make a channel map to fill in for a foreign file; its header is in `header_line`, or found."""
    check_out(out, path)
    text = template(path, header_line=header_line) + "\n"
    if out is not None:
        with replacing(out) as beside:
            beside.write_text(text, encoding="utf-8")
    return {"file": path.name, "columns": list(column_names(path, header_line=header_line)), "map": text}
