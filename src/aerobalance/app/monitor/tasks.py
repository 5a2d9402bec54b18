"""What is done with recordings on request, as the page sees it: what waits, what runs, what came of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.jobs import Task, TaskOutcome
from aerobalance.app.monitor.live_source import LiveSource
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.records import Records
from aerobalance.app.monitor.workers import Jobs

LISTED: Final = 20
"""Tasks that are listed."""

TOGETHER: Final = 20
"""Recordings that are identified together at most."""


class Tasks:
    """The tasks of a folder, by number.

    Parameters
    ----------
    folder
        Where the recordings are.
    source
        Whose set-up says with which files they are worked on.
    records
        What is being recorded, which has to end first.
    log
        What the operator is told.
    """

    def __init__(self, folder: Folder, source: LiveSource, records: Records, log: Log) -> None:
        self._folder, self._source, self._records, self._log = folder, source, records, log
        self._lock = threading.Lock()
        self._entries: dict[int, dict[str, Any]] = {}
        self._jobs = Jobs(self._heard)

    @property
    def process(self) -> BaseProcess | None:
        """The process that does them."""
        return self._jobs.process

    @property
    def listed(self) -> dict[int, dict[str, Any]]:
        """The last tasks by number, as plain data."""
        with self._lock:
            return {number: dict(entry) for number, entry in self._entries.items()}

    def run(self, verb: str, recordings: list[str], settings: Mapping[str, str]) -> int:
        """Do something with a recording, or with several at once; return the number of the task.

        Raises
        ------
        ValueError
            There is no such recording, or something is missing.
        """
        if not 1 <= len(recordings) <= (TOGETHER if verb == "together" else 1):
            raise ValueError(f"{verb} takes one recording, and together up to {TOGETHER}, not {len(recordings)}")
        folder, records = self._folder, self._records
        paths = [folder.recording(name) for name in recordings]
        under_way = Path(records.progress.path) if records.under_way and records.progress is not None else None
        if under_way in paths and verb != "info":
            raise ValueError(f"{under_way.name} is still being written; stop the record first")
        path, files = paths[0], self._source.setup.files
        chosen = dict(settings)
        if "dynamics" in chosen:
            chosen["dynamics"] = str(folder.file(chosen["dynamics"]))
        elif verb == "force":
            chosen["dynamics"] = str(self._dynamics_for(path))
        if verb == "force" and files.balance is not None and path.suffix in (".h5", ".hdf5"):
            chosen["balance"] = str(folder.named(files.balance))
        if verb == "together" and files.mass is not None:
            chosen["mass"] = str(folder.named(files.mass))
        task = self._jobs.add(verb, [str(one) for one in paths], chosen)
        with self._lock:
            entry = {"number": task.number, "verb": verb, "recording": path.name, "state": "waiting"}
            self._entries[task.number] = entry
            for old in sorted(self._entries)[:-LISTED]:
                del self._entries[old]
        self._log.changed()
        return task.number

    def cancel(self) -> None:
        """Give up what is being done, and what waits."""
        self._jobs.cancel()

    def close(self) -> None:
        """End the process."""
        self._jobs.close()

    def _dynamics_for(self, path: Path) -> Path:
        """The dynamics identified from the recording itself, or else those of the set-up."""
        own = path.with_name(f"{path.stem}-dynamics.json")
        if own.is_file():
            return self._folder.named(own)
        given = self._source.setup.files.dynamics
        if given is not None:
            return self._folder.named(given)
        raise ValueError(f"identify {path.name} first, or name dynamics in the set-up: the force needs them")

    def _heard(self, task: Task, outcome: TaskOutcome | None) -> None:
        """Take note of a task that has begun, or of what came of it."""
        with self._lock:
            entry = self._entries.get(task.number)
            if entry is None:
                return
            entry["began"] = entry.get("began", time.time())
            if outcome is None:
                entry["state"] = "running"
            else:
                entry |= {
                    "state": "done" if outcome.done else "failed",
                    "text": outcome.text,
                    "report": outcome.report,
                    "files": list(outcome.files),
                    "account": outcome.account,
                }
        if outcome is not None:
            self._log.list_anew()
            if not outcome.done:
                name = Path(task.recordings[0]).name
                self._log.say(f"{task.verb} of {name}: {outcome.text}", kind="error")
        self._log.changed()
