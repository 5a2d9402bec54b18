"""What all tests share: random numbers, processes that begin at once, and one run of the demo."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest_plugins = ["seeds"]
pytest.register_assert_rewrite("helpers")

STARTERS = ("aerobalance.acquisition.session", "aerobalance.app.monitor.workers")
LOADED = [
    "aerobalance.acquisition.simulated",
    "aerobalance.acquisition.recorder",
    "aerobalance.app.monitor.engine",
    "aerobalance.app.monitor.learner",
    "aerobalance.app.monitor.jobs",
]


@pytest.fixture(scope="session", autouse=True)
def quick_starts() -> Iterator[None]:
    """Let sources, recorders and engines begin from a process that has their libraries loaded, where there is fork.

    Each is a process of its own as it is in use, and may be killed; but some two hundred of them do not each take
    seconds to load the same. Programs that a test runs start theirs as in use.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        yield
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(LOADED)
    with pytest.MonkeyPatch.context() as patch:
        for starter in STARTERS:
            patch.setattr(f"{starter}._SPAWN", context)
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


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Return one more than there are processors: a part of the tests waits for clocks and for other programs."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return 1 + (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
