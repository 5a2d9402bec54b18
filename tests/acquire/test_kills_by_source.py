"""Recorder and source are killed at random moments, whatever gives the samples: nothing acknowledged is lost."""

import contextlib
import time
import warnings
from importlib.util import find_spec

import numpy as np
import pytest

from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import parse_setup
from aerobalance.acquisition.simulated import RigSettings, SimulatedSource
from aerobalance.app.commands import force, recordings
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import read_blocks
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.simulation.published import CABLE_CUT
from helpers.at_work import follow, lost_by_a_kill
from helpers.devices import RIG, Server, free_port

SEED = 11
RECORD = "[record]\nblock = 0.05\nkeep_free = 0.0\n[channels.AF]\n[channels.live_acceleration]\n"
RIGGED = f'[source]\nkind = "simulated"\nrig = "cable_cut"\nrate = 1600.0\nseed = {SEED}\nblock = 0.01\n'
LONG_ENOUGH = 200

installed = pytest.mark.skipif(find_spec("opendaq") is None, reason="the extra opendaq is not installed")
KINDS = ["simulated", "replay", pytest.param("opendaq", marks=installed)]


def given(samples):
    """What the seeded rig gives of AF and live_acceleration, so many samples of each."""
    source = SimulatedSource(RigSettings(rig="cable_cut", rate=1600.0, seed=SEED, block=0.01, speed=float("inf")))
    names = [channel.name for channel in source.channels]
    source.start()
    found, rows = [], 0
    while rows < samples:
        found.append(source.read(1.0).samples)
        rows += len(found[-1])
    return np.concatenate(found)[:, [names.index("AF"), names.index("live_acceleration")]], source.rate


@contextlib.contextmanager
def source_of(kind, folder):
    """A set-up whose source gives what the seeded rig gives, and the process of the device where there is one."""
    if kind == "simulated":
        yield RIGGED, None
    elif kind == "replay":
        samples, rate = given(20_000)
        channels = (StoredChannel("AF", "N"), StoredChannel("live_acceleration", "m/s^2"))
        writer = BlockWriter(folder / "given.h5", channels, rate=rate, rows=500, provenance=Provenance("test"))
        for first in range(0, len(samples), 500):
            writer.append(first, samples[first : first + 500])
        writer.finish("done")
        yield '[source]\nkind = "replay"\nfile = "given.h5"\nblock = 0.01\n', None
    else:
        port = free_port()
        (folder / "rig.toml").write_text(RIGGED, encoding="utf-8")
        with Server(RIG, port, folder / "rig.toml") as server:
            server.listen()
            yield f'[source]\nkind = "opendaq"\naddress = "daq.nd://127.0.0.1:{port}"\n', server


def check(file, acknowledged, expected):
    """What was acknowledged is in the file to the last bit, and the file is ready for `info` and `force`."""
    assert len(contents(file).blocks) >= acknowledged.blocks
    blocks = list(read_blocks(file))
    assert all(samples is not None for _, samples in blocks)
    found = sum(len(samples) for _, samples in blocks)
    assert found >= acknowledged.samples
    if found < 2:
        return
    # a device runs before it is listened to, so that the first sample may be any
    first = int(np.flatnonzero(expected[:, 0] == blocks[0][1][0, 0])[0])
    for tick, samples in blocks:
        place = first + tick - blocks[0][0]
        assert samples.tobytes() == expected[place : place + len(samples)].tobytes()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        account = recordings.info(file)
        assert (account["samples"], account["gaps"]) == (found, [])
        if found >= LONG_ENOUGH:
            dynamics = file.with_name("dynamics.json")
            told = force.force(file, file.with_suffix(".csv"), dynamics=dynamics)
            # the cable hangs: 10 N of noise over the middle half of the samples, five times over
            lines = np.loadtxt(file.with_suffix(".csv"), delimiter=",", skiprows=1)[found // 4 : -(found // 4)]
            assert list(told["components"]) == ["AF"]
            assert lines[:, 1].mean() == pytest.approx(-1020.0, abs=5 * 10 / np.sqrt(len(lines)) + 1)


def kill(kind, folder, count, seed):
    rng = np.random.default_rng(seed)
    write_dynamics(folder / "dynamics.json", {"AF": CABLE_CUT.dynamics})
    expected = given(200_000)[0]
    killed = {}
    for number in range(count):
        victim = str(rng.choice(["recorder", "source"]))
        with source_of(kind, folder) as (source, server), Session(parse_setup(source + RECORD), folder) as session:
            file = folder / f"{kind}-{number}.h5"
            recorder = session.record(file)
            recorder.ready()
            session.start()
            time.sleep(rng.uniform(0, 1.0))
            where = f"seed {seed}, kill {number}, {victim}"
            progress = lost_by_a_kill(session, recorder, victim)
            if victim == "recorder":
                assert session.process.is_alive(), where
                # another record of the same source goes on
                again = session.record(file.with_name(f"{kind}-{number}-again.h5"))
                again.ready()
                follow(again, lambda progress: progress.blocks > 2)
                assert again.stop("enough").reason == "enough", where
                check(file.with_name(f"{kind}-{number}-again.h5"), again.progress, expected)
            else:
                assert contents(file).reason == progress.reason, where
            assert server is None or server.process.poll() is None, where
            check(file, progress, expected)
        (folder / "given.h5").unlink(missing_ok=True)
        killed[victim] = killed.get(victim, 0) + 1
    print(f"{kind}: killed {killed}, nothing acknowledged was lost")  # noqa: T201 - shown with -s


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_thirty_kills_lose_nothing_acknowledged(kind, tmp_path, seed) -> None:
    kill(kind, tmp_path, 30, seed)
