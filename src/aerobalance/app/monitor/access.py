"""Who may use the page: hosts, origins and the token are checked before anything else happens."""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from typing import Any, Final
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Receive, Scope, Send

from aerobalance.app.monitor.logins import SHORTEST_TOKEN, VARIABLE, Logins, check_token

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the page may load: nothing that does not come from this server."""

REPORT_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'; sandbox"
)
"""What a report may do: show itself. Its styles are within it, and it runs no script."""


def is_loopback(host: str) -> bool:
    """Say whether an address is that of this computer alone."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Door:
    """Where the server listens, and what it asks for.

    Attributes
    ----------
    host, port
        Where it listens.
    token
        What a viewer must know; None on loopback alone.
    secure
        Whether it speaks TLS.
    names
        Further names that it may be reached under.
    """

    host: str
    port: int
    token: str | None = None
    secure: bool = False
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.token is None and not is_loopback(self.host):
            raise ValueError(
                f"--host {self.host} is reached from other computers: give --token-file FILE or the variable "
                f"{VARIABLE} with a secret of at least {SHORTEST_TOKEN} characters, which viewers have to know"
            )
        if self.token is not None:
            check_token(self.token)

    def host_allowed(self, host: str) -> bool:
        """Whether a request is for this server: a page elsewhere may have had its name point here."""
        name, port = _split(host)
        if port != (self.port if port else None) and port is not None:
            return False
        if is_loopback(name):
            return is_loopback(self.host) or self.host in ("0.0.0.0", "::")
        if name in (self.host, *self.names):
            return True
        return not is_loopback(self.host) and _is_address(name)

    def origin_allowed(self, origin: str, host: str) -> bool:
        """Whether a request comes from this server's own page."""
        return origin == f"{'https' if self.secure else 'http'}://{host}"


def _split(host: str) -> tuple[str, int | None]:
    """Name and port of a Host header; a port that is none is 0."""
    name, colon, port = host.rpartition(":")
    if not colon or host.endswith("]"):
        return host.strip("[]"), None
    return name.strip("[]"), int(port) if port.isascii() and port.isdecimal() and len(port) < 6 else 0


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class Guard:
    """Lets requests through to the page, or not.

    Parameters
    ----------
    app
        The page.
    door
        What is asked for.
    """

    def __init__(self, app: ASGIApp, door: Door) -> None:
        self._app, self._door = app, door
        self.logins = Logins(door.token, door.port)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request and pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        status, text = self._check(scope, headers)
        if status == 0:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": text})
        elif status == 303:
            cookie = f"{self.logins.name}={self.logins.cookie}; HttpOnly; SameSite=Strict; Path=/"
            cookie += "; Secure" if self._door.secure else ""
            await _answer(send, 303, "", [(b"location", b"/"), (b"set-cookie", cookie.encode())])
        else:
            await _answer(send, status, text)

    def _check(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str]:
        """Status and reason of a refusal; status 0 for none."""
        door, host, origin = self._door, headers.get("host", ""), headers.get("origin")
        if not door.host_allowed(host):
            return 400, "this server is not reached under that name"
        safe = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not safe and (origin is None or not door.origin_allowed(origin, host)):
            return 403, "this is not asked by the page of this server"
        if (
            safe
            and headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none")
            and (scope["path"] != "/")
        ):
            return 403, "this is not asked by the page of this server"
        return self._check_token(scope, headers, asked=safe)

    def _check_token(self, scope: Scope, headers: dict[str, str], *, asked: bool) -> tuple[int, str]:
        """Status and reason of a refusal of who does not know the token; 303 for who has just shown it."""
        logins = self.logins
        if not logins.asked:
            return 0, ""
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        token, once = (query.get(name, [""])[0] for name in ("token", "once"))
        address = (scope.get("client") or ("",))[0]
        if asked and once and logins.redeem(once):
            return 303, ""
        if asked and token:
            wait = logins.waits(address)
            if wait:
                return 429, f"too many wrong tokens came from {address}; wait {wait:.0f} s"
            if logins.right(token, address):
                return 303, ""
        if not logins.known(_cookie(headers.get("cookie", ""), logins.name)):
            return 401, "open the page once with its token: http(s)://HOST:PORT/?token=SECRET"
        return 0, ""


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _with_headers(send: Send) -> Send:
    """Add what every answer says to browsers."""

    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            given = {name.lower() for name, _ in message["headers"]}
            more = [
                (b"content-security-policy", POLICY.encode()),
                (b"x-content-type-options", b"nosniff"),
                (b"referrer-policy", b"no-referrer"),
                (b"cross-origin-opener-policy", b"same-origin"),
                (b"cross-origin-resource-policy", b"same-origin"),
                (b"cache-control", b"no-store"),
            ]
            message["headers"] = [*message["headers"], *(item for item in more if item[0] not in given)]
        await send(message)

    return sending


async def _answer(send: Send, status: int, text: str, headers: list[tuple[bytes, bytes]] | None = None) -> None:
    body = text.encode()
    send = _with_headers(send)
    start = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": [*start, *(headers or [])]})
    await send({"type": "http.response.body", "body": body})
