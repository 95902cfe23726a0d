"""Names and texts of other programs: what does not print never reaches a log, a table, a page or ROS."""

from collections.abc import Iterator
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest
from canskin.description import LayoutReply
from canskin.fabric import Fabric, Missed, Origin
from canskin.messages import GATEWAY
from canskin.peers import Peer, peer_of_key
from canskin.roles import QUESTIONS, TOPICS
from canskin.session import open_client, open_hub
from canskin.text import TEXT_MAX, Told, plain
from tests import messages as make
from tests.client.conftest import Log
from tests.processes import PATIENCE_S

#: Colours and clears a terminal, and forges a line of a log.
CODES = "\x1b[2J\ngateway: all is well\r\x9b31m\u202e"


def structs_of(kind: Any) -> Iterator[type[msgspec.Struct]]:
    """Yield a message and all messages in it."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield kind
        for each in msgspec.structs.fields(kind):
            yield from structs_of(each.type)
        for each in kind.__subclasses__():
            yield from structs_of(each)
    for each in get_args(kind):
        yield from structs_of(each)


def test_each_message_with_text_escapes_it() -> None:
    """But for a layout, which is read as a file."""
    told = [each.message for each in TOPICS] + [part for each in QUESTIONS for part in (each.request, each.reply)]
    every = {found for each in told for found in structs_of(each) if found.__module__.startswith("canskin.")}
    for kind in every - {LayoutReply}:
        types = [each.type for each in msgspec.structs.fields(kind)]
        assert issubclass(kind, Told) == any(str in (each, *get_args(each)) for each in types), kind


@given(st.text(st.characters(codec="utf-8")))
def test_a_text_is_one_line_that_prints(text: str) -> None:
    assert plain(text).isprintable()
    assert plain(plain(text)) == plain(text)
    assert plain(text) == text or not text.isprintable()
    assert len(plain("a" + text * TEXT_MAX)) <= 10 * TEXT_MAX


def test_texts_of_a_message_from_any_program_are_escaped() -> None:
    status = msgspec.structs.asdict(make.gateway_status())
    status["buses"] = [msgspec.structs.asdict(make.bus_state()) | {"name": CODES, "trouble": CODES}]
    status["calibration"] = {"state": "following", "defects": [CODES, "block 3"]}
    found = GATEWAY.decoder()(msgspec.msgpack.encode(status))
    assert [found.buses[0].name, found.buses[0].trouble] == [plain(CODES)] * 2
    assert found.calibration.defects == [plain(CODES), "block 3"]
    assert r"\x1b[2J\ngateway" in plain(CODES)


def test_an_answer_of_another_program_is_one_line(endpoint: str) -> None:
    hub, forged = open_hub(endpoint), msgspec.msgpack.encode({"is_done": False, "text": CODES})
    kept = hub.declare_queryable("canskin/palm/calibration", lambda query: query.reply(query.key_expr, forged))
    operator = Fabric("palm", "client", endpoint)
    reply: CalibrationReply = operator.ask(CALIBRATION, CalibrationRequest(action="tare"), PATIENCE_S)
    operator.close()
    kept.undeclare()
    hub.close()
    assert reply.text == plain(CODES)


@pytest.mark.parametrize(
    "key",
    [
        "canskin/**",
        "canskin/*/alive/*/*",
        f"canskin/palm/alive/{CODES}/8f00--",
        f"canskin/{CODES}/alive/gateway/8f00--",
        f"canskin/palm/alive/gateway/8f00-{CODES}-",
        f"canskin/palm/alive/{'a' * 100_000}/8f00--",
        "canskin/palm/alive/<b>/8f00--",
        "canskin/palm/alive/gateway/8f00--\n",
    ],
)
def test_a_wrong_token_is_no_service(key: str) -> None:
    assert peer_of_key(key) is None


@given(st.text(st.characters(codec="utf-8", exclude_characters="/"), min_size=1))
def test_names_of_a_token_have_letters_digits_and_few_signs(name: str) -> None:
    for key in (
        f"canskin/{name}/alive/gateway/8f",
        f"canskin/palm/alive/{name}/8f",
        f"canskin/palm/alive/gateway/{name}",
    ):
        found = peer_of_key(key)
        assert found is None or (key.isascii() and key.isprintable())


def test_wrong_tokens_neither_stop_a_service_nor_reach_its_log(endpoint: str, log: Log) -> None:
    hub = Fabric("palm", "hub", endpoint, hub=True, fingerprint="0" * 16)
    session = open_client(endpoint, "other", None, PATIENCE_S)
    keys = ("canskin/**", "canskin/palm/alive/gate\x1b[31m\nway/8f--1", f"canskin/palm/alive/gateway/8f-{CODES}-1")
    tokens = [session.liveliness().declare_token(key) for key in keys]
    tokens.append(session.liveliness().declare_token(f"canskin/palm/alive/gateway/8f-0.1-{'1' * 16}"))
    log.wait_for("hub: gateway has Φ 1111")
    assert hub.malformed == len(keys)
    assert [each for each in hub.peers() if each.service != "hub"] == [Peer("palm", "gateway", "8f", "0.1", "1" * 16)]
    assert all(line.isprintable() for line in log.lines)
    session.close()
    hub.close()


def test_invented_publishers_take_no_more_memory() -> None:
    missed = Missed()
    for number in range(5000):
        missed.take("image", Origin(f"p{number}", 1))
        missed.take("image", Origin(f"p{number}", 9))
    assert len(missed._expected) <= 1000
    assert missed.counts()["image"] <= 7 * 1000
