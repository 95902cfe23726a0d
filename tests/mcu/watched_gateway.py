"""The gateway on an emulated bus; each valid block is compared with what the converters of its board showed."""

import select
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from bus.link import Link
from canskin.messages import Measurement
from dbc.contract import Contract
from gateway.loop import GatewayLoop
from tests.mcu.machine import PATIENCE_S

#: SYNCs that a board may have seen before the first valid block of it.
EARLIER = 4096


class WatchedGateway:
    """A gateway that runs while the test waits for something.

    Attributes
    ----------
    complete, checked : int
        Complete cycles; valid blocks that held the sums of their SYNC.
    """

    def __init__(self, contract: Contract, link: Link) -> None:
        self.contract, self._link = contract, link
        self.complete = self.checked = 0
        self.newest = np.zeros(contract.phi.blocks, np.bool_)
        self._loop = GatewayLoop(contract, {0: link.send}, time.monotonic(), say=print, complain=print)
        self._blocks = [_BlockWatch(contract, block) for block in range(contract.phi.blocks)]

    def run(self, seconds: float) -> None:
        """Run for a while."""
        end_s = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= end_s, "the end")

    def run_until_whole(self) -> None:
        """Run until a cycle is complete."""
        before = self.complete
        self.until(lambda: self.complete > before, "a complete cycle")

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        """Run until something is so."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not is_so():
            assert time.monotonic() < give_up_s, f"waited {PATIENCE_S:g} s for {what}"
            ready, _, _ = select.select([self._link], [], [], 0.002)
            now_s = time.monotonic()
            if ready:
                arrived = self._link.receive()
                self._loop.take(0, arrived, now_s, stamp_error_ns=self._link.stamp_error_ns)
            self._loop.tick(now_s)
            for measurement in [*self._loop.send_sync(time.monotonic()), *self._loop.measurements(time.monotonic())]:
                self._check(measurement)

    def _check(self, measurement: Measurement) -> None:
        self.newest = np.frombuffer(measurement.valid, np.uint8) == 1
        self.complete += bool(self.newest.all())
        sums = np.frombuffer(measurement.sums, "<i4")
        for block in np.flatnonzero(self.newest):
            self._blocks[block].check(sums, measurement)
            self.checked += 1


class PressedGateway(WatchedGateway):
    """The gateway of stepped boards on which a pressure lies, from some seconds after power-up on.

    Attributes
    ----------
    is_pressed : bool
        Whether the newest measurement has the pressure on all blocks.
    """

    def __init__(self, contract: Contract, link: Link) -> None:
        super().__init__(contract, link)
        self.is_pressed = False
        felt = np.zeros(contract.phi.taxels, np.int64)
        for node in contract.nodes:  # ``ports/virt/converters.c``
            felt[contract.phi.taxels_of_blocks[node.block]] = (
                16 * node.node_id * (np.arange(contract.phi.block_size) % 8)
            )
        self._sums = contract.phi.forward(felt)
        is_first = np.diff(contract.phi.block_of_sum, prepend=-1) > 0
        #: Noise of 0 to 3 counts is in the sum of all taxels as a whole, in the others as differences.
        self._allowed = np.where(is_first, 3 * contract.phi.block_size, contract.phi.block_size)

    def _check(self, measurement: Measurement) -> None:
        self.newest = np.frombuffer(measurement.valid, np.uint8) == 1
        self.complete += bool(self.newest.all())
        near = np.abs(np.frombuffer(measurement.sums, "<i4") - self._sums) <= self._allowed
        is_known = self.newest[self.contract.phi.block_of_sum]
        if self.is_pressed:
            assert near[is_known].all(), f"measurement {measurement.cycle}: a valid block has other sums than its board"
            self.checked += int(self.newest.sum())
        self.is_pressed |= bool((near & is_known).all())


class _BlockWatch:
    """What the converters of a block show, and which conversion was seen last."""

    def __init__(self, contract: Contract, block: int) -> None:
        phi = contract.phi
        self._packing = contract.packing
        self._sums = phi.block_of_sum == block
        taxels = phi.taxels_of_blocks[block]
        units = np.eye(phi.taxels, dtype=np.int64)[taxels]
        self._signs = np.array([phi.forward(unit)[self._sums] for unit in units])
        node = next(each for each in contract.nodes if each.block <= block < each.block + each.blocks)
        self._cpu = node.node_id
        self._place = (block - node.block) * phi.block_size
        self._conversion = self._cycle = -1

    def check(self, sums: npt.NDArray[np.int32], measurement: Measurement) -> None:
        """Compare the sums of a valid block with each conversion that may be that of the SYNC."""
        elapsed = measurement.cycle - self._cycle if self._cycle >= 0 else EARLIER
        known = np.arange(elapsed) + self._conversion + 1
        restarted = np.arange(elapsed)  # the board was reset
        candidates = np.concatenate([known, restarted])
        expected = self._shown(candidates, measurement.sync_counter) @ self._signs
        carried = self._packing.counts(self._packing.raw(expected))
        right = np.flatnonzero((carried == sums[self._sums]).all(axis=1))
        assert right.size, f"cycle {measurement.cycle}: a valid block of node {self._cpu} has other sums than its SYNC"
        self._conversion, self._cycle = int(candidates[right[0]]), measurement.cycle

    def _shown(self, conversions: npt.NDArray[np.int64], counter: int) -> npt.NDArray[np.int64]:
        """Return what the taxels of the block show (``ports/virt/converters.c``), shape (conversions, B)."""
        first = _mixed(((conversions * 256 + counter) * 128 + self._cpu).astype(np.uint32))
        places = np.arange(len(self._signs), dtype=np.uint32) + np.uint32(self._place)
        return (_mixed(first[:, None] + places) >> 8 & 1023).astype(np.int64)


def _mixed(numbers: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint32]:
    mixed = (numbers ^ numbers >> np.uint32(15)) * np.uint32(2246822519)
    return mixed ^ mixed >> np.uint32(13)
