"""Synchronous sums: one measurement for each SYNC, when its cycle is settled or out of time."""

from collections import deque
from collections.abc import Collection, Mapping
from operator import mul
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import CycleMeasurement, FrameCounts, Measurement
from dbc.canopen import NmtState
from dbc.configuration import READ_S
from dbc.contract import Contract, NodeContract
from gateway.batch import Batch
from gateway.collector import Collector
from gateway.gathering import Health, Sync
from gateway.open_cycles import slot_of

#: Frames of a bus that may wait unread: receive buffers hold twice as many.
MOST_UNREAD: Final = 64
#: A cycle ends at the latest this part of a period after the next SYNC was due.
GRACE: Final = 0.9
#: Changes of `_stuffing`, at each look at a cycle that should be whole, and at its end: four cycles take five looks.
STUFFING_UP, STUFFING_DOWN = 0.04, 0.01


class CycleGathering:
    """Gathers the sums of the open cycles.

    Parameters
    ----------
    early_echoes : collection of int
        See `gateway.collector.Collector`.

    Attributes
    ----------
    collector : Collector
    turn : callable
        That of the collector.
    """

    #: Time between two looks at the measurements in a replay; None: they are due by frames and SYNCs alone.
    replay_step_ns = None
    #: What another SYNC producer does to the sums of its bus.
    disturbance = "its cycles are not valid"

    def __init__(self, contract: Contract, early_echoes: Collection[int] = ()) -> None:
        self.collector = Collector(contract, early_echoes)
        self.turn = self.collector.turn
        self.published = self.complete = 0
        self._contract = contract
        self._period_s = contract.layout.sync.period_s
        self._place = {(node.bus, node.node_id): place for place, node in enumerate(contract.nodes)}
        self._open_cycles: deque[Sync] = deque()
        self._unproven = set(range(len(contract.nodes)))
        buses = range(len(contract.layout.bus))
        #: By bus: the least and the most time of a TPDO.
        self._frame_s = [(contract.shortest_s(bus), contract.longest_ns(bus) * 1e-9) for bus in buses]
        self._most_unread_s = MOST_UNREAD * min(most_s for _, most_s in self._frame_s)
        #: What frames take beyond the least time, as a part of the most stuff bits; learnt.
        self._stuffing = 0.0
        self._has_stamps = [False] * len(buses)
        #: When the newest cycle should be whole, and when frames were read.
        self._whole_s = self._looked_s = float("-inf")

    @property
    def may_sleep_until_s(self) -> float:
        """Until when frames may wait unread: until a cycle is whole, and then for `READ_S`.

        While a node is not proven, frames are answers, and the next question waits for them. The times of frames
        without stamps are those of the read.
        """
        if len(self._open_cycles) > 1 or self._unproven or not all(self._has_stamps):
            return float("-inf")
        return min(self._whole_s, self._looked_s + self._most_unread_s)

    @property
    def counts(self) -> FrameCounts:
        """What became of the frames."""
        return self.collector.counts

    @property
    def in_flight(self) -> int:
        """Number of open cycles."""
        return len(self._open_cycles)

    @property
    def due_s(self) -> float:
        """When the oldest cycle must be closed."""
        return self._closes_s(self._open_cycles[0]) if self._open_cycles else float("inf")

    def trust(self, node: NodeContract, *, proven: bool) -> None:
        """Use the sums of a node from the next cycle on if `proven`; else stop at once."""
        place = self._place[node.bus, node.node_id]
        self.collector.trust(slice(node.block, node.block + node.blocks), proven=proven)
        (self._unproven.discard if proven else self._unproven.add)(place)
        if proven:
            self.collector.expected[place] = True

    def take(self, batch: Batch, health: Health, _now_s: float) -> None:
        """Use the frames that arrived on a bus, in bus order."""
        if health.has_gap:
            self.collector.lost(batch.bus)
        self.collector.take(batch, health.stamp_error_ns)
        self._has_stamps[batch.bus] = health.stamp_error_ns is not None

    def begin(self, sync: Sync) -> list[Measurement]:
        """Open the cycle of a SYNC; return the measurements of cycles closed for it."""
        closed = []
        slot = slot_of(sync.counter)
        while any(slot_of(each.counter) == slot for each in self._open_cycles):
            closed.append(self._close(self._open_cycles.popleft()))
        self.collector.open(sync.counter, sync.due_ns, sync.sent_ns)
        self._open_cycles.append(sync)
        if sync.sent_ns is not None:
            waiting = self.collector.waiting(sync.counter).tolist()
            frame_s = (least_s + self._stuffing * (most_s - least_s) for least_s, most_s in self._frame_s)
            self._looked_s = sync.sent_ns * 1e-9
            self._whole_s = self._looked_s + max(map(mul, waiting, frame_s))
        return closed

    def tick(self, now_s: float) -> None:
        """Do nothing: cycles end by frames and time alone."""

    def measurements(self, now_s: float, _wall_offset_ns: int) -> list[Measurement]:
        """End the cycles that are settled or out of time; return their measurements."""
        closed, self._looked_s = [], now_s
        while self._open_cycles:
            oldest = self._open_cycles[0]
            if not self.collector.is_settled(oldest.counter) and now_s < self._closes_s(oldest):
                if now_s >= self._whole_s:
                    self._stuffing = min(1.0, self._stuffing + STUFFING_UP)
                break
            closed.append(self._close(self._open_cycles.popleft()))
            self._stuffing = max(0.0, self._stuffing - STUFFING_DOWN)
            if not self._open_cycles:
                self._whole_s = now_s + READ_S
        return closed

    def look(self, nmt: Mapping[int, npt.NDArray[np.uint8]]) -> list[str]:
        """Let cycles wait for operational nodes only."""
        for bus, states in nmt.items():
            places = [self._place[bus, node.node_id] for node in self._contract.on_bus(bus)]
            # A node that sends sums is operational, whatever state its last heartbeat had.
            self.collector.expected[places] = (states == NmtState.OPERATIONAL) | self.collector.heard[places]
        self.collector.heard[:] = False
        return []

    def doubled(self) -> list[NodeContract]:
        """Return the nodes of which a frame has come twice with other sums since the last call."""
        nodes = [self._contract.nodes[place] for place in np.flatnonzero(self.collector.twice).tolist()]
        self.collector.twice[:] = False
        return nodes

    def frames_of(self, place: int) -> tuple[int, int]:
        """Return how many frames of the node at `place` were missing, and late."""
        return int(self.collector.missing_of_node[place]), int(self.collector.late_of_node[place])

    def _closes_s(self, sync: Sync) -> float:
        return sync.due_s + (1 + GRACE) * self._period_s

    def _close(self, sync: Sync) -> Measurement:
        gathered = self.collector.close(sync.counter)
        times = gathered.times
        self.published += 1
        self.complete += gathered.complete
        return CycleMeasurement(
            cycle=sync.number,
            sync_counter=sync.counter,
            sampled_mono_ns=times.mono_ns,
            sampled_error_ns=times.error_ns,
            sent_mono_ns=times.sent_mono_ns,
            wall_offset_ns=sync.wall_offset_ns,
            bus_sampled_ns=times.bus_ns.astype("<i8", copy=False).tobytes(),
            sums=gathered.sums.astype("<i4").tobytes(),
            valid=gathered.valid.astype(np.uint8).tobytes(),
            fingerprint=self._contract.phi.fingerprint,
            usable=self._contract.packing.usable(gathered.sums),
        )
