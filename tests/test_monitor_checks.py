"""Combined loads, contact and the checks before a run, as the page shows and records them."""

from __future__ import annotations

import json
import math
import struct
import time
from types import SimpleNamespace

import numpy as np
import pytest

from aerobalance.acquisition.feed import SourceInfo
from aerobalance.acquisition.guards import ContactCircuit
from aerobalance.acquisition.setup import setup_from
from aerobalance.acquisition.source import Block, SourceChannel
from aerobalance.acquisition.source_settings import HALF_RANGES
from aerobalance.app.monitor.checks import Checks
from aerobalance.app.monitor.display import DisplayState
from aerobalance.app.monitor.form import form_of
from aerobalance.app.monitor.messages import News, Watching
from aerobalance.app.monitor.setups import rig_setup
from aerobalance.app.monitor.view import Panel, View
from aerobalance.balance.load_envelope import LoadEnvelope
from aerobalance.dynamics.independent import NO_DYNAMICS
from aerobalance.io import read
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.simulation.published import CABLE_CUT, VIBRATION_RIG
from helpers.running_page import Running, source_of

CHANNELS = (
    StoredChannel(name="NF", unit="kN"),
    StoredChannel(name="AF", unit="N"),
    StoredChannel(name="fouling", unit="V"),
)


def test_combined_loads_are_the_worst_of_all_samples(rng) -> None:
    envelope = LoadEnvelope("rhombus", {"NF": (-2000.0, 2000.0), "AF": (-100.0, 100.0)})
    view = View(Panel(CHANNELS, 1000.0, True, NO_DYNAMICS, {}, {}, zeros={"AF": 10.0}, envelope=envelope))
    samples = rng.normal(size=(400, 3)) * (0.5, 20.0, 0.0)
    view.feed(Block(0, samples, 0.0))
    found = view.take().envelope
    # kN and N, the zero taken off; every sample counts, as the ringing strains the balance
    shares = np.abs(samples[:, 0]) / 2 + np.abs(samples[:, 1] - 10) / 100
    assert found.share == pytest.approx(shares.max(), rel=1e-12)
    worst = samples[np.argmax(shares)]
    assert found.parts == pytest.approx({"NF": abs(worst[0]) / 2, "AF": abs(worst[1] - 10) / 100})


def test_contact_is_marked_where_it_is() -> None:
    circuit = ContactCircuit(2, "fouling", "V", 2.5, True, 20)
    view, board = View(Panel(CHANNELS, 1000.0, True, NO_DYNAMICS, {}, {}, circuit=circuit)), DisplayState()
    board.begin(Watching(1, view.panel.names, ("",) * 3, 1000.0, 1, (), {}, {}, {}, {}))
    volts = np.zeros(1500)
    volts[300:420] = volts[430:500] = volts[1400:] = 5.0  # bounces once
    touching = []
    for begin in range(0, 1500, 100):
        part = np.zeros((100, 3))
        part[:, 2] = volts[begin : begin + 100]
        view.feed(Block(begin, part, 0.0))
        board.take(News(1, view.take(), {}))
        touching.append(board.numbers.get("touching"))
    marks = [(item["tick"], item["kind"]) for item in board.marks]
    assert marks == [(300, "contact"), (500, "contact over"), (1400, "contact")]
    assert "over after 0.2 s" in board.marks[1]["text"]
    # numbers come every 200 samples
    assert touching[1] is False and touching[3] is True and touching[9] is False


@pytest.mark.parametrize("rig", ["cable_cut", "vibration"])
def test_the_simulated_contact_is_a_force(rig) -> None:
    source = source_of(rig, noise=0.0, amplitude=0.0, circuit="fouling", cable_force=0.0)
    before = source.read(1.0).samples[-1]
    source.control("touch", 1)
    for _ in range(150):
        touching = source.read(1.0).samples
    # at rest again, the spring carries the force of the support: 5 % of half of the range
    half = {"cable_cut": CABLE_CUT, "vibration": VIBRATION_RIG}[rig].half_range.value
    assert touching[-1, 0] - before[0] == pytest.approx(0.05 * half, rel=1e-3)
    assert touching[-1, -1] == 5.0 and before[-1] == 0.0
    assert touching[-1, 2] == pytest.approx(before[2], abs=1e-3 * half)
    source.control("release", 1)
    source.control("shunt", 1)
    for _ in range(150):
        released = source.read(1.0).samples
    assert released[-1, 0] - before[0] == pytest.approx(0.4 * half, rel=1e-3)
    assert released[-1, -1] == 0.0


def test_half_ranges_of_the_rigs_are_the_printed_ones() -> None:
    assert HALF_RANGES["vibration"]["AF"] == VIBRATION_RIG.half_range.value
    assert HALF_RANGES["cable_cut"]["AF"] == HALF_RANGES["six"]["AF"] == CABLE_CUT.half_range.value


def test_the_form_can_hold_every_kind_of_field() -> None:
    form = form_of(rig_setup("six"), None)
    kinds = {field["type"] for fields in (*form["tables"].values(), *form["sources"].values()) for field in fields}
    assert kinds <= {"text", "number", "numbers", "choice", "data", "table"}
    assert form["values"]["shunt"]["AF"] == {"change": 800.0}
    assert form["values"]["fouling"] == {"channel": "fouling", "level": 2.5}
    assert [field["key"] for field in form["envelope"]] == ["shape", "action"]
    assert next(field for field in form["tables"]["stations"] if field["key"] == "limit")["needed"]


class StandIn:
    """A check of a source that has been switched off, from means of its channels before and after."""

    def __init__(self, channels, given, half_ranges=None):
        info = SourceInfo(tuple(SourceChannel(*one) for one in channels), 1000.0, True, "a source", ())
        names, units = zip(*channels, strict=True)
        watching = Watching(1, names, units, 1000.0, 1, (), half_ranges or {}, {}, {}, {})
        setup, running = setup_from(given), SimpleNamespace(info=info)
        source = SimpleNamespace(setup=setup, running=lambda: running, watching=watching)
        self.notes, self.opening_notes, self.said = [], [], []
        self.checks = Checks(source, self, self)

    def note(self, text, *, shown=True):
        self.notes.append(text)

    def say(self, text, *, kind):
        self.said.append((kind, text))

    def changed(self):
        pass


@pytest.mark.parametrize("kind", ["shunt", "return"])
def test_a_channel_without_readings_fails_a_check(kind) -> None:
    given = {"source": {"kind": "simulated"}, "shunt": {"rNF": {"change": 0.5}, "rPM": {"change": 0.5}}}
    page = StandIn([("rNF", "mV/V"), ("rPM", "mV/V")], given, {"rNF": 1.0, "rPM": 1.0})
    step = 0.5 if kind == "shunt" else 0.0
    before, dead = np.array([0.0, 1e-5, 0.0, -1e-5]), (math.nan,) * 4
    page.checks._judge(kind, {"rNF": tuple(before), "rPM": dead}, {"rNF": tuple(step + before), "rPM": dead})
    assert [(row["channel"], row["verdict"]) for row in page.checks.shown["rows"]] == [
        ("rNF", "passed"), ("rPM", "failed"),
    ]  # fmt: skip
    name = {"shunt": "shunt check", "return": "return to zero"}[kind]
    assert page.said == [("error", f"{name} FAILED; rPM has no readings")]
    assert f"{name} failed: rPM has no readings" in page.opening_notes


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with Running(tmp_path_factory.mktemp("project")) as page:
        page.wait(lambda state: state["numbers"].get("estimates"))
        yield page


def check_of(page, kind, holds):
    assert page.post("test", kind=kind).status_code == 200
    return page.wait(lambda state: holds(state["check"]))["check"]


def test_shunt_check_of_a_source_that_switches_it(running) -> None:
    found = check_of(running, "shunt", lambda check: check.get("rows"))
    (row,) = found["rows"]
    assert (row["channel"], row["unit"], row["expected"], row["verdict"]) == ("AF", "N", 800.0, "passed")
    # means of 1 s each of 10 N noise: 0.35 N together
    assert row["change"] == pytest.approx(800, abs=5 * 0.36)
    assert running.client.get("/api/state").json()["check"]["text"] == "shunt check passed"
    # switched off again
    running.wait(lambda state: abs(state["numbers"]["readings"]["AF"]["mean"] + 1020) < 50)


def test_contact_and_checks_are_in_the_record(running) -> None:
    check_of(running, "shunt", lambda check: check.get("rows"))
    assert running.post("record", name="touched").status_code == 200
    check_of(running, "return", lambda check: check.get("waiting"))
    running.wait(lambda state: state["record"].get("blocks", 0) >= 2)
    assert running.post("control", name="touch", value=1).status_code == 200
    running.wait(lambda state: state["numbers"]["touching"])
    assert running.post("control", name="release", value=1).status_code == 200
    begin = running.wait(lambda state: not state["numbers"]["touching"])["record"]["seconds"]
    # rings down from 100 N, 1 / (zeta w0) = 0.43 s of the source, which a busy machine may keep waiting
    running.wait(lambda state: state["record"]["seconds"] > begin + 3)
    found = check_of(running, "return", lambda check: check.get("rows"))
    assert found["rows"][0]["verdict"] == "passed"
    assert found["text"] == "return to zero passed; the contact circuit closed 1 time(s) meanwhile"
    # said when all of it is noted in the record, a moment after it is shown
    running.wait(lambda state: any(item["text"].startswith(found["text"]) for item in state["messages"]))
    assert running.post("stop").status_code == 200
    state = running.client.get("/api/state").json()
    assert state["record"]["touched"] == 1
    assert any("the loads read then carry the force of the contact" in item["text"] for item in state["messages"])
    kept = contents(running.folder / "touched.h5").events
    kinds = [bytes(kind).rstrip(b"\0").decode() for kind in kept["kind"]]
    assert kinds.count("contact") == kinds.count("contact over") == 1
    texts = b"\n".join(bytes(text).rstrip(b"\0") for text in kept["text"]).decode()
    assert "shunt check passed: AF changed by" in texts  # of before the record
    assert "return to zero passed: AF changed by" in texts
    with pytest.warns(DataQualityWarning, match=r"touched \(.* s to .* s\): the loads read then carry"):
        read(running.folder / "touched.h5")


def test_checks_that_cannot_be_done(running, seed) -> None:
    assert running.post("test", kind="nothing").status_code == 422
    check_of(running, "return", lambda check: check.get("waiting"))
    assert running.post("give_up").status_code == 200
    assert running.client.get("/api/state").json()["check"] == {}
    given = {"source": {"kind": "simulated", "rig": "cable_cut", "seed": seed}}
    assert running.post("setup", setup=given).status_code == 200
    running.wait(lambda state: state["source"]["state"] == "running" and state["numbers"].get("readings"))
    answer = running.post("test", kind="shunt")
    assert answer.status_code == 409 and "does not say what the shunt should change" in answer.json()["error"]
    running.wait(lambda state: state["numbers"].get("touching", True) is None)


def test_combined_loads_end_the_record(running, seed) -> None:
    given = {
        "source": {"kind": "simulated", "rig": "cable_cut", "cable_force": -1020.0, "seed": seed},
        "stations": {"root": {"limit": 500.0, "AF": 0.5}},
        "envelope": {"shape": "stations", "action": "stop"},
    }
    assert running.post("setup", setup=given).status_code == 200
    with running.client.websocket_connect("ws://127.0.0.1:8765/live") as viewer:
        limit = time.monotonic() + 120
        found = None
        while found is None and time.monotonic() < limit:
            message = viewer.receive()
            if message.get("bytes"):
                viewer.send_json({"shown": struct.unpack_from("<I", message["bytes"], 4)[0]})
            elif (numbers := json.loads(message["text"]))["type"] == "numbers":
                found = numbers.get("envelope")
    assert found["nearest"] == "root: AF"
    # 510 of 500, and the largest of 320 readings whose half has 5 N of noise
    assert 1.02 < found["share"] < 1.02 + 0.01 * 6
    assert math.isclose(found["parts"]["AF"], found["share"])
    assert running.post("record", name="over").status_code == 200
    state = running.wait(lambda state: state["record"]["state"] == "ended")
    assert "limit: combined loads take up" in state["record"]["reason"]
    assert contents(running.folder / "over.h5").reason == state["record"]["reason"]
