"""Processes beside a clock compute with one thread, and whoever starts them keeps its own settings."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NAME = "OPENBLAS_NUM_THREADS"
PROGRAM = f"""
import os
from aerobalance.acquisition.processes import pipe, start_worker
from helpers.worker import tell_threads

here, there = pipe()
process = start_worker(tell_threads, there)
print(here.recv(), os.environ.get({NAME!r}))
process.join(30)
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted in /proc")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one processor has one thread anyway")
@pytest.mark.parametrize(("given", "threads"), [(None, 1), ("2", 2)])
def test_one_thread_unless_said_otherwise(given, threads) -> None:
    without = ("OMP_NUM_THREADS", NAME)
    environment = {name: value for name, value in os.environ.items() if name not in without}
    environment["PYTHONPATH"] = os.pathsep.join([*sys.path[1:], str(Path(__file__).parents[1])])
    if given is not None:
        environment[NAME] = given
    command = [sys.executable, "-c", PROGRAM]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert result.stdout.split() == [str(threads), str(given)], result.stderr
