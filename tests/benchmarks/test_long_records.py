"""Long records of six components, from mV/V to forces: memory, processor time of a sample, and the clock."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from aerobalance.app.demos.six_demo import DemoFolder, calibrated, identified, largest_felt, weighed
from aerobalance.io import write_recording
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_signals import Band, broadband, random_motion
from helpers.yardstick import Yardstick

LARGEST = 500.0
"""Most memory that the program may have resident [MB]."""

CHANNELS, COMPONENTS, RATE = 12, 6, 25_000.0
SECONDS = (24.0, 60.0)
"""Lengths of the two records: two parts and five, which is as many a second as of a record of any length."""


PROGRAM = """
import pathlib, sys
from aerobalance.app.cli import run
try:
    run()
finally:
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    print(next(line for line in lines if line.startswith("VmHWM")), file=sys.stderr)
"""
"""The command, as it is started, that says how much memory it had: what the system says of a child counts its parent's
before it begins."""


class Spent(NamedTuple):
    """What a command took: largest resident memory [MB], processor time and time by the clock [s]."""

    memory: float
    processor: float
    clock: float


def spent(words: list[str]) -> Spent:
    """What a command takes, its libraries' own threads apart."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    clock, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    assert run.returncode == 0, run.stderr
    processor = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    kilobytes = float(run.stderr.splitlines()[-1].split()[1])  # of 1024 bytes
    return Spent(kilobytes * 1024 / 1e6, processor, clock)


@pytest.mark.alone
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # of the way to the dynamics
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is told by the kernel of Linux")
def test_long_records_of_six_components(tmp_path: Path, record, seed: int) -> None:
    folder = DemoFolder(tmp_path, np.random.default_rng(seed))
    balance = random_balance(folder.generator)
    files = calibrated(folder, balance)
    dynamics = identified(folder, balance, files, weighed(folder, balance, files))
    band = Band(0, 1.2 * max(mode.natural_frequency for mode in balance.dynamics.modes))
    duration = SECONDS[-1]
    rig = SixComponentRig(
        balance,
        applied=broadband(
            folder.generator, band, rms=0.15 / largest_felt(balance, band) * balance.half_range, period=2 * duration
        ),
        base=random_motion(folder.generator, Band(2, 40), rms=np.ones(6), period=2 * duration),
    )
    made = rig.run(duration, folder.generator).recording
    kept = [name for name in made.channels if name not in ("pitch", "roll")]  # which stay as they were for the zero
    made = replace(made, channels={name: made.channels[name] for name in kept})
    assert len(kept) == CHANNELS
    found = []
    counts = [int(seconds * RATE) for seconds in SECONDS]
    yardstick = Yardstick(np.random.default_rng(seed).normal(size=counts[0]))
    for place, samples in enumerate(counts):
        path = tmp_path / f"run_{place}.h5"
        write_recording(path, made.part(0, samples))
        words = ["force", str(path), "--dynamics", str(dynamics), "--balance", str(files.balance)]
        words += ["--zero", str(files.zero[0]), "-o", str(tmp_path / f"force_{place}.h5")]
        if not place:
            spent([*words, "--replace"])  # compiles
        yardstick.beside()
        # of two the larger memory and the shorter times: what else goes on on the machine lengthens them
        one, again = (spent([*words, "--replace"]) for _ in range(2))
        memory = max(one.memory, again.memory)
        found.append(Spent(memory, min(one.processor, again.processor), min(one.clock, again.clock)))
    few, many = found
    yardstick.beside()
    own = yardstick.transform
    further = (many.processor - few.processor) / (counts[1] - counts[0]) / COMPONENTS
    told = [f"{one.memory:.0f} MB, {one.processor:.2f} s of processor, {one.clock:.2f} s" for one in found]
    print(f"{SECONDS} s of six components: {told}; a further sample {further / own:.0f} transforms")  # noqa: T201
    record("500 MB over the memory of force, six components from mV/V in twelve channels", LARGEST / many.memory, 1.0)
    record("memory of force of 24 s over that of 60 s", few.memory / many.memory, 0.85)
    record("80 transforms over the time of a further sample of a component, six from mV/V", 80 * own / further, 1.0)
    record(
        "length of a record of 60 s over ten times the time of its force by the clock", duration / many.clock / 10, 1.0
    )
    assert many.memory < LARGEST
    # what stays of a part is sums, and a few numbers of each; the heap of a process settles within the first parts, of
    # which the shorter record has two: fifty more come to one or two per cent
    assert few.memory > 0.85 * many.memory
    assert further < 160 * own
