"""What several tests of the gateway share: disturbances of a skin, and the boards of a bus as its master sees them."""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings

from dbc.canopen import (
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    NmtState,
)
from dbc.configuration import configuration, expected_signature
from dbc.contract import Contract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO
from dbc.indices import (
    OD_RESTORE,
    OD_SIGNATURE,
    OD_STORE,
    OD_TPDO_COMMUNICATION,
    OD_TPDO_MAPPING,
    SIGNATURE_LOAD,
    SIGNATURE_SAVE,
)
from gateway.nmt_master import LATER_S, PAUSES_S, TICK_S, NmtMaster
from gateway.node_record import NodeRecord
from tests.bus.harness import frame
from tests.gateway.world import STEP_S, EndOfWire, Wire, World
from tests.layouts import small_contract


def little(value: int, size: int = 4) -> bytes:
    return value.to_bytes(size, "little")


def swap_mapping(world: World, bus: int, node_id: int, tpdo: int = 0, *, back: bool = False) -> None:
    """Swap the first two sums of a TPDO, or swap them back, as CiA 301, 7.5.2.38, wants it done."""
    node = next(each for each in world.contract.on_bus(bus) if each.node_id == node_id)
    cob_id = node.tpdos[tpdo].cob_id | 0x4000_0000
    entries = [each.data for each in configuration(world.contract, node) if each.index == OD_TPDO_MAPPING + tpdo]
    count, first, second = entries[0], *(entries[2:0:-1] if back else entries[1:3])
    communication, mapping = OD_TPDO_COMMUNICATION + tpdo, OD_TPDO_MAPPING + tpdo
    for index, subindex, data in (
        (communication, 1, little(cob_id | 0x8000_0000)),
        (mapping, 0, b"\0"),
        (mapping, 1, second),
        (mapping, 2, first),
        (mapping, 0, count),
        (communication, 1, little(cob_id)),
    ):
        world.write(bus, node_id, index, subindex, data)


#: Disturbances in each of the four cases: the same ones in every run, or as many random ones as wanted.
DISTURBANCES = int(os.environ.get("SKIN_DISTURBANCES", "2600"))
RANDOM = settings(
    derandomize="SKIN_DISTURBANCES" not in os.environ,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=(Phase.explicit, Phase.generate),  # to shrink an example takes longer than all tests
)
#: After the last disturbance and the pause of a node that is out: a heartbeat, another pause, a proof that runs out.
BOUND_S = 1.0 + max(PAUSES_S) + 5.0


class Losing:
    """Loses frames at random at one end of a wire; own frames always come back."""

    def __init__(self, end: EndOfWire, ratio: float, seed: int) -> None:
        self._end, self._ratio, self._random = end, ratio, np.random.default_rng(seed)

    def __call__(self, end: EndOfWire, each: np.void) -> bool:
        return end is self._end and not each["flags"] & ECHO and self._random.random() < self._ratio


def disturb(world: World, what: tuple, *, gateway_loses: bool) -> list[int]:
    """Do one thing to the skin; return the blocks it may have changed."""
    match what:
        case ("write" | "write in segments" as how, (bus, node_id), (index, subindex, size), data):
            write = world.write if how == "write" else world.write_in_segments
            write(bus, node_id, index, subindex, data.ljust(size, b"\0")[:size])
        case ("request", (bus, node_id), command, (index, subindex, _), data):
            world.request(bus, node_id, command, index, subindex, data)
        case ("swap", (bus, node_id), tpdo):
            swap_mapping(world, bus, node_id, tpdo % len(world.contract.nodes[0].tpdos))
        case ("pattern", (bus, node_id), pattern):
            world.write(bus, node_id, 0x2021, 0, bytes((pattern,)))
        case ("nmt", bus, command, node_id):
            world.nmt(bus, command, node_id)
            return [bus * 2, bus * 2 + 1]
        case ("store", (bus, node_id)):
            world.write(bus, node_id, OD_STORE, 1, little(SIGNATURE_SAVE))
        case ("restore", (bus, node_id)):
            world.write(bus, node_id, OD_RESTORE, 1, little(SIGNATURE_LOAD))
        case ("sync", bus, counter):
            world.wires[bus].put(0x80, bytes((counter,)))
            return [bus * 2, bus * 2 + 1]
        case ("lose", bus, ratio, seed):
            wire: Wire = world.wires[bus]
            wire.loses = Losing(wire.gateway if gateway_loses else wire.nodes, ratio, seed)
            return []
        case _:
            return []
    return [bus * 2 + node_id - 1]


def drive(world: World, actions: list[tuple], *, gateway_loses: bool, pause_s: float = STEP_S) -> None:
    """Disturb a skin again and again, `pause_s` apart; then let it become whole."""
    world.until_whole(2.0)
    changed_s = np.full(world.contract.phi.blocks, -np.inf)
    limit_s = max(master.proof_limit_s for master in world.gateway.masters.values())
    for what in actions:
        for block in disturb(world, what, gateway_loses=gateway_loses):
            changed_s[block] = world.now_s
        for each in world.run(pause_s):
            for block in world.wrong_blocks(each):
                ago_s = world.now_s - changed_s[block]
                assert gateway_loses, f"block {block} is wrong"
                assert ago_s < limit_s, f"block {block} is wrong, changed {ago_s:.2f} s ago"
    for wire in world.wires:
        wire.loses = None
    world.run(SILENT_AFTER_S)  # the next heartbeat shows a command that the gateway has lost
    skip_pauses(world)
    world.until_whole(BOUND_S)


def skip_pauses(world: World) -> None:
    """Check that no node is left out for longer than the longest pause; go on as if that pause were over."""
    for master in world.gateway.masters.values():
        for each in master.nodes.values():
            if not each.trusted:
                assert each.prove_at_s <= world.now_s + LATER_S
                each.prove_at_s, each.tries = min(each.prove_at_s, world.now_s), 0


def until_sync(world: World) -> None:
    """Go on until a SYNC has been sent; the cycle stays open where a bus is held."""
    sent = world.gateway.sync.sent
    while world.gateway.sync.sent == sent:
        world.step()


def two_states() -> Contract:
    phi = small_contract().phi
    rows = [[block, int(phi.rows_of(block)[block])] for block in range(3)]
    return small_contract(recognition={"rows": rows, "rate_hz": 100.0})


NO_SUBINDEX = 0x0609_0011


class Boards:
    """The boards of bus0, their master and its clock; every answer comes at once."""

    def __init__(self, contract: Contract) -> None:
        self.now_s = 100.0
        self.lines: list[str] = []
        #: Times of requests by node-ID.
        self.asked_s: dict[int, list[float]] = {}
        #: Boards that answer no SDO, and those whose configuration is not right.
        self.mute: set[int] = set()
        self.wrong: set[int] = set()
        self._answers: list[tuple[int, bytes]] = []
        self._signatures = {
            node.node_id: expected_signature(configuration(contract, node)).to_bytes(4, "little")
            for node in contract.on_bus(0)
        }
        self.master = NmtMaster(contract, 0, self._send, lambda *_: None, self.lines.append)
        self._beat_s = self.now_s

    def _send(self, can_id: int, data: bytes) -> None:
        if can_id == NMT_COB_ID:
            self.hear(can_id, data, ECHO)
            return
        node_id = can_id - SDO_REQUEST_BASE
        self.asked_s.setdefault(node_id, []).append(self.now_s)
        if node_id in self.mute or data[0] & 0xE0 == 0x80:
            return
        is_signature = int.from_bytes(data[1:3], "little") == OD_SIGNATURE
        if not is_signature:
            answer = b"\x80" + data[1:4] + NO_SUBINDEX.to_bytes(4, "little")
        else:
            answer = b"\x43" + data[1:4] + (b"\1\2\3\4" if node_id in self.wrong else self._signatures[node_id])
        self._answers.append((SDO_RESPONSE_BASE + node_id, answer))

    def hear(self, can_id: int, data: bytes, flags: int = 0) -> None:
        self.master.take(frame(can_id, data, flags, time_ns=round(self.now_s * 1e9)), self.now_s)

    def run(self, seconds: float, *, beating: bool = True) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            if beating and self.now_s >= self._beat_s:
                self._beat_s = self.now_s + 1.0
                for node_id in self.master.node_ids:
                    self.hear(HEARTBEAT_BASE + node_id, bytes((NmtState.OPERATIONAL,)))
            self.master.tick(self.now_s)
            while self._answers:
                self.hear(*self._answers.pop())

    def trusted(self) -> list[int]:
        return [node_id for node_id, node in self.master.nodes.items() if node.trusted]


def request(command: int, index: int, subindex: int = 0) -> bytes:
    return bytes((command,)) + index.to_bytes(2, "little") + bytes((subindex, 0, 0, 0, 0))


NMT, EMCY, ANSWER, REQUEST, HEARTBEAT = 0x000, 0x080, 0x580, 0x600, 0x700
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
BOOTED, STOPPED, OPERATIONAL, PRE = 0, 4, 5, 127


class Listening(Boards):
    """Boards that keep the NMT commands; those of `plain` compute no signature, and answer what the contract says."""

    def __init__(self, contract: Contract) -> None:
        self.commands: list[tuple[int, int]] = []
        self.plain: set[int] = set()
        self._rest = b""
        super().__init__(contract)

    def _send(self, can_id: int, data: bytes) -> None:
        if can_id == NMT:
            self.commands.append((data[0], data[1]))
        node_id, before = can_id - REQUEST, len(self._answers)
        super()._send(can_id, data)
        if node_id in self.plain and len(self._answers) > before:
            self._answers[-1] = (ANSWER + node_id, self._plain_answer(node_id, data))

    def _plain_answer(self, node_id: int, asked: bytes) -> bytes:
        if asked[0] & 0xE0 == 0x60:
            part, self._rest = self._rest[:7], self._rest[7:]
            return bytes((asked[0] & 0x10 | 7 - len(part) << 1 | (not self._rest),)) + part.ljust(7, b"\0")
        index, subindex = int.from_bytes(asked[1:3], "little"), asked[3]
        if index == OD_SIGNATURE:
            return b"\x43" + asked[1:4] + bytes(4)
        settings = self.master.nodes[node_id].settings
        (value,) = {each.data for each in settings if (each.index, each.subindex) == (index, subindex)}
        if len(value) > 4:
            self._rest = value
            return b"\x41" + asked[1:4] + len(value).to_bytes(4, "little")
        return bytes((0x43 | 4 - len(value) << 2,)) + asked[1:4] + value.ljust(4, b"\0")

    def node(self, node_id: int) -> NodeRecord:
        return self.master.nodes[node_id]

    def beat(self, node_id: int, state: int) -> None:
        self.hear(HEARTBEAT + node_id, bytes((state,)))

    def lines_now(self) -> list[str]:
        """Return the lines since the last call, with those that wait for others."""
        self.master.stop()
        assert self.commands.pop() == (PRE_OPERATIONAL, 0)
        lines = [*self.lines]
        self.lines.clear()
        return lines


@pytest.fixture
def skin(small: Contract) -> Listening:
    """Return nodes 1 and 2 of bus0, proven and running, 0.5 s after their start."""
    built = Listening(small)
    built.run(0.5, beating=False)
    assert built.trusted() == [1, 2]
    return built
