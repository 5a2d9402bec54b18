"""Ends a process whose starter is gone, whatever it is in the middle of."""

from __future__ import annotations

import multiprocessing
import os
import threading


def end_with_starter() -> None:
    """Watch, in a thread, for the end of the process that started this one. Only for processes that hold nothing."""
    starter = multiprocessing.parent_process()
    if starter is None:
        return

    def watch() -> None:
        starter.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
