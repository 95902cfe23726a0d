"""32 boards in C and the gateway on a real kernel: whatever SYNCs are lost, a valid block holds its cycle's sums."""

import select
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from bus.link import Link, open_link
from canskin.messages import Measurement
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from gateway.loop import GatewayLoop
from nodes.firmware.library import Firmware
from nodes.segment import Segment
from tests.layouts import small_layout
from tests.nodes.firmware.twins import CountWitness
from tests.vcan.chain import valid

#: Rates, the highest first: a slow guest does not keep the first.
RATES_HZ = (100.0, 50.0, 20.0, 5.0)
#: Cycles of a look, and those that have to be complete at a rate that the machine keeps.
CYCLES, COMPLETE_RATIO = 200, 0.8
LOSS_RATIO = 0.1
#: Longest time until all boards are proven and started.
START_S = 60.0


class Skin:
    """Gateway and boards on their own sockets of vcan0, in one thread; SYNCs are lost to the boards at random."""

    def __init__(self, contract: Contract, links: tuple[Link, Link]) -> None:
        self.contract = contract
        self.links = links
        self.lost = 0
        self.loss_ratio = 0.0
        self.random = np.random.default_rng(5)
        self.measured: list[Measurement] = []
        self.witness = CountWitness(contract)
        boards = Firmware(contract, contract.nodes).boards(0)
        self.boards = Segment(contract, 0, boards, self.witness, links[1].send, complain=print)
        self.boards.boot(time.monotonic())
        self.gateway = GatewayLoop(contract, {0: links[0].send}, time.monotonic(), say=print, complain=print)

    def turn(self) -> None:
        ready, _, _ = select.select(self.links, [], [], 0.001)
        now_s = time.monotonic()
        if self.links[1] in ready:
            self.boards.take(self._without_lost(self.links[1].receive()), now_s)
        if self.links[0] in ready:
            self.gateway.take(0, self.links[0].receive(), now_s, stamp_error_ns=self.links[0].stamp_error_ns)
        self.boards.tick(now_s)
        self.gateway.tick(now_s)
        self.measured += self.gateway.send_sync(time.monotonic())
        self.measured += self.gateway.measurements(time.monotonic())

    def _without_lost(self, arrived: Frames) -> Frames:
        is_sync = (arrived["can_id"] == SYNC_COB_ID) & (arrived["flags"] & ECHO == 0)
        lost = is_sync & (self.random.random(len(arrived)) < self.loss_ratio)
        self.lost += int(lost.sum())
        return arrived[~lost]

    def cycles(self, count: int) -> list[Measurement]:
        first = len(self.measured)
        until_s = time.monotonic() + START_S
        while len(self.measured) < first + count:
            assert time.monotonic() < until_s, f"{len(self.measured) - first} of {count} cycles"
            self.turn()
        return self.measured[first:]

    def sync_of(self, measurement: Measurement, there: np.ndarray, after_ns: int) -> int:
        """Return the time of the SYNC whose counts have the sums of all valid blocks.

        Two SYNCs have the same counts only if a stall of the guest has brought them into the same period.
        """
        known = there[self.contract.phi.block_of_sum]
        sums = np.frombuffer(measurement.sums, "<i4")[known]
        packing = self.contract.packing
        carried = {at_ns: packing.counts(packing.raw(truth)) for at_ns, truth in self.witness.truths.items()}
        found = [at_ns for at_ns, truth in carried.items() if np.array_equal(truth[known], sums)]
        assert found, f"cycle {measurement.cycle}: {there.sum()} valid blocks are of no one cycle"
        assert max(found) - min(found) < 1e9 * self.contract.layout.sync.period_s, f"cycle {measurement.cycle}: {found}"
        later = [time_ns for time_ns in found if time_ns > after_ns]
        assert later, f"cycle {measurement.cycle}: the sums of an earlier cycle"
        return min(later)

    def start(self) -> None:
        until_s = time.monotonic() + START_S
        while not (self.measured and valid(self.measured[-1]).all()):
            assert time.monotonic() < until_s, "no complete cycle"
            self.turn()


@contextmanager
def running(rate_hz: float) -> Iterator[Skin]:
    layout = small_layout(32, 32, sync={"rate_hz": rate_hz})
    links = open_link("socketcan", "vcan0", 1_000_000), open_link("socketcan", "vcan0", 1_000_000)
    try:
        yield Skin(Contract.from_layout(layout), links)
    finally:
        for link in links:
            link.close()


def test_valid_blocks_hold_the_sums_of_their_cycle_though_syncs_are_lost() -> None:
    for rate_hz in RATES_HZ:
        with running(rate_hz) as skin:
            skin.start()
            complete = sum(valid(each).all() for each in skin.cycles(CYCLES)) / CYCLES
            print(f"{rate_hz:g} Hz: {complete:.0%} complete")
            skin.loss_ratio = LOSS_RATIO
            checked, last_ns = 0, 0
            for measurement in skin.cycles(CYCLES):
                there = valid(measurement)
                if there.any():
                    last_ns = skin.sync_of(measurement, there, last_ns)
                    checked += int(there.sum())
            assert skin.lost > 0
            assert checked > 0
            print(f"{rate_hz:g} Hz: {skin.lost} SYNCs lost, {checked} valid blocks right")
        if complete > COMPLETE_RATIO:
            return
    pytest.fail(f"the machine kept none of {RATES_HZ} Hz")
