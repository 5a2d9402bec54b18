"""Alarms: what was over its limit stays on the list until somebody has acknowledged it, however short it was."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from aerobalance.app.monitor.messages import ShownReading, Update, Watching

PAST: Final = 50
"""Alarms that are still listed when they are over and acknowledged."""

_WORSE: Final = 1.02
"""Factor by which an alarm must grow before all viewers are told again."""


class _Alarm(NamedTuple):
    """Something over its limit: what, how it is said, its share of the limit, its value and how far beyond that is."""

    what: str
    text: str
    share: float
    value: float | None = None
    unit: str = ""
    beyond: float = 0.0

    def is_worse(self, kept: Mapping[str, Any], *, factor: float = 1.0) -> bool:
        """Whether it is worse than one that is kept, by more than a factor."""
        if self.share == kept["share"]:  # of a limit at zero the share is infinite
            return self.beyond > factor * float(kept["beyond"])
        return self.share > factor * float(kept["share"])


class Alarms:
    """The alarms of a session.

    Parameters
    ----------
    changed
        Called when the list has changed, in the caller's thread.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._open: dict[str, dict[str, Any]] = {}
        self._past: deque[dict[str, Any]] = deque(maxlen=PAST)

    @property
    def shown(self) -> dict[str, list[dict[str, Any]]]:
        """The alarms as plain data: `open` (there, or not acknowledged) and `past`, the newest first."""
        with self._lock:
            return {
                "open": [dict(one) for one in sorted(self._open.values(), key=lambda one: -float(one["began"]))],
                "past": [dict(one) for one in reversed(self._past)],
            }

    def watch(self, update: Update, watching: Watching | None) -> None:
        """Look at what the engine has found; the numbers are not in each update."""
        found = {one.what: one for one in _contact(update)}
        looked = {"contact"} if update.touching is not None else set()
        if update.readings and watching is not None:
            found |= {one.what: one for one in _loads(update, watching)}
            # an alarm is not over because there are no readings any more
            looked |= {name for name, reading in update.readings.items() if reading.state != "none"}
            looked |= {"combined loads"} if update.envelope is not None else set()
        with self._lock:
            told = [self._raise(one) for one in found.values()]
            told += [self._over(name) for name in looked - {*found}]
        if any(told):
            self._changed()

    def acknowledge(self) -> None:
        """Acknowledge all alarms; those that are over leave the list of the open ones."""
        now = time.time()
        with self._lock:
            for name, one in list(self._open.items()):
                one["acknowledged"] = one["acknowledged"] or now
                if not one["present"]:
                    self._past.append(self._open.pop(name))
        self._changed()

    def leave(self) -> None:
        """Take all for over, as the source is another one or gone."""
        with self._lock:
            for name in list(self._open):
                self._over(name)

    def _raise(self, found: _Alarm) -> bool:
        """Put an alarm on the list, or what is worse of it; say whether that is news."""
        now, one = time.time(), self._open.get(found.what)
        if one is None:
            fields = found._asdict() | {"began": now, "last": now, "present": True, "acknowledged": None}
            self._open[found.what] = fields | {"number": next(self._numbers), "times": 1}
            return True
        news = not one["present"] or found.is_worse(one, factor=_WORSE)
        one["times"] += not one["present"]
        one |= {"present": True, "last": now}
        if found.is_worse(one):
            one |= found._asdict()
        return news

    def _over(self, name: str) -> bool:
        one = self._open.get(name)
        if one is None or not one["present"]:
            return False
        one["present"] = False
        if one["acknowledged"]:
            self._past.append(self._open.pop(name))
        return True


def _contact(update: Update) -> Iterator[_Alarm]:
    if update.touching or any(kind == "contact" for _, kind, _ in update.remarks):
        yield _Alarm("contact", "the model touches its support", 1.0)


def _loads(update: Update, watching: Watching) -> Iterator[_Alarm]:
    envelope = update.envelope
    if envelope is not None and envelope.share >= 1:
        text = f"outside the load envelope, most by {envelope.nearest}"
        yield _Alarm("combined loads", text, float(envelope.share), 100 * float(envelope.share), "%")
    units = dict(zip(watching.names, watching.units, strict=True))
    for name, reading in update.readings.items():
        if reading.state == "over":
            half = watching.half_ranges.get(name, math.inf)
            low, high = watching.limits.get(name, (-half, half))
            yield _beyond(name, reading, (low, high), units[name])


def _beyond(name: str, reading: ShownReading, limits: tuple[float, float], unit: str) -> _Alarm:
    """Return by which value a reading is beyond which of its limits."""
    low, high = limits
    lower = low - reading.least > reading.largest - high
    value, limit = (reading.least, low) if lower else (reading.largest, high)
    text = f"{'below' if lower else 'above'} {limit:.6g} {unit}"
    # of a load that must not come near zero, what is left of the limit is the smaller the worse it is
    held_off = limit > 0 if lower else limit < 0
    over, under = (limit, value) if held_off else (value, limit)
    share = over / under if over * under > 0 else math.inf
    return _Alarm(name, text, share, value, unit, abs(value - limit))
