"""Recordings of other programs in binary formats, each made by the library of its format."""

from __future__ import annotations

import contextlib
import gc
import io
import shutil
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RATE = 1000.0
TIME = np.arange(400) / RATE
LOAD = np.round(100 * np.sin(30 * TIME) + 3 * np.cos(400 * TIME), 9)
"""Axial load, shape (n,) [N]."""

PITCH = np.round(2 + 0.1 * np.cos(7 * TIME), 9)
"""Pitch, shape (n,) [deg]."""

BEGAN = np.datetime64("2024-03-12T10:15:00.125", "ns")
"""Date and time of time zero, where the format has a place for it."""


@dataclass(frozen=True)
class Foreign:
    """One file.

    Attributes
    ----------
    name
        Its name.
    make
        Writes it.
    column
        What a channel map calls the column of the load.
    lazy
        Whether one channel can be read without the others.
    error
        Largest error of a sample, from the digits of the format.
    dated
        Whether it says when time zero was.
    """

    name: str
    make: Callable[[Path], None]
    column: str | int
    lazy: bool = True
    error: float = 0.0
    dated: bool = False


def _mat(path: Path, **settings: bool) -> None:
    from scipy.io import savemat

    units = {"time": "s", "AF": "N", "pitch": "deg"}
    savemat(path, {"time": TIME, "AF": LOAD, "pitch": PITCH, "units": units}, oned_as="column", **settings)


def _mat_struct(path: Path) -> None:
    from scipy.io import savemat

    run = {"fs": RATE, "AF": LOAD, "pitch": PITCH, "units": {"AF": "N", "pitch": "deg"}}
    savemat(path, {"run": run, "note": "wind off"})


def _mat73(path: Path) -> None:
    """As MATLAB writes it: a user block, texts as whole numbers, arrays turned."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("AF", LOAD), ("pitch", PITCH), ("time", TIME)):
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        units = file.create_group("units")
        units.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, unit in (("AF", "N"), ("pitch", "deg"), ("time", "s")):
            text = np.array([[ord(sign)] for sign in unit], dtype=np.uint16)
            units.create_dataset(name, data=text).attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as stream:
        stream.write(
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Tue Mar 12 10:15:00 2024 HDF5 schema 1.00 ."
        )


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        run = file.create_group("test/run 1")
        run.attrs["sampling rate"] = RATE
        run.attrs["epoch"] = str(BEGAN)
        load = run.create_dataset("AF", data=LOAD, compression="gzip", chunks=(100,))
        load.attrs["unit"] = "N"
        pitch = run.create_dataset("pitch", data=np.round(1e9 * PITCH).astype(np.int64))
        pitch.attrs.update({"unit": "deg", "scale_factor": 1e-9})


def _hdf5_table(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        table = np.rec.fromarrays([TIME, LOAD, PITCH], names=["time [s]", "AF [N]", "pitch [deg]"])
        file.create_dataset("table", data=np.asarray(table))


def _dataset(*, dated: bool) -> object:
    import xarray as xr

    stamps = BEGAN + np.round(TIME * 1e9).astype("timedelta64[ns]")
    coordinate = stamps if dated else ("time", TIME, {"units": "s"})
    channels = {"AF": ("time", LOAD, {"units": "N"}), "pitch": ("time", PITCH, {"units": "degree"})}
    return xr.Dataset(channels, coords={"time": coordinate})


def _netcdf(engine: str, *, dated: bool) -> Callable[[Path], None]:
    return lambda path: _dataset(dated=dated).to_netcdf(path, engine=engine)


def _zarr(version: int, *, dated: bool) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _dataset(dated=dated).to_zarr(path, zarr_format=version, consolidated=False)

    return make


def _zipped(*, packed: bool) -> Callable[[Path], None]:
    """As zarr writes an archive itself, or a folder that somebody packed."""

    def make(path: Path) -> None:
        import zarr

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if packed:
                folder = path.with_name("run.zarr")
                _dataset(dated=False).to_zarr(folder, zarr_format=3, consolidated=False)
                made = shutil.make_archive(str(path), "zip", folder.parent, folder.name)
                Path(made).replace(path)
                shutil.rmtree(folder)
            else:
                with zarr.storage.ZipStore(path, mode="w") as store:
                    _dataset(dated=False).to_zarr(store, zarr_format=3, consolidated=False)

    return make


def _frame() -> object:
    import pandas as pd

    return pd.DataFrame({"time [s]": TIME, "AF [N]": LOAD, "pitch [deg]": PITCH})


def _arrow_stream(path: Path) -> None:
    import pyarrow as pa

    table = pa.Table.from_pandas(_frame())
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)


def _mdf(compression: int) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        from datetime import UTC, datetime

        from asammdf import MDF, Signal

        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with MDF(version="4.10") as file:
                file.start_time = datetime(2024, 3, 12, 10, 15, 0, 125_000, tzinfo=UTC)
                file.append([Signal(LOAD, TIME, name="AF", unit="N"), Signal(PITCH, TIME, name="pitch", unit="deg")])
                file.save(path, overwrite=True, compression=compression)

    return make


def _uff(binary: int, *, even: bool = True) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        import pyuff

        for number, (name, unit, values) in enumerate((("AF", "N", LOAD), ("pitch", "deg", PITCH)), start=1):
            given = pyuff.prepare_58(
                binary=binary,
                func_type=1,
                rsp_node=number,
                rsp_dir=1,
                ref_node=0,
                ref_dir=0,
                data=values,
                x=TIME,
                id1=name,
                id3="12-Mar-24 10:15:00",
                abscissa_spacing=int(even),
                abscissa_spec_data_type=17,
                ordinate_spec_data_type=0,
                orddenom_spec_data_type=0,
                z_axis_spec_data_type=0,
                ordinate_axis_units_lab=unit,
                abscissa_min=0.0,
                abscissa_inc=1 / RATE,
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResourceWarning)  # it leaves files open
                pyuff.UFF(str(path)).write_sets(given, mode="add")
                gc.collect()

    return make


FILES: tuple[Foreign, ...] = (
    Foreign("plain.mat", _mat, "AF"),
    Foreign("packed.mat", lambda path: _mat(path, do_compression=True), "AF"),
    Foreign("struct.mat", _mat_struct, "run.AF", lazy=False),
    Foreign("new.mat", _mat73, "AF"),
    Foreign("paths.h5", _hdf5, "test/run 1/AF", error=1e-15, dated=True),
    Foreign("table.h5", _hdf5_table, "table.AF [N]", lazy=False),
    Foreign("four.nc", _netcdf("h5netcdf", dated=False), "AF"),
    Foreign("dated.nc", _netcdf("h5netcdf", dated=True), "AF", dated=True),
    Foreign("three.nc", _netcdf("scipy", dated=False), "AF"),
    Foreign("three.zarr", _zarr(3, dated=False), "AF"),
    Foreign("dated.zarr", _zarr(3, dated=True), "AF", dated=True),
    Foreign("two.zarr", _zarr(2, dated=True), "AF", dated=True),
    Foreign("store.zip", _zipped(packed=False), "AF"),
    Foreign("folder.zip", _zipped(packed=True), "AF"),
    Foreign("columns.parquet", lambda path: _frame().to_parquet(path), "AF [N]"),
    Foreign("columns.feather", lambda path: _frame().to_feather(path), "AF [N]"),
    Foreign("columns.arrows", _arrow_stream, "AF [N]"),
    Foreign("plain.mf4", _mdf(0), "1/AF", dated=True),
    Foreign("packed.mf4", _mdf(2), "1/AF", dated=True),
    Foreign("text.uff", _uff(0), "AF", error=1e-9, dated=True),
    Foreign("binary.uff", _uff(1), "AF", dated=True),
    Foreign("uneven.uff", _uff(1, even=False), "AF", dated=True),
)


def wav(path: Path, channels: Mapping[str, np.ndarray] | None = None) -> None:
    """Write 16-bit WAV of two channels: load and pitch as shares of full scale."""
    from scipy.io import wavfile

    values = channels or {"AF": LOAD / 200, "pitch": PITCH / 4}
    table = np.column_stack([np.round(32768 * one) for one in values.values()])
    wavfile.write(path, round(RATE), table.astype(np.int16))
