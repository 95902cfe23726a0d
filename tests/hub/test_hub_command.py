"""``skin hub``: a process of its own, its log of denials, and skins that do not notice each other's gateways."""

import re
import signal
import sys
import threading
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.keys import Keys
from canskin.messages import GATEWAY, LABEL
from canskin.session import open_client
from canskin.skin_clock import TIME, TimeRequest, machine, time_reply
from hub.denials import MOST_LINES, PERIOD_S, Denials
from hub.hub_command import hub
from tests.hub.keys import make_authority
from tests.messages import gateway_status, label
from tests.processes import PATIENCE_S, Processes, free_port

#: A gateway that sends labels, one each 10 ms.
LABELLER = """
import sys, time
from canskin.fabric import Fabric
from canskin.messages import LABEL
from tests.messages import label
fabric = Fabric("palm", "gateway", sys.argv[1])
while True:
    fabric.publish(LABEL, label(1, "cup"))
    time.sleep(0.01)
"""


@pytest.mark.heavy
def test_a_gateway_that_is_killed_is_a_gap_for_nobody_else(tmp_path: Path, endpoint: str) -> None:
    with Processes(tmp_path) as started, ExitStack() as stack:

        def join(skin: str, service: str = "") -> Fabric:
            return stack.enter_context(closing(Fabric(skin, service, endpoint)))

        def hears(skin: str, gateway: Fabric) -> None:
            def is_heard() -> bool:
                gateway.publish(LABEL, label(1, "cup"))
                return came[skin].is_set()

            came[skin].clear()
            started.until(is_heard, f"a label of {skin}")

        started.skin("hub", "hub", "--listen", endpoint)
        started.start("palm", sys.executable, "-c", LABELLER, endpoint)
        came, left = {skin: threading.Event() for skin in ("palm", "hand")}, threading.Event()
        palm, hand, gateway = join("palm"), join("hand"), join("hand", "gateway")
        palm.subscribe(LABEL, lambda _: came["palm"].set())
        hand.subscribe(LABEL, lambda _: came["hand"].set())
        palm.watch(lambda _, alive: None if alive else left.set())
        assert came["palm"].wait(PATIENCE_S)
        started.stop("palm", signal.SIGKILL)
        assert left.wait(PATIENCE_S)
        came["palm"].clear()
        hears("hand", gateway)
        assert not came["palm"].is_set()
        hears("palm", join("palm", "gateway"))
        assert not hand.missed.counts()
        assert started.stop("hub") == 0


@pytest.mark.heavy
@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_two_hubs_that_are_joined_have_the_skins_of_both(tmp_path: Path, protocol: str) -> None:
    first, second = (f"{protocol}/127.0.0.1:{free_port()}" for _ in range(2))
    options, keys = [], dict[str, Keys]()
    if protocol == "tls":
        roles = ("gateway", "client")
        make_authority(tmp_path / "keys", *roles)
        options = ["--keys", str(tmp_path / "keys" / "hub")]
        keys = {role: Keys(tmp_path / "keys" / role) for role in roles}
    came = threading.Event()
    with Processes(tmp_path) as started, ExitStack() as stack:

        def join(service: str, endpoint: str) -> Fabric:
            return stack.enter_context(
                closing(Fabric("palm", service, endpoint, keys=keys.get(service), patience_s=PATIENCE_S))
            )

        def is_heard() -> bool:
            gateway.publish(GATEWAY, gateway_status())
            return came.is_set()

        started.skin("second", "hub", "--listen", second, "--join", first, *options)  # waits for the first
        started.skin("first", "hub", "--listen", first, *options)
        gateway, client = join("gateway", first), join("client", second)
        client.subscribe(GATEWAY, lambda _: came.set())
        gateway.answer(TIME, lambda _, reply: reply(time_reply()))
        started.until(is_heard, "a message through both hubs")
        assert client.ask(TIME, TimeRequest(), PATIENCE_S).machine == machine()
        started.until(lambda: {"client", "gateway"} <= {each.service for each in client.peers()}, "tokens of both")
        started.stop("first", signal.SIGKILL)
        started.skin("first again", "hub", "--listen", first, *options)
        came.clear()
        started.until(is_heard, "a message after the first hub has started again")


@pytest.mark.heavy
def test_a_denial_is_told_once_with_who_and_what(tmp_path: Path) -> None:
    folder, endpoint = tmp_path / "keys", f"tls/127.0.0.1:{free_port()}"
    authority = make_authority(folder, "client", "client:lost")
    authority.list.revoked.append("palm:client:lost")
    authority.write_list()
    with Processes(tmp_path) as started:
        everywhere = endpoint.replace("127.0.0.1", "0.0.0.0")  # noqa: S104 - with keys
        started.skin("hub", "hub", "--listen", everywhere, "--keys", str(folder / "hub"))
        session = open_client(endpoint, "test", None, PATIENCE_S, keys=Keys(folder / "client"))
        kept = [
            session.declare_subscriber("canskin/**", lambda _: None),
            session.declare_subscriber("canskin/palm/image", lambda _: None),  # which the role may
            session.declare_queryable("canskin/palm/zero", lambda _: None),
            session.liveliness().declare_token("canskin/palm/alive/gateway/test"),
        ]
        for _ in range(3):
            session.put("canskin/palm/label", b"")
            session.put("canskin/palm/\x1b[2m" + "x" * 1000, b"")
            list(session.get("canskin/palm/calibration"))
        for keys in (folder / "client.lost", authority.issue("palm:client:new")):  # after the hub has read the list
            with pytest.raises(Exception, match="do nothing"):
                open_client(endpoint, "test", None, PATIENCE_S, keys=Keys(keys))
        session.put("canskin/hand/image", b"")
        started.await_words("hub", "canskin/hand/image")
        for each in kept:
            each.undeclare()
        session.close()
        assert started.stop("hub") == 0
    said = started.log("hub").read_text()
    assert f"listens on {everywhere}: give {endpoint.replace('127.0.0.1', 'HOST')} to" in said
    lines = [line.removeprefix("hub: ") for line in said.splitlines() if " may " in line]
    assert sorted(lines) == sorted(
        [
            "palm:client may not subscribe 'canskin/**'",
            "palm:client may not answer 'zero': gateway, run may",
            "palm:client may not appear as 'gateway': gateway, run may",
            "palm:client may not put 'label': classifier may",
            rf"palm:client may not put '\x1b[2m{'x' * 93}'",
            "palm:client may not ask 'calibration': ros2, operator may",
            "palm:client:lost may do nothing: these keys are revoked",
            "keys that are not in the list of holders may do nothing: copy the hub's keys here, and start it again",
            "palm:client may not put 'canskin/hand/image'",
        ]
    )


def test_keys_that_a_socket_would_drop_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKIN_KEYS", str(make_authority(tmp_path / "keys", "client").folder / "hub"))
    with pytest.raises(InputError, match="has no keys: give tls/HOST:PORT, or leave --keys out"):
        hub(listen=f"unixsock-stream/{tmp_path}/hub")


def test_a_network_without_keys_is_refused() -> None:
    with pytest.raises(InputError, match="or --insecure"):
        hub(listen="tcp/0.0.0.0:7447")


def denied(key: str, holder: str = "palm:client") -> bytes:
    """Return a line as zenoh prints it."""
    return (
        "\x1b[2m2026-01-01T00:00:00.000000Z\x1b[0m \x1b[35mTRACE\x1b[0m rx-0 ThreadId(09)"
        " \x1b[2mzenoh::net::routing::interceptor::access_control\x1b[0m\x1b[2m:\x1b[0m 7599 on"
        f" Interface(lo)+CertCommonName({holder})+Transport(Tls)+7599 is unauthorized to Put (ingress) on {key}"
    ).encode()


def test_a_program_that_invents_names_fills_no_log_and_imitates_no_other() -> None:
    said: list[str] = []
    clock = iter([*[0.0] * 103, *[PERIOD_S] * 2])
    denials = Denials(said.append, clock=lambda: next(clock))
    forged = re.sub(rb"\x1b", rb"\\x1b", denied("canskin/palm/image", "palm:operator"))  # zenoh escapes this sign
    denials.take(denied("canskin/palm/a\n") + forged)
    for number in range(100):
        denials.take(denied(f"canskin/palm/{number}"))
    denials.take(denied("canskin/palm/image"))
    assert len(said) == MOST_LINES + 2
    assert said[0] == "palm:client may not put 'a'"
    assert said[-2] == "palm:client: no more names that it invents are told"
    assert said[-1] == "palm:client may not put 'image': reconstructor, run may"  # names of the fabric are always told
    denials.take(denied("canskin/palm/image"))
    assert said[MOST_LINES + 2 :] == said[-1:]
    assert said[-1] == said[-2]


@given(st.binary(max_size=200), st.text(max_size=30), st.text(max_size=200))
def test_nothing_that_zenoh_prints_stops_the_log(noise: bytes, holder: str, key: str) -> None:
    said: list[str] = []
    denials = Denials(said.append)
    denials.take(noise + b"\n" + denied(key, holder) + b"\n" + noise)
    assert all(line.isprintable() for line in said)
