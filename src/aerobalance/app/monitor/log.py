"""What the operator is told: messages, marks on the charts, and that something has changed."""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from aerobalance.app.options import as_options

MESSAGES: Final = 50
"""Messages that are kept."""


class Log:
    """The messages of a monitor.

    Parameters
    ----------
    changed
        Called when anything that the page shows has changed, in some thread.
    mark
        Takes an event for the charts and its kind, in some thread.
    """

    def __init__(self, changed: Callable[[], None], mark: Callable[[str, str], None]) -> None:
        self.changed, self._mark = changed, mark
        self.messages: deque[dict[str, Any]] = deque(maxlen=MESSAGES)
        self._numbers = itertools.count(1)
        self.listed_version = 0

    def say(self, text: str, *, kind: str = "info") -> None:
        """Show a message to the operator: ``info``, ``done`` or ``error``."""
        self.messages.append(
            {
                "number": next(self._numbers),
                "time": time.time(),
                "kind": kind,
                "text": as_options(" ".join(text.split())),
            }
        )
        self.changed()

    def mark(self, text: str, *, kind: str = "mark") -> None:
        """Put an event on the charts."""
        self._mark(text, kind)
        self.changed()

    def list_anew(self) -> None:
        """Say that the recordings of the folder, or their results, are others than before."""
        self.listed_version += 1
        self.changed()
