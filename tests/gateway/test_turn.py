"""A bus that compiled code reads is as a bus that Python reads: the same measurements and counters, to the bit."""

import contextlib
import os
import socket
import struct
import time
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.arbitrated import ArbitratedLink
from bus.datagrams import SO_TIMESTAMPNS
from bus.error_frames import State
from bus.protocol import HEADER, MAGIC, Hello, Kind, Welcome
from bus.socketcan import SocketCanLink
from bus.told import DESCRIPTOR, DROPPED, OFFSET, STATE
from canskin.messages import GatewayStatus, Measurement
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import CAN_ID_AT, ECHO, Frames, frame_bytes, frames
from dbc.steps import COUNT, WORD_BYTES, form_at, set_word, slot_byte, write_word
from gateway.loop import BOOT_PATIENCE_S, SETTLE_S
from gateway.service import GatewayService
from shell.clock import WallOffset
from tests.bus.harness import frame
from tests.gateway.boards import small_stepped
from tests.layouts import small_contract
from tests.messages import Published

#: After this time SYNC is sent, though no node answers.
BOOT_S = BOOT_PATIENCE_S + SETTLE_S + 0.2
CONTRACTS = {"cycles": small_contract(rate_hz=200.0), "steps": small_stepped()}


class Virtual(ArbitratedLink):
    """A link to a virtual bus that is the test."""

    def __init__(self) -> None:
        super().__init__("test", Hello(name="gateway"))

    def _connect(self) -> socket.socket:
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        near.setblocking(False)
        self.welcome = Welcome(bitrate=1_000_000, data_bitrate=None, queue_size=10_000)
        return near

    def put(self, came: Frames, state: State, dropped: int) -> None:
        self.far.send(HEADER.pack(MAGIC, Kind.FRAMES, state, len(came), dropped, 0) + came.tobytes())


class Kernel(SocketCanLink):
    """A link to a bus of the kernel that is the test: no SYNC comes back there, and nothing is dropped."""

    def __init__(self) -> None:
        super().__init__("test")
        self.reported = State.ACTIVE

    def _open(self) -> socket.socket:
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        near.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        return near

    def put(self, came: Frames, state: State, dropped: int) -> None:
        report = bytes((0, {State.ACTIVE: 0x40, State.WARNING: 0x08, State.PASSIVE: 0x20}.get(state, 0), *bytes(6)))
        if state is not self.reported:
            self.far.send(struct.pack("=IB3x8s", 0x20000040 if state is State.BUS_OFF else 0x20000004, 8, report))
        self.reported = state
        for row in frame_bytes(came[came["flags"] & ECHO == 0])[:100]:
            self.far.send(row[CAN_ID_AT : CAN_ID_AT + 16].tobytes())
        self._told[DROPPED] = dropped


class Follower:
    """A link that compiled code cannot read; on its bus is what has been on that of another service."""

    def __init__(self, link: Virtual | Kernel) -> None:
        self.link, self._fd = link, os.eventfd(1)  # frames wait at every time

    def fileno(self) -> int:
        return self._fd

    def receive(self) -> Frames:
        return self.link.arrived(self.rows)

    def follow(self, told: Any, rows: Any) -> None:
        """Have what another link was told, but for what Python tells."""
        mine, self.rows = self.link._told, rows
        kept = [DESCRIPTOR, OFFSET] + [STATE] * isinstance(self.link, Kernel)
        before = mine[kept]
        mine[:] = told
        mine[kept] = before

    def close(self) -> None:
        os.close(self._fd)

    def __getattr__(self, name: str) -> Any:
        if name in {"tell", "arrived"}:
            raise AttributeError(name)
        return getattr(self.link, name)


class Pair:
    """A service whose buses are read by compiled code, and one that Python reads with the same frames."""

    def __init__(self, contract: Contract, kind: type[Virtual | Kernel]) -> None:
        buses = range(len(contract.layout.bus))
        self.links = [kind() for _ in buses]
        self.all_links, self.followers = list(self.links), [Follower(kind()) for _ in buses]
        self.all_links += [each.link for each in self.followers]
        self.now_s, self.fabrics = time.monotonic() - BOOT_S, (Published(), Published())
        self.services = [
            GatewayService(contract, dict(enumerate(links)), fabric, clock=lambda: self.now_s)
            for links, fabric in zip((self.links, self.followers), self.fabrics, strict=True)
        ]
        compiled = self.services[0]
        turn, intake = compiled.loop.turn, compiled._turn.intake

        def followed(*arguments: Any) -> int:
            restless = turn(*arguments)
            for follower, told, rows in zip(self.followers, intake.told, intake.rows, strict=True):
                follower.follow(told, rows)
            return restless

        compiled.loop.turn = followed
        for service in self.services:
            for node in contract.nodes:
                service.loop.gathering.trust(node, proven=True)
            service.loop.gathering.tick(self.now_s)  # uses what is proven

    def turn(self, now_s: float) -> None:
        self.now_s = now_s
        for link in self.all_links:
            with contextlib.suppress(BlockingIOError):
                while link.far.recv(1 << 16, socket.MSG_DONTWAIT):
                    pass
        for service in self.services:
            service.turn()

    def close(self) -> None:
        for link in self.all_links:
            link.close()
            link.far.close()
        for follower in self.followers:
            follower.close()


def payload(contract: Contract, cob_id: int, bus: int, counter: int, random: np.random.Generator) -> bytes:
    """Return what a node may send, mostly sums of the cycle of `counter`, or words of its slots."""
    named = counter if random.random() < 0.8 else int(random.integers(256))
    if not contract.in_steps:
        return bytes((named, *random.integers(0, 256, contract.table.length[0] - 1).tolist()))
    table, slot = contract.parts, (counter - 1) * contract.slots
    row = table.row_of[bus, cob_id]
    data = np.zeros(table.length[row], np.uint8)
    for place in range(table.parts[row]):
        form = form_at(table.form, table.part[row] + place)
        known = random.integers(0, 4096, form.sums)
        word = set_word(int(random.integers(form.groups)), known, int(random.integers(COUNT)), slot, form)
        write_word(word, data[1 + WORD_BYTES * place :])
    data[0] = slot_byte(slot) if random.random() < 0.9 else named
    return data.tobytes()


def some_frames(contract: Contract, bus: int, counter: int, random: np.random.Generator) -> Frames:
    """Return what may come on a bus."""
    nodes = contract.on_bus(bus)
    came = [frame(SYNC_COB_ID, bytes((counter,)), ECHO)] * (random.random() < 0.3)
    for tpdo in (tpdo for node in nodes for tpdo in node.tpdos):
        data = payload(contract, tpdo.cob_id, bus, counter, random)
        came += [frame(tpdo.cob_id, data if random.random() < 0.95 else data[:3])]
    if random.random() < 0.2:
        came += [frame(HEARTBEAT_BASE + nodes[0].node_id, bytes((5,)))]
    if random.random() < 0.05:
        came += [frame(SYNC_COB_ID, bytes((counter,)))]
    taken = random.integers(0, len(came), int(random.integers(len(came) + 1)))
    return np.concatenate([frames(0), *(came[each] for each in taken)])


def used(pair: Pair) -> int:
    counts = pair.services[0].loop.gathering.counts
    return counts.accepted + counts.after_gap


def counters(status: GatewayStatus) -> GatewayStatus:
    """Return a status without times of the wall clock."""
    buses = [msgspec.structs.replace(bus, emergencies=[]) for bus in status.buses]
    return msgspec.structs.replace(status, time_ns=0, buses=buses)


@pytest.mark.parametrize("kind", [Virtual, Kernel])
@pytest.mark.parametrize("sends", CONTRACTS)
@pytest.mark.parametrize("seed", range(2))
def test_what_is_read_compiled_is_what_python_reads(
    kind: type[Virtual | Kernel], sends: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Controllers change their states meanwhile, and drop frames."""
    monkeypatch.setattr(GatewayService, "waits_ns", lambda _service: (0, 0))
    monkeypatch.setattr("gateway.service.wall_offset", lambda: WallOffset(7, 1))
    contract, random = CONTRACTS[sends], np.random.default_rng(seed)
    pair, states, dropped, step = Pair(contract, kind), [State.ACTIVE] * 2, [0, 0], 0
    with contextlib.closing(pair):
        while used(pair) < 200 or len(pair.fabrics[0].of(Measurement)) < 40:
            now_s = time.monotonic() - max(0.0, BOOT_S - 0.1 * step)  # the kernel's stamps are of this clock
            for bus, link in enumerate(pair.links):
                if random.random() < 0.02:
                    states[bus] = State.ACTIVE if states[bus] else State(int(random.integers(4)))
                dropped[bus] += random.random() < 0.01
                came = some_frames(contract, bus, max(1, pair.services[0].loop.sync.counter), random)
                came["time_ns"] = round(now_s * 1e9) + bus  # of frames that end at once on two buses either may count
                if now_s < pair.services[0].loop.sync.due_s and random.random() < 0.6:
                    link.put(came, states[bus], dropped[bus])
            pair.turn(now_s)
            step += 1
        for service in pair.services:
            service.publish_status()
    ours, theirs = (fabric.of(Measurement) for fabric in pair.fabrics)
    assert ours == theirs
    of_ours, of_theirs = ([counters(each) for each in fabric.of(GatewayStatus)] for fabric in pair.fabrics)
    assert of_ours == of_theirs


def test_a_controller_that_is_well_again_is_seen_with_the_next_sums(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GatewayService, "waits_ns", lambda _service: (0, 0))
    pair = Pair(small, Virtual)
    sums = frame(small.on_bus(0)[0].tpdos[0].cob_id, bytes((1, *bytes(small.table.length[0] - 1))))
    for now_s, state in ((50.0, State.PASSIVE), (50.1, State.ACTIVE)):
        pair.links[0].put(sums, state, 0)
        pair.turn(now_s)
        assert pair.links[0].state is state
    pair.close()
