"""The gateway's loop: SYNC out at absolute times, frames in, one measurement per cycle to the fabric."""

import select
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from bus.link import Link
from dbc.contract import (
    NMT_COB_ID,
    OPERATIONAL,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    Contract,
    NodeContract,
    next_counter,
)
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, frames
from gateway.boot import Boot
from gateway.collector import Collector, Gathered
from gateway.monitor import SILENT, BusMonitor
from gateway.network import MasterNetwork
from skin.fabric import Fabric
from skin.messages import GATEWAY, MEASUREMENT, BusState, GatewayStatus, Measurement
from skin.service import Complaints, StopSignal, be_punctual

STATUS_PERIOD_S: Final = 0.2
#: SYNC starts when every node has been asked, or after this time.
BOOT_PATIENCE_S: Final = 3.0
#: The last node that was started gets this long to be ready.
SETTLE_S: Final = 0.1
#: A cycle is closed this fraction of a period after the next SYNC, if a bus does not show that SYNC.
GRACE: Final = 0.9
NMT_ENTER_PRE_OPERATIONAL: Final = 128


@dataclass(frozen=True)
class _Cycle:
    number: int
    counter: int
    sync_mono_ns: int
    time_ns: int
    closes_s: float


@dataclass(frozen=True)
class _Line:
    """One bus: its link and what is kept about it."""

    link: Link
    network: MasterNetwork
    monitor: BusMonitor
    boot: Boot


class GatewayService:
    """Master of a skin's buses.

    Parameters
    ----------
    contract : Contract
    links : mapping of int to Link
        By number of the bus.
    fabric : Fabric
    """

    def __init__(self, contract: Contract, links: Mapping[int, Link], fabric: Fabric) -> None:
        self.collector = Collector(contract)
        self._contract = contract
        self._fabric = fabric
        self._period_s = contract.layout.sync.period_s
        self._lines = {number: self._line(number, link) for number, link in links.items()}
        self._complaints = Complaints("gateway")
        self._numbers = sorted(self._lines)
        self._places = {
            number: [(place, node) for place, node in enumerate(contract.nodes) if node.bus == number]
            for number in links
        }
        self._flying: deque[_Cycle] = deque()
        self._counter = 0
        self._cycles = self._closed = self._complete = 0
        self._next_sync_s = self._sync_start_s = float("inf")
        self._status_at_s = 0.0

    def run(self, stop: StopSignal) -> None:
        """Boot the nodes, then serve until `stop`; cycles in flight are finished first."""
        for line in self._lines.values():
            line.boot.start()
        be_punctual()
        patience_s = time.monotonic() + BOOT_PATIENCE_S
        while not stop.is_set():
            now_s = self._turn()
            if self._next_sync_s == float("inf"):
                if now_s >= patience_s or all(line.boot.passed for line in self._lines.values()):
                    self._start_sync(now_s)
            elif now_s >= self._next_sync_s:
                self._sync(now_s)
        self._next_sync_s = float("inf")
        while self._flying:
            self._turn()
        self.publish_status()
        for line in self._lines.values():
            line.boot.stop()
            line.network.send_message(NMT_COB_ID, bytes((NMT_ENTER_PRE_OPERATIONAL, 0)))

    def publish_status(self) -> None:
        """Publish all counters."""
        counts = self.collector.counts
        elapsed_s = time.monotonic() - self._sync_start_s
        status = GatewayStatus(
            time_ns=time.time_ns(),
            cycles=self._closed,
            cycles_complete=self._complete,
            frames_received=counts.received,
            frames_accepted=counts.accepted,
            frames_missing=counts.missing,
            frames_late=counts.late,
            frames_duplicate=counts.duplicate,
            frames_malformed=counts.malformed,
            frames_foreign=counts.foreign,
            sync_rate_hz=self._cycles / elapsed_s if elapsed_s > 0 else 0.0,
            buses=[self._bus_state(number) for number in self._numbers],
            mean_load_ratio=[line.monitor.mean_load_ratio for line in self._lines.values()],
        )
        self._fabric.publish(GATEWAY, status)

    def _bus_state(self, number: int) -> BusState:
        places = [place for place, _ in self._places[number]]
        collector = self.collector
        line = self._lines[number]
        return line.monitor.state(
            line.link, collector.missing_of_node[places], collector.late_of_node[places], sorted(line.boot.refused)
        )

    def _line(self, number: int, link: Link) -> _Line:
        network = MasterNetwork(link)
        nodes = self._contract.on_bus(number)
        name = self._contract.layout.bus[number].name
        boot = Boot(name, nodes, self._contract.phi.fingerprint, network, self._trust)
        return _Line(link, network, BusMonitor(self._contract, number, HEARTBEAT_MS / 1000), boot)

    def _trust(self, node: NodeContract, trusted: bool) -> None:
        """Use a node's sums from now on, or no longer."""
        self.collector.trusted[node.block : node.block + node.blocks] = trusted
        if trusted:
            self._lines[node.bus].monitor.started(node.node_id)
            self.collector.expected[self._contract.nodes.index(node)] = True

    def _look_after_nodes(self) -> None:
        """Wait for operational nodes only; ask a node that came back without saying so what it measures."""
        for number, line in self._lines.items():
            nmt = dict(zip(line.monitor.node_ids, line.monitor.nmt, strict=True))
            for place, node in self._places[number]:
                state = nmt[node.node_id]
                # A node that sends sums is operational, whatever its last heartbeat said.
                self.collector.expected[place] = state == OPERATIONAL or self.collector.heard[place]
                trusted = self.collector.trusted[node.block]
                if state == SILENT and trusted:
                    self._trust(node, False)
                elif state != SILENT and not trusted and line.boot.passed and node.node_id not in line.boot.refused:
                    line.boot.ask([node.node_id])
        self.collector.heard[:] = False

    def _turn(self) -> float:
        """Wait for frames until the next thing is due, use them, and close what has settled."""
        now_s = time.monotonic()
        due_s = min(self._next_sync_s, self._status_at_s, self._flying[0].closes_s if self._flying else float("inf"))
        # select() and not epoll: its timeout has microseconds.
        ready, _, _ = select.select(
            [line.link for line in self._lines.values()], [], [], max(0.0, min(due_s - now_s, 0.05))
        )
        for number, line in self._lines.items():
            if line.link in ready:
                self._receive(number, line)
        now_s = time.monotonic()
        while self._flying and (
            self.collector.is_settled(self._flying[0].counter) or now_s >= self._flying[0].closes_s
        ):
            self._publish(self._flying.popleft())
        if now_s >= self._status_at_s:
            self._status_at_s = now_s + STATUS_PERIOD_S
            self._look_after_nodes()
            self.publish_status()
        return now_s

    def _receive(self, number: int, line: _Line) -> None:
        arrived = line.link.receive()
        if not len(arrived):
            return
        self.collector.take(number, arrived)
        line.monitor.take(arrived)
        self._answers(line, arrived)
        for node_id, code in line.monitor.emergencies:
            self._complaints.complain(
                f"EMCY {code:04X}h from node {node_id} on {self._contract.layout.bus[number].name}"
            )
        line.monitor.emergencies.clear()
        if line.monitor.foreign_syncs:
            self._complaints.complain(
                f"another SYNC producer on {self._contract.layout.bus[number].name}: its cycles mix"
            )
            line.monitor.foreign_syncs = 0
        if line.monitor.booted:
            for node in self._contract.on_bus(number):
                if node.node_id in line.monitor.booted:
                    self._trust(node, False)
            line.boot.ask(line.monitor.booted)
            line.monitor.booted.clear()

    @staticmethod
    def _answers(line: _Line, arrived: Frames) -> None:
        """Hand SDO answers to whoever waits for them."""
        plain = arrived["flags"] & (ERROR | ECHO | EXTENDED | REMOTE) == 0
        answer = plain & (arrived["can_id"] > SDO_RESPONSE_BASE) & (arrived["can_id"] <= SDO_RESPONSE_BASE + 127)
        for frame in arrived[answer & (arrived["length"] == 8)]:
            data = bytearray(frame["data"][:8].tobytes())
            line.network.notify(int(frame["can_id"]), data, int(frame["time_ns"]) * 1e-9)

    def _start_sync(self, now_s: float) -> None:
        self._sync_start_s = self._next_sync_s = now_s + SETTLE_S
        for line in self._lines.values():
            line.monitor.restart(self._sync_start_s)

    def _sync(self, now_s: float) -> None:
        """Send the SYNC that is due on every bus and open its cycle."""
        while len(self._flying) > 1:  # the one whose phase comes round again
            self._publish(self._flying.popleft())
        self._counter = next_counter(self._counter) if self._counter else 1
        self._cycles += 1
        self.collector.open(self._counter)
        sync = frames(1)
        sync["can_id"], sync["length"] = SYNC_COB_ID, 1
        sync["data"][0, 0] = self._counter
        # When it was due, so that on a virtual bus a late turn of this loop is no jitter of the SYNC.
        sync["time_ns"] = sync_ns = round(self._next_sync_s * 1e9)
        time_ns = time.time_ns() - time.monotonic_ns() + sync_ns
        for number, line in self._lines.items():
            if not line.network.send_frames(sync):
                name = self._contract.layout.bus[number].name
                self._complaints.complain(f"{name} took no SYNC: its transmit queue is full, or the bus is gone")
        # Absolute deadlines: lateness of one SYNC does not move the next; whole missed periods are skipped.
        self._next_sync_s += self._period_s * max(1, int((now_s - self._next_sync_s) / self._period_s) + 1)
        closes_s = self._next_sync_s + GRACE * self._period_s
        self._flying.append(_Cycle(self._cycles, self._counter, sync_ns, time_ns, closes_s))

    def _publish(self, cycle: _Cycle) -> None:
        gathered: Gathered = self.collector.close(cycle.counter)
        self._closed += 1
        self._complete += gathered.complete
        message = Measurement(
            cycle=cycle.number,
            sync_counter=cycle.counter,
            sync_mono_ns=cycle.sync_mono_ns,
            time_ns=cycle.time_ns,
            sums=gathered.sums.astype("<i4").tobytes(),
            valid=gathered.valid.astype(np.uint8).tobytes(),
            fingerprint=self._contract.phi.fingerprint,
        )
        self._fabric.publish(MEASUREMENT, message)
        # One bus per cycle, now that the burst is over and the loop has time.
        self._lines[self._numbers[self._closed % len(self._numbers)]].monitor.account()
