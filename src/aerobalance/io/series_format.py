"""Formats whose modules open files as series (see `aerobalance.io.series`), as `aerobalance.io.Format` has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aerobalance.io.columns import Heading, RawColumns
from aerobalance.io.series import Holdings, Reader, Series, by_label
from aerobalance.io.series_columns import columns_of
from aerobalance.io.text_clock import is_time_unit
from aerobalance.io.text_layout import Layout


@dataclass(frozen=True, slots=True)
class SeriesFormat:
    """A format whose module opens files as series, as `aerobalance.io.Format` has it.

    Attributes
    ----------
    reader
        The module.
    SUFFIXES
        File name endings that are written in this format.
    appending
        Writes columns that come some rows at a time; None for a format that is read only.
    KEEPS_SENSORS, KEEPS_EPOCH
        Whether it has a place for how a channel was measured, and for the date and time of time zero.
    """

    reader: Reader
    SUFFIXES: Mapping[str, str] = field(default_factory=dict)
    appending: Any = None
    KEEPS_SENSORS: bool = False
    KEEPS_EPOCH: bool = True

    @property
    def NAME(self) -> str:  # noqa: N802 - as the modules of the other formats call it
        """What to call the format in messages."""
        return self.reader.NAME

    def can_read(self, head: bytes, path: Path) -> bool:
        """Return whether a file is of this format, from its first bytes."""
        return self.reader.can_read(head, path)

    def headings(self, path: Path) -> tuple[Heading, ...]:
        """Read what the file says of its series, without their samples."""
        with self.reader.opened(path) as found:
            return headings_of(found)

    def read_columns(
        self, path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None
    ) -> RawColumns:
        """Read series as columns; only the samples of those wanted are read."""
        with self.reader.opened(path) as found:
            return columns_of(path, found, wanted, clocked=layout is not None and layout.clocked)


def headings_of(found: Holdings) -> tuple[Heading, ...]:
    """Return what a file says of its series."""
    axes = {series.axis: by_label(found, series.axis) for series in found.series if series.axis}
    rows = []
    for number, series in enumerate(found.series, start=1):
        if series.hidden:
            continue
        rate = f"{1 / series.clock.interval:.9g} Hz, " if series.clock is not None else ""
        note = f"cannot be used: {series.fault}" if series.fault else f"{rate}{series.samples} samples"
        axis = axes.get(series.axis)
        own = axes.get(series.label)
        rows.append(
            Heading(
                series.label,
                series.name,
                series.unit_as_read,
                number,
                "the time of other channels" if own else note,
                clocked=series.clock is not None or (axis is not None and _has_unit(axis)),
                usable=not series.fault and own is None,
                time=own is not None and not _has_unit(own),
            )
        )
    return tuple(rows)


def _has_unit(axis: Series) -> bool:
    """Whether a series of times needs no more than itself to be seconds."""
    return axis.stamps or is_time_unit(axis.unit)
