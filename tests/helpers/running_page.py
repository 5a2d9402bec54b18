"""The page in the process of a test, with the processes behind it."""

import json
import math
import time

from starlette.testclient import TestClient

from aerobalance.acquisition.simulated import RigSettings, SimulatedSource
from aerobalance.app.monitor.access import AccessPolicy
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.server import Page
from aerobalance.app.monitor.session import Beginning
from aerobalance.app.monitor.setups import rig_setup
from seeds import new_seed

BASE = "http://127.0.0.1:8765"
LIVE = "ws://127.0.0.1:8765/live"


class Running:
    """A page in this process, with the processes behind it."""

    def __init__(self, folder, rig="cable_cut", **policy):
        self.folder = folder
        setup = rig_setup(rig)
        setup = setup.model_copy(update={"source": setup.source.model_copy(update={"seed": new_seed()})})
        self.page = Page(Beginning(setup, Folder(folder), None), policy=AccessPolicy("127.0.0.1", 8765, **policy))
        self.client = TestClient(self.page.app, base_url=BASE, headers={"origin": BASE})

    def __enter__(self):
        self.client.__enter__()
        self.wait(lambda state: state["source"]["state"] == "running")
        return self

    def __exit__(self, *error):
        self.client.__exit__(*error)

    def post(self, action, **body):
        return self.client.post(f"/api/{action}", json=body)

    def wait(self, holds, timeout=120.0):
        limit = time.monotonic() + timeout
        while time.monotonic() < limit:
            state = self.client.get("/api/state").json()
            if holds(state):
                return state
            time.sleep(0.05)
        raise AssertionError(f"not within {timeout} s: {json.dumps(state)[:3000]}")


def source_of(rig, **settings):
    source = SimulatedSource(RigSettings(rig=rig, speed=math.inf, **({"seed": new_seed()} | settings)))
    source.start()
    return source
