"""The gateway without its input and output: frames and times in, frames and measurements out."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from bus.link import Send, State
from dbc.canopen import SYNC_COB_ID, NmtState
from dbc.contract import Contract, NodeContract
from dbc.frame import Frames, one_frame
from gateway.collector import Collector, Gathered
from gateway.cycles import LATEST, SyncClock
from gateway.load import BusLoad
from gateway.nmt_master import NmtMaster
from skin.messages import BusState, GatewayStatus, Measurement
from skin.ranges import ranges_text

#: Period of `_look_after_nodes`.
LOOK_PERIOD_S: Final = 0.2
#: SYNC starts when every node has answered or timed out, at the latest after this time.
BOOT_PATIENCE_S: Final = 3.0
#: Time from the start of the last node to the first SYNC.
SETTLE_S: Final = 0.1
#: A cycle ends at the latest this part of a period after the next SYNC was due.
GRACE: Final = 0.9


@dataclass(frozen=True)
class _Cycle:
    number: int
    counter: int
    sync_mono_ns: int
    time_ns: int
    closes_s: float


@dataclass
class _Bus:
    """State of one bus."""

    name: str
    send: Send
    master: NmtMaster
    load: BusLoad
    places: list[tuple[int, NodeContract]]
    #: SYNCs in a row that the transmit queue did not accept.
    refused_syncs: int = 0
    #: The log names the cause already.
    is_explained: bool = False


class GatewayLoop:
    """Master and collector of a skin's buses.

    Parameters
    ----------
    contract : Contract
    sends : mapping of int to callable
        Sends frames, by number of the bus.
    now_s : float
        Monotonic time.
    say, complain : callable
        Write a line to the log: `say` for a change, `complain` for a line that may come many times.

    Attributes
    ----------
    collector : Collector
    sync : SyncClock
    masters : dict of int to NmtMaster
        By number of the bus.
    """

    def __init__(
        self,
        contract: Contract,
        sends: Mapping[int, Send],
        now_s: float,
        *,
        say: Callable[[str], None],
        complain: Callable[[str], None],
    ) -> None:
        self.collector = Collector(contract)
        self.sync = SyncClock(contract.layout.sync.period_s)
        self._contract = contract
        self._period_s = contract.layout.sync.period_s
        self._say, self._complain = say, complain
        self._place = {(node.bus, node.node_id): place for place, node in enumerate(contract.nodes)}
        self._buses = {number: self._bus(number, send, now_s) for number, send in sends.items()}
        self._numbers = sorted(self._buses)
        self.masters = {number: bus.master for number, bus in self._buses.items()}
        self._flying: deque[_Cycle] = deque()
        self._patience_s = now_s + BOOT_PATIENCE_S
        self._look_s = now_s
        self._closed = self._complete = 0

    @property
    def in_flight(self) -> int:
        """Number of open cycles."""
        return len(self._flying)

    @property
    def due_s(self) -> float:
        """When the next SYNC is due or the oldest cycle must be closed, whichever comes first."""
        closes_s = self._flying[0].closes_s if self._flying else float("inf")
        return min(self.sync.due_s, closes_s)

    def take(self, number: int, arrived: Frames, now_s: float) -> None:
        """Use the frames that arrived on a bus, in bus order."""
        if not len(arrived):
            return
        bus = self._buses[number]
        # The master first: a frame may make it doubt the node whose sums come next.
        bus.master.take(arrived, now_s)
        self.collector.take(number, arrived)
        bus.load.take(arrived)

    def tick(self, now_s: float) -> None:
        """Do all that is due at `now_s`, except SYNC and the end of cycles."""
        for bus in self._buses.values():
            bus.master.tick(now_s)
        if not self.sync.runs and self.sync.counter == 0:
            passed = all(bus.master.passed for bus in self._buses.values())
            if passed or now_s >= self._patience_s:
                self._start_sync(now_s)
        if now_s >= self._look_s:
            self._look_s = now_s + LOOK_PERIOD_S
            self._look_after_nodes(now_s)

    def send_sync(self, now_s: float, wall_offset_ns: int = 0) -> list[Measurement]:
        """Send the SYNC that is due on every bus; return the measurements of cycles that were closed for it.

        Parameters
        ----------
        now_s : float
            Time of this call. With an older time, SYNCs would come close together after a stall.
        wall_offset_ns : int
            Wall clock minus monotonic clock.
        """
        due_s = self.sync.take(now_s)
        if due_s is None:
            return []
        closed = [self._close(self._flying.popleft()) for _ in range(len(self._flying) - 1)]
        counter = self.sync.counter
        self.collector.open(counter)
        sync = one_frame(SYNC_COB_ID, bytes((counter,)))
        # The due time: on a virtual bus a late turn of the loop adds no jitter to SYNC.
        sync["time_ns"] = sync_ns = round(due_s * 1e9)
        sync["expires_ns"] = sync_ns + round(LATEST * self._period_s * 1e9)
        for bus in self._buses.values():
            if bus.send(sync):
                if bus.refused_syncs:
                    self._say(f"{bus.name} takes SYNC again, after {bus.refused_syncs} that it did not take")
                bus.refused_syncs = 0
            else:
                bus.refused_syncs += 1
        closes_s = due_s + (1 + GRACE) * self._period_s
        self._flying.append(_Cycle(self.sync.sent, counter, sync_ns, sync_ns + wall_offset_ns, closes_s))
        return closed

    def close_settled(self, now_s: float) -> list[Measurement]:
        """End the cycles that are settled or out of time; return their measurements."""
        closed = []
        while self._flying:
            oldest = self._flying[0]
            if not self.collector.is_settled(oldest.counter) and now_s < oldest.closes_s:
                break
            closed.append(self._close(self._flying.popleft()))
        return closed

    def stop(self) -> None:
        """Command all nodes to PRE-OPERATIONAL."""
        for bus in self._buses.values():
            bus.master.stop()

    def status(self, links: Mapping[int, tuple[State, int]], now_s: float) -> GatewayStatus:
        """Return all counters.

        Parameters
        ----------
        links : mapping of int to (State, int)
            By number of the bus: state of the gateway's controller, and frames that its receive side lost.
        """
        return GatewayStatus(
            time_ns=time.time_ns(),
            cycles=self._closed,
            cycles_complete=self._complete,
            frames=msgspec.structs.replace(self.collector.counts),
            sync_rate_hz=self.sync.rate_hz(now_s),
            buses=[self._bus_state(number, *links[number], now_s) for number in self._numbers],
            syncs_skipped=self.sync.skipped,
        )

    def explain_refused_syncs(self, states: Mapping[int, State]) -> None:
        """Log once why the transmit queue of a bus accepts no SYNC."""
        for number, bus in self._buses.items():
            if bus.refused_syncs and not bus.is_explained:
                self._say(f"{bus.name} takes no SYNC: {_WHY_REFUSED[states[number]]}")
            bus.is_explained = bool(bus.refused_syncs)

    def _bus(self, number: int, send: Send, now_s: float) -> _Bus:
        def send_one(can_id: int, data: bytes) -> None:
            send(one_frame(can_id, data))

        wires = self._contract.layout.bus[number]
        master = NmtMaster(self._contract, number, send_one, self._trust, self._say)
        places = [(place, node) for place, node in enumerate(self._contract.nodes) if node.bus == number]
        return _Bus(wires.name, send, master, BusLoad(wires, now_s), places)

    def _trust(self, node: NodeContract, proven: bool) -> None:
        """Use the sums of a node from the next cycle on if `proven`; else stop at once."""
        self.collector.trust(slice(node.block, node.block + node.blocks), proven=proven)
        if proven:
            self.collector.expected[self._place[node.bus, node.node_id]] = True

    def _start_sync(self, now_s: float) -> None:
        self.sync.start(now_s + SETTLE_S)
        for bus in self._buses.values():
            bus.load.restart(now_s + SETTLE_S)
            absent = bus.master.awaited
            if absent:
                self._say(f"{bus.name}: no answer yet from node{'s' * (len(absent) > 1)} {ranges_text(absent)}")

    def _look_after_nodes(self, now_s: float) -> None:
        """Let cycles wait for operational nodes only; report swapped phases, emergencies and foreign SYNCs."""
        for place in self.collector.take_swapped():
            node = self._contract.nodes[place]
            if node.bus in self._buses:
                self._buses[node.bus].master.swapped(node.node_id, now_s)
        for number, bus in self._buses.items():
            nmt = bus.master.nmt
            for (place, _), state in zip(bus.places, nmt, strict=True):
                # A node that sends sums is operational, whatever state its last heartbeat had.
                self.collector.expected[place] = state == NmtState.OPERATIONAL or self.collector.heard[place]
            for node_id, code in bus.master.emergencies:
                self._complain(f"EMCY {code:04X}h from node {node_id} on {bus.name}")
            bus.master.emergencies.clear()
            if self.collector.take_foreign_syncs(number):
                self._complain(f"another SYNC producer on {bus.name}: its cycles are not valid")
        self.collector.heard[:] = False

    def _bus_state(self, number: int, state: State, dropped: int, now_s: float) -> BusState:
        bus, collector = self._buses[number], self.collector
        places = [place for place, _ in bus.places]
        return BusState(
            name=bus.name,
            load_ratio=bus.load.look(now_s),
            mean_load_ratio=bus.load.mean_ratio(now_s),
            nodes=bus.master.node_ids,
            nmt=bus.master.nmt.tobytes(),
            missing=collector.missing_of_node[places].tolist(),
            late=collector.late_of_node[places].tolist(),
            emcy=bus.master.emcy,
            refused=bus.master.refused,
            link=state.name.lower(),
            overrun=dropped,
        )

    def _close(self, cycle: _Cycle) -> Measurement:
        gathered: Gathered = self.collector.close(cycle.counter)
        self._closed += 1
        self._complete += gathered.complete
        # One bus per cycle: the burst is over, so the loop has time.
        self._buses[self._numbers[self._closed % len(self._numbers)]].load.account()
        return Measurement(
            cycle=cycle.number,
            sync_counter=cycle.counter,
            sync_mono_ns=cycle.sync_mono_ns,
            time_ns=cycle.time_ns,
            sums=gathered.sums.astype("<i4").tobytes(),
            valid=gathered.valid.astype(np.uint8).tobytes(),
            fingerprint=self._contract.phi.fingerprint,
        )


#: Why a transmit queue is full, by the state of the controller.
_WHY_REFUSED: Final = {
    State.ACTIVE: "its transmit queue is full: is the bus overloaded?",
    State.WARNING: "its transmit queue is full: is the bus overloaded?",
    State.PASSIVE: "nobody acknowledges its frames: is any node powered, wired and at the same bit rate?",
    State.BUS_OFF: "the controller is bus-off: wiring, termination or bit rate",
    State.LOST: "the connection to the bus is gone",
}
