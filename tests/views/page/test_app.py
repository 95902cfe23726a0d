"""The server: what it answers, and to whom."""

import struct
import threading
import warnings
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from starlette.exceptions import StarletteDeprecationWarning

from canskin.fabric import Fabric
from canskin.messages import GATEWAY, IMAGE, LABEL, LONGEST_LABEL, NODES, TRUTH
from tests.health.helpers import FabricStub
from tests.processes import PATIENCE_S
from tests.views.page.conftest import only
from views.page.app import build_app
from views.page.shown import Live

with warnings.catch_warnings():  # it would rather stand on httpx2
    warnings.simplefilter("ignore", StarletteDeprecationWarning)
    from starlette.testclient import TestClient


@pytest.fixture
def live(messages: Any) -> Live:
    return Live(messages.layout, FabricStub().fabric)


@pytest.fixture
def client(live: Live) -> Iterator[TestClient]:
    with TestClient(build_app(only(live)), base_url="http://127.0.0.1:8765") as client:
        yield client


def header(content: bytes) -> Any:
    (length,) = struct.unpack_from("<I", content)
    return msgspec.json.decode(content[4 : 4 + length])


@pytest.mark.parametrize("path", ["/", "/static/main.js", "/static/colours.js", "/static/page.css", "/static/icon.svg"])
def test_page_is_complete_and_guarded(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"].split("; ")
    assert {"default-src 'none'", "script-src 'self'", "frame-ancestors 'none'", "base-uri 'none'"} <= set(policy)
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_page_fetches_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/").text
    for line in page.splitlines():
        if "src=" in line or "href=" in line:
            assert '="/static/' in line or '<a href="/"' in line
    assert "style=" not in page
    assert "<script>" not in page


def test_the_field_of_marks_takes_the_longest_label(client: TestClient) -> None:
    assert f'name="label" list="labels" maxlength="{LONGEST_LABEL}"' in client.get("/").text


def test_state_is_json(client: TestClient) -> None:
    state = client.get("/api/state").json()
    assert state["skin"] == "palm"
    assert state["image"] is None
    assert state["figures"]["blocks"] == 8
    assert client.get("/healthz").json() == {"status": "ok"}


def test_unknown_path_and_climbing_out_are_not_found(client: TestClient) -> None:
    assert client.get("/nothing").status_code == 404
    assert client.get("/static/%2e%2e/app.py").status_code == 404


def test_socket_greets_and_then_sends_frames(client: TestClient) -> None:
    with client.websocket_connect("ws://127.0.0.1:8765/ws") as socket:
        assert msgspec.json.decode(socket.receive_text())["columns"] == 16
        times = []
        for _ in range(5):  # more than may be on their way: acknowledging goes on
            times.append(header(socket.receive_bytes())["snapshot"]["time_s"])
            socket.send_text("ok")
    assert times == sorted(set(times))


def test_page_that_breaks_the_rules_is_hung_up_on(client: TestClient) -> None:
    with client.websocket_connect("ws://127.0.0.1:8765/ws") as socket:
        for _ in range(10):
            socket.send_text("ok")
        while (message := socket.receive())["type"] != "websocket.close":
            assert message["type"] == "websocket.send"
    assert message["code"] == 1008


def test_name_pointed_at_this_machine_is_refused(client: TestClient) -> None:
    answer = client.get("/api/state", headers={"host": "evil.example:8765"})
    assert (answer.status_code, "evil.example" in answer.text) == (403, True)


def test_messages_from_the_fabric_are_shown(messages: Any, hub: Fabric, endpoint: str) -> None:
    fabric = Fabric(messages.layout.name, "viewer", endpoint)
    live = Live(messages.layout, fabric)
    pause = threading.Event()
    for cycle in range(1, round(PATIENCE_S / 0.02)):
        hub.publish(IMAGE, messages.image(cycle))
        hub.publish(TRUTH, messages.truth(cycle))
        hub.publish(LABEL, messages.label())
        hub.publish(GATEWAY, messages.gateway())
        hub.publish(NODES, messages.nodes())
        state = live.snapshot()[0]
        if state.image and state.truth and state.label and state.gateway and state.nodes and state.services:
            break
        pause.wait(0.02)
    else:
        pytest.fail("nothing was heard")
    fabric.close()
    assert state.services["gateway"].alive
    assert state.label.label == "golf-ball"
