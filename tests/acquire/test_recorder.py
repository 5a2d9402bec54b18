"""The recorder: what it acknowledges is on the disk, whoever is killed and however full the disk is."""

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import warnings
import zlib
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from aerobalance.acquisition import recorder as recorder_module
from aerobalance.acquisition.feed import Address
from aerobalance.acquisition.intake import OnCall, RecordPlan
from aerobalance.acquisition.recorder import RecorderCommand, RecordJob, RecordWriter
from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import parse_setup
from aerobalance.acquisition.simulated import RigSettings, SimulatedSource
from aerobalance.acquisition.source import Block
from aerobalance.app.commands import recordings
from aerobalance.io import read, write_recording
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import read_blocks
from aerobalance.io.hdf5_layout import Provenance, StoredChannel
from aerobalance.recording.errors import DataQualityWarning, FitError
from helpers.monitor_program import children
from seeds import trials

CHANNELS = (StoredChannel("AF", "N"), StoredChannel("NF", "N"))


def truth(first, last):
    ticks = np.arange(first, last)
    return np.column_stack([np.sin(ticks * 0.1), np.cos(ticks * 0.037)])


def job(path, **settings):
    plan = {"channels": CHANNELS, "rate": 1000.0, "rows": 64} | settings
    return RecordJob(
        str(path), RecordPlan(**plan), clocked=False, provenance=Provenance("test", 'name = "x"\n'), keep_free=0
    )


def quietly(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return read(path)


def stored(path):
    """All samples of a file by tick; every block agrees with its checksum."""
    found = {}
    for tick, samples in read_blocks(path):
        assert samples is not None
        found.update(zip(range(tick, tick + len(samples)), samples, strict=True))
    return found


def test_what_the_source_gave_is_in_the_file_to_the_last_bit(tmp_path, rng) -> None:
    take = RecordWriter(job(tmp_path / "run.h5"))
    given, tick = {}, 5_000_000_000
    for _ in range(60):
        tick += int(rng.integers(0, 3) == 0) * int(rng.integers(1, 40))
        samples = rng.normal(size=(int(rng.integers(1, 200)), 2))
        take.feed(Block(tick, samples, 0.0))
        given.update(zip(range(tick, tick + len(samples)), samples, strict=True))
        tick += len(samples)
    take.end("done")
    found = stored(tmp_path / "run.h5")
    assert list(found) == list(given)
    assert all(found[tick].tobytes() == given[tick].tobytes() for tick in given)
    said = contents(tmp_path / "run.h5")
    assert (said.state, said.reason) == ("ended", "done")
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["setup"][...].tobytes() == b'name = "x"\n'
    gaps = {tick for gap in said.gaps for tick in range(gap["tick"], gap["tick"] + gap["samples"])}
    assert gaps == set(range(min(given), max(given))) - set(given)
    # the checksum as the layout describes it, worked out without the library
    head = int(said.blocks[0]["tick"]).to_bytes(8, "little") + int(said.blocks[0]["rows"]).to_bytes(8, "little")
    first = np.array([given[min(given) + i] for i in range(said.blocks[0]["rows"])])
    assert zlib.crc32(head + first.tobytes()) == said.blocks[0]["crc32"]


def test_every_acknowledged_block_can_be_read_while_it_is_recorded(tmp_path) -> None:
    file = tmp_path / "run.h5"
    take = RecordWriter(job(file))
    for number in range(5):
        take.feed(Block(number * 100, truth(number * 100, number * 100 + 100), 0.0))
        assert len(stored(file)) == take.progress.samples == (number + 1) * 100 // 64 * 64
    with pytest.warns(DataQualityWarning, match="not ended"):
        assert read(file).samples == take.progress.samples
    take.end("done")
    assert read(file).samples == 500


def test_pre_trigger_puts_time_zero_at_the_trigger(tmp_path) -> None:
    take = RecordWriter(job(tmp_path / "run.h5", trigger=OnCall(), before=150))
    for number in range(4):
        take.feed(Block(number * 100, truth(number * 100, number * 100 + 100), 0.0))
    assert take.progress.state == "waiting"
    take.intake.call("button")
    take.feed(Block(400, truth(400, 500), 0.0))
    take.note("note", "vibration heard")
    take.end("done")
    recording = read(tmp_path / "run.h5")
    assert recording.start == pytest.approx(-0.15)
    assert recording.channel("AF").values == pytest.approx(truth(250, 500)[:, 0], abs=0)
    assert take.progress.events == 2


def test_note_that_comes_after_the_last_sample_leaves_the_record_as_it_is(tmp_path) -> None:
    take = RecordWriter(job(tmp_path / "run.h5", length=100))
    take.feed(Block(0, truth(0, 200), 0.0))
    ended, content = take.progress, (tmp_path / "run.h5").read_bytes()
    assert ended.state == "ended"
    take.note("note", "pressed in the last instant")
    assert take.progress == ended
    assert (tmp_path / "run.h5").read_bytes() == content


def test_disk_is_watched_and_what_fits_is_kept(tmp_path, monkeypatch) -> None:
    take = RecordWriter(job(tmp_path / "run.h5"))
    take.feed(Block(0, truth(0, 128), 0.0))
    monkeypatch.setattr(recorder_module.shutil, "disk_usage", lambda _: SimpleNamespace(free=2000))
    take.feed(Block(128, truth(128, 256), 0.0))
    assert take.progress.over
    assert take.progress.full
    assert take.progress.reason.startswith("disk full: 0.0 MB left")
    assert len(stored(tmp_path / "run.h5")) == 128
    assert contents(tmp_path / "run.h5").reason == take.progress.reason
    read(tmp_path / "run.h5")


def test_space_that_the_system_does_not_tell_is_no_full_disk(tmp_path, monkeypatch) -> None:
    take = RecordWriter(job(tmp_path / "run.h5"))
    known = take.progress.free

    def unanswered(_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(recorder_module.shutil, "disk_usage", unanswered)
        take.feed(Block(0, truth(0, 128), 0.0))
    assert not take.progress.over, take.progress.reason
    assert (take.progress.full, take.progress.free) == (False, known)
    take.feed(Block(128, truth(128, 256), 0.0))
    take.end("done")
    assert (take.progress.reason, take.progress.samples) == ("done", 256)
    assert len(stored(tmp_path / "run.h5")) == 256


def test_a_record_begins_where_the_system_does_not_tell_the_space(tmp_path, monkeypatch) -> None:
    def unanswered(_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with Session(setup_of(), tmp_path) as session:
        monkeypatch.setattr(recorder_module.shutil, "disk_usage", unanswered)
        recorder = session.record(tmp_path / "run.h5")
        monkeypatch.undo()
        recorder.ready()
        session.start()
        time.sleep(0.1)
        assert recorder.stop("enough").reason == "enough"
    assert len(stored(tmp_path / "run.h5")) > 0


SETUP = (
    '[source]\nkind = "simulated"\nrig = "{rig}"\nseed = 7\nblock = 0.01\n[record]\nblock = {block}\nkeep_free = 0.0\n'
)


def setup_of(rig="vibration", block="0.02", more=""):
    return parse_setup(SETUP.format(rig=rig, block=block) + more)


def check_after_a_kill(file, acknowledged):
    """Every block that was acknowledged can be read, and the file is ready for `info` and `force`."""
    found = stored(file)
    said = contents(file)
    assert len(said.blocks) >= acknowledged.blocks
    assert len(found) >= acknowledged.samples
    assert list(found) == list(range(len(found)))
    with h5py.File(file) as opened:  # as any other program does
        assert np.array_equal(opened["blocks"][: len(said.blocks)], said.blocks)
    # the rig is seeded, so that what should be in the file is known
    source = SimulatedSource(RigSettings(seed=7, block=0.01, speed=float("inf")))
    source.start()
    expected = []
    while len(expected) * 250 < len(found):
        expected.append(source.read(1.0).samples)
    expected = np.concatenate(expected)[: len(found)] if expected else np.empty((0, 4))
    assert all(found[tick].tobytes() == expected[tick].tobytes() for tick in found)
    if len(found) >= 2:
        account = recordings.info(file)
        assert account["samples"] == len(found)
        assert account["gaps"] == []


def kill_recorders(folder, count, seed):
    rng = np.random.default_rng(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        for number in range(count):
            with Session(setup_of(), folder) as session:
                file = folder / f"run{number}.h5"
                recorder = session.record(file)
                recorder.ready()
                session.start()
                time.sleep(rng.uniform(0, 0.6))
                victim = "recorder" if rng.uniform() < 0.7 else "source"
                process = recorder.process if victim == "recorder" else session.process
                os.kill(process.pid, signal.SIGKILL)
                limit = time.monotonic() + 60
                while not recorder.poll(0.1).over:
                    assert time.monotonic() < limit, f"seed {seed}: the loss of the {victim} was not noticed"
                assert "gone without a word" in recorder.progress.reason
                if victim == "recorder":
                    assert session.process.is_alive()
                else:
                    assert contents(file).reason == recorder.progress.reason
                check_after_a_kill(file, recorder.progress)


def test_kill_of_recorder_or_source_loses_nothing_acknowledged(tmp_path, seed) -> None:
    kill_recorders(tmp_path, trials(3, 10), seed)


@pytest.mark.long
def test_kill_of_recorder_or_source_a_hundred_times(tmp_path, seed) -> None:
    kill_recorders(tmp_path, 100, seed)


def ticks_by_the_clock(feed, until):
    """Follow a source of 25 kHz until a time on the steady clock; return what tells the tick of a time."""
    found = []
    while not found or found[-1].received < until:
        found.append(feed.take())

    def tick_at(at):
        block = next(block for block in found if block.received >= at)
        return block.end - round((block.received - at) * 25_000)

    return tick_at


def test_what_is_sampled_since_the_press_is_in_the_file(tmp_path) -> None:
    with Session(setup_of(), tmp_path) as session:
        feed = session.view()
        session.start()
        while feed.take().end < 25_000:
            pass
        pressed = time.monotonic()
        recorder = session.record(tmp_path / "run.h5", asked=pressed)
        stopped = time.monotonic() + 0.3
        time.sleep(0.3)
        # the process takes longer than this to start: it finds the samples, and the stop, when it is there
        progress = recorder.stop("enough")
        tick_at = ticks_by_the_clock(feed, stopped + 0.1)
        feed.close()
    ticks = list(stored(tmp_path / "run.h5"))
    said = contents(tmp_path / "run.h5")
    assert (progress.state, progress.reason, said.reason) == ("ended", "enough", "enough")
    assert ticks == list(range(ticks[0], ticks[-1] + 1))
    assert abs(ticks[0] - tick_at(pressed)) <= 0.1 * 25_000
    assert ticks[-1] >= tick_at(stopped) - 0.1 * 25_000
    # a block of 10 ms comes when it is due, so the sample is nearer than the test asks
    print(f"first sample {(ticks[0] - tick_at(pressed)) / 25:.1f} ms from the press")  # noqa: T201


def test_pre_trigger_is_there_at_once(tmp_path) -> None:
    with Session(setup_of(more="pre_trigger = 0.4\n"), tmp_path) as session:
        feed = session.view()
        session.start()
        while feed.take().end < 25_000:
            pass
        recorder = session.record(tmp_path / "run.h5", asked=time.monotonic())
        recorder.ready()
        recorder.stop("enough")
        feed.close()
    assert read(tmp_path / "run.h5").start == pytest.approx(-0.4)


def test_another_recorder_goes_on_where_one_was_killed(tmp_path) -> None:
    with Session(setup_of(), tmp_path) as session:
        first = session.record(tmp_path / "a.h5")
        first.ready()
        session.start()
        time.sleep(0.2)
        first.process.kill()
        second = session.record(tmp_path / "b.h5")
        second.ready()
        time.sleep(0.4)
        progress = second.stop("enough")
    assert progress.reason == "enough"
    ticks = list(stored(tmp_path / "b.h5"))
    assert len(ticks) == progress.samples > 1000
    assert ticks == list(range(ticks[0], ticks[-1] + 1))


def test_force_is_worked_out_from_the_file_of_a_killed_recorder(tmp_path) -> None:
    from aerobalance.estimation.force import estimate_force
    from aerobalance.simulation.published import CABLE_CUT

    text = SETUP.format(rig="cable_cut", block=0.1).replace("[record]", "speed = 10.0\ncut_at = 5.0\n[record]")
    with Session(parse_setup(text), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        while recorder.poll(0.05).seconds < 10.0:
            assert not recorder.progress.over
        recorder.process.kill()
    with pytest.warns(DataQualityWarning, match="not ended"):
        recording = read(tmp_path / "run.h5")
    force = estimate_force(recording, CABLE_CUT.dynamics).only.values
    # means over 4 s: 6400 readings of 10 N noise have 0.13 N, the accelerometer's 5 m/s^2 on 177.87 kg 11 N
    before, after = force[800:7200].mean(), force[9600:16000].mean()
    assert before == pytest.approx(-1020.0, abs=50)
    assert after == pytest.approx(0.0, abs=50)


def test_largest_size_of_a_file_ends_the_record_cleanly(tmp_path) -> None:
    file = tmp_path / "run.h5"
    with Session(setup_of(rig="six", block="0.1"), tmp_path) as session:
        recorder = session.record(file)
        recorder.ready()
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))
        session.start()
        while not recorder.poll(0.2).over:
            pass
        assert session.process.is_alive()
    assert recorder.progress.full
    assert recorder.progress.reason.startswith("disk full: the disk, its quota or the largest size")
    # a block has 2500 * 12 * 8 = 240 kB: eight of them are below 2 MB, less what the layout takes
    assert 7 <= recorder.progress.blocks <= 8
    assert len(stored(file)) == recorder.progress.samples
    assert contents(file).reason == recorder.progress.reason
    assert read(file).samples == recorder.progress.samples
    # no second name is left, which would keep the space in use when the file is deleted
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_note_that_finds_no_room_ends_the_record_as_a_block_does(tmp_path) -> None:
    file = tmp_path / "run.h5"
    with Session(setup_of(more='trigger = "call"\n'), tmp_path) as session:
        recorder = session.record(file)
        recorder.ready()
        size = file.stat().st_size
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (size, size))
        for _ in range(40):  # the table of events grows by 16 rows
            recorder.tell(RecorderCommand("note", "heard"))
        while not recorder.poll(0.2).over:
            pass
        recorder.process.join(5.0)
        assert recorder.process.exitcode == 0
    assert recorder.progress.full
    assert recorder.progress.reason.startswith("disk full: the disk, its quota or the largest size")
    assert contents(file).reason == recorder.progress.reason
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_full_file_system_ends_the_record_cleanly(tmp_path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    mount = shutil.which("mount")
    if os.geteuid() != 0 or mount is None:
        pytest.skip("a small file system can only be mounted by root")
    if subprocess.run([mount, "-t", "tmpfs", "-o", "size=6m", "tmpfs", small], check=False).returncode:
        pytest.skip("mounting is not allowed here")
    try:
        file = small / "run.h5"
        with Session(setup_of(rig="six", block="0.5"), tmp_path) as session:
            recorder = session.record(file)
            recorder.ready()
            (small / "other").write_bytes(bytes(1_500_000))
            session.start()
            while not recorder.poll(0.2).over:
                pass
        assert recorder.progress.full
        assert recorder.progress.reason.startswith("disk full")
        assert len(stored(file)) == recorder.progress.samples > 0
        assert contents(file).reason == recorder.progress.reason
        read(file)
        file.unlink()
        check_without_space(small)
    finally:
        subprocess.run(["umount", small], check=True)


WITHOUT_SPACE = """
import os, sys
from types import SimpleNamespace
import numpy as np
from aerobalance.acquisition import recorder
from aerobalance.acquisition.intake import RecordPlan
from aerobalance.acquisition.source import Block
from aerobalance.io.hdf5_layout import Provenance, StoredChannel
recorder.shutil.disk_usage = lambda _: SimpleNamespace(free=2**40)
channels = tuple(StoredChannel(f"c{i}", "N") for i in range(12))
plan = RecordPlan(channels, 25000.0, 2500)
take = recorder.RecordWriter(recorder.RecordJob(sys.argv[1], plan, False, recorder.Provenance("test"), 0))
number = 0
while not take.progress.over:
    take.feed(Block(number * 2500, np.random.default_rng(number).normal(size=(2500, 12)), 0.0))
    number += 1
sys.stdout.write(f"{take.progress.blocks} {take.progress.full} {take.progress.reason}")
sys.stdout.flush()
os._exit(0)
"""


def check_without_space(small):
    """The watch on the disk sees nothing (a quota, another program), so that the write itself fails."""
    file = small / "blind.h5"
    command = [sys.executable, "-c", WITHOUT_SPACE, str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    blocks, full, reason = done.stdout.split(" ", 2)
    assert full == "True"
    assert reason.startswith("disk full")
    assert len(stored(file)) == int(blocks) * 2500 > 0
    assert contents(file).reason == reason
    read(file)


def test_record_that_cannot_fit_is_refused_before_it_begins(tmp_path) -> None:
    with Session(setup_of(more="seconds = 1e7\n"), tmp_path) as session:
        with pytest.raises(ValueError, match=r"the record needs .* MB"):
            session.record(tmp_path / "run.h5")
        (tmp_path / "old.h5").write_bytes(b"old")
        with pytest.raises(ValueError, match="there already"):
            session.record(tmp_path / "old.h5", setup=setup_of())
        with pytest.raises(ValueError, match="there is no folder"):
            session.record(tmp_path / "none" / "run.h5", setup=setup_of())
    assert (tmp_path / "old.h5").read_bytes() == b"old"
    assert not (tmp_path / "run.h5").exists()


def test_trigger_note_and_controls_while_it_runs(tmp_path) -> None:
    setup = parse_setup(
        SETUP.format(rig="cable_cut", block=0.05)
        + 'trigger = "level"\nchannel = "AF"\nlevel = 500.0\npre_trigger = 0.1\nseconds = 0.5\n'
    )
    with Session(setup, tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        time.sleep(1.0)  # a busy machine takes its time until a tenth of a second before the trigger was sampled
        assert recorder.poll().state == "waiting"
        recorder.tell(RecorderCommand("note", "about to cut"))
        session.control("cut", 1.0)
        session.control("frequency", 3.0)
        limit = time.monotonic() + 60
        while not recorder.poll(0.1).over:
            assert time.monotonic() < limit
        said = {said.kind: said.text for said in session.news(0.5)}
    assert said["done"] == "cable cut"
    assert "no control 'frequency'" in said["refused"]
    recording = read(tmp_path / "run.h5")
    assert recording.start == pytest.approx(-0.1)
    assert recording.samples == round(0.6 * recording.rate)
    # the first sample at or above the level is at time zero
    load = recording.channel("AF").values
    assert np.flatnonzero(load >= 500)[0] == 160
    assert load[:100] == pytest.approx(-1020.0, abs=60)  # noise of 10 N


def test_viewer_that_never_reads_does_not_slow_the_recorder(tmp_path) -> None:
    with Session(setup_of(rig="six", block="0.1", more="seconds = 2.0\n"), tmp_path) as session:
        viewers = [session.view(), session.view()]
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        limit = time.monotonic() + 60  # a recorder that waits for the viewers never ends
        while not recorder.poll(0.2).over:
            assert time.monotonic() < limit
        assert recorder.progress.gaps == 0
        # the viewer gets what was kept for it, and is told of what was not
        first = viewers[0].take()
        assert isinstance(first, Block)
        assert first.tick == 0
        for viewer in viewers:
            viewer.close()


def record_command(folder, *options):
    command = [sys.executable, "-m", "aerobalance.app.cli", "record", "-o", "run.h5", "--json", *options]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_blocks(file, least=1):
    limit = time.monotonic() + 60
    while time.monotonic() < limit:
        if file.exists():
            try:
                if len(contents(file).blocks) >= least:
                    return
            except Exception:  # noqa: BLE001 - not yet
                pass
        time.sleep(0.05)
    raise AssertionError("nothing was recorded")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.soak(first=1)
def test_signal_ends_the_command_with_a_whole_file(number, tmp_path) -> None:
    process = record_command(tmp_path)
    wait_for_blocks(tmp_path / "run.h5")
    process.send_signal(number)
    out, err = process.communicate(timeout=60)  # it takes 2 s; a busy machine is allowed more
    assert process.returncode == 0, err
    account = json.loads(out)
    assert account["samples"] == read(tmp_path / "run.h5").samples
    assert contents(tmp_path / "run.h5").state == "ended"


def gone(pids):
    """Wait until none of the processes is there; a busy machine is given a minute."""
    limit = time.monotonic() + 60
    while any(Path(f"/proc/{pid}/cmdline").exists() and Path(f"/proc/{pid}/cmdline").read_bytes() for pid in pids):
        assert time.monotonic() < limit
        time.sleep(0.05)


@pytest.mark.parametrize("delay", [0.8, 1.4, 2.0])
@pytest.mark.soak(first=1)
def test_signal_while_the_command_starts_leaves_nothing_running(delay, tmp_path) -> None:
    process = record_command(tmp_path)
    time.sleep(delay)
    started = children(process.pid)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    # before the record: said so; before the program takes signals: ended by it; after: a record as any
    assert process.returncode in (0, 1, 128 + signal.SIGTERM, -signal.SIGTERM), err
    assert process.returncode != 1 or "before the record began" in err
    assert "Traceback" not in err
    gone(started)


def test_a_recorder_without_source_and_starter_ends_without_a_word(tmp_path) -> None:
    """As where all are told to end while they start: what it would tell has nobody to hear it."""
    own, starter = Pipe()
    starter.close()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        recorder_module.run_recorder(job(tmp_path / "run.h5"), Address(str(tmp_path / "socket"), b"key"), own)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert not (tmp_path / "run.h5").exists()


def test_kill_of_the_command_ends_the_record_and_leaves_no_process(tmp_path) -> None:
    process = record_command(tmp_path)
    wait_for_blocks(tmp_path / "run.h5", 2)
    started = children(process.pid)
    assert len(started) >= 2
    process.kill()
    process.communicate()
    gone(started)
    reason = contents(tmp_path / "run.h5").reason
    # the recorder finds it out itself, or hears it from the source, which has found it out first
    assert "the program that started the record is gone" in reason or "started the source is gone" in reason
    read(tmp_path / "run.h5")


def test_replay_keeps_gaps_at_any_speed(tmp_path) -> None:
    from aerobalance.app.commands.record import RecordOptions, record

    take = RecordWriter(job(tmp_path / "first.h5"))
    take.feed(Block(0, truth(0, 300), 0.0))
    take.feed(Block(450, truth(450, 1000), 0.0))
    take.end("done")
    with pytest.warns(DataQualityWarning, match="150 sample"):
        write_recording(tmp_path / "first.csv", read(tmp_path / "first.h5"))
    for name in ("first.h5", "first.csv"):
        options = RecordOptions(source="replay", file=tmp_path / name, speed=float("inf"))
        account = record(tmp_path / f"{name}.h5", options=options)
        assert (account["samples"], account["gaps"], account["lost"]) == (850, 1, 150)
        with pytest.warns(DataQualityWarning, match="150 sample"):
            again = read(tmp_path / f"{name}.h5")
        assert again.gaps == [(pytest.approx(0.299), pytest.approx(0.15))]
        assert np.array_equal(
            again.channel("NF").values, quietly(tmp_path / "first.h5").channel("NF").values, equal_nan=True
        )


def test_calls_that_the_command_refuses(tmp_path) -> None:
    from aerobalance.app.commands.record import RecordOptions, chosen_setup, record

    with pytest.raises(ValueError, match=r"written as \.h5"):
        record(tmp_path / "run.csv")
    with pytest.raises(ValueError, match="one of simulated, replay"):
        chosen_setup(None, RecordOptions(source="opera"))
    with pytest.raises(ValueError, match="needs --file"):
        chosen_setup(None, RecordOptions(source="replay"))
    with pytest.raises(ValueError, match="--rig does not go with --source replay"):
        chosen_setup(None, RecordOptions(source="replay", rig="six"))
    setup = tmp_path / "test.toml"
    setup.write_text('[source]\nkind = "simulated"\nrate = 50.0\n')
    with pytest.raises(ValueError, match=r"22\.5 Hz"):
        record(tmp_path / "run.h5", setup=setup)
    setup.write_text("[limits.NF]\nlow = 0.0\n")
    with pytest.raises(FitError, match="no channel NF"):
        record(tmp_path / "run.h5", setup=setup)
    assert not (tmp_path / "run.h5").exists()
