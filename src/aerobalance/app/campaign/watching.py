"""A test that is going on: its runs are reduced as their files come in."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from aerobalance.app.campaign.assignment import Run
from aerobalance.app.campaign.campaign import Campaign, Prepared
from aerobalance.app.campaign.definition import Definition
from aerobalance.app.campaign.places import each_of, fingerprint, is_address
from aerobalance.app.campaign.rows import REDUCED
from aerobalance.io.locked_file import is_locked
from aerobalance.recording.errors import ReadError

EVERY: Final = 2.0
"""Time between two looks at the folder [s]."""

SETTLED: Final = 2.0
"""Time that a file has not changed for before it is taken for complete [s]."""

Stand = tuple[int, int] | str | None
FIRST: Final = 4
"""New runs that are reduced before results are shown for the first time; then twice as many, and so on."""

State = tuple[Definition, tuple[Run, ...], dict[str, Stand]]
"""What a test says, its runs with what is said of them, and what their files are like."""


def complete(run: Run) -> bool:
    """Return whether all files of a run are there, and nobody writes to them any more."""
    return all(_settled(place) for place in run.inputs)


def _settled(place: str) -> bool:
    if is_address(place):
        return True  # what a store lists is whole
    path = Path(place)
    try:
        return time.time() - path.stat().st_mtime >= SETTLED and not is_locked(path)
    except FileNotFoundError:
        return True  # the run has the reason then
    except OSError:
        return False


@dataclass(slots=True, eq=False)
class FileWatch:
    """Looks for the files of a test, and has what is new reduced.

    Attributes
    ----------
    prepare
        Finds the runs that there are.
    reduce
        Reduces those that are complete; what is done is known.
    told
        Takes what there is to say.
    every
        Time between two looks [s].
    there
        Names of the runs that have a result from earlier: they are shown at once.
    """

    prepare: Callable[[], Prepared]
    reduce: Callable[[Callable[[Run], bool]], Campaign]
    told: Callable[[str], None]
    every: float = EVERY
    there: set[str] = field(default_factory=set)
    _room: int = FIRST
    _most: int = FIRST
    _found: Campaign | None = None
    _known: State | None = None
    _left: list[str] = field(default_factory=list)
    _said: str = ""

    def go(self, seconds: float | None = None) -> Campaign | None:
        """Watch for so long [s], or until interrupted; return the last results, None where there are none."""
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            self.look()
            while self._room < 0:  # more have come than were to be reduced before something is shown
                self.look()
            if end is not None and time.monotonic() + self.every > end:
                return self._found
            time.sleep(self.every)

    def look(self) -> None:
        """Look once, and have reduced what is new and complete."""
        try:
            state = self._state()
            if state == self._known and not self._left:
                return
            self._left, self._room = [], self._most
            found = self.reduce(self._ready)
        except ReadError as problem:  # there is no run yet, or a file is just being replaced
            if str(problem) != self._said:
                self._said = str(problem)
                self.told(f"waiting: {problem}")
            self._room = 0
            return
        self._known, self._found = state, found
        self.there |= {row["run_name"] for row in found.rows}
        self._most *= 2
        for row in found.rows:
            if row["run_name"] in found.done:
                said = row["verdict"] if row["status"] == REDUCED else f"set aside: {row['reason']}"
                self.told(f"{row['run_name']}: {said}")

    def _ready(self, run: Run) -> bool:
        if complete(run):
            self._room -= run.name not in self.there
            if self._room >= 0 or run.name in self.there:
                return True
        self._left.append(run.name)
        return False

    def _state(self) -> State:
        """What the test, its runs, and all of their files are like now."""
        found = self.prepare()
        places = sorted({place for run in found.runs for place in run.inputs})
        stands = each_of(_stand, places, of_store=any(map(is_address, places)))
        return found.definition, found.runs, dict(zip(places, stands, strict=True))


def _stand(place: str) -> Stand:
    """What changes when a file changes: size and time on a disk, whose content would take long to read again."""
    try:
        if is_address(place):
            return fingerprint(place)
        about = Path(place).stat()
    except (OSError, ReadError):
        return None
    return about.st_size, about.st_mtime_ns
