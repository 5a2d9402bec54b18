"""Files: `read` one into a recording, write recordings, forces, and the JSON artefacts.

A format is one module with ``NAME``, ``SUFFIXES`` (endings it writes), ``can_read(head, path)``, ``headings(path)``,
``read_columns(path, layout, wanted=...)`` and ``appending(path, labels)``; listing it in `FORMATS` is all it takes.
Most binary formats are smaller still: a module with ``NAME``, ``can_read`` and ``opened``, as
`aerobalance.io.series` describes it. Units, the clock, the channel map and the warnings are common to all.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from aerobalance.io import (
    arrow_file,
    balfit_file,
    csv_file,
    hdf5_file,
    hdf5_foreign,
    lvm_file,
    mat_file,
    mat_write,
    mdf_file,
    netcdf3_file,
    netcdf4_write,
    tdms_file,
    uff_file,
    vol_file,
    wav_file,
    zarr_file,
)
from aerobalance.io.channel_map import ChannelMap, load_channel_map, mapped_recording
from aerobalance.io.clocks import of_one_length, on_one_clock
from aerobalance.io.columns import Append, Heading, RawColumns
from aerobalance.io.csv_file import read_table
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.io.map_template import map_text
from aerobalance.io.opening import opened_file
from aerobalance.io.recording_columns import channel_column, stored_channel, time_column
from aerobalance.io.series_format import SeriesFormat
from aerobalance.io.table import Column, Table, recording_from, table_from
from aerobalance.io.text_layout import Layout
from aerobalance.io.text_table import describe_text, guess_encoding
from aerobalance.recording.errors import ReadError
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import LongRecord, parts_of
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording

__all__ = [
    "FORMATS",
    "ChannelMap",
    "Column",
    "Format",
    "Table",
    "check_output",
    "column_names",
    "format_of",
    "is_text",
    "load_channel_map",
    "read",
    "read_table",
    "states_times",
    "template",
    "write_recording",
    "writer_of",
]


class Writes(Protocol):
    """Writes columns that come some rows at a time; the file takes its place when all are written."""

    def __call__(
        self,
        path: Path,
        labels: Sequence[str],
        described: Mapping[str, StoredChannel] | None = None,
        *,
        epoch: np.datetime64 | None = None,
        rows: int = 0,
    ) -> AbstractContextManager[Append]:
        """Begin a file of the columns of these headers, nearly so many rows, with what is known beside them."""


class Format(Protocol):
    """What a module that reads and writes one file format offers."""

    @property
    def NAME(self) -> str:  # noqa: N802 - a constant of the module
        """What to call the format in messages."""

    @property
    def SUFFIXES(self) -> Mapping[str, str]:  # noqa: N802 - a constant of the module
        """File name endings that are written in this format."""

    def can_read(self, head: bytes, path: Path) -> bool:
        """Return whether a file is of this format, from its first bytes."""

    def headings(self, path: Path) -> tuple[Heading, ...]:
        """Read what the file says of its columns, without their cells."""

    def read_columns(
        self, path: Path, layout: Layout | None = None, *, wanted: Sequence[str | int] | None = None
    ) -> RawColumns:
        """Read the columns as they are."""

    @property
    def KEEPS_SENSORS(self) -> bool:  # noqa: N802 - a constant of the module
        """Whether it has a place for how a channel was measured."""

    @property
    def KEEPS_EPOCH(self) -> bool:  # noqa: N802 - a constant of the module
        """Whether it has a place for the date and time of time zero."""

    @property
    def appending(self) -> Writes | None:
        """Writes columns under their headers, some rows at a time; None for a format that is read only."""


WRITTEN_AT_ONCE: Final = 1 << 17
"""Samples of a record that are read and written at once."""

FORMATS: Final[tuple[Format, ...]] = (
    tdms_file,
    SeriesFormat(hdf5_foreign),
    hdf5_file,
    SeriesFormat(mat_file, {".mat": ""}, mat_write.appending, KEEPS_SENSORS=True),
    SeriesFormat(netcdf3_file, {".nc": ""}, netcdf4_write.appending, KEEPS_SENSORS=True),
    SeriesFormat(arrow_file, {".parquet": ""}, arrow_file.appending, KEEPS_SENSORS=True),
    SeriesFormat(zarr_file),
    SeriesFormat(mdf_file),
    SeriesFormat(uff_file, {".uff": "", ".unv": ""}, uff_file.appending),
    SeriesFormat(wav_file),
    lvm_file,
    csv_file,
)
"""The formats, in the order in which they are asked; text comes last, as it takes what the others leave."""

_SIGNATURES: Final = (
    (b"TDSh", "the index that LabVIEW keeps beside a TDMS file (give the .tdms file itself)"),
    (
        zarr_file.ZIPPED,
        "a zip archive (perhaps a spreadsheet: save it as CSV; aerobalance calibrate reads load schedules of .xlsx)",
    ),
    (b"%PDF", "a PDF document"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\x89PNG", "a picture"),
    (b"\xff\xd8\xff", "a picture"),
    (b"{", "a JSON file"),
)


def read(path: Path | str, *, channel_map: ChannelMap | None = None) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path
        The file; its format is recognised by its content.
    channel_map
        What the columns of a foreign file are; None for a file whose headers say it.

    Returns
    -------
    Recording
        Channels in SI units (angles in rad, gauge outputs in mV/V) on one steady clock.

    Raises
    ------
    ReadError
        The file is no recording; the message says where and what is allowed.

    Warns
    -----
    DataQualityWarning
        Samples are missing or saturated, or time stamps jitter.
    """
    file = Path(path)
    chosen = format_of(file)
    if channel_map is None:
        columns = chosen.read_columns(file)
        clocked = any(column.clock is not None for column in columns.columns)
        columns = on_one_clock(columns) if clocked else of_one_length(columns)
        table = table_from(columns, missing_allowed=True)
        return recording_from(table, rate=columns.rate, ticks=columns.ticks)
    layout = channel_map.layout
    if chosen is lvm_file and layout.header_line is not None:
        chosen = csv_file  # who gives the header line wants the plain text behind the headers
    raw = chosen.read_columns(file, layout, wanted=channel_map.wanted)
    return mapped_recording(raw, channel_map)


def column_names(path: Path | str, *, header_line: int | None = None) -> tuple[str, ...]:
    """Read the names of a file's columns: without units for a text file, ``group/channel`` for TDMS.

    With `header_line` the file is read as text, its header in that line (0 for none).

    Raises
    ------
    ReadError
        The file is of no known format, or has no header.
    """
    file = Path(path)
    text = header_line is not None or is_text(file)
    found = csv_file.headings(file, Layout(header_line=header_line)) if text else format_of(file).headings(file)
    return tuple(heading.name if text else heading.label for heading in found if heading.label)


def is_text(path: Path | str) -> bool:
    """Return whether a file is a text table, which may be something else than a recording.

    Raises
    ------
    ReadError
        The file is of no known format.
    """
    return format_of(Path(path)) is csv_file


def states_times(path: Path | str) -> bool:
    """Return whether a file has a column of times, which makes a recording of it; one that is no text is a recording.

    Raises
    ------
    ReadError
        The file is of no known format, or has no header.
    """
    file = Path(path)
    found = format_of(file)
    return found is not csv_file or any(heading.name == "time" or heading.time for heading in found.headings(file))


def template(path: Path | str, *, header_line: int | None = None) -> str:
    """Write a channel map for a foreign file, made from its header, to be completed by hand.

    Parameters
    ----------
    path
        The foreign file.
    header_line
        Line of the header of a text file, counted from 1, 0 for a file without; recognised where left out.

    Returns
    -------
    str
        TOML with comments: the clock and the layout as found, and a table for every column, commented where a person
        has to say what it is.

    Raises
    ------
    ReadError
        The file is of no known format, or has no header.
    """
    file = Path(path)
    if header_line is None:
        found = format_of(file)
        if found is not csv_file:
            return map_text(file, found.headings(file))
    layout = Layout(header_line=header_line)
    return map_text(file, csv_file.headings(file, layout), found=describe_text(file, layout))


def format_of(path: Path) -> Format:
    """Find the format of a file by its content."""
    head = b""
    if not _is_store(path):
        with opened_file(path) as file:
            head = file.read(65536)
    known = ", ".join(form.NAME for form in FORMATS)
    seems = next((text for sign, text in _SIGNATURES if head.startswith(sign)), "")
    if not seems and _is_schedule(head):
        raise ReadError(
            path, "", "is a load schedule and no recording; aerobalance calibrate makes a balance matrix of it"
        )
    for form in FORMATS:
        if (not seems or form is not csv_file) and form.can_read(head, path):
            return form
    seems = seems or "a binary file of an unknown kind"
    raise ReadError(path, "", f"seems to be {seems}; formats that can be read: {known}")


def _is_store(path: Path) -> bool:
    """Whether a folder is a file of a format whose files are folders."""
    return path.is_dir() and zarr_file.can_read(b"", path)


def _is_schedule(head: bytes) -> bool:
    """Whether a file begins as a load schedule of a calibration does that is no plain table."""
    encoding = guess_encoding(head)
    if encoding is None:
        return False
    text = head.decode(encoding, errors="replace")
    return vol_file.can_read(text) or balfit_file.can_read(text)


def check_output(path: Path | str) -> Path:
    """Make sure, before long work, that a file of this name can be written.

    Raises
    ------
    ValueError
        No format is written under this ending, or the folder does not exist.
    """
    file = Path(path)
    if file.is_dir():
        raise ValueError(f"{file} is a folder; the name of a file is needed")
    writer_of(file)
    if not file.parent.is_dir():
        raise ValueError(f"cannot write {file}: there is no folder {file.parent}")
    return file


def writer_of(path: Path) -> Format:
    """Return the format that a file of this name is written in.

    Raises
    ------
    ValueError
        There is none.
    """
    for form in FORMATS:
        if path.suffix.lower() in form.SUFFIXES:
            return form
    allowed = ", ".join(suffix for form in FORMATS for suffix in form.SUFFIXES)
    raise ValueError(f"cannot write {path}: the ending {path.suffix!r} stands for no known format; allowed: {allowed}")


def writing_of(path: Path) -> Writes:
    """Return what writes a file of this name.

    Raises
    ------
    ValueError
        Nothing does.
    """
    found = writer_of(path).appending
    if found is None:
        raise ValueError(f"cannot write {path}: {writer_of(path).NAME} is read only")
    return found


def write_recording(path: Path | str, record: LongRecord[Recording]) -> Recording:
    """Write the rows of a recording, each channel in the unit it had in its file (angles in deg where it had none).

    A record that is open (see `aerobalance.io.long_record`) is read and written part by part. Formats with a place
    for it keep how each channel was measured: noise, uncertainties, delay, coupling, filter, cross-axis sensitivity.

    Parameters
    ----------
    path
        The file; its ending chooses the format.
    record
        What to write; samples that its gaps lack are not written.

    Returns
    -------
    Recording
        The first part of it, which has its channels and its start.

    Raises
    ------
    ReadError
        A part cannot be read.
    ValueError
        The ending stands for no format, or the file cannot be written.

    Warns
    -----
    DataQualityWarning
        Of a record that is read as it is written: samples are missing or rest on a limit.
    """
    file = check_output(path)
    parts = parts_of(record.samples, length=WRITTEN_AT_ONCE, margin=0)
    told = PartWarnings(record)
    begun: list[tuple[Recording, Append]] = []
    with contextlib.ExitStack() as stack:
        for part in PROGRESS.each(parts, "part"):
            with told.of(part):
                recording = record.part(part.first, part.stop)
            columns = time_column(recording)
            described = {}
            for channel in recording:
                column = channel_column(channel, recording)
                columns.update(column)
                described[next(iter(column))] = stored_channel(channel)
            if not begun:
                begin = writing_of(file)(
                    file,
                    list(columns),
                    described,
                    epoch=recording.epoch,
                    rows=record.samples,
                )
                begun.append((recording, stack.enter_context(begin)))
            if recording.rows.size:
                begun[0][1](columns)
    told.tell()
    return begun[0][0]
