"""How far a command is, and how long it will still take, for whoever waits at a terminal.

What takes long says where it is: in a loop (`Progress.each`) or in one of several stages (`Progress.stage`), one
inside the other as they are called. Nobody has to know who waits, and nothing is done where nobody does.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic
from typing import Final, TypeVar

Item = TypeVar("Item")

SOON: Final = 1.0
"""Time before which nothing is said of the time that is left [s]: it would be a guess."""

OFTEN: Final = 0.1
"""Time between two words [s]."""


@dataclass(slots=True)
class _Level:
    """A loop or a stage that is under way, as a part of what is around it: from `at` on, `width` of it."""

    at: float = 0.0
    width: float = 1.0
    what: str = ""
    note: str = ""


@dataclass(slots=True)
class Progress:
    """Tells how much is done, and how long the rest will take.

    Attributes
    ----------
    told
        Takes the words; None where nobody waits for them.
    """

    told: Callable[[str], None] | None = None
    _levels: list[_Level] = field(default_factory=lambda: [_Level()])
    _since: float = 0.0
    _last: float = 0.0

    def each(self, items: Collection[Item], what: str) -> Iterator[Item]:
        """Run through items that take equally long, and tell which it is: `what` 3 of 20."""
        if not self._heard or len(items) < 2:
            yield from items
            return
        with self._level() as level:
            level.width = 1 / len(items)
            for number, item in enumerate(items):
                level.at, level.note = number * level.width, ""
                level.what = f"{what} {number + 1} of {len(items)}"
                self._tell(at_once=number == 0)
                yield item

    @contextmanager
    def stage(self, first: float, last: float, what: str) -> Iterator[None]:
        """Do what leads from the share `first` of the work around it to the share `last`; both are rough."""
        if not self._heard:
            yield
            return
        with self._level() as level:
            level.at, level.width, level.what = first, last - first, what
            self._tell(at_once=True)
            yield

    def note(self, text: str) -> None:
        """Tell more of what is under way, of which it is not known how long it will take."""
        if self._heard:
            self._levels[-1].note = text
            self._tell()

    @property
    def done(self) -> float:
        """Share of the work that is done."""
        share, width = 0.0, 1.0
        for level in self._levels:
            share += width * level.at
            width *= level.width
        return share

    @property
    def _heard(self) -> bool:
        """Whether somebody waits; threads that help do not tell."""
        return self.told is not None and threading.current_thread() is threading.main_thread()

    @contextmanager
    def _level(self) -> Iterator[_Level]:
        level = _Level()
        if len(self._levels) == 1:
            self._since = monotonic()
            self._levels[0].note = ""
        self._levels.append(level)
        try:
            yield level
        finally:
            self._levels.remove(level)

    def _tell(self, *, at_once: bool = False) -> None:
        """Tell where it is; what follows soon after other words may be left out, unless it is wanted at once."""
        now = monotonic()
        if self.told is None or (now < self._last + OFTEN and not at_once):
            return
        self._last = now
        words = ", ".join(text for level in self._levels for text in (level.what, level.note) if text)
        gone, share = now - self._since, self.done
        left = f"; about {_duration(gone / share * (1 - share))} left" if gone > SOON and share > 0 else ""
        self.told(words + left)


def _duration(seconds: float) -> str:
    """A duration in words, such as 40 s, 3 min or 1 h 20 min."""
    if seconds < 100:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


PROGRESS: Final = Progress()
"""That of the running command."""


@contextmanager
def telling(told: Callable[[str], None]) -> Iterator[None]:
    """Tell the progress of what is done meanwhile."""
    PROGRESS.told = told
    try:
        yield
    finally:
        PROGRESS.told = None
