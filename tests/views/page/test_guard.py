"""Which hosts and origins are served, and what every answer carries."""

import asyncio
from typing import Any

import pytest

from canskin.errors import InputError
from shell.service import PAGE_TOKEN
from views.page.guard import HEALTH, Access, Guard

TOKEN = "right-token-12345"  # noqa: S105 - of no server


async def _app(_scope: Any, _receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"cache-control", b"public")]})
    await send({"type": "http.response.body", "body": b"page"})


def answers(kind: str, hosts: tuple[str, ...] | None, query: str = "", **headers: str) -> list[dict[str, Any]]:
    """Return what the server sends to a connection with these headers."""
    return asked(Access(hosts, TOKEN), {"type": kind, "query_string": query.encode()}, **headers)


def asked(access: Access, scope: dict[str, Any], **headers: str) -> list[dict[str, Any]]:
    sent: list[dict[str, Any]] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        raise AssertionError("nothing is received")

    named = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(
        Guard(_app, access)(
            {"method": "GET", "path": "/", "query_string": b"", "headers": named} | scope, receive, send
        )
    )
    return sent


def status(kind: str, hosts: tuple[str, ...] | None, **headers: str) -> int:
    """Return the status of the answer, or the code with which a WebSocket is closed."""
    return code_of(answers(kind, hosts, **headers))


def code_of(sent: list[dict[str, Any]]) -> int:
    code = sent[0]["status"] if sent[0]["type"] == "http.response.start" else sent[0]["code"]
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
    assert status("http", tuple(Access.to(bound).hosts or ()), host=host) == 200


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


ACTION = {"type": "http", "method": "POST", "path": "/api/tare"}
LOOK = {"type": "http", "method": "GET", "path": "/api/state"}
PAGE = {"host": "10.0.0.5:8765", "origin": "http://10.0.0.5:8765", "content_type": "application/json"}
WITH_TOKEN = {"query_string": f"token={TOKEN}".encode()}


@pytest.mark.parametrize("is_shared", [False, True])
@pytest.mark.parametrize("scope", [ACTION, LOOK, {"type": "websocket", "path": "/ws"}])
def test_actions_need_the_token_and_on_a_network_to_look_does_too(scope: dict[str, Any], is_shared: bool) -> None:
    access = Access(None, TOKEN, is_shared)
    refused = 0 if scope is not ACTION and not is_shared else 1008 if scope["type"] == "websocket" else 403
    other = Access(None, "x").cookie
    for cookie in ("", f"{access.cookie}=", f"{access.cookie}={TOKEN}x", f"{other}={TOKEN}"):
        assert code_of(asked(access, scope, **PAGE, cookie=cookie)) == (refused or 200)
        wrong = {"query_string": b"token=" + TOKEN[:-1].encode()}
        assert code_of(asked(access, scope | wrong, **PAGE, cookie=cookie)) == (refused or 200)
    assert code_of(asked(access, scope, **PAGE, cookie=f"a=b; {access.cookie}={TOKEN}")) == 200
    assert code_of(asked(access, scope | WITH_TOKEN, **PAGE)) == 200


def test_health_needs_no_token_and_a_foreign_page_nothing_but_its_own() -> None:
    access = Access(None, TOKEN, is_shared=True)
    assert code_of(asked(access, LOOK | {"path": HEALTH}, **PAGE)) == 200
    foreign = PAGE | {"origin": "http://10.0.0.5:9999"}
    assert code_of(asked(access, ACTION, **foreign, cookie=f"{access.cookie}={TOKEN}")) == 403


def test_an_address_with_the_token_sets_a_cookie_that_no_script_reads() -> None:
    start = asked(Access(None, TOKEN), LOOK | WITH_TOKEN, **PAGE)[0]
    (cookie,) = [value.decode() for name, value in start["headers"] if name == b"set-cookie"]
    assert cookie == f"{Access(None, TOKEN).cookie}={TOKEN}; HttpOnly; SameSite=Strict; Path=/"
    assert not [name for name, _ in asked(Access(None, TOKEN), LOOK, **PAGE)[0]["headers"] if name == b"set-cookie"]


def test_a_token_is_that_of_the_environment_or_new(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PAGE_TOKEN, raising=False)
    assert Access.to("127.0.0.1").token != Access.to("127.0.0.1").token
    assert [Access.to(host).is_shared for host in ("::1", "localhost", "10.0.0.5", "0.0.0.0")] == [  # noqa: S104
        False,
        False,
        True,
        True,
    ]
    monkeypatch.setenv(PAGE_TOKEN, TOKEN)
    assert Access.to("127.0.0.1").token == TOKEN
    monkeypatch.setenv(PAGE_TOKEN, "too short")
    with pytest.raises(InputError, match="SKIN_PAGE_TOKEN: expected 16 or more letters"):
        Access.to("127.0.0.1")
