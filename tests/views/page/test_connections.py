"""The limits of the page's connections, tried with sockets that never end what they begin."""

import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
import uvicorn

from tests.health.helpers import FabricStub
from tests.processes import PATIENCE_S
from tests.views.page.conftest import only
from views.page.actions import Action, SetMark
from views.page.app import build_app
from views.page.command import server_config
from views.page.connections import CONNECTIONS_OF_ADDRESS_MAX, REQUEST_S, WITHOUT_TOKEN_MAX
from views.page.guard import Access
from views.page.shown import Live

ACCESS = Access()
HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
WHOLE = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
MARK = (
    f"POST /api/mark?token={ACCESS.token} HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\n"
    'Content-Type: application/json\r\nContent-Length: 13\r\n\r\n{"label":"a"}'
).encode()
LIVE = (
    b"GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
#: Limits of the server here.
OF_ADDRESS, ALL = 16, 24
#: Longer than any limit of the server.
SILENCE_S = 4 * REQUEST_S


class Serving:
    """A page's server in this process."""

    def __init__(self, messages: Any) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        self.port = listener.getsockname()[1]
        self.is_asked, self.may_answer = threading.Event(), threading.Event()
        actions = {"mark": Action(SetMark, self._mark)}
        self.server = uvicorn.Server(
            server_config(build_app(only(Live(messages.layout, FabricStub().fabric), actions), ACCESS))
        )
        self._thread = threading.Thread(target=self.server.run, args=([listener],))
        self._thread.start()

    def _mark(self, _asked: SetMark) -> str:
        self.is_asked.set()
        self.may_answer.wait(PATIENCE_S)
        return "marked"

    def open(self, sent: bytes = HALF, source: str = "127.0.0.1") -> socket.socket:
        """Open a connection, and send the begin of a request."""
        opened = socket.create_connection(("127.0.0.1", self.port), SILENCE_S, (source, 0))
        opened.sendall(sent)
        return opened

    def answers(self, path: str = "healthz") -> bool:
        return httpx.get(f"http://127.0.0.1:{self.port}/{path}", timeout=PATIENCE_S).status_code == 200

    def close(self) -> None:
        self.server.should_exit = True
        self._thread.join()


@pytest.fixture
def serving(messages: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Serving]:
    monkeypatch.setattr("views.page.connections.CONNECTIONS_OF_ADDRESS_MAX", OF_ADDRESS)
    monkeypatch.setattr("views.page.connections.CONNECTIONS_MAX", ALL)
    serving = Serving(messages)
    yield serving
    serving.close()


def is_closed(opened: socket.socket) -> bool:
    """Wait until the server has closed a connection, or is silent for long."""
    try:
        while opened.recv(65536):
            pass
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False
    return True


@pytest.mark.heavy
def test_half_open_requests_of_one_address_leave_places(serving: Serving) -> None:
    with ExitStack() as stack:
        asking = stack.enter_context(serving.open(MARK))
        serving.is_asked.wait(PATIENCE_S)
        for _ in range(3 * OF_ADDRESS):
            stack.enter_context(serving.open())
        assert serving.answers()
        assert len(serving.server.server_state.connections) <= OF_ADDRESS
        serving.may_answer.set()
        assert asking.recv(100).startswith(b"HTTP/1.1 200 OK")  # what is being answered keeps its place


@pytest.mark.heavy
def test_half_open_requests_of_many_addresses_leave_places(serving: Serving) -> None:
    with ExitStack() as stack:
        for place in range(2 * ALL):
            stack.enter_context(serving.open(source=f"127.0.1.{1 + place % 8}"))
        assert serving.answers()
        assert len(serving.server.server_state.connections) <= ALL


@pytest.mark.heavy
def test_pages_without_token_leave_places_to_one_with_the_token(messages: Any) -> None:
    serving = Serving(messages)
    with ExitStack() as stack:
        stack.callback(serving.close)
        opened = [stack.enter_context(serving.open(LIVE)) for _ in range(CONNECTIONS_OF_ADDRESS_MAX)]
        begun = [each.recv(12) for each in opened]
        assert begun.count(b"HTTP/1.1 101") == WITHOUT_TOKEN_MAX
        assert begun.count(b"HTTP/1.1 403") == CONNECTIONS_OF_ADDRESS_MAX - WITHOUT_TOKEN_MAX
        assert serving.answers()
        assert serving.answers(f"?token={ACCESS.token}")
        assert not serving.answers("")


@pytest.mark.heavy
@pytest.mark.parametrize(
    "sent", [b"", HALF, MARK[:-1], HALF + b"X: " + b"x" * 20000], ids=["none", "half", "body", "long"]
)
@pytest.mark.parametrize("before", [b"", WHOLE], ids=["first", "second"])
def test_a_request_that_does_not_become_whole_is_hung_up_on(
    serving: Serving, before: bytes, sent: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("views.page.connections.REQUEST_S", 0.1)
    with serving.open(before) as opened:
        if before:
            assert opened.recv(100).startswith(b"HTTP/1.1 200 OK")
        opened.sendall(sent)
        assert is_closed(opened)
    assert serving.answers()


@pytest.mark.heavy
def test_a_websocket_outlives_the_limit_of_requests(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    from websockets.sync.client import connect

    monkeypatch.setattr("views.page.connections.REQUEST_S", 0.05)
    with connect(f"ws://127.0.0.1:{serving.port}/ws") as page:
        page.recv(timeout=PATIENCE_S)
        for _ in range(20):  # 0.8 s
            page.recv(timeout=PATIENCE_S)
            page.send("ok")
