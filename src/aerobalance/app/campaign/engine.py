"""Many runs at once: processes of this machine, or a Dask scheduler at an address; the same results everywhere.

A run is a task, so that a worker that is lost costs what it was working on and nothing else. What is done is in the
folder of results before a task is over: a scheduler that is started anew is given the rest.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urljoin
from urllib.request import ProxyHandler, build_opener

from aerobalance.app.campaign.places import MissingLibraryError
from aerobalance.app.campaign.results import Results
from aerobalance.app.campaign.rows import Row, set_aside
from aerobalance.app.campaign.work import Report, RunWork, work_on
from aerobalance.recording.blas_threads import VARIABLES
from aerobalance.recording.errors import FitError

if TYPE_CHECKING:
    from distributed import Client

SETTINGS_OF_PROCESSES: Final = {
    **dict.fromkeys(VARIABLES, "1"),
    "MALLOC_MMAP_THRESHOLD_": "33554432",
    "MALLOC_TRIM_THRESHOLD_": "268435456",
}
"""Environment of a worker: one thread of the linear algebra; arrays are kept, and not given back after each use."""

FEW_LOOKS: Final = {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "1s"}
"""Dask looks at itself every 10 to 20 ms, in each process and in this one, which takes from the runs."""

PATIENCE: Final = 120.0
"""How long a scheduler that is gone, or one without workers, is waited for [s]."""

ANSWER: Final = 10.0
"""How long the first answer of a scheduler is waited for [s]."""

ASKED: Final = 2.0
"""How long a scheduler is waited for that is asked for its dashboard [s]."""

LONGEST_ANSWER: Final = 1 << 16
"""Bytes of the answer to that which are read."""

FEW: Final = 8
"""Runs up to which no processes are started for them: two processes take as long to start as five short runs take."""

LOSSES: Final = 2
"""Workers that a run may cost before it is set aside."""


@dataclass(frozen=True, slots=True)
class Engine:
    """Where the work is done.

    Attributes
    ----------
    scheduler
        Address of a Dask scheduler; None for processes of this machine.
    workers
        Processes of this machine; 0 for this process itself, None for one per processor where there are enough runs.
    patience
        How long a scheduler that is gone is waited for [s].
    told
        Takes what there is to say, such as where the dashboard is.
    """

    scheduler: str | None = None
    workers: int | None = None
    patience: float = PATIENCE
    told: Callable[[str], None] = field(default=lambda text: None)

    def rows(self, tasks: Sequence[RunWork], report: Report | None = None) -> Iterator[tuple[RunWork, Row]]:
        """Do all work and give the rows, as they come.

        Raises
        ------
        FitError
            The scheduler is gone, or has no workers, for longer than it is waited for.
        ValueError
            No scheduler answers; results cannot be written; Dask is not installed.
        """
        if not tasks:
            return
        alone = self.workers == 0 or (self.workers is None and len(tasks) <= FEW)
        if self.scheduler is None and alone:
            for task in tasks:
                yield task, work_on(task, report)
            return
        _need_dask()
        left = {task.run.name: task for task in tasks}
        if self.scheduler is None:
            with self._processes(len(tasks)) as client:
                yield from self._done_by(client, left, report)
            if left:
                raise FitError("the processes of this machine ended before all runs were done; call again to go on")
            return
        with _quiet_client():
            yield from self._by_scheduler(self.scheduler, left, report)

    def _by_scheduler(
        self, address: str, left: dict[str, RunWork], report: Report | None
    ) -> Iterator[tuple[RunWork, Row]]:
        """Give rows of what a scheduler's workers do, and take them off what is left, however often it starts anew."""
        first, gone_since = True, time.monotonic()
        while left:
            count = len(left)
            try:
                with self._at(address, wait=ANSWER) as client:
                    first = False
                    yield from self._done_by(client, left, report)
                    if left and client.status != "running":
                        self.told(f"the scheduler {address} is gone; waiting up to {self.patience:g} s for it")
            except _GoneError as problem:
                if first:
                    raise ValueError(
                        f"no Dask scheduler answers at {address} ({problem}); start one with dask scheduler"
                    ) from None
            if len(left) < count:
                gone_since = time.monotonic()
            if left and time.monotonic() - gone_since > self.patience:
                raise FitError(
                    f"the scheduler {address} has been gone for {self.patience:g} s; {len(left)} runs are not "
                    "done. What is done is kept: call again to go on"
                )
            for name, task in list(left.items()):  # what was done while nobody could say so
                row = Results(task.out).known(name, task.key)
                if row is not None:
                    del left[name]
                    yield task, row
            if left:
                time.sleep(min(1.0, self.patience / 10))

    @contextmanager
    def _processes(self, tasks: int) -> Iterator[Client]:
        import dask  # noqa: PLC0415 - of an extra
        from distributed import Client, LocalCluster  # noqa: PLC0415

        _quiet_tracker()
        count = min(tasks, self.workers or _processors())
        with (
            dask.config.set(
                {
                    "distributed.nanny.pre-spawn-environ": SETTINGS_OF_PROCESSES,
                    "distributed.scheduler.allowed-failures": LOSSES,
                    "logging.distributed": "critical",
                    **FEW_LOOKS,
                }
            ),
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):
            self._tell_dashboard(client)
            yield client

    @contextmanager
    def _at(self, address: str, *, wait: float) -> Iterator[Client]:
        from distributed import Client  # noqa: PLC0415 - of an extra

        try:
            client = Client(address, timeout=wait, set_as_default=False)
        except (OSError, TimeoutError) as problem:
            raise _GoneError(" ".join(str(problem).split())[:200] or type(problem).__name__) from None
        except ValueError as problem:
            raise ValueError(f"{address} is no address of a scheduler such as tcp://host:8786 ({problem})") from None
        try:
            self._tell_dashboard(client)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=2)

    def _tell_dashboard(self, client: Client) -> None:
        services = client.scheduler_info().get("services", {})
        link = client.dashboard_link if "dashboard" in services else ""
        there = find_spec("bokeh") is not None if self.scheduler is None else bool(link) and _has_dashboard(link)
        if there and link:
            self.told(f"dashboard: {link}")

    def _done_by(
        self, client: Client, left: dict[str, RunWork], report: Report | None
    ) -> Iterator[tuple[RunWork, Row]]:
        """Give rows as workers are done, and take them off what is left; end where the scheduler is lost."""
        from distributed import as_completed  # noqa: PLC0415 - of an extra

        self._wait_for_workers(client)
        # Dask takes tasks for alike by the words of their names before the first that has a digit, and gives out of
        # such only what workers are free for: one that is lost then takes few with it
        futures = {
            client.submit(work_on, task, report, key=f"aerobalance-{task.key[:16]}-{name}", pure=False): task
            for name, task in left.items()
        }
        waiting = as_completed(list(futures), loop=client.loop, raise_errors=False)
        for future in waiting:
            task = futures.pop(future)
            row = _row_of(future, task)
            if row is None:
                continue
            del left[task.run.name]
            yield task, row

    def _wait_for_workers(self, client: Client) -> None:
        try:
            client.wait_for_workers(1, timeout=self.patience)
        except (OSError, TimeoutError):
            raise FitError("the scheduler has no workers; start some with dask worker") from None


class _GoneError(Exception):
    """A scheduler does not answer."""


def _row_of(future: Any, task: RunWork) -> Row | None:
    """The row of a task that is over; None where the scheduler lost it."""
    from distributed import KilledWorker  # noqa: PLC0415 - of an extra

    if future.status == "finished":
        try:
            found: Any = future.result(timeout=ANSWER)
        except Exception:  # noqa: BLE001 - the worker that holds it is gone, and the row is in the folder
            return Results(task.out).known(task.run.name, task.key)
        future.release()
        return dict(found)
    if future.status != "error":
        return None
    problem = future.exception(timeout=ANSWER)
    if isinstance(problem, KilledWorker):
        return set_aside(
            task.run,
            f"its worker process ended {LOSSES + 1} times while it was worked on: it may need more memory",
        )
    if isinstance(problem, Exception):
        raise problem
    return None


def _has_dashboard(link: str) -> bool:
    """Return whether there is a dashboard at a link: a scheduler without one has a link and serves other pages."""
    own = ProxyHandler({})  # the machines of a test are in one network
    with suppress(Exception), build_opener(own).open(urljoin(link, "/individual-plots.json"), timeout=ASKED) as page:
        return bool(json.loads(page.read(LONGEST_ANSWER)))
    return False


def _need_dask() -> None:
    if find_spec("distributed") is None:
        raise MissingLibraryError("distributed")


@contextmanager
def _quiet_client() -> Iterator[None]:
    """Keep to itself what Dask logs of a scheduler that is gone: a traceback of what is waited for."""
    import distributed  # noqa: F401, PLC0415 - of an extra; it sets the level when it is loaded

    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def _quiet_tracker() -> None:
    """Start the process that tidies up after others so that it does not complain where Ctrl-C ended these."""
    from multiprocessing import resource_tracker  # noqa: PLC0415 - few calls need it

    quiet = "ignore:resource_tracker"
    sys.warnoptions.append(quiet)
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.remove(quiet)


def _processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
