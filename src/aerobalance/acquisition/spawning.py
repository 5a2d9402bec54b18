"""Starts processes beside a clock: each computes with one thread, so that it is known what they take of a machine.

Libraries of linear algebra would otherwise have a thread for every core in every process. Those wait in a busy loop
for the next product, whatever priority the process has given itself, and take from source and recorder what these need
on time.
"""

from __future__ import annotations

import os
import threading
from multiprocessing.context import SpawnProcess
from typing import Final

_SETTINGS: Final = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_LOCK: Final = threading.Lock()


def start(process: SpawnProcess) -> None:
    """Start a process whose libraries compute with one thread, unless their own settings say otherwise."""
    with _LOCK:  # a process is given the environment of the moment
        made = [name for name in _SETTINGS if name not in os.environ]
        os.environ.update(dict.fromkeys(made, "1"))
        try:
            process.start()
        finally:
            for name in made:
                del os.environ[name]
