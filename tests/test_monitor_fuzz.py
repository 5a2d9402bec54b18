"""Whatever is sent to the page: no crash, nothing outside the project folder, and a page that still works."""

import copy
import json
import math
import time
import warnings

import numpy as np
import pytest

from aerobalance.acquisition.feed import SourceInfo
from aerobalance.acquisition.intake import Intake
from aerobalance.acquisition.planned import plan_of
from aerobalance.acquisition.setup import parse_setup, setup_from, setup_text, stored_channels
from aerobalance.acquisition.sources import open_source
from aerobalance.app.monitor.form import form_of
from aerobalance.app.monitor.panels import panel_of
from aerobalance.app.monitor.setups import rig_setup
from aerobalance.app.monitor.view import View
from aerobalance.recording.errors import FitError, ReadError
from helpers.running_page import LIVE, Running

RIGS = ("cable_cut", "vibration", "six")
PIECES = [
    b"{", b"}", b'"name"', b":", b"[", b"1e999", b"null", b"\xff\xfe", b"../", b'"setup"', b",", b"\0", b"[" * 300,
    b'"AF"', b"-1", b"NaN",
]  # fmt: skip
PATHS = [
    "../secret.h5", "/etc/passwd", "..", ".", "", "a/../../b", "out.h5", "link/secret.h5", "run.h5", "run", "x" * 200,
    "con.h5", "run.h5\0", "..\\secret.h5", "%2e%2e/secret.h5", "~/x.h5", "-o", "run-dynamics.json", "a\nb", "ä.h5",
]  # fmt: skip
NUMBERS = [0.0, -0.0, 1.0, -1.0, 0.5, 5e-324, 1e-300, -1e300, 1e308, 1e-9, 100.0, 652.5, 1e6, -1e6, math.inf, 2]
WORDS = [
    "AF",
    "rAF",
    "NF",
    "x",
    "stop",
    "mark",
    "N",
    "lbf",
    "dc",
    "ac",
    "up",
    "level",
    "time",
    "ellipsoid",
    "stations",
]


class Chance:
    """Random requests and set-ups."""

    def __init__(self, seed) -> None:
        self.rng = np.random.default_rng(seed)

    def one(self, of):
        return of[int(self.rng.integers(len(of)))]

    def rubbish(self):
        return b"".join(self.one(PIECES) for _ in range(self.rng.integers(1, 12)))

    def number(self):
        return (
            self.one(NUMBERS) if self.rng.random() < 0.6 else float(self.rng.normal() * 10.0 ** self.rng.integers(5))
        )

    def value(self):
        plain = [None, True, [], {}, [1.0, 2.0, 3.0], {"AF": {}}]
        return self.one([self.number(), self.one(WORDS), self.one(PATHS), self.one(plain), self.number()])

    def setup(self):
        """The set-up of a rig with some of its values replaced, or some more."""
        given = rig_setup(self.one(RIGS))
        tree = given.model_dump(exclude_none=True, exclude_unset=True)
        tree["source"] = given.source.model_dump(exclude_none=True, exclude_unset=True)
        for _ in range(self.rng.integers(1, 4)):
            form = form_of(given, None)
            table = self.one(
                ["files", "record", "envelope", "fouling", "channels", "limits", "stations", "shunt", "source"]
            )
            if table == "source":
                place, fields = tree["source"], form["sources"][self.one(["simulated", "simulated", "replay"])]
            elif table in form["tables"]:
                name = self.one([*tree.get(table, {}), self.one(WORDS)])
                place, fields = tree.setdefault(table, {}).setdefault(name, {}), form["tables"][table]
            else:
                place, fields = tree.setdefault(table, {}), form[table]
            field = self.one(fields)
            choices = field.get("choices")
            numeric = field["type"] == "number" and self.rng.random() < 0.9
            place[field["key"]] = self.number() if numeric else self.one(choices) if choices else self.value()
        return tree

    def accepted(self):
        """One that is a set-up, and its source as fast as it can."""
        while True:
            tree = self.setup()
            tree["source"] |= {"kind": "simulated", "speed": math.inf}
            try:
                return setup_from(tree)
            except ReadError:
                pass

    def request(self):
        """An action and its body, which often makes sense."""
        name, word, number = self.one(PATHS), self.one(WORDS), self.number()
        bodies = {
            "record": {"name": name, "notes": word, "seconds": self.one([None, number])},
            "check": {"setup": self.setup(), "name": name},
            "job": {"verb": self.one(["info", "decay", "rig", "force", "together"]), "recording": name, "mass": "1e3"},
            "use": {"recording": name},
            "control": {"name": self.one(["cut", "hang", "touch", "release", "frequency", word]), "value": number},
            "mark": {"text": name},
            "test": {"kind": self.one(["shunt", "return", word])},
            "rig": {"rig": word},
        }
        action = self.one([*bodies, "stop", "trigger", "zero", "clear_zero", "give_up", "cancel", "sweep", "nothing"])
        body = bodies.get(action, {})
        if body and self.rng.random() < 0.2:
            body[self.one(list(body))] = self.value()
        return action, body


@pytest.fixture
def project(tmp_path):
    """A project folder with links that lead out of it, and what is around it."""
    folder = tmp_path / "around" / "project"
    folder.mkdir(parents=True)
    (tmp_path / "around" / "secret.h5").write_bytes(b"secret")
    (folder / "out.h5").symlink_to(tmp_path / "around" / "secret.h5")
    (folder / "link").symlink_to(tmp_path / "around")
    return folder


def outside(folder):
    around = folder.parent
    return {
        path: path.read_bytes() if path.is_file() else None
        for path in around.rglob("*")
        if not path.is_relative_to(folder)
    }


def send(page, action, content):
    began = time.monotonic()
    answer = page.client.post(f"/api/{action}", content=content)
    # a source that does not start is given up after 60 s
    assert time.monotonic() - began < 70.0
    assert answer.status_code in (200, 400, 404, 405, 409, 413, 422), (answer.status_code, answer.text)
    return answer


def works(page):
    """The page can be brought back to what it is for: a source, a record of it, and its end."""
    page.client.post("/api/stop", json={})
    assert page.post("rig", rig="cable_cut").status_code == 200
    page.wait(lambda state: state["source"]["state"] == "running" and state["numbers"].get("readings"))
    name = f"proof-{time.monotonic_ns()}"
    assert page.post("record", name=name).status_code == 200
    page.wait(lambda state: state["record"].get("blocks", 0) >= 2)
    assert page.post("stop").status_code == 200
    assert (page.folder / f"{name}.h5").stat().st_size > 0


def fuzz(folder, chance, *, requests, frames, setups):
    before = outside(folder)
    with Running(folder) as page:
        page.wait(lambda state: state["numbers"].get("estimates"))
        for _ in range(requests):
            send(page, chance.one(["record", "mark", "job", "setup", "%00", "zero" + "/" * 5]), chance.rubbish())
            action, body = chance.request()
            send(page, action, json.dumps(body).encode())
        with page.client.websocket_connect(LIVE) as socket:
            for number in range(frames):
                data = chance.rubbish()
                socket.send_bytes(data) if chance.rng.random() < 0.5 else socket.send_text(data.decode("latin-1"))
                key = chance.one(["shown", "level", "component", "ping", "x"])
                socket.send_text(json.dumps({key: chance.value()}))
                if number % 100 == 99:
                    socket.send_json({"ping": number, "shown": 2**62})
                    while json.loads(socket.receive().get("text") or "{}").get("ping") != number:
                        pass
        works(page)
        for _ in range(setups):
            page.client.post("/api/stop", json={})
            send(page, "setup", json.dumps({"setup": chance.setup(), "name": chance.one([None, *PATHS])}).encode())
            send(page, "record", json.dumps({"name": f"run-{chance.rng.integers(10**9)}"}).encode())
        works(page)
    assert outside(folder) == before


def run_through(setup, folder):
    """Use a set-up as the page and the recorder do, in this process; return how far it comes."""
    assert parse_setup(setup_text(setup)) == setup
    form_of(setup, None)
    try:
        source = open_source(setup, folder)
        channels = stored_channels(setup, source.channels)
        panel = panel_of(setup, _hello(source), folder, {})
    except (FitError, ReadError, ValueError):
        return "refused"
    source.start()
    blocks = [block for _ in range(6) if (block := source.read(0.01)) is not None]
    view = View(panel)
    for block in blocks:
        view.feed(block)
        view.take()
    for line in view.lines.values():
        line.due()
    try:
        plan = plan_of(setup, channels, source.rate, balance=None)
    except FitError:
        return "not recorded"
    intake = Intake(plan, clocked=source.clocked)
    for block in blocks:
        intake.feed(block)
    return "recorded"


def _hello(source):
    return SourceInfo(tuple(source.channels), source.rate, source.clocked, source.description, tuple(source.controls))


def try_setups(chance, folder, count):
    came = []
    with warnings.catch_warnings():
        # numbers of 1e308 overflow, which costs a chart and no process
        warnings.simplefilter("ignore", RuntimeWarning)
        for _ in range(count):
            setup = chance.accepted()
            kept = copy.deepcopy(setup)
            came.append(run_through(setup, folder))
            assert setup == kept
    assert came.count("recorded") > 0
    return came


def test_any_set_up_that_is_accepted_can_be_used_or_is_refused(tmp_path, seed) -> None:
    try_setups(Chance(seed), tmp_path, 8)


@pytest.mark.long
def test_thousands_of_set_ups(tmp_path, seed) -> None:
    came = try_setups(Chance(seed), tmp_path, 1000)
    print({kind: came.count(kind) for kind in set(came)})  # noqa: T201 - shown with -s


@pytest.mark.long
def test_thousands_of_requests(project, seed) -> None:
    fuzz(project, Chance(seed), requests=2000, frames=4000, setups=40)
