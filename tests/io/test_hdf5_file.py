"""Recordings in HDF5: read back as they were recorded, with what is lost or damaged marked, and nothing else lost."""

import os
import signal
import struct
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
from aerobalance.io.hdf5_layout import CHANNEL_1, StoredChannel, checksums_of_sums, text_bytes
from aerobalance.io.long_record import open_record
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning, ReadError
from aerobalance.recording.recording import Recording
from helpers.hdf5_files import CHANNELS, in_blocks, make, quietly, readings, with_crc32_of_samples


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


def converted(path, *, layout=5):
    """A recording of three channels with a time column, as it is written now or was written before."""
    time = np.arange(20_000) / 1000.0
    values = readings(0, time.size)
    channels = {
        name: Channel(name, column, unit)
        for name, unit, column in zip(("AF", "pitch", "NF"), ("N", "rad", "N"), values.T, strict=True)
    }
    write_recording(path, Recording.from_columns(time, channels))
    if layout == 4:
        with_crc32_of_samples(path)
    if layout == 3:
        in_blocks(path)
    return values


@pytest.mark.parametrize("layout", [5, 4, 3])
def test_a_converted_recording_of_any_layout_is_read(tmp_path, layout) -> None:
    path, toml = tmp_path / "a.h5", tmp_path / "map.toml"
    values = converted(path, layout=layout)
    found = read(path)
    for place, name in enumerate(("AF", "pitch", "NF")):
        np.testing.assert_allclose(found.channel(name).values, values[:, place], rtol=3e-16)  # pitch was in degrees
    toml.write_text('[file]\ntime = "time"\ntime_unit = "s"\n[channels.SF]\ncolumn = "NF"\nunit = "N"\n')
    only = read(path, channel_map=load_channel_map(toml))
    np.testing.assert_array_equal(only.channel("SF").values, values[:, 2])
    with open_record(path) as record:
        part = record.part(8000, 17_000)  # of three blocks
    np.testing.assert_array_equal(part.channel("NF").values, values[8000:17_000, 2])
    assert np.concatenate([block for _, block in read_blocks(path)]).shape == (20_000, 3)


def test_one_channel_of_a_converted_recording_is_read_without_the_others(tmp_path) -> None:
    path, toml = tmp_path / "a.h5", tmp_path / "map.toml"
    values = converted(path)
    with h5py.File(path, "r") as file:
        samples = file["samples"]
        assert samples.chunks == (8192, 1)
        places = {column: samples.id.get_chunk_info_by_coord((8192, column)).byte_offset for column in range(3)}
    whole = path.read_bytes()
    for damaged, column in ((0, "NF"), (2, "AF")):
        data = bytearray(whole)
        data[places[damaged] + 1000] ^= 1
        path.write_bytes(data)
        toml.write_text(
            f'[file]\ntime = "time"\ntime_unit = "s"\n[channels.{column}]\ncolumn = "{column}"\nunit = "N"\n'
        )
        found = read(path, channel_map=load_channel_map(toml))  # a block that is left out would be a warning
        np.testing.assert_array_equal(found.channel(column).values, values[:, 0 if column == "AF" else 2])
        with pytest.warns(DataQualityWarning) as said:
            rest = read(path)
        assert any("block 2 of 3 (8192 samples from tick 8192)" in str(item.message) for item in said)
        assert np.array_equal(np.flatnonzero(rest.channel(column).missing), np.arange(8192, 16_384))


@pytest.mark.parametrize("layout", [5, 4])
def test_every_single_bit_of_a_converted_recording_is_watched(tmp_path, seed, layout) -> None:
    path = tmp_path / "a.h5"
    converted(path, layout=layout)
    with h5py.File(path, "r") as file:
        places = [file["samples"].id.get_chunk_info_by_coord((16_384, column)).byte_offset for column in range(3)]
        checksums = file["checksums"].id.get_chunk_info(0).byte_offset + 2 * 3 * 4
    rng, data = np.random.default_rng(seed), path.read_bytes()
    rows = 20_000 - 16_384
    bits = [8 * place + int(bit) for place in places for bit in rng.integers(0, rows * 64, 10)]
    for bit in (*bits, *(8 * checksums + int(bit) for bit in rng.integers(0, 3 * 32, 10))):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        assert [samples is None for _, samples in read_blocks(path)] == [False, False, True]


@pytest.mark.parametrize("size", [1, 255, 256, 257, 600, 8192])
def test_checksums_of_sums_are_what_the_layout_says(size, rng) -> None:
    samples = rng.standard_normal((3, size))
    stated = []
    for column in samples:
        words = [int(word) for word in column.view("<u8")]
        lines = [words[begin : begin + 256] for begin in range(0, size, 256)]
        down = [sum(line[k] for line in lines if k < len(line)) for k in range(256)]
        sums = [one % 2**64 for one in [*down, *map(sum, lines)]]
        stated.append(zlib.crc32(struct.pack(f"<{len(sums)}Q", *sums)))
    assert checksums_of_sums(samples).tolist() == stated
    wide = np.empty((3, size + 7))  # a part of a longer table has its columns in one piece each
    wide[:, :size] = samples
    assert checksums_of_sums(wide[:, :size]).tolist() == stated


@pytest.mark.parametrize(
    "damage",
    [
        lambda table: table.__setitem__((3, 7), -table[3, 7]),
        lambda table: table.__setitem__((3, slice(7, 9)), -table[3, 7:9]),  # signs: the sum is the same modulo 2^64
        lambda table: table.__setitem__((slice(3, 5), 7), -table[3:5, 7]),
        lambda table: table.__setitem__(([3, 3, 9], [7, 8, 8]), -table[[3, 3, 9], [7, 8, 8]]),
        lambda table: table.__setitem__((slice(0, 2), slice(None)), table[[1, 0]]),  # pieces change places
        lambda table: table.__setitem__((slice(2, 4), slice(None)), 0.0),  # a page of zeros
        lambda table: table.__setitem__((slice(None), [4, 5]), table[:, [5, 4]]),
    ],
)
def test_sums_tell_of_what_a_single_sum_does_not(damage, rng) -> None:
    whole = rng.standard_normal((32, 256))
    damaged = whole.copy()
    damage(damaged)
    assert checksums_of_sums(whole.reshape(1, -1)) != checksums_of_sums(damaged.reshape(1, -1))


@pytest.mark.parametrize("layout", [5, 4])
def test_pieces_are_read_together_only_where_they_are_one_behind_the_other(tmp_path, monkeypatch, layout) -> None:
    path = tmp_path / "a.h5"
    values = converted(path, layout=layout)
    with h5py.File(path, "r+") as file:  # pieces of the columns that lie elsewhere, and out of order
        table = file["samples"][...]
        del file["samples"]
        file.create_dataset("samples", table.shape, "<f8", chunks=(8192, 1), maxshape=(None, 3), fillvalue=np.nan)
        for column in (2, 0, 1):
            file["samples"][:, column] = table[:, column]
    found = read(path)
    for place, name in enumerate(("AF", "pitch", "NF")):
        np.testing.assert_allclose(found.channel(name).values, values[:, place], rtol=3e-16)
    monkeypatch.delattr(os, "preadv")  # as on systems that have none
    without = read(path)
    for name in found.channels:
        np.testing.assert_array_equal(without.channel(name).values, found.channel(name).values)


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
