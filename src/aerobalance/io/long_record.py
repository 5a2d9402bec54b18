"""A record opened to be read part by part, where its format allows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Final

from aerobalance.io import Format, csv_file, format_of, hdf5_file, read, tdms_file
from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.hdf5_parts import opened_record
from aerobalance.io.series_format import SeriesFormat
from aerobalance.io.series_record import SeriesRecord, opened_series
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.parts import LongRecord
from aerobalance.recording.recording import Recording

SHORT: Final = 1 << 16
"""Samples up to which a record is read whole: there is nothing to be saved."""

LARGE: Final = 1 << 28
"""Size of a file from which on it is said that it is read whole [bytes]."""


@contextmanager
def open_record(path: Path | str, *, channel_map: ChannelMap | None = None) -> Iterator[LongRecord[Recording]]:
    """Open a recording of which parts are read as they are wanted.

    A recording in HDF5 as this program writes it, on a steady clock and without a channel map, is, and a file of
    another program whose format allows it (see `aerobalance.io.series_record`); every other is read whole.

    Parameters
    ----------
    path, channel_map
        As in `aerobalance.io.read`.

    Raises
    ------
    ReadError
        The file is no recording.

    Warns
    -----
    DataQualityWarning
        As in `aerobalance.io.read`, of a part when it is read; or a large file is read whole.
    """
    file = Path(path)
    form = format_of(file)
    if channel_map is None and form is hdf5_file:
        with opened_record(file) as record:
            if record is not None and record.samples > SHORT:
                yield record
                return
    with _series(file, form, channel_map) as series:
        if series is not None and series.samples > SHORT:
            yield series
            return
    size = file.stat().st_size
    if size > LARGE:
        own = form is hdf5_file and channel_map is None
        warn_quality(
            f"{file.name}: this file of {size / 1e6:.0f} MB is read whole, and takes several times as much memory; "
            + (
                "it is read in parts only where its time is that of a steady clock without gaps"
                if own
                else "`aerobalance convert` it to .h5 once, which is read in parts"
            )
        )
    yield read(file, channel_map=channel_map)


def _series(path: Path, form: Format, channel_map: ChannelMap | None) -> AbstractContextManager[SeriesRecord | None]:
    """Open a file of another program to read parts of it; None where it must be read whole."""
    if isinstance(form, SeriesFormat):
        return opened_series(path, form.reader, channel_map)
    if form is tdms_file:
        return tdms_file.opened_parts(path, channel_map)
    if form is csv_file:
        return csv_file.opened_parts(path, channel_map)
    return nullcontext()
