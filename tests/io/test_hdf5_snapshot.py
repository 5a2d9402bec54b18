"""A recording that is written to, fetched as a whole file."""

import subprocess
import sys

import h5py
import numpy as np
import pytest

from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import read_blocks
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.io.hdf5_snapshot import FileSnapshot
from aerobalance.recording.errors import ReadError

CHANNELS = (StoredChannel("AF", "N"), StoredChannel("NF", "N", scale=2.0))


def block(number, rows):
    return np.random.default_rng(number).normal(size=(rows, 2))


@pytest.fixture
def writer(tmp_path):
    made = BlockWriter(tmp_path / "run.h5", CHANNELS, rate=1000.0, rows=50, provenance=Provenance("test", "a = 1\n"))
    made.origin(3)
    yield made
    made.finish("done")


@pytest.mark.parametrize("count", [1, 2, 5, 700])
def test_blocks_of_the_moment_are_in_it_while_others_are_written(writer, tmp_path, count) -> None:
    for number in range(count):  # every third is short
        writer.append(100 * number, block(number, 20 if number % 3 == 2 else 50))
    writer.event(7, kind="note", text="told")
    writer.gap(50, 50, kind="lost", text="gone")
    snapshot = FileSnapshot(tmp_path / "run.h5")
    parts = snapshot.parts()
    copy = next(parts)
    for number in range(count, count + 40):  # meanwhile, the record goes on
        writer.append(100 * number, block(number, 50))
    copy += b"".join(parts)
    assert len(copy) == snapshot.size
    (tmp_path / "copy.h5").write_bytes(copy)
    found = dict(read_blocks(tmp_path / "copy.h5"))
    assert sorted(found) == [100 * number for number in range(count)]
    for number in range(count):
        assert found[100 * number].tobytes() == block(number, 20 if number % 3 == 2 else 50).tobytes()
    kept, own = contents(tmp_path / "copy.h5"), contents(tmp_path / "run.h5")
    assert (kept.channels, kept.rate, kept.origin) == (own.channels, own.rate, own.origin)
    with h5py.File(tmp_path / "copy.h5") as file:
        assert file["setup"][...].tobytes() == b"a = 1\n"
    assert (len(kept.events), len(kept.gaps), kept.state) == (1, 1, "recording")


def test_other_programs_open_it(writer, tmp_path) -> None:
    writer.append(0, block(0, 50))
    writer.append(50, block(1, 30))
    (tmp_path / "copy.h5").write_bytes(b"".join(FileSnapshot(tmp_path / "run.h5").parts()))
    with h5py.File(tmp_path / "copy.h5", "r") as file:
        assert file["samples"][...].tobytes() == np.concatenate([block(0, 50), block(1, 30)]).tobytes()
    command = [sys.executable, "-m", "aerobalance.app.cli", "info", str(tmp_path / "copy.h5")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, "80" in done.stdout) == (0, True), done.stderr


def test_nothing_is_sent_of_a_record_without_a_block(writer, tmp_path) -> None:
    with pytest.raises(ReadError, match="no block yet"):
        FileSnapshot(tmp_path / "run.h5")
