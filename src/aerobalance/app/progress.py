"""How far a command is that works on a record part by part, for whoever waits at a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic


@dataclass(slots=True)
class Progress:
    """Tells how many parts are done, and how long the rest will take.

    Attributes
    ----------
    told
        Takes the words; None where nobody waits for them.
    """

    told: Callable[[str], None] | None = None
    _since: float = field(default_factory=monotonic)

    def begin(self) -> None:
        """Begin to count the time."""
        self._since = monotonic()

    def done(self, parts: int, count: int) -> None:
        """Say how far it is."""
        if self.told is not None and 0 < parts < count:
            left = (monotonic() - self._since) / parts * (count - parts)
            self.told(f"part {parts} of {count} done, about {_duration(left)} left")


def _duration(seconds: float) -> str:
    """A duration in words, such as 40 s, 3 min or 1 h 20 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


PROGRESS = Progress()
"""That of the running command."""


@contextmanager
def telling(told: Callable[[str], None]) -> Iterator[None]:
    """Tell the progress of what is done meanwhile."""
    PROGRESS.told = told
    try:
        yield
    finally:
        PROGRESS.told = None
