"""What devices have in common as sources: libraries that come with an extra, and times when they are gone."""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any, Final

from aerobalance.acquisition.source import Uncontrolled
from aerobalance.recording.errors import FitError

RETRY: Final = 0.5
"""Time between attempts to reach a device that is gone [s]."""

QUIET: Final = 5.0
"""Time without samples after which the connection is made anew from its beginning [s]."""


class Device(Uncontrolled):
    """A source that has a clock of its own and waits for nobody."""

    clocked = True
    patient = False

    def __init__(self) -> None:
        self._stopped = False
        self._remark = ""
        self._heard = 0.0
        self._tried = -RETRY

    def _due(self, timeout: float) -> bool:
        """Return whether to try to reach the device again; where it is too early, wait, `timeout` [s] at most."""
        left = self._tried + RETRY - time.monotonic()
        if left > 0:
            time.sleep(min(left, timeout))
            return False
        self._tried = time.monotonic()
        return True

    def _note(self, text: str) -> None:
        """Keep what is to be said with the next block."""
        if text not in self._remark:
            self._remark = "; ".join(filter(None, (self._remark, text)))

    def _said(self) -> str:
        """Return what is to be said of the time before the next block, once."""
        remark, self._remark = self._remark, ""
        return remark


def extra_library(module: str, *, extra: str) -> Any:
    """Import a library.

    Parameters
    ----------
    module
        What to import.
    extra
        The extra of this program that installs it.

    Raises
    ------
    FitError
        It is not installed, or does not run on this computer; the message says how to install it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as problem:
        if problem.name not in (module, module.partition(".")[0]):
            raise
        raise FitError(
            f"sources of this kind need a library that is not installed: pip install 'aerobalance[{extra}]'"
        ) from None
    except (ImportError, OSError) as problem:
        raise FitError(f"the library {module} does not load on this computer: {problem}") from None
