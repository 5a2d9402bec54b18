"""A recording whose file is deleted, moved or replaced while it is written: nothing that was acknowledged is lost."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from aerobalance.acquisition.recorder import run_recorder
from aerobalance.acquisition.session import Recorder, Session
from aerobalance.acquisition.setup import parse_setup
from aerobalance.acquisition.simulated import RigSettings, SimulatedSource
from aerobalance.app.cli import main
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_file import read_blocks
from aerobalance.io.locked_file import LockedFile, is_locked, recover_all
from helpers.at_work import blocks_of, follow

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there, an open file cannot be deleted")

SETUP = """
[source]
kind = "simulated"
rig = "vibration"
seed = 7
block = 0.01
[record]
block = 0.05
keep_free = 0.0
"""


def samples_of(path):
    """All samples of a file, which has to open_locked every tick from the first on and to agree with its checksums."""
    blocks = list(read_blocks(path))
    assert [tick for tick, _ in blocks] == list(np.cumsum([0, *(len(part) for _, part in blocks)]))[:-1]
    return np.concatenate([part for _, part in blocks])


def expected(rows):
    """What the seeded rig gives."""
    source = SimulatedSource(RigSettings(seed=7, block=0.01, speed=float("inf")))
    source.start()
    found = [source.read(1.0).samples for _ in range(rows // 250 + 1)]
    return np.concatenate(found)[:rows]


def check(progress):
    """The file where the record is now has every sample that was acknowledged, to the last bit."""
    stored = samples_of(progress.path)
    assert len(stored) >= progress.samples > 0
    assert stored.tobytes() == expected(len(stored)).tobytes()


def replace(file):
    other = file.with_name("other.h5")
    shutil.copyfile(file, other)
    other.replace(file)


def move(file):
    file.with_name("moved").mkdir()
    file.rename(file.with_name("moved") / "else.h5")


@pytest.mark.parametrize(
    ("take_away", "words", "name"),
    [
        (Path.unlink, "run.h5 was deleted while it was written; the record is in run-2.h5", "run-2.h5"),
        (replace, "run.h5 was replaced by another file while it was written; the record is in run-2.h5", "run-2.h5"),
        (move, "run.h5 was moved to", "else.h5"),
    ],
)
def test_record_goes_on_where_its_name_is_taken_away(take_away, words, name, tmp_path) -> None:
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks >= 3)
        take_away(tmp_path / "run.h5")
        before = follow(recorder, lambda progress: progress.mishap).blocks
        follow(recorder, lambda progress: progress.blocks >= before + 3)
        progress = recorder.stop("enough")
    assert progress.reason == "enough"
    assert progress.mishap.startswith(words)
    assert Path(progress.path).name == name
    check(progress)
    kept = contents(progress.path)
    assert kept.state == "ended"
    assert [bytes(event["text"]).decode() for event in kept.events if event["kind"] == b"file"] == [progress.mishap]
    assert not list(tmp_path.glob(".*"))


def test_folder_that_is_moved_takes_the_second_name_along(tmp_path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    (old / "run.h5").write_bytes(b"samples")
    held = LockedFile(old / "run.h5")
    assert [file.name for file in old.glob(".*")] == [".run.h5.recording"]
    old.rename(new)
    assert held.look().text == f"run.h5 was moved to {new / 'run.h5'} while it was written"
    old.mkdir()  # what takes the place of the old folder is not touched
    assert held.look() is None
    (new / "run.h5").unlink()
    assert held.look().path == new / "run-2.h5"
    held.release()
    assert list(old.iterdir()) == []
    assert [(file.name, file.read_bytes()) for file in new.iterdir()] == [("run-2.h5", b"samples")]


def test_name_that_is_taken_away_twice(tmp_path) -> None:
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        for number in (1, 2):
            follow(recorder, lambda progress: progress.blocks >= 2)
            Path(recorder.progress.path).unlink()
            follow(recorder, lambda progress, number=number: progress.mishap.count("deleted") == number)
        progress = recorder.stop("enough")
    assert list(tmp_path.iterdir()) == [Path(progress.path)]
    check(progress)


def test_record_without_any_name_left_is_copied_and_ended(tmp_path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(folder / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks >= 3)
        shutil.rmtree(folder)
        limit = time.monotonic() + 60
        while not recorder.poll(0.1).over:
            assert time.monotonic() < limit
    progress = recorder.progress
    assert progress.unkept
    assert progress.reason == (
        "run.h5 was deleted while it was written; the record was ended, and what it holds was copied to run-2.h5"
    )
    check(progress)


def test_file_that_is_cut_short_is_told(tmp_path) -> None:
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks >= 3)
        os.truncate(tmp_path / "run.h5", 1000)
        limit = time.monotonic() + 60
        while not recorder.poll(0.1).over:
            assert time.monotonic() < limit
    assert recorder.progress.unkept
    assert "run.h5 was cut short by another program" in recorder.progress.reason


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Call the program in the folder: exit code and what it says on standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        capsys.readouterr()
        return main([*words]), capsys.readouterr().err

    return call


def test_command_says_where_the_record_is(tmp_path) -> None:
    import json

    program = [sys.executable, "-m", "aerobalance.app.cli", "record", "--seconds", "4", "-o", "run.h5", "--json"]
    with subprocess.Popen(program, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        limit = time.monotonic() + 60
        while blocks_of(tmp_path / "run.h5") < 2:
            assert time.monotonic() < limit
            time.sleep(0.05)
        (tmp_path / "run.h5").unlink()
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    told = json.loads(out)
    assert (told["file"], len(told["warnings"])) == ("run-2.h5", 1)
    assert f"warning: {told['warnings'][0]}\n" in err
    assert len(samples_of(tmp_path / "run-2.h5")) == told["samples"] == 4 * 25000


def test_file_that_is_being_written_is_not_replaced(tmp_path, command) -> None:
    from aerobalance.io.safe_write import replacing

    file = tmp_path / "run.h5"
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(file)
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks >= 3)
        assert is_locked(file)
        code, text = command("record", "--seconds", "1", "--replace", "-o", "run.h5")
        assert (code, "is being recorded" in text) == (2, True), text
        shutil.copyfile(file, tmp_path / "copy.h5")
        code, text = command("convert", "copy.h5", "-o", "run.h5")
        assert (code, "is being recorded" in text) == (2, True), text
        with pytest.raises(ValueError, match="is being recorded"), replacing(file):
            pass
        assert contents(file).state == "recording"  # others may read
        progress = recorder.stop("enough")
    check(progress)
    assert progress.mishap == ""
    assert not is_locked(file)
    with replacing(file) as beside:
        beside.write_text("now it may be replaced", encoding="utf-8")
    assert file.read_text(encoding="utf-8") == "now it may be replaced"


def test_record_that_begins_while_a_result_is_worked_out_stays(tmp_path) -> None:
    from aerobalance.io.safe_write import replacing

    with Session(parse_setup(SETUP), tmp_path) as session:
        with pytest.raises(ValueError, match="is being recorded"), replacing(tmp_path / "run.h5") as beside:
            beside.write_text("a result", encoding="utf-8")
            recorder = session.record(tmp_path / "run.h5")
            recorder.ready()
            session.start()
            follow(recorder, lambda progress: progress.blocks >= 1)
        check(recorder.stop("enough"))


def test_file_that_another_recorder_has_made_is_told_in_plain_words(tmp_path, monkeypatch) -> None:
    with Session(parse_setup(SETUP), tmp_path) as session:
        first = session.record(tmp_path / "run.h5")
        first.ready()
        job = None

        def caught(given, address):
            nonlocal job
            job = given
            raise KeyError

        with monkeypatch.context() as patch:
            patch.setattr("aerobalance.acquisition.session.Recorder", caught)
            with pytest.raises(KeyError):
                session.record(tmp_path / "other.h5")
        # both have seen that there was no such file
        from dataclasses import replace as changed

        second = Recorder(changed(job, path=str(tmp_path / "run.h5")), session.address)
        with pytest.raises(ValueError, match="it is there already, made by another program") as refusal:
            second.ready()
        assert "errno" not in str(refusal.value)
        first.stop()
    assert run_recorder is not None


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only for root")
def test_folder_that_is_read_only_is_told_in_plain_words(tmp_path) -> None:
    tmp_path.chmod(0o500)
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        with pytest.raises(ValueError, match="permission denied"):
            recorder.ready()


def test_name_that_is_too_long_is_a_wrong_call(command) -> None:
    code, text = command("record", "--seconds", "1", "-o", "a" * 300 + ".h5")
    assert code == 2, text
    assert "File name too long" in text


def test_record_whose_name_is_gone_when_its_recorder_is_killed_is_found_again(tmp_path) -> None:
    with Session(parse_setup(SETUP), tmp_path) as session:
        recorder = session.record(tmp_path / "run.h5")
        recorder.ready()
        session.start()
        follow(recorder, lambda progress: progress.blocks >= 3)
        recorder.process.kill()
        recorder.process.join()
        (tmp_path / "run.h5").unlink()
        progress = recorder.poll()
        while not progress.over:
            progress = recorder.poll(0.1)
        assert list(tmp_path.iterdir()) == [tmp_path / "run.h5"]
        check(progress)
        # where the name is still there, only the second one goes
        recorder = session.record(tmp_path / "two.h5")
        recorder.ready()
        recorder.process.kill()
        recorder.process.join()
        assert recover_all(tmp_path) == []
        assert sorted(tmp_path.iterdir()) == [tmp_path / "run.h5", tmp_path / "two.h5"]
