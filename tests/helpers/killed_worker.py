"""Pages of a campaign that say who wrote them, one of which ends its process in the middle of a run."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from aerobalance.recording.errors import ReadError


@dataclass(frozen=True)
class Pages:
    """Writes pages that are alike, and a line of `log` for each; once, at the run `fatal`, its process is killed.

    A page is written after the history of its run and before its record: in the middle of the work.
    """

    log: Path
    fatal: str = ""

    def __call__(self, path: Path, work, found, warnings) -> None:
        before = self.log.read_text() if self.log.exists() else ""
        with self.log.open("a") as file:
            file.write(f"{work.run.name}\n")
        if work.run.name == self.fatal and self.fatal not in before.split():
            os.kill(os.getpid(), signal.SIGKILL)
        path.write_text(work.run.name)


AT_WORK, ENDED = threading.Event(), threading.Event()
"""A worker in a thread of this process is in the middle of a run; its scheduler has ended."""


@dataclass(frozen=True)
class Held(Pages):
    """The same, but the work on the second run goes on until the scheduler has ended, and comes to nothing.

    The scheduler may end when the record of the first is there: who asked for it writes it, after its page.
    """

    records: Path = Path()

    def __call__(self, path: Path, work, found, warnings) -> None:
        if self.log.exists():
            while not any(self.records.glob("*.json")):
                time.sleep(0.01)
            AT_WORK.set()
            ENDED.wait(60)
            raise ReadError("the worker ended")
        super().__call__(path, work, found, warnings)
