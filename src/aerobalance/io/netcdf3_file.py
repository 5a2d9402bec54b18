"""NetCDF of the classic formats (3): variables by their name. NetCDF-4 is HDF5 (see `hdf5_foreign`)."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io.format_library import library_faults
from aerobalance.io.said_by_file import clock_of, epoch_of, plain_keys, sensor_said, since, unit_of, unpacked
from aerobalance.io.series import MOST_COLUMNS, MOST_SERIES, Holdings, Series, kind_fault, named, with_axes
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError

NAME: Final = "NetCDF (classic)"
"""What to call the format in messages."""


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is NetCDF of a classic format, from its first bytes."""
    del path
    return head[:3] == b"CDF" and head[3:4] in (b"\x01", b"\x02", b"\x05")


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its variables as series; what is not wanted stays on the disk.

    Raises
    ------
    ReadError
        The file is damaged, or of the 64-bit data format (CDF-5), which the library does not read.
    """
    from scipy.io import netcdf_file  # noqa: PLC0415 - a tenth of a second, and only these files need it

    with path.open("rb") as stream:
        if stream.read(4) == b"CDF\x05":
            raise ReadError(
                path, "byte 4", "is NetCDF of the 64-bit data format (CDF-5); write it as netCDF-4 (nccopy -k nc4)"
            )
    with contextlib.ExitStack() as stack:
        with library_faults(path, NAME, "its header"):
            file: Any = netcdf_file(path, "r", mmap=True, maskandscale=False)
            stack.callback(_close, file)
            about = plain_keys(file._attributes)
            series, epoch = [], epoch_of(about)
            for name, variable in file.variables.items():
                found, date = _of_variable(path, str(name), variable, about)
                series += found
                epoch = epoch if epoch is not None else date
            if len(series) > MOST_SERIES:
                raise ReadError(path, "variables", f"are more than {MOST_SERIES}, which no recording has")
        yield Holdings(with_axes(series, flat=True), epoch)


def _close(file: Any) -> None:
    """Close a file whose variables are read by now: no view of them is left."""
    with contextlib.suppress(Exception):
        for variable in file.variables.values():
            variable.data = np.empty(0)
        file.close()


def _of_variable(
    path: Path, name: str, variable: Any, about: dict[str, Any]
) -> tuple[list[Series], np.datetime64 | None]:
    """Series of one variable, and the date and time of zero where it is a time that states it."""
    shape = tuple(int(length) for length in variable.shape)
    if len(shape) not in (1, 2) or math.prod(shape) < 2 or (len(shape) == 2 and min(shape) > MOST_COLUMNS):
        return [], None
    size = path.stat().st_size
    if math.prod(shape) * variable.data.dtype.itemsize > size:
        raise ReadError(
            path, f"variable {name!r}", f"claims {math.prod(shape)} samples in {size} bytes: it is damaged"
        )
    own = plain_keys(variable._attributes)
    stated = unit_of(own)
    unit, date = since(stated) if "since" in stated else (stated, None)
    bare, unit = named(name, unit)
    fault = kind_fault(variable.data.dtype.kind)
    along = int(np.argmax(shape))
    dimension = str(variable.dimensions[along])
    columns = 1 if len(shape) == 1 else min(shape)
    found = []
    for k in range(columns):
        mark = "" if columns == 1 else f"[{k + 1}]"
        as_it_is = _reader(variable, k, along)
        read = unpacked(as_it_is, own)
        plain = read is as_it_is and len(shape) == 1 and variable.data.dtype.kind == "f"
        clock = clock_of(own) or clock_of(about)
        axis = dimension if dimension != name and clock is None else ""
        found.append(
            Series(
                f"{name}{mark}",
                f"{bare}{mark}",
                unit,
                shape[along],
                read,
                fill=_filling(variable) if plain else None,
                clock=clock,
                axis=axis,
                fault=fault,
                sensor=sensor_said(own),
            )
        )
    return found, date


def _reader(variable: Any, column: int, along: int) -> Any:
    def read(begin: int, end: int) -> Any:
        data = variable.data
        if data.ndim == 1:
            part = data[begin:end]
        else:
            part = data[begin:end, column] if along == 0 else data[column, begin:end]
        return np.array(part, dtype=part.dtype.newbyteorder("="))

    return read


def _filling(variable: Any) -> Any:
    def fill(begin: int, into: Array) -> None:
        into[:] = variable.data[begin : begin + into.size]

    return fill
