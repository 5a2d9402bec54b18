"""MDF (ASAM, version 4; .mf4, .mdf, .dat): groups of channels, each group with its own times."""

from __future__ import annotations

import contextlib
import gc
import io
import logging
import sys
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io.format_library import library, library_faults
from aerobalance.io.mdf_blocks import check_blocks
from aerobalance.io.said_by_file import date_of
from aerobalance.io.series import MOST_SERIES, Holdings, Series, named
from aerobalance.recording.errors import ReadError

NAME: Final = "MDF"
"""What to call the format in messages."""

_FINISHED: Final = b"MDF     "
_UNFINISHED: Final = b"UnFinMF "


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is MDF, from its first bytes."""
    del path
    return head[:8] in (_FINISHED, _UNFINISHED)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its channels as series ``group/channel``; only those that are wanted are read.

    Raises
    ------
    ReadError
        The file is damaged, or asammdf is not installed.
    """
    asammdf = library("asammdf", "mdf", path, "an MDF file")
    with library_faults(path, NAME, "its blocks"):
        check_blocks(path)
    with contextlib.ExitStack() as stack:
        stack.enter_context(_quiet())
        with library_faults(path, NAME, "its channels"), _silent():
            mdf = asammdf.MDF(path, process_bus_logging=False)
            stack.callback(mdf.close)
        with library_faults(path, NAME, "its channels"):
            holdings = _holdings(path, mdf)
        yield holdings


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the library from writing to standard error."""
    logger = logging.getLogger("asammdf")
    before = logger.disabled, logger.propagate
    logger.disabled, logger.propagate = True, False
    try:
        yield
    finally:
        logger.disabled, logger.propagate = before


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep from the screen what the library prints of what it raises, and what its half-made object raises at its end.

    Only while a file is opened: it is done with what all of the process prints.
    """
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    except BaseException as fault:
        traceback.clear_frames(fault.__traceback__)  # so that the object, which refers to itself, ends here
        gc.collect()
        raise
    finally:
        sys.unraisablehook = hook


def _holdings(path: Path, mdf: Any) -> Holdings:
    """Series of all groups."""
    series: list[Series] = []
    size = path.stat().st_size
    names = [_group_name(group, number) for number, group in enumerate(mdf.groups)]
    for g, group in enumerate(mdf.groups):
        samples = int(group.channel_group.cycles_nr)
        if samples > size:
            raise ReadError(path, f"group {g + 1}", f"claims {samples} samples in {size} bytes: it is damaged")
        label = names[g] if names.count(names[g]) == 1 else f"{names[g]} {g + 1}"
        master = mdf.masters_db.get(g)
        axis = f"{label}/{group.channels[master].name}" if master is not None else ""
        for c, channel in enumerate(group.channels):
            if len(series) >= MOST_SERIES:
                raise ReadError(path, "channels", f"are more than {MOST_SERIES}, which no recording has")
            text = f"{label}/{channel.name}"
            is_master = c == master
            unit = "s" if is_master else _unit(channel)
            name, unit = named(str(channel.name).strip(), unit)
            fault = "" if samples > 1 else f"it has {samples} sample(s)"
            fetch = _Fetch(mdf, g, c, is_master, samples)
            series.append(
                Series(
                    text,
                    name,
                    unit,
                    samples,
                    fetch.read,
                    alias=str(channel.name),
                    axis="" if is_master else axis,
                    fault=fault,
                )
            )
    started = mdf.header.start_time
    return Holdings(tuple(series), date_of(started))


def _group_name(group: Any, number: int) -> str:
    """What a group is called: by its own name, or its number counted from 1."""
    name = getattr(group.channel_group, "acq_name", "") or ""
    return str(name).strip().replace("/", "_") or str(number + 1)


def _unit(channel: Any) -> str:
    """Unit of a channel, or of its conversion."""
    for holder in (channel, getattr(channel, "conversion", None)):
        text = str(getattr(holder, "unit", "") or "").strip()
        if text:
            return text
    return ""


@dataclass(frozen=True, slots=True)
class _Fetch:
    """Reads a part of one channel."""

    mdf: Any
    group: int
    channel: int
    master: bool
    samples: int

    def read(self, begin: int, end: int) -> Any:
        """Samples from one to another (not included), as numbers in their unit."""
        if self.master and end - begin == self.samples:
            return self.mdf.get_master(self.group)
        if self.master:
            return self.mdf.get_master(self.group, record_offset=begin, record_count=end - begin)
        if end - begin == self.samples:
            values, invalid = self.mdf.get(group=self.group, index=self.channel, samples_only=True)
        else:  # the library returns the samples alone for the whole only
            part = self.mdf.get(group=self.group, index=self.channel, record_offset=begin, record_count=end - begin)
            values, invalid = part.samples, part.invalidation_bits
        if values.dtype.kind not in "fiub" or values.ndim != 1:
            raise ValueError("it holds text or arrays; readings over time are needed")
        if invalid is not None and np.any(invalid):
            values = values.astype(np.float64)
            values[np.asarray(invalid, dtype=bool)] = np.nan
        return values
