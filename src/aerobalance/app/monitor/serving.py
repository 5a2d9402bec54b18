"""Listens on the network, and ends everything in time when told to."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import signal
import ssl
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import uvicorn

from aerobalance.acquisition.scratch import remove_own
from aerobalance.app.monitor.access import AccessPolicy
from aerobalance.app.monitor.crowd import LARGEST_HEAD, TIMES, Crowd, Patient
from aerobalance.app.monitor.server import Page

ENDING: Final = 1.1
"""Time within which everything has ended, once it was told to [s]."""

_GRACE: Final = 0.5
_HANDS: Final = 32


class _Loop(asyncio.SelectorEventLoop):
    """An event loop that does not wait long for somebody who begins TLS and says no more."""

    async def create_server(self, *args: Any, **settings: Any) -> Any:
        if settings.get("ssl") is not None:
            settings["ssl_handshake_timeout"] = TIMES["head"]
        return await super().create_server(*args, **settings)


class _Server(uvicorn.Server):
    """Leaves the signals alone, and says when it listens."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    @contextlib.contextmanager
    def capture_signals(self):  # type: ignore[no-untyped-def]
        """Leave them to whoever serves."""
        yield

    async def startup(self, sockets=None):  # type: ignore[no-untyped-def]
        """Listen."""
        await super().startup(sockets)
        if self.started:
            self._ready()


def _config(page: Page, policy: AccessPolicy, certificate: tuple[Path, Path] | None) -> uvicorn.Config:
    settings: dict[str, Any] = {"timeout_graceful_shutdown": _GRACE}
    if certificate is not None:
        settings |= {"ssl_certfile": str(certificate[0]), "ssl_keyfile": str(certificate[1])}
    return uvicorn.Config(
        page.app,
        host=policy.host,
        port=policy.port,
        log_level="critical",
        access_log=False,
        server_header=False,
        date_header=False,
        proxy_headers=False,  # else anybody here could claim to be at any address
        http=type("Connection", (Patient,), {"crowd": Crowd()}),
        h11_max_incomplete_event_size=LARGEST_HEAD,
        ws="websockets-sansio",
        ws_max_size=65536,
        ws_per_message_deflate=False,
        ws_ping_interval=None,
        timeout_keep_alive=5,
        **settings,
    )


def serve(
    page: Page,
    policy: AccessPolicy,
    *,
    certificate: tuple[Path, Path] | None,
    ready: Callable[[], None],
    last: bool = False,
) -> None:
    """Serve until SIGTERM or Ctrl-C; all processes have ended when this returns, within `ENDING`.

    What still waits for something by then is left: the program ends at once. Blocks of a record that were acknowledged
    are on the disk, whatever becomes of its recorder.

    Parameters
    ----------
    page
        What is served.
    policy
        Where.
    certificate
        Certificate and key for TLS, or None.
    ready
        Called when the server listens.
    last
        Whether the program has nothing else to do: it then ends here, without waiting for the interpreter to tidy up.
    """
    server = _Server(_config(page, policy, certificate), ready)
    closing = threading.Thread(target=page.close, daemon=True)
    timer = threading.Timer(ENDING, _leave)
    timer.daemon = True
    told: list[float] = []

    async def run() -> None:
        loop = asyncio.get_running_loop()
        loop.set_default_executor(ThreadPoolExecutor(_HANDS))

        def end() -> None:
            page.ending.set()
            server.should_exit = True
            if not told:
                told.append(time.monotonic())
                closing.start()
                timer.start()

        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                loop.add_signal_handler(number, end)
            except NotImplementedError:  # Windows
                signal.signal(number, lambda *_: loop.call_soon_threadsafe(end))
        await server.serve()

    with asyncio.Runner(loop_factory=_Loop) as runner:
        runner.run(run())
    if told:
        closing.join(max(0.0, told[0] + ENDING - time.monotonic()))
    if last:
        _leave()
    _kill_all()
    timer.cancel()


def _kill_all() -> None:
    for process in multiprocessing.active_children():
        process.kill()
    remove_own()


def _leave() -> None:
    """End the program, whatever still waits for something."""
    _kill_all()
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    os._exit(0)


def check_certificate(certificate: Path, key: Path) -> None:
    """Refuse a certificate and key that cannot be used for TLS.

    Raises
    ------
    ValueError
        They cannot; the message says which and why.
    """
    for path, option in ((certificate, "--certificate"), (key, "--key")):
        try:
            path.read_bytes()
        except OSError as problem:
            raise ValueError(f"{option} {path}: {(problem.strerror or str(problem)).lower()}") from None

    def locked() -> str:
        raise ValueError(f"--key {key} is locked by a password; give a key without one (openssl rsa -in {key.name})")

    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=locked)
    except ssl.SSLError as problem:
        if problem.reason == "KEY_VALUES_MISMATCH":
            raise ValueError(f"--key {key} is not the key of --certificate {certificate}") from None
        raise ValueError(
            f"--certificate {certificate} and --key {key} must hold a certificate and its key as PEM text "
            "(-----BEGIN CERTIFICATE----- and -----BEGIN PRIVATE KEY-----)"
        ) from None
