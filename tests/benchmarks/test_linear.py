"""How the processor time of a force grows with its record, and what a command takes from its call to its end."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import irfft, rfft

from aerobalance.estimation.force import estimate_force
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut
from helpers.accuracy import RIG, WIDE, density

RATE = 25_000.0
PART = 245_760
"""Samples that the lengths are multiples of: the shortest is one part of a slower clock."""

LENGTHS = (4 * PART, 12 * PART, 40 * PART)
LIMIT = 0.05
"""By how much the time of a further sample may change from the shorter lengths to the longer ones."""


def long_load(rng: np.random.Generator) -> Array:
    """Readings under a load of 0-900 Hz that never repeats, of one spectrum all along [N].

    One period repeated would have all parts look closer at a peak by chance, or none.
    """
    count = LENGTHS[-1]
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    scale = np.sqrt(density(WIDE["0-900 Hz"], frequency, rate=RATE, rms=100.0) * count * RATE / 2)
    phasors = scale * (rng.normal(size=scale.size) + 1j * rng.normal(size=scale.size))
    phasors[0] = 0
    return np.fft.irfft(phasors * RIG.response(frequency), count) + rng.normal(0, 0.5, count)


def spent(work: Callable[[], object]) -> float:
    """Processor time [s]."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        work()
    return time.process_time() - begin


@pytest.mark.alone
def test_time_grows_as_the_record_does(record, rng) -> None:
    values = long_load(rng)

    def of(samples: int) -> float:
        channel = Channel(RIG.component, values[:samples], "N")
        run = Recording.from_columns(np.arange(samples) / RATE, {RIG.component: channel})
        return spent(lambda: estimate_force(run, RIG))

    of(2 * PART)
    times = [min(of(samples) for _ in range(2 if samples < LENGTHS[-1] else 1)) for samples in LENGTHS]
    early, late = np.diff(times) / np.diff(LENGTHS)
    transform = min(spent(lambda: irfft(rfft(values[: LENGTHS[1]]))) for _ in range(5)) / LENGTHS[1]
    told = f"a further sample {early / transform:.1f} and {late / transform:.1f} transforms"
    print(f"{[f'{one:.2f} s' for one in times]} of {LENGTHS} samples, {told}")  # noqa: T201
    steady = min(early / late, late / early)
    record("time of a further sample up to 3e6 and from there to 1e7, the less over the more", steady, 1 - LIMIT)
    record(
        "40 transforms over the time of a further sample to 1e7, one component at 25 kHz", 40 * transform / late, 1.0
    )
    assert steady > 0.7


def command(words: list[str], folder: Path, **environment: str) -> float:
    """Processor time of a command, from its call to its end [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "aerobalance.app.cli", *words],
        cwd=folder,
        env=os.environ | environment,
        check=True,
        capture_output=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


@pytest.mark.alone
@pytest.mark.skipif(os.name == "nt", reason="processor times of children are those of POSIX")
def test_commands_begin_soon(record, rng, tmp_path: Path) -> None:
    rig = CableCut()
    write_recording(tmp_path / "run.csv", rig.run(2.0, rng).recording)
    write_dynamics(tmp_path / "dynamics.json", {"AF": rig.dynamics})
    force = ["force", "run.csv", "--dynamics", "dynamics.json", "-o", "force.csv"]
    for name, words, allowed in (("--help", ["--help"], 0.3), ("force of 2 s at 1600 Hz", force, 1.5)):
        command(words, tmp_path)
        least = min(command(words, tmp_path) for _ in range(5))
        record(f"{allowed:g} s over the processor time of {name}, from its call to its end", allowed / least, 1.0)
        assert least < 3 * allowed
    again = min(command(force, tmp_path) for _ in range(3))
    first = command(force, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "compiled"))
    record("3 s over the pause in which the first force compiles", 3 / (first - again), 1.0)
    assert first - again < 6
