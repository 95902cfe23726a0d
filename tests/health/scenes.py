"""The faults that a skin can have, as scenes: each begins, lasts, and ends, and the skin is watched meanwhile."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from bus.faults import Fault as Odds
from bus.link import State
from canskin.peers import new_peer
from dbc import indices as od
from dbc.canopen import EMCY_BASE, HEARTBEAT_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID, NmtCommand, NmtState
from dbc.frame import ECHO, EXTENDED, FD, REMOTE
from health.state import ViewState
from nodes.node import SkinNode
from tests import messages as make
from tests.bus.harness import frame
from tests.layouts import buses, small_contract
from tests.watched import Watched
from tests.world import PERIOD_S, EndOfWire, little

#: Three nodes on the bus that has the fault, one on the other.
BUSES: Final = buses(3, 1)
#: A scene is over when the skin was whole, and nothing was said, for this time.
CALM_S: Final = 3.0
#: A refused node is asked again after a minute.
PATIENCE_S: Final = 100.0
#: Frames of eight bytes that fill a slow bus for a step.
FLOOD: Final = 26
#: Bits per second of a bus that is flooded: fewer frames fill it.
SLOW: Final = {"bus": buses(3, 1, bitrate=125_000)}

#: Causes of a node that is not heard any more.
SILENT: Final = ("node-loses", "node-silent")

End = Callable[[], object]
Begin = Callable[[Watched], End]


@dataclass(frozen=True, eq=False)
class Scene:
    """A fault.

    Attributes
    ----------
    fault : str
    begin : callable
        Puts the fault into a skin, and returns what ends it.
    codes : sequence of str
        Of the causes that are named, in their order.
    lasts_s : float
        0: it ends at once.
    at_start : bool
        The fault is there before the gateway starts.
    tables : dict
        Of the layout.
    """

    fault: str
    begin: Begin
    codes: tuple[str, ...] = ()
    lasts_s: float = 4.0
    at_start: bool = False
    tables: dict[str, Any] = field(default_factory=dict)


class Result(NamedTuple):
    """What became of a scene: when causes were named, from its begin; when all was well, from its end.

    `whole_s` is None where no block became invalid.
    """

    named_s: dict[str, float]
    whole_s: float | None
    silent_s: float
    wrong: list[int]


@cache
def played(scene: Scene) -> Result:
    """Play a scene."""
    world = Watched(small_contract(**{"bus": BUSES} | scene.tables))
    if not scene.at_start:
        world.until_whole(3.0)
        world.run(2.0)
        assert not world.notices, world.notices
    world.named.clear()
    begun_s, end = world.now_s, scene.begin(world)
    world.run(scene.lasts_s)
    end()
    world.during = None
    ended_s = world.now_s
    world.until(lambda: world.now_s - max(ended_s, world.broken_s, world.said_s) > CALM_S, PATIENCE_S)
    return Result(
        {code: round(at_s - begun_s, 2) for code, at_s in world.named.items()},
        None if world.broken_s < begun_s else max(0.0, round(world.broken_s + PERIOD_S - ended_s, 2)),
        max(0.0, round(world.said_s - ended_s, 2)),
        [block for each in world.measured for block in world.wrong_blocks(each)],
    )


def nothing() -> None:
    """End a fault that has ended."""


# What happens to frames


def losing(is_lost: Callable[[EndOfWire, np.void], bool], *, bus: int = 0) -> Begin:
    """Lose these frames at an end of the wire."""

    def begin(world: Watched) -> End:
        world.wires[bus].loses = is_lost
        return lambda: setattr(world.wires[bus], "loses", None)

    return begin


def at_gateway(end: EndOfWire, each: np.void) -> bool:
    return end is end.wire.gateway and not each["flags"] & ECHO


def is_sum(each: np.void) -> bool:
    return 0x180 <= each["can_id"] < SDO_RESPONSE_BASE


def is_of(each: np.void, *nodes: int) -> bool:
    return each["can_id"] != SYNC_COB_ID and int(each["can_id"]) & 0x7F in nodes


def hears_nothing_of(*nodes: int) -> Begin:
    return losing(lambda end, each: at_gateway(end, each) and is_of(each, *nodes))


def one_of_ten(world: Watched) -> End:
    random = np.random.default_rng(1)
    return losing(lambda end, each: at_gateway(end, each) and is_sum(each) and bool(random.random() < 0.1))(world)


def waiting(delay_s: float, can_id: int, mask: int = 0x7F) -> Begin:
    """Let frames of a board wait."""

    def begin(world: Watched) -> End:
        line = world.wires[0].line(can_id, mask)
        line.delay_ns = round(delay_s * 1e9)
        return lambda: setattr(line, "delay_ns", 0)

    return begin


def suffering(*faults: Odds) -> Begin:
    def begin(world: Watched) -> End:
        world.wires[0].suffer(*faults)
        return world.wires[0].suffer

    return begin


def doing(what: Callable[[Watched], object]) -> Begin:
    """Do something in every step."""

    def begin(world: Watched) -> End:
        world.during = lambda: what(world)
        return nothing

    return begin


def once(what: Callable[[Watched], object]) -> Begin:
    def begin(world: Watched) -> End:
        what(world)
        return nothing

    return begin


def flooding(can_id: int, count: int = FLOOD) -> Begin:
    """Let a device send this number of frames in every step."""
    burst = np.concatenate([frame(can_id, bytes(8))] * count)

    def begin(world: Watched) -> End:
        wire = world.wires[0]
        world.during = lambda: wire.queue.append((None, burst))
        return wire.unplug_others

    return begin


def babbles(world: Watched) -> None:
    """Let node 1 send its sums again and again."""
    for _ in range(FLOOD):
        world.wires[0].nodes.send(frame(0x181, bytes((world.gateway.sync.counter,)).ljust(8), port=1))


def is_malformed(world: Watched) -> None:
    """Send frames with identifiers of node 1 that are none of its frames."""
    for base in (0x180, 0x380, EMCY_BASE, SDO_RESPONSE_BASE, HEARTBEAT_BASE):
        for length, flags in ((0, 0), (3, 0), (8, REMOTE), (8, EXTENDED), (8, FD), (64, FD)):
            world.wires[0].nodes.send(frame(base + 1, bytes(length), flags, port=1))


def all_identifiers(world: Watched) -> None:
    """Send everything that nobody on the bus knows, a few at a time."""
    first = round(world.now_s / world.step_s) * 20
    for number in range(first, first + 20):
        can_id = number % 0x800
        if can_id & 0x7F > 3 and can_id & 0x7F not in (0x64, 0x65):
            world.wires[0].put(can_id, bytes((number & 0xFF,) * 8))
        world.wires[0].queue.append((None, frame(number * 7919 % (1 << 29), bytes(8), EXTENDED)))


def doubled(world: Watched) -> End:
    """Let a second board with the node-ID of node 1 boot, and answer each SYNC a moment later."""
    wire = world.wires[0]

    def answers(end: EndOfWire, each: np.void) -> bool:
        if end is wire.nodes and each["can_id"] == SYNC_COB_ID:
            for tpdo in world.contract.nodes[0].tpdos:
                wire.put(tpdo.cob_id, bytes((int(each["data"][0]), *b"another")))
        return False

    wire.loses = answers
    wire.put(HEARTBEAT_BASE + 1, b"\0")
    return lambda: setattr(wire, "loses", None)


# What boards and masters do


def board(world: Watched, node_id: int = 1) -> SkinNode:
    return next(each for each in world.segments[0].boards.nodes if each.contract.node_id == node_id)


def reboots(world: Watched) -> None:
    board(world).boot(world.now_s)
    world.segments[0]._post(world.segments[0].boards.pass_time(world.now_s))


def dies(world: Watched) -> End:
    board(world).end()
    return lambda: reboots(world)


def never_there(world: Watched) -> End:
    """Let node 1 be without power from the start on."""
    board(world).end()
    world.wires[0].queue.clear()
    return lambda: reboots(world)


def answers(index: int, value: bytes, subindex: int | None = None) -> Begin:
    """Let node 1 answer with something else; a board that is right replaces it."""

    def begin(world: Watched) -> End:
        def other(end: EndOfWire, each: np.void) -> bool:
            if at_gateway(end, each) and each["can_id"] == SDO_RESPONSE_BASE + 1:
                place = int.from_bytes(each["data"][1:3].tobytes(), "little"), int(each["data"][3])
                if place[0] == od.SIGNATURE:
                    each["data"][4:8] = 0
                elif place[0] == index and subindex in (None, place[1]):
                    each["data"][4:8] = tuple(value)
            return False

        world.wires[0].loses = other

        def end() -> None:
            world.wires[0].loses = None
            reboots(world)

        return end

    return begin


def of_another_skin(world: Watched) -> End:
    """Let the boards of a bus have the program for another Φ."""
    world.wires[0].queue.clear()
    world.segments[0] = world.new_segment(0, small_contract(bus=BUSES, measurement={"seed": 2}))
    world.segments[0].boot(world.now_s)

    def end() -> None:
        world.segments[0] = world.new_segment(0, world.contract)
        world.segments[0].boot(world.now_s)

    return end


def gains(world: Watched) -> End:
    def write(gain: float) -> None:
        world.write(0, 1, od.GAIN, 3, struct.pack("<f", gain))

    write(0.5)
    return lambda: write(1.0)


def emergency(world: Watched) -> End:
    world.wires[0].put(EMCY_BASE + 1, bytes((0x20, 0x81, 0x11, 0, 0, 0, 0, 0)))
    return lambda: world.wires[0].put(EMCY_BASE + 1, bytes(8))


def misses_sync() -> Begin:
    return losing(lambda end, each: end is end.wire.nodes and bool(each["can_id"] == SYNC_COB_ID))


def leaves(world: Watched) -> None:
    board(world).command(NmtCommand.ENTER_PRE_OPERATIONAL)


def stops_all(world: Watched) -> None:
    for segment in world.segments:
        for each in segment.boards.nodes:
            each.command(NmtCommand.STOP)


def other_sync(world: Watched) -> None:
    world.wires[0].put(HEARTBEAT_BASE + 9, bytes((NmtState.OPERATIONAL,)))
    world.wires[0].put(SYNC_COB_ID, bytes((world.gateway.sync.counter % 240 + 1,)))


# What happens to the gateway and its host


def unplugged(world: Watched) -> End:
    world.wires[0].unplug()

    def plug() -> None:
        world.wires[0].plug()
        world.segments[0].boot(world.now_s)

    return plug


def without_interface(world: Watched) -> End:
    world.forced[0] = State.LOST
    ends = losing(lambda *_: True)(world)
    world.wires[0].gateway.takes = False

    def end() -> None:
        world.forced.clear()
        world.wires[0].gateway.takes = True
        ends()

    return end


def swapped(world: Watched) -> End:
    """Let two interfaces come back with each other's names, and after two seconds with their own."""
    begun_s, wires, passed = world.now_s, world.wires, [0.0, 0.5, 2.5, 3.0]

    def step() -> None:
        while passed and world.now_s - begun_s >= passed[0]:
            is_back = passed.pop(0) in {0.5, 3.0}
            world.forced = {} if is_back else dict.fromkeys(range(2), State.LOST)
            for wire in wires:
                wire.loses = None if is_back else lambda *_: True
            if is_back:
                wires[0].exchange(wires[1])
                world.segments.reverse()

    world.during = step
    return nothing


def refuses(world: Watched) -> End:
    world.wires[0].gateway.takes = False
    return lambda: setattr(world.wires[0].gateway, "takes", True)


def overruns(world: Watched) -> None:
    """Let the receive buffer overflow: the newest frames are gone."""
    world.dropped[0] += 3


def stalls(world: Watched) -> None:
    """Let the gateway come late in every second second."""
    if int(world.now_s * 8) % 8 == 0:
        world.now_s += 3 * PERIOD_S


# What happens to services


def gone(service: str) -> Begin:
    def begin(world: Watched) -> End:
        peer = world.go(service)
        return lambda: world.come(peer)

    return begin


def mute(*services: str) -> Begin:
    def begin(world: Watched) -> End:
        world.mute |= set(services)
        return world.mute.clear

    return begin


def hub_away(world: Watched) -> End:
    ends = [mute("hub")(world), *(gone(service)(world) for service in list(world.peers))]
    return lambda: [end() for end in ends]


def other_phi(world: Watched) -> End:
    ours = world.peers["reconstructor"]
    world.come(msgspec.structs.replace(ours, instance="other", fingerprint="0123456789abcdef"))
    return lambda: world.come(ours)


def drops(world: Watched) -> None:
    second = int(world.now_s)
    if world.now_s - second < world.step_s:
        world.state.take(
            make.service_status(second, instance=world.peers["reconstructor"].instance, missed=second), world.now_s
        )


def other_skin(world: Watched) -> End:
    """Let the hub have another skin, and no gateway of this one."""
    gateway = world.peers.pop("gateway")
    world.state = ViewState(world.contract.layout, service="viewer")
    for peer in (*world.peers.values(), new_peer("other", "gateway", "0123456789abcdef")):
        world.state.take_peer(peer, True, world.now_s)
    return lambda: world.come(gateway)


SCENES: Final = (
    Scene("a frame with sums is lost in ten", one_of_ten, ("node-loses",)),
    Scene("frames come twice", suffering(Odds(controller="nodes:*", duplicate_ratio=0.2))),
    Scene("frames of a node come in another order", waiting(0.02, 0x181, 0x7FF)),
    Scene("frames of a node are late by two cycles", waiting(0.11, 1), ("node-loses",)),
    Scene("bit errors on the bus", suffering(Odds(bit_error_rate=2e-4))),
    Scene("nodes miss SYNC", misses_sync(), ("node-loses",)),
    Scene("a node sends frames of other lengths and kinds", doing(is_malformed)),
    Scene("frames of others, all identifiers", doing(all_identifiers)),
    Scene("an identifier fills the bus: 1", flooding(1, 2 * FLOOD), ("bus-full", *SILENT), tables=SLOW),
    Scene("an identifier fills the bus: 7FFh", flooding(0x7FF), ("bus-full",), tables=SLOW),
    Scene("a node floods the bus with its sums", doing(babbles), (
        "bus-full", "node-twice", *SILENT, "node-emergency"
    ), tables=SLOW),
    Scene("a node dies, and boots", dies, (*SILENT, "node-booted")),
    Scene("a node boots again", once(reboots), ("node-booted",), 0.0),
    Scene("a node is never there", never_there, ("node-absent", "node-booted"), at_start=True),
    Scene("two boards have one node-ID", doubled, ("node-booted", "node-twice", "error-passive")),
    Scene("another device has the node-ID", answers(od.IDENTITY, little(0x1234), 1), (
        "node-other-device",
    ), at_start=True),
    Scene("a board of another skin", of_another_skin, ("node-refused",), at_start=True),
    Scene("no answer to SDO, from the start", losing(
        lambda end, each: at_gateway(end, each) and each["can_id"] == SDO_RESPONSE_BASE + 1
    ), ("node-unanswered",), at_start=True),
    Scene("no answer to SDO, later", losing(
        lambda end, each: at_gateway(end, each) and each["can_id"] == SDO_RESPONSE_BASE + 1
    ), ("node-unproven",), 30.0),
    Scene("SDO answers take 0.28 s", waiting(0.26, SDO_RESPONSE_BASE + 1, 0x7FF), ("node-late",), 10.0),
    Scene("a node becomes pre-operational by itself", once(leaves), ("node-loses", "node-left"), 0.0),
    Scene("another master stops a node", once(lambda world: world.nmt(0, NmtCommand.STOP, 1)), ("node-left",), 0.0),
    Scene("all nodes stop again and again", doing(stops_all), ("nothing-measured", "node-loses", "node-left")),
    Scene("another master writes the configuration", once(
        lambda world: world.write(0, 1, od.HEARTBEAT_MS, 0, b"\x10\x27")
    ), ("node-changed",), 0.0),
    Scene("another master writes gains", gains, ("node-changed", "gains-changed")),
    Scene("another SYNC producer", doing(other_sync), ("other-sync",)),
    Scene("a node reports an error", emergency, ("node-emergency",)),
    Scene("the cable breaks behind node 1", hears_nothing_of(2, 3), ("node-loses", "cable-break", "node-silent")),
    Scene("no board on the bus has power", unplugged, ("error-passive", "node-loses", "node-silent", "node-booted")),
    Scene("bus-off", suffering(Odds(controller="gateway:*", bit_error_rate=0.1)), ("bus-off",)),
    Scene("the interface is removed", without_interface, ("interface-lost",)),
    Scene("two interfaces are swapped, and come back so, for 2 s", swapped, (
        "interface-lost", "nothing-measured", "node-refused"), tables={"bus": buses(2, 2)}),
    Scene("the interface takes no SYNC", refuses, ("sync-refused", "node-loses"), 3.0),
    Scene("the gateway's receive buffer overflows", doing(overruns), ("host-late",)),
    Scene("the gateway's host stalls", doing(stalls), ("host-late",)),
    Scene("the hub is away", hub_away, ("hub-away",)),
    Scene("the gateway is gone", gone("gateway"), ("gateway-gone",)),
    Scene("the gateway hangs", mute("gateway"), ("gateway-silent",)),
    Scene("the reconstructor is gone", gone("reconstructor"), ("service-gone",)),
    Scene("the reconstructor hangs", mute("reconstructor"), ("service-silent",)),
    Scene("the classifier hangs", mute("classifier"), ("service-silent",)),
    Scene("the process of simulated boards is gone", gone("nodes"), ("service-gone",)),
    Scene("a reconstructor of another Φ", other_phi, ("service-differs",)),
    Scene("a reconstructor misses messages", doing(drops), ("service-drops",)),
    Scene("another skin alone has the hub", other_skin, ("other-skin", "gateway-absent"), at_start=True),
)  # fmt: skip
