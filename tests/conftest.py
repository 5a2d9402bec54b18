"""What all tests share: random numbers, and one run of the demo."""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aerobalance.acquisition.processes import load_beforehand

# as the page does: what its processes need is named before a test starts the first process
load_beforehand("numba", *(f"aerobalance.app.monitor.{name}" for name in ("engine", "learner", "jobs")))

# Four thousand tests are collected, and are kept to the end: going through them for what may be thrown away takes each
# process 5 s while they are made, and 3 % of the time of the tests afterwards.
gc.disable()

pytest_plugins = ["seeds"]
pytest.register_assert_rewrite("helpers")


@pytest.fixture(autouse=True)
def threads(request: pytest.FixtureRequest) -> Iterator[None]:
    """One thread for each process of the tests: they have all processors, and a second costs a tenth of the time.

    What is marked so has the threads that a user has, as commands in processes of their own do.
    """
    from aerobalance.recording.side_by_side import one_after_the_other

    alone = "PYTEST_XDIST_WORKER" in os.environ and request.node.get_closest_marker("threads") is None
    with one_after_the_other() if alone else contextlib.nullcontext():
        yield


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder of the demo and its account, not to be written to; run once for all processes of the tests."""
    from aerobalance.app.demos.demo import run_demo
    from aerobalance.recording.errors import DataQualityWarning
    from seeds import new_seed, running

    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ and os.name != "nt":
        shared = shared.parent
    folder, kept = shared / "demo", shared / "demo.pickle"
    with one_at_a_time(shared / "demo.lock"):
        if not kept.exists():
            with running("the demo"):  # whichever test comes first
                seed = new_seed()
            with pytest.warns(DataQualityWarning, match="not steady"):  # the unsteady record is there to be doubted
                kept.write_bytes(pickle.dumps(run_demo(folder, seed=seed)))
    return folder, pickle.loads(kept.read_bytes())


@contextlib.contextmanager
def one_at_a_time(file: Path) -> Iterator[None]:
    """Wait until no other process of the tests is here, where they share folders."""
    with file.open("w") as lock:
        with contextlib.suppress(ImportError):
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Return two more than there are processors: a part of the tests waits for clocks and for other processes."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return 2 + (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
