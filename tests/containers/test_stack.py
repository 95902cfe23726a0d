"""The skin in containers of a real engine: built without a network, brought up, disturbed, taken down.

`make test-containers` runs these tests (`tests/containers/run`).
"""

import json
import os
import shlex
import signal
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from tests.layouts import slow_layout

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),  # the first test builds the image, on machines that differ by a factor of eight
    pytest.mark.skipif("SKIN_CONTAINERS" not in os.environ, reason="NOT TESTED: make test-containers runs this"),
]

ROOT: Final = Path(__file__).parents[2]
IMAGE: Final = "canskin-test"
SERVICES: Final = ("nodes", "gateway", "reconstructor", "classifier", "viewer")
PATIENCE_S: Final = 300.0
TOKEN: Final = "of-the-test-alone"  # noqa: S105 - of no other stack
#: Of the words of a check that fails.
LINES: Final = 40


class Stack:
    """The compose project of the test."""

    def __init__(self, files: Path) -> None:
        can_give = run("docker", "run", "--rm", "--ulimit", "rtprio=1", "--entrypoint", "true", IMAGE, check=False)
        self._environment = {
            "COMPOSE_PROJECT_NAME": IMAGE,
            "COMPOSE_PROFILES": "virtual",
            "SKIN_IMAGE": IMAGE,
            "SKIN_FILES": str(files),
            "SKIN_LAYOUT": "slow.toml",
            "SKIN_PAGE_TOKEN": TOKEN,
            # A block that misses over half of a window while the zero is measured (0.2 s at 20 Hz) has none
            # until nothing touches for 3.2 s, which the touches here do not leave. A busy machine may stall so long.
            "SKIN_GATEWAY_OPTIONS": "--tare never",
            "SKIN_RTPRIO": "1" if can_give.returncode == 0 else "0",
        }

    def compose(self, *words: str) -> str:
        """Run a command of compose and return its output."""
        command = shlex.split(os.environ["SKIN_COMPOSE"])
        return run(*command, *words, environment=self._environment).stdout

    def container(self, service: str) -> str:
        """Return the ID of a service's container."""
        return self.compose("ps", "--quiet", service).strip()

    def state(self, service: str) -> Any:
        """Return the engine's state of a service's container."""
        return json.loads(run("docker", "inspect", "--format", "{{json .State}}", self.container(service)).stdout)

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        """Wait for something; tell the logs of the services where it does not come."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not is_so():
            if time.monotonic() > give_up_s:
                pytest.fail(f"waited {PATIENCE_S:g} s in vain for {what}\n{self.compose('logs', '--tail', str(LINES))}")
            time.sleep(0.5)

    def is_whole(self) -> bool:
        """Tell whether the engine calls every service healthy."""
        return all(self.state(service).get("Health", {}).get("Status") == "healthy" for service in SERVICES)


def run(
    *command: str, check: bool = True, environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, **(environment or {})}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=env)
    if check and done.returncode != 0:
        pytest.fail(f"{shlex.join(command)} ended with {done.returncode}: {done.stdout[-4000:]}{done.stderr[-4000:]}")
    return done


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Build the image without a network, bring the stack up, and take it down."""
    base = ["--build-arg", f"BASE={os.environ['SKIN_BASE']}"] if "SKIN_BASE" in os.environ else []
    run("docker", "build", "--network", "none", *base, "--build-arg", "WHEELS=wheels", "--tag", IMAGE, ".")
    files = tmp_path_factory.mktemp("files")
    slow_layout(files, 20).rename(files / "slow.toml")
    files.chmod(0o755)
    stack = Stack(files)
    stack.compose("up", "--detach")
    try:
        yield stack
    finally:
        stack.compose("down", "--volumes", "--remove-orphans")
    left = [run("docker", kind, "ls", "--quiet", "--filter", f"name={IMAGE}_").stdout for kind in ("volume", "network")]
    assert [*left, run("docker", "ps", "--all", "--quiet", "--filter", f"name={IMAGE}").stdout] == ["", "", ""]
    run("docker", "image", "rm", IMAGE)


def shows_images_and_labels() -> bool:
    """Tell whether a frame of the page's WebSocket has a whole fresh image and a fresh label of measured sums."""
    try:
        with connect(f"ws://127.0.0.1:8765/ws?token={TOKEN}") as page:
            assert "rows" in json.loads(page.recv(timeout=10))
            frame = page.recv(timeout=10)
    except (OSError, WebSocketException):  # not there yet
        return False
    assert isinstance(frame, bytes)
    (length,) = struct.unpack_from("<I", frame)
    header = json.loads(frame[4 : 4 + length])
    image, label = header["snapshot"]["image"], header["snapshot"]["label"]
    if image is None or label is None or image["stale"] or label["stale"]:
        return False
    return "image" in header["pictures"] and image["invalid_blocks"] == [] and bool(label["measured"])


def test_the_page_shows_images_and_labels_and_every_service_is_healthy(stack: Stack) -> None:
    stack.until(shows_images_and_labels, "a whole image and a label on the page")
    stack.until(stack.is_whole, "six healthy services")
    assert not [service for service in SERVICES if stack.state(service)["Pid"] == 0]


@pytest.mark.parametrize("service", ["gateway", "nodes"])
def test_a_service_that_is_killed_comes_back_and_the_stack_is_whole_again(stack: Stack, service: str) -> None:
    killed = stack.state(service)["Pid"]
    try:
        os.kill(killed, signal.SIGKILL)  # `docker kill` would count as the user's wish
    except PermissionError:
        pytest.skip("NOT TESTED: needs root, or an engine of this user, to kill a container's process")
    stack.until(lambda: stack.state(service)["Pid"] not in {0, killed}, f"the {service} to start again")
    stack.until(shows_images_and_labels, "a whole image and a label on the page")
    stack.until(stack.is_whole, "six healthy services")


def test_nothing_is_healthy_that_lives_on_blocks_while_none_is_measured(stack: Stack) -> None:
    stack.compose("stop", "nodes")
    for service in ("gateway", "reconstructor", "classifier"):
        check = ("docker", "exec", stack.container(service), "skin-alive", service)
        stack.until(
            lambda command=check: "nothing tells of measured blocks" in run(*command, check=False).stderr,
            f"the check of the {service} to fail",
        )
