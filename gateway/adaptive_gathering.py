"""Adaptive sums: the newest value of every sum, measured whenever frames have come, and at a least rate."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from canskin.errors import InputError
from canskin.messages import UNKNOWN_ERROR_NS, AdaptiveMeasurement, FrameCounts, Measurement
from dbc.adaptive import PAUSE_MS, column_of
from dbc.configuration import READ_S
from dbc.contract import Contract, NodeContract, sample_age_ns
from dbc.frame import Frames, frame_bytes, frames
from gateway.adaptive_state import (
    FOREIGN,
    FOREIGN_SYNCS,
    MALFORMED,
    NEVER_NS,
    UNPROVEN,
    UNREFINED,
    USED,
    BusSums,
    Flags,
    forget_node,
    new_sums,
    take_all,
)
from gateway.block_states import judge, new_states
from gateway.gathering import Health, Sync
from gateway.nmt_master import NmtMaster
from gateway.sum_requests import SumRequests

#: Measurements in a second, with news and at least; the limits of other rates.
RATES_HZ: Final = (1000.0, 10.0)
RATE_MAX_HZ: Final = 1000.0
RATE_MIN_HZ: Final = 1.0
#: Longest time for which frames wait unread: a request for a missing group waits for its turn, too.
REST_MAX_S: Final = 0.02


@dataclass
class _Bus:
    """One bus: its nodes' blocks, and views of what is held of them."""

    is_fd: bool
    sample_age_ns: int
    blocks: slice
    sums: BusSums
    is_proven: Flags
    has_changed: Flags
    sum_requests: SumRequests
    #: Nodes whose proof has just ended, by place: used from the next frames on.
    newly_proven: set[int]
    #: When the newest frame ended that is in the sums, 0 before the first.
    newest_ns: int = 0
    foreign_syncs: int = 0
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


class AdaptiveGathering:
    """Holds the newest value of every sum, and says how each block stands.

    A node's frames are used from its proof on. When the node is doubted, its sums are forgotten at once.

    Parameters
    ----------
    masters : mapping of int to NmtMaster
        By number of the bus: they ask nodes for groups that are missing.
    rates_hz : tuple of float
        Most measurements in a second, when there is news, and least, see `publishing_rates`.
    """

    #: See `gateway.cycle_gathering.CycleGathering`.
    in_flight = 0
    replay_step_ns = 10_000_000
    disturbance = f"no sums start in the {PAUSE_MS} ms after each SYNC"

    def __init__(
        self,
        contract: Contract,
        masters: Mapping[int, NmtMaster],
        now_s: float,
        rates_hz: tuple[float, float] = RATES_HZ,
    ) -> None:
        self._shortest_s, self._longest_s = (1 / rate_hz for rate_hz in rates_hz)
        self.published = self.complete = 0
        self._law = contract.law
        self._newton_per_count = contract.layout.taxels.newton_per_count
        self._fingerprint = contract.phi.fingerprint
        blocks = contract.phi.blocks
        self._sums = new_sums(blocks, contract.layout.groups)
        self._is_proven = np.zeros(blocks, np.bool_)
        self._has_changed = np.zeros((blocks, contract.layout.groups), np.bool_)
        self._shown = new_states(blocks, contract.layout.groups, round(now_s * 1e9))
        self._noise_n = np.full(blocks, np.nan)
        self._median_n = 0.0
        self._buses = {number: self._bus(contract, number, master) for number, master in masters.items()}
        self._counter = 0
        #: When the newest frame ended that is in the sums; before the first, the start.
        self._newest_ns = round(now_s * 1e9)
        #: Bound of the age of its sample, with the error of its time stamp.
        self._newest_error_ns = UNKNOWN_ERROR_NS
        self._published_s, self._has_news = now_s, False
        self._compile()

    @property
    def counts(self) -> FrameCounts:
        """What became of the frames."""
        total = np.sum([bus.sums.counts for bus in self._buses.values()], axis=0).tolist()
        return FrameCounts(
            accepted=total[USED],
            malformed=total[MALFORMED],
            unrefined=total[UNREFINED],
            unproven=total[UNPROVEN],
            foreign=total[FOREIGN],
        )

    @property
    def due_s(self) -> float:
        """When the next measurement is due: soon after news, else at the least rate."""
        return self._published_s + (self._shortest_s if self._has_news else self._longest_s)

    @property
    def may_sleep_until_s(self) -> float:
        """Until when frames may wait unread: no measurement is made before.

        While a node is not proven, frames are answers and the next question waits for them: then for `READ_S`.
        """
        rest_s = min(self._shortest_s, REST_MAX_S) if self._is_proven.all() else READ_S
        return self._published_s + rest_s

    def trust(self, node: NodeContract, *, proven: bool) -> None:
        """Use a node's frames that come from now on if `proven`; else forget its sums at once."""
        bus = self._buses[node.bus]
        place = node.block - bus.blocks.start
        if proven:
            bus.newly_proven.add(place)
            return
        bus.newly_proven.discard(place)
        bus.sum_requests.lost(place)
        bus.is_proven[place] = False
        self._forget(bus, place)

    def take(self, bus: int, arrived: Frames, health: Health, now_s: float) -> None:
        """Use the frames that arrived on a bus, in bus order.

        Frames before the end of a node's proof are not used, nor those that came together with it.
        """
        mine = self._buses[bus]
        rows = frame_bytes(arrived)
        parts = self._law, mine.is_proven, mine.sums, mine.has_changed, mine.is_fd
        newest_ns = take_all(rows, health.has_gap, *parts)
        mine.newest_ns = max(mine.newest_ns, newest_ns)
        if newest_ns > self._newest_ns:
            stamp_error_ns = health.stamp_error_ns
            self._newest_ns = newest_ns
            self._newest_error_ns = UNKNOWN_ERROR_NS if stamp_error_ns is None else mine.sample_age_ns + stamp_error_ns
        is_still_down = health.is_down and mine.is_down
        self._has_news |= newest_ns > NEVER_NS or (health.has_gap and not is_still_down)
        mine.is_down = health.is_down
        if health.has_gap:
            mine.sum_requests.gap()
        if health.has_returned:
            mine.sum_requests.again()
        self._use_proven(mine, now_s)

    def begin(self, sync: Sync) -> list[Measurement]:
        """Take note of a SYNC."""
        self._counter = sync.counter
        return []

    def tick(self, now_s: float) -> None:
        """Ask nodes for groups that are missing, and for their noise."""
        for bus in self._buses.values():
            self._use_proven(bus, now_s)
            if not bus.is_down:
                bus.sum_requests.tick(now_s, self._shown.unknown[bus.blocks], self._shown.doubtful[bus.blocks])

    def measurements(self, now_s: float, wall_offset_ns: int) -> list[Measurement]:
        """Return the measurement that is due, if one is."""
        if now_s < self.due_s:
            return []
        self._published_s, self._has_news = now_s, False
        self._judge(now_s)
        shown = self._shown
        self.published += 1
        self.complete += bool(shown.valid.all())
        return [
            AdaptiveMeasurement(
                cycle=self.published,
                sync_counter=self._counter,
                sampled_mono_ns=self._newest_ns,
                sampled_error_ns=self._newest_error_ns,
                wall_offset_ns=wall_offset_ns,
                bus_sampled_ns=np.array([bus.newest_ns for bus in self._buses.values()], "<i8").tobytes(),
                sums=shown.sums.astype("<i4", copy=False).tobytes(),
                valid=shown.valid.tobytes(),
                fingerprint=self._fingerprint,
                known=shown.known.tobytes(),
                states=shown.states.tobytes(),
                since_ns=shown.since_ns.astype("<i8", copy=False).tobytes(),
                noise_n=self._median_n,
            )
        ]

    def look(self, masters: Mapping[int, NmtMaster]) -> None:
        """Do nothing: a node that is alive may be silent."""

    def take_foreign_syncs(self, bus: int) -> int:
        """Return the number of foreign SYNCs on a bus since the last call."""
        mine = self._buses[bus]
        before, mine.foreign_syncs = mine.foreign_syncs, int(mine.sums.counts[FOREIGN_SYNCS])
        return mine.foreign_syncs - before

    def missing_and_late(self, _place: int) -> tuple[int, int]:
        """Return 0 and 0: no frame is due at a time."""
        return 0, 0

    def _bus(self, contract: Contract, number: int, master: NmtMaster) -> _Bus:
        line, first = contract.layout.bus[number], contract.layout.first_block(number)
        blocks = slice(first, first + len(master.node_ids))

        def take_noise(node: int, noise_n: float) -> None:
            self._noise_n[first + node] = noise_n
            self._median_n = float(np.nanmedian(self._noise_n))

        return _Bus(
            is_fd=line.fd,
            sample_age_ns=sample_age_ns(line, contract.layout.groups),
            blocks=blocks,
            sums=self._sums.of(blocks, [column_of(each, contract.layout.groups, is_fd=line.fd) for each in line.ids]),
            is_proven=self._is_proven[blocks],
            has_changed=self._has_changed[blocks],
            sum_requests=SumRequests(master, take_noise),
            newly_proven=set(),
        )

    def _use_proven(self, bus: _Bus, now_s: float) -> None:
        for place in bus.newly_proven:
            self._forget(bus, place)
            bus.is_proven[place] = True
            bus.sum_requests.proven(place, now_s)
        bus.newly_proven.clear()

    def _forget(self, bus: _Bus, place: int) -> None:
        forget_node(place, bus.sums)
        bus.has_changed[place] = True
        self._has_news = True

    def _judge(self, now_s: float) -> None:
        now_ns = round(now_s * 1e9)
        judge(now_ns, self._newton_per_count, self._is_proven, self._sums, self._has_changed, self._shown)

    def _compile(self) -> None:
        """Compile what runs for each frame before the first comes."""
        rows = frame_bytes(frames(0))
        for bus in self._buses.values():
            take_all(rows, False, self._law, bus.is_proven, bus.sums, bus.has_changed, bus.is_fd)
        self._judge(self._published_s)
