"""The hub without keys: a socket that only this user may open, and addresses that other machines reach."""

import os
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from canskin.errors import BusError
from canskin.fabric import Fabric
from canskin.keys import UNIX
from canskin.session import is_open, open_hub, own_folder
from tests.processes import PATIENCE_S, free_port

#: Runs the default hub until its input ends.
HUB = """
import sys
from canskin.fabric import Fabric
hub = Fabric("palm", "gateway", hub=True)
print("up", flush=True)
sys.stdin.read()
"""
#: Prints the skins on the default hub.
LOOK = "import canskin; print(canskin.skins_at())"


def environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "XDG_RUNTIME_DIR": str(folder)}


@contextmanager
def hub(folder: Path) -> Iterator[subprocess.Popen[str]]:
    command, pipe = [sys.executable, "-c", HUB], subprocess.PIPE
    process = subprocess.Popen(command, env=environment(folder), stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def look(folder: Path) -> str:
    """Return the last line of a program that looks for skins on the default hub."""
    done = subprocess.run(
        [sys.executable, "-c", LOOK], env=environment(folder), capture_output=True, text=True, check=False
    )
    return (done.stdout + done.stderr).strip().splitlines()[-1]


@pytest.mark.heavy
def test_programs_without_an_address_meet_on_a_socket_that_outlives_its_hub(tmp_path: Path) -> None:
    endpoint = f"{UNIX}/{tmp_path}/canskin/hub"
    with hub(tmp_path) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "up\n"
        assert stat.S_IMODE((tmp_path / "canskin").stat().st_mode) == 0o700
        assert look(tmp_path) == "['palm']"
        with pytest.raises(BusError, match=f"^cannot listen on {endpoint}: another hub listens there$"):
            Fabric("palm", "gateway", endpoint, hub=True)
        with closing(Fabric("palm", "viewer", endpoint, patience_s=PATIENCE_S)) as reader:
            first.kill()
            first.wait()
            with hub(tmp_path) as second:
                assert second.stdout is not None
                assert second.stdout.readline() == "up\n"
                while len(reader.peers()) < 2:  # until the gateway is there again, and the reader has reconnected
                    pass


@pytest.mark.heavy
@pytest.mark.skipif(os.geteuid() != 0, reason="NOT TESTED: needs root to be another user")
def test_another_user_cannot_open_the_socket() -> None:
    with tempfile.TemporaryDirectory() as name, hub(Path(name)) as running:
        Path(name).chmod(0o755)
        assert running.stdout is not None
        assert running.stdout.readline() == "up\n"
        attack = f"import socket; socket.socket(socket.AF_UNIX).connect('{name}/canskin/hub')"
        done = subprocess.run(["python3", "-c", attack], user=65534, capture_output=True, text=True, check=False)
        assert "PermissionError" in done.stderr


@pytest.mark.heavy
def test_a_folder_that_others_may_open_is_refused_by_programs_too(tmp_path: Path) -> None:
    (tmp_path / "canskin").mkdir()
    (tmp_path / "canskin").chmod(0o755)
    assert look(tmp_path).endswith(
        "canskin can be opened by other users: expected a folder of your own, with mode 0700"
    )


def test_a_folder_of_another_user_or_none_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "own"
    own_folder(own)
    (tmp_path / "link").symlink_to(own)
    for other in ("link", "file"):
        (tmp_path / "file").touch()
        with pytest.raises(BusError, match=str(tmp_path / other)):
            own_folder(tmp_path / other)
    own_folder(own)
    monkeypatch.setattr(os, "getuid", lambda: own.stat().st_uid + 1)
    with pytest.raises(BusError, match="can be opened by other users"):
        own_folder(own)


def test_every_socket_of_a_hub_is_its_users_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    before = os.umask(0)
    try:
        with closing(open_hub(f"{UNIX}/{tmp_path}/hub")):
            assert not stat.S_IMODE((tmp_path / "hub").stat().st_mode) & 0o077
    finally:
        assert os.umask(before) == 0
    assert not caplog.messages


@pytest.mark.parametrize(("host", "who"), [("127.0.0.1", "every user of this machine"), ("0.0.0.0", "everybody")])  # noqa: S104
def test_a_hub_without_keys_says_who_may_connect(host: str, who: str, caplog: pytest.LogCaptureFixture) -> None:
    endpoint = f"tcp/{host}:{free_port()}"
    Fabric("palm", "gateway", endpoint, hub=True).close()
    assert [line for line in caplog.messages if line.startswith(f"{endpoint} has no keys: {who} ")]


def test_a_path_that_no_socket_can_have_is_one_clear_line(tmp_path: Path) -> None:
    longest = tmp_path / "h"
    longest = longest.with_name("h" * (107 - len(str(tmp_path)) - 1))
    with closing(socket.socket(socket.AF_UNIX)) as probe:
        probe.bind(str(longest))
    with pytest.raises(BusError, match="is too long for a socket: expected up to 107 bytes"):
        Fabric("palm", "viewer", f"{UNIX}/{longest}h")


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        (f"{UNIX}//tmp/hub", False),
        ("tcp/127.0.0.1:7447", False),
        ("tcp/localhost:7447", False),
        ("tcp/[::1]:7447", False),
        ("tls/0.0.0.0:7447", False),
        ("quic/10.0.0.5:7447", False),
        ("tcp/0.0.0.0:7447", True),
        ("tcp/[::]:7447", True),
        ("udp/10.0.0.5:7447", True),
        ("ws/robot:7447", True),
    ],
)
def test_an_address_that_other_machines_reach_without_keys_is_known(endpoint: str, expected: bool) -> None:
    assert is_open(endpoint) is expected
