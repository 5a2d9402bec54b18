"""How the processor time of a force grows with its record, and what a command takes from its call to its end."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import prev_fast_len

from aerobalance.dynamics.independent import dynamics_of
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.force import ForceWork, estimate_force
from aerobalance.estimation.force_parts import DIVISION
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.parts import Part
from aerobalance.recording.recording import Recording
from aerobalance.recording.side_by_side import one_after_the_other
from aerobalance.simulation import CableCut
from helpers.accuracy import RIG, WIDE, density
from helpers.yardstick import Yardstick, spent

RATE = 25_000.0
PARTS = (1, 3, 10)
TURNS = 5
"""Times that each length is worked out, in turn with the others."""

LIMIT = 0.05
"""By how much the time of a further sample may change from the shorter lengths to the longer ones."""


def load_of(rng: np.random.Generator, count: int) -> Array:
    """Readings under a load of 0-900 Hz that does not repeat, of one spectrum all along [N]."""
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    scale = np.sqrt(density(WIDE["0-900 Hz"], frequency, rate=RATE, rms=100.0) * count * RATE / 2)
    phasors = scale * (rng.normal(size=scale.size) + 1j * rng.normal(size=scale.size))
    phasors[0] = 0
    return np.fft.irfft(phasors * RIG.response(frequency), count) + rng.normal(0, 0.5, count)


def recording_of(time: Array, values: Array) -> Recording:
    channel = Channel(RIG.component, values, "N")
    return Recording.from_columns(time, {RIG.component: channel})


def force_of(time: Array, values: Array) -> Force:
    return estimate_force(recording_of(time, values), RIG)


def own_time(work: Callable[[], object]) -> float:
    """Processor time of the program itself [s].

    What the kernel takes to find memory for what comes out of a record is not in it: 0.05 s for a gigabyte that it has
    at hand, 0.9 s where a virtual machine is given it anew, which begins somewhere between the lengths below.
    """
    begin = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    work()
    return resource.getrusage(resource.RUSAGE_SELF).ru_utime - begin


@pytest.mark.alone
@pytest.mark.skipif(os.name == "nt", reason="the times of the program and of the kernel are told apart by POSIX")
def test_time_grows_as_the_record_does(record, rng) -> None:
    """All parts have the same readings: that one looks closer at a peak than another is no growth."""
    dynamics = dynamics_of(RIG)

    def divided(values: Array) -> tuple[int, Sequence[Part]]:
        clock = ForceWork(recording_of(np.arange(values.size) / RATE, values), dynamics).working
        return clock.every, DIVISION.parts(clock, dynamics, every=clock.every, shown=clock.shown)

    every, (first, second) = divided(load_of(rng, 2_000_000))
    length = prev_fast_len(DIVISION.length(dynamics, every=every), real=True)
    again = (length - (first.end - second.begin)) * every
    period = load_of(rng, again)

    def of(parts: int) -> float:
        values = np.resize(period, length * every + (parts - 1) * again)
        lengths = [part.end - part.begin for part in divided(values)[1]]
        assert lengths[:-1] == [length] * (parts - 1) and lengths[-1] > 0.95 * length
        time = np.arange(values.size) / RATE
        return own_time(lambda: force_of(time, values))

    of(1)
    times = np.median([[of(parts) for parts in PARTS] for _ in range(TURNS)], axis=0)
    early, late = np.diff(times) / np.diff(PARTS)
    print(f"{[f'{one:.2f} s' for one in times]} of {PARTS} parts, a further one {early:.2f} and {late:.2f} s")  # noqa: T201
    steady = min(early / late, late / early)
    record(
        "own time of a further part up to 3 and then up to 10 (1e7 samples), the less over the more", steady, 1 - LIMIT
    )
    assert steady > 0.7


@pytest.mark.alone
def test_a_further_sample_of_one_component(record, rng) -> None:
    """By one thread, as the transforms: two took 9 to 39 % more processor time for the same, by turns in one run."""
    values, shorter = load_of(rng, 10_000_000), 2_000_000
    time = np.arange(values.size) / RATE
    yardstick, times = Yardstick(values[:shorter]), []
    with one_after_the_other():
        spent(lambda: force_of(time[:shorter], values[:shorter]))
        for some in (shorter, values.size):
            yardstick.beside()
            times.append(spent(lambda some=some: force_of(time[:some], values[:some])))
    yardstick.beside()
    further, transform = (times[1] - times[0]) / (values.size - shorter), yardstick.transform
    print(f"a further sample {further / transform:.1f} transforms of {1e9 * transform:.1f} ns")  # noqa: T201
    record(
        "40 transforms over the time of a further sample, 1e7 of one component at 25 kHz",
        40 * transform / further,
        1.0,
    )
    assert further < 80 * transform


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
