"""Libraries of formats: imported when they are wanted, and what they fail with said as the program says it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from aerobalance.recording.errors import ReadError, quiet_libraries


@contextlib.contextmanager
def library_faults(path: Path, name: str, where: str = "") -> Iterator[None]:
    """Turn whatever a library fails with on a file into a `ReadError`, and keep what it would print to itself."""
    try:
        with quiet_libraries(), np.errstate(all="ignore"):
            yield
    except (ReadError, GeneratorExit, KeyboardInterrupt):
        raise
    except FileNotFoundError:
        raise ReadError(path, "", "there is no such file") from None
    except MemoryError:
        raise ReadError(
            path, where, "is damaged, or too large for the memory; read fewer channels at a time"
        ) from None
    except Exception as error:  # noqa: BLE001 - libraries fail in a dozen ways on damaged files
        text = " ".join(str(error).split()) or type(error).__name__
        raise ReadError(
            path, where, f"is a damaged file of {name}, or of a kind that cannot be read: {text[:200]}"
        ) from None


def library(module: str, extra: str, path: Path | str, what: str) -> Any:
    """Import the library of a format.

    Raises
    ------
    ReadError
        It is not installed; the message has the command that does it.
    """
    if find_spec(module.partition(".")[0]) is None:
        raise ReadError(
            path, "", f"is {what}, and needs a library that is not installed: pip install 'aerobalance[{extra}]'"
        )
    with quiet_libraries():  # of what the library finds or lacks on this machine
        return import_module(module)


def library_to_write(module: str, extra: str, path: Path | str, what: str) -> Any:
    """Import the library of a format that is written.

    Raises
    ------
    ValueError
        It is not installed; the message has the command that does it.
    """
    try:
        return library(module, extra, path, what)
    except ReadError:
        raise ValueError(
            f"cannot write {path}: {what} needs a library that is not installed: pip install 'aerobalance[{extra}]'"
        ) from None
