"""What is told of how far a command is."""

import os
import pty
import subprocess
import sys
import threading

import pytest

from aerobalance.app.cli import main
from aerobalance.estimation.force import estimate_force
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording import progress
from aerobalance.recording.progress import Progress, telling
from aerobalance.simulation.cable_cut import CableCut
from aerobalance.uncertainty.monte_carlo import monte_carlo


@pytest.fixture
def clock(monkeypatch):
    """A clock that is set by hand: clock[0] [s]."""
    now = [100.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    return now


def test_the_time_that_is_left_follows_from_the_share_that_is_done(clock):
    said = []
    told = Progress(said.append)
    for _ in told.each(range(3), "part"):
        clock[0] += 30
    assert said == ["part 1 of 3", "part 2 of 3; about 60 s left", "part 3 of 3; about 30 s left"]
    said.clear()
    for place in told.each([1, 2], "part"):  # times are those of this loop alone
        with told.stage(0.0, 0.5, "steps"):
            told.note("2 found")
            clock[0] += 10
        with told.stage(0.5, 1.0, "uncertainty"):
            for _ in told.each(range(5), "draw"):
                clock[0] += 2
        assert place in (1, 2)
    assert said[:2] == ["part 1 of 2", "part 1 of 2, steps"]
    assert "part 1 of 2, uncertainty, draw 2 of 5; about 28 s left" in said  # 12 s for 0.3 of the whole
    assert said[-1] == "part 2 of 2, uncertainty, draw 5 of 5; about 2 s left"
    assert told.done == 0


@pytest.mark.parametrize(("seconds", "words"), [(3, "3 s"), (300, "5 min"), (30_000, "8 h 20 min")])
def test_durations_are_short(clock, seconds, words):
    said = []
    for _ in Progress(said.append).each(range(2), "part"):
        clock[0] += seconds
    assert said[1] == f"part 2 of 2; about {words} left"


def test_nothing_is_told_too_often_or_after_an_error_or_by_another_thread(clock):
    said = []
    told = Progress(said.append)
    with pytest.raises(ZeroDivisionError):
        for number in told.each(range(1000), "part"):
            clock[0] += progress.OFTEN / 3.5
            _ = 1 / (50 - number)
    assert 10 <= len(said) <= 15
    assert told.done == 0
    clock[0] += 1
    said.clear()
    helping = threading.Thread(target=lambda: list(told.each(range(3), "part")))
    helping.start()
    helping.join()
    assert said == []
    assert list(Progress().each(range(3), "part")) == [0, 1, 2]


def test_force_and_monte_carlo_say_where_they_are(rng, monkeypatch):
    """The share that is done grows, and the words name what is being done."""
    run = CableCut().run(2.0, rng)
    said = []
    monkeypatch.setattr(progress, "OFTEN", 0.0)

    def hear(text):
        said.append((text, progress.PROGRESS.done))

    with telling(hear):
        force = estimate_force(run.recording, CableCut().dynamics)
        count = len(said)
        monte_carlo(force, draws=20)
    words = " ".join(text for text, _ in said)
    assert all(part in words for part in ("spectrum and steps", "1 found so far", "uncertainty", "draw 20 of 20"))
    for shares in ([share for _, share in said[:count]], [share for _, share in said[count:]]):
        assert shares == sorted(shares)
    assert said[-1][1] == pytest.approx(0.95)
    assert progress.PROGRESS.told is None


@pytest.mark.skipif(os.name == "nt", reason="terminals are those of POSIX")
def test_progress_stands_at_a_terminal_and_not_in_a_file(tmp_path, rng, monkeypatch, capsys):
    run = CableCut().run(2.0, rng)
    write_recording(tmp_path / "run.csv", run.recording)
    write_dynamics(tmp_path / "dynamics.json", {"AF": CableCut().dynamics})
    words = ["force", "run.csv", "--dynamics", "dynamics.json", "-o", "f.csv", "--monte-carlo", "600", "--replace"]
    command = [sys.executable, "-m", "aerobalance.app.cli", *words]
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=theirs, env=os.environ | {"TERM": "xterm"}
    ):
        os.close(theirs)
        shown = b""
        while True:
            try:
                more = os.read(ours, 4096)
            except OSError:  # the terminal is gone with the command
                break
            if not more:
                break
            shown += more
    os.close(ours)
    assert b"estimating the force" in shown
    assert b"draw" in shown and b"of 600" in shown
    monkeypatch.chdir(tmp_path)
    assert main(words) == 0
    said = capsys.readouterr().err
    assert "draw" not in said and "left" not in said
