"""The process that runs a source and hands its blocks to whoever is connected: recorders, and slow viewers too.

Connections are local (a socket in a private folder) and carry a key. A recorder is never skipped: where it falls
behind, blocks wait for it, up to `KEPT` bytes. A viewer gets what it can take, and what it misses is seen from the
ticks.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from aerobalance.acquisition.scratch import remove, stay
from aerobalance.acquisition.source import Block, Source, SourceChannel, SourceEndedError
from aerobalance.recording.errors import FitError, ReadError

KEPT: Final = 256 * 2**20
"""Bytes that wait for a recorder that has fallen behind, before blocks are lost."""

KEPT_FOR_VIEWERS: Final = 8 * 2**20
"""Bytes that wait for a viewer."""

RECENT: Final = 30.0
"""Time that blocks are kept for a record that was asked for before its recorder had started [s]."""

RECENT_BYTES: Final = 64 * 2**20
"""Bytes that are kept for it at most."""

_BLOCK: Final = b"B"
_END: Final = b"E"
_TICK: Final = 0.1
_STOPPED: Final = "stopped"


class SourceInfo(NamedTuple):
    """What a source says of itself.

    Attributes
    ----------
    channels
        The c channels.
    rate
        Sampling rate [Hz].
    clocked
        Whether samples come by a clock.
    description
        What gives the samples.
    controls
        What can be set while it runs.
    """

    channels: tuple[SourceChannel, ...]
    rate: float
    clocked: bool
    description: str
    controls: tuple[str, ...]


class SourceMessage(NamedTuple):
    """A message of the source's process: ``done``, ``refused``, ``lost``, ``ended`` or ``failed``, and its text."""

    kind: str
    text: str


class Order(NamedTuple):
    """What the source's process is to do: ``start``, ``stop``, or set the control `name` to `value`."""

    do: Literal["start", "stop", "control"]
    name: str = ""
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Address:
    """Where the source's process listens.

    Attributes
    ----------
    socket
        The socket's file.
    key
        What a connection has to know.
    """

    socket: str
    key: bytes


class Sender:
    """Sends messages from a thread of its own, so that a slow receiver does not hold the sender up.

    Parameters
    ----------
    connection
        Where to.
    limit
        Bytes that may wait.
    """

    def __init__(self, connection: Connection[Any, Any], limit: int) -> None:
        self._connection, self._limit = connection, limit
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._ended = False
        self.broken = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def offer(self, message: bytes, *, wait: bool) -> bool:
        """Queue a message; say whether it was taken. With `wait`, wait until there is room for it."""
        with self._changed:
            while wait and self._bytes > self._limit and not self.broken:
                self._changed.wait(_TICK)
            if self.broken or self._bytes > self._limit:
                return False
            self._waiting.append(message)
            self._bytes += len(message)
            self._changed.notify_all()
        return True

    def finish(self, timeout: float, *, last: bytes | None = None) -> None:
        """Send what waits and a last message, and close."""
        with self._changed:
            if last is not None:
                self._waiting.append(last)
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout)
        with contextlib.suppress(OSError):
            self._connection.close()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._ended:
                    self._changed.wait()
                if not self._waiting:
                    return
                message = self._waiting.popleft()
            try:
                self._connection.send_bytes(message)
            except (OSError, ValueError):
                self.broken = True
            with self._changed:
                self._bytes = max(0, self._bytes - len(message))
                self._changed.notify_all()
            if self.broken:
                return


class _Outlet:
    """One receiver of blocks."""

    def __init__(self, connection: Connection[Any, Any], *, viewer: bool) -> None:
        self.viewer = viewer
        self.sender = Sender(connection, KEPT_FOR_VIEWERS if viewer else KEPT)
        self._missed = 0
        self._anew = False

    def give(self, block: Block, *, patient: bool) -> None:
        """Send a block; say with the next one that some were lost."""
        if self._missed:
            block = replace(block, anew=block.anew or self._anew)
            text = f"overrun: {self._missed} block(s) lost, as the receiver fell behind"
            block = replace(block, remark="; ".join(filter(None, (block.remark, text))))
        taken = self.sender.offer(_BLOCK + block.to_bytes(), wait=patient and not self.viewer)
        self._missed = 0 if taken else self._missed + 1
        self._anew = not taken and block.anew


class Feed:
    """A connection to the process of a source.

    Parameters
    ----------
    address
        Where it listens.
    viewer
        Whether blocks may be left out where this receiver is slow.
    recent
        Whether the blocks of the last `RECENT` seconds are wanted first.

    Raises
    ------
    OSError, EOFError
        There is no such process (any more).
    """

    def __init__(self, address: Address, *, viewer: bool, recent: bool = False) -> None:
        self.connection = Client(address.socket, authkey=address.key)
        self.connection.send((viewer, recent))
        self.info: SourceInfo = self.connection.recv()

    def take(self) -> Block | str:
        """Return the next block, or the reason for which there will be no more.

        Raises
        ------
        EOFError, OSError
            The process of the source is gone without a word.
        """
        message = self.connection.recv_bytes()
        if message[:1] == _END:
            return message[1:].decode()
        return Block.from_bytes(message[1:])

    def close(self) -> None:
        """Disconnect."""
        self.connection.close()


class _SourceServer:
    """Runs the source and looks after the receivers."""

    def __init__(self, source: Source, address: Address) -> None:
        self.source = source
        self.outlets: list[_Outlet] = []
        self.info = SourceInfo(
            tuple(source.channels), source.rate, source.clocked, source.description, tuple(source.controls)
        )
        self._recent: deque[Block] = deque()
        self._recent_bytes = 0
        self._changing = threading.Lock()
        self._listener = Listener(address.socket, authkey=address.key)
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection = self._listener.accept()
                viewer, recent = connection.recv()
                connection.send(self.info)
                self._add(_Outlet(connection, viewer=bool(viewer)), recent=bool(recent))
            except (OSError, EOFError, AuthenticationError):
                if self._closed:
                    return

    _closed = False

    def _add(self, outlet: _Outlet, *, recent: bool) -> None:
        """Add a receiver, which may want what was given before; no block is left out or comes twice."""
        with self._changing:
            for block in self._recent if recent else ():
                outlet.give(block, patient=False)
            self.outlets = [*self.outlets, outlet]

    def _keep(self, block: Block) -> None:
        self._recent.append(block)
        self._recent_bytes += block.samples.nbytes
        while self._recent and (
            self._recent_bytes > RECENT_BYTES or block.received > self._recent[0].received + RECENT
        ):
            self._recent_bytes -= self._recent.popleft().samples.nbytes

    def give(self, block: Block, say: Callable[[SourceMessage], None]) -> None:
        """Give a block to all; let go of those that are gone."""
        with self._changing:
            self._keep(block)
            outlets = self.outlets
        for outlet in outlets:
            outlet.give(block, patient=self.source.patient)
            if outlet.sender.broken:
                with self._changing:  # somebody else may be coming in
                    self.outlets = [other for other in self.outlets if other is not outlet]
                say(SourceMessage("lost", "a viewer" if outlet.viewer else "a recorder"))

    def finish(self, reason: str, *, hurry: bool) -> None:
        """Tell all receivers that there is no more."""
        self._closed = True
        for outlet in self.outlets:
            # What a patient source has given must all arrive; a device's receivers have a second for the rest.
            patient = self.source.patient and not hurry
            patience = (2.0 if patient else 0.2) if outlet.viewer else 60.0 if patient else 1.0
            outlet.sender.finish(patience, last=_END + reason.encode())
        self._listener.close()


def run_source(setup: str, folder: str, address: Address, control: Connection[Any, Any]) -> None:
    """Run the source of a set-up until it ends, is told to stop, or its starter is gone: the body of a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the starter decides what it means
    from aerobalance.acquisition.setup import parse_setup  # noqa: PLC0415 - a recorder needs none of it
    from aerobalance.acquisition.sources import open_source  # noqa: PLC0415

    place = Path(address.socket).parent
    stay(place)
    stopped: list[str] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append("the process of the source was told to end"))
    try:
        source = open_source(parse_setup(setup), Path(folder))
        server = _SourceServer(source, address)
    except (FitError, ReadError, ValueError, OSError) as problem:
        with contextlib.suppress(OSError):  # the starter may be gone already, and with it the folder of the socket
            control.send(problem if isinstance(problem, FitError | ReadError | ValueError) else FitError(str(problem)))
        return

    def say(said: SourceMessage) -> None:
        with contextlib.suppress(OSError):
            control.send(said)

    try:
        control.send(server.info)
    except OSError:  # the starter is gone already
        return
    reason = _serve(source, server, control, stopped, say)
    server.finish(reason, hurry=bool(stopped) or reason == _STOPPED)
    say(SourceMessage("ended", reason))
    # Where the starter was killed, nobody else removes the folder of the socket.
    remove(place)
    # Last, as the library of a device may end the process when its device is let go of.
    with contextlib.suppress(Exception):
        source.stop()


def _serve(
    source: Source,
    server: _SourceServer,
    control: Connection[Any, Any],
    stopped: list[str],
    say: Callable[[SourceMessage], None],
) -> str:
    """Yield blocks until the end; return its reason."""
    running = False
    try:
        while not stopped:
            while control.poll(0 if running else _TICK):
                order: Order = control.recv()
                if order.do == "stop":
                    return _STOPPED
                if order.do == "start":
                    source.start()
                    running = True
                else:
                    say(_set(source, order))
            if not running:
                continue
            block = source.read(_TICK)
            if block is not None:
                server.give(block, say)
    except SourceEndedError as end:
        return str(end)
    except EOFError:
        return "the program that started the source is gone"
    except (FitError, ReadError, OSError, ValueError) as problem:
        return f"the source failed: {problem}"
    return stopped[0]


def _set(source: Source, order: Order) -> SourceMessage:
    try:
        return SourceMessage("done", source.control(order.name, order.value))
    except ValueError as problem:
        return SourceMessage("refused", str(problem))
