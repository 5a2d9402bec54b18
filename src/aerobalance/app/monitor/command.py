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

from aerobalance.acquisition.setup import load_setup
from aerobalance.app.monitor.access import AccessPolicy, is_loopback
from aerobalance.app.monitor.folder import Folder
from aerobalance.app.monitor.setups import check_files, rig_setup
from aerobalance.io.hdf5_closing import close_all_broken_off, closed_text
from aerobalance.recording.errors import ReadError

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
    last: bool = False,
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
    last
        Whether the program has nothing else to do: it ends with the page, by `os._exit`.
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
    try:
        check_files(chosen, Folder(place))
    except ReadError as problem:
        raise ReadError(
            setup or "set-up",
            problem.where,
            f"{problem.what}, where the page reads and writes; move the file below it, or give --folder FOLDER: the "
            "names of files in the set-up are then read from there",
        ) from None
    for name in close_all_broken_off(place):
        warn(closed_text(name))
    port = reach.port or _free_port(reach.host)
    secure = reach.certificate is not None
    policy = AccessPolicy(reach.host, port, token=reach.token, secure=secure)
    _check_free(reach.host, port)
    if not is_loopback(reach.host) and not secure:
        warn(
            "without TLS (--certificate and --key) the token and all that is shown can be read on the network; "
            "use it on a network that you trust, or through a tunnel"
        )
    from aerobalance.app.monitor.server import Page  # noqa: PLC0415 - the call is checked before it is loaded
    from aerobalance.app.monitor.serving import check_certificate, serve  # noqa: PLC0415
    from aerobalance.app.monitor.session import Beginning  # noqa: PLC0415

    certificate = None if reach.certificate is None or reach.key is None else (reach.certificate, reach.key)
    if certificate is not None:
        check_certificate(*certificate)
    page = Page(Beginning(chosen, Folder(place), setup), policy=policy)
    address = _address(policy, reach.host)

    def ready() -> None:
        say(f"the page is at {address}; Ctrl-C ends it")
        if browser:
            own = _address(policy, "127.0.0.1") if reach.host == "0.0.0.0" else address
            mine = f"{own}?once={page.app.logins.once()}" if page.app.logins.asked else own
            threading.Thread(target=webbrowser.open, args=(mine,), daemon=True).start()

    serve(page, policy, certificate=certificate, ready=ready, last=last)


def _address(policy: AccessPolicy, host: str) -> str:
    """Address of the page for a browser."""
    name = host if ":" not in host else "localhost" if is_loopback(host) or host == "::" else f"[{host}]"
    return f"{'https' if policy.secure else 'http'}://{name}:{policy.port}/"


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
