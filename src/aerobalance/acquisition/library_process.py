"""A device whose library runs in a process of its own, and is started again there where it crashes or hangs.

Libraries of devices are compiled, and have threads of their own: an error in one of these ends its process, whatever
the program does (openDAQ 3.40 where a device is removed while its connection is being mended). In a process of its own
it takes neither the receivers of the source with it nor what the source knows of the device: the library that is
started again is told from which instant samples are numbered, so that the gap has its exact length.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import BinaryIO, Final, NamedTuple, Protocol

from aerobalance.acquisition.device import Device
from aerobalance.acquisition.processes import start_interpreter
from aerobalance.acquisition.source import Block, Source, SourceChannel, SourceEndedError
from aerobalance.recording.errors import FitError, ReadError

CRASHES: Final = 3
"""Crashes without a sample between them that end the source."""

CRASHES_WITHIN: Final = 30.0
"""Time within which they are counted [s]."""

SILENT: Final = 30.0
"""Time without a sign of life from which on the library is taken to hang [s]."""

_LEAVING: Final = 0.5
_TICK: Final = 0.1
_START: Final = b"start\n"
_ENDS: Final = (SourceEndedError, FitError, ReadError, OSError, ValueError)


class _Opened(NamedTuple):
    """What the process of the library says of the device it has opened."""

    channels: tuple[SourceChannel, ...]
    rate: float
    description: str


class _Given(NamedTuple):
    """A block, and what is known of the device after it: packed, as it is rarely wanted."""

    block: bytes
    memory: bytes


class _Alive(NamedTuple):
    """That the library has no samples yet."""


_Said = _Opened | _Given | _Alive | Exception | None
"""What the process of the library says: None where it is gone without a word."""


class Resumable(Source, Protocol):
    """A source that another process can go on with."""

    @property
    def memory(self) -> object:
        """What the process after this one has to know, to be given to it as `memory`."""


class LibraryProcess(Device):
    """A device that is read in a process beneath this one.

    Parameters
    ----------
    make
        Makes the device; called with ``memory=None`` at first, and with what was known of the device later: then it
        must not need the device to be there.

    Raises
    ------
    FitError, ReadError, ValueError, OSError
        What `make` raises; or the library crashed.
    """

    def __init__(self, make: Callable[..., Resumable]) -> None:
        super().__init__()
        self._make = make
        self._memory = pickle.dumps(None)
        self._started = False
        self._crashes: deque[float] = deque(maxlen=CRASHES)
        self._child = _Child(make, self._memory)
        answer = self._child.take(None)
        if not isinstance(answer, _Opened):
            self._stopped = True
            how = self._child.end()
            crashed = FitError(f"the library of the device crashed ({how}) as the device was opened; try again")
            raise answer if isinstance(answer, Exception) else crashed
        self.channels, self.rate, self.description = answer

    def start(self) -> None:
        """Begin to read; a device that refuses ends the next reading."""
        self._started, self._heard = True, time.monotonic()
        self._child.start()

    def stop(self) -> None:
        """End the process of the library."""
        self._stopped = True
        self._child.end()

    def read(self, timeout: float) -> Block | None:
        """Return the next samples, as the device has them."""
        if self._stopped:
            raise SourceEndedError("the device was disconnected")
        try:
            said = self._child.take(timeout)
        except queue.Empty:
            if self._started and time.monotonic() - self._heard > SILENT:
                self._child.end()
                self._again(f"did not answer for {SILENT:g} s")
            return None
        self._heard = time.monotonic()
        match said:
            case _Given(block, memory):
                self._memory = memory
                self._crashes.clear()
                given = Block.from_bytes(block)
                return replace(given, remark="; ".join(filter(None, (self._said(), given.remark))))
            case Exception():
                self.stop()
                raise said
            case None:
                self._crashed(self._child.end())
        return None  # it is alive, or one that was started again has opened the device

    def _crashed(self, how: str) -> None:
        """Start the library again, unless it has crashed too often."""
        now = time.monotonic()
        self._crashes.append(now)
        if len(self._crashes) == CRASHES and now - self._crashes[0] < CRASHES_WITHIN:
            self._stopped = True
            raise SourceEndedError(
                f"the library of the device crashed {CRASHES} times without a sample between, at last with {how}; "
                "start anew once the device answers"
            )
        self._again(f"crashed ({how})")

    def _again(self, what: str) -> None:
        """Start the library again, and say so with the next block, once."""
        self._note(f"the library of the device {what}; it was started again")
        self._child = _Child(self._make, self._memory)
        self._heard = time.monotonic()
        if self._started:
            self._child.start()


class _Child:
    """The process of the library, as the source sees it."""

    def __init__(self, make: Callable[..., Resumable], memory: bytes) -> None:
        self._process = start_interpreter(__name__)
        self._said: queue.SimpleQueue[_Said] = queue.SimpleQueue()
        threading.Thread(target=self._hear, daemon=True).start()
        self._tell(pickle.dumps((make, memory)))

    def take(self, timeout: float | None) -> _Said:
        """Return what it says next; None where it is gone without a word.

        Raises
        ------
        queue.Empty
            It says nothing within `timeout` [s].
        """
        return self._said.get(timeout=timeout)

    def start(self) -> None:
        """Let it read."""
        self._tell(_START)

    def end(self) -> str:
        """End it, by force where it does not go by itself; return how it ended."""
        orders = self._process.stdin
        if orders is not None:
            with contextlib.suppress(OSError):
                orders.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVING)
        self._process.kill()
        code = self._process.wait()
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"

    def _tell(self, order: bytes) -> None:
        orders = self._process.stdin
        if orders is not None:
            with contextlib.suppress(OSError):  # that it is gone is heard
                orders.write(order)
                orders.flush()

    def _hear(self) -> None:
        stream = self._process.stdout
        if stream is not None:
            with stream, contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):
                while True:
                    self._said.put(pickle.load(stream))
        self._said.put(None)


def main() -> None:
    """Run the library until the device ends, or the source closes the pipe or is gone: the body of the process."""
    # Ctrl-C and the end of a session go to the whole group; the source decides what they mean.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    code = 1
    try:
        with os.fdopen(os.dup(1), "wb") as answers, contextlib.suppress(BrokenPipeError):
            os.dup2(2, 1)  # what the library prints is no answer
            _run(sys.stdin.buffer, answers)
        code = 0
    finally:
        if code:
            traceback.print_exc()
        # Without the end that Python makes: it takes the library apart, which may crash, or wait for ever.
        os._exit(code)


def _run(orders: BinaryIO, answers: BinaryIO) -> None:
    """Open the device, and give its blocks once told to start, until it ends or no more are wanted."""

    def tell(what: _Said) -> None:
        pickle.dump(what, answers)
        answers.flush()

    make, memory = pickle.load(orders)
    started, ended = threading.Event(), threading.Event()
    threading.Thread(target=_obey, args=(orders, started, ended), daemon=True).start()
    try:
        source: Resumable = make(memory=pickle.loads(memory))
    except _ENDS as problem:
        tell(problem)
        return
    try:
        tell(_Opened(tuple(source.channels), source.rate, source.description))
        started.wait()
        if not ended.is_set():
            source.start()
        while not ended.is_set():
            block = source.read(_TICK)
            if block is None:
                tell(_Alive())
            else:
                tell(_Given(block.to_bytes(), pickle.dumps(source.memory)))
    except BrokenPipeError:  # the source is gone
        pass
    except _ENDS as end:
        tell(end)
    # Last, as the library may crash when its device is let go of.
    with contextlib.suppress(Exception):
        source.stop()


def _obey(orders: BinaryIO, started: threading.Event, ended: threading.Event) -> None:
    """Hear when to start, and when to end: when the pipe closes, be it that the source was killed."""
    orders.readline()
    started.set()
    orders.read()
    ended.set()
    time.sleep(_LEAVING)  # for the device to be let go of
    os._exit(0)
