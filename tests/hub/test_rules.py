"""Every cell of role x topic x action, with real certificates, against a hub with the rules: made from the table."""

import secrets
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from canskin.calibration_messages import CALIBRATION, tare_request
from canskin.errors import BusError, InputError
from canskin.fabric import Fabric
from canskin.keys import Keys
from canskin.messages import MARK, TRUTH, Mark
from canskin.peers import EVERY_KEY
from canskin.roles import ACTIONS, QUESTIONS, ROLES, TOPICS
from canskin.session import open_client, open_hub
from hub.rules import access_control
from tests.hub.keys import make_authority
from tests.processes import PATIENCE_S, free_port

SERVICES = sorted({name for role in ROLES.values() for name in role.appear})
NAMES = {action: [each.name for each in TOPICS] for action in ("put", "subscribe")}
NAMES |= {action: [each.name for each in QUESTIONS] for action in ("ask", "answer")}
Cells = dict[str, set[str]]
NOTHING: Cells = {action: set() for action in ACTIONS}


class Hub:
    """A hub with rules, whose own session is the other side of every action."""

    def __init__(self, folder: Path) -> None:
        authority = make_authority(folder, *ROLES, "client:lost", "operator:anna")
        for role in ROLES:
            authority.issue(f"hand:{role}")
        authority.list.revoked.append("palm:client:lost")
        authority.write_list()
        self.folder, self.endpoint = folder, f"tls/127.0.0.1:{free_port()}"
        self.session = open_hub(self.endpoint, Keys(folder / "hub"), access_control(folder / "hub"))

    def cells(self, keys: str, expected: Cells) -> Cells:
        """Return the names with which each action passes; each is tried until those of `expected` pass."""
        session = open_client(self.endpoint, "test", None, PATIENCE_S, keys=Keys(self.folder / keys))
        try:
            return {
                "put": _heard(session, self.session, session, expected["put"]),
                "subscribe": _heard(self.session, session, session, expected["subscribe"]),
                "answer": _answered(self.session, session, session, expected["answer"]),
                "ask": _answered(session, self.session, session, expected["ask"]),
                "appear": _seen(session, self.session),
            }
        finally:
            session.close()


def _see(session: Any) -> list[str]:
    """Return the tokens that a session sees; when they came, all that it sent before has passed the hub."""
    return [str(each.ok.key_expr) for each in session.liveliness().get(EVERY_KEY, timeout=PATIENCE_S)]


def _heard(sender: Any, hearer: Any, client: Any, expected: set[str]) -> set[str]:
    heard: set[str] = set()
    names = [*NAMES["put"], *NAMES["ask"]]
    kept = [hearer.declare_subscriber(f"canskin/palm/{name}", lambda _, name=name: heard.add(name)) for name in names]
    give_up_s = time.monotonic() + PATIENCE_S
    while True:
        _see(client)
        for name in names:
            sender.put(f"canskin/palm/{name}", b"")
        _see(client)
        if expected <= heard or time.monotonic() > give_up_s:
            break
    for each in kept:
        each.undeclare()
    return heard


def _answered(asker: Any, answerer: Any, client: Any, expected: set[str]) -> set[str]:
    came, answered = set[str](), set[str]()

    def reply(query: Any) -> None:
        came.add(str(query.key_expr).rpartition("/")[2])
        query.reply(query.key_expr, b"")

    names = [*NAMES["ask"], *NAMES["put"]]
    kept = [answerer.declare_queryable(f"canskin/palm/{name}", reply) for name in names]
    give_up_s = time.monotonic() + PATIENCE_S
    while True:
        _see(client)
        for name in names:
            if any(each.ok is not None for each in asker.get(f"canskin/palm/{name}", timeout=PATIENCE_S)):
                answered.add(name)
        if expected <= answered or time.monotonic() > give_up_s:
            break
    for each in kept:
        each.undeclare()
    assert came == answered  # a question that comes, and whose answer does not, may have changed the zero
    return answered


def _seen(session: Any, hub: Any) -> set[str]:
    own = secrets.token_hex(4)  # those of the session before may be there still
    kept = [session.liveliness().declare_token(f"canskin/palm/alive/{name}/{own}") for name in (*SERVICES, "hub")]
    _see(session)
    seen = {key.split("/")[3] for key in _see(hub) if key.endswith(own)}
    for each in kept:
        each.undeclare()
    return seen


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    made = Hub(tmp_path_factory.mktemp("rules") / "keys")
    yield made
    made.session.close()


@pytest.mark.heavy
@pytest.mark.parametrize("role", ROLES)
def test_the_hub_lets_a_role_do_what_the_table_says_and_nothing_else(hub: Hub, role: str) -> None:
    allowed: Cells = {action: set(ROLES[role].names(action)) for action in ACTIONS}
    assert hub.cells(role, allowed) == allowed
    assert hub.cells(f"hand.{role}", NOTHING) == NOTHING


def test_each_holder_has_the_rights_of_its_role_until_it_is_revoked(hub: Hub) -> None:
    marks = set(ROLES["operator"].names("put"))
    assert hub.cells("operator.anna", NOTHING | {"put": marks})["put"] == marks
    with pytest.raises(BusError, match="lets 'palm:client:lost' do nothing: its keys are revoked"):
        hub.cells("client.lost", NOTHING)


def test_a_program_is_told_its_role_what_it_may_not_and_who_may(hub: Hub) -> None:
    keys = Keys(hub.folder / "viewer")
    with closing(Fabric("palm", "show", hub.endpoint, keys=keys)) as fabric:
        for refused in (
            lambda: fabric.publish(MARK, Mark(label="")),
            lambda: fabric.ask(CALIBRATION, tare_request(1, 1), PATIENCE_S),
            lambda: fabric.answer(CALIBRATION, lambda _request, _reply: None),
        ):
            with pytest.raises(BusError, match=r"role 'viewer' may not .*, .*'(operator|run)' may: see 'skin keys"):
                refused()
    with pytest.raises(BusError, match="may not subscribe 'truth', 'viewer', 'recorder', 'operator' may"):
        Fabric(
            "palm",
            "client",
            hub.endpoint,
            keys=Keys(hub.folder / "client"),
            prepare=lambda it: it.subscribe(TRUTH, print),
        )
    with pytest.raises(BusError, match="role 'viewer' may not appear as 'gateway', 'gateway', 'run' may"):
        Fabric("palm", "gateway", hub.endpoint, keys=keys)
    with pytest.raises(BusError, match=r"keys .*viewer: they are of skin 'palm', not of 'hand'"):
        Fabric("hand", "viewer", hub.endpoint, keys=keys)


def test_a_list_without_holders_is_refused(tmp_path: Path) -> None:
    make_authority(tmp_path / "keys")
    with pytest.raises(InputError, match="has no holder of keys: 'skin keys add'"):
        access_control(tmp_path / "keys")
