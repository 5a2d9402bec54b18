"""The record button, names and lengths, what a record's files are, tasks, and replays, on the page's server."""

from __future__ import annotations

import queue
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from aerobalance.app.monitor import stepped_sine
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.jobs import TaskOutcome
from aerobalance.app.monitor.workers import Jobs
from aerobalance.io.hdf5_contents import contents
from helpers.running_page import Running


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with Running(tmp_path_factory.mktemp("project")) as page:
        page.wait(lambda state: state["numbers"].get("estimates"))
        yield page


def ended(running):
    return running.wait(lambda state: state["record"]["state"] == "ended")["record"]


def test_a_record_begins_at_the_press_and_says_at_once_that_it_starts(running) -> None:
    """The cable-cut rig gives 1600 samples a second in blocks of 20 ms; a viewer of its own tells when each came."""
    feed = running.page.session.source.session.view()
    feed.take()
    states = []
    log, records = running.page.session.log, running.page.session.records
    said, log.changed = log.changed, lambda: states.append(records.progress and records.progress.state)
    pressed = time.time()
    steady = time.monotonic()
    try:
        assert running.post("record", name="pressed", seconds=0.5, pressed=1e3 * pressed).status_code == 200
    finally:
        log.changed = said
    assert states[0] == "starting"
    ended(running)
    blocks = [feed.take()]
    while blocks[-1].received < steady + 0.3:
        blocks.append(feed.take())
    feed.close()
    # a block may come late beside other tests, and none comes early
    expected = max(one.end - (one.received - steady) * 1600 for one in blocks if one.received >= steady)
    found = contents(running.folder / "pressed.h5")
    first = int(found.blocks["tick"][0])
    print(f"first sample {(first - expected) / 1.6:.1f} ms after the press")  # noqa: T201
    assert abs(first - expected) <= 0.1 * 1600
    assert int(found.blocks["rows"].sum()) == 800


def test_a_stop_while_the_recorder_starts_leaves_what_was_sampled_until_then(running) -> None:
    source = running.page.session.source
    source.running()
    time.sleep(2.0)
    began = time.monotonic() - 2.0  # two seconds ago, which the source has kept
    recorder = source.running().record(running.folder / "early.h5", setup=source.setup, asked=began)
    progress = recorder.stop("enough", timeout=10.0)
    took = time.monotonic() - began
    assert progress.reason == "enough" and not progress.gaps
    # two blocks of the source at the ends
    assert 2.0 - 0.05 <= progress.seconds <= took


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        ("abc", "seconds: must be a number, not 'abc'"),
        (-3, "seconds: must be greater than 0, not -3"),
        (float("nan"), "seconds: must be a finite number, not nan"),
        (0, "seconds: must be greater than 0, not 0"),
    ],
)
def test_a_length_that_is_none_is_refused(running, seconds, said) -> None:
    text = '{"name": "endless", "seconds": %s}' % (f'"{seconds}"' if isinstance(seconds, str) else repr(seconds))
    answer = running.client.post("/api/record", content=text.replace("nan", "NaN"))
    assert answer.status_code == 422
    assert answer.json() == {"error": said, "where": "seconds"}
    assert running.client.get("/api/state").json()["record"].get("file") != "endless.h5"


def test_what_is_no_json_is_refused_in_words_of_the_project(running) -> None:
    assert running.client.post("/api/record", content="{").json()["error"] == "the request is no JSON"


@pytest.mark.parametrize("name", ["Prüfling Ä 1", "µ-run", "Прогон 3", "試験(2)", "Pru\u0308fling NFD", "12 °C"])
def test_names_of_other_languages(tmp_path, name) -> None:
    folder = Folder(tmp_path)
    path = folder.new_recording(name)
    path.write_bytes(b"x")
    assert [item["name"] for item in folder.recordings()] == [path.name]
    assert folder.recording(path.name) == path
    with pytest.raises(ValueError, match="there already"):
        folder.new_recording(name)


@pytest.mark.parametrize(
    "name", ["a\u202egpj.exe", "a\u200bb", "a\ud800b", "a/ü", "\u0308", "a" * 60 + "試" * 38, "a\u0000"]
)
def test_names_that_are_still_refused(tmp_path, name) -> None:
    with pytest.raises(ValueError, match=r"no name for a file|longer than"):
        Folder(tmp_path).new_recording(name)


def test_zeros_are_told_with_their_unit(running) -> None:
    running.post("zero")
    running.wait(lambda state: state["zeros"])
    text = running.page.display.marks[-1]["text"]
    assert text.startswith("zero: AF -10") and text.endswith(" N")
    running.post("clear_zero")


def test_every_file_made_of_a_recording_is_listed_and_can_be_fetched(running) -> None:
    assert running.post("record", name="Läufer 1", seconds=0.5).status_code == 200
    ended(running)
    for ending in ("-force.csv", "-dynamics.json", "-force.html", "-identified.html"):
        (running.folder / f"Läufer 1{ending}").write_text(ending, encoding="utf-8")
    listed = {item["name"]: item for item in running.client.get("/api/recordings").json()}["Läufer 1.h5"]
    assert listed["files"] == ["Läufer 1-dynamics.json", "Läufer 1-force.csv"]
    assert listed["reports"] == ["Läufer 1-identified.html", "Läufer 1-force.html"]
    for name in [*listed["files"], *listed["reports"], "Läufer 1.h5"]:
        answer = running.client.get(f"/file/{name}")
        assert answer.status_code == 200
        assert answer.content == (running.folder / name).read_bytes()
        assert "attachment" in answer.headers["content-disposition"]
    report = running.client.get("/report/Läufer 1-force.html")
    assert report.status_code == 200
    assert "sandbox" in report.headers["content-security-policy"]


@pytest.mark.parametrize("loop", [False, True])
def test_a_replay_shorter_than_a_second_is_shown_whole(tmp_path, loop) -> None:
    time_ = np.arange(640) / 1600
    load = 100 * np.sin(2 * np.pi * 5 * time_)
    table = np.column_stack([time_, load])
    np.savetxt(tmp_path / "short.csv", table, delimiter=",", header="time [s],AF [N]", comments="", fmt="%.9f")
    with Running(tmp_path) as running:
        source = {"kind": "replay", "file": "short.csv", "loop": loop}
        assert running.post("setup", setup={"source": source}).status_code == 200
        if loop:
            running.wait(lambda _: running.page.display.tick >= 3 * 640)
            again = [mark["tick"] for mark in running.page.display.marks if "begins again" in mark["text"]]
            assert again[:2] == [640, 1280]
            assert running.client.get("/api/state").json()["source"]["state"] == "running"
            return
        running.wait(lambda state: state["source"]["state"] == "ended" and running.page.display.tick == 640)
        shown = running.page.display.strips[0].since(0, 0)
        assert shown.first == 0
        np.testing.assert_allclose(shown.least[:, 0], load, atol=1e-4)
        assert not any("cannot be watched" in item["text"] for item in running.page.session.log.messages)
        # 0.4 s are two spans of 0.2 s: the page has had numbers
        assert running.page.display.numbers["readings"]["AF"]["largest"] == pytest.approx(100, abs=1)


class Rig:
    """Source, records, tasks and log of a rig at 100 Hz whose record ends by itself after so many dwells."""

    def __init__(self, dwells, masses):
        self.controls = {"frequency": 100.0}
        self.watching = SimpleNamespace(components=("AF",), frequencies={"AF": 66.0}, masses=masses)
        self.driven, self.left, self.begun, self.said = [], dwells, False, []

    def control(self, name, value):
        self.driven.append(value)

    def begin(self, name, *, notes, seconds):
        self.begun = True

    @property
    def under_way(self):
        self.left -= 1
        return self.left > 0

    def stop(self):
        raise ValueError("no record is under way")

    def changed(self):
        pass

    def say(self, text, *, kind):
        self.said.append((kind, text))


def test_a_stepped_sine_run_that_ends_early_leaves_no_drive_at_resonance(monkeypatch) -> None:
    monkeypatch.setattr(stepped_sine, "DWELL", 0.0)
    rig = Rig(1 + stepped_sine.SHARES.index(1.0), {"AF": 177.0})
    run = stepped_sine.SteppedSineRun(rig, rig, rig, rig, taken=())
    run._run()
    assert rig.driven[-2:] == [66.0, 100.0]
    assert run.shown["text"] == "ended early: no record is under way"
    assert rig.said == [("error", "stepped-sine run: no record is under way")]


def test_a_stepped_sine_run_needs_a_mass() -> None:
    rig = Rig(1, {})
    with pytest.raises(ValueError, match="needs the moving mass along AF"):
        stepped_sine.SteppedSineRun(rig, rig, rig, rig, taken=())
    assert not rig.begun


def test_controls_are_shown_as_the_source_has_them(tmp_path) -> None:
    with Running(tmp_path, rig="vibration") as page:
        before = page.wait(lambda state: True)["source"]["controls"]
        assert before["frequency"] == 100.0
        page.post("control", name="frequency", value=120.0)
        page.post("control", name="frequency", value=1e6)
        page.post("control", name="amplitude", value=20.0)
        page.wait(lambda state: state["source"]["controls"]["amplitude"] == 20.0)
        state = page.wait(lambda state: any("must be above 0" in said["text"] for said in state["messages"]))
        assert state["source"]["controls"] == before | {"frequency": 120.0, "amplitude": 20.0}


def test_tasks_that_wait_are_given_up_with_the_one_under_way(tmp_path, monkeypatch) -> None:
    begun, ended, words = [], threading.Event(), queue.Queue()

    def do(self, task):
        begun.append(task.number)
        assert ended.wait(10.0)
        return TaskOutcome(task.number, True)

    monkeypatch.setattr(Jobs, "_do", do)
    jobs = Jobs(lambda task, outcome: words.put((task.number, outcome)))
    numbers = [jobs.add("info", [str(tmp_path / "run.h5")], {}).number for _ in range(3)]
    assert words.get(timeout=10.0) == (numbers[0], None)
    jobs.cancel()
    told = dict(words.get(timeout=10.0) for _ in numbers[1:])
    assert {number: outcome.done for number, outcome in told.items()} == dict.fromkeys(numbers[1:], False)
    ended.set()
    number, outcome = words.get(timeout=10.0)
    assert (number, outcome.done) == (numbers[0], True)
    # a task after that is done as any other
    after = jobs.add("info", [str(tmp_path / "run.h5")], {}).number
    assert [words.get(timeout=10.0)[0] for _ in range(2)] == [after, after]
    jobs.close()
    assert begun == [numbers[0], after]
