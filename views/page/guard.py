"""Access to the page's server: which hosts, origins and tokens are served, and the security headers for browsers."""

import hashlib
import os
import re
import secrets
from collections.abc import Collection
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Final
from urllib.parse import SplitResult, urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from canskin.errors import InputError
from canskin.session import is_loopback
from shell.service import PAGE_TOKEN
from views.page.connections import WITHOUT_TOKEN_MAX

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")


#: Path that is served without a token.
HEALTH: Final = "/healthz"


@dataclass(frozen=True)
class Access:
    """Whom the server serves.

    Attributes
    ----------
    hosts
        Host names that the server answers to; None: all.
    token
        What a request shows that asks for an action: as ``token`` in its address, or in the cookie that the server
        sets in answer to such an address.
    is_shared
        Other machines reach the server: looking needs the token, too.
    """

    hosts: Collection[str] | None = LOOPBACK
    token: str = field(default_factory=secrets.token_urlsafe)
    is_shared: bool = False

    @classmethod
    def to(cls, host: str) -> "Access":
        """Return the access to a server that is bound to `host`; its token is that of the environment, or a new one."""
        token = os.environ.get(PAGE_TOKEN) or secrets.token_urlsafe()
        if not re.fullmatch(r"[A-Za-z0-9_-]{16,}", token):
            raise InputError(f"{PAGE_TOKEN}: expected 16 or more letters, digits, - and _")
        try:
            address = ip_address(host)
        except ValueError:
            hosts: Collection[str] | None = (*LOOPBACK, host.lower())
        else:
            hosts = None if address.is_unspecified else (*LOOPBACK, str(address))
        return cls(hosts, token, is_shared=not is_loopback(host))

    @property
    def cookie(self) -> str:
        """Name of the cookie: servers on other ports have others."""
        return f"canskin-{hashlib.sha256(self.token.encode()).hexdigest()[:8]}"

    def is_shown(self, token: str) -> bool:
        """Tell whether a token is the right one, in a time that tells nothing about it."""
        return secrets.compare_digest(token.encode(), self.token.encode())


class Guard:
    """Middleware: refuse foreign hosts, origins and tokens, and add the security headers to every answer.

    A page of another site cannot open the WebSocket, because its ``Origin`` differs from ``Host``. DNS rebinding does
    not help it either: a request under a foreign name has no cookie.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access
        self._without_token = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        request, access = HTTPConnection(scope), self._access
        is_addressed = access.is_shown(request.query_params.get("token", ""))
        is_known = is_addressed or access.is_shown(request.cookies.get(access.cookie, ""))
        refusal = self._refusal(request, is_known=is_known)
        if refusal and scope["type"] == "websocket":
            await WebSocketClose(code=1008, reason=refusal)(scope, receive, send)
        elif refusal:
            await PlainTextResponse(f"{refusal}\n", status_code=403)(scope, receive, send)
        else:
            cookie = f"{access.cookie}={access.token}; HttpOnly; SameSite=Strict; Path=/" if is_addressed else ""
            self._without_token += not is_known
            try:
                await self._app(scope, receive, _with_headers(send, cookie))
            finally:
                self._without_token -= not is_known

    def _refusal(self, request: HTTPConnection, *, is_known: bool) -> str:
        headers, kind = request.headers, request.scope["type"]
        method = request.scope["method"] if kind == "http" else kind
        host = headers.get("host", "")
        if self._access.hosts is not None and (_split(f"//{host}").hostname or "") not in self._access.hosts:
            return f"this server does not answer to the host '{host}'"
        origin = headers.get("origin")
        is_own = origin is not None and _split(origin).netloc == host
        if method == "websocket" and origin is not None and not is_own:
            return f"pages of {origin} may not read this skin"
        if method == "POST" and not is_own:
            return f"only the page itself may ask for this, not {headers.get('origin', 'a program')}"
        if method == "POST" and headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            return "expected Content-Type: application/json"
        is_look_closed = self._access.is_shared or self._without_token >= WITHOUT_TOKEN_MAX
        needs_token = method == "POST" or (is_look_closed and request.scope["path"] != HEALTH)
        if needs_token and not is_known:
            return "expected the page's token: open the page by the address that 'skin view' logs"
        return ""


def _split(address: str) -> SplitResult:
    """Return the parts of an address, empty ones if it is none."""
    try:
        return urlsplit(address)
    except ValueError:
        return urlsplit("")


def _with_headers(send: Send, cookie: str) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers[name] = value
            if cookie:
                headers.append("Set-Cookie", cookie)
        await send(message)

    return send_with_headers
