"""The token that viewers must know: where it comes from, what it must be like, and how often it may be wrong."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

VARIABLE: Final = "AEROBALANCE_TOKEN"
"""Environment variable that a token may be in."""

SHORTEST_TOKEN: Final = 16
"""Characters that a token has at least."""

FEWEST_DIFFERENT: Final = 6
"""Different characters that a token has at least."""

FREE_TRIES: Final = 4
"""Wrong tokens of an address before it has to wait."""

LONGEST_WAIT: Final = 300.0
"""Longest time for which an address has to wait [s]."""

_ALLOWED: Final = re.compile(r"[A-Za-z0-9._~-]+", re.ASCII)
_LARGEST_FILE: Final = 4096
_ONCE: Final = 60.0
_ADDRESSES: Final = 1000


def check_token(token: str) -> None:
    """Refuse a token that is soon guessed, or that a cookie cannot hold.

    Raises
    ------
    ValueError
        It is one; the message does not repeat it.
    """
    if len(token) < SHORTEST_TOKEN or len(set(token)) < FEWEST_DIFFERENT or not _ALLOWED.fullmatch(token):
        raise ValueError(
            f"the token must have at least {SHORTEST_TOKEN} characters, {FEWEST_DIFFERENT} of them different, out of "
            "A-Z a-z 0-9 . _ ~ -; a good one comes from: python -c 'import secrets; print(secrets.token_urlsafe())'"
        )


def find_token(
    given: str | None, file: Path | None, environment: Mapping[str, str], warn: Callable[[str], None]
) -> str | None:
    """Return the token from the command line, from a file or from the environment; None where there is none.

    Parameters
    ----------
    given
        What the command line says.
    file
        File whose only line is the token.
    environment
        Variables of the environment.
    warn
        Takes a line on a token that others can read.

    Raises
    ------
    ValueError
        There are two, or the file cannot be read.
    """
    if given is not None and file is not None:
        raise ValueError("--token and --token-file are two tokens; give one of them")
    if given is not None:
        warn(
            "--token is seen by everybody on this computer in the list of processes, and is kept in the shell's "
            f"history; better give --token-file FILE, or the variable {VARIABLE}"
        )
        return given
    if file is None:
        return environment.get(VARIABLE) or None
    try:
        if not file.is_file():
            raise ValueError(f"--token-file {file}: there is no such file")
        with file.open("rb") as stream:
            text = stream.read(_LARGEST_FILE + 1)
        open_to = stat.S_IMODE(file.stat().st_mode) & (stat.S_IRWXG | stat.S_IRWXO)
    except OSError as problem:
        raise ValueError(f"--token-file {file}: {(problem.strerror or str(problem)).lower()}") from None
    if os.name == "posix" and open_to:
        warn(f"others on this computer can read the token in {file}; chmod 600 {file.name} keeps it to yourself")
    return text.decode("utf-8", "replace").strip()


class Logins:
    """Lets viewers in who know the token, and keeps those waiting who guess.

    Parameters
    ----------
    token
        The token; None where none is asked for.
    port
        Port of the page: cookies go to all ports of a host.
    """

    def __init__(self, token: str | None, port: int) -> None:
        self._token = token
        self._once: dict[str, float] = {}
        self._wrong: dict[str, tuple[int, float]] = {}
        self.name = f"aerobalance_{port}"
        # made from the token, so that it outlives the page, and nobody who sees it knows the token
        key = f"viewer of the page on port {port}".encode()
        self.cookie = "" if token is None else hmac.new(token.encode(), key, hashlib.sha256).hexdigest()

    @property
    def asked(self) -> bool:
        """Whether a token is asked for."""
        return self._token is not None

    def once(self) -> str:
        """Return a secret that lets one viewer in, once and soon: a browser's address is no place for the token."""
        code = secrets.token_urlsafe()
        self._once[code] = time.monotonic() + _ONCE
        return code

    def redeem(self, code: str) -> bool:
        """Whether such a secret lets somebody in; it does not a second time."""
        return self._once.pop(code, 0.0) > time.monotonic()

    def waits(self, address: str) -> float:
        """Time for which an address has to wait before it may try another token [s]."""
        return max(0.0, self._wrong.get(address, (0, 0.0))[1] - time.monotonic())

    def right(self, token: str, address: str) -> bool:
        """Whether a token is the right one, without telling by time how far it is; a wrong one is counted."""
        if self._token is None or hmac.compare_digest(token.encode(), self._token.encode()):
            self._wrong.pop(address, None)
            return True
        count = self._wrong.pop(address, (0, 0.0))[0] + 1
        wait = min(2.0 ** (count - FREE_TRIES), LONGEST_WAIT) if count > FREE_TRIES else 0.0
        self._wrong[address] = count, time.monotonic() + wait
        for old in list(self._wrong)[:-_ADDRESSES]:
            del self._wrong[old]
        return False

    def known(self, cookie: str) -> bool:
        """Whether a viewer has been let in before; a cookie is too long to be guessed, so that tries do not count."""
        return self._token is None or hmac.compare_digest(cookie.encode(), self.cookie.encode())
