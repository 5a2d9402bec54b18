"""A folder of results is worked on by one call at a time, and one that was killed does not stand in the way."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time

import fsspec
import pytest

from aerobalance.app.campaign import holding
from aerobalance.app.campaign.campaign import reduce_runs
from aerobalance.app.campaign.engine import Engine
from aerobalance.app.campaign.holding import LOCK, held
from aerobalance.app.campaign.results import Results
from aerobalance.io.dynamics_file import write_dynamics
from helpers.axial_runs import spring


def test_a_second_call_is_told_who_works_there_and_since_when(tmp_path):
    runs = tmp_path / "runs"
    runs.mkdir()
    (runs / "run_1.h5").write_bytes(b"")
    dynamics = tmp_path / "dynamics.json"
    write_dynamics(dynamics, {"AF": spring()})
    who = rf"process {os.getpid()} on {re.escape(socket.gethostname())}, since 20\d\d-\d\d-\d\d \d\d:\d\d:\d\d"
    with Results(str(tmp_path / "out")).held():
        with pytest.raises(ValueError, match=rf"out is in use: another call \({who}\) works on it\. Wait until"):
            reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=Engine(workers=0))
        assert not (tmp_path / "out" / "runs" / "run_1.json").exists()
    assert reduce_runs(runs, tmp_path / "out", dynamics=dynamics, engine=Engine(workers=0)).aside.keys() == {"run_1"}


def test_what_goes_wrong_meanwhile_is_told_as_it_is_and_lets_go(tmp_path):
    with pytest.raises(OSError, match="the disk is full"), held(str(tmp_path)):
        raise OSError("the disk is full")
    with held(str(tmp_path)):
        pass
    with pytest.raises(ValueError, match=r"cannot write .*none"), held(str(tmp_path / "none")):
        pass


def test_a_killed_call_holds_nothing(tmp_path):
    code = f"""
import time
from aerobalance.app.campaign.holding import held
with held({str(tmp_path)!r}):
    time.sleep(600)
"""
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        limit = time.monotonic() + 60
        while not (tmp_path / LOCK).exists() or not (tmp_path / LOCK).read_bytes():
            assert process.poll() is None
            assert time.monotonic() < limit
            time.sleep(0.02)
        with pytest.raises(ValueError, match=f"process {process.pid} on"), held(str(tmp_path)):
            pass
        process.send_signal(signal.SIGKILL)
        process.wait()
    with held(str(tmp_path)):
        assert json.loads((tmp_path / LOCK).read_bytes())["process"] == os.getpid()


@pytest.fixture(params=["memory", "file"])
def store(request, tmp_path) -> str:
    """The address of a store, where nothing is locked."""
    return "memory://held" if request.param == "memory" else f"file://{tmp_path}"


def test_in_a_store_who_goes_on_saying_so_holds_it_and_who_is_silent_does_not(store, monkeypatch):
    monkeypatch.setattr(holding, "BEAT", 0.2)
    system, inside = fsspec.core.url_to_fs(f"{store}/{LOCK}")
    refused = pytest.raises(ValueError, match=rf"is in use: another call \(process {os.getpid()} on")
    with held(store), refused, held(store):
        pass
    assert not system.exists(inside)
    system.pipe_file(inside, b'{"process": 1, "host": "gone", "since": "long ago"}')
    begun = time.monotonic()
    with held(store):
        assert json.loads(system.cat_file(inside))["process"] == os.getpid()
    assert time.monotonic() - begun > holding.SILENCE * holding.BEAT  # not before it is known to be silent
