"""Samples of HDF5 files read where they stand in the file, and looked through on the way; files in large pieces."""

import io
import os

import h5py
import numpy as np
import pytest
from scipy.io import wavfile

from aerobalance.io import hdf5_heaps, load_channel_map, read
from aerobalance.io.hdf5_direct import Filling, is_plain
from aerobalance.io.hdf5_guard import GuardedFile
from aerobalance.io.long_record import open_record
from aerobalance.io.measure import LARGEST, rows_within_measure, take_out, within_measure
from aerobalance.recording.errors import DataQualityWarning, ReadError

SAMPLES = 150_000

STORED = {
    "in one piece": {},
    "in pieces": {"chunks": (1000,)},
    "in one long piece": {"chunks": (200_000,), "maxshape": (None,)},
    "a row": {"shape": (1, SAMPLES)},
    "a column in pieces": {"shape": (SAMPLES, 1), "chunks": (4096, 1)},
}
"""Ways to store a series that can be read where it stands."""


def written(path, values, *, user_block=0, **settings):
    with h5py.File(path, "w", userblock_size=user_block) as file:
        data = values.reshape(settings.pop("shape", values.shape))
        file.create_dataset("AF", data=data, **settings).attrs.update({"unit": "N", "fs": 1000.0})
    if user_block:
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file")


@pytest.fixture
def counted(monkeypatch):
    """Bytes that are read past the library."""
    taken = []
    original = os.preadv

    def noted(handle, buffers, place):
        taken.append(original(handle, buffers, place))
        return taken[-1]

    monkeypatch.setattr(os, "preadv", noted)
    return taken


@pytest.mark.parametrize("user_block", [0, 512])
@pytest.mark.parametrize("stored", STORED)
def test_samples_are_those_that_the_library_reads(tmp_path, rng, counted, stored, user_block) -> None:
    path, values = tmp_path / "a.h5", rng.standard_normal(SAMPLES)
    written(path, values, user_block=user_block, **STORED[stored])
    np.testing.assert_array_equal(read(path).channel("AF").values, values)
    # where pieces stand behind bytes of another program depends on the version of the library
    assert sum(counted) == (0 if user_block and "chunks" in STORED[stored] else 8 * SAMPLES)


@pytest.mark.parametrize("stored", STORED)
def test_any_part_is_that_of_the_library(tmp_path, rng, stored) -> None:
    path, values = tmp_path / "a.h5", rng.standard_normal(SAMPLES)
    written(path, values, **STORED[stored])
    with h5py.File(path, "r") as file:
        data = file["AF"]
        assert is_plain(data)
        fill = Filling(data, lambda begin, end: pytest.fail("the library is not asked"))
        for begin, end in [
            (0, 1),
            (SAMPLES - 1, SAMPLES),
            *np.sort(rng.integers(0, SAMPLES, (20, 2)), axis=1).tolist(),
        ]:
            found = np.empty(end - begin)
            if found.size:
                fill(begin, found)
            np.testing.assert_array_equal(found, values[begin:end])


def test_what_is_not_there_as_it_is_the_library_reads(tmp_path, rng, counted) -> None:
    path, values = tmp_path / "a.h5", rng.standard_normal(SAMPLES)
    written(path, values, chunks=(1000,), compression="gzip")
    np.testing.assert_array_equal(read(path).channel("AF").values, values)
    written(path, values.astype(">f8"))
    np.testing.assert_array_equal(read(path).channel("AF").values, values)
    with h5py.File(path, "w") as file:  # a piece that was never written is what the file says instead
        data = file.create_dataset("AF", (SAMPLES,), "f8", chunks=(1000,), fillvalue=2.5)
        data.attrs.update({"unit": "N", "fs": 1000.0})
        data[:5000], data[6000:] = values[:5000], values[6000:]
    values[5000:6000] = 2.5
    np.testing.assert_array_equal(read(path).channel("AF").values, values)
    assert not counted


def test_what_cannot_be_read_past_the_library_is_left_to_it(tmp_path, rng, monkeypatch) -> None:
    path, values = tmp_path / "a.h5", rng.standard_normal(SAMPLES)
    written(path, values)
    monkeypatch.setattr(os, "preadv", lambda handle, buffers, place: len(buffers[0]) - 1)
    np.testing.assert_array_equal(read(path).channel("AF").values, values)


def test_numbers_beyond_all_measure_are_named_wherever_they_are(tmp_path, rng) -> None:
    path = tmp_path / "a.h5"
    places = [0, 8191, 8192, 65_535, 65_536, 131_073, SAMPLES - 1]
    for k, wild in enumerate((1e101, -1e101, np.inf, -np.inf, np.nan)):
        values = rng.standard_normal(SAMPLES)
        for place in places[k % 3 :]:
            there = values.copy()
            there[place] = wild
            written(path, there)
            with pytest.warns(DataQualityWarning) as said:
                found = read(path).channel("AF").values
            there[place] = np.nan
            np.testing.assert_array_equal(found, there)
            named = any("1 number(s) beyond 1e+100 either way" in str(one.message) for one in said)
            assert named == bool(np.isfinite(wild))
            assert not named or any(f"channel 'AF', sample {place + 1}:" in str(one.message) for one in said)


def test_a_number_beyond_all_measure_has_its_place_in_the_file(tmp_path, rng) -> None:
    """Also where channels are read a piece at a time, as they stand in one table, or part by part."""
    path, rows = tmp_path / "a.h5", np.zeros(SAMPLES, dtype=[("AF [N]", "<f8"), ("NF [N]", "<f8")])
    rows["AF [N]"], rows["NF [N]"] = rng.standard_normal((2, SAMPLES))
    rows["NF [N]"][[100_000, 140_000]] = -3e105, np.inf
    with h5py.File(path, "w") as file:
        file.create_dataset("run", data=rows).attrs["fs"] = 1000.0
    with pytest.warns(DataQualityWarning) as said:
        found = read(path)
    assert any("1 number(s) beyond" in str(one.message) and "sample 100001:" in str(one.message) for one in said)
    expected = rows["NF [N]"].copy()
    expected[[100_000, 140_000]] = np.nan
    np.testing.assert_array_equal(found.channel("NF").values, expected)
    np.testing.assert_array_equal(found.channel("AF").values, rows["AF [N]"])
    with open_record(path) as record, pytest.warns(DataQualityWarning) as said:
        part = record.part(90_000, 145_000)
    assert any("1 number(s) beyond" in str(one.message) and "sample 100001:" in str(one.message) for one in said)
    np.testing.assert_array_equal(part.channel("NF").values, expected[90_000:145_000])


@pytest.mark.parametrize("kind", ["u1", "<i2", "<i4", "<f4", "<f8"])
def test_channels_of_a_wav_file_are_taken_apart(tmp_path, rng, kind) -> None:
    path, toml = tmp_path / "a.wav", tmp_path / "map.toml"
    whole = np.dtype(kind).kind != "f"
    full = np.iinfo(kind) if whole else None
    table = (
        # the highest and the lowest would be a converter at its limits
        rng.integers(full.min + 1, full.max, (SAMPLES, 3)) if full else rng.standard_normal((SAMPLES, 3))
    )
    table = table.astype(kind)
    wavfile.write(path, 1000, table)
    wanted = (("AF", 1), ("NF", 3))
    toml.write_text("".join(f'[channels.{name}]\ncolumn = "channel {k}"\nunit = "N"\n' for name, k in wanted))
    found = read(path, channel_map=load_channel_map(toml))
    # WAV has bytes with their zero at 128, and whole numbers of more bytes with a sign
    middle, zero = (2.0 ** (8 * table.itemsize - 1), 128 if kind == "u1" else 0) if whole else (1.0, 0)
    for name, k in wanted:
        np.testing.assert_array_equal(found.channel(name).values, (table[:, k - 1].astype(float) - zero) / middle)


@pytest.mark.parametrize("size", [0, 1, 8191, 8192, 8193, 20_000])
def test_one_pass_tells_what_is_within_measure(size, rng) -> None:
    values = rng.standard_normal(size) * 1e90
    assert within_measure(values)
    assert within_measure(np.repeat(values, 2)[::2])
    assert rows_within_measure(values.reshape(1, -1))
    for wild in (np.nan, np.inf, -np.inf, 2 * LARGEST, -2 * LARGEST, 1e200):
        for place in {0, size // 2, size - 1} if size else ():
            there = values.copy()
            there[place] = wild
            assert not within_measure(there)
            assert not rows_within_measure(there.reshape(1, -1))
            found = take_out(there)
            assert found.tolist() == ([place] if np.isfinite(wild) else [])
            values_left = np.delete(there, place)
            np.testing.assert_array_equal(values_left, np.delete(values, place))
            assert np.isnan(there[place])


def test_heaps_are_found_wherever_they_begin(tmp_path, rng) -> None:
    """Across the pieces of which readings are passed over, and with no other zeros in the file."""
    path = tmp_path / "a.h5"
    piece = hdf5_heaps._PIECE
    for begin in (
        piece - 8,
        piece - 7,
        piece - 4,
        piece - 1,
        piece,
        piece + 1,
        3 * piece + 100,
        4 * piece - 3,
        5 * piece,
    ):
        content = rng.integers(1, 256, 6 * piece, dtype=np.uint8)
        content[begin : begin + 8] = np.frombuffer(b"GCOL\x01\0\0\0", dtype=np.uint8)
        path.write_bytes(content.tobytes())
        with pytest.raises(ReadError, match=f"byte {begin}: claims a heap of"):
            hdf5_heaps.check_heaps(path)


def test_a_guarded_file_is_what_was_written_to_it(tmp_path, rng) -> None:
    path, oracle = tmp_path / "a.bin", io.BytesIO()
    with GuardedFile(path) as guarded:
        place = 0
        for _ in range(400):
            way = rng.random()
            if way < 0.2:
                place = int(rng.integers(0, 3_000_000))
            data = rng.bytes(int(rng.integers(0, 200_000)))
            for file in (guarded, oracle):
                file.seek(place)
                file.write(data)
            place += len(data)
            if way > 0.9:
                at, count = (int(one) for one in rng.integers(0, 100_000, 2))
                into = bytearray(count)
                guarded.seek(at)
                oracle.seek(at)
                assert into[: guarded.readinto(into)] == oracle.read(count)
            if way > 0.97:
                guarded.truncate(size := int(rng.integers(0, 3_000_000)))
                oracle.truncate(size)
                oracle.seek(0, io.SEEK_END)
                oracle.write(bytes(max(0, size - oracle.tell())))
    assert path.read_bytes() == oracle.getvalue()
