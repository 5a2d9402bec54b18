"""The program of the page in a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

PROGRAM = """
{first}
from pathlib import Path
from aerobalance.app.monitor.command import Reach, monitor
monitor(folder=Path({folder!r}), reach=Reach(port=0), browser=False, last=True,
        say=lambda text: print(text, flush=True))
"""


def children(pid):
    """Processes that a process has started, and those that they have."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError, IndexError):
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(fields[1]) == pid and fields[0] != "Z":
                    found += [int(entry.name), *children(int(entry.name))]
    return found


class Program:
    """A page in a process of its own."""

    def __init__(self, folder, *, wait=True, first=""):
        code = PROGRAM.format(folder=str(folder), first=first)
        self.folder = folder
        self.process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.base = line.split()[4].rstrip("/;")
        self.known = []
        self._estimates = wait

    def __enter__(self):
        ready = (lambda state: state["numbers"].get("estimates")) if self._estimates else (lambda state: True)
        self.wait(lambda state: state["source"]["state"] == "running" and ready(state))
        self.known = children(self.process.pid)
        return self

    def __exit__(self, *_):
        for pid in {*self.known, *children(self.process.pid)}:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def state(self):
        with urllib.request.urlopen(f"{self.base}/api/state", timeout=60) as answer:
            return json.load(answer)

    def wait(self, holds, timeout=120.0):
        limit = time.monotonic() + timeout
        while time.monotonic() < limit:
            state = self.state()
            if holds(state):
                return state
            time.sleep(0.05)
        raise AssertionError(f"not within {timeout} s: {state}")

    def post(self, action, **body):
        headers = {"origin": self.base, "content-type": "application/json"}
        request = urllib.request.Request(f"{self.base}/api/{action}", json.dumps(body).encode(), headers)
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)

    def refused(self, action, **body):
        with pytest.raises(urllib.error.HTTPError) as caught:
            self.post(action, **body)
        return json.load(caught.value)["error"]

    def record(self, name):
        self.post("record", name=name)
        self.wait(lambda state: state["record"].get("blocks", 0) >= 3)
        self.known = children(self.process.pid)
        return self.folder / f"{name}.h5"


def alive(pid):
    with contextlib.suppress(OSError, IndexError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def gone(pids):
    limit = time.monotonic() + 60
    while time.monotonic() < limit and any(alive(pid) for pid in pids):
        time.sleep(0.05)
    return [pid for pid in pids if alive(pid)]
