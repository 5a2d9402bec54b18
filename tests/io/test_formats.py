"""Binary formats of other programs: files by their libraries are read, and these read what is written."""

import gc
import importlib.util
import json
import struct
import subprocess
import sys
import tomllib
from dataclasses import replace

import h5py
import numpy as np
import pytest

import aerobalance as ab
from aerobalance.app.cli import main
from aerobalance.io import (
    FORMATS,
    column_names,
    format_library,
    load_channel_map,
    mat_write,
    read,
    series_values,
    template,
    write_recording,
)
from aerobalance.io.hdf5_parts import Hdf5Record
from aerobalance.io.long_record import open_record
from aerobalance.io.series_record import SeriesRecord
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import Channel, CrossAxis
from aerobalance.recording.errors import DataQualityWarning, ReadError
from aerobalance.recording.recording import Recording
from helpers.foreign_files import BEGAN, FILES, LOAD, PITCH, RATE, TIME, wav

IDS = [given.name for given in FILES]


@pytest.mark.parametrize("given", FILES, ids=IDS)
def test_a_file_that_says_what_it_holds_is_read_without_a_map(tmp_path, given) -> None:
    path = tmp_path / given.name
    given.make(path)
    found = ab.read(path)
    assert found.rate == pytest.approx(RATE, rel=1e-9)
    np.testing.assert_allclose(found.time, TIME, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.channel("AF").values, LOAD, rtol=given.error, atol=given.error)
    # packed to 1e-9 deg, or to twelve digits, where the format does so
    np.testing.assert_allclose(found.channel("pitch").values, np.radians(PITCH), rtol=1e-15, atol=1e-9 * given.error)
    if given.dated:
        assert found.epoch is not None
        assert abs(found.epoch - BEGAN) < np.timedelta64(1, "s" if ".uff" in given.name else "ns")


@pytest.mark.parametrize("given", FILES, ids=IDS)
def test_a_map_names_a_channel_in_any_of_them(tmp_path, given) -> None:
    path, toml = tmp_path / given.name, tmp_path / "map.toml"
    given.make(path)
    toml.write_text(f'[channels.NF]\ncolumn = "{given.column}"\nunit = "kN"\nscale = 0.5\nsign = -1\n')
    found = read(path, channel_map=load_channel_map(toml))
    assert list(found.channels) == ["NF"]
    np.testing.assert_allclose(found.channel("NF").values, -500 * LOAD, rtol=1e-12, atol=500 * given.error)
    np.testing.assert_allclose(found.time, TIME, rtol=0, atol=1e-9)


@pytest.mark.parametrize("given", FILES, ids=IDS)
def test_a_map_that_is_proposed_reads_the_file(tmp_path, given) -> None:
    path, toml = tmp_path / given.name, tmp_path / "map.toml"
    given.make(path)
    text = template(path)
    toml.write_text(text, encoding="utf-8")
    assert set(tomllib.loads(text)["channels"]) == {"AF", "pitch"}
    found = read(path, channel_map=load_channel_map(toml))
    np.testing.assert_allclose(found.channel("AF").values, LOAD, rtol=0, atol=given.error + 1e-12)


def test_only_what_is_wanted_is_read(tmp_path, monkeypatch) -> None:
    asked = []

    def noting(original):
        def noted(path, one, *others):
            asked.append(one.name)
            return original(path, one, *others)

        return noted

    for name in ("read_values", "_read_into"):  # alone, or with others a piece at a time
        monkeypatch.setattr(series_values, name, noting(getattr(series_values, name)))
    for given in FILES:
        path, toml = tmp_path / given.name, tmp_path / "map.toml"
        given.make(path)
        toml.write_text(f'[channels.NF]\ncolumn = "{given.column}"\nunit = "N"\n')
        read(path, channel_map=load_channel_map(toml))
        assert "pitch" not in asked
        assert "AF" in asked
        asked.clear()


def test_wav_is_shares_of_full_scale(tmp_path) -> None:
    path, toml = tmp_path / "a.wav", tmp_path / "map.toml"
    wav(path)
    with pytest.raises(
        ReadError, match=r"channels: none of them .*'channel 1', 'channel 2'.* a channel map is needed"
    ):
        read(path)
    toml.write_text('[channels.AF]\ncolumn = "channel 1"\nunit = "N"\nscale = 200\n')
    found = read(path, channel_map=load_channel_map(toml))
    assert found.rate == RATE
    np.testing.assert_allclose(found.channel("AF").values, LOAD, rtol=0, atol=200 * 0.5001 / 32768)


def test_a_proposed_map_says_how_many_channels_wait_for_a_person(tmp_path, capsys) -> None:
    wav(tmp_path / "a.wav")
    count = len(column_names(tmp_path / "a.wav"))  # none of which has a name that tells it
    assert main(["map", str(tmp_path / "a.wav"), "-o", str(tmp_path / "map.toml")]) == 0
    assert f"map of {count} columns, {count} wait for a person" in capsys.readouterr().out


def test_a_message_lists_the_first_of_many_columns(tmp_path) -> None:
    path, toml = tmp_path / "a.csv", tmp_path / "map.toml"
    names = [f"column {number} {'x' * 100}" for number in range(1, 31)]
    path.write_text(f"{','.join(names)}\n" + "\n".join(",".join("1" * 30) for _ in range(9)) + "\n")
    toml.write_text('[file]\nrate = 10\n[channels.AF]\ncolumn = "AF"\nunit = "N"\n')
    with pytest.raises(ReadError, match="and 10 more") as problem:
        read(path, channel_map=load_channel_map(toml))
    assert len(str(problem.value).replace(str(path), "")) < 1500


def test_matrices_are_columns_by_number(tmp_path) -> None:
    from scipy.io import savemat

    table = np.column_stack([LOAD, PITCH])
    savemat(tmp_path / "a.mat", {"data": table, "dt": 1 / RATE})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("run/data", data=table, chunks=(64, 2)).attrs["fs"] = RATE
    for name, column in (("a.mat", "data(:,2)"), ("a.h5", "run/data[2]")):
        toml = tmp_path / "map.toml"
        toml.write_text(
            f'[channels.pitch]\ncolumn = "{column}"\nunit = "deg"\n[channels.AF]\ncolumn = 1\nunit = "N"\n'
        )
        found = read(tmp_path / name, channel_map=load_channel_map(toml))
        np.testing.assert_array_equal(found.channel("pitch").values, np.radians(PITCH))
        np.testing.assert_array_equal(found.channel("AF").values, LOAD)
        assert found.rate == pytest.approx(RATE, rel=1e-12)


def test_groups_of_other_rates_stand_on_the_fastest_clock(tmp_path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(LOAD, TIME, name="AF", unit="N")])
        file.append([Signal(PITCH[::4], TIME[::4], name="pitch", unit="deg")])
        file.save(tmp_path / "a.mf4")
    found = read(tmp_path / "a.mf4")
    np.testing.assert_array_equal(found.channel("AF").values, LOAD)
    np.testing.assert_allclose(found.channel("pitch").values[:-3:4], np.radians(PITCH[::4]), rtol=1e-12)


def test_uneven_times_are_a_clock_or_are_refused(tmp_path, rng) -> None:
    from asammdf import MDF, Signal

    slow = TIME[::4] + rng.uniform(-1.5e-3, 1.5e-3, 100)
    with MDF(version="4.10") as file:
        file.append([Signal(LOAD, TIME, name="AF", unit="N")])
        file.append([Signal(PITCH[::4], slow, name="pitch", unit="deg")])
        file.save(tmp_path / "a.mf4")
    with pytest.raises(ReadError, match=r"channel '2/time': is no steady clock, and other channels have another"):
        read(tmp_path / "a.mf4")


def known() -> Recording:
    """A recording with gaps, a date and all that can be known of a channel."""
    kept = np.delete(np.arange(400), [50, 51, 200])
    sensor = {"noise": 0.25, "relative_uncertainty": 0.01, "zero_uncertainty": 0.5, "delay": 2e-4}
    load = Channel("AF", LOAD[kept] * 1e3, "N", file_unit="kN", filter=AntiAlias("bessel", 4, 200.0), **sensor)
    load = replace(load, values=np.where(np.arange(kept.size) == 7, np.nan, load.values))
    cross = (CrossAxis("ground_acceleration_z", 0.02, 0.01),)
    ground = Channel(
        *("ground_acceleration", 0.1 * PITCH[kept], "m/s^2"),
        **{"coupling": "ac", "corner": 0.5, "cross_axis": cross, "place": (0.5, 0.0, 0.1), "place_uncertainty": 1e-3},
    )
    pitch = Channel("pitch", np.radians(PITCH[kept]), "rad", file_unit="deg")
    other = Channel("Brücke 7/b", PITCH[kept], "1", file_unit="1")
    channels = {one.name: one for one in (load, ground, pitch, other)}
    with pytest.warns(DataQualityWarning, match="3 sample"):
        made = Recording.from_columns(TIME[kept] + 0.25, channels, name="known", time_unit="ms")
    return replace(made, epoch=BEGAN + np.timedelta64(7, "ns"))


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
@pytest.mark.parametrize("ending", ["h5", "parquet", "mat", "nc", "uff", "csv"])
def test_what_is_written_reads_back(tmp_path, ending) -> None:
    given, path = known(), tmp_path / f"a.{ending}"
    write_recording(path, given)
    found = read(path)
    assert set(found.channels) == {name.replace("ü", "?") if ending == "uff" else name for name in given.channels}
    np.testing.assert_array_equal(found.rows, given.rows)
    np.testing.assert_allclose(found.stamps, given.stamps, rtol=1e-15, atol=0)  # times in ms have fifteen digits
    assert (found.rate, found.start) == pytest.approx((given.rate, given.start), rel=1e-14)
    for name in ("AF", "pitch", "ground_acceleration"):
        one, other = given.channel(name), found.channel(name)
        np.testing.assert_allclose(other.values, one.values, rtol=3e-16)
        assert (other.unit, other.file_unit or other.unit) == (one.unit, one.file_unit or one.unit)
        if ending not in ("csv", "uff"):
            assert other.known() == one.known()
    assert found.epoch == (None if ending == "csv" else given.epoch)


def test_an_even_clock_is_written_as_one_where_six_digits_tell_it(tmp_path) -> None:
    for rate, size in ((25_000.0, 1), (3_000.0, 2)):
        path = tmp_path / "a.uff"
        write_recording(path, Recording.from_columns(np.arange(400) / rate, {"AF": Channel("AF", LOAD, "N")}))
        assert path.stat().st_size < 1200 + size * 400 * 8
        np.testing.assert_allclose(read(path).time, np.arange(400) / rate, rtol=1e-15, atol=1e-19)
        path.unlink()


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_programs_of_others_read_what_is_written(tmp_path) -> None:
    """scipy, xarray, pyarrow, pandas and pyuff find names, units and numbers where they belong."""
    import pandas as pd
    import pyarrow.parquet as pq
    import pyuff
    import xarray as xr
    from scipy.io import loadmat

    given = known()
    load = np.where(np.isfinite(given.channel("AF").values), given.channel("AF").values, np.nan)[given.rows] / 1e3
    for ending in ("mat", "nc", "parquet", "uff"):
        write_recording(tmp_path / f"a.{ending}", given)
    mat = loadmat(tmp_path / "a.mat", squeeze_me=True)
    np.testing.assert_allclose(mat["AF"], load, rtol=3e-16)
    np.testing.assert_allclose(mat["time"], 1e3 * given.stamps, rtol=1e-15)
    assert (str(mat["units"]["AF"]), str(mat["units"]["time"]), mat["epoch"]) == ("kN", "ms", str(given.epoch))
    assert str(mat["names"]["Br_cke_7_b"]) == "Brücke 7/b"
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        np.testing.assert_allclose(data["AF"], load, rtol=3e-16)
        assert data["pitch"].attrs["units"] == "degree"
        assert data["ground_acceleration"].attrs["units"] == "m s-2"
        since = (data["time"].to_numpy() - given.epoch) / np.timedelta64(1, "ns")
        np.testing.assert_allclose(since, 1e9 * given.stamps, rtol=0, atol=64)  # xarray rounds through float64
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.schema.field("AF [kN]").metadata[b"unit"] == b"kN"
    np.testing.assert_allclose(pd.read_parquet(tmp_path / "a.parquet")["AF [kN]"], load, rtol=3e-16)
    sets = pyuff.UFF(str(tmp_path / "a.uff")).read_sets()
    assert [one["id1"] for one in sets[:3]] == ["AF", "ground_acceleration", "pitch"]
    assert sets[0]["ordinate_axis_units_lab"] == "kN"
    np.testing.assert_allclose(sets[0]["data"], load, rtol=3e-16)
    np.testing.assert_allclose(sets[0]["x"], given.stamps, rtol=1e-15)


def test_commands_take_and_write_them(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for given in FILES:
        given.make(tmp_path / given.name)
        assert main(["info", given.name]) == 0, capsys.readouterr()
        assert "400 samples" in capsys.readouterr().out
    assert main(["convert", "plain.mf4", "-o", "a.parquet"]) == 0
    assert main(["convert", "a.parquet", "-o", "b.nc"]) == 0
    assert main(["convert", "b.nc", "-o", "c.mat"]) == 0
    assert main(["convert", "c.mat", "-o", "d.uff"]) == 0
    assert main(["convert", "d.uff", "-o", "e.h5"]) == 0
    assert main(["convert", "e.h5", "-o", "f.csv"]) == 0
    assert "no place for the date and time" in capsys.readouterr().err
    np.testing.assert_array_equal(read("f.csv").channel("AF").values, LOAD)
    assert read("e.h5").epoch == BEGAN


def test_what_is_not_installed_is_named_with_what_installs_it(tmp_path, monkeypatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(format_library, "find_spec", lambda name: None if name in lacking else found(name))
    extras = {"a.mf4": ("asammdf", "mdf"), "a.parquet": ("pyarrow", "parquet"), "three.zarr": ("zarr", "zarr")}
    made = {given.name: given.make for given in FILES}
    for name, (module, extra) in extras.items():
        lacking = ()
        path = tmp_path / name
        made[{"a.mf4": "plain.mf4", "a.parquet": "columns.parquet"}.get(name, name)](path)
        lacking = (module,)
        with pytest.raises(
            ReadError, match=rf"needs a library that is not installed: pip install 'aerobalance\[{extra}\]'"
        ):
            read(path)
    lacking = ("h5netcdf",)
    with pytest.raises(ValueError, match=r"cannot write .*a.nc: NetCDF needs .* pip install 'aerobalance\[netcdf\]'"):
        write_recording(tmp_path / "a.nc", Recording.from_columns(TIME, {"AF": Channel("AF", LOAD, "N")}))


def test_reading_text_loads_no_library_of_another_format(tmp_path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time [s],AF [N]\n0,1\n0.1,2\n0.2,3\n")
    code = f"import sys; from aerobalance.io import read; read({str(path)!r}); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert "pandas" in loaded  # so that libraries are seen
    assert not {"h5py", "zarr", "asammdf", "scipy.io", "h5netcdf", "xarray"} & set(loaded)


def test_what_the_library_prints_of_a_damaged_file_is_not_shown(tmp_path, capfd) -> None:
    """Finished, but for its flags: asammdf prints a traceback of its own fault, and its object another at its end."""
    path = tmp_path / "packed.mf4"
    next(given for given in FILES if given.name == path.name).make(path)
    raw = bytearray(path.read_bytes())
    raw[60] = 0x3F
    path.write_bytes(raw)
    with pytest.raises(ReadError, match="is a damaged file of MDF"):
        ab.read(path)
    gc.collect()
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")
    assert path.read_bytes() == raw


UNREADABLE = {
    "spectra.uff": (r"data set 1 .*|channel", "frequency response"),
    "no58.uff": ("", "holds no data set 58 .*its data sets are 151"),
    "old.mdf": ("byte 28", "is MDF of version 3.30; versions 4.00 and later are read"),
    "unfinished.mf4": ("its first bytes", "never finished; finish it with the program that recorded it"),
    "cdf5.nc": ("byte 4", "64-bit data format"),
    "cut.parquet": ("its last 8 bytes", "was not finished, or is cut off"),
    "compressed.wav": ("byte 12, the format", r"is compressed \(code 85\)"),
    "cut.wav": ("byte 36", "is cut off: 600 bytes of samples are stated, and 300 are there"),
    "narrow.wav": ("byte 12, the format", "frames of 2 bytes for 1 channels of 8 bits"),
    "cells.mat": ("channel", "it is a cell array"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_what_cannot_be_read_is_told_exactly(tmp_path, name) -> None:
    path = tmp_path / name
    if name.endswith(".uff"):
        number, function = (151, 0) if name == "no58.uff" else (58, 4)
        head = (
            f"    -1\n{number:6d}\n" + "NONE\n" * 5 + f"{function:5d}{0:10d}{0:5d}{0:10d} {'NONE':>10}{1:10d}{1:4d}\n"
        )
        form = f"{5:10d}{2:10d}{1:10d}{0.0:13.5e}{0.1:13.5e}{0.0:13.5e}\n"
        path.write_text(head + form + f"{18:10d}\n" + "         0\n" * 3 + " 1.0 1.0 1.0 1.0\n    -1\n")
    elif name == "old.mdf":
        path.write_bytes(b"MDF     3.30    test    \0\0\0\0\x4a\x01" + bytes(200))
    elif name == "unfinished.mf4":
        path.write_bytes(b"UnFinMF 4.10    test    \0\0\0\0\x9a\x01" + bytes(200))
    elif name == "cdf5.nc":
        path.write_bytes(b"CDF\x05" + bytes(100))
    elif name == "cut.parquet":
        next(given for given in FILES if given.name == "columns.parquet").make(path)
        path.write_bytes(path.read_bytes()[:-20])
    elif name in {"cut.wav", "narrow.wav"}:  # samples of three bytes, and of one in two
        width, bits = (3, 24) if name == "cut.wav" else (2, 8)
        form = np.array([1, 1], "<u2").tobytes() + np.array([10, 10 * width], "<u4").tobytes()
        form += np.array([width, bits], "<u2").tobytes()
        body = b"WAVEfmt " + np.array([16], "<u4").tobytes() + form + b"data" + np.array([600], "<u4").tobytes()
        path.write_bytes(b"RIFF" + np.array([len(body) + 600], "<u4").tobytes() + body + bytes(300))
    elif name == "compressed.wav":
        body = b"WAVEfmt " + np.array([16], "<u4").tobytes() + np.array([85, 1], "<u2").tobytes() + bytes(12)
        path.write_bytes(b"RIFF" + np.array([len(body)], "<u4").tobytes() + body)
    else:
        from scipy.io import savemat

        savemat(path, {"AF": np.array([1.0, "a"], dtype=object)})
    where, what = UNREADABLE[name]
    toml = tmp_path / "map.toml"
    toml.write_text("[file]\nrate = 10\n[channels.AF]\ncolumn = 1\nunit = 'N'\n")
    with pytest.raises(ReadError, match=what) as problem:
        read(path, channel_map=load_channel_map(toml))
    assert where.split("|")[-1] in problem.value.where
    assert str(path) in str(problem.value)


def test_formats_have_names_and_endings_of_their_own() -> None:
    names = [form.NAME for form in FORMATS]
    endings = [suffix for form in FORMATS for suffix in form.SUFFIXES]
    assert len(set(names)) == len(names)
    assert len(set(endings)) == len(endings)
    assert {".csv", ".h5", ".parquet", ".uff", ".mat", ".nc"} <= set(endings)


LONG = 70_000
"""Samples of a recording that is read part by part."""


@pytest.fixture(scope="module")
def long_files(tmp_path_factory):
    """One long recording in every format that is written, and its map."""
    folder = tmp_path_factory.mktemp("long")
    time = np.arange(LONG) / 1000
    temperature = Channel("temperature", 20 + 0.001 * time, "degC")
    values = {"AF": Channel("AF", np.sin(time), "N", file_unit="kN"), "temperature": temperature}
    recording = Recording.from_columns(time, values)
    for ending in ("nc", "parquet", "uff", "mat", "h5"):
        write_recording(folder / f"a.{ending}", recording)
    (folder / "map.toml").write_text('[channels.NF]\ncolumn = "AF"\nunit = "kN"\nsign = -1\n')
    return folder, recording


@pytest.mark.parametrize("ending", ["nc", "parquet", "uff", "mat", "h5"])
def test_a_long_file_is_read_in_parts(long_files, ending, monkeypatch) -> None:
    folder, recording = long_files
    with open_record(folder / f"a.{ending}") as record:
        assert not isinstance(record, Recording)
        part = record.part(30_000, 31_000)
        whole = recording.part(30_000, 31_000)
        assert (record.samples, record.rate, record.start) == pytest.approx((LONG, 1000.0, 0.0), abs=1e-9)
        np.testing.assert_allclose(part.channel("AF").values, whole.channel("AF").values, rtol=3e-16)
        np.testing.assert_allclose(part.stamps, whole.stamps, rtol=1e-14)
        assert part.start == pytest.approx(30.0, abs=1e-9)
        assert part.extent.means == pytest.approx(whole.extent.means)
        assert (part.extent.begin, part.extent.end) == pytest.approx((whole.extent.begin, whole.extent.end))


def test_a_map_is_used_in_parts(long_files) -> None:
    folder, recording = long_files
    chosen = load_channel_map(folder / "map.toml")
    with open_record(folder / "a.nc", channel_map=chosen) as record:
        assert not isinstance(record, Recording)
        part = record.part(10, 20)
    np.testing.assert_allclose(part.channel("NF").values, -recording.channel("AF").values[10:20], rtol=3e-16)


def test_numbers_of_matlab_5_are_read_in_parts_where_they_are_not_packed(tmp_path) -> None:
    from scipy.io import savemat

    counts = np.arange(LONG) % 1000 - 500
    toml = tmp_path / "map.toml"
    table = np.stack([counts, counts / 4])
    for packed in (False, True):
        path = tmp_path / f"{packed}.mat"
        given = {"AF": counts.astype(np.int16), "NF": (counts / 8).astype(np.float32)[:, None], "dt": 1 / RATE}
        savemat(path, given | {"up": np.asfortranarray(table.T), "along": table}, do_compression=packed)
        for column, expected in (
            *(("AF", counts), ("NF", counts / 8), ("up(:,2)", counts / 4)),
            *(("along(1,:)", counts), ("along(2,:)", counts / 4)),
        ):
            toml.write_text(f'[channels.AF]\ncolumn = "{column}"\nunit = "N"\n')
            chosen = load_channel_map(toml)
            with open_record(path, channel_map=chosen) as record:
                assert isinstance(record, Recording) == packed
                for begin, end in ((0, LONG), (30_000, 31_000), (LONG - 1, LONG)):
                    found = record.part(begin, end).channel("AF").values
                    np.testing.assert_array_equal(found, expected[begin:end])
            np.testing.assert_array_equal(read(path, channel_map=chosen).channel("AF").values, expected)


def test_channels_of_one_name_are_told_apart_by_number(tmp_path, rng) -> None:
    asammdf = pytest.importorskip("asammdf")
    path, toml = tmp_path / "a.mf4", tmp_path / "map.toml"
    time, (first, second) = np.arange(500) / 1000.0, rng.standard_normal((2, 500))
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(one, time, name="AF", unit="N") for one in (first, second)])
        file.save(path, overwrite=True)
    with pytest.raises(ReadError, match=r"column 3 .*there is a column AF already \(column 2"):
        read(path)
    toml.write_text('[channels.AF]\ncolumn = 2\nunit = "N"\n[channels.NF]\ncolumn = 3\nunit = "N"\n')
    found = read(path, channel_map=load_channel_map(toml))
    np.testing.assert_array_equal(found.channel("AF").values, first)
    np.testing.assert_array_equal(found.channel("NF").values, second)


def test_matlab_5_of_another_byte_order(tmp_path) -> None:
    """After the format's description: two double arrays, written here as a machine of the other byte order does."""

    def variable(name: str, values: np.ndarray) -> bytes:
        head = struct.pack(">4I2I2i", 6, 8, 6, 0, 5, 8, values.size, 1)
        head += (
            struct.pack(">2H4s", 2, 1, b"AF") if name == "AF" else struct.pack(">2I8s", 1, len(name), name.encode())
        )
        body = head + struct.pack(">2I", 9, 8 * values.size) + values.astype(">f8").tobytes()
        return struct.pack(">2I", 14, len(body)) + body

    path, toml = tmp_path / "a.mat", tmp_path / "map.toml"
    path.write_bytes(
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + variable("AF", LOAD) + variable("pitch", PITCH)
    )
    toml.write_text('[file]\nrate = 1000\n[channels.AF]\ncolumn = "AF"\nunit = "N"\n')
    np.testing.assert_array_equal(read(path, channel_map=load_channel_map(toml)).channel("AF").values, LOAD)


@pytest.mark.parametrize("expected", [0, 1, 250, 400, 5000])
def test_a_matlab_file_of_more_or_fewer_rows_than_expected(tmp_path, expected) -> None:
    from scipy.io import loadmat

    path = tmp_path / "a.mat"
    with mat_write.appending(path, ["time [s]", "AF [N]", "pitch [deg]"], rows=expected) as append:
        for begin in range(0, TIME.size, 70):
            part = slice(begin, begin + 70)
            append({"time [s]": TIME[part], "AF [N]": LOAD[part], "pitch [deg]": PITCH[part]})
    found = loadmat(path, squeeze_me=True)
    for name, values in (("time", TIME), ("AF", LOAD), ("pitch", PITCH)):
        np.testing.assert_array_equal(found[name], values)
    assert str(found["units"]["pitch"]) == "deg"


def test_a_variable_beyond_what_matlab_5_can_hold_is_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(mat_write, "_LARGEST", 8 * 1000)
    path = tmp_path / "a.mat"
    with (
        pytest.raises(ValueError, match=r"a variable of MATLAB 5 has at most 2 GB; write .h5 or .parquet"),
        mat_write.appending(path, ["time [s]", "AF [N]"], rows=5000) as append,
    ):
        for _ in range(3):
            append({"time [s]": TIME, "AF [N]": LOAD})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ["nc", "parquet", "mat", "h5"])
def test_a_long_file_is_converted_in_parts(long_files, ending, tmp_path, monkeypatch, capsys) -> None:
    folder, _ = long_files
    whole = read(folder / f"a.{ending}")
    monkeypatch.setattr("aerobalance.io.WRITTEN_AT_ONCE", 30_000)
    asked = []
    part = SeriesRecord.part if ending != "h5" else Hdf5Record.part
    monkeypatch.setattr(
        SeriesRecord if ending != "h5" else Hdf5Record,
        "part",
        lambda record, begin, end: asked.append((begin, end)) or part(record, begin, end),
    )
    monkeypatch.setattr("aerobalance.app.commands.recordings.raw_recording", None)  # which reads the whole
    for out in ("b.h5", "b.csv"):
        assert main(["convert", str(folder / f"a.{ending}"), "-o", str(tmp_path / out), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["samples"] == LONG
        assert asked == [(0, 30_000), (30_000, 60_000), (60_000, LONG)]
        asked.clear()
        found = read(tmp_path / out)
        for channel in whole:
            np.testing.assert_array_equal(found.channel(channel.name).values, channel.values)
            assert found.channel(channel.name).file_unit == channel.file_unit
        np.testing.assert_array_equal(found.stamps, whole.stamps)


def test_readings_that_look_like_references_to_texts_are_readings(tmp_path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.attrs["fs"] = RATE
        load = file.create_dataset("AF", data=LOAD)
        load.attrs["unit"] = "N"
    at = path.read_bytes().index(b"GCOL")
    values = np.frombuffer(np.array([7, 0, 9999, at, 0, 1, 0, 5], "<u4").tobytes(), "<f8")
    with h5py.File(path, "r+") as file:
        file["AF"][10:14] = values
    np.testing.assert_array_equal(read(path).channel("AF").values[10:14], values)


@pytest.mark.parametrize("libver", ["earliest", "latest"])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_texts_longer_than_their_file_are_refused_before_the_library_takes_the_memory(tmp_path, libver, shape) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver=libver) as file:
        file.create_dataset("AF", data=LOAD).attrs["fs"] = RATE
        file["AF"].attrs["unit"] = np.full(shape, "Newton", dtype=h5py.string_dtype()) if shape else "Newton"
    content = bytearray(path.read_bytes())
    heap = content.index(b"GCOL").to_bytes(8, "little")
    place = content.index(b"\x06\0\0\0" + heap)
    content[place : place + 6] = (10**9).to_bytes(4, "little") + b"\xff\xff"  # no heap is there
    path.write_bytes(content)
    with pytest.raises(ReadError, match=rf"byte {place}: claims 1000000000 letters in a file of {len(content)} bytes"):
        read(path)


def test_a_text_longer_than_its_file_is_seen_whatever_else_is_in_the_shape_of_its_attribute(tmp_path) -> None:
    """A damaged file of 29 kB took 4 GB: five bytes of a shape have no meaning, and were thought to be zero."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("AF", data=LOAD).attrs["fs"] = RATE
        file["AF"].attrs["unit"] = "Newton"
    content = bytearray(path.read_bytes())
    place = content.index(b"\x06\0\0\0" + content.index(b"GCOL").to_bytes(8, "little"))
    content[place - 2 : place + 6] = b"\1\2" + (10**9).to_bytes(4, "little") + b"\xff\xff"
    path.write_bytes(content)
    with pytest.raises(ReadError, match=rf"byte {place}: claims 1000000000 letters in a file of {len(content)} bytes"):
        read(path)


def test_names_whose_free_places_are_in_a_circle_are_refused_before_the_library_follows_them(tmp_path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("AF", data=LOAD).attrs["fs"] = RATE
    content = bytearray(path.read_bytes())
    heap = content.index(b"HEAP")
    free, address = (int.from_bytes(content[heap + at : heap + at + 8], "little") for at in (16, 24))
    place = address + free
    assert content[place : place + 8] == (1).to_bytes(8, "little")  # the last one
    content[place : place + 8] = free.to_bytes(8, "little")
    path.write_bytes(content)
    with pytest.raises(ReadError, match=f"byte {place}: the free places of a group's names are in a circle"):
        read(path)


@pytest.mark.parametrize("even", [True, False])
def test_times_of_a_universal_file_have_their_unit(even, tmp_path) -> None:
    count, step = 50, 0.5
    head = [
        "    -1",
        "    58",
        "AF",
        *["NONE"] * 4,
        f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':>10}{1:10d}{0:4d} {'NONE':>10}",
    ]
    head += [f"{4:10d}{count:10d}{int(even):10d}{0.0:13.5e}{step if even else 0.0:13.5e}{0.0:13.5e}"]
    head += [f"{17:10d}{0:5d}{0:5d}{0:5d} {'Time':<20} {'ms':<20}", f"{0:10d}{0:5d}{0:5d}{0:5d} {'AF':<20} {'N':<20}"]
    head += [f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}"] * 2
    values = [f"{np.sin(k):20.12E}" for k in range(count)]
    body = values if even else [f"{k * step:13.5E}{value}" for k, value in enumerate(values)]
    path = tmp_path / "ms.uff"
    path.write_text("\n".join([*head, *body, "    -1", ""]))
    assert read(path).rate == pytest.approx(2000.0)
