"""One call at a time in a folder of results: who holds it is written there, and a call that was killed holds nothing.

On a disk the system's lock of a file does it, which ends with the process. A store has none: there the holder writes
again and again that it is at work, and whoever finds that silent takes its place.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from aerobalance.app.campaign.places import is_address, joined, store_of
from aerobalance.io.safe_write import reason_of

if sys.platform != "win32":
    import fcntl

LOCK: Final = ".lock"
"""Name of the file that says who works in the folder."""

BEAT: Final = 10.0
"""Time between two words of a holder in a store [s]."""

SILENCE: Final = 2.5
"""Beats without a word after which a holder in a store is gone."""


@contextmanager
def held(folder: str) -> Iterator[None]:
    """Work alone in a folder of results.

    Parameters
    ----------
    folder
        A path of a folder that exists, or an address.

    Raises
    ------
    ValueError
        Another call works in it; the message says which and since when. Or the folder cannot be written to.
    """
    place = joined(folder, LOCK)
    try:
        release = _said_again_and_again(folder, place) if is_address(folder) else _locked(folder, Path(place))
    except OSError as error:
        raise ValueError(f"cannot write {place}: {reason_of(error)}") from error
    try:
        yield
    finally:
        release()


def _holder() -> dict[str, Any]:
    """Who this is."""
    return {"process": os.getpid(), "host": socket.gethostname(), "since": datetime.now().isoformat(" ", "seconds")}


def _refusal(folder: str, content: bytes) -> ValueError:
    """Say who works in a folder."""
    who = "another call"
    with suppress(ValueError, TypeError, KeyError):  # it may just be writing it
        found = json.loads(content)
        who += f" (process {found['process']} on {found['host']}, since {found['since']})"
    return ValueError(
        f"{folder} is in use: {who} works on it. Wait until that has ended, or end it, and call again: what is done "
        "is kept. Or give another folder"
    )


def _locked(folder: str, place: Path) -> Callable[[], None]:
    """Take the system's lock, and return what gives it back."""
    if sys.platform == "win32":
        return _said_again_and_again(folder, str(place))
    handle = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        content = os.pread(handle, 1000, 0)
        os.close(handle)
        if isinstance(problem, BlockingIOError):
            raise _refusal(folder, content) from None
        return _said_again_and_again(folder, str(place))  # a file system without locks
    os.ftruncate(handle, 0)
    os.pwrite(handle, json.dumps(_holder()).encode(), 0)

    def release() -> None:
        os.ftruncate(handle, 0)
        os.close(handle)

    return release


def _said_again_and_again(folder: str, place: str) -> Callable[[], None]:
    """Write who this is until what is returned is called."""
    system, inside = store_of(place)
    token = secrets.token_hex(8)
    found = _content(system, inside)
    limit = time.monotonic() + SILENCE * BEAT
    while found:
        if time.monotonic() > limit:
            with suppress(FileNotFoundError):
                system.rm_file(inside)
            break
        time.sleep(min(1.0, BEAT / 10))
        before, found = found, _content(system, inside)
        if found and found != before:
            raise _refusal(folder, found)
    holder = _holder()

    def said(number: int) -> bytes:
        return json.dumps({**holder, "token": token, "beat": number}).encode()

    try:
        system.pipe_file(inside, said(0), mode="create")  # of two calls at once the store lets one through
    except FileExistsError:
        raise _refusal(folder, _content(system, inside)) from None
    ended = threading.Event()

    def go_on() -> None:
        number = 0
        while not ended.wait(BEAT):
            number += 1
            with suppress(Exception):  # the next beat may reach the store again
                system.pipe_file(inside, said(number))

    beating = threading.Thread(target=go_on, name="holds the results", daemon=True)
    beating.start()

    def release() -> None:
        ended.set()
        beating.join()
        with suppress(OSError):  # others find it silent
            system.rm_file(inside)

    return release


def _content(system: Any, inside: str) -> bytes:
    """What the holder last said; nothing where there is none."""
    try:
        system.invalidate_cache()
        return bytes(system.cat_file(inside))
    except FileNotFoundError:
        return b""
