"""The health check: a service of whatever skin, and one that is not there."""

import subprocess
import sys
from pathlib import Path

import pytest

from canskin.fabric import Fabric

ALIVE = str(Path(sys.executable).with_name("skin-alive"))


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("asked", "status"), [(["gateway"], 0), (["gateway", "palm"], 0), (["gateway", "hand"], 1), (["viewer"], 1)]
)
def test_service_is_found_whatever_the_name_of_its_skin(asked: list[str], status: int, endpoint: str) -> None:
    gateway = Fabric("palm", "gateway", endpoint, hub=True, fingerprint="0123456789abcdef")
    service, *skin = asked
    done = subprocess.run([ALIVE, service, endpoint, *skin], capture_output=True, check=False)
    gateway.close()
    assert (done.returncode, done.stdout + done.stderr) == (status, b"")


@pytest.mark.heavy
def test_wrong_call_and_hub_that_is_not_there_are_told(endpoint: str) -> None:
    for arguments, status, says in (([], 2, "expected SERVICE ENDPOINT"), (["gateway", endpoint], 1, "no hub at")):
        done = subprocess.run([ALIVE, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == status
        assert says in done.stderr
