"""Writes docs/formats.md: what is measured of every format, beside the library of the format alone.

    python docs/formats.py [--samples 15000000] [--folder build/formats] [--page docs/formats.md] [NAME ...]
    python docs/formats.py --convert 3000000 [NAME ...]
    python docs/formats.py --damaged 10000 [NAME ...]

Files of twelve channels are written and read, each in a process of its own; of those named, or of all. Rows that were
measured before are kept in FOLDER/rows.json. Takes 4 GB of memory and as much of the disk.

With ``--convert`` files of so many samples are converted, five times in turn with their library, which reads and
writes them alone.

With ``--damaged`` small files are damaged byte by byte and read instead, until so many of every format were: counts
are kept in FOLDER/damaged.json, and what must not be in FOLDER/faults.txt; the format with the fewest is next.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
RATE = 25_000.0
CHANNELS = ("NF", "PM", "SF", "YM", "RM", "AF", "rNF", "rPM", "rSF", "rYM", "rRM", "rAF")
UNITS = ("N", "N*m", "N", "N*m", "N*m", "N", *["mV/V"] * 6)
OWN_MEMORY = {"MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": "1000000000000"}
"""Environment of a process that keeps the memory it has had."""

SLOWEST = "UFF 58"
"""Format whose library takes minutes, beside which the first use of memory is nothing."""

SMALL = {"text (CSV)": 150_000}
"""Samples of the files that are read first, where it takes so many that all libraries are loaded."""

HEAD = """# Formats

Reading twelve channels of {samples} samples each (float64: {size:.0f} MB) from every format, and one of them,
beside the library of the format alone, which turns the same file into the same arrays. Processor times of single
processes that read the file a second time (UFF 58 the first time), from memory and into memory that they have, medians
of three; they vary by a third on a machine that does other work. Peak memory is that of the process with its
libraries. What is read is checked for numbers that no reading is, own HDF5 for its checksums, and text cell by cell,
which the library alone does not do, and which shows where reading is no more than a copy; a recording is made of it
after that. In brackets what can be read without the rest of the file; what is mapped into memory does not count as
read. This page is written by `python docs/formats.py`.

| {heads} |
|---|---|---|---|---|---|---|---|---|
"""

HEADS = (
    "format",
    "samples",
    "library",
    "all channels: s",
    "over the library",
    "peak memory: MB",
    "over the library",
    "one channel: s",
    "read of the file: MB",
)


def column(number: int, samples: int) -> np.ndarray:
    """Return the readings of a channel: noise on a slow sine, as many digits as a 24-bit converter has."""
    rng = np.random.default_rng(number)
    return np.round(np.sin(np.arange(samples) * 1e-3) + 0.01 * rng.standard_normal(samples), 7)


def stamps(samples: int) -> np.ndarray:
    """Return the times of the samples."""
    return np.arange(samples) / RATE


def write_hdf5(path: Path, samples: int) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["fs"] = RATE
        for number, (name, unit) in enumerate(zip(CHANNELS, UNITS, strict=True)):
            file.create_dataset(name, data=column(number, samples)).attrs["unit"] = unit


def write_mat73(path: Path, samples: int) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("fs", data=[[RATE]])
        for number, name in enumerate(CHANNELS):
            data = file.create_dataset(
                name,
                data=column(number, samples)[None, :],
                chunks=(1, min(samples, 1 << 16)),
                compression="gzip",
                compression_opts=1,
            )
            data.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")


def write_recording(path: Path, samples: int) -> None:
    from aerobalance.io.results_file import writing

    with writing(path, samples=samples) as append:
        columns = {"time [s]": stamps(samples)}
        columns |= {f"{n} [{u}]": column(i, samples) for i, (n, u) in enumerate(zip(CHANNELS, UNITS, strict=True))}
        step = 1 << 20
        for begin in range(0, samples, step):
            append({label: values[begin : begin + step] for label, values in columns.items()})


def recorded(path: Path) -> None:
    """Write a recording as the recorder does: 400 samples in blocks of all channels."""
    from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel

    channels = tuple(StoredChannel(name, unit) for name, unit in zip(CHANNELS, UNITS, strict=True))
    writer = BlockWriter(path, channels, rate=RATE, rows=100, provenance=Provenance("a simulated source"))
    table = np.column_stack([column(i, 400) for i in range(12)])
    for tick in range(0, 400, 100):
        writer.append(tick, table[tick : tick + 100])
    writer.finish("asked to stop")


def write_netcdf3(path: Path, samples: int) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(path, "w", version=2) as file:
        file.createDimension("time", samples)
        for number, name in enumerate(("time", *CHANNELS)):
            variable = file.createVariable(name, "d", ("time",))
            variable.units = "s" if name == "time" else UNITS[number - 1]
            variable[:] = stamps(samples) if name == "time" else column(number - 1, samples)


def write_feather(path: Path, samples: int) -> None:
    import pyarrow as pa

    names = [f"{name} [{unit}]" for name, unit in zip(CHANNELS, UNITS, strict=True)]
    table = pa.table([stamps(samples), *(column(i, samples) for i in range(12))], names=["time [s]", *names])
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table, max_chunksize=1 << 18)


def write_zarr(path: Path, samples: int) -> None:
    import zarr

    root = zarr.open_group(path, mode="w")
    root.attrs["fs"] = RATE
    for number, (name, unit) in enumerate(zip(CHANNELS, UNITS, strict=True)):
        array = root.create_array(name, shape=(samples,), chunks=(1 << 20,), dtype="f8")
        array[:] = column(number, samples)
        array.attrs["units"] = unit


def write_mdf(path: Path, samples: int) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        pairs = enumerate(zip(CHANNELS, UNITS, strict=True))
        file.append([Signal(column(i, samples), stamps(samples), name=name, unit=unit) for i, (name, unit) in pairs])
        file.save(path, overwrite=True)


def write_wav(path: Path, samples: int) -> None:
    from scipy.io import wavfile

    table = np.column_stack([np.round(column(i, samples) * 2**22).astype(np.int32) << 8 for i in range(12)])
    wavfile.write(path, int(RATE), table)


def write_tdms(path: Path, samples: int) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path)) as writer:
        given = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
        pairs = enumerate(zip(CHANNELS, UNITS, strict=True))
        writer.write_segment(
            [
                ChannelObject("run", name, column(i, samples), {**given, "unit_string": unit})
                for i, (name, unit) in pairs
            ]
        )


def write_uff(path: Path, samples: int) -> None:
    import pyuff

    for number, (name, unit) in enumerate(zip(CHANNELS, UNITS, strict=True)):
        given = pyuff.prepare_58(
            binary=0,
            func_type=1,
            rsp_node=number + 1,
            rsp_dir=1,
            ref_node=0,
            ref_dir=0,
            data=column(number, samples),
            x=stamps(samples),
            id1=name,
            abscissa_spacing=1,
            abscissa_spec_data_type=17,
            ordinate_spec_data_type=0,
            orddenom_spec_data_type=0,
            z_axis_spec_data_type=0,
            ordinate_axis_units_lab=unit,
            abscissa_min=0.0,
            abscissa_inc=1 / RATE,
        )
        pyuff.UFF(str(path)).write_sets(given, mode="add")


def with_h5py(path: Path) -> list[np.ndarray]:
    import h5py

    with h5py.File(path) as file:
        return [np.asarray(file[name][...], dtype=float).ravel() for name in CHANNELS]


def with_own(path: Path) -> list[np.ndarray]:
    import h5py

    with h5py.File(path) as file:
        return [file["samples"][:, column] for column in range(len(CHANNELS))]


def with_h5netcdf(path: Path) -> list[np.ndarray]:
    import h5netcdf

    with h5netcdf.File(path) as file:
        return [np.asarray(file[name][...]) for name in ("time", *CHANNELS)]


def with_netcdf_file(path: Path) -> list[np.ndarray]:
    from scipy.io import netcdf_file

    with netcdf_file(path, mmap=True) as file:
        return [np.array(file.variables[name].data, dtype="f8") for name in ("time", *CHANNELS)]


def with_loadmat(path: Path) -> list[np.ndarray]:
    from scipy.io import loadmat

    found = loadmat(path)
    return [found[name].ravel() for name in ("time", *CHANNELS)]


def with_pyuff(path: Path) -> list[np.ndarray]:
    import pyuff

    return [one["data"] for one in pyuff.UFF(str(path)).read_sets()]


def with_parquet(path: Path) -> list[np.ndarray]:
    import pyarrow.parquet as pq

    table = pq.read_table(path, use_threads=False)
    return [one.to_numpy() for one in table.columns]


def with_arrow(path: Path) -> list[np.ndarray]:
    import pyarrow as pa

    with pa.memory_map(str(path)) as source:
        return [one.to_numpy() for one in pa.ipc.open_file(source).read_all().columns]


def with_zarr(path: Path) -> list[np.ndarray]:
    import zarr

    root = zarr.open_group(path, mode="r")
    return [root[name][:] for name in CHANNELS]


def with_asammdf(path: Path) -> list[np.ndarray]:
    from asammdf import MDF

    with MDF(path) as file:
        return [file.get_master(0), *(file.get(name, samples_only=True)[0] for name in CHANNELS)]


def with_wavfile(path: Path) -> list[np.ndarray]:
    from scipy.io import wavfile

    _, table = wavfile.read(path, mmap=True)
    return [table[:, i] / 2.0**31 for i in range(12)]


def with_nptdms(path: Path) -> list[np.ndarray]:
    from nptdms import TdmsFile

    file = TdmsFile.read(path)
    return [file["run"][name][:] for name in CHANNELS]


def with_pandas(path: Path) -> list[np.ndarray]:
    import pandas as pd

    frame = pd.read_csv(path)
    return [frame[name].to_numpy() for name in frame.columns]


Way = tuple[str, str, str, Callable[[Path, int], None], Callable[[Path], Any], str]
FORMATS: dict[str, Way] = {
    "own HDF5": ("own.h5", "h5py", "part", write_recording, with_own, "AF"),
    "HDF5 of others": ("other.h5", "h5py", "part", write_hdf5, with_h5py, "AF"),
    "MATLAB 7.3": ("seven.mat", "h5py", "part", write_mat73, with_h5py, "AF"),
    "MATLAB 5": ("five.mat", "scipy", "part", write_recording, with_loadmat, "AF"),
    "NetCDF-4": ("four.nc", "h5netcdf", "part", write_recording, with_h5netcdf, "AF"),
    "NetCDF-3": ("three.nc", "scipy", "part", write_netcdf3, with_netcdf_file, "AF"),
    "Parquet": ("a.parquet", "pyarrow", "row group", write_recording, with_parquet, "AF [N]"),
    "Arrow": ("a.feather", "pyarrow", "part", write_feather, with_arrow, "AF [N]"),
    "Zarr": ("a.zarr", "zarr", "chunk", write_zarr, with_zarr, "AF"),
    "MDF 4": ("a.mf4", "asammdf", "part", write_mdf, with_asammdf, "1/AF"),
    "WAV": ("a.wav", "scipy", "part", write_wav, with_wavfile, "channel 6"),
    "LabVIEW TDMS": ("a.tdms", "npTDMS", "part", write_tdms, with_nptdms, "run/AF"),
    "UFF 58b": ("b.uff", "pyuff", "part", write_recording, with_pyuff, "AF"),
    "UFF 58": ("t.uff", "pyuff", "data set", write_uff, with_pyuff, "AF"),
    "text (CSV)": ("a.csv", "pandas", "-", write_recording, with_pandas, "AF"),
}


DAMAGED = (*FORMATS, "LabVIEW LVM")
"""Formats of which damaged files are read."""


def with_this(path: Path, keys: list[str] | None) -> list[np.ndarray]:
    """Read columns as the commands do, before they are made channels."""
    from aerobalance.io import format_of
    from aerobalance.recording.errors import DataQualityWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return [one.values for one in format_of(path).read_columns(path, wanted=keys).columns]


def measured(task: Callable[[], Any]) -> dict[str, float]:
    """Processor time [s], peak memory of the process [MB], and bytes read from files [MB]."""
    before, start = bytes_read(), time.process_time()
    kept = task()
    spent = time.process_time() - start
    assert all(np.isfinite(one[-1]) for one in kept)
    # of this process alone: ru_maxrss begins with what the process had that started it
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024
    return {"seconds": spent, "peak": peak, "read": (bytes_read() - before) / 1e6}


def bytes_read() -> int:
    """Bytes that this process has asked the system for."""
    return int(Path("/proc/self/io").read_text(encoding="ascii").split()[1])


def child(name: str, way: str, path: Path) -> None:
    """Measure one way and print it."""
    file, _, _, _, alone, key = FORMATS[name]
    del file
    small = path.with_name(f"small-{path.name}")
    keys = {"WAV": [f"channel {i + 1}" for i in range(12)], "MATLAB 7.3": list(CHANNELS)}
    everything = keys.get(name)
    tasks = {
        "alone": alone,
        "all": lambda given: with_this(given, everything),
        "one": lambda given: with_this(given, [key]),
    }
    warnings.simplefilter("ignore")
    tasks[way](small)  # libraries are loaded and warm
    if name != SLOWEST:
        tasks[way](
            path
        )  # the process has the memory, whose first use takes as long as the reading, or several times that
    print(json.dumps(measured(lambda: tasks[way](path))))


def row(name: str, samples: int, folder: Path) -> dict[str, Any]:
    """Measure one format, each way three times in turn: the medians."""
    file, library, lazy, write, _, _ = FORMATS[name]
    path = folder / file
    for place, count in ((path, samples), (folder / f"small-{file}", SMALL.get(name, 1000))):
        if place.is_dir():
            shutil.rmtree(place)
        place.unlink(missing_ok=True)
        write(place, count)
    size = (
        sum(one.stat().st_size for one in path.rglob("*") if one.is_file()) if path.is_dir() else path.stat().st_size
    )
    found: dict[str, Any] = {"name": name, "library": library, "lazy": lazy, "samples": samples, "size": size / 1e6}
    rounds: dict[str, list[dict[str, float]]] = {"alone": [], "all": [], "one": []}
    for _ in range(3):
        for way, kept in rounds.items():
            command = [sys.executable, __file__, "--child", name, way, str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | OWN_MEMORY)
            kept.append(json.loads(done.stdout.splitlines()[-1]))
    for way, kept in rounds.items():
        found[way] = {key: float(np.median([one[key] for one in kept])) for key in kept[0]}
    for place in (path, folder / f"small-{file}"):
        shutil.rmtree(place) if place.is_dir() else place.unlink()
    return found


def write_alone_hdf5(path: Path, columns: list[np.ndarray]) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in zip(CHANNELS, columns, strict=True):
            file.create_dataset(name, data=values)


def write_alone_mat(path: Path, columns: list[np.ndarray]) -> None:
    from scipy.io import savemat

    names = ("time", *CHANNELS)
    units = dict(zip(names, ("s", *UNITS), strict=True))
    savemat(path, dict(zip(names, columns, strict=True)) | {"units": units}, oned_as="column")


def write_alone_netcdf(path: Path, columns: list[np.ndarray]) -> None:
    import h5netcdf

    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"time": columns[0].size}
        for name, unit, values in zip(("time", *CHANNELS), ("s", *UNITS), columns, strict=True):
            file.create_variable(name, ("time",), "f8", data=values).attrs["units"] = unit


def write_alone_parquet(path: Path, columns: list[np.ndarray]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(list(columns), names=["time", *CHANNELS]), path)


def write_alone_uff(path: Path, columns: list[np.ndarray]) -> None:
    import pyuff

    for number, (name, values) in enumerate(zip(CHANNELS, columns, strict=True)):
        even = {"abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1 / RATE, "x": stamps(values.size)}
        node = {"rsp_node": number + 1, "rsp_dir": 1, "ref_node": 0, "ref_dir": 0}
        kinds = dict.fromkeys(("abscissa", "orddenom", "z_axis", "ordinate"), 0)
        given = pyuff.prepare_58(
            binary=1,
            func_type=1,
            id1=name,
            data=values,
            **node,
            **even,
            **{f"{key}_spec_data_type": value for key, value in kinds.items()},
        )
        pyuff.UFF(str(path)).write_sets(given, mode="add")


def write_alone_csv(path: Path, columns: list[np.ndarray]) -> None:
    import pandas as pd

    pd.DataFrame(dict(zip(("time", *CHANNELS), columns, strict=True))).to_csv(path, index=False)


def from_columns(write: Callable[[Path, list[np.ndarray]], None]) -> Callable[[Path, int], None]:
    """Return what writes a file by its library alone."""
    return lambda path, samples: write(path, [stamps(samples), *(column(i, samples) for i in range(12))])


Converted = tuple[
    str, str, Callable[[Path, int], None], Callable[[Path], Any], Callable[[Path, list[np.ndarray]], None]
]
CONVERTED: dict[str, Converted] = {
    "HDF5": ("h5", "h5py", write_hdf5, with_h5py, write_alone_hdf5),
    "MATLAB 5": ("mat", "scipy", from_columns(write_alone_mat), with_loadmat, write_alone_mat),
    "NetCDF-4": ("nc", "h5netcdf", from_columns(write_alone_netcdf), with_h5netcdf, write_alone_netcdf),
    "Parquet": ("parquet", "pyarrow", write_recording, with_parquet, write_alone_parquet),
    "UFF 58b": ("uff", "pyuff", write_recording, with_pyuff, write_alone_uff),
    "text (CSV)": ("csv", "pandas", write_recording, with_pandas, write_alone_csv),
}
"""Formats that are converted into themselves: ending, library, and what makes, reads and writes a file."""

PAIRS = 5
MORE_PAIRS = {"HDF5": 11}
"""Pairs that are measured, and of which format more: its library takes ten times as long at one time as at others."""


def convert_child(name: str, way: str, path: Path) -> None:
    """Convert a file one way and print the times of it."""
    from aerobalance.app.commands.recordings import convert

    _, _, _, read, write = CONVERTED[name]
    tasks = {"alone": lambda given, out: write(out, read(given)), "own": lambda given, out: convert([given], out)}
    warnings.simplefilter("ignore")
    for given in (path.with_name(f"small-{path.name}"), path):
        out = path.with_name(f"out-{path.name}")
        out.unlink(missing_ok=True)
        before, start = time.process_time(), time.perf_counter()
        tasks[way](given, out)
        found = {"seconds": time.process_time() - before, "elapsed": time.perf_counter() - start}
    print(json.dumps(found))


def convert_row(name: str, samples: int, folder: Path) -> dict[str, Any]:
    """Measure the conversion of one format beside its library: medians of the times, and of what pairs differ by."""
    ending, library, make, _, _ = CONVERTED[name]
    path = folder / f"converted.{ending}"
    made = (path.with_name(f"small-{path.name}"), path)
    for place, count in zip(made, (150_000, samples), strict=True):
        place.unlink(missing_ok=True)
        make(place, count)
    ways: dict[str, list[dict[str, float]]] = {"alone": [], "own": []}
    for _ in range(MORE_PAIRS.get(name, PAIRS)):
        for way, kept in ways.items():
            command = [sys.executable, __file__, "--convert-child", name, way, str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
            kept.append(json.loads(done.stdout.splitlines()[-1]))
    for place in (*made, path.with_name(f"out-{path.name}")):
        place.unlink()
    found: dict[str, Any] = {"name": name, "library": library, "samples": samples}
    for key in ("seconds", "elapsed"):
        alone, own = (np.array([one[key] for one in ways[way]]) for way in ("alone", "own"))
        found[key] = [float(np.median(one)) for one in (alone, own, alone / own)]
    return found


CONVERT_HEAD = """
## Converting

Files of twelve channels of {samples} samples with their times, converted by `aerobalance convert` into the same
format, beside the library of the format alone, which reads such a file and writes what it has read; files of HDF5,
MATLAB and NetCDF are as the library writes them. HDF5 is written as own HDF5, whose checksums the library has not;
what is read is looked through for what is missing, beyond all measure or at a limit. Medians of five pairs (HDF5:
eleven), each in a process of its own; speed is the median of what pairs differ by, 1 for as fast as the library. The
library writes HDF5 in pieces of 24 MB, for which the system at times has to find memory first: it took from 0.10 s to
1.3 s, `convert` from 0.25 s to 0.29 s, so that the speed is 0.4 where nothing has to be found. Elapsed time has the
wait until the file is safe on the disk, for which the library does not wait. Written by `python docs/formats.py
--convert 3000000`.

| format | library | processor time, library: s | `convert`: s | speed | elapsed, library: s | `convert`: s | speed |
|---|---|---|---|---|---|---|---|
"""


def convert_table(rows: list[dict[str, Any]]) -> str:
    """Return the part of the page on conversions."""
    lines = []
    for one in rows:
        cells = [
            f"{value:.2g}" if place < 2 else f"{value:.2f}"
            for key in ("seconds", "elapsed")
            for place, value in enumerate(one[key])
        ]
        lines.append(f"| {' | '.join([one['name'], one['library'], *cells])} |")
    samples = f"{rows[0]['samples']:,}".replace(",", " ") if rows else ""
    return CONVERT_HEAD.format(samples=samples) + "\n".join(lines) + "\n" if rows else ""


DAMAGED_AT_ONCE = 1000
"""Damaged copies of one file that are read by one process."""


def originals(name: str, folder: Path) -> list[tuple[Path, str]]:
    """Write small files of a format, as several programs do, and return them, each with the channel map it needs."""
    from aerobalance.io import template
    from helpers.foreign_files import FILES
    from helpers.text_exports import EXPORTS, completed

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    found = []
    if name in FORMATS:
        file, _, _, write, _, _ = FORMATS[name]
        write(folder / file, 200)
        keys = ["AF"] if name == "MATLAB 7.3" else ["channel 6"] if name == "WAV" else []
        lines = [f'[channels.AF]\ncolumn = "{key}"\nunit = "N"\n' for key in keys]
        if lines:
            (folder / "own.toml").write_text("".join(lines), encoding="utf-8")
        found.append((folder / file, str(folder / "own.toml") if lines else ""))
    if name == "own HDF5":
        path = folder / "recorded.h5"
        recorded(path)
        found.append((path, ""))
    for given in FILES:
        if given.name in OF_OTHERS.get(name, ()):
            given.make(folder / given.name)
            found.append((folder / given.name, ""))
    for export in [make() for make in EXPORTS] if name in ("text (CSV)", "LabVIEW LVM") else []:
        if export.name.endswith(".lvm") == (name == "LabVIEW LVM"):
            path, toml = folder / f"{len(found)}-{export.name}", folder / f"{len(found)}.toml"
            path.write_bytes(export.content)
            toml.write_text(completed(template(path), export.names), encoding="utf-8")
            found.append((path, str(toml)))
    return found


OF_OTHERS = {
    "MATLAB 5": ("plain.mat", "packed.mat", "struct.mat"),
    "MATLAB 7.3": ("new.mat",),
    "HDF5 of others": ("paths.h5", "table.h5"),
    "NetCDF-4": ("four.nc", "dated.nc"),
    "NetCDF-3": ("three.nc",),
    "Zarr": ("three.zarr", "dated.zarr", "two.zarr", "store.zip", "folder.zip"),
    "Parquet": ("columns.parquet",),
    "Arrow": ("columns.feather", "columns.arrows"),
    "MDF 4": ("plain.mf4", "packed.mf4"),
    "UFF 58": ("text.uff",),
    "UFF 58b": ("binary.uff", "uneven.uff"),
}
"""Small files of other programs that are damaged, by format."""


def damage(names: list[str], wanted: int, folder: Path, save: Callable[[], None]) -> None:
    """Read damaged copies until there are so many of every format, and keep the counts."""
    from helpers.mutations import trial, without_place

    files: dict[str, list[tuple[Path, str]]] = {}
    while True:
        rows = kept_rows(folder / "damaged.json")
        name = min(names, key=lambda one: rows.get(one, {}).get("files", 0))
        row = rows.setdefault(
            name, {"name": name, "files": 0, "read": 0, "refused": 0, "faults": 0, "longest": 0.0, "most": 0.0}
        )
        if row["files"] >= wanted:
            return
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ways = files.setdefault(name, [])
            ways += [] if ways else originals(name, folder / "originals" / name.replace(" ", "-"))
        block = row["files"] // DAMAGED_AT_ONCE
        path, toml = ways[block % len(ways)]
        found = trial([path], folder / "damaged", count=DAMAGED_AT_ONCE, seed=block, channel_map=toml)
        faults = [*found.faults, *(f"no place: {text}" for text in without_place(found.words))]
        with (folder / "faults.txt").open("a", encoding="utf-8") as file:
            file.writelines(f"{name}, {path}, block {block}: {text}\n" for text in faults)
        row |= {key: row[key] + getattr(found, key) for key in ("read", "refused")}
        row |= {"files": row["files"] + DAMAGED_AT_ONCE, "faults": row["faults"] + len(faults)}
        row |= {key: max(row[key], getattr(found, key)) for key in ("longest", "most")}
        (folder / "damaged.json").write_text(json.dumps(list(rows.values()), indent=1), encoding="utf-8")
        save()


def kept_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Rows that were measured before, by name."""
    return {one["name"]: one for one in json.loads(path.read_text(encoding="utf-8"))} if path.exists() else {}


DAMAGED_HEADS = (
    "format",
    "damaged files",
    "read",
    "refused",
    "faults",
    "longest: s",
    "most memory: MB",
)

DAMAGED_HEAD = """
## Damaged files

Small files of every format, as this program and others write them, of which some bytes are changed, cut out or put
in, mostly near either end. Each is looked at (as by `aerobalance map`) and read, in a process of its own for every
{at_once} of them. A fault would be a traceback, a process that dies, more than 5 s of processor time, more than 1 GB
of memory beside what the process had before, or a refusal that does not name the file and the place in it. Files are
read where the damage leaves their meaning alone. All of HDF5, MATLAB 7.3, NetCDF, Arrow and WAV were read since these
are read a piece at a time, of every other format 2000, by what only looks at readings in another way. Written by
`python docs/formats.py --damaged 11000`.

| {heads} |
|---|---|---|---|---|---|---|
"""


def damaged_table(rows: list[dict[str, Any]]) -> str:
    """Return the part of the page on damaged files."""
    lines = []
    for one in rows:
        counts = [f"{one[key]:,}".replace(",", " ") for key in ("files", "read", "refused", "faults")]
        cells = [one["name"], *counts, f"{one['longest']:.2g}", f"{one['most'] / 1e6:.0f}"]
        lines.append(f"| {' | '.join(cells)} |")
    head = DAMAGED_HEAD.format(at_once=DAMAGED_AT_ONCE, heads=" | ".join(DAMAGED_HEADS))
    return head + "\n".join(lines) + "\n" if rows else ""


def page(rows: list[dict[str, Any]], samples: int) -> str:
    """Return the page."""
    lines = []
    for one in rows:
        whole, alone, single = one["all"], one["alone"], one["one"]
        cells = [
            f"{one['name']} ({one['lazy']})",
            f"{one['samples']:,}".replace(",", " "),
            one["library"],
            f"{whole['seconds']:.2g}",
            f"{whole['seconds'] / max(alone['seconds'], 1e-3):.2f}",
            f"{whole['peak']:.0f}",
            f"{whole['peak'] / alone['peak']:.2f}",
            f"{single['seconds']:.2g}",
            f"{single['read']:.0f} of {one['size']:.0f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    head = HEAD.format(samples=f"{samples:,}".replace(",", " "), size=samples * 96 / 1e6, heads=" | ".join(HEADS))
    return head + "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write the page."""
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
        return
    if sys.argv[1:2] == ["--convert-child"]:
        convert_child(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
        return
    parser = argparse.ArgumentParser(description="Measure every format.")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--samples", type=int, default=15_000_000)
    parser.add_argument("--folder", type=Path, default=HERE.parent / "build" / "formats")
    parser.add_argument("--page", type=Path, default=HERE / "formats.md")
    parser.add_argument("--convert", type=int)
    parser.add_argument("--damaged", type=int)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    rows = kept_rows(given.folder / "rows.json")

    def save() -> None:
        damaged = kept_rows(given.folder / "damaged.json")
        ordered = [rows[name] for name in FORMATS if name in rows]
        text = page(ordered, given.samples)
        converted = kept_rows(given.folder / "converted.json")
        text += convert_table([converted[name] for name in CONVERTED if name in converted])
        text += damaged_table([damaged[name] for name in DAMAGED if name in damaged])
        given.page.write_text(text, encoding="utf-8")

    if given.convert:
        for name in given.names or CONVERTED:
            converted = kept_rows(given.folder / "converted.json")
            converted[name] = convert_row(name, given.convert, given.folder)
            text = json.dumps(list(converted.values()), indent=1)
            (given.folder / "converted.json").write_text(text, encoding="utf-8")
            print(name, converted[name], flush=True)
            save()
        return
    if given.damaged:
        sys.path.insert(0, str(HERE.parent / "tests"))
        damage(given.names or list(DAMAGED), given.damaged, given.folder, save)
        return
    for name in given.names or FORMATS:
        rows[name] = row(name, given.samples, given.folder)
        (given.folder / "rows.json").write_text(json.dumps(list(rows.values()), indent=1), encoding="utf-8")
        print(name, rows[name]["all"]["seconds"] / max(rows[name]["alone"]["seconds"], 1e-3), flush=True)
        save()


if __name__ == "__main__":
    main()
