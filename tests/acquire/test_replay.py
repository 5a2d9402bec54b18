"""Replay: what is played is what was recorded, and a recording need not fit into the memory."""

import math
import tracemalloc

import numpy as np
import pytest

from aerobalance.acquisition.replay import AGAIN, ReplaySource
from aerobalance.acquisition.source import SourceEndedError
from aerobalance.io import read
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.recording.errors import DataQualityWarning, ReadError

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
