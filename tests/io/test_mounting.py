"""Where accelerometers sit and which way they read: from a channel map, through HDF5, to the recording."""

import zlib

import h5py
import numpy as np
import pytest

from aerobalance.io import read, write_recording
from aerobalance.io.channel_map import load_channel_map
from aerobalance.io.hdf5_layout import CHANNEL_2
from aerobalance.motion.platform import PlatformMotion
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import ReadError
from aerobalance.recording.recording import Recording
from helpers.hdf5_files import in_blocks

MAP = """
[file]
rate = 1000.0
[channels.ground_acceleration_1]
column = "a"
unit = "m/s^2"
noise = 1e-3
place = [0.5, 0, -0.1]
place_uncertainty = 0.002
axis = "up"
[channels.ground_acceleration_left]
column = "b"
unit = "m/s^2"
noise = 1e-3
place = [0.0, -0.25, 0.0]
axis = [0.6, 0.0, 0.8]
[channels.ground_turn_rate_PM]
column = "c"
unit = "deg/s"
[channels.ground_acceleration_y]
column = "d"
unit = "g"
"""


@pytest.fixture
def mapped(tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    rows = "\n".join(f"{np.sin(k)},{np.cos(k)},{k % 3},{k % 2}" for k in range(200))
    (tmp_path / "run.csv").write_text(f"a,b,c,d\n{rows}\n")
    return read(tmp_path / "run.csv", channel_map=load_channel_map(tmp_path / "map.toml"))


def check(recording):
    one, left = recording.channel("ground_acceleration_1"), recording.channel("ground_acceleration_left")
    assert (one.place, one.axis, one.place_uncertainty) == ((0.5, 0.0, -0.1), (0.0, 0.0, 1.0), 0.002)
    assert (left.place, left.axis, left.place_uncertainty) == ((0.0, -0.25, 0.0), (0.6, 0.0, 0.8), 0.0)
    right = recording.channel("ground_acceleration_y")
    assert (right.place, right.axis, right.unit) == (None, None, "m/s^2")
    rate = recording.channel("ground_turn_rate_PM")
    assert rate.unit == "rad/s"
    np.testing.assert_allclose(rate.values[:3], np.radians([0, 1, 2]))


def test_place_and_axis_reach_the_channel(mapped):
    check(mapped)


def test_place_and_axis_survive_a_conversion_to_hdf5(mapped, tmp_path):
    write_recording(tmp_path / "run.h5", mapped)
    check(read(tmp_path / "run.h5"))


def test_the_second_layout_is_still_read(mapped, tmp_path):
    write_recording(tmp_path / "run.h5", mapped)
    in_blocks(tmp_path / "run.h5", version=2)
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        table = file["channels"][...]
        second = np.zeros(table.shape, CHANNEL_2)
        for name in CHANNEL_2.names:
            second[name] = table[name]
        del file["channels"]
        file.create_dataset("channels", data=second)
        file.attrs["channels_crc32"] = zlib.crc32(second.tobytes())
    channel = read(tmp_path / "run.h5").channel("ground_acceleration_1")
    assert (channel.noise, channel.place, channel.axis) == (1e-3, None, None)


@pytest.mark.parametrize("text", [b'{"axis": [1, 1, 0]}', b'{"place": 3}', b"{", b'{"place": [1, 2]}'])
def test_an_impossible_mounting_is_a_damaged_file(mapped, tmp_path, text):
    write_recording(tmp_path / "run.h5", mapped)
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        table = file["channels"][...]
        table["mounting"] = text
        file["channels"][...] = table
        file.attrs["channels_crc32"] = zlib.crc32(table.tobytes())
    with pytest.raises(ReadError, match="impossible settings"):
        read(tmp_path / "run.h5")


@pytest.mark.parametrize(
    ("given", "instead", "words"),
    [
        ('"up"', '"down"', ["ground_acceleration_1.axis", "aft, right, up", "'down'"]),
        ("[0.5, 0, -0.1]", "[0.5, 0]", ["ground_acceleration_1.place", "three numbers", "in m"]),
        ("[0.5, 0, -0.1]", '"here"', ["ground_acceleration_1.place", "three numbers", "'here'"]),
        ("[0.5, 0, -0.1]", "[0.5, nan, 0]", ["ground_acceleration_1.place", "finite"]),
        ("[0.6, 0.0, 0.8]", "[1.6, 0.0, 0.8]", ["ground_acceleration_left.axis", "length 1"]),
        ("axis = [0.6, 0.0, 0.8]\n", "", ["ground_acceleration_left.axis", "is needed"]),
        ('"deg/s"', '"deg/s"\naxis = "up"', ["ground_turn_rate_PM", "place and axis are for"]),
        ('"deg/s"', '"Hz"', ["ground_turn_rate_PM.unit", "a rate of turn is expected"]),
        ('unit = "g"', 'unit = "g"\nplace_uncertainty = 0.1', ["ground_acceleration_y", "goes with a place"]),
        ("0.002", "-0.002", ["ground_acceleration_1.place_uncertainty", "greater than or equal to 0"]),
    ],
)
def test_wrong_mountings_are_refused_by_name(tmp_path, given, instead, words):
    assert given in MAP
    (tmp_path / "map.toml").write_text(MAP.replace(given, instead))
    with pytest.raises(ReadError) as refused:
        load_channel_map(tmp_path / "map.toml")
    for word in words:
        assert word in str(refused.value)


def test_a_mapped_pair_gives_the_turn(tmp_path):
    clock = np.arange(500) / 1000
    tone = np.sin(2 * np.pi * 30 * clock)
    channels = {
        f"ground_acceleration_{i}": Channel(
            f"ground_acceleration_{i}", -x * tone, "m/s^2", noise=1e-4, place=(x, 0.0, 0.0), axis=(0.0, 0.0, 1.0)
        )
        for i, x in enumerate((0.5, -0.5))
    }
    write_recording(tmp_path / "a.h5", Recording("pair", clock, np.arange(500), 0.0, 1000.0, channels))
    motion = PlatformMotion.of(read(tmp_path / "a.h5"))
    np.testing.assert_allclose(motion.acceleration[:, 1], tone, atol=1e-12)
