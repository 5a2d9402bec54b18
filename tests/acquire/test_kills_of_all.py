"""The command record, one of its processes, or all are killed: nothing on the disk is lost, nothing stays."""

import contextlib
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.io.hdf5_file import read_blocks
from helpers.at_work import blocks_of
from helpers.monitor_program import children

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found in /proc")

VICTIMS = ("main", "recorder", "source", "loader", "all")
SECONDS = 300.0  # for a busy machine


def state_of(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


def family(process, file):
    """Numbers of the processes of a record, by what they do; the loader is the one that the others are forked from."""
    found = {"main": process.pid}
    for child in children(process.pid):
        if b"resource_tracker" in Path(f"/proc/{child}/cmdline").read_bytes():
            continue
        handles = {str(handle.readlink()) for handle in Path(f"/proc/{child}/fd").iterdir()}
        role = "loader" if children(child) else "recorder" if str(file) in handles else "source"
        found[role] = child
    return found


@contextlib.contextmanager
def begin(folder, name, temporary):
    command = [sys.executable, "-m", "aerobalance.app.cli", "record", "--source", "simulated", "--rig", "cable_cut"]
    environment = os.environ | {"TMPDIR": str(temporary)}
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*command, "-o", name], cwd=folder, env=environment, **streams) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until(holds, what):
    limit = time.monotonic() + SECONDS
    while not holds():
        assert time.monotonic() < limit, what
        time.sleep(0.05)


def kill(folder, victim, number, enough):
    """Kill once some blocks are on the disk; return how many there were."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    file = folder / f"run{number}.h5"
    with begin(folder, file.name, temporary) as process:
        wait_until(lambda: blocks_of(file) >= enough, f"run {number} begins")
        members = family(process, file)
        assert set(members) - {"loader"} == {"main", "recorder", "source"}
        assert ("loader" in members) == (sys.platform == "linux")
        before = blocks_of(file)
        for pid in members.values() if victim == "all" else [members[victim]]:
            # of all, those that come last may have ended by themselves: the others were needed
            with contextlib.suppress(*([ProcessLookupError] if victim == "all" else [])):
                os.kill(pid, signal.SIGKILL)
        if victim == "loader":  # nobody needs it any more
            wait_until(lambda: blocks_of(file) >= before + 3, f"run {number} goes on without the {victim}")
            process.send_signal(signal.SIGTERM)
        error = process.communicate(timeout=SECONDS)[1]
        wait_until(lambda: all(state_of(pid) == "Z" for pid in members.values()), f"run {number}: {victim} killed")
    ended = {"recorder": 1, "source": 1, "loader": 0}
    assert process.returncode == ended.get(victim, -signal.SIGKILL), error
    blocks = list(read_blocks(file))
    assert len(blocks) >= before >= enough
    assert all(samples is not None for _, samples in blocks)
    ticks = np.cumsum([0, *(len(samples) for _, samples in blocks)])[:-1]
    assert [tick - blocks[0][0] for tick, _ in blocks] == ticks.tolist()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main(["info", str(file)]) == 0
    return before


def kill_in_turn(rng, folder, count):
    killed = dict.fromkeys(VICTIMS, 0)
    for number in range(count):
        victim = VICTIMS[number % len(VICTIMS)]
        kill(folder, victim, number, int(rng.integers(1, 12)))
        killed[victim] += 1
        print(number, victim, flush=True)  # noqa: T201 - shown with -s
    # a start removes what is left of those of whom nobody was left
    with begin(folder, "last.h5", folder / "tmp") as process:
        wait_until(lambda: blocks_of(folder / "last.h5") >= 1, "the last one begins")
        assert len(list((folder / "tmp").glob("aerobalance-*"))) == 1
        process.send_signal(signal.SIGTERM)
        assert process.wait(SECONDS) == 0
    assert not list((folder / "tmp").glob("aerobalance-*"))
    assert not list(folder.glob(".*"))  # nor second names of files
    print(f"killed {killed}: every block was in its file")  # noqa: T201 - shown with -s


def test_each_is_killed_once(tmp_path, rng) -> None:
    kill_in_turn(rng, tmp_path, len(VICTIMS))


@pytest.mark.long
def test_fifty_kills(tmp_path, rng) -> None:
    kill_in_turn(rng, tmp_path, 50)
