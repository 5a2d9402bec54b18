"""Access control of the monitor's server: Host and Origin headers and the token are checked before each request."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import ip_address
from typing import Final

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from aerobalance.app.monitor.logins import SHORTEST_TOKEN, VARIABLE, Logins, check_token

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy of the page: it loads nothing that does not come from this server."""

REPORT_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'; sandbox"
)
"""Content security policy of a report: its styles are inline, and it runs no script."""

HEADERS: Final = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""Headers of every response that does not set them itself."""


def is_loopback(host: str) -> bool:
    """Return whether a host name or address is the loopback, which only this computer reaches."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class AccessPolicy:
    """Address of the server, and what a request must have to be answered.

    Attributes
    ----------
    host, port
        Address and port on which it listens.
    token
        Secret that a viewer must know; None is allowed on the loopback only.
    secure
        Whether it speaks TLS.
    names
        Further host names under which it may be reached.
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
        """Whether the Host header names this server.

        Other names are refused, as a foreign page may have its own name resolve to this address (DNS rebinding); an
        address cannot do that, and is allowed where the server is not on the loopback.
        """
        name, port = _split(host)
        if port != (self.port if port else None) and port is not None:
            return False
        if is_loopback(name):
            return is_loopback(self.host) or self.host in ("0.0.0.0", "::")
        if name in (self.host, *self.names):
            return True
        return not is_loopback(self.host) and _is_address(name)

    def origin_allowed(self, origin: str, host: str) -> bool:
        """Whether the Origin header is that of this server's own page."""
        return origin == f"{'https' if self.secure else 'http'}://{host}"


def _split(host: str) -> tuple[str, int | None]:
    """Name and port of a Host header; None without a port, and 0 for a port that is not a number."""
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


class AccessControl:
    """ASGI application that passes allowed requests on to the page and refuses others.

    Parameters
    ----------
    app
        The page.
    policy
        What a request must have.
    """

    def __init__(self, app: ASGIApp, policy: AccessPolicy) -> None:
        self._app, self._policy = app, policy
        self.logins = Logins(policy.token, policy.port)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass an allowed request on; answer another with its refusal, or a login with a redirection."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status, text = self._check(HTTPConnection(scope))
        answer: ASGIApp = self._app
        if status and scope["type"] == "websocket":
            answer = WebSocketClose(1008, text)
        elif status == 303:
            answer = self._logged_in()
        elif status:
            answer = PlainTextResponse(text, status)
        await answer(scope, receive, _with_headers(send))

    def _logged_in(self) -> Response:
        """Redirection to the page that sets the login cookie, so that the token does not stay in the address."""
        answer = RedirectResponse("/", 303)
        logins, secure = self.logins, self._policy.secure
        answer.set_cookie(logins.name, logins.cookie, httponly=True, samesite="strict", secure=secure)
        return answer

    def _check(self, request: HTTPConnection) -> tuple[int, str]:
        """HTTP status and reason of a refusal; status 0 where the request is allowed, 303 for a login."""
        policy, headers = self._policy, request.headers
        host, origin = headers.get("host", ""), headers.get("origin")
        if not policy.host_allowed(host):
            return 400, "this server is not reached under that name"
        safe = request.scope["type"] == "http" and request.scope["method"] in ("GET", "HEAD")
        if not safe and (origin is None or not policy.origin_allowed(origin, host)):
            return 403, "this is not asked by the page of this server"
        if (
            safe
            and headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none")
            and (request.scope["path"] != "/")  # another site may hold a link to the page itself
        ):
            return 403, "this is not asked by the page of this server"
        return self._check_token(request, asked=safe)

    def _check_token(self, request: HTTPConnection, *, asked: bool) -> tuple[int, str]:
        """HTTP status and reason of a refusal without a login; status 303 where the request has a right token."""
        logins = self.logins
        if not logins.asked:
            return 0, ""
        token, once = (request.query_params.get(name, "") for name in ("token", "once"))
        address = request.client.host if request.client else ""
        if asked and once and logins.redeem(once):
            return 303, ""
        if asked and token:
            wait = logins.waits(address)
            if wait:
                return 429, f"too many wrong tokens came from {address}; wait {wait:.0f} s"
            if logins.right(token, address):
                return 303, ""
        if not logins.known(request.cookies.get(logins.name, "")):
            return 401, "open the page once with its token: http(s)://HOST:PORT/?token=SECRET"
        return 0, ""


def _with_headers(send: Send) -> Send:
    """Return `send` with `HEADERS` added to each response."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
