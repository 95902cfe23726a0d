"""Every service and verb with keys of its role: the table of roles has all that they do, and the hub denies nothing."""

from pathlib import Path

import pytest

import canskin
from calibration.command import calibration, tare
from canskin.errors import BusError
from canskin.peers import Peer
from canskin.session import peers_at
from health.alive import WORK, trouble
from health.list_command import list_
from shell.skin_options import SkinOptions
from tests.hub.keys import make_authority
from tests.processes import PATIENCE_S, Processes, free_port

ROLES = ("nodes", "gateway", "reconstructor", "classifier", "viewer", "recorder", "client", "operator")
SERVICES = {"reconstructor": ["reconstruct"], "classifier": ["classify"], "viewer": ["view", "--port", "0"]}


@pytest.mark.slow
@pytest.mark.usefixtures("one_look")
def test_every_service_and_verb_works_with_keys_of_its_role(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tmp_path.chmod(0o700)
    keys, endpoint, layout = tmp_path / "keys", f"tls/127.0.0.1:{free_port()}", ("--layout", "pad")
    make_authority(keys, *ROLES, skin="pad")
    of = SkinOptions(connect=endpoint)

    def take_keys(role: str) -> None:
        monkeypatch.setenv("SKIN_KEYS", str(keys / role))

    with Processes(tmp_path) as started:

        def start(name: str, *words: str) -> None:
            started.skin(name, *words, "--connect", endpoint, "--keys", str(keys / name))

        def is_there(peers: list[Peer]) -> bool:
            return {"viewer", "recorder", *WORK} <= {each.service for each in peers}

        started.skin("hub", "hub", "--listen", endpoint, "--keys", str(keys / "hub"))
        started.skin("bus", "bus", *layout)
        started.await_words("bus", "ready")
        started.await_words("hub", "listens")
        start("nodes", "nodes", *layout, "--objects", "golf-ball")
        start("gateway", "gateway", *layout)
        take_keys("viewer")
        started.until(lambda: bool(canskin.skins_at(endpoint, timeout_s=PATIENCE_S)), "the gateway to come")
        for name, words in SERVICES.items():
            start(name, *words)
        start("recorder", "record", str(tmp_path / "run.mcap"), "--no-frames")
        started.until(lambda: is_there(peers_at(endpoint, PATIENCE_S, bool)), "all services to come")
        for name in WORK:
            take_keys(name)
            started.until(lambda name=name: not trouble(name, endpoint), f"{name} to work")  # type: ignore[misc]
        take_keys("viewer")
        list_(connect=endpoint)
        calibration("show", of=of)
        with pytest.raises(BusError, match="role 'viewer' may not ask 'calibration'"):
            tare(of=of)
        take_keys("operator")
        assert tare(of=of, force=True) == 0
        with canskin.connect(endpoint, timeout_s=PATIENCE_S) as skin:
            skin.latest(PATIENCE_S)
            skin.mark("ball")
        with canskin.connect(endpoint, timeout_s=PATIENCE_S, keys=keys / "client") as skin:
            skin.latest(PATIENCE_S)
            with pytest.raises(BusError, match="role 'client' may not put 'marks'"):
                skin.mark("ball")
        assert started.stop("recorder") == 0
    assert " may " not in started.log("hub").read_text()
