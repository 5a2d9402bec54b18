"""Which channels of a TDMS file were sampled together, although the start times written for them differ; and how fast.

LabVIEW writes `wf_start_time` channel by channel from the computer's clock. Where that clock ticks over between two
channels of one task (by 1 ms, or 16 ms on older systems), their stamps differ while their samples do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

CLOCK_TICK: Final = 0.02
"""Largest difference of stamps that the computer's clock explains [s]: a little more than its longest tick."""

_NAMED: Final = 12


@dataclass(frozen=True, slots=True)
class Stamped:
    """A channel with what its file says of its sampling.

    Attributes
    ----------
    number
        Position in the file.
    group, name
        What it is called.
    increment, offset
        Properties ``wf_increment`` and ``wf_start_offset`` as they are.
    samples
        Number of samples.
    stamp
        Property ``wf_start_time``: seconds and fractions of 2**-64 s; None where there is none.
    """

    number: int
    group: str
    name: str
    increment: Any
    offset: Any
    samples: int
    stamp: Any


def seconds_after(stamp: Any, origin: Any) -> float:
    """Time from one stamp to another [s], whole seconds and fractions apart: both together leave microseconds only."""
    return float((stamp.seconds - origin.seconds) + (stamp.second_fractions - origin.second_fractions) * 2.0**-64)


def start_stamps(channels: Sequence[Stamped], chosen: Sequence[int]) -> tuple[dict[int, Any], list[str]]:
    """Return the stamp at which each channel really starts, and what was set right.

    Channels of one group with the same increment, offset and number of samples, whose stamps are no further apart than
    the clock explains, are one task: all of them start at the earliest stamp.

    Parameters
    ----------
    channels
        All channels of the file.
    chosen
        Numbers of those that are read; only of these it is said.

    Returns
    -------
    tuple
        Stamp by channel number, for channels that have one; and a sentence for each task that was put together.
    """
    tasks: dict[tuple[Any, ...], list[Stamped]] = {}
    for channel in channels:
        if channel.stamp is not None and channel.increment is not None:
            key = (channel.group, repr(channel.increment), repr(channel.offset), channel.samples)
            tasks.setdefault(key, []).append(channel)
    found = {channel.number: channel.stamp for channel in channels if channel.stamp is not None}
    said = []
    for task in tasks.values():
        first = min((channel.stamp for channel in task), key=lambda stamp: (stamp.seconds, stamp.second_fractions))
        late = {channel.number: seconds_after(channel.stamp, first) for channel in task}
        if not 0 < max(late.values()) <= CLOCK_TICK:
            continue
        found |= dict.fromkeys(late, first)
        used = [channel for channel in task if channel.number in set(chosen)]
        if len({late[channel.number] for channel in used}) > 1:
            said.append(_sentence(used, late))
    return found, said


def _sentence(used: Sequence[Stamped], late: Mapping[int, float]) -> str:
    first = min(late[channel.number] for channel in used)
    behind = [channel for channel in used if late[channel.number] > first]
    names = ", ".join(channel.name for channel in behind[:_NAMED]) + (" and others" if len(behind) > _NAMED else "")
    apart = max(late[channel.number] for channel in used) - first
    return (
        f"the start times of {names} are up to {apart * 1e3:.3g} ms after those of the other channels of the group "
        f"{used[0].group!r}, though rate and number of samples are the same: the computer's clock ticked over while "
        "they were written. The channels are taken as sampled together; tasks that were not belong into two groups"
    )


def round_interval(value: float) -> float:
    """Return the round number that a sampling interval stands for, where it went through single precision.

    0.0010000000474974513 is what single precision makes of 0.001, and over 600 s at 25 kHz the difference is more
    than a sample. A value that is exactly a single-precision number is taken as the number of at most six digits, or
    as one over such a number (a round rate), which single precision rounds to it: float32(round) == value. Any other
    value, a measured double-precision interval for one, stays as it is.
    """
    single = np.float32(value)
    if value <= 0 or float(single) != value:
        return value
    for candidate in (float(f"{value:.6g}"), 1 / float(f"{1 / value:.6g}")):
        if np.float32(candidate) == single:
            return candidate
    return value
