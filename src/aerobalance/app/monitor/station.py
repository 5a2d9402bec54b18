"""The station: one source, at most one record of it, the zeros, the tasks; what the page's buttons act on."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from aerobalance.acquisition.recorder import Progress, Tell
from aerobalance.acquisition.session import Recorder, Session
from aerobalance.acquisition.setup import Setup, save_setup, setup_text
from aerobalance.app.monitor.alarms import Alarms
from aerobalance.app.monitor.checks import Checks
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.messages import Answer, Means, News, SetZeros, TakeZeros, Watch, Watching, Zeros
from aerobalance.app.monitor.setups import check_files, check_set_up, first_controls, setup_of_record
from aerobalance.app.monitor.sweep import Sweep
from aerobalance.app.monitor.tasks import Tasks
from aerobalance.app.monitor.workers import Engine
from aerobalance.io.held_file import recover_all
from aerobalance.recording.errors import FitError, ReadError

POLLED: Final = 0.1
"""Time between looks at source and recorder [s]."""

STARTING: Final = 60.0
"""Time that a recorder has to start [s]."""

CLOSING: Final = 10.0
"""Time that a recorder has to close its file, on a computer that is busy [s]."""

UNWATCHED: Final = 20.0
"""Time after which a source begins although the charts do not follow it yet [s]."""

PATIENCE: Final = 0.2
"""Time that ending waits for what is under way [s]."""

ENDING: Final = 0.9
"""Time that ending takes at most [s]."""

MESSAGES: Final = 50
"""Messages that are kept."""


@dataclass(slots=True)
class Source:
    """How the source stands: ``starting``, ``running``, ``ended`` or ``failed``."""

    state: str = "starting"
    text: str = ""
    number: int = 0


class Beginning(NamedTuple):
    """What a page begins with: a test set-up, the project folder, and where the set-up was read from, or None."""

    setup: Setup
    folder: Folder
    setup_file: Path | None


class Station:
    """Everything behind the page.

    Parameters
    ----------
    begin
        What it begins with.
    heard
        Takes what the engine has found, in a thread of its own.
    changed
        Called when the state has changed, in some thread.
    """

    def __init__(
        self, begin: Beginning, *, heard: Callable[[Watching | News], None], changed: Callable[[], None]
    ) -> None:
        self.setup, self.folder, self.setup_file = begin
        self._heard, self.changed = heard, changed
        self._lock = threading.RLock()
        self._closed = False
        self._numbers = itertools.count(1)
        self.source = Source()
        self.session: Session | None = None
        self.recorder: Recorder | None = None
        self.progress: Progress | None = None
        self.zeros: dict[str, float] = {}
        self.controls: dict[str, float] = {}
        self.watching: Watching | None = None
        self._held_since, self._unwatched = 0.0, False
        self.messages: deque[dict[str, Any]] = deque(maxlen=MESSAGES)
        self._message_numbers = itertools.count(1)
        self.marker: Callable[[str, str], None] = lambda *_: None
        self.listed_version = 0
        self.sweep: dict[str, Any] | None = None
        for found in recover_all(self.folder.path):
            text = "its record was broken off by a kill after it had lost its name; what was written is in it"
            self.say(f"{found.name} is back: {text}", kind="error")
        self.checks = Checks(self)
        self.alarms = Alarms(changed)
        self.engine = Engine(self._answer)
        self.tasks = Tasks(self)
        threading.Thread(target=self._watch_over, daemon=True).start()

    # ---- source

    def open(self, setup: Setup | None = None) -> None:
        """Start the source of a set-up in the place of the one before.

        Raises
        ------
        ValueError
            A record is under way.
        """
        with self._lock:
            if self.recording:
                raise ValueError("a record is under way; stop it before the source is changed")
            setup = setup or self.setup
            self.setup = setup
            if self.session is not None:
                self.session.close()
                self.session = None
            number = next(self._numbers)
            self.source = Source("starting", "the source is starting", number)
            self.zeros, self.recorder, self.progress, self.watching = {}, None, None, None
            self.checks.forget()
            self.alarms.leave()
            self.changed()
            try:
                self.session = Session(setup, self.folder.path)
            except (FitError, ReadError, ValueError, OSError) as problem:
                self.source = Source("failed", str(problem), number)
                self.say(f"the source cannot be used: {problem}", kind="error")
                return
            self.controls = first_controls(setup)
            watch = Watch(number, self.session.address, setup_text(setup), str(self.folder.path), {})
            self.engine.remember(watch)
            self.engine.order(watch)
            self._held_since, self._unwatched = time.monotonic(), False
            self.changed()

    def control(self, name: str, value: float) -> None:
        """Set a control of the source.

        Raises
        ------
        ValueError
            The source has no such control.
        """
        with self._lock:
            session = self.running()
            if name not in session.hello.controls:
                raise ValueError(f"this source has no control {name[:40]!r}")
            session.control(name, value)
            self.controls[name] = value

    def running(self) -> Session:
        """Return the session of the source that runs; raises ValueError where none does."""
        if self.session is None or self.source.state != "running":
            raise ValueError(f"there is no source running: {self.source.text}")
        return self.session

    # ---- records

    @property
    def recording(self) -> bool:
        """Whether a record is under way."""
        return self.recorder is not None and self.progress is not None and not self.progress.over

    def record(self, name: str, *, notes: str, seconds: float | None, asked: float | None = None) -> None:
        """Begin a record; what was sampled since it was asked for is in it, however long its process takes to start.

        Parameters
        ----------
        name
            Name of the file.
        notes
            What the operator wrote.
        seconds
            Length [s]; None for that of the set-up.
        asked
            When it was asked for, on the steady clock [s]; None for now.

        Raises
        ------
        FitError, ValueError
            It cannot be begun; the message says why.
        """
        asked = time.monotonic() if asked is None else asked
        with self._lock:
            session = self.running()
            if self.recording:
                raise ValueError("a record is under way already")
            path = self.folder.new_recording(name)
            setup = setup_of_record(self.setup, session.hello.channels, zeros=self.zeros, notes=notes, seconds=seconds)
            recorder = session.record(path, setup=setup, asked=asked)
            self.recorder, self.progress = recorder, recorder.progress
            self._mark(f"record {path.name} begins", kind="start")
            for note in self.checks.notes:
                recorder.tell(Tell("note", note, asked))
        self._await(recorder)

    def _await(self, recorder: Recorder) -> None:
        """Wait until a recorder takes samples; others may look at the state, or stop it, meanwhile.

        Raises
        ------
        ValueError
            It cannot record.
        """
        limit = time.monotonic() + STARTING
        while not recorder.heard and not recorder.progress.over:
            if time.monotonic() > limit:
                recorder.stop(timeout=0.5, hurry=True)
                raise ValueError(f"the recorder did not start within {STARTING:g} s")
            time.sleep(POLLED / 4)
            with self._lock:
                self._look_at_record()
        if recorder.progress.state == "failed":
            raise ValueError(recorder.progress.reason)

    def stop(self) -> Progress | None:
        """End the record; its file is closed when this returns."""
        with self._lock:
            if self.recorder is None or not self.recording:
                raise ValueError("no record is under way")
            self.progress = self.recorder.stop("stopped by the operator", timeout=CLOSING)
            self._ended(self.progress)
            return self.progress

    def mark(self, text: str) -> None:
        """Put an event on the charts and into the record."""
        self.note(text or "mark")

    def note(self, text: str, *, shown: bool = True) -> None:
        """Put a note into the record that runs, and on the charts."""
        with self._lock:
            if shown:
                self._mark(text)
            if self.recorder is not None and self.recording:
                self.recorder.tell(Tell("note", text, time.monotonic()))

    def call(self) -> None:
        """Begin the record now, whatever its trigger waits for."""
        with self._lock:
            if self.recorder is None or not self.recording:
                raise ValueError("no record is waiting for its trigger")
            self.recorder.tell(Tell("call", "button"))

    def acknowledge(self) -> None:
        """Take note that the operator has seen the alarms."""
        self.alarms.acknowledge()

    def begin_sweep(self) -> None:
        """Begin a stepped-sine run.

        Raises
        ------
        FitError, ValueError
            The source has no drive, or cannot be recorded.
        """
        with self._lock:
            Sweep(self)

    def _mark(self, text: str, *, kind: str = "mark") -> None:
        self.marker(text, kind)
        self.changed()

    def _ended(self, progress: Progress) -> None:
        bad = (
            progress.full or progress.unkept or progress.state == "failed" or "gone without a word" in progress.reason
        )
        name = Path(progress.path).name
        text = f"record {name} ended: {progress.reason}; {progress.seconds:.2f} s, {progress.blocks} blocks"
        if progress.gaps:
            text += f", {progress.gaps} gap(s), {progress.lost} samples lost"
        self.say(text, kind="error" if bad else "done")
        if progress.touched:
            text = f"{name}: model and support touched {progress.touched} time(s), see its events"
            self.say(f"{text}; the loads read then carry the force of the contact", kind="error")
        self._mark(f"record {name} ends", kind="end")
        self.listed_version += 1
        self.changed()

    # ---- zeros

    def zero(self) -> None:
        """Take off what the loads read now, the weight apart."""
        self.running()
        if self.recording:
            raise ValueError("a record is under way; its zero stays as it is until it has ended")
        self.engine.order(TakeZeros())

    def clear_zero(self) -> None:
        """Show the loads as they are read."""
        if self.recording:
            raise ValueError("a record is under way; its zero stays as it is until it has ended")
        self._set_zeros({})

    def _set_zeros(self, zeros: dict[str, float]) -> None:
        self.checks.give_up()
        with self._lock:
            self.zeros = zeros
            if self.session is not None:
                folder = str(self.folder.path)
                watch = Watch(self.source.number, self.session.address, setup_text(self.setup), folder, zeros)
                self.engine.remember(watch)
            self.engine.order(SetZeros(zeros))
        units = {} if self.watching is None else dict(zip(self.watching.names, self.watching.units, strict=True))
        listed = ", ".join(f"{name} {value:.4g} {units.get(name, '')}".strip() for name, value in zeros.items())
        self._mark(f"zero: {listed}" if zeros else "zero taken back", kind="zero")

    # ---- set-up

    def apply(self, setup: Setup, *, name: str | None) -> None:
        """Use another set-up, and save it under a name where one is given.

        Raises
        ------
        ValueError
            A record is under way, a file of the set-up is outside the folder, or it cannot be saved.
        """
        with self._lock:
            if self.recording:
                raise ValueError("a record is under way; stop it before the set-up is changed")
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
        files = self.setup.files.model_copy(update={"dynamics": name})
        self.apply(self.setup.model_copy(update={"files": files}), name=None)
        self.say(f"the live force is worked out with {name}", kind="done")

    # ---- what is heard, and what is watched over

    def _answer(self, answer: Answer) -> None:
        if isinstance(answer, Watching):
            if answer.number == self.source.number:
                self.watching = answer
                self._heard(answer)
                self.changed()
        elif isinstance(answer, News):
            self.checks.watch(answer.update.remarks)
            if answer.number == self.source.number:
                self.alarms.watch(answer.update, self.watching)
            self._heard(answer)
        elif isinstance(answer, Means):
            self.checks.heard(answer)
        elif isinstance(answer, Zeros):
            self._set_zeros(dict(answer.zeros))
        elif answer.number in (-1, self.source.number):
            self._unwatched |= answer.number != -1  # an engine that is started again will follow
            if answer.number != -1 and answer.text.startswith("the source ended"):
                return  # the source's own word says it better
            self.say(answer.text, kind="error")

    def _watch_over(self) -> None:
        while not self._closed:
            time.sleep(POLLED)
            with contextlib.suppress(OSError), self._lock:
                self._look()

    def _let_flow(self, session: Session) -> None:
        """Let a source begin once the charts follow it, so that a short replay is seen whole."""
        late = time.monotonic() - self._held_since > UNWATCHED
        if self.source.state == "starting" and (self.watching is not None or self._unwatched or late):
            session.start()
            self.source = Source("running", session.hello.description, self.source.number)
            self.changed()

    def _look(self) -> None:
        if self.session is not None:
            self._let_flow(self.session)
        if self.session is not None:
            for said in self.session.news():
                if said.kind == "ended":
                    gone = "gone without a word" in said.text
                    self.source = Source("ended", said.text, self.source.number)
                    self.say(f"the source ended: {said.text}", kind="error" if gone else "done")
                elif said.kind == "done":
                    self.checks.done(said.text)
                    self._mark(said.text, kind="control")
                    if self.recorder is not None and self.recording:
                        self.recorder.tell(Tell("note", said.text, time.monotonic()))
                elif said.kind == "refused":
                    self.say(said.text, kind="error")
                elif said.kind == "failed":
                    self.source = Source("ended", said.text, self.source.number)
                    self.say(said.text, kind="error")
        self._look_at_record()

    def _look_at_record(self) -> None:
        if self.recorder is not None and self.recording:
            before = self.progress
            self.progress = self.recorder.poll()
            if self.progress.state == "failed":
                self.changed()  # who asked for it is told
            elif self.progress.over:
                self._ended(self.progress)
            elif self.progress != before:
                if before is not None and self.progress.mishap != before.mishap:
                    self.say(self.progress.mishap, kind="error")
                    self.listed_version += 1
                self.changed()

    def say(self, text: str, *, kind: str = "info") -> None:
        """Show a message to the operator: ``info``, ``done`` or ``error``."""
        self.messages.append(
            {"number": next(self._message_numbers), "time": time.time(), "kind": kind, "text": " ".join(text.split())}
        )
        self.changed()

    def processes(self) -> dict[str, int | None]:
        """Numbers of the processes behind the page, for whoever looks after the computer."""
        running = {"engine": self.engine.process, "learner": self.engine.learner, "jobs": self.tasks.process}
        if self.session is not None:
            running["source"] = self.session.process
        if self.recorder is not None:
            running["recorder"] = self.recorder.process
        return {name: process.pid for name, process in running.items() if process is not None and process.is_alive()}

    def recordings(self) -> list[dict[str, Any]]:
        """List the recordings of the folder, with the results that are there."""
        return self.folder.with_results()

    def close(self, *, timeout: float = ENDING) -> None:
        """End everything within a time [s], the record first: its file is closed."""
        if self._closed:
            return
        self._closed = True
        limit = time.monotonic() + timeout
        self.tasks.close()
        self.engine.close()
        # whatever holds the lock (a source that is just starting) has nothing yet that could be lost
        held = self._lock.acquire(timeout=PATIENCE)
        try:
            if self.recorder is not None and self.recording:
                left = max(0.1, 0.75 * (limit - time.monotonic()))
                self.recorder.stop("the page was ended", timeout=left, hurry=True)
            if self.session is not None:
                self.session.close(timeout=max(0.1, limit - time.monotonic()))
        finally:
            if held:
                self._lock.release()
