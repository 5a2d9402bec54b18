"""What kind of result a file holds, told by its content."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from aerobalance.io import arrow_file, hdf5_file, hdf5_foreign, hdf5_rows, mat_file, uff_file
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.opening import opened_file
from aerobalance.io.series import Reader
from aerobalance.recording.errors import ReadError

PAGE: Final = "page"
TABLE: Final = "table with uncertainties"
CONVERTED: Final = "converted recording"
EMPTY: Final = "empty"

_KIND: Final = re.compile(r'\s*\{\s*"kind"\s*:\s*"([^"]*)"')
_GENERATOR: Final = re.compile(r'<meta\s+name="generator"\s+content="aerobalance')


def kind_of(path: Path) -> str:
    """Kind of result that a file holds.

    Parameters
    ----------
    path
        A file that exists.

    Returns
    -------
    str
        The ``kind`` of a JSON artefact; `PAGE` for a report of this program, `TABLE` for loads or forces with their
        standard uncertainties, `CONVERTED` for a recording in HDF5 that was converted from another file; `EMPTY`; an
        empty string for everything else.
    """
    try:
        with opened_file(path) as file:
            head = file.read(65536)
    except ReadError:
        return ""
    if not head:
        return EMPTY
    if hdf5_file.can_read(head, path):
        return _of_hdf5(path)
    for reader in (arrow_file, mat_file, uff_file):
        if reader.can_read(head, path):
            return _of_series(path, reader)
    return _of_text(head)


def _of_text(head: bytes) -> str:
    text = head.decode("utf-8", errors="replace")  # which is what the program writes
    artefact = _KIND.match(text)
    if artefact is not None:
        return artefact[1].removeprefix("coupled ")  # both are dynamics to whoever names the file
    if _GENERATOR.search(text):
        return PAGE
    line = text.split("\n", 1)[0].rstrip("\r")
    separator = max(",;\t", key=line.count)
    return TABLE if _has_uncertainties([label.partition(" [")[0] for label in line.split(separator)]) else ""


def _of_hdf5(path: Path) -> str:
    with contextlib.suppress(ReadError):
        found = contents(path)
        if found.reason == hdf5_rows.CONVERTED:
            names = ["time", *(channel.name for channel in found.channels)]
            return TABLE if _has_uncertainties(names) else CONVERTED
        return ""
    return _of_series(path, hdf5_foreign)  # NetCDF


def _of_series(path: Path, reader: Reader) -> str:
    """Kind of a file whose columns stand in any order."""
    with contextlib.suppress(ReadError), reader.opened(path) as found:
        names = {series.name for series in found.series}
        clocked = "time" in names or all(series.clock is not None for series in found.series)
        if clocked and any(f"u_{name}" in names for name in names):
            return TABLE
    return ""


def _has_uncertainties(names: Sequence[str]) -> bool:
    """Whether the columns are time, a quantity and its standard uncertainty, as `loads` and `force` write them."""
    return len(names) > 2 and names[0] == "time" and names[2] == f"u_{names[1]}"
