"""The process that learns what the force is taken for, while the engine goes on."""

from __future__ import annotations

import contextlib
import os
import signal
from typing import TYPE_CHECKING, Any, Final

from aerobalance.app.monitor.orphan import end_with_starter
from aerobalance.estimation.live.health import Snapshot
from aerobalance.recording.errors import FitError

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    Pipe = Connection[Any, Any]

_NICE: Final = 10


def run_learner(pipe: Pipe) -> None:
    """Learn from snapshots as they come: the body of a process. It gives way to all others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_starter()
    if hasattr(os, "nice"):
        os.nice(_NICE)
    with contextlib.suppress(EOFError, OSError):
        while True:
            tag, snapshot = pipe.recv()
            found: object
            try:
                found = snapshot.learn() if isinstance(snapshot, Snapshot) else None
            except (FitError, ArithmeticError, ValueError):
                found = None
            pipe.send((tag, found))
