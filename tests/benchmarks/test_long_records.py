"""Memory of a long record of six components, from mV/V to forces, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.demos.six_demo import DemoFolder, calibrated, identified, largest_felt, weighed
from aerobalance.io import write_recording
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_signals import Band, broadband, random_motion

LARGEST = 500.0
"""Most memory that the program may have resident [MB]."""

CHANNELS = 12
PARTS = (3, 8)
PART, OWN = 57_344, 43_008
"""Samples of a part of six components, and those of them that it adds to a record."""


PROGRAM = """
import pathlib, sys
from aerobalance.app.cli import main
code = main(sys.argv[1:])
lines = pathlib.Path("/proc/self/status").read_text().splitlines()
print(next(line for line in lines if line.startswith("VmHWM")), file=sys.stderr)
sys.exit(code)
"""
"""A command that says how much memory it had: what the system says of a child counts its parent's before it begins."""


def resident(words: list[str]) -> float:
    """Largest resident memory of a command [MB]."""
    run = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return float(run.stderr.splitlines()[-1].split()[1]) / 1024


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # of the way to the dynamics
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is told by the kernel of Linux")
def test_memory_does_not_grow_with_the_record(tmp_path: Path, record, seed: int) -> None:
    folder = DemoFolder(tmp_path, np.random.default_rng(seed))
    balance = random_balance(folder.generator)
    files = calibrated(folder, balance)
    dynamics = identified(folder, balance, files, weighed(folder, balance, files))
    band = Band(0, 1.2 * max(mode.natural_frequency for mode in balance.dynamics.modes))
    samples = PART + (PARTS[-1] - 1) * OWN
    duration = samples / 25_000.0
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
    found = {}
    for parts in PARTS:
        path = tmp_path / f"run_{parts}.h5"
        write_recording(path, made.part(0, PART + (parts - 1) * OWN))
        words = ["force", str(path), "--dynamics", str(dynamics), "--balance", str(files.balance)]
        words += ["--zero", str(files.zero[0]), "-o", str(tmp_path / f"force_{parts}.h5")]
        found[parts] = resident(words)
        print(f"force, {parts} parts of six components: {found[parts]:.0f} MB")  # noqa: T201
    few, many = (found[parts] for parts in PARTS)
    record("500 MB over the memory of force, six components from mV/V in twelve channels", LARGEST / many, 1.0)
    record("memory of force of 3 parts over that of 8 parts", few / many, 0.93)
    assert many < LARGEST
    # what stays of a part is sums, and a few numbers of each; the heap of a process settles within the first parts
    assert few > 0.93 * many
