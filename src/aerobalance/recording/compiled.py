"""Functions that are compiled when they are first used on a machine, and kept on its disk.

What is kept belongs to one state of all sources that are compiled: their names on the disk hold a digest of them. So a
program that is upgraded never finds what another version left, which it could not read, or which would have the old
steps of another file inside.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, TypeVar

import numba
from numba.core import event

from aerobalance.recording.first_use import FIRST_USE
from aerobalance.recording.version import VERSION

Function = TypeVar("Function", bound=Callable[..., Any])

SOURCES: Final = (
    "balance/_term_kernels.py",
    "dynamics/_kernels.py",
    "estimation/live/_live_kernels.py",
    "estimation/spectra/_kernels.py",
    "estimation/statespace/_kernels.py",
    "io/_text_kernels.py",
    "recording/compiled.py",
)
"""Files that decide on what is compiled; the types of arguments are defined in them too."""


def state_of(root: Path) -> str:
    """Return a digest of the sources below a folder; of the version alone where there are none."""
    digest = sha256(VERSION.encode())
    with suppress(OSError):
        for name in SOURCES:
            digest.update((root / name).read_bytes())
    return digest.hexdigest()[:10]


STATE: Final = state_of(Path(__file__).parents[1])
"""Digest of the sources of this program."""


def compiled(*, inner: bool = False, **options: Any) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function at its first call.

    Where no folder can be written to, it is compiled anew in every process.

    Parameters
    ----------
    inner
        Whether compiled functions alone call it, which saves a fifth of the time that compiling takes.
    **options
        What else `numba.njit` is to do.
    """
    if inner:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

    def decorated(function: Function) -> Function:
        function.__qualname__ = f"{function.__qualname__}_{STATE}"  # a part of the names on the disk
        try:
            found: Function = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder to keep it in
            found = numba.njit(**options)(function)
        return found

    return decorated


class _Compiling(event.Listener):
    """Hears of everything that is compiled."""

    def __init__(self) -> None:
        self._depth, self._searched = 0, False

    def on_start(self, event: event.Event) -> None:
        """Tell whoever waits, and take away what is kept of other states."""
        if not self._depth:
            FIRST_USE.begin()
            self._searched = gc.isenabled()
            gc.disable()  # hundreds of thousands of objects come and stay; looking through them takes an eighth
        self._depth += 1
        function = event.data["dispatcher"].py_func
        folder = event.data["dispatcher"].stats.cache_path
        if folder is not None and function.__qualname__.endswith(STATE):
            clear(Path(folder), Path(function.__code__.co_filename).stem)

    def on_end(self, _: event.Event) -> None:
        """Go on as before."""
        self._depth -= 1
        if not self._depth and self._searched:
            gc.enable()


@cache
def clear(folder: Path, module: str) -> None:
    """Take away what a folder keeps of a module's other states."""
    with suppress(OSError):
        for file in folder.glob(f"{module}.*.nb[ci]"):
            if STATE not in file.name:
                file.unlink(missing_ok=True)


event.register("numba:compile", _Compiling())  # type: ignore[no-untyped-call]
