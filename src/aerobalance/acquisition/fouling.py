"""Contact between model and support, as a contact circuit reports it.

The model is insulated from its support or the gap between them is lined, and a small voltage across the gap tells by
a channel of its own when they touch. While they do, part of the load goes past the balance, and what it reads holds
the force of the contact: such spans are no measurement, however good they look. Contacts bounce; one is over only when
the circuit has stayed open for some time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from aerobalance.recording.channel import Array

HOLD: Final = 0.02
"""Time that the circuit stays open before a contact is over [s]."""


class Contact(NamedTuple):
    """Something that happened: the circuit closed (``closed``) or has stayed open (not ``closed``) from `tick` on.

    `samples` is the length of the contact that is over.
    """

    tick: int
    closed: bool
    samples: int = 0


@dataclass(slots=True)
class ContactFinder:
    """Finds contacts in a channel, chunk by chunk; what it finds does not depend on how the samples come cut.

    Attributes
    ----------
    level
        Reading from which on the circuit is closed.
    hold
        Samples that the circuit stays open before a contact is over.
    closed_above
        Whether a closed circuit reads `level` or more; else `level` or less.
    """

    level: float
    hold: int = 1
    closed_above: bool = True
    _since: int | None = None
    _last: int = 0

    @property
    def touching(self) -> bool:
        """Whether a contact is under way."""
        return self._since is not None

    def push(self, tick: int, readings: Array) -> list[Contact]:
        """Take readings; return what has happened, in order.

        Parameters
        ----------
        tick
            Number of the first; later than those before. Samples in between count as open.
        readings
            Shape (n,); NaN where missing, which counts as open.
        """
        closed = readings >= self.level if self.closed_above else readings <= self.level
        ticks = tick + np.flatnonzero(closed)
        found: list[Contact] = []
        # only the first of a run and the first after a long pause can change anything
        starts = np.flatnonzero(np.diff(ticks, prepend=-np.inf) > max(1, self.hold))
        for place, start in enumerate(starts):
            end = starts[place + 1] if place + 1 < len(starts) else len(ticks)
            self._close(int(ticks[start]), found)
            self._last = int(ticks[end - 1])
        self._open(tick + len(readings), found)
        return found

    def _close(self, tick: int, found: list[Contact]) -> None:
        self._open(tick, found)
        if self._since is None:
            self._since = tick
            found.append(Contact(tick, True))

    def _open(self, tick: int, found: list[Contact]) -> None:
        """End the contact where the circuit has been open for `hold` samples before `tick`."""
        if self._since is not None and tick - self._last > max(1, self.hold):
            found.append(Contact(self._last + 1, False, self._last + 1 - self._since))
            self._since = None
