"""HDF5 files of other programs: data sets by their path, NetCDF-4 and MATLAB 7.3 among them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from aerobalance.io.format_library import library_faults
from aerobalance.io.hdf5_closing import SIGNATURE
from aerobalance.io.hdf5_direct import Filling, is_plain
from aerobalance.io.hdf5_heaps import check_heaps
from aerobalance.io.hdf5_layout import FORMAT
from aerobalance.io.said_by_file import (
    clock_of,
    epoch_of,
    number_of,
    plain_keys,
    sensor_said,
    since,
    text_of,
    unit_of,
    unpacked,
)
from aerobalance.io.series import MOST_COLUMNS, MOST_SERIES, Holdings, Matrix, Series, kind_fault, named, with_axes
from aerobalance.recording.errors import ReadError

if TYPE_CHECKING:
    import h5py

NAME: Final = "HDF5"
"""What to call the format in messages."""

MATLAB: Final = b"MATLAB 7.3 MAT-file"
"""The first bytes of a MATLAB file that is HDF5 within."""

_PACKED: Final = 1100
"""Most that a sample of a data set may be larger than what is stored of it: deflate makes 1032 to 1 at best."""

_SMALL: Final = 1 << 20
_DEEPEST: Final = 12
_LONGEST_ATTRIBUTE: Final = 4096
_MOST_ATTRIBUTES: Final = 200


def can_read(head: bytes, path: Path) -> bool:
    """Return whether a file is HDF5 of another program, from its first bytes and its attribute ``format``."""
    if head.startswith(MATLAB):
        return True
    if not head.startswith(SIGNATURE):
        return False
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    try:
        check_heaps(path)
        with h5py.File(path, "r") as file:
            return "format" not in file.attrs or text_of(file.attrs["format"]) != FORMAT
    except Exception:  # noqa: BLE001 - damaged, or being written: then the recorder's own reader says what is wrong
        return False


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Holdings]:
    """Open a file to read its data sets of numbers as series, by their paths.

    Raises
    ------
    ReadError
        The file is damaged.
    """
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    with contextlib.ExitStack() as stack:
        with library_faults(path, NAME, "its structure"):
            check_heaps(path)
            file = stack.enter_context(h5py.File(path, "r"))
        with library_faults(path, NAME, "its data sets"):
            walk = _Walk(path, path.stat().st_size)
            walk.group(file, "", 0)
            found = Holdings(with_axes(walk.series), walk.epoch)
        yield found


@dataclass(slots=True)
class _Walk:
    """What is found on the way through the groups of a file."""

    path: Path
    size: int
    series: list[Series] = field(default_factory=list)
    epoch: np.datetime64 | None = None
    seen: set[int] = field(default_factory=set)

    def group(self, group: h5py.Group, place: str, depth: int) -> None:
        """Take the data sets of a group and those below it, each once; links elsewhere are not followed."""
        import h5py  # noqa: PLC0415 - loaded by now

        said = _attributes(group)
        self.epoch = self.epoch if self.epoch is not None else epoch_of(plain_keys(said))
        within: list[tuple[str, h5py.Dataset]] = []
        below: list[tuple[str, h5py.Group]] = []
        for name in group:
            if name.startswith("#") or group.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
                continue
            one = group[name]
            address = h5py.h5o.get_info(one.id).addr
            if address in self.seen:
                continue
            self.seen.add(address)
            label = f"{place}/{name}" if place else name
            if isinstance(one, h5py.Dataset):
                within.append((label, one))
            elif isinstance(one, h5py.Group) and depth < _DEEPEST:
                below.append((label, one))
        beside = {label.rpartition("/")[2]: _scalar(one) for label, one in within}
        units = _unit_table([one for label, one in below if label.rpartition("/")[2].lower() in ("unit", "units")])
        shared = said | {name: value for name, value in beside.items() if value is not None}
        for label, one in within:
            self.data_set(label, one, shared, units)
        for label, deeper in below:
            if not units or label.rpartition("/")[2].lower() not in ("unit", "units"):
                self.group(deeper, label, depth + 1)

    def data_set(self, label: str, one: h5py.Dataset, shared: dict[str, Any], units: dict[str, str]) -> None:
        """Take the series of one data set."""
        if one.dtype.names:
            for name in one.dtype.names[:MOST_COLUMNS]:
                if one.ndim == 1 and one.dtype[name].kind in "fiub" and not one.dtype[name].shape:
                    read = _field_reader(one, name)
                    self._add(f"{label}.{name}", name, one, read, shared=shared, units=units, block=label)
            return
        if one.ndim not in (1, 2) or one.size < 2:
            return
        if one.ndim == 1 or min(one.shape) == 1:
            name = label.rpartition("/")[2]
            self._add(label, name, one, Matrix(one).reader(0), shared=shared, units=units, block="")
        elif min(one.shape) <= MOST_COLUMNS:
            matrix = Matrix(one)
            block = label if one.shape[0] >= one.shape[1] else ""
            for k in range(min(one.shape)):
                name, read = label.rpartition("/")[2], matrix.reader(k)
                self._add(
                    f"{label}[{k + 1}]", name, one, read, shared=shared, units=units, block=block, mark=f"[{k + 1}]"
                )

    def _add(
        self,
        label: str,
        text: str,
        one: h5py.Dataset,
        read: Any,
        *,
        shared: dict[str, Any],
        units: dict[str, str],
        block: str,
        mark: str = "",
    ) -> None:
        if len(self.series) >= MOST_SERIES:
            raise ReadError(self.path, "data sets", f"are more than {MOST_SERIES}, which no recording has")
        own, samples = plain_keys(_attributes(one)), max(one.shape)
        stated = units.get(text, "") or unit_of(own)
        unit, date = since(stated) if "since" in stated else (stated, None)
        self.epoch = self.epoch if self.epoch is not None else date
        name, unit = named(text_of(own.get("channelname")) or text, unit)
        clock = clock_of(own) or (clock_of(plain_keys(shared)) if samples > 1 else None)
        changed, fault = unpacked(read, own), _fault(one, self.size)
        whole = changed is read and not fault and one.size == samples and is_plain(one)
        series = Series(
            label,
            f"{name}{mark}",
            unit,
            samples,
            changed,
            fill=Filling(one, read) if whole else None,
            alias=label.rpartition("/")[2],
            clock=clock,
            axis=_dimension(one),
            fault=fault,
            block=block,
            sensor=sensor_said(own),
        )
        self.series.append(replace(series, axis="" if series.axis == label else series.axis))


def _fault(one: h5py.Dataset, size: int) -> str:
    """Return why a data set cannot be read as readings; an empty string where it can."""
    if not one.dtype.names and (fault := kind_fault(one.dtype.kind)):
        return fault
    if one.external or one.is_virtual:
        return "it takes its data from other files, which are not opened"
    stored = one.id.get_storage_size()
    held = one.size * one.dtype.itemsize
    if stored == 0:
        return "nothing of it is stored"
    if stored > size or held > _PACKED * stored:
        return f"it claims {held} bytes, of which {stored} are stored in a file of {size}: it is damaged"
    piece = math.prod(one.chunks or ()) * one.dtype.itemsize
    if piece > max(_PACKED * size, _SMALL):
        return f"it claims pieces of {piece} bytes in a file of {size}: it is damaged"
    return ""


def _field_reader(one: h5py.Dataset, name: str) -> Any:
    return lambda begin, end: one.fields(name)[begin:end]


def _dimension(one: h5py.Dataset) -> str:
    """Path of the data set that holds the coordinate of the longer dimension; an empty string where there is none."""
    with contextlib.suppress(Exception):
        along = int(np.argmax(one.shape))
        scales = one.dims[along]
        if "DIMENSION_LIST" in one.attrs and len(scales):
            return str(scales[0].name).lstrip("/")
    return ""


def _attributes(holder: h5py.HLObject) -> dict[str, Any]:
    """Attributes that are single numbers or short texts; lists of any length, say, crash the library if damaged."""
    import h5py  # noqa: PLC0415 - loaded by now

    found: dict[str, Any] = {}
    for name in list(holder.attrs)[:_MOST_ATTRIBUTES]:
        if name in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"):
            continue
        with contextlib.suppress(Exception):  # of a kind that h5py does not read: none that is needed here
            known = holder.attrs.get_id(name)
            plain = known.dtype.kind in "fiubSU" or h5py.check_string_dtype(known.dtype) is not None
            if plain and math.prod(known.shape) <= 1 and known.dtype.itemsize <= _LONGEST_ATTRIBUTE:
                found[name] = holder.attrs[name]
    return found


def _scalar(one: h5py.Dataset) -> Any:
    """The number or the text that a data set holds; None where it holds more."""
    with contextlib.suppress(Exception):
        if one.external or one.is_virtual or not 0 < one.size <= _LONGEST_ATTRIBUTE:
            return None
        if text_of(one.attrs.get("MATLAB_class")) == "char":
            return "".join(chr(int(sign)) for sign in np.asarray(one[()]).ravel())
        if one.size == 1 and one.dtype.kind in "fiub":
            return number_of(np.asarray(one[()]))
    return None


def _unit_table(groups: list[h5py.Group]) -> dict[str, str]:
    """Units by name, where a group (a structure of MATLAB) called units holds them."""
    import h5py  # noqa: PLC0415 - loaded by now

    found: dict[str, str] = {}
    for group in groups:
        for name in group:
            if group.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
                continue
            one = group[name]
            text = _scalar(one) if isinstance(one, h5py.Dataset) else None
            if isinstance(text, str):
                found[name] = text
    return found
