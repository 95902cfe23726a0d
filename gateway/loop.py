"""The gateway without its input and output: frames and times in, frames and measurements out."""

import sys
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from bus.link import Link, Send, State
from canskin.messages import BusState, GatewayStatus, Measurement, NodeEmergency
from dbc.configuration import TICK_S
from dbc.contract import Contract, NodeContract, sync_frame
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import Frames
from dbc.lss import anybody_without_node_id, has_answer
from dbc.time_of_day import time_frame
from gateway.batch import batch_of
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Health, Sync
from gateway.link_watch import LinkWatch
from gateway.load import LoadMeter
from gateway.nmt_master import NmtMaster
from gateway.outgoing import Outgoing
from gateway.sdo import TIMEOUT_S
from gateway.stepped_gathering import RATES_HZ, SteppedGathering
from gateway.sync_clock import LATEST, SyncClock
from gateway.turn import Turn, new_turn
from skin.ranges import ranges_text

#: Period of `_look_after_nodes`.
LOOK_PERIOD_S: Final = 0.2
#: SYNC starts when every node has answered or timed out, at the latest after this time.
BOOT_PATIENCE_S: Final = 3.0
#: Time from the start of the last node to the first SYNC.
SETTLE_S: Final = 0.1
#: Longest time in which a board without node-ID answers: LSS has the lowest priority.
UNNUMBERED_S: Final = 1.0
#: SYNC of somebody else is told for this time.
OTHER_SYNC_S: Final = 10.0


@dataclass
class _Bus:
    """State of one bus."""

    name: str
    send: Send
    master: NmtMaster
    outgoing: Outgoing
    watch: LinkWatch
    load: LoadMeter
    places: list[int]
    #: Nodes whose sums are used from now on, or are not, as the master has found.
    trusts: list[tuple[NodeContract, bool]]
    health: Health = field(default_factory=Health)
    #: SYNCs of somebody else since the last look at the nodes.
    other_syncs: int = 0
    #: When the last of them came.
    other_sync_s: float = -np.inf
    #: Until when boards without node-ID may answer that they are there.
    asked_until_s: float = -np.inf


class GatewayLoop:
    """Master and collector of a skin's buses: what does not depend on how nodes send.

    Parameters
    ----------
    sends : mapping of int to callable
        Sends frames, by number of the bus.
    now_s : float
        Monotonic time.
    say, complain : callable
        Write a line to the log: `say` for a change, `complain` for a line that may come many times.
    rates_hz : tuple of float
        Of steps: most and least measurements in a second.
    early_echoes : collection of int
        Numbers of the buses whose interface may echo a frame before the frame has been on the bus.

    Attributes
    ----------
    gathering : CycleGathering or SteppedGathering
        Makes measurements of frames, as the layout's nodes send them.
    turn : callable
        Waits for frames and uses those of calm buses, see `gateway.turn`; returns how many buses are not calm.
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
        rates_hz: tuple[float, float] = RATES_HZ,
        early_echoes: Collection[int] = (),
    ) -> None:
        self.sync = SyncClock(contract.layout.sync.period_s)
        self._contract = contract
        self._busy_ns = np.zeros(len(contract.layout.bus), np.int64)
        self._say, self._complain = say, complain
        self._buses = {
            number: self._bus(number, send, now_s, has_echoes=number not in early_echoes)
            for number, send in sends.items()
        }
        self._numbers = sorted(self._buses)
        self._table = contract.parts if contract.in_steps else contract.table
        self.masters = {number: bus.master for number, bus in self._buses.items()}
        self.gathering = (
            SteppedGathering(contract, self.masters, now_s, rates_hz)
            if contract.in_steps
            else CycleGathering(contract, early_echoes)
        )
        self.turn = self.gathering.turn
        #: Known from the first tick on: what comes before may take long.
        self._patience_s: float | None = None
        self._tick_s = self._look_s = self._time_due_s = now_s
        self._time_period_s = contract.layout.sync.time_s

    @property
    def in_flight(self) -> int:
        """Number of open cycles."""
        return self.gathering.in_flight

    @property
    def due_s(self) -> float:
        """When the next SYNC or measurement is due, whichever comes first."""
        return min(self.sync.due_s, self.gathering.due_s)

    @property
    def may_sleep_until_s(self) -> float:
        """Until when frames may wait unread."""
        return min(self.sync.due_s, self.gathering.may_sleep_until_s)

    def new_turn(self) -> Turn:
        """Return what `turn` needs, without links yet."""
        return new_turn(self._contract.layout.bus, self._busy_ns)

    def take(
        self,
        number: int,
        arrived: Frames,
        now_s: float,
        *,
        state: State = State.ACTIVE,
        dropped: int = 0,
        stamp_error_ns: int | None,
    ) -> bool:
        """Use the frames that arrived on a bus, in bus order; none is a look at the link.

        Return whether the bus has a gap: then the link has to be looked at again soon, whatever comes.

        Parameters
        ----------
        state : State
            Of the gateway's controller, after these frames.
        dropped : int
            Frames that its receive side has lost so far.
        stamp_error_ns : int or None
            Of the clock of the frames' time stamps, see `bus.link.Link`.
        """
        bus, batch = self._buses[number], batch_of(arrived, number, self._table)
        bus.health.look(state, dropped, stamp_error_ns, tells_loss=batch.tells_loss)
        bus.watch.look(state)
        if bus.health.has_returned:
            for node in bus.master.nodes.values():
                node.take_replugged(now_s)
            self._trust(bus)
        if not len(arrived) and not bus.health.has_gap:
            return False
        bus.outgoing.take(batch.echoes, has_gap=bus.health.has_gap)
        if now_s < bus.asked_until_s and has_answer(batch.talk):
            bus.asked_until_s = -np.inf
            self._say(f"{bus.name}: boards without node-ID are there: stop the gateway, and run skin commission")
        # The master first: a frame may make it doubt the node whose sums come next.
        if len(batch.talk):
            bus.master.take(batch.talk, now_s)
            self._trust(bus)
        self.gathering.take(batch, bus.health, now_s)
        bus.other_syncs += batch.other_syncs
        bus.load.take(batch.rows)
        return bus.health.has_gap

    def tick(self, now_s: float) -> None:
        """Do all that is due at `now_s`, except SYNC and measurements: most of it each `TICK_S`."""
        for bus in self._buses.values():
            bus.outgoing.tick(now_s)
        if now_s < self._tick_s:
            return
        self._tick_s = now_s + TICK_S
        for bus in self._buses.values():
            bus.master.tick(now_s)
            self._trust(bus)
            if bus.master.strangers.tick(now_s):
                self._say(f"another SYNC producer on {bus.name}: {bus.master.strangers.words} [other-sync]")
        self.gathering.tick(now_s)
        if self._patience_s is None:
            self._patience_s = now_s + BOOT_PATIENCE_S
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
        sync_ns = round(due_s * 1e9)
        begun = Sync(self.sync.sent, self.sync.counter, sync_ns, round(now_s * 1e9), wall_offset_ns)
        closed = self.gathering.begin(begun)
        for node in self.gathering.doubled():
            self.masters[node.bus].nodes[node.node_id].take_twice(now_s)
            self._trust(self._buses[node.bus])
        sync = sync_frame(self.sync.counter)
        # The due time: on a virtual bus a late turn of the loop adds no jitter to SYNC.
        sync["time_ns"] = sync_ns
        sync["expires_ns"] = sync_ns + round(LATEST * self.sync.period_s * 1e9)
        for bus in self._buses.values():
            bus.watch.count_sync(is_taken=bool(bus.send(sync)))
        self._send_time(now_s, wall_offset_ns)
        return closed

    def measurements(self, now_s: float, wall_offset_ns: int = 0) -> list[Measurement]:
        """Return the measurements that are due."""
        return self.gathering.measurements(now_s, wall_offset_ns)

    def _send_time(self, now_s: float, wall_offset_ns: int) -> None:
        """Send TIME if it is due. After SYNC: SYNC never waits for it."""
        if self._time_period_s is None or now_s < self._time_due_s:
            return
        self._time_due_s = now_s + self._time_period_s - self.sync.period_s / 2
        for bus in self._buses.values():
            bus.send(time_frame(round(now_s * 1e9) + wall_offset_ns))

    def stop(self) -> None:
        """Command all nodes to PRE-OPERATIONAL."""
        for bus in self._buses.values():
            bus.master.stop()

    def flush(self) -> bool:
        """Send all that waits, without room for SYNC; tell whether frames still wait."""
        return sum(bus.outgoing.flush(most=sys.maxsize) for bus in self._buses.values()) > 0

    def status(self, links: Mapping[int, tuple[State, int]], now_s: float) -> GatewayStatus:
        """Return all counters.

        Parameters
        ----------
        links : mapping of int to (State, int)
            By number of the bus: state of the gateway's controller, and frames that its receive side lost.
        """
        return GatewayStatus(
            time_ns=time.time_ns(),
            cycles=self.gathering.published,
            cycles_complete=self.gathering.complete,
            frames=self.gathering.counts,
            sync_rate_hz=self.sync.rate_hz(now_s),
            buses=[self._bus_state(number, *links[number], now_s) for number in self._numbers],
            syncs_skipped=self.sync.skipped,
            heartbeat_limit_s=SILENT_AFTER_S,
            answer_limit_s=TIMEOUT_S,
        )

    def report_links(self, links: Mapping[int, Link], now_s: float) -> None:
        """Tell what has happened to the links since the last call; for `status`, too."""
        for number, link in links.items():
            self._buses[number].watch.report(link.explain, now_s)

    def _bus(self, number: int, send: Send, now_s: float, *, has_echoes: bool) -> _Bus:
        wires = self._contract.layout.bus[number]
        outgoing, watch = Outgoing(send, now_s, has_echoes=has_echoes), LinkWatch(wires.name, self._say)
        trusts: list[tuple[NodeContract, bool]] = []
        master = NmtMaster(self._contract, number, outgoing.put, lambda *found: trusts.append(found), self._say)
        places = [place for place, node in enumerate(self._contract.nodes) if node.bus == number]
        return _Bus(
            wires.name,
            send,
            master,
            outgoing,
            watch,
            LoadMeter(wires, now_s, self._busy_ns[number : number + 1]),
            places,
            trusts,
        )

    def _trust(self, bus: _Bus) -> None:
        """Tell the gathering what the master of a bus has found."""
        for node, proven in bus.trusts:
            self.gathering.trust(node, proven=proven)
        bus.trusts.clear()

    def _start_sync(self, now_s: float) -> None:
        self.sync.start(now_s + SETTLE_S)
        for bus in self._buses.values():
            bus.load.restart(now_s + SETTLE_S)
            awaited = bus.master.awaited
            optional = [each for each in awaited if bus.master.nodes[each].contract.is_optional]
            absent = [each for each in awaited if each not in optional]
            if optional:
                self._say(f"{bus.name}: starts without optional nodes {ranges_text(optional)}")
            if absent:
                self._say(f"{bus.name}: no answer yet from node{'s' * (len(absent) > 1)} {ranges_text(absent)}")
                bus.send(anybody_without_node_id())
                bus.asked_until_s = now_s + UNNUMBERED_S

    def _look_after_nodes(self, now_s: float) -> None:
        """Report emergencies and foreign SYNCs, and let the gathering look at the nodes."""
        for line in self.gathering.look({number: bus.master.nmt for number, bus in self._buses.items()}):
            self._complain(line)
        for bus in self._buses.values():
            for node_id, code in bus.master.emergencies:
                self._complain(f"EMCY {code:04X}h from node {node_id} on {bus.name} [node-emergency]")
            bus.master.emergencies.clear()
            strangers = bus.master.strangers
            if bus.other_syncs:
                bus.other_syncs, bus.other_sync_s = 0, now_s
                lost = self.gathering.disturbance
                self._complain(f"another SYNC producer on {bus.name}: {lost}; {strangers.words} [other-sync]")
                strangers.find_producers(now_s)

    def _bus_state(self, number: int, state: State, dropped: int, now_s: float) -> BusState:
        bus = self._buses[number]
        nodes, wall_s = bus.master.nodes.values(), time.time() - now_s
        missing, late = zip(*(self.gathering.frames_of(place) for place in bus.places), strict=True)
        return BusState(
            name=bus.name,
            load_ratio=bus.load.take_ratio(now_s),
            mean_load_ratio=bus.load.mean_ratio(now_s),
            nodes=bus.master.node_ids,
            nmt=bus.master.nmt.tobytes(),
            missing=list(missing),
            late=list(late),
            emcy=bus.master.emcy,
            refused=bus.master.refused,
            link=max(state, bus.watch.state).name.lower(),
            trouble=bus.watch.trouble,
            overrun=dropped,
            faults=bus.master.faults,
            out_s={node.contract.node_id: now_s - node.lost_s for node in nodes if node.lost_s is not None},
            answer_s=[node.answer_s.of(now_s) for node in nodes],
            heartbeat_s=[node.heartbeat_s.of(now_s) for node in nodes],
            emergencies=[
                NodeEmergency(node.contract.node_id, code, round(1e9 * (wall_s + at_s)))
                for node in nodes
                for code, at_s in node.emergencies
            ],
            other_sync=bus.master.strangers.words if now_s - bus.other_sync_s < OTHER_SYNC_S else "",
        )
