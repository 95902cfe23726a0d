"""The chain of real processes under the losses it promises to survive."""

import json
import os
import signal
import urllib.request
from pathlib import Path
from typing import Any

import can
import msgspec
import pytest

from bus.protocol import socket_path
from tests.processes import free_port
from tests.system.conftest import Chain, invalid_blocks

pytestmark = pytest.mark.slow

START, STOP, RESET_NODE = 1, 2, 129


def nmt(chain: Chain, monkeypatch: pytest.MonkeyPatch, channel: str, command: int, node_id: int) -> None:
    """Send an NMT command as any other tool on the bus could."""
    monkeypatch.setenv("SKIN_BUS_DIR", str(chain.supervisor.folder))
    assert socket_path(channel).exists()
    with can.Bus(interface="canskin", channel=channel, receive_own_messages=True) as bus:
        bus.send(can.Message(arbitration_id=0, data=[command, node_id], is_extended_id=False), timeout=1)
        until_seen(bus, 0x000, bytes((command, node_id)))
        if command == RESET_NODE:  # it boots, and the gateway starts it when it has shown its Φ
            until_seen(bus, 0x700 + node_id, b"\0")
            until_seen(bus, 0x000, bytes((START, node_id)))


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


def until_seen(bus: can.BusABC, can_id: int, data: bytes) -> None:
    while (seen := bus.recv(30)) is not None:
        if (seen.arbitration_id, bytes(seen.data)) == (can_id, data):
            return
    pytest.fail(f"{can_id:03X}#{data.hex()} was not on the bus")


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


def test_muted_and_reset_node(chain: Chain, monkeypatch: pytest.MonkeyPatch) -> None:
    chain.start_bus()
    chain.start("nodes", "nodes")
    chain.start("gateway", "gateway")
    chain.until("a complete cycle", lambda: is_complete(chain))
    nmt(chain, monkeypatch, "bus0", STOP, 5)
    chain.until("the block invalid", lambda: not is_complete(chain))
    chain.until("the node back by itself", lambda: is_complete(chain))
    log = chain.supervisor.children["gateway"].log
    chain.until("its line in the log", lambda: "node 5 on bus0 back after" in log.read_text())
    assert "node 5 on bus0 left OPERATIONAL: stopped, by another master's NMT command" in log.read_text()
    nmt(chain, monkeypatch, "bus0", RESET_NODE, 5)
    first = len(chain.measurements)
    chain.until("the node back", lambda: len(chain.measurements) > first and is_complete(chain))


def test_node_with_another_phi_is_refused(chain: Chain, tmp_path: Path) -> None:
    chain.start_bus()
    chain.start("nodes", "nodes", "--without", "bus2:1")
    other = tmp_path / "other.toml"
    other.write_text(chain.layout_path.read_text().replace("seed = 1", "seed = 2"))
    assert msgspec.toml.decode(other.read_bytes())["measurement"]["seed"] == 2
    chain.supervisor.start("stranger", "nodes", "--layout", str(other), "--no-fabric", "--only", "bus2:1")
    chain.start("gateway", "gateway")
    chain.until("measurements", lambda: len(chain.measurements) > 0)
    chain.until("all others valid", lambda: invalid_blocks(chain.measurements[-1]) == [64])
    await_steady(chain, [64])
    assert all(64 in invalid_blocks(one) for one in chain.measurements)
    assert "node 1 on bus2 refused" in chain.supervisor.children["gateway"].log.read_text()


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
