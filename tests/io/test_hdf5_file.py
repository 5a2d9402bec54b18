"""Recordings in HDF5: read back as they were recorded, with what is lost or damaged marked, and nothing else lost."""

import signal
import subprocess
import sys
import warnings
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from aerobalance.app.commands import recordings
from aerobalance.io import column_names, load_channel_map, read, template, write_recording
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import headings, read_blocks
from aerobalance.io.hdf5_layout import CHANNEL_1, StoredChannel, text_bytes
from aerobalance.recording.errors import DataQualityWarning, ReadError
from helpers.hdf5_files import CHANNELS, make, quietly, readings


def test_the_first_layout_is_still_read(tmp_path) -> None:
    make(tmp_path / "a.h5", [(0, 100)])
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        table = file["channels"][...]
        first = np.zeros(table.shape, CHANNEL_1)
        for name in CHANNEL_1.names:
            first[name] = table[name]
        del file["channels"]
        file.create_dataset("channels", data=first)
        file.attrs["schema_version"] = 1
        file.attrs["channels_crc32"] = zlib.crc32(first.tobytes())
    assert read(tmp_path / "a.h5").channel("AF").noise == pytest.approx(10.0)
    assert contents(tmp_path / "a.h5").channels == CHANNELS


def test_an_impossible_filter_is_a_damaged_file(tmp_path) -> None:
    make(tmp_path / "a.h5", [(0, 100)])
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        table = file["channels"][...]
        table["filter"] = b"elliptic"
        file["channels"][...] = table
        file.attrs["channels_crc32"] = zlib.crc32(table.tobytes())
    with pytest.raises(ReadError, match="impossible settings"):
        read(tmp_path / "a.h5")


def test_channels_come_back_in_their_units_with_their_settings(tmp_path) -> None:
    make(tmp_path / "a.h5", [(100, 400)])
    recording = read(tmp_path / "a.h5")
    assert (recording.samples, recording.rate, recording.start) == (300, 1000.0, 0.1)
    load, pitch, ground = recording
    raw = readings(100, 400)
    assert load.values == pytest.approx(-1000 * (0.5 * raw[:, 0] + 3.0), rel=1e-14)
    assert (load.unit, load.file_unit, load.noise, load.delay) == ("N", "kN", pytest.approx(10.0), 2e-4)
    assert pitch.values == pytest.approx(np.deg2rad(raw[:, 1]), rel=1e-14)
    assert (ground.coupling, ground.corner, ground.relative_uncertainty) == ("ac", 0.5, 0.01)
    assert np.array_equal(ground.values, raw[:, 2])


def test_gaps_are_missing_samples_of_exact_length(tmp_path) -> None:
    make(tmp_path / "a.h5", [(0, 130), (171, 300), (1000, 1064)])
    with pytest.warns(DataQualityWarning, match=r"741 sample\(s\) are missing in 2 gap"):
        recording = read(tmp_path / "a.h5")
    assert recording.samples == 1064
    lost = np.r_[130:171, 300:1000]
    for channel in recording:
        assert np.array_equal(np.flatnonzero(channel.missing), lost)
    assert np.array_equal(recording.channel("ground_acceleration").values[171:300], readings(171, 300)[:, 2])
    assert [round(length * 1000) for _, length in recording.gaps] == [41, 700]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        account = recordings.info(tmp_path / "a.h5")
    assert [gap["length"] for gap in account["gaps"]] == [pytest.approx(0.041), pytest.approx(0.7)]


def test_damaged_block_is_named_and_missing(tmp_path) -> None:
    file = tmp_path / "a.h5"
    make(file, [(0, 320)])
    with h5py.File(file, "r") as opened:
        place = opened["samples"].id.get_chunk_info(2).byte_offset
    data = bytearray(file.read_bytes())
    data[place + 1000] ^= 1
    file.write_bytes(data)
    with pytest.warns(DataQualityWarning) as said:
        recording = read(file)
    assert any("block 3 of 5 (64 samples from tick 128)" in str(item.message) for item in said)
    assert np.array_equal(np.flatnonzero(recording.channel("AF").missing), np.arange(128, 192))
    assert [samples is None for _, samples in read_blocks(file)] == [False, False, True, False, False]


def test_every_single_bit_of_the_samples_is_watched(tmp_path, seed) -> None:
    file = tmp_path / "a.h5"
    make(file, [(0, 20)], rows=20)
    with h5py.File(file, "r") as opened:
        place, size = opened["samples"].id.get_chunk_info(0).byte_offset, 20 * 3 * 8
    data = file.read_bytes()
    for bit in np.random.default_rng(seed).integers(0, size * 8, 40):
        damaged = bytearray(data)
        damaged[place + int(bit) // 8] ^= 1 << int(bit) % 8
        file.write_bytes(damaged)
        assert [samples for _, samples in read_blocks(file)] == [None]


KILLED = """
import os, sys, signal
sys.path[:0] = {folders!r}
from pathlib import Path
from helpers.hdf5_files import make
make(Path({file!r}), [(0, 300)], finish=False)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_file_of_a_killed_writer_is_read_to_its_last_block(tmp_path) -> None:
    file = tmp_path / "a.h5"
    code = KILLED.format(folders=[str(Path(__file__).parents[1])], file=str(file))
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == -signal.SIGKILL
    with pytest.warns(DataQualityWarning, match="the record was not ended"):
        recording = read(file)
    assert np.array_equal(recording.channel("ground_acceleration").values, readings(0, 300)[:, 2])


def test_recording_goes_to_csv_and_back_to_the_last_bit(tmp_path) -> None:
    make(tmp_path / "a.h5", [(50, 130), (171, 300)])
    original = quietly(tmp_path / "a.h5")
    write_recording(tmp_path / "b.h5", original)
    write_recording(tmp_path / "b.csv", original)
    for name in ("b.h5", "b.csv"):
        again = quietly(tmp_path / name)
        assert np.array_equal(again.stamps, original.stamps)
        assert np.array_equal(again.rows, original.rows)
        for channel in original:
            # through [kN] and [deg] and back: one rounding each way
            assert again.channel(channel.name).values == pytest.approx(channel.values, rel=4e-16, nan_ok=True)
    # what goes through HDF5 is what goes through text, where numbers are kept exactly
    text, binary = quietly(tmp_path / "b.csv"), quietly(tmp_path / "b.h5")
    assert all(np.array_equal(text.channel(channel.name).values, channel.values, equal_nan=True) for channel in binary)


def test_time_keeps_its_unit(tmp_path) -> None:
    (tmp_path / "a.csv").write_text("time [ms],AF [N]\n" + "".join(f"{i * 0.625},{i}\n" for i in range(50)))
    write_recording(tmp_path / "a.h5", read(tmp_path / "a.csv"))
    recording = read(tmp_path / "a.h5")
    assert recording.time_unit == "ms"
    assert recording.rate == pytest.approx(1600.0)
    assert [heading.label for heading in headings(tmp_path / "a.h5")] == ["time [ms]", "AF [N]"]


def test_channel_map_of_a_recording(tmp_path) -> None:
    file = tmp_path / "a.h5"
    make(file, [(0, 130), (171, 300)], channels=(StoredChannel("lift", "N", input="Dev1/ai3"), *CHANNELS[1:]))
    assert "lift" in template(file)
    assert column_names(file) == ("lift [N]", "pitch [deg]", "ground_acceleration [m/s^2]")
    (tmp_path / "map.toml").write_text('[channels.NF]\ncolumn = "lift"\nsign = -1\n')
    with pytest.warns(DataQualityWarning, match="41 of 300"):
        recording = read(file, channel_map=load_channel_map(tmp_path / "map.toml"))
    assert list(recording.channels) == ["NF"]
    assert recording.rate == 1000.0
    values = recording.channel("NF").values
    assert np.array_equal(values[171:], -readings(171, 300)[:, 0])
    assert np.array_equal(np.flatnonzero(np.isnan(values)), np.arange(130, 171))


def test_recordings_that_cannot_be_used(tmp_path) -> None:
    file = tmp_path / "a.h5"
    with h5py.File(file, "w") as opened:
        opened["x"] = np.arange(5)
    with pytest.raises(ReadError, match=r"none of them [(]'x'[)] has a name that the program knows"):
        read(file)
    file.unlink()
    make(file, [])
    with pytest.raises(ReadError, match=r"recording of 0 sample\(s\) \(done\)"):
        read(file)
    file.unlink()
    make(file, [(0, 64), (10_000, 10_064)])
    with pytest.raises(ReadError, match="gaps of more than 20 times"):
        read(file)
    file.unlink()
    make(file, [(0, 64)])
    with h5py.File(file, "r+") as opened:
        table = opened["blocks"][...]
        table["rows"] = 65
        opened["blocks"][...] = table
    with pytest.raises(ReadError, match="impossible number of rows"):
        read(file)


def test_damage_anywhere_is_a_clear_error_or_leaves_true_samples(tmp_path, rng) -> None:
    file = tmp_path / "a.h5"
    make(file, [(0, 300)])
    data, original = file.read_bytes(), quietly(file)
    for _ in range(60):
        damaged = bytearray(data)
        for at in rng.integers(12, len(data), 3):
            damaged[int(at)] ^= 1 << int(rng.integers(0, 8))
        file.write_bytes(damaged[: int(rng.integers(100, len(data)))] if rng.uniform() < 0.2 else damaged)
        try:
            recording = quietly(file)
        except ReadError:
            continue
        for name in set(recording.channels) & set(original.channels):
            values = recording.channel(name).values
            known = ~np.isnan(values)
            assert np.isin(values[known], original.channel(name).values).all()


def test_live_file_is_read_while_it_grows(tmp_path) -> None:
    writer = make(tmp_path / "a.h5", [(0, 128)], finish=False)
    assert quietly(tmp_path / "a.h5").samples == 128
    writer.append(128, readings(128, 150))
    assert quietly(tmp_path / "a.h5").samples == 150
    assert contents(tmp_path / "a.h5").state == "recording"
    writer.finish("done")
    assert contents(tmp_path / "a.h5").state == "ended"


def test_text_is_cut_between_letters() -> None:
    assert text_bytes("aé", 2) == b"a"
    assert text_bytes("aé", 3).decode() == "aé"
    assert text_bytes("\ud800", 8) == b"?"
