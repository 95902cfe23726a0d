"""The chain of real processes under the losses it promises to survive."""

import json
import os
import signal
import urllib.request
from typing import Any

import pytest

from tests.processes import free_port
from tests.system.conftest import Chain, invalid_blocks

pytestmark = [pytest.mark.slow, pytest.mark.chain]


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


def is_complete(chain: Chain) -> bool:
    return bool(chain.measurements) and not invalid_blocks(chain.measurements[-1])


def notices(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state", timeout=10) as answer:
        state: dict[str, Any] = json.load(answer)
    return json.dumps(state)


def test_killed_reconstructor(chain: Chain) -> None:
    port = free_port()
    chain.start_bus()
    chain.start("nodes", "nodes", "--objects", "granola-box")
    pid = chain.start("reconstructor", "reconstruct")
    chain.start("classifier", "classify")
    chain.start("viewer", "view", "--port", str(port))
    chain.until_alive("nodes", "reconstructor", "classifier", "viewer")
    chain.start("gateway", "gateway")
    chain.until("images", lambda: len(chain.images) > 5)
    assert "images stopped" not in notices(port)

    os.kill(pid, signal.SIGKILL)
    chain.until("the reconstructor gone", lambda: "reconstructor" not in chain.alive)
    images, labels = len(chain.images), len(chain.labels)
    await_steady(chain, [])
    chain.until("labels", lambda: len(chain.labels) >= labels + 20)
    assert len(chain.images) <= images + 2
    assert "images stopped" in notices(port)

    chain.start("reconstructor", "reconstruct")
    images = len(chain.images)
    chain.until("images again", lambda: len(chain.images) > images + 5)
    assert chain.images[-1].valid_sums == 1024


def test_killed_node_process_is_invalid_from_then_on(chain: Chain) -> None:
    chain.start_bus()
    chain.start("nodes", "nodes", "--without", "bus1:6")
    pid = chain.start("node", "nodes", "--only", "bus1:6")
    chain.start("reconstructor", "reconstruct")
    chain.until_alive("nodes", "reconstructor")
    chain.start("gateway", "gateway")
    chain.until("a complete cycle", lambda: is_complete(chain))

    os.kill(pid, signal.SIGKILL)
    chain.until("the block invalid", lambda: 37 in invalid_blocks(chain.measurements[-1]))
    first = len(chain.measurements)
    await_steady(chain, [37])
    assert all(37 in invalid_blocks(one) for one in chain.measurements[first:])
    last = chain.measurements[-1].cycle
    chain.until("its image", lambda: chain.images[-1].cycle >= last)
    assert chain.images[-1].valid_sums == 1016

    chain.start("node", "nodes", "--only", "bus1:6")
    chain.until("the node back", lambda: is_complete(chain))


def test_restarted_gateway(chain: Chain) -> None:
    chain.start_bus()
    chain.start("nodes", "nodes")
    pid = chain.start("gateway", "gateway")
    chain.until("a complete cycle", lambda: is_complete(chain))
    os.kill(pid, signal.SIGKILL)
    chain.until("the gateway gone", lambda: "gateway" not in chain.alive)
    chain.start("gateway", "gateway")
    first = len(chain.measurements)
    chain.until("a complete cycle", lambda: len(chain.measurements) > first and is_complete(chain))
    assert chain.measurements[-1].cycle < chain.measurements[first - 1].cycle + 100
