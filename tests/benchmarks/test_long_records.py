"""Memory of a long record of six components, from mV/V to forces, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.demos.six_demo import DemoFolder, bearable, calibrated, identified, largest_felt, weighed
from aerobalance.io import write_recording
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation import SixComponentRig
from aerobalance.simulation.six_balance import random_balance
from aerobalance.simulation.six_components import Release
from aerobalance.simulation.six_signals import Band, broadband

LARGEST = 500.0
"""Most memory that the program may have resident [MB]."""

CHANNELS = 12
PARTS = (3, 8)
PART, OWN = 40_960, 30_720
"""Samples of a part of six components, and those of them that it adds to a record."""


def resident(words: list[str]) -> float:
    """Largest resident memory of a command [MB]."""
    command = [sys.executable, "-m", "aerobalance.app.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        _, status, used = os.wait4(running.pid, 0)
        running.returncode = os.waitstatus_to_exitcode(status)
        assert running.returncode == 0, running.stderr and running.stderr.read()
    return used.ru_maxrss / 1024


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the unit of ru_maxrss is that of Linux")
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
        releases=(Release(bearable(balance, 0.1 * balance.half_range), instant=1.0001),),
        pitch=lambda time: np.zeros(time.shape),
        roll=lambda time: np.zeros(time.shape),
    )
    made = rig.run(duration, folder.generator).recording
    kept = [name for name in made.channels if name[1:] in COMPONENTS or name in ("pitch", "roll")]
    kept += [name for name in made.channels if name not in kept][: CHANNELS - len(kept)]
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
