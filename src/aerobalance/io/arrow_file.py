"""Parquet and Arrow (Feather): columns by their name."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io.columns import Append, split_label
from aerobalance.io.format_library import library, library_faults, library_to_write
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.io.safe_write import replacing
from aerobalance.io.said_by_file import clock_of, epoch_of, plain_keys, sensor_said, since, unit_of
from aerobalance.io.sensor_text import KEY, sensor_text
from aerobalance.io.series import MOST_SERIES, Fills, Holdings, Series, named, with_axes
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError
from aerobalance.recording.version import VERSION

NAME: Final = "Parquet or Arrow"
"""What to call the format in messages."""

_PARQUET: Final = b"PAR1"
_ARROW: Final = b"ARROW1"
_STREAM: Final = b"\xff\xff\xff\xff"
_PACKED: Final = 20_000
"""Most values that a byte of a file may stand for: runs and dictionaries of the same number are short."""


_GROUP: Final = 1 << 18
"""Rows of a row group that is written, at least."""


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is Parquet, Arrow or an Arrow stream, from its first bytes."""
    del path
    return head.startswith((_PARQUET, _ARROW)) or (
        head.startswith(_STREAM) and head[8:12] in (b"\x10\0\0\0", b"\x0c\0\0\0")
    )


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its columns as series; of Parquet only the row groups and columns that are wanted.

    Raises
    ------
    ReadError
        The file is damaged, or pyarrow is not installed.
    """
    library("pyarrow", "parquet", path, "a Parquet or Arrow file")
    with contextlib.ExitStack() as stack:
        with path.open("rb") as stream:
            parquet = stream.read(4) == _PARQUET
        with library_faults(path, NAME, "its footer"):
            holdings = _parquet(path, stack) if parquet else _arrow(path, stack)
        yield holdings


def _parquet(path: Path, stack: contextlib.ExitStack) -> Holdings:
    import pyarrow.parquet as pq  # noqa: PLC0415 - an extra, and only these files need it

    size = path.stat().st_size
    with path.open("rb") as stream:
        stream.seek(max(0, size - 8))
        tail = stream.read(8)
    footer = int.from_bytes(tail[:4], "little")
    if tail[4:] != _PARQUET or footer > size - 12:
        raise ReadError(path, "its last 8 bytes", "do not end a Parquet file: it was not finished, or is cut off")
    file = stack.enter_context(pq.ParquetFile(path, memory_map=False, pre_buffer=False))
    about = file.metadata
    rows = [about.row_group(i).num_rows for i in range(about.num_row_groups)]
    if min(rows, default=0) < 0 or sum(rows) != about.num_rows:
        raise ReadError(path, "its footer", "has row groups that do not add up: it is damaged")
    # what the footer says of single columns is not asked for: the library ends the process where that is damaged
    if about.num_rows * about.num_columns > _PACKED * size:
        raise ReadError(
            path,
            "its footer",
            f"claims {about.num_columns} columns of {about.num_rows} in {size} bytes: it is damaged",
        )
    bounds = np.concatenate([[0], np.cumsum(rows)]).astype(np.int64)

    def reader(name: str) -> Any:
        kept: dict[tuple[int, ...], Any] = {}  # of pieces that are shorter than a row group, which all unpack it

        def read(begin: int, end: int) -> Any:
            wanted = tuple(i for i in range(len(rows)) if bounds[i] < end and bounds[i + 1] > begin)
            if not wanted:
                return np.empty(0)
            first, last = int(bounds[wanted[0]]), int(bounds[wanted[-1] + 1])
            found = kept.get(wanted)
            if found is None:
                found = _numbers(file.read_row_groups(list(wanted), columns=[name], use_threads=False).column(0))
                kept.clear()
                if (begin, end) != (first, last):
                    kept[wanted] = found
            return found[begin - first : end - first]

        return read

    return _holdings(path, file.schema_arrow, about.num_rows, reader)


def _arrow(path: Path, stack: contextlib.ExitStack) -> Holdings:
    import pyarrow as pa  # noqa: PLC0415 - an extra, and only these files need it

    source = stack.enter_context(pa.memory_map(str(path)))
    whole = source.read(6) == _ARROW
    source.seek(0)
    batches = pa.ipc.open_file(source) if whole else pa.ipc.open_stream(source)
    stack.enter_context(batches)
    table = batches.read_all()  # of what is not packed no more than a map of the file
    table.validate(full=False)

    def reader(name: str) -> Any:
        place = table.schema.get_field_index(name)
        return lambda begin, end: _numbers(table.column(place).slice(begin, end - begin))

    def filling(name: str) -> Fills:
        column = table.column(table.schema.get_field_index(name))

        def fill(begin: int, into: Array) -> None:
            at = 0
            for part in column.slice(begin, into.size).chunks:
                into[at : at + len(part)] = part.to_numpy(zero_copy_only=False)
                at += len(part)
            if at < into.size:
                raise ValueError(f"it has {at} of {into.size} samples")

        return fill

    # packed columns are unpacked by now
    return replace(_holdings(path, table.schema, table.num_rows, reader, filling), parts=False)


def _holdings(path: Path, schema: Any, rows: int, reader: Any, filling: Any = None) -> Holdings:
    """Series of the columns of a schema."""
    import pyarrow as pa  # noqa: PLC0415 - an extra, and only these files need it

    if len(schema) > MOST_SERIES:
        raise ReadError(path, "columns", f"are {len(schema)}; at most {MOST_SERIES} are read")
    about = plain_keys(_decoded(schema.metadata))
    names = list(schema.names)
    series, epoch = [], epoch_of(about)
    for column in schema:
        own = plain_keys(_decoded(column.metadata))
        kind = column.type
        stamps = pa.types.is_timestamp(kind) or pa.types.is_date64(kind)
        numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        fault = "" if stamps or numbers or pa.types.is_decimal(kind) else f"it holds {str(kind)[:60]}, no numbers"
        if names.count(column.name) > 1:
            fault = "several columns have this name"
        stated = unit_of(own)
        unit, date = since(stated) if "since" in stated else (stated, None)
        epoch = epoch if epoch is not None else date
        name, unit = named(column.name, unit)
        series.append(
            Series(
                column.name,
                name,
                unit,
                rows,
                reader(column.name),
                fill=filling(column.name) if filling is not None and pa.types.is_float64(kind) and not fault else None,
                alias=name,
                clock=clock_of(own) or clock_of(about),
                fault=fault,
                stamps=stamps,
                sensor=sensor_said(own),
            )
        )
    return Holdings(with_axes(series, flat=True), epoch)


def _decoded(given: Mapping[bytes, bytes] | None) -> dict[str, Any]:
    """Metadata as text, numbers among them as numbers."""
    found: dict[str, Any] = {}
    for key, value in (given or {}).items():
        text = value.decode("utf-8", "replace") if len(value) <= 4096 else ""
        try:
            found[key.decode("utf-8", "replace")] = float(text)
        except ValueError:
            found[key.decode("utf-8", "replace")] = text
    return found


def _numbers(column: Any) -> Any:
    """Numbers of a column, NaN where there is none; dates and times as they are."""
    import pyarrow as pa  # noqa: PLC0415 - an extra, and only these files need it

    kind = column.type
    if pa.types.is_decimal(kind) or pa.types.is_boolean(kind) or pa.types.is_float16(kind):
        column = column.cast(pa.float64())
    return column.to_numpy()


@contextmanager
def appending(
    path: Path,
    labels: Sequence[str],
    described: Mapping[str, StoredChannel] | None = None,
    *,
    epoch: np.datetime64 | None = None,
    rows: int = 0,
) -> Iterator[Append]:
    """Write columns to Parquet some rows at a time; the file takes its place when all are written.

    Every column has its header ``name [unit]``, and in its metadata ``unit`` and what is known of its ``sensor``; that
    of the file has ``epoch``, the date and time at which the time is zero.

    Raises
    ------
    ValueError
        pyarrow is not installed, or the file cannot be written.
    """
    del rows
    library_to_write("pyarrow", "parquet", path, "Parquet")
    import pyarrow as pa  # noqa: PLC0415 - an extra, and only these files need it
    import pyarrow.parquet as pq  # noqa: PLC0415

    fields = []
    for label in labels:
        about = {"unit": split_label(label)[1]}
        text = sensor_text(described[label]) if described and label in described else ""
        fields.append(pa.field(label, pa.float64(), metadata=about | ({KEY: text} if text else {})))
    whole = {"program": f"aerobalance {VERSION}"} | ({} if epoch is None else {"epoch": str(epoch)})
    schema = pa.schema(fields, metadata=whole)
    waiting: list[Any] = []
    with replacing(path) as beside, pq.ParquetWriter(beside, schema, use_dictionary=False) as writer:

        def flush() -> None:
            if waiting:
                writer.write_table(pa.concat_tables(waiting).combine_chunks())
                waiting.clear()

        def append(columns: Mapping[str, Array]) -> None:
            there = {label: np.isfinite(columns[label]) for label in labels}
            cells = [pa.array(columns[one], mask=None if there[one].all() else ~there[one]) for one in labels]
            waiting.append(pa.table(cells, schema=schema))
            if sum(part.num_rows for part in waiting) >= _GROUP:
                flush()

        yield append
        flush()
