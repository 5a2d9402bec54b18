"""The session behind the page: a source, its records, zeros and checks, and the tasks; what the buttons act on."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from aerobalance.acquisition.setup import Setup, save_setup
from aerobalance.app.monitor.alarms import Alarms
from aerobalance.app.monitor.campaigns import CampaignWatch
from aerobalance.app.monitor.checks import Checks
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.live_source import LiveSource
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.messages import Answer, Means, News, Watching, Zeros
from aerobalance.app.monitor.records import Records
from aerobalance.app.monitor.setups import check_files, check_set_up
from aerobalance.app.monitor.stepped_sine import SteppedSineRun
from aerobalance.app.monitor.tasks import Tasks
from aerobalance.app.monitor.workers import EngineProcesses
from aerobalance.io.locked_file import recover_all

POLLED: Final = 0.1
"""Time between looks at source and recorder [s]."""

PATIENCE: Final = 0.2
"""Time that ending waits for what is under way [s]."""

ENDING: Final = 0.9
"""Time that ending takes at most [s]."""


class Beginning(NamedTuple):
    """What a page begins with: a test set-up, the project folder, and where the set-up was read from, or None."""

    setup: Setup
    folder: Folder
    setup_file: Path | None


class MonitorSession:
    """Everything behind the page.

    Parameters
    ----------
    begin
        What it begins with.
    heard
        Takes what the engine has found, in a thread of its own.
    changed
        Called when the state has changed, in some thread.
    mark
        Takes an event for the charts and its kind, in some thread.
    """

    def __init__(
        self,
        begin: Beginning,
        *,
        heard: Callable[[Watching | News], None],
        changed: Callable[[], None],
        mark: Callable[[str, str], None],
    ) -> None:
        setup, self.folder, self.setup_file = begin
        self._heard = heard
        self._lock = threading.RLock()
        self._closed = False
        self.log = log = Log(changed, mark)
        self.sweep: SteppedSineRun | None = None
        for found in recover_all(self.folder.path):
            text = "its record was broken off by a kill after it had lost its name; what was written is in it"
            log.say(f"{found.name} is back: {text}", kind="error")
        self.alarms = Alarms(changed)
        self.source = LiveSource(setup, self.folder.path, EngineProcesses(self._answer), log=log, lock=self._lock)
        self.records = Records(self.folder, self.source, log=log, lock=self._lock)
        self.checks = Checks(self.source, self.records, log)
        self.tasks = Tasks(self.folder, self.source, self.records, log)
        self.campaign = CampaignWatch(self.folder, log)
        threading.Thread(target=self._watch_over, daemon=True).start()

    # ---- what the buttons do

    def open(self, setup: Setup | None = None) -> None:
        """Start the source of a set-up in the place of the one before.

        Raises
        ------
        ValueError
            A record is under way.
        """
        with self._lock:
            self.records.refuse_under_way("stop it before the source is changed")
            self.records.forget()
            self.checks.forget()
            self.alarms.leave()
            self.source.open(setup or self.source.setup)

    def begin_sweep(self) -> None:
        """Begin a stepped-sine run.

        Raises
        ------
        FitError, ValueError
            The source has no drive, or cannot be recorded.
        """
        with self._lock:
            if self.sweep is not None and self.sweep.shown["running"]:
                raise ValueError("a stepped-sine run is under way already")
            names = {item["name"] for item in self.folder.with_results()}
            self.sweep = sweep = SteppedSineRun(self.source, self.records, self.tasks, self.log, taken=names)
            sweep.start()

    def zero(self) -> None:
        """Take off what the loads read now, the weight apart."""
        self.records.refuse_under_way("its zero stays as it is until it has ended")
        self.source.take_zeros()

    def clear_zero(self) -> None:
        """Show the loads as they are read."""
        self.records.refuse_under_way("its zero stays as it is until it has ended")
        self._set_zeros({})

    def _set_zeros(self, zeros: dict[str, float]) -> None:
        self.checks.give_up()
        self.source.set_zeros(zeros)

    def apply(self, setup: Setup, *, name: str | None) -> None:
        """Use another set-up, and save it under a name where one is given.

        Raises
        ------
        ValueError
            A record is under way, a file of the set-up is outside the folder, or it cannot be saved.
        """
        with self._lock:
            self.records.refuse_under_way("stop it before the set-up is changed")
            check_files(setup, self.folder)
            if name is not None:
                path = self.folder.file(name if name.endswith(".toml") else f"{name}.toml")
                if path.exists():
                    check_set_up(path)
                save_setup(path, setup)
                self.setup_file = path
            self.open(setup)

    def use_dynamics(self, recording: str) -> None:
        """Work out the live force with the dynamics that were identified from a recording.

        Raises
        ------
        ValueError
            A record is under way, or nothing was identified from it.
        """
        name = f"{Path(recording).stem}-dynamics.json"
        if not self.folder.file(name).is_file():
            raise ValueError(f"there is no {name}: identify {recording[:80]} first")
        setup = self.source.setup
        files = setup.files.model_copy(update={"dynamics": name})
        self.apply(setup.model_copy(update={"files": files}), name=None)
        self.log.say(f"the live force is worked out with {name}", kind="done")

    # ---- what is heard, and what is watched over

    def _answer(self, answer: Answer) -> None:
        source, number = self.source, self.source.state.number
        if isinstance(answer, Watching):
            if answer.number == number:
                source.watching = answer
                self._heard(answer)
                self.log.changed()
        elif isinstance(answer, News):
            self.checks.watch(answer.update.remarks)
            if answer.number == number:
                self.alarms.watch(answer.update, source.watching)
            self._heard(answer)
        elif isinstance(answer, Means):
            self.checks.heard(answer)
        elif isinstance(answer, Zeros):
            self._set_zeros(dict(answer.zeros))
        elif answer.number in (-1, number):
            if answer.number != -1:  # an engine that is started again will follow
                source.unwatched()
                if answer.text.startswith("the source ended"):
                    return  # the source's own word says it better
            self.log.say(answer.text, kind="error")

    def _watch_over(self) -> None:
        while not self._closed:
            time.sleep(POLLED)
            with contextlib.suppress(OSError), self._lock:
                for message in self.source.news():
                    if message.kind == "done":
                        self.checks.done(message.text)
                        self.log.mark(message.text, kind="control")
                        self.records.note(message.text, shown=False)
                self.records.look()

    def processes(self) -> dict[str, int | None]:
        """Numbers of the processes behind the page, for whoever looks after the computer."""
        engine, session, recorder = self.source.engine, self.source.session, self.records.recorder
        running = {"engine": engine.process, "learner": engine.learner, "jobs": self.tasks.process}
        running["campaign"] = self.campaign.process
        if session is not None:
            running["source"] = session.process
        if recorder is not None:
            running["recorder"] = recorder.process
        return {name: process.pid for name, process in running.items() if process is not None and process.is_alive()}

    def close(self, *, timeout: float = ENDING) -> None:
        """End everything within a time [s], the record first: its file is closed."""
        if self._closed:
            return
        self._closed = True
        limit = time.monotonic() + timeout
        self.tasks.close()
        self.campaign.close()
        self.source.engine.close()
        # whatever holds the lock (a source that is just starting) has nothing yet that could be lost
        held = self._lock.acquire(timeout=PATIENCE)
        try:
            self.records.close(timeout=max(0.1, 0.75 * (limit - time.monotonic())))
            self.source.close(timeout=max(0.1, limit - time.monotonic()))
        finally:
            if held:
                self._lock.release()
