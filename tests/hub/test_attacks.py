"""Attacks of another program: each succeeds on a hub without keys, and fails for a reader's stolen keys."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest
from canskin.errors import BusError
from canskin.messages import IMAGE, Image
from tests import messages as make
from tests.hub.world import World
from tests.processes import PATIENCE_S

#: Whoever sends it wants a robot to let go.
FALSE_N, TRUE_N = 666.0, 0.5


@pytest.fixture(scope="module", params=["open", "keys"])
def world(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    made = World(tmp_path_factory.mktemp("attacks"), has_keys=request.param == "keys")
    yield made
    made.close()


def image(force_n: float) -> Image:
    return make.image(pixels=np.full(64, force_n, "<f4").tobytes())


def test_false_images(world: World) -> None:
    forces_n: list[float] = []
    reader, maker = world.join("client"), world.join("reconstructor")
    reader.subscribe(IMAGE, lambda image: forces_n.append(float(np.frombuffer(image.pixels, "<f4")[0])))
    false = msgspec.msgpack.encode(image(FALSE_N))

    def has_heard() -> bool:
        world.attacker.put("canskin/palm/image", false)
        maker.publish(IMAGE, image(TRUE_N))
        return forces_n.count(TRUE_N) > 50

    world.processes.until(has_heard, "fifty true images")
    reader.close()
    maker.close()
    assert (FALSE_N in forces_n) != world.has_keys


def test_tare_under_a_touch(world: World) -> None:
    tare = msgspec.msgpack.encode(CalibrationRequest(action="tare", force=True))
    replies = list(world.attacker.get("canskin/palm/calibration", payload=tare, timeout=PATIENCE_S))
    assert bool(world.tared) == bool(replies) == (not world.has_keys)
    if world.has_keys:
        client = world.join("client", "client.stolen")
        with pytest.raises(BusError, match="role 'client' may not ask 'calibration', 'ros2', 'operator' may"):
            client.ask(CALIBRATION, CalibrationRequest(action="tare", force=True), PATIENCE_S)
        client.close()


def test_false_answers_to_the_operator(world: World) -> None:
    lie = msgspec.msgpack.encode(CalibrationReply(is_done=True, text="a lie"))
    kept = world.attacker.declare_queryable(
        "canskin/palm/calibration", lambda query: query.reply(query.key_expr, lie), complete=True
    )
    operator = world.join("client", "operator")
    tare = CalibrationRequest(action="tare")
    heard = {operator.ask(CALIBRATION, tare, PATIENCE_S).text for _ in range(100)}
    operator.close()
    kept.undeclare()
    assert ("a lie" in heard) != world.has_keys
    assert not world.has_keys or heard == {"of the gateway"}


def test_false_services(world: World) -> None:
    names = ("gateway", "reconstructor", "recorder")
    kept = [world.attacker.liveliness().declare_token(f"canskin/palm/alive/{each}/false--") for each in names]
    world.attacker.liveliness().get("canskin/*/alive/*/*", timeout=PATIENCE_S)
    reader = world.join("client")
    seen = {each.service for each in reader.peers() if each.instance == "false"}
    reader.close()
    for each in kept:
        each.undeclare()
    assert seen == (set() if world.has_keys else set(names))


def test_denials_are_logged_once_with_who_and_what(world: World) -> None:
    if world.has_keys:
        for name in ("put 'image'", "ask 'calibration'", "answer 'calibration'"):
            world.processes.await_words("hub", f"palm:client:stolen may not {name}")
        assert world.processes.log("hub").read_text().count("may not put 'image'") == 1
