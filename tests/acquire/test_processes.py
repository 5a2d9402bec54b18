"""Processes beside a clock compute with one thread, and whoever starts them keeps its own settings."""

import os
import subprocess
import sys
from collections.abc import Mapping
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
    if given is not None:
        environment[NAME] = given
    result = run(PROGRAM, environment)
    assert result.stdout.split() == [str(threads), str(given)], result.stderr


def run(program: str, environment: Mapping[str, str], *folders: Path) -> subprocess.CompletedProcess[str]:
    """Run a program that finds this one, the helpers of tests, and what is in some folders."""
    paths = [*sys.path[1:], str(Path(__file__).parents[1]), *map(str, folders)]
    environment = {**environment, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


FRAIL = """
from aerobalance.acquisition.processes import load_beforehand, pipe, start_worker
from aerobalance.recording.errors import FitError
from helpers.worker import tell_threads

load_beforehand("frail")
here, there = pipe()
try:
    process = start_worker(tell_threads, there)
except FitError as problem:
    print(problem)
else:
    print(here.recv() > 0)
    process.join(30)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no process forks others")
@pytest.mark.parametrize(("deaths", "said"), [(1, "True"), (9, "a process could not be started")])
def test_where_what_forks_processes_is_killed_another_one_does(deaths: int, said: str, tmp_path: Path) -> None:
    """It said that the user had interrupted it."""
    (tmp_path / "left").write_text("x" * deaths)
    (tmp_path / "frail.py").write_text(
        "import os, signal\nfrom pathlib import Path\n"
        "file = Path(__file__).with_name('left')\nleft = file.read_text()\nfile.write_text(left[1:])\n"
        "if left: os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    result = run(FRAIL, os.environ, tmp_path)
    assert result.stdout.startswith(said), result.stderr
    assert result.returncode == 0
