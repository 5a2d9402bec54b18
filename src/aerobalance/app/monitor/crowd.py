"""How long a connection may keep the server waiting, and how many of them an address may have.

A connection that owes something (the head of a request, its body, or reading the answer) is given a time for it. Where
an address has all the connections that one may have, or there are as many as there may be, a new one takes the place
of the one that has kept the server waiting longest: so nobody is locked out by connections that say nothing, from
their own address neither. A viewer's socket is no longer counted once it is one; `Page` limits these.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any, Final, Literal

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

TIMES: Final = {"head": 10.0, "body": 10.0, "answer": 30.0}
"""Time for the head of a request, for its body, and for reading a part of the answer [s]."""

MOST_OF_ONE: Final = 64
"""Connections of one address."""

MOST: Final = 256
"""Connections in all."""

LARGEST_HEAD: Final = 16_384
"""Largest head of a request [bytes]."""

Owed = Literal["", "head", "body", "answer"]


class Crowd:
    """The connections that are open."""

    def __init__(self) -> None:
        self._open: dict[Patient, None] = {}

    def enter(self, new: Patient) -> bool:
        """Let a connection in, in another's place where it must be; say whether it could be."""
        same = [one for one in self._open if one.address == new.address]
        if len(same) >= MOST_OF_ONE:
            if not _end_longest(same):
                return False
        elif len(self._open) >= MOST and not _end_longest(self._of_busiest()):
            return False
        self._open[new] = None
        return True

    def leave(self, one: Patient) -> None:
        """Count a connection no longer."""
        self._open.pop(one, None)

    def _of_busiest(self) -> list[Patient]:
        """Connections of the address that has most of them."""
        by_address: dict[str, list[Patient]] = {}
        for one in self._open:
            by_address.setdefault(one.address, []).append(one)
        return max(by_address.values(), key=len)


def _end_longest(some: list[Patient]) -> bool:
    """End the connection that has kept the server waiting longest; say whether there was one."""
    waiting = [one for one in some if one.owes]
    if not waiting:
        return False
    min(waiting, key=lambda one: one.since).end()
    return True


class Patient(H11Protocol):
    """A connection whose other end may keep the server waiting for a time, not for ever."""

    crowd: Crowd
    address = ""
    owes: Owed = ""
    since = 0.0
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Let the connection in, or end it."""
        super().connection_made(transport)
        self.address = self.client[0] if self.client else ""
        if self.crowd.enter(self):
            self._look()
        else:
            self.end()

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it no longer."""
        self._leave()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has come."""
        super().data_received(data)
        self._look()

    def pause_writing(self) -> None:
        """The other end does not read as fast as it is answered."""
        super().pause_writing()
        self._look()

    def resume_writing(self) -> None:
        """The other end has read on."""
        super().resume_writing()
        self._look()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._look()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over to a viewer's socket."""
        self._leave()
        self._gone = True
        super().handle_websocket_upgrade(event)

    def end(self) -> None:
        """End the connection at once."""
        self._leave()
        self._gone = True
        self.transport.abort()

    _gone = False

    def _leave(self) -> None:
        self.crowd.leave(self)
        self.owes = ""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _look(self) -> None:
        """See what the other end owes now; the time for it begins when it does."""
        owes = self._owed()
        if self._gone or owes == self.owes:
            return
        self.owes, self.since = owes, time.monotonic()
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self.loop.call_later(TIMES[owes], self.end) if owes else None

    def _owed(self) -> Owed:
        cycle: Any = self.cycle
        if self.flow.write_paused:
            return "answer"
        if cycle is None or cycle.response_complete:
            return "head"
        return "body" if cycle.more_body else ""
