"""Functions that are compiled when they are first used on a machine, and kept on its disk.

The compiler is loaded when the first of them is called, which takes a third of a second: much of the program, as what
looks at a file or records one, calls none.

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
from threading import RLock
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from aerobalance.recording.first_use import FIRST_USE
from aerobalance.recording.version import VERSION

if TYPE_CHECKING:
    from types import ModuleType

    from numba.core.event import Event

Function = TypeVar("Function", bound=Callable[..., Any])

SOURCES: Final = (
    "balance/_term_kernels.py",
    "balance/_variance_kernels.py",
    "dynamics/_kernels.py",
    "estimation/checks/_covariance_kernels.py",
    "estimation/checks/_level_kernels.py",
    "estimation/checks/_root_kernels.py",
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
        return cast("Function", _Compiled(function, options))

    return decorated


class _Compiled:
    """A function that is handed to the compiler at its first call, with what it calls."""

    __slots__ = ("_compiler", "_made", "_options", "py_func")

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.py_func, self._options = function, options
        self._made: Callable[..., Any] | None = None
        self._compiler: Callable[..., Any] | None = None  # the same, once all that the function calls is made too

    def __call__(self, *arguments: Any) -> Any:
        return (self._compiler or self.handed_over())(*arguments)

    def handed_over(self) -> Callable[..., Any]:
        """What compiles the function for the types of arguments that it is called with, and calls it."""
        with _HANDING:
            if self._made is None:
                self._made = _made(self.py_func, self._options)
                place = self.py_func.__globals__
                for name, value in list(place.items()):  # the compiler takes a name for what stands there
                    if isinstance(value, _Compiled):
                        place[name] = value.handed_over()
                self._compiler = self._made
            return self._made


_HANDING: Final = RLock()
"""Held while functions are handed to the compiler: two threads may call the same one first."""


def _made(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    """A function in the compiler's hands, kept on the disk where there is a folder for it."""
    numba = _numba()
    try:
        kept = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder to keep it in
        return cast("Callable[..., Any]", numba.njit(**options)(function))
    _load_alone(kept)
    return cast("Callable[..., Any]", kept)


def _load_alone(function: Any) -> None:
    """Load what is kept of a function without all that the compiler knows how to compile.

    By itself it makes its tables of all functions and types ready before it loads the first one: 0.14 s, for what is
    compiled already. It makes them ready again where it compiles. A compiler that keeps its functions in another way
    is left as it is.
    """
    from numba.core.runtime.nrt import rtsys  # noqa: PLC0415 - the compiler is there by now

    cache: Any = getattr(function, "_cache", None)
    if not {"load_overload", "_load_overload", "_guard_against_spurious_io_errors"} <= set(dir(cache)):
        return

    def load(types: Any, target: Any) -> Any:
        rtsys.initialize(target)  # what compiled functions take memory by
        with cache._guard_against_spurious_io_errors():
            return cache._load_overload(types, target)

    cache.load_overload = load


@cache
def _numba() -> ModuleType:
    """The compiler, which tells of its work from now on."""
    searched = gc.isenabled()
    gc.disable()  # as while it compiles
    try:
        import numba  # noqa: PLC0415 - takes a third of a second, and much of the program compiles nothing
        from numba.core import event  # noqa: PLC0415
    finally:
        if searched:
            gc.enable()

    class Listener(_Compiling, event.Listener):
        """Known as one to the compiler."""

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
    return numba


class _Compiling:
    """Hears of everything that is compiled."""

    def __init__(self) -> None:
        self._depth, self._searched = 0, False

    def on_start(self, event: Event) -> None:
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

    def on_end(self, _: Event) -> None:
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
