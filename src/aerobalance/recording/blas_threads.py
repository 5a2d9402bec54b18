"""One thread for the linear algebra while the library works.

The matrices here are small: threads of the linear algebra wait for each other in a busy loop, and cost several times
the processor time of the work, and on a shared machine more than that of the clock.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

VARIABLES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Variables of the environment by which libraries of linear algebra are told how many threads to have."""


def settings_of_process(environment: Mapping[str, str]) -> dict[str, str]:
    """Return what gives a process one thread when it starts; nothing where its environment says another number."""
    return {} if any(name in environment for name in VARIABLES) else dict.fromkeys(VARIABLES, "1")


class _Limit:
    """The limit of this process, which holds as long as anybody is at work."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._controller: Any = None
        self._limited: Any = None

    def enter(self) -> None:
        with self._lock:
            if not self._inside:
                if self._controller is None:
                    import scipy.linalg  # noqa: F401, PLC0415 - brings a library of its own, which is to be limited
                    from threadpoolctl import ThreadpoolController  # noqa: PLC0415 - only where something is worked out

                    self._controller = ThreadpoolController()
                self._limited = self._controller.limit(limits=1, user_api="blas")
                self._let_go()
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._limited.restore_original_limits()
                self._let_go()

    def _let_go(self) -> None:
        """Let any thread set the number: the first that begins need not be the last that ends."""
        for library in self._controller.select(internal_api="openblas").lib_controllers:
            library.clear_controlling_thread()


_LIMIT: Final = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the linear algebra of this process have one thread meanwhile; as a decorator, while a function works.

    Whoever says in the environment how many threads it is to have is heard. Calls may be nested, and come from several
    threads: the last that ends gives back what was before the first.
    """
    if any(name in os.environ for name in VARIABLES):
        yield
        return
    _LIMIT.enter()
    try:
        yield
    finally:
        _LIMIT.leave()
