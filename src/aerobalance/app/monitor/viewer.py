"""One viewer: what it is sent, as fast as it says that it has shown it, and no faster."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from typing import Any, Final

from starlette.websockets import WebSocket, WebSocketDisconnect

from aerobalance.app.monitor.display import KEPT, DisplayState, plain

UNSHOWN: Final = 2
"""Frames that a viewer may have got and not shown."""

GONE: Final = 60.0
"""Time after which a viewer that shows nothing is let go [s]."""

LARGEST: Final = 4096
"""Largest message of a viewer [bytes]."""

_WAKE: Final = 0.25


class Viewer:
    """Serves one websocket.

    Parameters
    ----------
    socket
        The connection, accepted.
    display
        What is shown.
    state
        What is said of the state: a version, and the text.
    """

    def __init__(self, socket: WebSocket, display: DisplayState, state: Any) -> None:
        self._socket, self._display, self._state = socket, display, state
        self._sequence = self._acknowledged = 0
        self._shown = time.monotonic()
        self._level = 1
        self._component = ""
        self._source = -1
        self._state_version = self._numbers_version = self._data_version = -1
        self._cursors: list[int] = []
        self._spectra_seen = 0

    @property
    def _has_room(self) -> bool:
        """Whether the viewer may be sent one more frame."""
        return self._sequence - self._acknowledged < UNSHOWN

    async def serve(self) -> None:
        """Send and listen until the viewer is gone, or the server ends."""
        listener = asyncio.create_task(self._listen())
        try:
            while not listener.done():
                if self._has_room:
                    await self._send()
                elif time.monotonic() - self._shown > GONE:
                    break
                async with self._display.changed:
                    with contextlib.suppress(TimeoutError):
                        await asyncio.wait_for(self._display.changed.wait(), _WAKE)
        except (WebSocketDisconnect, RuntimeError, OSError):
            pass  # gone, which is its right
        finally:
            listener.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await listener

    async def _send(self) -> None:
        display, watching = self._display, self._display.watching
        version, state = self._state()
        if version != self._state_version:
            self._state_version = version
            await self._socket.send_text(state)
        if watching is None:
            return
        if watching.number != self._source:
            await self._begin()
        if display.numbers_version != self._numbers_version and display.numbers:
            self._numbers_version = display.numbers_version
            await self._tell(
                {"type": "numbers", **display.numbers, "marks": list(display.marks), "tick": display.tick}
            )
        if display.data_version != self._data_version:
            self._data_version = display.data_version
            frame = display.data_frame(self._sequence + 1, self._level, self._cursors)
            if frame is not None:
                self._sequence += 1
                await self._socket.send_bytes(frame)
        if not self._has_room:
            return
        name = self._component if self._component in watching.components else next(iter(watching.components), "")
        frame, seen = display.spectra_frame(self._sequence + 1, name, self._spectra_seen)
        if frame is not None:
            self._sequence, self._spectra_seen = self._sequence + 1, seen
            await self._socket.send_bytes(frame)

    async def _begin(self) -> None:
        watching = self._display.watching
        if watching is None:
            return
        self._source = watching.number
        self._cursors = [0] * len(self._display.strips)
        self._spectra_seen = 0
        await self._tell(
            {
                "type": "panel",
                "number": watching.number,
                "names": watching.names,
                "units": watching.units,
                "rate": watching.rate,
                "width": watching.width,
                "components": watching.components,
                "half_ranges": watching.half_ranges,
                "limits": watching.limits,
                "masses": watching.masses,
                "frequencies": watching.frequencies,
                "kept": KEPT,
            }
        )

    async def _tell(self, message: dict[str, Any]) -> None:
        await self._socket.send_text(json.dumps(plain(message), separators=(",", ":")))

    async def _listen(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text") or ""
            if not text or len(text) > LARGEST:
                continue
            with contextlib.suppress(ValueError, RecursionError):
                given = json.loads(text)
                if isinstance(given, dict):
                    self._hear(given)
                    ping = given.get("ping")
                    if isinstance(ping, int | float):  # at once: the viewer sets its clock by it
                        await self._tell({"type": "pong", "ping": ping, "now": time.time() * 1e3})
            if self._has_room:
                await self._display.tell()

    def _hear(self, given: dict[str, Any]) -> None:
        """Take what a viewer says; what makes no sense is passed over."""
        shown, level, component = (given.get(key) for key in ("shown", "level", "component"))
        if isinstance(shown, int) and self._acknowledged < shown <= self._sequence:
            self._acknowledged, self._shown = shown, time.monotonic()
        if isinstance(level, int) and not isinstance(level, bool) and 0 <= level < len(KEPT):
            self._level = level
            self._cursors = [0] * len(self._cursors)
            self._data_version = -1
        if isinstance(component, str):
            self._component, self._spectra_seen = component[:20], 0
