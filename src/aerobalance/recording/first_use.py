"""The pause of a program's first use, in which its loops are compiled: whoever waits for it is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final


@dataclass(slots=True)
class FirstUse:
    """What happens when a loop is compiled.

    Attributes
    ----------
    told
        Called when the first one is; None where nobody waits.
    """

    told: Callable[[], None] | None = None

    def begin(self) -> None:
        """Tell, once, that loops are being compiled."""
        told, self.told = self.told, None
        if told is not None:
            told()


FIRST_USE: Final = FirstUse()
"""That of the process."""
