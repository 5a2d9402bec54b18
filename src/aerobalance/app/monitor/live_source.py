"""The source that runs, as the page sees it: its state, controls and zeros, and the engine that follows it."""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from aerobalance.acquisition.feed import SourceMessage
from aerobalance.acquisition.session import Session
from aerobalance.acquisition.setup import Setup, setup_text
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.messages import FollowSource, SetZeros, TakeZeros, Watching
from aerobalance.app.monitor.setups import first_controls
from aerobalance.app.monitor.workers import EngineProcesses
from aerobalance.recording.errors import FitError, ReadError

UNWATCHED: Final = 20.0
"""Time after which a source begins although the charts do not follow it yet [s]."""


@dataclass(slots=True)
class SourceState:
    """How the source stands: ``starting``, ``running``, ``ended`` or ``failed``."""

    state: str = "starting"
    text: str = ""
    number: int = 0


class LiveSource:
    """One source after the other, each with the set-up it was opened with.

    Parameters
    ----------
    setup
        The set-up to begin with.
    folder
        Where its files are looked for.
    engine
        Follows the source for the charts.
    log
        What the operator is told.
    lock
        Held while anything of the monitor is changed.
    """

    def __init__(
        self, setup: Setup, folder: Path, engine: EngineProcesses, *, log: Log, lock: threading.RLock
    ) -> None:
        self.setup, self.engine = setup, engine
        self._folder, self._log, self._lock = folder, log, lock
        self._numbers = itertools.count(1)
        self.state = SourceState()
        self.session: Session | None = None
        self.zeros: dict[str, float] = {}
        self.controls: dict[str, float] = {}
        self._asked: deque[tuple[str, float]] = deque()  # controls that the source has not answered yet
        self.watching: Watching | None = None
        self._opened, self._unwatched = 0.0, False

    def open(self, setup: Setup) -> None:
        """Start the source of a set-up in the place of the one before; what goes wrong is told."""
        self.setup = setup
        if self.session is not None:
            self.session.close()
            self.session = None
        number = next(self._numbers)
        self.state = SourceState("starting", "the source is starting", number)
        self.zeros, self.watching = {}, None
        self._log.changed()
        try:
            self.session = Session(setup, self._folder)
        except (FitError, ReadError, ValueError, OSError) as problem:
            self.state = SourceState("failed", str(problem), number)
            self._log.say(f"the source cannot be used: {problem}", kind="error")
            return
        self.controls = first_controls(setup)
        self._asked.clear()
        watch = self._watch(self.session)
        self.engine.remember(watch)
        self.engine.order(watch)
        self._opened, self._unwatched = time.monotonic(), False
        self._log.changed()

    def running(self) -> Session:
        """Return the session of the source that runs; raises ValueError where none does."""
        if self.session is None or self.state.state != "running":
            raise ValueError(f"there is no source running: {self.state.text}")
        return self.session

    def control(self, name: str, value: float) -> None:
        """Set a control of the source; `controls` has it once the source has done so.

        Raises
        ------
        ValueError
            The source has no such control.
        """
        with self._lock:
            session = self.running()
            if name not in session.info.controls:
                raise ValueError(f"this source has no control {name[:40]!r}")
            session.control(name, value)
            self._asked.append((name, value))

    def take_zeros(self) -> None:
        """Ask for what the loads read now, the weight apart."""
        self.running()
        self.engine.order(TakeZeros())

    def set_zeros(self, zeros: dict[str, float]) -> None:
        """Take off what is given of each channel, SI."""
        with self._lock:
            self.zeros = zeros
            if self.session is not None:
                self.engine.remember(self._watch(self.session))
            self.engine.order(SetZeros(zeros))
        units = {} if self.watching is None else dict(zip(self.watching.names, self.watching.units, strict=True))
        listed = ", ".join(f"{name} {value:.4g} {units.get(name, '')}".strip() for name, value in zeros.items())
        self._log.mark(f"zero: {listed}" if zeros else "zero taken back", kind="zero")

    def _watch(self, session: Session) -> FollowSource:
        return FollowSource(self.state.number, session.address, setup_text(self.setup), str(self._folder), self.zeros)

    def unwatched(self) -> None:
        """Take note that the charts cannot follow this source."""
        self._unwatched = True

    def news(self) -> Sequence[SourceMessage]:
        """Return what the source has said since; it begins once the charts follow it: a short replay is seen whole."""
        if self.session is None:
            return ()
        late = time.monotonic() - self._opened > UNWATCHED
        if self.state.state == "starting" and (self.watching is not None or self._unwatched or late):
            self.session.start()
            self._stands("running", self.session.info.description)
        found = self.session.news()
        for message in found:
            if message.kind == "ended":
                self._stands("ended", message.text)
                gone = "gone without a word" in message.text
                self._log.say(f"the source ended: {message.text}", kind="error" if gone else "done")
            elif message.kind == "failed":
                self._stands("ended", message.text)
                self._log.say(message.text, kind="error")
            elif message.kind == "done":
                name, value = self._asked.popleft()
                self.controls[name] = value
            elif message.kind == "refused":
                self._asked.popleft()
                self._log.say(message.text, kind="error")
        return found

    def _stands(self, state: str, text: str) -> None:
        self.state = SourceState(state, text, self.state.number)
        self._log.changed()

    def close(self, *, timeout: float) -> None:
        """End the source within a time [s]."""
        if self.session is not None:
            self.session.close(timeout=timeout)
