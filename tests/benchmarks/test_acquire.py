"""The recorder beside the clock: twelve channels at 25 kHz, nothing lost, and the processor time it takes."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import parse_setup
from aerobalance.acquisition.simulated import RigSettings, SimulatedSource
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import read_blocks

SECONDS = 6.0
SETUP = f'[source]\nkind = "simulated"\nrig = "six"\nseed = 3\n[record]\nseconds = {SECONDS}\n'


def processor_time(pid: int) -> float:
    """Time that a process has kept a core busy [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.alone
def test_twelve_channels_at_25_khz_in_real_time(tmp_path, record) -> None:
    if not Path("/proc/self/stat").exists():
        pytest.skip("the processor time of other processes is read from /proc")
    file = tmp_path / "run.h5"
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(file)
        recorder.ready()
        pids = (session.process.pid or 0, recorder.process.pid or 0)
        before = [processor_time(pid) for pid in pids]
        session.start()
        begin = time.monotonic()
        spent = before
        latency = []
        while not recorder.poll(0.05).over:
            spent = [processor_time(pid) for pid in pids]
            latency.append(time.monotonic() - begin - recorder.progress.seconds)
        elapsed = time.monotonic() - begin
    used = sum(after - first for after, first in zip(spent, before, strict=True)) / elapsed
    assert (recorder.progress.gaps, recorder.progress.samples) == (0, round(SECONDS * 25_000))
    assert contents(file).channels[5].name == "AF"
    source = SimulatedSource(RigSettings(rig="six", seed=3, speed=float("inf")))
    source.start()
    expected = np.empty((0, 12))
    due = 0
    for tick, samples in read_blocks(file):
        assert tick == due
        assert samples is not None
        while len(expected) < len(samples):
            expected = np.concatenate([expected, source.read(1.0).samples])
        assert samples.tobytes() == expected[: len(samples)].tobytes()
        expected, due = expected[len(samples) :], due + len(samples)
    assert due == round(SECONDS * 25_000)
    shares = [(after - first) / elapsed for after, first in zip(spent, before, strict=True)]
    print(f"source {shares[0]:.3f}, recorder {shares[1]:.3f} cores; sample to disk {np.median(latency):.3f} s")  # noqa: T201
    # all processes together, the page among them, may take 1.3 cores
    record(
        "record time over processor time of source and recorder, 12 channels at 25 kHz", 1 / used, round(1 / 1.3, 4)
    )
    assert used < 1.3
    assert elapsed < SECONDS + 2
