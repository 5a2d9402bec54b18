"""openDAQ: a real server over the loopback is read without loss, killed, started again, and its gap known exactly."""

import os
import signal
import socket
import time
import warnings
from contextlib import contextmanager
from fractions import Fraction
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest

from aerobalance.acquisition import library_process
from aerobalance.acquisition.library_process import LibraryProcess
from aerobalance.acquisition.opendaq import DomainClock, OpendaqSource, origin_of
from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import parse_setup
from aerobalance.app.commands import recordings
from aerobalance.io import read
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import read_blocks
from aerobalance.recording.errors import DataQualityWarning, FitError
from helpers.at_work import children, end_by_sigterm, follow, gone, library_of, lost_by_a_kill
from helpers.devices import RIG, Server, free_port
from helpers.worker import crash

installed = pytest.mark.skipif(
    find_spec("opendaq") is None,
    reason="the extra opendaq is not installed",
)

# A device of twelve channels at 25 kHz that count their own samples; it says which instant its first sample has, in
# sampling intervals since 1970.
SERVER = """
import sys, time
import numpy as np
from aerobalance.acquisition.opendaq_server import PublishedDevice
from aerobalance.acquisition.source import Pacing
from aerobalance.acquisition.source import Block, SourceChannel

class Counter:
    rate = float(sys.argv[2])
    channels = tuple(SourceChannel(f"c{i}", "V") for i in range(12))

import opendaq
sys.stdin.readline()
device, pacing, rows, tick = PublishedDevice(Counter(), port=int(sys.argv[1])), Pacing(Counter.rate, 1.0), 500, 0
pacing.start()
while True:
    pacing.wait(tick, rows, 1.0)
    counts = np.arange(tick, tick + rows, dtype=float)[:, np.newaxis]
    device.give(Block(tick, counts + 1e9 * np.arange(12), 0.0))
    if tick == 0:
        print(device.first, flush=True)
    tick += rows
"""


def setup_of(address, *, channels=()):
    text = f'[source]\nkind = "opendaq"\naddress = "{address}"\n[record]\nkeep_free = 0.0\nblock = 0.05\n'
    return parse_setup(text + "".join(f"[channels.{name}]\n" for name in channels))


@contextmanager
def recording_of(port, file, *, channels=()):
    """Session and recorder of a server that listens, at work until the block ends."""
    with Session(setup_of(f"daq.nd://127.0.0.1:{port}", channels=channels), file.parent) as session:
        recorder = session.record(file)
        recorder.ready()
        session.start()
        yield session, recorder


def checked_gaps(file, progress, ticks):
    """Text of a record's first gap; the samples of all its gaps are those that no block holds."""
    # on a busy machine the signals may be read anew once more, after the first samples: another gap, as exact
    gap, *more = contents(file).gaps
    missing = gap["samples"] + sum(other["samples"] for other in more)
    assert missing == progress.lost == ticks[-1] + 1 - ticks[0] - len(ticks)
    return gap["text"]


def take(source, wanted):
    """The first block that is wanted."""
    limit = time.monotonic() + 120
    while True:
        block = source.read(0.1)
        if block is not None and wanted(block):
            return block
        assert time.monotonic() < limit


def ended(recorder):
    """Wait for a record to end by itself."""
    limit = time.monotonic() + 120
    while not recorder.poll(0.1).over:
        assert time.monotonic() < limit


def checked_ticks(file, *servers):
    """Ticks of a record's samples, each held against what the device counted; the lives of its server part at gaps."""
    found = np.concatenate([samples for _, samples in read_blocks(file)])
    ticks = np.concatenate([np.arange(tick, tick + len(samples)) for tick, samples in read_blocks(file)])
    # all twelve channels are of the same sample
    assert np.array_equal(found - 1e9 * np.arange(12), np.repeat(found[:, :1], 12, axis=1))
    # what a sample counts says when it was taken, by the clock that all lives of the server share
    life = np.minimum(np.concatenate([[0], np.cumsum(np.diff(ticks) > 1)]), len(servers) - 1)
    instants = found[:, 0] + np.array([int(server.first) for server in servers])[life]
    assert np.array_equal(instants - instants[0], ticks - ticks[0])
    return ticks


@installed
def test_server_that_is_killed_and_started_again_leaves_a_gap_of_its_exact_length(tmp_path) -> None:
    port, file = free_port(), tmp_path / "run.h5"
    with Server(SERVER, port, 25_000) as server, Server(SERVER, port, 25_000) as again:
        server.listen()
        with recording_of(port, file) as (_, recorder):
            before = follow(recorder, lambda progress: progress.seconds > 1.5)
            assert before.gaps == 0
            server.kill()
            again.listen()
            follow(recorder, lambda progress: progress.gaps and progress.samples > before.samples + 40_000)
            progress = recorder.stop("enough")
    assert progress.reason == "enough"
    ticks = checked_ticks(file, server, again)
    assert b"lost and made again" in checked_gaps(file, progress, ticks)


@installed
def test_device_that_comes_back_at_another_rate_ends_the_record_and_says_so(tmp_path) -> None:
    port = free_port()
    with Server(SERVER, port, 25_000) as server, Server(SERVER, port, 20_000) as again:
        server.listen()
        with recording_of(port, tmp_path / "run.h5") as (_, recorder):
            follow(recorder, lambda progress: progress.blocks > 3)
            server.kill()
            again.listen()
            ended(recorder)
    assert "samples at 20000 Hz instead of 25000 Hz" in recorder.progress.reason
    assert all(samples is not None for _, samples in read_blocks(tmp_path / "run.h5"))


@installed
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGABRT])
@pytest.mark.soak(first=1)
def test_library_that_crashes_is_started_again_and_the_gap_has_its_exact_length(how, tmp_path) -> None:
    port, file = free_port(), tmp_path / "run.h5"
    with Server(SERVER, port, 25_000) as server:
        server.listen()
        with recording_of(port, file) as (session, recorder):
            before = follow(recorder, lambda progress: progress.seconds > 1.5)
            library = library_of(session)
            os.kill(library, how)
            follow(recorder, lambda progress: progress.gaps and progress.samples > before.samples + 40_000)
            second = library_of(session)
            progress = recorder.stop("enough")
        assert gone(second)
    assert second != library
    assert progress.reason == "enough"
    ticks = checked_ticks(file, server)
    assert f"the library of the device crashed ({how.name}); it was started again".encode() in checked_gaps(
        file, progress, ticks
    )


@installed
def test_library_that_hangs_is_started_again_and_the_gap_has_its_exact_length(monkeypatch) -> None:
    monkeypatch.setattr(library_process, "SILENT", 2.0)
    port = free_port()
    with Server(SERVER, port, 25_000) as server:
        server.listen()
        others = children(os.getpid())
        source = LibraryProcess(partial(OpendaqSource, f"daq.nd://127.0.0.1:{port}"))
        try:
            (library,) = set(children(os.getpid())) - set(others)
            source.start()
            before = take(source, lambda block: block.samples.size)
            os.kill(library, signal.SIGSTOP)
            after = take(source, lambda block: block.remark)
        finally:
            source.stop()
    assert after.remark == "the library of the device did not answer for 2 s; it was started again"
    # the device counts its samples itself; what was on its way when the library hung has come
    assert after.samples[0, 0] - before.samples[0, 0] == after.tick - before.tick > 2 * 25_000


@installed
def test_library_that_crashes_while_the_device_is_away_waits_for_it_and_knows_its_rate(tmp_path) -> None:
    port = free_port()
    with Server(SERVER, port, 25_000) as server, Server(SERVER, port, 20_000) as again:
        server.listen()
        with recording_of(port, tmp_path / "run.h5") as (session, recorder):
            follow(recorder, lambda progress: progress.blocks > 3)
            server.kill()
            library = library_of(session)
            os.kill(library, signal.SIGABRT)
            library_of(session, other_than=library)
            again.listen()
            ended(recorder)
    assert "samples at 20000 Hz instead of 25000 Hz" in recorder.progress.reason


@installed
def test_library_that_crashes_again_and_again_ends_the_record_and_says_so(tmp_path) -> None:
    port, library = free_port(), 0
    with Server(SERVER, port, 25_000) as server:
        server.listen()
        with recording_of(port, tmp_path / "run.h5") as (session, recorder):
            follow(recorder, lambda progress: progress.blocks > 3)
            server.kill()
            for _ in range(3):
                library = library_of(session, other_than=library)
                os.kill(library, signal.SIGABRT)
            ended(recorder)
            assert gone(library)
    assert "crashed 3 times without a sample between, at last with SIGABRT" in recorder.progress.reason
    assert all(samples is not None for _, samples in read_blocks(tmp_path / "run.h5"))


def test_library_that_crashes_as_the_device_is_opened_is_said_so() -> None:
    with pytest.raises(FitError, match=r"crashed \(SIGABRT\) as the device was opened; try again"):
        LibraryProcess(crash)


@installed
def test_record_across_a_restart_gives_info_and_force(tmp_path) -> None:
    from aerobalance.estimation.force import estimate_force
    from aerobalance.simulation.published import CABLE_CUT

    port, file = free_port(), tmp_path / "run.h5"
    (tmp_path / "rig.toml").write_text(
        '[source]\nkind = "simulated"\nrig = "cable_cut"\nrate = 250.0\nseed = 7\n', encoding="utf-8"
    )
    rigs = [Server(RIG, port, tmp_path / "rig.toml") for _ in range(2)]
    with rigs[0] as server, rigs[1] as again:
        server.listen()
        with recording_of(port, file, channels=("AF",)) as (_, recorder):
            follow(recorder, lambda progress: progress.samples > 600)
            server.kill()
            again.listen()
            assert f"on port {port} of all addresses" in again.first
            follow(recorder, lambda progress: progress.gaps and progress.samples > 1250)
            progress = recorder.stop("enough")
        again.process.terminate()
        out, err = again.process.communicate(timeout=60)
        assert (again.process.returncode, out, err) == (0, "stopped\n", "")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        account = recordings.info(file)
        assert account["gaps"]
        assert account["channels"]["AF"]["unit"] == "N"
        recording = read(file)
        given = estimate_force(recording, CABLE_CUT.dynamics).only.values
    there = np.isfinite(recording.channel("AF").values)
    assert np.count_nonzero(~there) == progress.lost > 0
    after = np.flatnonzero(~there)[-1]
    # the cable hangs in both lives of the rig: 10 N of noise over 400 readings and more is 0.5 N
    for part in (given[100:500], given[after + 100 : -100]):
        assert part.mean() == pytest.approx(-1020.0, abs=2.5)


@installed
def test_reference_device_of_the_library_is_read_by_name(tmp_path) -> None:
    source = OpendaqSource("daqref://device0", names=["AI1", "RefCh0/Sig/AI0"])
    assert [(channel.name, channel.unit) for channel in source.channels] == [("AI1", "V"), ("RefCh0/Sig/AI0", "V")]
    source.start()
    begin, end = time.monotonic(), None
    while time.monotonic() < begin + 1.0:
        block = source.read(0.1)
        if block is not None:
            assert end is None or block.tick == end
            assert block.remark == ""
            end = block.end
    source.stop()
    # begun and ended within its blocks of 20 ms and 0.1 s of start
    assert end == pytest.approx(source.rate, abs=0.3 * source.rate)
    with pytest.raises(FitError, match=r"no signal 'AI7' .* it has AI0, AI1"):
        OpendaqSource("daqref://device0", names=["AI7"])


@installed
def test_device_that_is_not_there_is_said_so() -> None:
    with pytest.raises(FitError, match=r"no openDAQ device answers at .*:1; check"):
        OpendaqSource("daq.nd://127.0.0.1:1")


@installed
def test_port_that_is_taken_is_said_so(tmp_path) -> None:
    from aerobalance.acquisition.opendaq_server import PublishedDevice
    from aerobalance.acquisition.simulated import RigSettings, SimulatedSource

    with socket.create_server(("", 0)) as taken, pytest.raises(FitError, match="cannot listen on port"):
        PublishedDevice(SimulatedSource(RigSettings()), port=taken.getsockname()[1])
    with pytest.raises(FitError, match=r"whole number of samples a second, not 1599\.98"):
        PublishedDevice(SimulatedSource(RigSettings(rate=1599.98)), port=free_port())


@installed
def test_sigterm_ends_the_record_of_a_device(tmp_path) -> None:
    end_by_sigterm(tmp_path, '[source]\nkind = "opendaq"\naddress = "daqref://device0"\n')


@installed
@pytest.mark.parametrize("victim", ["recorder", "source"])
def test_kill_loses_nothing_acknowledged(victim, tmp_path) -> None:
    with Session(setup_of("daqref://device0"), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks > 5)
        library = library_of(session)
        progress = lost_by_a_kill(session, recorder, victim)
        # the library of a source that was killed ends with it; that of a killed recorder goes on
        assert gone(library, 60.0 if victim == "source" else 0.0) == (victim == "source")
    assert gone(library)
    stored = [samples for _, samples in read_blocks(tmp_path / "run.h5")]
    assert all(samples is not None for samples in stored)
    assert sum(len(samples) for samples in stored) >= progress.samples


def test_instants_become_numbers_of_samples_exactly() -> None:
    # nanoseconds since 1970: floats of that size are 256 ns apart
    clock = DomainClock(Fraction(25_000), Fraction(1, 10**9))
    assert clock.step == 40_000
    day = 1_795_279_269_317_923_000
    assert clock.number(day) == (0, "")
    assert clock.number(day + 40_000 * 10**9) == (10**9, "")
    # a device that begins a third of an interval later
    number, odd = clock.number(day + 40_000 * (10**9 + 500) + 13_333)
    assert number == 10**9 + 500
    assert "+0.33 of a sampling interval" in odd
    assert clock.number(day + 40_000 * (10**9 + 600) + 13_333) == (10**9 + 600, "")
    # a device that counts from when it was switched on, 2.5 s after it was the last time
    clock = DomainClock(Fraction(1000), Fraction(1, 1000), origin_of("2026-01-01T00:00:00Z"))
    assert clock.number(5000) == (0, "")
    clock.origin = origin_of("2026-01-01T00:00:02.500000000Z")
    assert clock.number(2600) == (100, "")
    with pytest.raises(FitError, match=r"1\.5 ticks a sample"):
        DomainClock(Fraction(1000), Fraction(1, 1500)).step  # noqa: B018 - refused when it is asked for


def test_origins_that_are_no_date_count_as_none() -> None:
    assert origin_of("") == origin_of("since the device was switched on") == 0
    assert origin_of("1970-01-02T00:00:00.25Z") == Fraction(86400) + Fraction(1, 4)
    assert origin_of("1970-01-01T01:00:00+01:00") == origin_of("1970-01-01") == 0
