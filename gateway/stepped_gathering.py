"""Steps: the newest value of every sum, measured whenever frames have come, and at a least rate."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import UNKNOWN_ERROR_NS, FrameCounts, Measurement, SteppedMeasurement
from dbc.configuration import READ_S
from dbc.contract import Contract, NodeContract
from dbc.frame import frames
from dbc.patch_filter import SAMPLE_NS
from dbc.steps import LATE_SLOTS
from gateway.batch import Batch, batch_of
from gateway.block_states import judge, new_states
from gateway.gathering import Health, Sync
from gateway.nmt_master import NmtMaster
from gateway.stepped_state import COUNTED, NEVER_NS, forget, new_sums, slots_of, take_all, take_turn
from gateway.sum_requests import SumRequests
from shell.compiled import Held, hold

#: Measurements in a second, with news and at least; the limits of other rates.
RATES_HZ: Final = (250.0, 10.0)
RATE_MAX_HZ: Final = 1000.0
RATE_MIN_HZ: Final = 1.0
#: Boards near a touch send one after the other in each slot, and rest then: a measurement is made this long after the
#: newest frame. For that it comes at most `SOONER_S` sooner than the highest rate asks, or `LATER_S` later; both count
#: from when the one before was due, if its turn was late by at most `LATE_S`.
AFTER_NEWEST_S: Final = 0.0005
SOONER_S: Final = 0.0003
LATER_S: Final = 0.0001
LATE_S: Final = 0.001
#: Longest time for which frames wait unread: a request for a missing group waits for its turn, too.
REST_MAX_S: Final = 0.02


@dataclass
class _Bus:
    """One bus: its blocks and parts."""

    blocks: slice
    parts: slice
    sum_requests: SumRequests
    #: Blocks whose proof has just ended: used from the next frames on.
    newly_proven: set[int]
    #: When the newest frame ended that is in the sums, 0 before the first.
    newest_ns: int = 0
    is_down: bool = False


def publishing_rates(max_hz: float | None, min_hz: float | None) -> tuple[float, float]:
    """Return the most and the least measurements in a second; None stands for the default of `RATES_HZ`.

    Raise InputError if a rate is out of range, or the least exceeds the most.
    """
    most_hz = RATES_HZ[0] if max_hz is None else max_hz
    least_hz = min(RATES_HZ[1], most_hz) if min_hz is None else min_hz
    if not RATE_MIN_HZ <= most_hz <= RATE_MAX_HZ:
        raise InputError(f"--max-rate: expected {RATE_MIN_HZ:g} to {RATE_MAX_HZ:g} Hz, got {most_hz:g}")
    if not RATE_MIN_HZ <= least_hz <= most_hz:
        raise InputError(f"--min-rate: expected {RATE_MIN_HZ:g} to {most_hz:g} Hz (the highest rate), got {least_hz:g}")
    return most_hz, least_hz


class SteppedGathering:
    """Holds the newest value of every sum, and says how each block stands.

    A node's frames are used from its proof on. When the node is doubted, its sums are forgotten at once. Where another
    SYNC producer has the nodes count other slots, words of a bus prove nothing until all sums have come again.

    Parameters
    ----------
    masters : mapping of int to NmtMaster
        By number of the bus: they ask nodes for sums that are missing.
    rates_hz : tuple of float
        Most measurements in a second, when there is news, and least, see `publishing_rates`.
    """

    #: See `gateway.cycle_gathering.CycleGathering`.
    in_flight = 0
    replay_step_ns = 10_000_000
    disturbance = "its blocks are not valid until all sums have come again"

    def __init__(
        self,
        contract: Contract,
        masters: Mapping[int, NmtMaster],
        now_s: float,
        rates_hz: tuple[float, float] = RATES_HZ,
    ) -> None:
        self._shortest_s, self._longest_s = (1 / rate_hz for rate_hz in rates_hz)
        self.published = self.complete = 0
        self._contract, self._table = contract, contract.parts
        self._state = new_sums(contract)
        self._all_missing = self._state.missing.copy()
        self._told_different = self._state.different.copy()
        self._counts_per_unit = contract.unit_n / contract.layout.taxels.newton_per_count
        self._is_proven = np.zeros(contract.phi.blocks, np.bool_)
        self._known = hold((self._is_proven, slots_of(contract), self._table, self._state))
        self._shown = new_states(contract, round(now_s * 1e9))
        self._noise_n = np.full(contract.phi.blocks, np.nan)
        self._median_n = 0.0
        self._buses = {number: self._bus(number, master) for number, master in masters.items()}
        self._counter = 0
        self._news = np.zeros((len(contract.layout.bus), 3), np.int64)
        #: When the newest frame ended that is in the sums; before the first, the start.
        self._newest_ns = round(now_s * 1e9)
        #: Bound of the age of its sample, with the error of its time stamp.
        self._newest_error_ns = UNKNOWN_ERROR_NS
        self._published_s, self._has_news = now_s, False
        #: When the next measurement comes; not before `_earliest_s`, so that hardly more come than are asked for.
        self._next_s = self._earliest_s = now_s
        # What runs for each frame is compiled before the first comes.
        self.take(batch_of(frames(0), next(iter(masters)), self._table), Health(), now_s)
        self._judge(now_s)

    @property
    def counts(self) -> FrameCounts:
        """What became of the frames."""
        counted = dict(zip(COUNTED, self._state.counts.tolist(), strict=True))
        return FrameCounts(**counted, different=int(self._state.different.sum()))

    @property
    def due_s(self) -> float:
        """When the next measurement is due: soon after news, else at the least rate."""
        return self._next_s if self._has_news else self._published_s + self._longest_s

    @property
    def may_sleep_until_s(self) -> float:
        """Until when frames may wait unread: no measurement is made before.

        While a node is not proven, frames are answers and the next question waits for them: then for `READ_S`.
        """
        if not self._is_proven.all():
            return self._published_s + READ_S
        return min(self._next_s, self._published_s + REST_MAX_S)

    def trust(self, node: NodeContract, *, proven: bool) -> None:
        """Use a node's frames that come from now on if `proven`; else forget its sums at once."""
        bus = self._buses[node.bus]
        if proven:
            bus.newly_proven.add(node.block)
            return
        bus.newly_proven.discard(node.block)
        bus.sum_requests.lost(node.block - bus.blocks.start)
        self._is_proven[node.block] = False
        self._forget(node.block)

    def take(self, batch: Batch, health: Health, now_s: float) -> None:
        """Use the frames that arrived on a bus, in bus order.

        Frames before the end of a node's proof are not used, nor those that came together with it.
        """
        mine, state = self._buses[batch.bus], self._state
        self._note(mine, *take_all(batch, self._known), health.stamp_error_ns)
        self._has_news |= health.is_down != mine.is_down
        if batch.other_syncs:
            self._has_news = True
            state.missing[mine.parts] = self._all_missing[mine.parts]
        mine.is_down = health.is_down
        if health.has_gap:  # the words after the gap tell of a loss, but boards at rest say nothing for long
            state.is_late[mine.parts] = True
        if health.has_returned:
            mine.sum_requests.again()
        self._use_proven(mine, now_s)

    def turn(self, rest_ns: int, wait_ns: int, turn: Held) -> int:
        """Wait for frames and use those of calm buses, see `gateway.turn`; return how many buses are not calm."""
        restless = take_turn(rest_ns, wait_ns, self._known, turn, self._news)
        for bus, news in enumerate(self._news.tolist()):
            if news[0] > NEVER_NS:
                self._note(self._buses[bus], *news)
        return restless

    def _note(self, bus: _Bus, newest_ns: int, taken_ns: int, stamp_error_ns: int | None) -> None:
        """Take note of the newest frame that came on a bus."""
        bus.newest_ns = max(bus.newest_ns, newest_ns)
        if newest_ns > self._newest_ns:
            self._newest_ns = newest_ns
            error_ns = stamp_error_ns
            self._newest_error_ns = UNKNOWN_ERROR_NS if error_ns is None else taken_ns + SAMPLE_NS + error_ns
        self._has_news |= newest_ns > NEVER_NS

    def begin(self, sync: Sync) -> list[Measurement]:
        """Take note of a SYNC."""
        self._counter = sync.counter
        return []

    def tick(self, now_s: float) -> None:
        """Ask nodes for sums that are missing, and for their noise."""
        for bus in self._buses.values():
            self._use_proven(bus, now_s)
            if not bus.is_down:
                bus.sum_requests.tick(now_s, self._shown.is_wanted[bus.blocks])

    def measurements(self, now_s: float, wall_offset_ns: int) -> list[Measurement]:
        """Return the measurement that is due, if one is."""
        return [self.measure(now_s, wall_offset_ns)] if now_s >= self.due_s else []

    def measure(self, now_s: float, wall_offset_ns: int) -> SteppedMeasurement:
        """Return a measurement, due or not."""
        self._published_s, self._has_news = now_s, False
        self._earliest_s = max(self._earliest_s, now_s - 2 * self._shortest_s) + self._shortest_s
        sooner_s = min(max(now_s - 1e-9 * self._newest_ns - AFTER_NEWEST_S, -LATER_S), SOONER_S)
        due_s = max(self._next_s, now_s - LATE_S)
        self._next_s = max(self._earliest_s, due_s + self._shortest_s - sooner_s)
        self._judge(now_s)
        shown = self._shown
        self.published += 1
        self.complete += bool(shown.valid[self._contract.needed].all())
        return SteppedMeasurement(
            cycle=self.published,
            sync_counter=self._counter,
            sampled_mono_ns=self._newest_ns,
            sampled_error_ns=self._newest_error_ns,
            wall_offset_ns=wall_offset_ns,
            bus_sampled_ns=np.array([bus.newest_ns for bus in self._buses.values()], "<i8").tobytes(),
            sums=shown.sums.astype("<i4", copy=False).tobytes(),
            valid=shown.valid.tobytes(),
            fingerprint=self._contract.phi.fingerprint,
            known=shown.known.tobytes(),
            states=shown.states.tobytes(),
            since_ns=shown.since_ns.astype("<i8", copy=False).tobytes(),
            noise_n=self._median_n,
        )

    def look(self, nmt: Mapping[int, npt.NDArray[np.uint8]]) -> list[str]:  # noqa: ARG002  a node may be silent
        """Return which nodes have checked their sums, and have others than the gateway."""
        parts = np.flatnonzero(self._state.different > self._told_different)
        self._told_different = self._state.different.copy()
        nodes = [self._contract.nodes[block] for block in np.unique(self._table.block[parts]).tolist()]
        names = [f"node {node.node_id} on {self._contract.layout.bus[node.bus].name}" for node in nodes]
        return [f"{name} has other sums than the gateway: all are asked for" for name in names]

    def doubled(self) -> list[NodeContract]:
        """Return no node: words with equal slots may differ, and be of one node."""
        return []

    def frames_of(self, _place: int) -> tuple[int, int]:
        """Return zeros: no frame is due at a time."""
        return 0, 0

    def _bus(self, number: int, master: NmtMaster) -> _Bus:
        layout = self._contract.layout
        first = layout.first_block(number)
        blocks = slice(first, first + len(master.node_ids))

        def take_noise(node: int, noise_n: float) -> None:
            self._noise_n[first + node] = noise_n
            self._median_n = float(np.nanmedian(self._noise_n))

        told = LATE_SLOTS + max(form.groups for form in self._contract.forms_of(number))
        return _Bus(
            blocks=blocks,
            parts=slice(*np.searchsorted(self._table.block, (blocks.start, blocks.stop)).tolist()),
            sum_requests=SumRequests(master, take_noise, told * layout.steps.slot_s, layout.sync.period_s),
            newly_proven=set(),
        )

    def _use_proven(self, bus: _Bus, now_s: float) -> None:
        for block in bus.newly_proven:
            self._forget(block)
            self._is_proven[block] = True
            bus.sum_requests.proven(block - bus.blocks.start, now_s)
        bus.newly_proven.clear()

    def _forget(self, block: int) -> None:
        for part in np.flatnonzero(self._table.block == block).tolist():
            forget(part, self._table, self._state)
        self._has_news = True

    def _judge(self, now_s: float) -> None:
        judge(round(now_s * 1e9), self._counts_per_unit, self._known, self._shown)
