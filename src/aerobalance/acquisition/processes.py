"""How the processes beside a clock begin: source, recorder, and those behind the page.

Loading the libraries takes each of them one to three seconds of processor. Where the system can fork safely, they are
forked from one process that has loaded them; elsewhere each loads them itself. Either way each is a process of its
own, which may be killed and keeps no thread, lock or file of the program that started it.

The library of a device that may crash is beneath the source, which may start no forked process itself: it has an
interpreter of its own, which loads little else.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any, Final

from aerobalance.recording.blas_threads import settings_of_process
from aerobalance.recording.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.context import ForkServerContext, SpawnContext

_LOADED: Final = ["aerobalance.acquisition.simulated", "aerobalance.acquisition.recorder"]
_LOCK: Final = threading.Lock()

TRIES: Final = 3
"""Times that a process is tried to be started."""

PAUSE: Final = 0.1
"""Time between them [s], in which one that was killed is gone."""


def _context() -> SpawnContext | ForkServerContext:
    if sys.platform == "linux":
        return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")  # the libraries of macOS do not bear a fork, and Windows has none


_CONTEXT: Final = _context()


def load_beforehand(*modules: str) -> None:
    """Name modules that processes need which are started later; once one has been started, it is too late."""
    _LOADED.extend(name for name in modules if name not in _LOADED)


def pipe() -> tuple[Connection[Any, Any], Connection[Any, Any]]:
    """Return both ends of a pipe between this process and one that it starts."""
    return _CONTEXT.Pipe()


def start_worker(target: Callable[..., None], *arguments: object) -> BaseProcess:
    """Return a process that runs a function with these arguments, started.

    Its linear algebra has one thread, unless the environment says otherwise. It would have one for every core. Those
    wait in a busy loop for the next product, whatever priority the process has given itself, and take from source and
    recorder what these need on time.

    Raises
    ------
    FitError
        It could not be started.
    """
    if sys.platform == "linux":
        _CONTEXT.set_forkserver_preload(_LOADED)
    with _LOCK:  # a process is given the environment of the moment
        made = settings_of_process(os.environ)
        os.environ.update(made)
        try:
            for _ in range(TRIES):
                process = _CONTEXT.Process(target=target, args=arguments, daemon=True)
                # where the process that forks others was killed, another one is started at the next try
                try:
                    process.start()
                except (EOFError, ConnectionError):
                    time.sleep(PAUSE)
                else:
                    return process
        finally:
            for name in made:
                del os.environ[name]
    raise FitError(
        f"a process could not be started: the one that starts it ended {TRIES} times before it did; see whether the "
        "system lets processes start and has memory for them"
    )


def start_interpreter(module: str) -> subprocess.Popen[bytes]:
    """Return an interpreter that runs `main` of a module, started; pipes are its standard input and output."""
    command = f"import sys; sys.path[:] = {sys.path!r}; from {module} import main; main()"
    environment = {**os.environ, **settings_of_process(os.environ)}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", command], stdin=pipe, stdout=pipe, env=environment)
