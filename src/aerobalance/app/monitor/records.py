"""The records of the source that runs, one at a time: begun, followed, annotated and ended."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Final

from aerobalance.acquisition.recorder import RecorderCommand, RecordProgress
from aerobalance.acquisition.session import Recorder
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.live_source import LiveSource
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.setups import setup_of_record

LOOKED: Final = 0.025
"""Time between looks at a recorder that is starting [s]."""

STARTING: Final = 60.0
"""Time that a recorder has to start [s]."""

CLOSING: Final = 10.0
"""Time that a recorder has to close its file, on a computer that is busy [s]."""


class Records:
    """The record that is under way, and how the last one ended.

    Parameters
    ----------
    folder
        Where records are written.
    source
        What is recorded.
    log
        What the operator is told.
    lock
        Held while anything of the monitor is changed.
    """

    def __init__(self, folder: Folder, source: LiveSource, *, log: Log, lock: threading.RLock) -> None:
        self._folder, self._source, self._log, self._lock = folder, source, log, lock
        self.recorder: Recorder | None = None
        self.progress: RecordProgress | None = None
        self.opening_notes: list[str] = []  # of each record: what the checks of this source have found

    def forget(self) -> None:
        """Begin anew: another source is opened."""
        self.recorder, self.progress, self.opening_notes = None, None, []

    @property
    def under_way(self) -> bool:
        """Whether a record is under way."""
        return self.recorder is not None and self.progress is not None and not self.progress.over

    def refuse_under_way(self, what: str) -> None:
        """Raise ValueError where a record is under way, and say what has to wait for its end."""
        if self.under_way:
            raise ValueError(f"a record is under way; {what}")

    def begin(self, name: str, *, notes: str, seconds: float | None, asked: float | None = None) -> None:
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
            source = self._source
            session = source.running()
            if self.under_way:
                raise ValueError("a record is under way already")
            path = self._folder.new_recording(name)
            channels = session.info.channels
            setup = setup_of_record(source.setup, channels, zeros=source.zeros, notes=notes, seconds=seconds)
            recorder = session.record(path, setup=setup, asked=asked)
            self.recorder, self.progress = recorder, recorder.progress
            self._log.mark(f"record {path.name} begins", kind="start")
            for note in self.opening_notes:
                recorder.tell(RecorderCommand("note", note, asked))
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
            time.sleep(LOOKED)
            with self._lock:
                self.look()
        if recorder.progress.state == "failed":
            raise ValueError(recorder.progress.reason)

    def stop(self) -> RecordProgress:
        """End the record; its file is closed when this returns."""
        with self._lock:
            if self.recorder is None or not self.under_way:
                raise ValueError("no record is under way")
            self.progress = self.recorder.stop("stopped by the operator", timeout=CLOSING)
            self._ended(self.progress)
            return self.progress

    def note(self, text: str, *, shown: bool = True) -> None:
        """Put a note into the record that runs, and on the charts."""
        with self._lock:
            if shown:
                self._log.mark(text)
            if self.recorder is not None and self.under_way:
                self.recorder.tell(RecorderCommand("note", text, time.monotonic()))

    def call(self) -> None:
        """Begin the record now, whatever its trigger waits for."""
        with self._lock:
            if self.recorder is None or not self.under_way:
                raise ValueError("no record is waiting for its trigger")
            self.recorder.tell(RecorderCommand("call", "button"))

    def look(self) -> None:
        """Take note of how the record goes."""
        if self.recorder is None or not self.under_way:
            return
        before = self.progress
        self.progress = self.recorder.poll()
        if self.progress.state == "failed":
            self._log.changed()  # who asked for it is told
        elif self.progress.over:
            self._ended(self.progress)
        elif self.progress != before:
            if before is not None and self.progress.mishap != before.mishap:
                self._log.say(self.progress.mishap, kind="error")
                self._log.list_anew()
            self._log.changed()

    def _ended(self, progress: RecordProgress) -> None:
        bad = (
            progress.full or progress.unkept or progress.state == "failed" or "gone without a word" in progress.reason
        )
        name = Path(progress.path).name
        text = f"record {name} ended: {progress.reason}; {progress.seconds:.2f} s, {progress.blocks} blocks"
        if progress.gaps:
            text += f", {progress.gaps} gap(s), {progress.lost} samples lost"
        self._log.say(text, kind="error" if bad else "done")
        if progress.touched:
            text = f"{name}: model and support touched {progress.touched} time(s), see its events"
            self._log.say(f"{text}; the loads read then carry the force of the contact", kind="error")
        self._log.mark(f"record {name} ends", kind="end")
        self._log.list_anew()

    def close(self, *, timeout: float) -> None:
        """End the record within a time [s]: its file is closed."""
        if self.recorder is not None and self.under_way:
            self.recorder.stop("the page was ended", timeout=timeout, hurry=True)
