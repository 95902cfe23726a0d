"""A skin on simulated buses that is watched: its services as far as they are seen, and what the page says is wrong."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Final

import msgspec
import numpy as np

from bus.faults import Fault, FaultSchedule
from bus.link import State
from bus.outbox import OTHERS, OWNER
from bus.simulated_bus import SimulatedBus
from bus.station import Station
from canskin.messages import Measurement
from canskin.peers import Peer, new_peer
from dbc.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frames
from gateway.calibration import GatewayCalibration
from gateway.service import STATUS_PERIOD_S
from health.state import ViewState
from tests import messages as make
from tests.world import STEP_S, EndOfWire, Wire, World, valid

#: Frames that end within this time are handed on together.
SLICE_NS: Final = 500_000
SERVICES: Final = ("viewer", "gateway", "reconstructor", "classifier", "nodes")
#: What every start says, and a skin that is touched from its start on, as that of `tests.world.Shaking`.
ALWAYS: Final = ("starting", "node-starting", "no-image", "no-zero")


class BusWire(Wire):
    """A wire that is a simulated bus: frames take their time, in the order of their identifiers."""

    def __init__(self, bitrate: int) -> None:
        super().__init__()
        self.bus = SimulatedBus(bitrate, seed=1)
        self._stations: dict[EndOfWire | None, Station] = {
            end: self.bus.attach(name) for end, name in ((self.gateway, "gateway"), (self.nodes, "nodes"))
        }

    @property
    def state(self) -> State:
        """State of the gateway's controller."""
        return self._stations[self.gateway].state

    def suffer(self, *faults: Fault) -> None:
        """Let the bus have these faults alone from now on."""
        self.bus._faults = FaultSchedule(faults, 1)

    def unplug(self) -> None:
        """Take all boards off the bus: nobody acknowledges what the gateway sends."""
        self.bus.detach(self._stations.pop(self.nodes))

    def plug(self) -> None:
        self._stations[self.nodes] = self.bus.attach("nodes")

    def exchange(self, other: "BusWire") -> None:
        """Exchange the boards with those of another wire."""
        mine, theirs = self._stations.pop(self.nodes), other._stations.pop(other.nodes)
        self.nodes, other.nodes = other.nodes, self.nodes
        self._stations[self.nodes], other._stations[other.nodes] = mine, theirs
        self.nodes.wire, other.nodes.wire = self, other

    def unplug_others(self) -> None:
        """Take everybody off the bus who is no part of the skin, with what waits there."""
        self.bus.detach(self._stations.pop(None))

    def deliver(self) -> bool:
        came, coming, limit_ns = super().deliver(), self.bus.next_event_ns(), self.now_ns + round(STEP_S * 1e9) - 1
        if coming is None or coming > limit_ns:
            return came
        events = self.bus.run_until(min(coming + SLICE_NS, limit_ns))
        self.log += [(int(each["can_id"]), each["data"][: each["length"]].tobytes()) for each in events.frames]
        for end, station in list(self._stations.items()):
            if end is None:
                continue
            is_own = events.owner == station.number
            comes = events.audience & np.where(is_own, OWNER, OTHERS) != 0
            arrived, is_own = events.frames[comes], is_own[comes]
            arrived["flags"] |= np.where(is_own & (arrived["flags"] & ERROR == 0), ECHO, 0).astype(np.uint8)
            arrived["port"] *= is_own
            if self.loses is not None:
                arrived = arrived[np.array([not self.loses(end, each) for each in arrived], np.bool_)]
            end.arrive(arrived)
        return True

    def _carry(self, sender: EndOfWire | None, burst: Frames) -> None:
        if sender not in self._stations:
            if sender is not None:
                return  # unplugged
            self._stations[None] = self.bus.attach("others", 4096)
        self.bus.submit(self._stations[sender], burst, self.now_ns)


@dataclass
class Watched(World):
    """A skin with all its services, and the notices of the page.

    Attributes
    ----------
    notices : dict of str to str
        Texts of now by their codes, without `ALWAYS`.
    broken_s, said_s : float
        When a block was last not valid, and something was last said to be wrong.
    named : dict of str to float
        When each cause was first named, since the dict was last cleared.
    during : callable
        What happens in each step.
    mute : set of str
        Services that send nothing.
    """

    calibrates: bool = True
    notices: dict[str, str] = field(default_factory=dict)
    named: dict[str, float] = field(default_factory=dict)
    broken_s: float = -np.inf
    said_s: float = -np.inf
    during: Callable[[], object] | None = None
    mute: set[str] = field(default_factory=set)
    #: What the links of the buses are, where the simulated controllers are well.
    forced: dict[int, State] = field(default_factory=dict)
    peers: dict[str, Peer] = field(default_factory=dict)
    #: Frames with the identifiers of sums that the gateway has heard.
    heard_sums: int = 0

    def __post_init__(self) -> None:
        layout = self.contract.layout
        self._sums = [
            [tpdo.cob_id for node in self.contract.on_bus(bus) for tpdo in node.tpdos] for bus in range(len(layout.bus))
        ]
        super().__post_init__()
        self.state = ViewState(layout, service="viewer")
        self._calibration = GatewayCalibration(self.contract, tares=False)
        self._look_s = self.now_s
        self._links: Any = {bus: SimpleNamespace(explain=lambda: "") for bus in range(len(self.wires))}
        for name in SERVICES:
            self.come(new_peer(layout.name, name, self.contract.phi.fingerprint))

    def new_wire(self, bus: int) -> Wire:
        return BusWire(self.contract.layout.bus[bus].bitrate)

    def come(self, peer: Peer) -> None:
        """Let a service come; the one of its name goes."""
        if peer.service in self.peers:
            self.go(peer.service)
        self.peers[peer.service] = peer
        self.state.take_peer(peer, True, self.now_s)

    def go(self, service: str) -> Peer:
        """Let a service go; return what it was."""
        gone = self.peers.pop(service)
        self.state.take_peer(gone, False, self.now_s)
        return gone

    def hear(self, bus: int, arrived: Frames) -> None:
        wire = self.wires[bus]
        self.link[bus] = self.forced.get(bus, wire.state) if isinstance(wire, BusWire) else State.ACTIVE
        plain = arrived[arrived["flags"] & (ECHO | ERROR | EXTENDED | REMOTE | FD) == 0]
        self.heard_sums += int(np.isin(plain["can_id"], self._sums[bus]).sum())
        super().hear(bus, arrived)

    def step(self) -> list[Measurement]:
        if self.during is not None:
            self.during()
        came = super().step()
        self._calibration.look(self.gateway.masters, self.now_s)
        self._calibration.tick(self.gateway.masters, self.now_s)
        for each in came:
            if not valid(each)[self.contract.phi.has_sums].all():
                self.broken_s = self.now_s
            self._publish(each)
        if self.now_s >= self._look_s:
            self._look_s = self.now_s + STATUS_PERIOD_S
            self._look()
        return came

    def speak(self, service: str, message: msgspec.Struct) -> None:
        """Let a service send a message."""
        if service in self.peers and not self.mute & {service, "hub"}:
            self.state.take(message, self.now_s)

    def _publish(self, each: Measurement) -> None:
        if "gateway" not in self.peers or "gateway" in self.mute:
            return
        sums = int(np.count_nonzero(self.contract.phi.sums_of_blocks(valid(each))))
        moment = {"sampled_mono_ns": each.sampled_mono_ns, "valid_sums": sums}
        pixels = bytes(4 * self.contract.layout.taxels.count)
        self.speak("reconstructor", make.image(each.cycle, pixels=pixels, valid=each.valid, **moment))
        self.speak("classifier", make.label(each.cycle, **moment))

    def _look(self) -> None:
        self.gateway.report_links(self._links, self.now_s)
        self.speak("gateway", msgspec.structs.replace(self.status(), calibration=self._calibration.status()))
        snapshot, _ = self.state.snapshot(self.now_s)
        self.notices = {each.code: each.text for each in snapshot.notices if each.code not in ALWAYS}
        for code in self.notices:
            self.named.setdefault(code, self.now_s)
        if self.notices:
            self.said_s = self.now_s
