"""Keys: what is wrong with a folder of them, and why a hub refuses a program, is told at once."""

import math
import os
import queue
import shutil
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from unittest import mock

import pytest

import canskin
from calibration.command import tare
from canskin.errors import BusError, DeniedError, InputError
from canskin.fabric import Fabric
from canskin.keys import ANSWER_S, UNIX, Keys, reason
from canskin.peers import Peer
from canskin.session import DEFAULT_ENDPOINT, open_client, open_hub, peers_at
from hub.authority import Authority
from shell.command import build_app
from shell.skin_options import SkinOptions
from tests.hub.keys import issue_for, make_authority
from tests.processes import PATIENCE_S, free_port


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return make_authority(tmp_path / "keys", "client")


@pytest.fixture
def hub(authority: Authority) -> Iterator[str]:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    session = open_hub(endpoint, Keys(authority.folder / "hub"))
    yield endpoint
    session.close()


def refusal(endpoint: str, keys: Keys | None) -> str:
    with pytest.raises(BusError) as raised:  # however long the program would wait for its hub
        open_client(endpoint, "client", None, math.inf, keys=keys)
    return str(raised.value)


def test_a_refusal_is_told_within_a_second() -> None:
    assert 3 * ANSWER_S < 1.0  # to connect, of TLS, of the certificate; there is no other wait


def test_keys_of_one_authority_meet(authority: Authority, hub: str) -> None:
    keys = Keys(authority.folder / "client")
    assert (keys.common_name, keys.skin, keys.role, keys.holder) == ("palm:client", "palm", "client", "")
    open_client(hub, "client", None, 5.0, keys=keys).close()


def test_a_hub_refuses_a_program_without_keys(hub: str) -> None:
    assert refusal(hub, None) == f"{hub} needs keys: give --keys FOLDER, or SKIN_KEYS in the environment"
    plain = hub.replace("tls", "tcp")
    assert f"refuses a program without keys: it asks for keys: give --keys FOLDER and {hub}" in refusal(plain, None)


def test_a_hub_refuses_keys_of_another_authority(authority: Authority, hub: str, tmp_path: Path) -> None:
    foreign = make_authority(tmp_path / "foreign", "client").folder / "client"
    assert refusal(hub, Keys(foreign)) == (
        f"the hub at {hub} refuses 'palm:client': its certificate is of another authority"
    )


def ended_keys(authority: Authority) -> Keys:
    folder = issue_for(authority, "client:ended", -10.0)
    with mock.patch("canskin.keys.time.time", return_value=time.time() - 20.0):
        return Keys(folder)


def test_a_hub_refuses_keys_that_have_ended(authority: Authority, hub: str) -> None:
    assert "the certificate has ended" in refusal(hub, ended_keys(authority))


def test_zenoh_refuses_what_the_program_does_not_find_out(
    authority: Authority, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canskin.session.reason", lambda *_: "")
    good = Keys(authority.folder / "client")
    foreign = Keys(make_authority(tmp_path / "foreign", "client").folder / "client")
    no_certificate, of_foreign = Keys(good.folder), Keys(foreign.folder)
    knows_hub = {"transport/link/tls/root_ca_certificate": str(good.folder / "ca.pem")}
    monkeypatch.setattr(no_certificate, "settings", lambda **_: knows_hub)
    monkeypatch.setattr(of_foreign, "settings", lambda **_: foreign.settings(is_hub=False) | knows_hub)
    port = free_port()
    refused = (
        ("127.0.0.2", good),
        ("127.0.0.1", foreign),
        ("127.0.0.1", of_foreign),
        ("127.0.0.1", no_certificate),
        ("127.0.0.1", ended_keys(authority)),
    )
    with closing(open_hub(f"tls/0.0.0.0:{port}", Keys(authority.folder / "hub"))):
        for host, keys in refused:
            with pytest.raises(BusError, match="does not answer: it hangs, is busy"):
                open_client(f"tls/{host}:{port}", "client", None, 0.3, keys=keys)
        open_client(f"tls/127.0.0.1:{port}", "client", None, 5.0, keys=good).close()


def test_a_hub_lets_revoked_keys_do_nothing_and_they_are_told(authority: Authority) -> None:
    endpoint, flows = f"tls/127.0.0.1:{free_port()}", ["ingress", "egress"]
    messages = ["liveliness_query", "liveliness_token"]
    allowed = {"id": "see", "permission": "allow", "flows": flows, "messages": messages, "key_exprs": ["canskin/**"]}
    rules = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [allowed],
        "subjects": [{"id": "client", "cert_common_names": ["palm:client"]}],
        "policies": [{"rules": ["see"], "subjects": ["client"]}],
    }
    session = open_hub(endpoint, Keys(authority.folder / "hub"), rules)
    open_client(endpoint, "client", None, 5.0, keys=Keys(authority.folder / "client")).close()
    revoked = Keys(authority.issue("palm:client:laptop7"))
    assert f"the hub at {endpoint} lets 'palm:client:laptop7' do nothing: its keys are revoked" in refusal(
        endpoint, revoked
    )
    session.close()


@pytest.mark.heavy
def test_renewed_keys_are_read_when_those_before_end(authority: Authority, hub: str) -> None:
    came, left, back = (threading.Event() for _ in range(3))

    def note(peer: Peer, is_there: bool) -> None:
        (back if left.is_set() else came).set() if is_there else left.set()

    with closing(Fabric("palm", "", hub, keys=Keys(issue_for(authority, "client", 3.0)))) as fabric:
        fabric.watch_peers(note)
        assert came.wait(PATIENCE_S)
        issue_for(authority, "client", 3600.0)
        assert left.wait(PATIENCE_S)  # the link closes with the end of the certificate
        assert back.wait(PATIENCE_S)


def test_a_service_says_that_its_keys_end_soon(
    authority: Authority, hub: str, caplog: pytest.LogCaptureFixture
) -> None:
    Fabric("palm", "client", hub, keys=Keys(authority.folder / "client")).close()
    assert not caplog.messages
    Fabric("palm", "client", hub, keys=Keys(issue_for(authority, "client", 2.2 * 86400))).close()
    assert caplog.messages == [f"the keys {authority.folder / 'client'} end in 2 days: 'skin keys renew'"]


@pytest.mark.heavy
def test_a_service_that_runs_says_that_its_keys_have_ended(
    authority: Authority, hub: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: queue.Queue[tuple[str, str]] = queue.Queue()
    monkeypatch.setattr("canskin.keys.tell", lambda *words: said.put(words))
    with closing(Fabric("palm", "client", hub, keys=Keys(issue_for(authority, "client", 2.0)))):
        for when in ("end in 0 days", "have ended"):
            told = ("client", f"the keys {authority.folder / 'client'} {when}: 'skin keys renew'")
            assert said.get(timeout=PATIENCE_S) == told


def test_every_connection_of_a_process_has_the_keys_of_its_environment(
    authority: Authority, hub: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(BusError, match="needs keys: give --keys FOLDER, or SKIN_KEYS"):
        peers_at(hub, 5.0, bool)
    monkeypatch.setenv("SKIN_KEYS", str(authority.folder / "client"))
    assert [peer.service for peer in peers_at(hub, 5.0, bool)] == ["hub"]
    with pytest.raises(BusError, match="no skin at"):  # let in, but only the hub is there
        canskin.connect(hub, timeout_s=0.1)


def test_the_option_is_that_of_every_verb_and_of_the_processes_it_starts(
    authority: Authority, hub: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SKIN_KEYS", "another")
    folder = authority.issue("palm:viewer")
    build_app().meta(["list", "--connect", hub, "--seconds", "0.01", "--keys", str(folder)])
    assert "palm  hub " in capsys.readouterr().out
    assert os.environ["SKIN_KEYS"] == str(folder)


def test_with_keys_the_default_is_tls(authority: Authority, hub: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canskin.session.TLS_ENDPOINT", hub)
    open_client(DEFAULT_ENDPOINT, "client", None, 5.0, keys=Keys(authority.folder / "client")).close()


def test_a_socket_of_the_user_needs_no_keys(authority: Authority, tmp_path: Path) -> None:
    endpoint, keys = f"{UNIX}/{tmp_path / 'hub'}", Keys(authority.folder / "client")
    with closing(open_hub(endpoint, keys)):
        open_client(endpoint, "client", None, 5.0, keys=keys).close()


def test_a_hub_has_the_names_of_its_certificate_alone(authority: Authority) -> None:
    port = free_port()
    session = open_hub(f"tls/0.0.0.0:{port}", Keys(authority.folder / "hub"))
    assert "its certificate has other names" in refusal(f"tls/127.0.0.2:{port}", Keys(authority.folder / "client"))
    session.close()


def test_a_hub_without_keys_gets_none(authority: Authority) -> None:
    keys, port = Keys(authority.folder / "client"), free_port()
    session = open_hub(f"tcp/127.0.0.1:{port}")
    assert "it does not speak TLS: give the hub its keys" in refusal(f"tls/127.0.0.1:{port}", keys)
    assert "does not use the keys" in refusal(f"tcp/127.0.0.1:{port}", keys)
    session.close()


def test_a_hub_that_is_busy_refuses_nobody(authority: Authority, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canskin.keys.ANSWER_S", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as busy:  # its system takes connections, and nobody answers
        assert not reason(f"tls/127.0.0.1:{busy.getsockname()[1]}", Keys(authority.folder / "client"))


def test_a_hub_has_keys_of_its_role(authority: Authority) -> None:
    with pytest.raises(BusError, match="with keys of 'palm:client': expected those of role 'hub'"):
        open_hub(f"tls/127.0.0.1:{free_port()}", Keys(authority.folder / "client"))
    assert "they are the hub's own: expected those of a role" in refusal(
        "tls/127.0.0.1:1", Keys(authority.folder / "hub")
    )


def test_only_skin_hub_listens_with_keys(authority: Authority) -> None:
    """A gateway has no rules of the roles."""
    with pytest.raises(BusError, match="only 'skin hub' has the rules of the roles: start it"):
        Fabric("palm", "gateway", f"tls/127.0.0.1:{free_port()}", hub=True, keys=Keys(authority.folder / "hub"))


def test_a_tare_without_the_right_is_refused_before_a_skin_is_looked_for(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKIN_KEYS", str(authority.folder / "client"))
    with pytest.raises(DeniedError, match="role 'client' may not ask 'calibration', 'ros2', 'operator' may"):
        tare(of=SkinOptions(connect="tls/127.0.0.1:1"))


def test_quic_uses_keys(authority: Authority) -> None:
    endpoint = f"quic/127.0.0.1:{free_port()}"
    session = open_hub(endpoint, Keys(authority.folder / "hub"))
    open_client(endpoint, "client", None, 5.0, keys=Keys(authority.folder / "client")).close()
    session.close()


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem"])
def test_a_missing_or_damaged_file_is_named(authority: Authority, name: str) -> None:
    path = authority.folder / "client" / name
    path.write_text("no PEM")
    with pytest.raises(InputError, match="do not belong together"):
        Keys(path.parent)
    path.unlink()
    with pytest.raises(InputError, match=f"expected the folder of one role: {name} cannot be read"):
        Keys(path.parent)


def test_keys_that_cannot_be_used(authority: Authority) -> None:
    folder = authority.folder / "client"
    (folder / "key.pem").chmod(0o640)
    with pytest.raises(InputError, match=r"can be read by other users: .*'skin keys revoke', and add another"):
        Keys(folder)
    shutil.copy(authority.folder / "hub" / "key.pem", folder / "key.pem")
    (folder / "key.pem").chmod(0o600)
    with pytest.raises(InputError, match="do not belong together"):
        Keys(folder)
    with pytest.raises(InputError, match=r"the certificate ended .* 'skin keys renew'"):
        Keys(issue_for(authority, "client", -10.0))
    with pytest.raises(InputError, match=r"the certificate begins .*: is this clock right"):
        Keys(issue_for(authority, "client", 7200.0, 3600.0))
