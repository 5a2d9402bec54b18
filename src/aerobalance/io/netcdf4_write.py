"""NetCDF-4 files written after the conventions of CF; they are read as HDF5 (see `hdf5_foreign`)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from aerobalance.io.columns import Append, split_label, time_label
from aerobalance.io.format_library import library_to_write
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.io.measure import without_infinities
from aerobalance.io.safe_write import replacing
from aerobalance.io.sensor_text import KEY, sensor_text
from aerobalance.recording.channel import Array
from aerobalance.recording.version import VERSION

_CHUNK: Final = 1 << 16
_UNITS: Final = {
    "N*m": "N m",
    "m/s^2": "m s-2",
    "rad/s^2": "rad s-2",
    "rad/s": "rad s-1",
    "deg": "degree",
    "°": "degree",
    "degC": "degree_Celsius",
    "°C": "degree_Celsius",
}
"""Units as UDUNITS spells them, where that is not how channels have them."""

_TIMES: Final = {
    "s": "seconds",
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
    "min": "minutes",
    "h": "hours",
}
_LONG: Final = {
    "NF": "normal force",
    "PM": "pitching moment",
    "SF": "side force",
    "YM": "yawing moment",
    "RM": "rolling moment",
    "AF": "axial force",
    "pitch": "pitch angle",
    "roll": "roll angle",
    "temperature": "temperature of the balance",
    "excitation": "excitation voltage of the bridges",
}


@contextlib.contextmanager
def appending(
    path: Path,
    labels: Sequence[str],
    described: Mapping[str, StoredChannel] | None = None,
    *,
    epoch: np.datetime64 | None = None,
    rows: int = 0,
) -> Iterator[Append]:
    """Write columns to netCDF-4 some rows at a time; the file takes its place when all are written.

    Every channel is a variable over the coordinate ``time``, with ``units`` as UDUNITS spells them, ``unit`` as the
    channel has it, and what is known of its ``sensor``. The time counts since the date and time of zero where known.

    Raises
    ------
    ValueError
        There is no column of times, h5netcdf is not installed, or the file cannot be written.
    """
    del rows
    h5netcdf = library_to_write("h5netcdf", "netcdf", path, "NetCDF")
    import h5py  # noqa: PLC0415 - a quarter of a second, and only these files need it

    split = {label: split_label(label) for label in labels}
    time = time_label(path, labels, "a NetCDF file")
    with replacing(path) as beside:
        with h5netcdf.File(beside, "w") as file:
            file.attrs.update(
                {
                    "Conventions": "CF-1.11",
                    "title": path.stem,
                    "source": f"aerobalance {VERSION}",
                    "featureType": "timeSeries",
                }
            )
            file.dimensions = {"time": None}
            places = {}
            for label in labels:
                variable = _variable(file, "time" if label == time else split[label][0])
                places[label] = variable.name
                unit = split[label][1]
                if label == time:
                    variable.attrs.update(_about_time(unit, epoch))
                    continue
                spelled = {"units": _UNITS.get(unit, unit), "unit": unit} if unit else {}
                text = sensor_text(described[label]) if described and label in described else ""
                long = {"long_name": _LONG[split[label][0]]} if split[label][0] in _LONG else {}
                variable.attrs.update(spelled | long | ({KEY: text} if text else {}))
        # h5netcdf looks a variable up some six times at every access, which takes longer than writing a part of it
        with h5py.File(beside, "r+") as file:
            datasets = {label: file[place] for label, place in places.items()}
            written = 0

            def append(columns: Mapping[str, Array]) -> None:
                nonlocal written
                end = written + columns[time].size
                for label, dataset in datasets.items():
                    dataset.resize((end,))
                    dataset[written:end] = without_infinities(columns[label])
                written = end

            yield append


def _variable(file: Any, name: str) -> Any:
    """Make a variable of a name that NetCDF allows."""
    plain = name.replace("/", "_").strip() or "channel"
    variable = file.create_variable(
        plain, ("time",), "f8", chunks=(_CHUNK,), fillvalue=None if plain == "time" else np.nan
    )
    if plain != name:
        variable.attrs["channel_name"] = name
    return variable


def _about_time(unit: str, epoch: np.datetime64 | None) -> dict[str, str]:
    """Attributes of the coordinate of time."""
    about = {"standard_name": "time", "long_name": "time", "axis": "T", "units": unit}
    if epoch is None or unit not in _TIMES:
        return about
    date = str(epoch.astype("datetime64[ns]")).replace("T", " ")
    return about | {"units": f"{_TIMES[unit]} since {date}", "calendar": "proleptic_gregorian"}
