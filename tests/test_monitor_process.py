"""The page as a program of its own: it ends at once when told to, and what is killed leaves whole files."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import time
import warnings
from pathlib import Path

import pytest
import websockets

from aerobalance.io import read
from aerobalance.io.hdf5_contents import contents
from aerobalance.recording.errors import DataQualityWarning
from helpers.monitor_program import Program, children, gone

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="children are found in /proc")


@pytest.fixture
def program(tmp_path):
    with Program(tmp_path) as running:
        yield running


def test_told_to_end_with_viewers_and_a_record(program) -> None:
    file = program.record("one")
    known = program.known
    assert len(known) >= 3  # source, recorder, engine, and what else there is

    async def watched():
        live = program.base.replace("http", "ws") + "/live"
        async with (
            websockets.connect(live, origin=program.base) as one,
            websockets.connect(live, origin=program.base) as other,
        ):
            for _ in range(5):
                await one.recv()
            await other.recv()
            program.process.send_signal(signal.SIGTERM)
            return await asyncio.to_thread(program.process.wait, 60)

    # how long it takes is measured in tests/benchmarks
    assert asyncio.run(watched()) == 0
    assert gone(known) == []
    kept = contents(file)
    assert (kept.state, kept.reason) == ("ended", "the page was ended")
    assert read(file).samples > 0


def test_killed_without_a_word(program) -> None:
    file = program.record("one")
    known = program.known
    blocks = program.state()["record"]["blocks"]
    program.process.kill()
    program.process.wait()
    # source and recorder see that they are alone, close the file and end
    assert gone(known) == []
    kept = contents(file)
    assert kept.state == "ended"
    # the recorder finds it out itself, or hears it from the source, which has found it out first
    assert "the program that started the record is gone" in kept.reason or "started the source is gone" in kept.reason
    assert kept.blocks.size >= blocks
    assert not read(file).gaps


def test_told_to_end_while_it_starts(tmp_path) -> None:
    program = Program(tmp_path)
    try:
        time.sleep(0.3)
        known = children(program.process.pid)
        program.process.send_signal(signal.SIGTERM)
        assert program.process.wait(60) == 0
        assert gone(known) == []
    finally:
        program.__exit__()


def test_rubbish_at_the_socket(program, seed) -> None:
    rng = random.Random(seed)
    port = int(program.base.rpartition(":")[2])
    host = f"Host: 127.0.0.1:{port}\r\nOrigin: {program.base}\r\n".encode()
    upgrade = b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
    heads = (
        b"",
        b"GET / HTTP/1.1\r\n" + host,
        b"POST /api/mark HTTP/1.1\r\n" + host + b"Content-Length: 99999999999\r\n\r\n",
        b"GET /live HTTP/1.1\r\n" + host + upgrade + b"AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
    )
    left = contextlib.ExitStack()
    for number in range(80):
        connection = socket.create_connection(("127.0.0.1", port), timeout=5)
        with contextlib.suppress(OSError):
            connection.sendall(heads[number % 4] + rng.randbytes(rng.randint(1, 5000)))
        if number % 7:
            connection.close()
        else:
            left.enter_context(connection)
    assert program.state()["source"]["state"] == "running"
    program.post("mark", text="still here")

    async def too_much():
        live = program.base.replace("http", "ws") + "/live"
        while True:
            with contextlib.suppress(websockets.InvalidStatus):  # those before are still being closed
                async with websockets.connect(live, origin=program.base) as viewer:
                    await viewer.send("x" * 200_000)
                    with pytest.raises(websockets.ConnectionClosedError):
                        while True:
                            await asyncio.wait_for(viewer.recv(), 10)
                    return
            await asyncio.sleep(0.2)

    with left:
        asyncio.run(asyncio.wait_for(too_much(), 60))
        assert program.state()["numbers"]["readings"]


@contextlib.contextmanager
def small_disk(folder, size):
    folder.mkdir()
    mount = shutil.which("mount")
    if os.geteuid() != 0 or mount is None:
        pytest.skip("a small file system can only be mounted by root")
    if subprocess.run([mount, "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=False).returncode:
        pytest.skip("mounting is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def test_full_disk_ends_the_record_and_nothing_else(tmp_path, seed) -> None:
    with small_disk(tmp_path / "small", "5m") as small, Program(small) as program:
        # 4 channels of 8 bytes at 50 kHz: 1.6 MB a second
        source = {"kind": "simulated", "rig": "cable_cut", "rate": 50_000.0, "seed": seed}
        setup = {"source": source, "record": {"keep_free": 1.0, "block": 0.1}}
        program.post("setup", setup=setup)
        program.wait(lambda state: state["source"]["state"] == "running" and state["numbers"].get("readings"))
        program.post("record", name="full")
        state = program.wait(lambda state: state["record"]["state"] == "ended")
        record = state["record"]
        assert record["full"] and "disk full" in record["reason"] and "all blocks before are kept" in record["reason"]
        assert any(
            item["kind"] == "error" and "full.h5 ended: disk full" in item["text"] for item in state["messages"]
        )
        kept = contents(small / "full.h5")
        assert (kept.state, kept.reason) == ("ended", record["reason"])
        assert read(small / "full.h5").samples == record["samples"] > 0
        # the page and the source go on, and say what a full disk refuses
        assert state["source"]["state"] == "running"
        tick = program.wait(lambda state: state["numbers"].get("readings"))["numbers"]["readings"]["AF"]["mean"]
        program.wait(lambda state: state["numbers"]["readings"]["AF"]["mean"] != tick)
        assert "the record needs" in program.refused("record", name="more")
        with contextlib.suppress(OSError), (small / "rest").open("wb", buffering=0) as rest:
            while rest.write(bytes(4096)):
                pass
        assert "No space left" in program.refused("setup", setup=setup, name="mine")
        assert not (small / "mine.toml").exists()
        (small / "rest").unlink()
        (small / "full.h5").unlink()
        # room for longer than a busy machine takes to stop it: the record must not end by itself once more
        subprocess.run([shutil.which("mount") or "mount", "-o", "remount,size=512m", small], check=True)
        program.record("again")
        program.post("stop")
        assert read(small / "again.h5").samples > 0


def test_quota_ends_the_record_and_nothing_else(tmp_path) -> None:
    with Program(tmp_path) as program:
        file = program.record("one")
        # as a quota does: the disk has room, and the write is refused
        resource.prlimit(program.state()["processes"]["recorder"], resource.RLIMIT_FSIZE, (200_000, 200_000))
        record = program.wait(lambda state: state["record"]["state"] == "ended")["record"]
        assert record["full"] and record["reason"].startswith("disk full: the disk, its quota")
        assert read(file).samples == record["samples"] > 0
        assert contents(file).reason == record["reason"]
        program.record("two")
        program.post("stop")
        assert program.state()["source"]["state"] == "running"


@pytest.mark.long
def test_killed_at_random_moments(tmp_path, seed) -> None:
    rng = random.Random(seed)
    for round_ in range(5):
        folder = tmp_path / str(round_)
        folder.mkdir()
        with Program(folder) as program:
            for trial in range(5):
                victim = rng.choice(("recorder", "source", "engine")) if trial < 4 else "page"
                if program.state()["source"]["state"] != "running":
                    program.post("restart")
                    program.wait(lambda state: state["source"]["state"] == "running")
                program.post("record", name=f"run-{trial}")
                time.sleep(rng.uniform(0.05, 1.5))
                file, blocks = folder / f"run-{trial}.h5", program.state()["record"]["blocks"]
                if victim == "page":
                    program.known = children(program.process.pid)
                    program.process.kill()
                    program.process.wait()
                    assert gone(program.known) == [], (round_, trial)
                else:
                    os.kill(program.state()["processes"][victim], signal.SIGKILL)
                    if victim == "engine":
                        program.wait(lambda state: any("started again" in item["text"] for item in state["messages"]))
                        time.sleep(0.5)
                        program.post("stop")
                    program.wait(lambda state: state["record"]["state"] == "ended")
                kept = contents(file)
                assert kept.blocks.size >= blocks, (round_, trial, victim)
                if blocks:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore", DataQualityWarning)  # of a record that was broken off
                        assert read(file).samples > 0
