"""Ctrl-C and SIGTERM at any moment: one line, nothing half-written, and the exit code that shells expect."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def watch() -> None:
    """Answer Ctrl-C and SIGTERM from now on; what a command wants to do about them itself it says later."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
            signal.signal(number, _end)


def leave() -> None:
    """Let nothing interrupt the end of the program: the result is there."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _end(number: int, _: FrameType | None) -> None:
    """End the process here and now.

    An exception would have to find its way out of whatever runs at this moment, be it an import, a destructor or the
    call-back of a library, and some of these swallow it or print a traceback.
    """
    said = "interrupted" if number == signal.SIGINT else "told to end (SIGTERM)"
    told = "nothing was written"
    writing = sys.modules.get("aerobalance.io.safe_write")
    outputs = getattr(writing, "OUTPUTS", None)
    if outputs is not None:
        outputs.abandon()
        told = outputs.told()
    streams = sys.modules.get("aerobalance.app.cli.streams")
    if streams is not None and hasattr(streams, "clean_up"):
        told = streams.plain(told)
        streams.clean_up()
    line = f"{said}; {told}\n"
    if sys.stderr is not None and sys.stderr.isatty():
        line = f"\r\x1b[K\x1b[?25h{line}"  # the sign of life leaves the cursor hidden
    os.write(2, line.encode(errors="replace"))
    os._exit(128 + number)
