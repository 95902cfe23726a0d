"""What the page can ask for: what is done, what is refused with a sentence, and who may ask."""

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from starlette.exceptions import StarletteDeprecationWarning

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest
from canskin.errors import RunError
from canskin.fabric import Fabric
from canskin.messages import GATEWAY, MARK
from canskin.peers import Peer, new_peer
from shell.skin_options import join
from tests.health.helpers import FabricStub
from tests.recording.helpers import messages_of
from tests.views.page.conftest import only
from views.page.actions import live_actions, playback_actions
from views.page.app import build_app
from views.page.guard import Access
from views.page.playback import Playback
from views.page.record_process import RecorderProcess
from views.page.shown import Live

with warnings.catch_warnings():  # it would rather stand on httpx2
    warnings.simplefilter("ignore", StarletteDeprecationWarning)
    from starlette.testclient import TestClient

PAGE = "http://127.0.0.1:8765"


class Gateway(FabricStub):
    """Stands for the fabric with a gateway."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[CalibrationRequest] = []
        self.published: list[Any] = []
        self.reply = CalibrationReply(is_done=True, text="zero of 64 sums")

    def ask(self, question: Any, request: CalibrationRequest, _timeout_s: float) -> CalibrationReply:
        assert question is CALIBRATION
        self.asked.append(request)
        return self.reply

    def publish(self, topic: Any, message: Any) -> None:
        assert topic is MARK
        self.published.append(message)


class Recorder:
    """Stands for the process of a recorder."""

    def __init__(self) -> None:
        self.joined: Callable[[], bool] = bool

    def start(self, has_joined: Callable[[], bool]) -> str:
        self.joined = has_joined
        return "recording to run.mcap"

    def stop(self) -> str:
        raise RunError("no recording is being made")


def client_of(app: Any, access: Access) -> TestClient:
    """Return a client that has the cookie of the page."""
    client = TestClient(app, base_url=PAGE)
    client.cookies.set(access.cookie, access.token)
    return client


class Skin:
    """A page's server with stand-ins behind it."""

    def __init__(self, messages: Any) -> None:
        self.gateway, self.recorder, self.access = Gateway(), Recorder(), Access()
        live, recorder = Live(messages.layout, self.gateway.fabric), cast("RecorderProcess", self.recorder)
        self.name = messages.layout.name
        actions = live_actions(live, self.gateway.fabric, recorder)
        self.client = client_of(build_app(only(live, actions), self.access), self.access)

    def post(self, name: str, content: Any, **headers: str) -> tuple[int, Any]:
        answer = self.client.post(f"/api/{name}", json=content, headers={"origin": PAGE, **headers})
        return answer.status_code, answer.json() if answer.headers[
            "content-type"
        ] == "application/json" else answer.text

    def recorder_joins(self) -> Peer:
        peer = new_peer(self.name, "recorder", "")
        self.gateway.changed(peer, True)
        return peer


@pytest.fixture
def skin(messages: Any) -> Iterator[Skin]:
    made = Skin(messages)
    with made.client:
        yield made


def test_the_whole_skin_a_region_and_a_touched_skin_are_tared(skin: Skin) -> None:
    asked: tuple[tuple[Any, Any], ...] = (({}, (None, False)), ({"region": "thumb"}, ("thumb", False)),
        ({"region": None, "force": True}, (None, True)))  # fmt: skip
    for content, expected in asked:
        assert skin.post("tare", content) == (200, {"text": "zero of 64 sums"})
        assert (skin.gateway.asked[-1].region, skin.gateway.asked[-1].force) == expected


def test_a_tare_while_something_touches_says_so_and_offers_force(skin: Skin) -> None:
    text = "something touches the skin or moves on it, around taxel 3: the zero stays as it was"
    skin.gateway.reply = CalibrationReply(is_done=False, text=text)
    assert skin.post("tare", {}) == (409, {"error": f"{text}; by force, what touches it becomes part of the zero"})
    assert skin.post("tare", {"force": True}) == (409, {"error": text})
    status, told = skin.post("tare", {"region": "thumb", "force": True})
    assert (status, told["error"]) == (409, "a tare of a region, and by force: expected one of both")


def test_a_mark_needs_a_recorder(skin: Skin) -> None:
    status, told = skin.post("mark", {"label": "cup"})
    assert (status, "start a recording first" in told["error"], skin.gateway.published) == (409, True, [])
    skin.recorder_joins()
    assert skin.post("mark", {"label": "cup"}) == (200, {"text": "marked: cup"})
    assert skin.post("mark", {"label": ""})[0] == 200
    assert [each.label for each in skin.gateway.published] == ["cup", ""]
    assert skin.post("mark", {"label": " cup"})[0] == 409


def test_a_recording_has_begun_when_another_recorder_is_there(skin: Skin) -> None:
    older = skin.recorder_joins()
    assert skin.post("record", {"on": True}) == (200, {"text": "recording to run.mcap"})
    skin.gateway.changed(msgspec.structs.replace(older, scheduling="realtime"), True)
    assert not skin.recorder.joined()
    skin.gateway.changed(older, False)
    skin.recorder_joins()
    assert skin.recorder.joined()
    assert skin.post("record", {"on": False}) == (409, {"error": "no recording is being made"})


@pytest.mark.parametrize(
    ("name", "content", "status", "says"),
    [
        ("tare", {"force": 1}, 400, "Expected `bool`, got `int`"),
        ("tare", {"regions": "a"}, 400, "unknown field `regions`"),
        ("record", {}, 400, "missing required field `on`"),
        ("mark", {"label": "x" * 5000}, 413, "up to 4096 bytes"),
        ("play", {}, 403, "no play here: this server allows tare, record, mark"),
        ("jump", {}, 404, "expected one of tare, record, mark, play"),
    ],
)
def test_what_cannot_be_done_is_refused_with_a_sentence(
    skin: Skin, name: str, content: Any, status: int, says: str
) -> None:
    code, told = skin.post(name, content)
    assert (code, says in told["error"]) == (status, True)


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"content-type": "text/plain"},
        {"content-type": "application/x-www-form-urlencoded"},
        {"host": "evil.example:8765", "origin": "http://evil.example:8765"},
    ],
)
def test_no_other_page_can_tare_a_skin(skin: Skin, headers: dict[str, str]) -> None:
    assert skin.post("tare", {}, **headers)[0] == 403
    assert skin.client.post("/api/tare", json={}).status_code == 403  # no page at all
    assert skin.gateway.asked == []


def test_a_body_that_is_no_text_is_refused(skin: Skin) -> None:
    headers = {"origin": PAGE, "content-type": "application/json"}
    asked = skin.client.post("/api/tare", content=b'{"region": "\xff"}', headers=headers)
    assert (asked.status_code, "utf-8" in asked.json()["error"]) == (400, True)


def test_no_program_without_the_token_can_tare_a_skin(skin: Skin) -> None:
    skin.client.cookies.clear()
    status, told = skin.post("tare", {})
    assert (status, "open the page by the address that 'skin view' logs" in told) == (403, True)
    assert skin.client.get("/api/state").status_code == 200
    assert skin.client.get(f"/?token={skin.access.token}").status_code == 200  # it sets the cookie
    assert skin.post("tare", {})[0] == 200


def test_a_server_that_only_shows_says_so(messages: Any) -> None:
    access = Access()
    with client_of(build_app(only(Live(messages.layout, FabricStub().fabric)), access), access) as client:
        answer = client.post("/api/tare", json={}, headers={"origin": PAGE})
        assert (answer.status_code, "start 'skin view --control'" in answer.json()["error"]) == (403, True)
        with client.websocket_connect("ws://127.0.0.1:8765/ws") as socket:
            assert msgspec.json.decode(socket.receive_text())["actions"] == []


def test_a_recording_can_be_played_and_not_tared(messages: Any, tmp_path: Path) -> None:
    from tests.views.page.test_playback import recorded

    playback = Playback(recorded(messages, tmp_path / "run.mcap"), messages.layout)
    access = Access()
    with client_of(build_app(only(playback, playback_actions(playback)), access), access) as client:

        def post(name: str, content: Any) -> tuple[int, Any]:
            answer = client.post(f"/api/{name}", json=content, headers={"origin": PAGE})
            return answer.status_code, answer.json()

        assert post("play", {"position_s": 3.0, "is_paused": True}) == (200, {"text": "held at 3.0 s of 10.0 s"})
        assert client.get("/api/state").json()["playback"]["position_s"] == 3.0
        assert post("play", {"speed": 100})[0] == 400
        assert post("tare", {})[0] == 403
        told = client.get("/api/history").json()
        assert (
            client.get(f"/api/frame?time_s={told['time_s'][-1]}").headers["content-type"] == "application/octet-stream"
        )
        assert client.get("/api/frame?time_s=5").json() == {"error": "nothing is kept of that time"}
        assert client.get(f"/api/history?after_s={told['time_s'][-1]}").json()["time_s"] == []
        assert client.get("/api/history?after_s=x").json()["time_s"]


@pytest.mark.heavy
def test_a_recorder_begins_marks_and_ends_as_a_process(messages: Any, endpoint: str, tmp_path: Path) -> None:
    name, hub = messages.layout.name, join(messages.layout, "gateway", endpoint, hub=True)
    fabric = Fabric(name, "viewer", endpoint)
    recorder = RecorderProcess(tmp_path, endpoint, name)
    live = Live(messages.layout, fabric, recorder)
    actions = live_actions(live, fabric, recorder)

    def act(action: str, **content: Any) -> str:
        return actions[action].act(actions[action].asked(**content))

    try:
        assert act("record", on=True).startswith(f"recording to {tmp_path}/{name}-")
        state = live.snapshot()[0].recorder
        assert state is not None
        with pytest.raises(RunError, match="a recording is being made"):
            act("record", on=True)
        assert act("mark", label="cup") == "marked: cup"
        hub.publish(GATEWAY, messages.gateway())
        assert "messages in" in act("record", on=False)
        assert live.snapshot()[0].recorder is None
        assert [each.label for each in messages_of(Path(state.path), MARK)] == ["cup"]
    finally:
        recorder.close()
        fabric.close()
        hub.close()
