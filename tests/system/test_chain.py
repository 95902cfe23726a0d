"""The chain of real processes under the losses it promises to survive."""

import json
import os
import signal
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canskin.messages import SERVICES, ServiceStatus
from tests.processes import PATIENCE_S, free_port
from tests.system.conftest import Chain, invalid_blocks

pytestmark = pytest.mark.slow


class Skin(Chain):
    """Every service of a skin; node 6 of bus1 is a process of its own. Each test leaves all of them running."""

    def __init__(self, layout: Path, folder: Path) -> None:
        super().__init__(layout, folder)
        self.port = free_port()
        self.pids: dict[str, int] = {}

    def start_all(self) -> None:
        self.start_bus()
        self.start("nodes", "nodes", "--objects", "granola-box", "--without", "bus1:6")
        self.start_again("node")
        self.start_again("reconstructor")
        self.start("classifier", "classify")
        self.start("viewer", "view", "--port", str(self.port))
        self.until_alive("nodes", "reconstructor", "classifier", "viewer")
        self.start_again("gateway")

    def start_again(self, name: str) -> None:
        verb = {
            "node": ("nodes", "--objects", "granola-box", "--only", "bus1:6"),
            "reconstructor": ("reconstruct",),
            "gateway": ("gateway",),
        }[name]
        self.pids[name] = self.start(name, *verb)

    def kill(self, name: str) -> None:
        os.kill(self.pids[name], signal.SIGKILL)

    def await_whole(self) -> None:
        first = len(self.measurements)
        self.until("a complete cycle", lambda: len(self.measurements) > first and is_complete(self))


@pytest.fixture(scope="module")
def chain(slow_layout: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Skin]:
    made = Skin(slow_layout, tmp_path_factory.mktemp("chain"))
    try:
        made.start_all()
        yield made
    finally:
        made.close()


def await_steady(chain: Chain, blocks: list[int], in_a_row: int = 10) -> None:
    """Wait until exactly `blocks` are not valid in the newest measurements; a stall of the host may cost some."""
    first = len(chain.measurements)
    chain.until(
        f"only blocks {blocks} not valid, {in_a_row} times in a row",
        lambda: (
            len(chain.measurements) >= first + in_a_row
            and all(invalid_blocks(one) == blocks for one in chain.measurements[-in_a_row:])
        ),
    )


def test_every_service_tells_what_it_makes(chain: Skin) -> None:
    made: dict[str, list[int]] = {}

    def take(status: ServiceStatus) -> None:
        made.setdefault(status.service, []).append(status.made)

    chain.fabric.subscribe(SERVICES, take)
    working = {"gateway", "nodes", "reconstructor", "classifier"}
    chain.poll(
        "more made by each",
        lambda: made.keys() >= working | {"viewer"} and all(max(made[name]) > min(made[name]) for name in working),
    )


def is_complete(chain: Chain) -> bool:
    return bool(chain.measurements) and not invalid_blocks(chain.measurements[-1])


def notices(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state", timeout=PATIENCE_S) as answer:
        state: dict[str, Any] = json.load(answer)
    return json.dumps(state)


def test_killed_reconstructor(chain: Skin) -> None:
    chain.until("images", lambda: len(chain.images) > 5)
    chain.await_whole()
    chain.until("the page in time", lambda: "images stopped" not in notices(chain.port))

    chain.kill("reconstructor")
    chain.until("the reconstructor gone", lambda: "reconstructor" not in chain.alive)
    images, labels = len(chain.images), len(chain.labels)
    await_steady(chain, [])
    chain.until("labels", lambda: len(chain.labels) >= labels + 20)
    assert len(chain.images) <= images + 2
    assert "images stopped" in notices(chain.port)

    chain.start_again("reconstructor")
    images = len(chain.images)
    chain.until("images again", lambda: len(chain.images) > images + 5 and chain.images[-1].valid_sums == 1024)


def test_killed_node_process_is_invalid_from_then_on(chain: Skin) -> None:
    chain.await_whole()
    chain.kill("node")
    chain.until("the block invalid", lambda: 37 in invalid_blocks(chain.measurements[-1]))
    first = len(chain.measurements)
    await_steady(chain, [37])
    assert all(37 in invalid_blocks(one) for one in chain.measurements[first:])
    last = chain.measurements[-1].cycle
    chain.until("its image", lambda: chain.images[-1].cycle >= last)
    assert 0 < chain.images[-1].valid_sums <= 1016

    chain.start_again("node")
    chain.until("the node back", lambda: is_complete(chain))


def test_restarted_gateway(chain: Skin) -> None:
    chain.await_whole()
    before = chain.measurements[-1].cycle
    chain.kill("gateway")
    chain.until("the gateway gone", lambda: "gateway" not in chain.alive)
    first = len(chain.measurements)
    chain.start_again("gateway")
    chain.until("a complete cycle", lambda: len(chain.measurements) > first and is_complete(chain))
    assert chain.measurements[-1].cycle < before + 100
