"""A record opened to be read part by part, where its format allows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from aerobalance.io import hdf5_file, read
from aerobalance.io.channel_map import ChannelMap
from aerobalance.io.hdf5_parts import opened_record
from aerobalance.io.opening import opened_file
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

    A recording in HDF5 as this program writes it, on a steady clock and without a channel map, is; every other is read
    whole.

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
    with opened_file(file) as opened:
        head = opened.read(16)
    if channel_map is None and hdf5_file.can_read(head, file):
        with opened_record(file) as record:
            if record is not None and record.samples > SHORT:
                yield record
                return
    size = file.stat().st_size
    if size > LARGE:
        warn_quality(
            f"{file.name}: this file of {size / 1e6:.0f} MB is read whole, and takes several times as much memory; "
            "`aerobalance convert` it to .h5 once, which is read in parts"
        )
    yield read(file, channel_map=channel_map)
