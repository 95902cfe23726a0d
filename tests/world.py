"""A whole skin in one thread: real nodes and the real gateway on wires of arrays, with a clock that the test moves.

What may go wrong on a wire is data: who loses which frames (`Wire.loses`), and where frames wait (`Line`).
"""

import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol

import numpy as np
import numpy.typing as npt
from hypothesis import HealthCheck, Phase, settings

from bus.link import State
from canskin.messages import GatewayStatus, Measurement
from dbc import indices as od
from dbc.canopen import HIGHEST_NODE_ID, NMT_COB_ID, SDO_REQUEST_BASE
from dbc.configuration import configuration
from dbc.contract import Contract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO, Frames, frames
from gateway.loop import GatewayLoop
from gateway.node_machine import LATER_S, PAUSES_S
from gateway.stepped_gathering import RATES_HZ
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.segment import Boards, Segment
from nodes.virtual_boards import VirtualBoards
from skin.phi import Sbhe
from skin.sources import Frame
from skin.sync_counter import SYNC_OVERFLOW
from skin.taxel import to_counts
from tests.bus.harness import frame

PERIOD_S: Final = 0.05
#: Nodes look at time between two SYNCs only.
STEP_S: Final = PERIOD_S / 2
FOREVER_NS: Final = 1 << 62


class Shaking:
    """A source in which no two frames have a taxel in common."""

    has_noise = True

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape

    def frame(self, step: int) -> Frame:
        force_n = np.random.default_rng(step).uniform(0.004, 0.016, self._shape).astype(np.float32)
        return Frame(force_n, "")


class Witness(Electronics):
    """Electronics that remember the counts behind what a test pattern shows, with the gains that the gateway knows."""

    counts: npt.NDArray[np.int32]
    reads = 0

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.known_gain, self.known_offset = self.gain.copy(), self.offset.copy()

    def tell(self, taxels: npt.NDArray[np.intp]) -> None:
        """Note that the gateway knows gains and offsets of these taxels."""
        self.known_gain[taxels], self.known_offset[taxels] = self.gain[taxels], self.offset[taxels]

    def read(self, force_n: npt.NDArray[np.float32], step: int = 0) -> npt.NDArray[np.int32]:
        raw = np.zeros(self.gain.shape, np.int32)
        raw[: force_n.size] = to_counts(force_n.ravel(), self.taxels)
        self.reads += 1
        known = self.known_gain * raw + self.known_offset
        self.counts = np.clip(np.rint(known), 0, self.taxels.count_max).astype(np.int32)
        return super().read(force_n, step)


class WitnessSampler(Sampler):
    """A sampler that remembers the sums of these counts by bus and SYNC counter; the newest wins.

    Where another master counts ahead on one bus, the sums that the boards of another bus get may be older than theirs.
    """

    def __init__(self, phi: Sbhe, electronics: Witness) -> None:
        taxels = electronics.taxels
        super().__init__(phi, Shaking((taxels.rows, taxels.columns)), electronics)
        self.truths: dict[tuple[int, int], npt.NDArray[np.int32]] = {}
        self._witness = electronics
        #: By the identity of what the boards got.
        self._true: dict[int, npt.NDArray[np.int32]] = {}

    def sample(self, counter: int, time_ns: int, bus: int = 0) -> npt.NDArray[np.int32]:
        before = self._witness.reads
        sums = super().sample(counter, time_ns, bus)
        if self._witness.reads > before:
            self._true[id(sums)] = self._phi.wired.forward(self._witness.counts)
        self.truths[bus, counter] = self._true[id(sums)]
        return sums


class Line:
    """Where bursts wait in their order: each for `delay_ns`, and all until `shut_until_ns`."""

    def __init__(self) -> None:
        self.delay_ns = self.shut_until_ns = 0
        self._waiting: deque[tuple[int, Frames]] = deque()

    def put(self, burst: Frames, now_ns: int) -> None:
        self._waiting.append((now_ns + self.delay_ns, burst))

    def is_due(self, now_ns: int) -> bool:
        return bool(self._waiting) and now_ns >= max(self._waiting[0][0], self.shut_until_ns)

    def holds(self, now_ns: int) -> bool:
        """Tell whether what comes now has to wait."""
        return bool(self._waiting) or self.delay_ns > 0 or now_ns < self.shut_until_ns

    def take(self, now_ns: int) -> list[Frames]:
        """Return what has waited for long enough."""
        due = []
        while self.is_due(now_ns):
            due.append(self._waiting.popleft()[1])
        return due

    def clear(self) -> None:
        self._waiting.clear()


class EndOfWire:
    """One of the two that are joined by a `Wire`."""

    def __init__(self, wire: "Wire") -> None:
        self.wire = wire
        #: What may be read now, and what arrives.
        self.waiting: list[Frames] = []
        self.arriving = Line()
        #: Whether it has room for what is sent.
        self.takes = True

    @property
    def is_held(self) -> bool:
        """Whether it is not read."""
        return self.arriving.shut_until_ns == FOREVER_NS

    @is_held.setter
    def is_held(self, is_held: bool) -> None:
        self.arriving.shut_until_ns = FOREVER_NS if is_held else 0

    @property
    def has_news(self) -> bool:
        return bool(self.waiting) or self.arriving.is_due(self.wire.now_ns)

    def arrive(self, burst: Frames) -> None:
        self.arriving.put(burst, self.wire.now_ns)

    def receive(self) -> Frames:
        came = self.arriving.take(self.wire.now_ns)
        for burst in came if self.wire.echoes_early else ():
            burst["time_ns"] = self.wire.now_ns  # that of the read
        bursts = [*self.waiting, *came]
        self.waiting.clear()
        if len(bursts) == 1:
            return bursts[0]
        # Not np.concatenate, which compares the fields of the records each time.
        arrived, begin = frames(sum(map(len, bursts))), 0
        for burst in bursts:
            arrived[begin : begin + len(burst)] = burst
            begin += len(burst)
        return arrived

    def send(self, burst: Frames) -> int:
        if not self.takes:
            return 0
        self.wire.queue.append((self, burst.copy()))
        return len(burst)


class Wire:
    """A bus of no length: frames arrive in the order in which they were sent, at once, at everybody."""

    #: What the gateway is told, see `bus.link.Link`.
    proves_echo = True
    #: The gateway's echoes do not wait, and its adapter has no clock.
    echoes_early = False

    def __init__(self) -> None:
        #: The time of what is sent without a time of its own.
        self.now_ns = 0
        self.queue: list[tuple[EndOfWire | None, Frames]] = []
        self.gateway = EndOfWire(self)
        self.nodes = EndOfWire(self)
        self.log: list[tuple[int, bytes]] = []
        #: Tells which frames an end loses: called with the end and a frame.
        self.loses: Callable[[EndOfWire, np.void], bool] | None = None
        #: Where frames of the gateway wait.
        self.transmit = Line()
        #: Where frames of boards wait, by what their identifiers have in common: bits and mask.
        self.lines: dict[tuple[int, int], Line] = {}

    def line(self, can_id: int, mask: int = HIGHEST_NODE_ID) -> Line:
        """Return where frames of boards wait; without `mask` those of a node."""
        return self.lines.setdefault((can_id, mask), Line())

    def hang(self, node_id: int, until_ns: int) -> None:
        """Let a board hold back all that it sends, unless it hung less than three periods ago."""
        line = self.line(node_id)
        if until_ns - line.shut_until_ns > 8 * PERIOD_S * 1e9:
            line.shut_until_ns = until_ns

    def wake(self) -> None:
        """Let every board go on that hangs."""
        for line in self.lines.values():
            line.shut_until_ns = min(line.shut_until_ns, self.now_ns)

    def deliver(self) -> bool:
        """Carry what was sent; tell whether there was anything."""
        sent, self.queue = self.queue, []
        going: list[tuple[EndOfWire | None, Frames]] = []
        going += [(self.nodes, each) for line in self.lines.values() for each in line.take(self.now_ns)]
        for sender, burst in sent:
            going += self._off(sender, burst)
        going += [(self.gateway, each) for each in self.transmit.take(self.now_ns)]
        for sender, burst in going:
            self._carry(sender, burst)
        return bool(sent or going)

    def _off(self, sender: EndOfWire | None, burst: Frames) -> list[tuple[EndOfWire | None, Frames]]:
        """Return what need not wait; let the rest wait."""
        if sender is self.gateway:
            if self.echoes_early:
                echo = burst.copy()
                echo["flags"] |= ECHO
                self.gateway.waiting.append(echo)
            if self.transmit.holds(self.now_ns):
                self.transmit.put(burst, self.now_ns)
                return []
        elif sender is self.nodes:
            for (can_id, mask), line in self.lines.items():
                is_mine = burst["can_id"] & mask == can_id
                if is_mine.any() and line.holds(self.now_ns):
                    line.put(burst[is_mine], self.now_ns)
                    burst = burst[~is_mine]
        return [(sender, burst)]

    def _carry(self, sender: EndOfWire | None, burst: Frames) -> None:
        ids_and_lengths = zip(burst["can_id"].tolist(), burst["length"].tolist(), strict=True)
        self.log += [
            (can_id, data[:length].tobytes())
            for (can_id, length), data in zip(ids_and_lengths, burst["data"], strict=True)
        ]
        for end in (self.gateway, self.nodes):
            if self.echoes_early and end is sender is self.gateway:
                continue
            arrived = self._arrived(end, sender, burst)
            if self.loses is not None:
                arrived = arrived[[not self.loses(end, each) for each in arrived]]
            end.arrive(arrived)

    def _arrived(self, end: EndOfWire, sender: EndOfWire | None, burst: Frames) -> Frames:
        """Return what comes to an end of these frames, its own as echoes."""
        copy = burst.copy()
        copy["time_ns"][copy["time_ns"] == 0] = self.now_ns
        if end is sender:
            copy["flags"] |= ECHO
        return copy

    def put(self, can_id: int, data: bytes) -> None:
        """Send a frame of somebody else."""
        self.queue.append((None, frame(can_id, data)))


class Talk(Protocol):
    """A talk with boards: a check, an order, an update."""

    @property
    def done(self) -> bool:
        """Whether it has ended."""

    def tick(self, now_s: float, /) -> object:
        """Go on."""


@dataclass
class Skin:
    """The boards of a skin on their wires, and the clock of all.

    Attributes
    ----------
    built : Contract or None
        What the nodes were built for, where that is not `contract`.
    """

    contract: Contract
    store: Path | None = None
    built: Contract | None = None
    now_s: float = 100.0
    complaints: list[str] = field(default_factory=list)
    step_s: ClassVar[float] = STEP_S
    wire: ClassVar[type[Wire]] = Wire
    #: How many of the buses there are; 0: all.
    buses: ClassVar[int] = 0

    def __post_init__(self) -> None:
        self.wires = [self.new_wire(bus) for bus in range(self.buses or len(self.contract.layout.bus))]
        self.hardware = self.new_hardware()
        self.segments = [self.new_segment(bus, self.built or self.contract) for bus in range(len(self.wires))]
        self.power_up()

    def new_wire(self, bus: int) -> Wire:
        return self.wire()

    def new_hardware(self) -> Any:
        """Return what samples the taxels."""
        layout, places = self.contract.layout, self.contract.phi.wired.taxels
        electronics = Witness(layout.taxels, noise_n=0.0, period_s=layout.sync.period_s, places=places)
        return WitnessSampler(self.contract.phi, electronics)

    def new_boards(self, bus: int, contract: Contract) -> Boards:
        ids = {node.node_id for node in contract.on_bus(bus)}
        return VirtualBoards(contract, bus, ids, self.hardware, store=self.store)

    def new_segment(self, bus: int, contract: Contract) -> Any:
        send = self.wires[bus].nodes.send
        boards = self.new_boards(bus, contract)
        return Segment(contract, bus, boards, self.hardware, send, complain=self.complaints.append)

    def power_up(self) -> None:
        for segment in self.segments:
            segment.boot(self.now_s)

    def carry(self, hear: Callable[[int, Frames], object]) -> None:
        """Carry what was sent, and let everybody answer, until nobody says anything more."""
        for wire in self.wires:
            wire.now_ns = round(self.now_s * 1e9)
        while sum(wire.deliver() for wire in self.wires) or any(wire.gateway.has_news for wire in self.wires):
            for bus, (wire, segment) in enumerate(zip(self.wires, self.segments, strict=True)):
                if wire.nodes.has_news:
                    segment.take(wire.nodes.receive(), self.now_s)
                if wire.gateway.has_news:
                    hear(bus, wire.gateway.receive())

    def lead(
        self,
        talk: Talk,
        hear: Callable[[int, Frames], object],
        each_step: Callable[[], object] = lambda: None,
        at_most_s: float = 60.0,
    ) -> None:
        """Lead a talk to its end; `hear` takes what comes of a bus."""
        end_s = self.now_s + at_most_s
        while not talk.done:
            self.now_s += self.step_s
            assert self.now_s < end_s
            each_step()
            talk.tick(self.now_s)
            for segment in self.segments:
                segment.tick(self.now_s)
            self.carry(hear)

    # What another master does

    def nmt(self, bus: int, command: int, node_id: int) -> None:
        self.wires[bus].put(NMT_COB_ID, bytes((command, node_id)))

    def write(self, bus: int, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object by an expedited SDO download."""
        self.request(bus, node_id, 0x23 | 4 - len(data) << 2, index, subindex, data)

    def write_in_segments(self, bus: int, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object of up to seven bytes by a segmented SDO download."""
        self.request(bus, node_id, 0x21, index, subindex, len(data).to_bytes(4, "little"))
        segment = bytes((1 | 7 - len(data) << 1,)) + data.ljust(7, b"\0")
        self.wires[bus].put(SDO_REQUEST_BASE + node_id, segment)

    def request(self, bus: int, node_id: int, command: int, index: int, subindex: int, data: bytes) -> None:
        """Send an SDO request."""
        place = index.to_bytes(2, "little") + bytes((subindex,))
        self.wires[bus].put(SDO_REQUEST_BASE + node_id, bytes((command,)) + place + data.ljust(4, b"\0"))


@dataclass
class World(Skin):
    """A skin, its gateway, and what they said; `link` and `dropped` are what the gateway's links say of each bus."""

    #: Whether boards hear a SYNC before they look at time.
    hears_sync_first: ClassVar[bool] = True
    rates_hz: tuple[float, float] = RATES_HZ
    #: Whether somebody else takes `NmtMaster.recalibrated`.
    calibrates: bool = False
    lines: list[str] = field(default_factory=list)
    measured: list[Measurement] = field(default_factory=list)
    #: Bus and node-ID of nodes whose gains or offsets have become others.
    recalibrated: list[tuple[int, int]] = field(default_factory=list)
    #: `wrong_blocks` of the identities of `measured`.
    _wrong: dict[int, list[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.link, self.dropped = [State.ACTIVE] * len(self.wires), [0] * len(self.wires)
        self.gateway = self.new_gateway()

    @property
    def sampler(self) -> WitnessSampler:
        """What samples the taxels of boards in Python."""
        assert isinstance(self.hardware, WitnessSampler)
        return self.hardware

    @property
    def electronics(self) -> Witness:
        """The live taxels of boards in Python."""
        return self.sampler._witness

    def new_gateway(self) -> GatewayLoop:
        for wire in self.wires:
            wire.gateway.arriving.clear()
        return GatewayLoop(
            self.contract,
            {bus: wire.gateway.send for bus, wire in enumerate(self.wires)},
            self.now_s,
            say=self.lines.append,
            complain=self.complaints.append,
            rates_hz=self.rates_hz,
            early_echoes=[bus for bus, wire in enumerate(self.wires) if not wire.proves_echo],
        )

    def step(self) -> list[Measurement]:
        """Go on by `step_s`: everybody does what is due, until nobody says anything more."""
        self.now_s += self.step_s
        came: list[Measurement] = []
        self.gateway.tick(self.now_s)
        came += self._compared(self.gateway.send_sync(self.now_s))
        if self.hears_sync_first:
            self.carry(self.hear)
        for bus, segment in enumerate(self.segments):
            segment.tick(self.now_s)
            self.hear(bus, frames(0))
        self.carry(self.hear)
        came += self._compared(self.gateway.measurements(self.now_s))
        self.measured += came
        return came

    def _compared(self, made: list[Measurement]) -> list[Measurement]:
        """Compare measurements when they are made: a later SYNC, a foreign one, too, may have a counter of theirs."""
        self._wrong |= {id(each): self._wrong_blocks(each) for each in made}
        return made

    def hear(self, bus: int, arrived: Frames) -> None:
        """Let the gateway read a bus."""
        link, dropped = self.link[bus], self.dropped[bus]
        self.gateway.take(bus, arrived, self.now_s, state=link, dropped=dropped, stamp_error_ns=0)
        self._learn()

    def _learn(self) -> None:
        """Let the witness know of gains and offsets what the gateway has found."""
        for master in self.gateway.masters.values():
            for node in master.recalibrated:
                self.recalibrated.append((node.bus, node.node_id))
                chains = self.contract.phi.taxels_of_blocks[node.block : node.block + node.blocks]
                if isinstance(self.hardware, WitnessSampler):
                    self.electronics.tell(chains.ravel())
            if not self.calibrates:
                master.recalibrated.clear()

    def run(self, seconds: float) -> list[Measurement]:
        """Go on for some time; return the measurements of it."""
        first = len(self.measured)
        for _ in range(round(seconds / self.step_s)):
            self.step()
        return self.measured[first:]

    def pass_time(self, seconds: float) -> None:
        """Go on without SYNC: for what takes long and asks for no sums."""
        self.gateway.sync.stop()
        self.run(seconds)
        self.gateway.sync.start(self.now_s + PERIOD_S)

    def status(self) -> GatewayStatus:
        """Return all counters."""
        links = dict(enumerate(zip(self.link, self.dropped, strict=True)))
        return self.gateway.status(links, self.now_s)

    def until(self, is_so: Callable[[], object], at_most_s: float = 60.0) -> None:
        """Go on until something is so."""
        end_s = self.now_s + at_most_s
        while not is_so():
            assert self.now_s < end_s, self.lines[-5:]
            self.step()

    def until_whole(self, at_most_s: float) -> float:
        """Go on until every block that sends sums is valid; return how long that took."""
        start_s, sending = self.now_s, self.contract.phi.has_sums
        while self.now_s - start_s < at_most_s:
            if any(valid(each)[sending].all() for each in self.step()):
                return self.now_s - start_s
        raise AssertionError(
            f"blocks {np.flatnonzero(~valid(self.measured[-1]))} are still not valid: {self.lines[-5:]}"
        )

    def until_sync(self) -> None:
        """Go on until a SYNC has been sent; the cycle stays open where a bus is held."""
        sent = self.gateway.sync.sent
        self.until(lambda: self.gateway.sync.sent > sent)

    def wrong_blocks(self, measurement: Measurement) -> list[int]:
        """Return the blocks that are called valid and are not Φ of that cycle's counts."""
        found = self._wrong.get(id(measurement))
        return self._wrong_blocks(measurement) if found is None else found

    def _wrong_blocks(self, measurement: Measurement) -> list[int]:
        sums = np.frombuffer(measurement.sums, "<i4")
        phi = self.contract.phi
        differs = np.zeros(phi.blocks, np.bool_)
        for bus in range(len(self.wires)):
            blocks = [node.block + each for node in self.contract.on_bus(bus) for each in range(node.blocks)]
            truth = self._truth(measurement.sync_counter, bus)
            if truth is None:
                differs[blocks] = True
                continue
            differs[blocks] = np.isin(blocks, phi.block_of_sum[sums != truth])
        return np.flatnonzero(differs & valid(measurement)).tolist()

    def _truth(self, counter: int, bus: int) -> npt.NDArray[np.int32] | None:
        """Return the sums that a measurement has of a bus, those of each turn of its newest cycle.

        None if no node of the bus has sampled in one of these cycles.
        """
        table, packing = self.contract.table, self.contract.packing
        truth = np.zeros(self.contract.phi.shape[0], np.int32)
        for age in range(self.contract.turns):
            cycle = (counter - 1 - age) % SYNC_OVERFLOW + 1
            sums = self.sampler.truths.get((bus, cycle))
            if sums is None:
                return None
            places = table.gather[table.turn == self.contract.turn_of(cycle)]
            truth[places[places >= 0]] = sums[places[places >= 0]]
        return packing.counts(packing.raw(truth))


def valid(measurement: Measurement) -> npt.NDArray[np.bool_]:
    return np.frombuffer(measurement.valid, np.uint8) == 1


def little(value: int, size: int = 4) -> bytes:
    return value.to_bytes(size, "little")


def swap_mapping(skin: Skin, bus: int, node_id: int, tpdo: int = 0, *, back: bool = False) -> None:
    """Swap the first two sums of a TPDO, behind the counter, or swap them back, as CiA 301, 7.5.2.38, wants it done."""
    node = next(each for each in skin.contract.on_bus(bus) if each.node_id == node_id)
    cob_id = node.tpdos[tpdo].cob_id | 0x4000_0000
    entries = [each.data for each in configuration(skin.contract, node) if each.index == od.TPDO_MAPPING + tpdo]
    count, first, second = entries[0], *(entries[3:1:-1] if back else entries[2:4])
    communication, mapping = od.TPDO_COMMUNICATION + tpdo, od.TPDO_MAPPING + tpdo
    for index, subindex, data in (
        (communication, 1, little(cob_id | 0x8000_0000)),
        (mapping, 0, b"\0"),
        (mapping, 2, second),
        (mapping, 3, first),
        (mapping, 0, count),
        (communication, 1, little(cob_id)),
    ):
        skin.write(bus, node_id, index, subindex, data)


#: Disturbances in each of the four cases: the same ones in every run, or as many random ones as wanted.
DISTURBANCES: Final = int(os.environ.get("SKIN_DISTURBANCES", "1300"))


RANDOM: Final = settings(
    derandomize="SKIN_DISTURBANCES" not in os.environ,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=(Phase.explicit, Phase.generate),  # to shrink an example takes longer than all tests
)


#: After the last disturbance and the pause of a node that is out: a heartbeat, another pause, a proof that runs out.
BOUND_S: Final = 1.0 + max(PAUSES_S) + 5.0


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
        case ("hang", (bus, node_id), periods):
            world.wires[bus].hang(node_id, round((world.now_s + periods * PERIOD_S) * 1e9))
            return []
        case ("nmt", bus, command, node_id):
            world.nmt(bus, command, node_id)
            return [bus * 2, bus * 2 + 1]
        case ("store" | "restore" as how, (bus, node_id)):
            index, word = (od.STORE, od.SIGNATURE_SAVE) if how == "store" else (od.RESTORE, od.SIGNATURE_LOAD)
            world.write(bus, node_id, index, 1, little(word))
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
        wire.wake()
    world.run(SILENT_AFTER_S)  # the next heartbeat shows a command that the gateway has lost
    skip_pauses(world)
    world.until_whole(BOUND_S)


def skip_pauses(world: World) -> None:
    """Check that no node is left out for longer than the longest pause; go on as if that pause were over."""
    for master in world.gateway.masters.values():
        for each in master.nodes.values():
            if not each.in_use:
                assert each.prove_at_s <= world.now_s + LATER_S
                each.prove_at_s = each.due_s = min(each.prove_at_s, world.now_s)
                each.tries = 0
                each.alone_s = min(each.alone_s, world.now_s)
