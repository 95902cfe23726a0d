"""Which hosts and origins are served, and what every answer carries."""

import asyncio
from typing import Any

import pytest

from views.page.command import _hosts
from views.page.guard import Guard


async def _app(_scope: Any, _receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"cache-control", b"public")]})
    await send({"type": "http.response.body", "body": b"page"})


def answers(kind: str, hosts: tuple[str, ...] | None, **headers: str) -> list[dict[str, Any]]:
    """Return what the server sends to a connection with these headers."""
    sent: list[dict[str, Any]] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        raise AssertionError("nothing is received")

    scope = {"type": kind, "headers": [(name.encode(), value.encode()) for name, value in headers.items()]}
    asyncio.run(Guard(_app, hosts)(scope, receive, send))
    return sent


def status(kind: str, hosts: tuple[str, ...] | None, **headers: str) -> int:
    """Return the status of the answer, or the code with which a WebSocket is closed."""
    first = answers(kind, hosts, **headers)[0]
    code = first["status"] if first["type"] == "http.response.start" else first["code"]
    assert isinstance(code, int)
    return code


LOCAL = ("localhost", "::1")


@pytest.mark.parametrize(
    ("host", "code"),
    [
        ("localhost", 200),
        ("localhost:8765", 200),
        ("LOCALHOST", 200),
        ("[::1]:80", 200),
        ("evil.example", 403),
        ("[::1", 403),
        ("", 403),
    ],
)
def test_only_known_hosts_are_served(host: str, code: int) -> None:
    assert status("http", LOCAL, host=host) == code
    assert status("http", None, host=host) == 200


@pytest.mark.parametrize(
    ("bound", "host"), [("Palm.local", "palm.local:8765"), ("FD00:0::1", "[fd00::1]:8765"), ("10.0.0.5", "10.0.0.5")]
)
def test_the_address_of_the_server_is_served_as_browsers_write_it(bound: str, host: str) -> None:
    assert status("http", tuple(_hosts(bound) or ()), host=host) == 200


def test_a_request_without_a_host_is_refused() -> None:
    assert status("http", LOCAL) == 403


@pytest.mark.parametrize(
    ("origin", "code"),
    [
        ("http://localhost:8765", 200),
        *((other, 1008) for other in ("http://localhost", "http://evil.example", "http://[::1", "null")),
    ],
)
def test_pages_of_other_origins_open_no_websocket(origin: str, code: int) -> None:
    for hosts in (LOCAL, None):
        assert status("websocket", hosts, host="localhost:8765", origin=origin) == code
        assert status("http", hosts, host="localhost:8765", origin=origin) == 200


def test_programs_without_an_origin_open_a_websocket_of_a_known_host() -> None:
    assert status("websocket", LOCAL, host="localhost:8765") == 200
    assert status("websocket", LOCAL, host="evil.example") == 1008


def test_refusals_name_what_is_refused() -> None:
    body = answers("http", LOCAL, host="evil.example")[1]["body"]
    assert body == b"this server does not answer to the host 'evil.example'\n"
    (closed,) = answers("websocket", LOCAL, host="localhost", origin="http://evil.example")
    assert closed["reason"] == "pages of http://evil.example may not read this skin"


def test_every_answer_has_the_security_headers_once() -> None:
    start, body = answers("http", LOCAL, host="localhost")
    headers = {name.decode(): value.decode() for name, value in start["headers"]}
    assert len(headers) == len(start["headers"]) == 6
    assert headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'; ")
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-opener-policy"] == "same-origin"
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert headers["cache-control"] == "no-cache"
    assert body["body"] == b"page"


def test_what_is_no_connection_goes_through_untouched() -> None:
    start, _ = answers("lifespan", LOCAL)
    assert start["headers"] == [(b"cache-control", b"public")]
