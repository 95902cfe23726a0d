"""Access to the page's server: which hosts and origins are served, and the security headers for browsers."""

import socket
from collections.abc import Collection
from ipaddress import ip_address
from typing import Final
from urllib.parse import SplitResult, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

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


class Guard:
    """Middleware: refuse foreign hosts and origins, and add the security headers to every answer.

    A page of another site cannot open the WebSocket, because its ``Origin`` differs from ``Host``. DNS rebinding does
    not help it either: a request under a foreign name has a ``Host`` that is not in `hosts`.

    Parameters
    ----------
    hosts : collection of str, or None
        Host names that the server answers to; None: all.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str] | None) -> None:
        self._app = app
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(headers, scope.get("method", "") if scope["type"] == "http" else "websocket")
        if refusal and scope["type"] == "websocket":
            await WebSocketClose(code=1008, reason=refusal)(scope, receive, send)
        elif refusal:
            await PlainTextResponse(f"{refusal}\n", status_code=403)(scope, receive, send)
        else:
            await self._app(scope, receive, _with_headers(send))

    def _refusal(self, headers: Headers, method: str) -> str:
        host = headers.get("host", "")
        name = _split(f"//{host}").hostname or ""
        if self._hosts is not None and name not in self._hosts:
            return f"this server does not answer to the host '{host}'"
        origin = headers.get("origin")
        is_own = origin is not None and _split(origin).netloc == host
        if method == "websocket" and origin is not None and not is_own:
            return f"pages of {origin} may not read this skin"
        return self._refusal_to_act(headers, host, name, is_own=is_own) if method == "POST" else ""

    def _refusal_to_act(self, headers: Headers, host: str, name: str, *, is_own: bool) -> str:
        if not is_own:
            return f"only the page itself may ask for this, not {headers.get('origin', 'a program')}"
        if self._hosts is None and not _is_this_machine(name):
            return f"nothing is done for the host '{host}': open the page by the address of the machine"
        if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            return "expected Content-Type: application/json"
        return ""


def _split(address: str) -> SplitResult:
    """Return the parts of an address, empty ones if it is none."""
    try:
        return urlsplit(address)
    except ValueError:
        return urlsplit("")


def _is_this_machine(name: str) -> bool:
    """Tell whether a name of a host cannot have been pointed at this machine by somebody else."""
    try:
        ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name in {*LOOPBACK, own, f"{own.partition('.')[0]}.local"}
    return True


def _with_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers[name] = value
        await send(message)

    return send_with_headers
