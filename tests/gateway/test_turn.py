"""A bus that compiled code reads is as a bus that Python reads: the same measurements and counters, to the bit."""

import contextlib
import socket
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.arbitrated import ArbitratedLink
from bus.error_frames import State
from bus.protocol import HEADER, MAGIC, Hello, Kind, Welcome
from canskin.messages import GatewayStatus, Measurement
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from gateway.service import GatewayService
from shell.clock import WallOffset
from tests.bus.harness import frame
from tests.messages import Published


class Wired(ArbitratedLink):
    """A link whose bus is the test."""

    def _connect(self) -> socket.socket:
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        near.setblocking(False)
        self.far.setblocking(False)
        self.welcome = Welcome(bitrate=1_000_000, data_bitrate=None, queue_size=10_000)
        return near


class Hidden:
    """A link that compiled code cannot read."""

    def __init__(self, link: Wired) -> None:
        self.link = link

    def __getattr__(self, name: str) -> Any:
        if name in {"tell", "arrived"}:
            raise AttributeError(name)
        return getattr(self.link, name)


class Served:
    """A service on such links."""

    def __init__(self, contract: Contract, *, compiled: bool) -> None:
        self.fabric, self.wired = Published(), [Wired("test", Hello(name="gateway")) for _ in contract.layout.bus]
        links: dict[int, Any] = dict(enumerate(self.wired if compiled else map(Hidden, self.wired)))
        self.now_s = 50.0
        self.service = GatewayService(contract, links, self.fabric, clock=lambda: self.now_s)
        for node in contract.nodes:
            self.service.loop.gathering.trust(node, proven=True)

    def turn(self, now_s: float, packets: list[bytes]) -> None:
        self.now_s = now_s
        for link, packet in zip(self.wired, packets, strict=True):
            with contextlib.suppress(BlockingIOError):
                while link.far.recv(1 << 16):
                    pass
            if packet:
                link.far.send(packet)
        self.service.turn()

    def close(self) -> None:
        for link in self.wired:
            link.close()
            link.far.close()


def some_frames(contract: Contract, bus: int, counter: int, random: np.random.Generator) -> Frames:
    """Return what may come on a bus: mostly sums of the cycle, and SYNC."""
    nodes = contract.on_bus(bus)
    tpdos = [tpdo for node in nodes for tpdo in node.tpdos]
    came = [frame(SYNC_COB_ID, bytes((counter,)), ECHO)] * (random.random() < 0.3)
    for tpdo in tpdos:
        named = counter if random.random() < 0.8 else int(random.integers(256))
        length = contract.table.length[0] if random.random() < 0.95 else 3
        came += [frame(tpdo.cob_id, bytes((named, *random.integers(0, 256, length - 1).tolist())))]
    if random.random() < 0.2:
        came += [frame(HEARTBEAT_BASE + nodes[0].node_id, bytes((5,)))]
    if random.random() < 0.05:
        came += [frame(SYNC_COB_ID, bytes((counter,)))]
    taken = random.integers(0, len(came), int(random.integers(len(came) + 1)))
    return np.concatenate([np.zeros(0, came[0].dtype), *(came[each] for each in taken)])


def counters(status: GatewayStatus) -> GatewayStatus:
    """Return a status without times of the wall clock."""
    buses = [msgspec.structs.replace(bus, emergencies=[]) for bus in status.buses]
    return msgspec.structs.replace(status, time_ns=0, buses=buses)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_read_compiled_is_what_python_reads(
    small: Contract, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Controllers change their states meanwhile, and drop frames."""
    monkeypatch.setattr(GatewayService, "waits_ns", lambda _service: (0, 0))
    monkeypatch.setattr("gateway.service.wall_offset", lambda: WallOffset(7, 1))
    random, pair = np.random.default_rng(seed), [Served(small, compiled=compiled) for compiled in (True, False)]
    now_s, states, dropped = 50.0, [State.ACTIVE] * 2, [0, 0]
    for step in range(1500):
        now_s += 0.1 if step < 40 else 0.0033
        packets, is_syncless = [], now_s < pair[0].service.loop.sync.due_s
        for bus in range(2):
            if random.random() < 0.02:
                states[bus] = State.ACTIVE if states[bus] else State(int(random.integers(4)))
            dropped[bus] += random.random() < 0.01
            came = some_frames(small, bus, max(1, pair[0].service.loop.sync.counter), random)
            came["time_ns"] = round(now_s * 1e9)
            head = HEADER.pack(MAGIC, Kind.FRAMES, states[bus], len(came), dropped[bus], 0)
            packets.append(head + came.tobytes() if is_syncless and random.random() < 0.6 else b"")
        for served in pair:
            served.turn(now_s, packets)
    ours, theirs = (served.fabric.of(Measurement) for served in pair)
    assert ours == theirs
    assert len(ours) > 50
    of_ours, of_theirs = ([counters(each) for each in served.fabric.of(GatewayStatus)] for served in pair)
    assert of_ours == of_theirs
    assert of_ours[-1].frames.accepted > 100
    for served in pair:
        served.close()


def test_a_controller_that_is_well_again_is_seen_with_the_next_sums(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GatewayService, "waits_ns", lambda _service: (0, 0))
    served = Served(small, compiled=True)
    sums = frame(small.on_bus(0)[0].tpdos[0].cob_id, bytes((1, *bytes(small.table.length[0] - 1))))
    for now_s, state in ((50.0, State.PASSIVE), (50.1, State.ACTIVE)):
        served.turn(now_s, [HEADER.pack(MAGIC, Kind.FRAMES, state, 1, 0, 0) + sums.tobytes(), b""])
        assert served.wired[0].state is state
    served.close()
