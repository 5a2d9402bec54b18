"""The command monitor: the operator's page."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from aerobalance.acquire.setup import load_setup
from aerobalance.io.hdf5_closing import close_all_broken_off, closed_text
from aerobalance.monitor.access import Door, is_loopback
from aerobalance.monitor.folder import Folder
from aerobalance.monitor.setups import rig_setup

DEFAULT_PORT: Final = 8765
"""Port where none is given."""


@dataclass(frozen=True, slots=True)
class Reach:
    """From where the page can be reached.

    Attributes
    ----------
    host, port
        Address and port that it listens on; port 0 for any free one.
    token
        What viewers must know; needed where `host` is no loopback address.
    certificate, key
        Files for TLS.
    """

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    token: str | None = None
    certificate: Path | None = None
    key: Path | None = None


def monitor(
    setup: Path | None = None,
    *,
    reach: Reach | None = None,
    folder: Path | None = None,
    browser: bool = True,
    say: Callable[[str], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> None:
    """Serve the operator's page until SIGTERM or Ctrl-C.

    Parameters
    ----------
    setup
        Test set-up; None for the simulated cable cut.
    reach
        Where the page can be reached.
    folder
        Project folder: records and results go there, and nothing outside is read or written. That of the set-up, or
        else the present one, if None.
    browser
        Whether to open the page in the browser.
    say, warn
        Take a line for the operator.

    Raises
    ------
    ReadError, ValueError
        The set-up or the call is wrong, or the port is taken.
    """
    reach = reach or Reach()
    if (reach.certificate is None) != (reach.key is None):
        raise ValueError("--certificate and --key go together")
    chosen = rig_setup("cable_cut") if setup is None else load_setup(setup)
    place = folder or (Path() if setup is None else setup.parent)
    if not place.is_dir() or not os.access(place, os.W_OK):
        raise ValueError(f"the project folder {place} is not there or cannot be written to")
    for name in close_all_broken_off(place):
        warn(closed_text(name))
    port = reach.port or _free_port(reach.host)
    secure = reach.certificate is not None
    door = Door(reach.host, port, token=reach.token, secure=secure)
    _check_free(reach.host, port)
    if not is_loopback(reach.host) and not secure:
        warn(
            "without TLS (--certificate and --key) the token and all that is shown can be read on the network; "
            "use it on a network that you trust, or through a tunnel"
        )
    from aerobalance.monitor.server import Page, serve  # noqa: PLC0415 - the call is checked before it is loaded
    from aerobalance.monitor.station import Beginning  # noqa: PLC0415

    page = Page(Beginning(chosen, Folder(place), setup), door=door)
    name = "localhost" if is_loopback(reach.host) and ":" in reach.host else reach.host
    address = f"{'https' if secure else 'http'}://{name}:{port}/"

    def ready() -> None:
        say(f"the page is at {address}; Ctrl-C ends it")
        if browser:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    certificate = None if reach.certificate is None or reach.key is None else (reach.certificate, reach.key)
    serve(page, door, certificate=certificate, ready=ready)


def _check_free(host: str, port: int) -> None:
    """Refuse a port that is taken, before any process is started."""
    import socket  # noqa: PLC0415 - this alone needs it

    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if sys.platform != "win32":
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as problem:
            reason = problem.strerror or problem
            raise ValueError(f"cannot listen on {host} port {port}: {reason}; give another --port") from None


def _free_port(host: str) -> int:
    import socket  # noqa: PLC0415 - this alone needs it

    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind((host, 0))
        port: int = probe.getsockname()[1]
        return port
