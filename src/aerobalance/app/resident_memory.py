"""Keeps the memory that the program has resident within bounds: one heap, and no compiler that has done its work."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

SETTINGS: Final = {-8: 1, -3: 6 << 20, -1: 64 << 20}
"""Of ``mallopt`` (3) of the GNU C library: ``M_ARENA_MAX`` [1], ``M_MMAP_THRESHOLD``, ``M_TRIM_THRESHOLD`` [bytes]."""

NOT_NEEDED: Final = 4
"""``MADV_DONTNEED`` of ``madvise`` (2) of Linux."""

COMPILER: Final = "libllvmlite"
"""How the name of the library begins that compiles, and loads what was compiled before."""


def share_one_heap() -> None:
    """Let all threads take memory from one heap, where the C library is GNU's; elsewhere nothing is done.

    It gives each thread a heap of its own, and what one has let go of in its heap no other takes: two threads that
    work on a record in turn with a third then have a quarter more resident than they need. By itself it also comes to
    keep all that was let go of, up to 64 MB, which no later part of another size fits into: what is larger than 6 MB
    is given back at once. With a limit of 32 MB ten minutes of six components came to 30 MB more, a little with each
    part; with one of 2 MB the same memory is resident, and the kernel has a fifth more to do.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        for setting, value in SETTINGS.items():
            library.mallopt(setting, value)


def give_back_compiler() -> None:
    """Give back the memory of the compiler's machine code, on Linux; elsewhere nothing is done.

    Some 50 MB of it are read where functions that were compiled before are loaded, and stay resident for nothing. They
    are unchanged pages of its file, which the kernel reads again should they be called once more.
    """
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError, TypeError, ValueError):
        library = ctypes.CDLL(None)
        for begin, end in _places_of_compiler():
            library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), NOT_NEEDED)


_PLACES: Final[list[tuple[int, int]]] = []
"""Where its code is, once that was found: it stays there."""


def _places_of_compiler() -> list[tuple[int, int]]:
    """First addresses of its code, and those after it."""
    if not _PLACES:
        for line in Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines():
            ends, may, *_, file = line.split(maxsplit=5)
            if may == "r-xp" and Path(file).name.startswith(COMPILER):
                begin, end = (int(one, 16) for one in ends.split("-"))
                _PLACES.append((begin, end))
    return _PLACES
