"""Replay: what is played is what was recorded, and a recording need not fit into the memory."""

import errno
import math
import os
import pickle
import tracemalloc

import numpy as np
import pytest

from aerobalance.acquisition.replay import AGAIN, ReplaySource
from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import setup_from, stored_channels
from aerobalance.acquisition.source import SourceChannel, SourceEndedError
from aerobalance.acquisition.sources import open_source
from aerobalance.app.cli import main
from aerobalance.io import read
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.recording.channel import AntiAlias, CrossAxis
from aerobalance.recording.errors import DataQualityWarning, FitError, ReadError

CHANNELS = (
    StoredChannel("AF", "lbf", sign=-1.0, scale=2.0, offset=0.5),
    StoredChannel("rNF", "uV/V"),
    StoredChannel("ground_acceleration", "g"),
    StoredChannel("temperature", "degF"),
    StoredChannel("tap 3", "deg"),
)


def written(path, blocks, *, channels=CHANNELS, rows=400, rate=2000.0):
    writer = BlockWriter(path, channels, rate=rate, rows=rows, provenance=Provenance("test"))
    for tick, samples in blocks:
        writer.append(tick, samples)
    writer.finish("done")


def played(source):
    source.start()
    found = []
    with pytest.raises(SourceEndedError, match="at its end"):
        while True:
            found.append(source.read(1.0))
    return found


def test_a_record_is_played_as_it_would_be_read_with_its_gaps_and_units(tmp_path, rng) -> None:
    blocks, tick = [], 7_000
    for _ in range(12):
        rows = int(rng.integers(1, 400))
        samples = rng.normal(size=(rows, len(CHANNELS)))
        samples[rng.uniform(size=rows) < 0.05, 1] = np.nan
        blocks.append((tick, samples))
        tick += rows + int(rng.integers(0, 2)) * int(rng.integers(1, 300))
    written(tmp_path / "run.h5", [*blocks, (tick + 5, np.zeros((2, len(CHANNELS))))])
    source = ReplaySource(tmp_path / "run.h5", speed=math.inf, block=0.05)
    with pytest.warns(DataQualityWarning, match="missing"):
        whole = read(tmp_path / "run.h5")
    assert [(item.name, item.unit) for item in source.channels] == [(item.name, item.unit) for item in whole]
    assert source.rate == whole.rate
    expected = np.column_stack([item.values for item in whole])
    found = np.full_like(expected, np.nan)
    due = 0
    for block in played(source):
        assert block.tick >= due
        assert len(block.samples) <= 100
        found[block.tick : block.end] = block.samples
        due = block.end
    assert due == len(expected)
    assert np.array_equal(found, expected, equal_nan=True)


@pytest.mark.parametrize("kind", ["h5", "csv"])
def test_what_a_recording_says_of_its_sensors_is_known_of_its_replay(tmp_path, kind) -> None:
    """In the units inside: 0.01 lbf are 0.0444822 N by the definition of the pound, 1 g is 9.80665 m/s^2."""
    if kind == "h5":
        channels = (
            StoredChannel("AF", "lbf", delay=0.013, noise=0.01, filter=AntiAlias("bessel", 4, 200.0)),
            StoredChannel(
                "ground_acceleration",
                "g",
                delay=-0.002,
                coupling="ac",
                corner=1.5,
                place=(0.5, 0.0, 0.1),
                cross_axis=(CrossAxis("ground_acceleration_up", 0.02, 0.001),),
            ),
            StoredChannel("ground_acceleration_up", "g", zero_uncertainty=0.1),
        )
        written(tmp_path / "run.h5", [(0, np.zeros((10, 3)))], channels=channels)
        setup = setup_from({"source": {"kind": "replay", "file": "run.h5"}})
    else:
        (tmp_path / "run.csv").write_text("time [s],load [lbf],a [g]\n0.0,0,0\n0.1,0,0\n0.2,0,0\n")
        (tmp_path / "map.toml").write_text(
            '[channels.AF]\ncolumn = "load"\ndelay = 0.013\nnoise = 0.01\n'
            '[channels.ground_acceleration]\ncolumn = "a"\ndelay = -0.002\ncoupling = "ac"\ncorner = 1.5\n'
        )
        setup = setup_from({"source": {"kind": "replay", "file": "run.csv", "map": "map.toml"}})
    load, motion, *_ = stored = stored_channels(setup, open_source(setup, tmp_path).channels)
    assert (load.delay, load.unit) == (0.013, "N")
    assert load.noise == pytest.approx(0.01 * 4.4482216152605, rel=1e-12)
    assert (motion.delay, motion.coupling, motion.corner) == (-0.002, "ac", 1.5)
    if kind == "h5":
        assert load.filter == AntiAlias("bessel", 4, 200.0)
        assert (motion.place, motion.cross_axis) == (channels[1].place, channels[1].cross_axis)
        assert stored[2].zero_uncertainty == pytest.approx(0.980665, rel=1e-12)


def test_a_set_up_says_more_of_a_sensor_than_the_recording() -> None:
    given = [
        SourceChannel("AF", "N", delay=0.01, noise=0.3),
        SourceChannel("a", "m/s^2", coupling="ac", corner=2.0, cross_axis=(CrossAxis("b", 0.01),)),
        SourceChannel("b", "m/s^2", coupling="ac", corner=2.0),
    ]
    table = {
        "AF": {"delay": 0.002, "scale": 2.0},
        "ground_acceleration": {"input": "a", "coupling": "dc"},
        "live_acceleration": {"input": "b", "noise": 0.1},
    }
    load, ground, live = stored_channels(setup_from({"channels": table}), given)
    # delays add up, and a noise grows with the scale
    assert (load.delay, load.noise) == (pytest.approx(0.012), 0.6)
    assert (ground.coupling, ground.corner, ground.cross_axis) == ("dc", 0.0, (CrossAxis("live_acceleration", 0.01),))
    assert (live.coupling, live.corner, live.noise) == ("ac", 2.0, 0.1)
    table["ground_acceleration"]["sign"] = -1
    with pytest.raises(FitError, match="channel ground_acceleration: the source knows the axis"):
        stored_channels(setup_from({"channels": table}), given)
    with pytest.raises(FitError, match=r"channel tap 3: what the source knows .* coupling is for accelerations"):
        stored_channels(setup_from({"channels": {"tap 3": {"input": "a"}}}), given[1:2])


def test_a_damaged_block_is_a_gap_that_says_why(tmp_path) -> None:
    import h5py

    file = tmp_path / "run.h5"
    written(file, [(i * 400, np.full((400, 5), float(i))) for i in range(3)])
    with h5py.File(file, "r+", libver="latest") as opened:
        opened["samples"][450, 0] = 99.0
    found = played(ReplaySource(file, speed=math.inf, block=0.2))
    assert [(block.tick, block.remark != "") for block in found] == [(0, False), (800, True)]
    assert "checksum" in found[1].remark


def test_a_large_record_is_not_read_whole(tmp_path) -> None:
    file = tmp_path / "run.h5"
    names = tuple(StoredChannel(f"tap {i}", "N") for i in range(12))
    # 24 MB of samples
    written(file, ((i * 2500, np.full((2500, 12), float(i))) for i in range(100)), channels=names, rows=2500)
    tracemalloc.start()
    try:
        source = ReplaySource(file, speed=math.inf)
        rows = sum(len(block.samples) for block in played_lazily(source))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert rows == 250_000
    # some blocks of 240 kB, and the tables: far from 24 MB
    assert peak < 6e6


def played_lazily(source):
    source.start()
    while True:
        try:
            yield source.read(1.0)
        except SourceEndedError:
            return


def test_files_that_cannot_be_played(tmp_path) -> None:
    written(tmp_path / "run.h5", [(0, np.zeros((1, 5)))])
    with pytest.raises(ReadError, match="fewer than two samples"):
        ReplaySource(tmp_path / "run.h5")
    with pytest.raises(ReadError, match="no such file"):
        ReplaySource(tmp_path / "none.h5")


def test_a_file_that_cannot_be_played_is_told_by_the_process_of_the_source(tmp_path) -> None:
    with pytest.raises(ReadError, match="no such file") as fault:
        Session(setup_from({"source": {"kind": "replay", "file": "none.h5"}}), tmp_path)
    assert (fault.value.path, fault.value.where) == (tmp_path / "none.h5", "")
    for path in ("run.csv", "https://example.org/run.csv"):
        given = ReadError(path, "line 3", "is no number")
        told = pickle.loads(pickle.dumps(given))
        assert (str(told), told.path, told.where, told.what) == (str(given), given.path, "line 3", "is no number")


@pytest.mark.parametrize("kind", ["h5", "csv"])
def test_a_replay_begins_again_without_a_gap_and_says_so(tmp_path, kind) -> None:
    ramp = np.arange(130.0)
    if kind == "h5":
        written(tmp_path / "run.h5", [(500, ramp[:, None])], channels=(StoredChannel("AF", "N"),), rate=1000.0)
    else:
        table = np.column_stack([ramp / 1000, ramp])
        np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="time [s],AF [N]", comments="", fmt="%.6f")
    source = ReplaySource(tmp_path / f"run.{kind}", speed=math.inf, block=0.05, loop=True)
    source.start()
    blocks = [source.read(1.0) for _ in range(9)]
    assert [block.tick for block in blocks] == [0, 50, 100, 130, 180, 230, 260, 310, 360]
    assert np.concatenate([block.samples for block in blocks])[:, 0].tolist() == [*ramp, *ramp, *ramp]
    assert [block.tick for block in blocks if block.remark == AGAIN] == [130, 260]
    assert {block.remark for block in blocks} == {"", AGAIN}
    assert "again and again" in source.description


def test_links_in_a_circle_are_told_as_such(tmp_path, capsys) -> None:
    (tmp_path / "run.csv").symlink_to(tmp_path / "other.csv")
    (tmp_path / "other.csv").symlink_to(tmp_path / "run.csv")
    words = ["record", "--source", "replay", "--file", str(tmp_path / "run.csv"), "-o", str(tmp_path / "run.h5")]
    assert main(words) == 2
    assert f"{tmp_path / 'run.csv'}: cannot be read: {os.strerror(errno.ELOOP)}" in capsys.readouterr().err
