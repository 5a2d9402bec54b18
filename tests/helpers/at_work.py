"""Records that are made while a test watches."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

from aerobalance.io import read
from aerobalance.io.hdf5_contents import contents
from aerobalance.recording.errors import ReadError


def follow(recorder, enough, seconds=120.0):
    """Wait for a record to come so far; return how it stands."""
    limit = time.monotonic() + seconds
    while not enough(recorder.poll(0.05)):
        assert time.monotonic() < limit, recorder.progress
        assert not recorder.progress.over, recorder.progress
    return recorder.progress


def children(process):
    """The processes that a process has started and that live, by their numbers."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = status.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[:2]
        except OSError:  # gone since
            continue
        if int(parent) == process and state != "Z":
            found.append(int(status.parent.name))
    return found


def library_of(session, seconds=60.0, *, other_than=0):
    """Wait for the process of the library beneath a source; return its number."""
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        found = [number for number in children(session.process.pid) if number != other_than]
        if found:
            (number,) = found
            return number
        time.sleep(0.01)
    raise AssertionError("no process of a library")


def gone(number, seconds=60.0):
    """Whether a process ends in time."""
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        try:
            if Path(f"/proc/{number}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


def blocks_of(file):
    """Count the blocks of a file that is written to; none where it is only just being made."""
    try:
        return len(contents(file).blocks)
    except ReadError:
        return 0


def end_by_sigterm(folder, setup):
    """Run the command record with a set-up, and end it by SIGTERM: at once, cleanly, and with a whole file."""
    (folder / "test.toml").write_text(setup, encoding="utf-8")
    command = [sys.executable, "-m", "aerobalance.app.cli", "record", "--setup", "test.toml", "-o", "run.h5", "--json"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    limit = time.monotonic() + 60
    while blocks_of(folder / "run.h5") < 3:
        assert time.monotonic() < limit
        assert process.poll() is None, process.communicate()
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)  # it takes 2 s; a busy machine is allowed more
    assert process.returncode == 0, err
    assert json.loads(out)["samples"] == read(folder / "run.h5").samples


def lost_by_a_kill(session, recorder, victim):
    """Kill the recorder or the source of a running record; return how it stood when that was noticed."""
    process = recorder.process if victim == "recorder" else session.process
    process.kill()
    limit = time.monotonic() + 60
    while not recorder.poll(0.1).over:
        assert time.monotonic() < limit, f"the loss of the {victim} was not noticed"
    assert "gone without a word" in recorder.progress.reason
    return recorder.progress
