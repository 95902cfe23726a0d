"""Stepped nodes on a simulated bus, for plans and comparisons: the decisions of running boards, without a clock."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from bus.polling import poll
from bus.simulated_bus import SimulatedBus
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from dbc.patch_filter import SAMPLE_NS
from nodes.electronics import Calibration
from nodes.steps.filtering import settled_filter
from nodes.steps.sending import Senders
from nodes.steps.sensors import PatchSensors
from nodes.steps.stepping import Numbers
from skin.layout import Layout
from skin.sources import TaxelSource
from skin.sync_counter import SYNC_OVERFLOW
from skin.taxel import TaxelModel

Sums = npt.NDArray[np.float32]
#: Sums of a sample, newtons, and their variances, shape (nodes, sums), and noise of the nodes, shape (nodes,).
Sample = tuple[Sums, Sums, Numbers]


class SimulatedNodes:
    """All nodes of a bus, operational from the beginning, for `bus.polling.poll` in periods of a sample.

    Parameters
    ----------
    sample : callable
        Returns what the filters make of sample number n, which is asked for in order.
    """

    def __init__(self, contract: Contract, bus: int, sample: Callable[[int], Sample]) -> None:
        self._bus, self._sample = bus, sample
        self._sync_samples = _sync_samples(contract.layout)
        self._waiting = frames(0)
        self.senders = Senders(contract)
        for row, node in enumerate(contract.on_bus(bus)):
            self.senders.slots.row[node.block] = row
            self.senders.set_cob_ids(node.block, [tpdo.cob_id for tpdo in node.tpdos])
            self.senders.set_operational(node.block, True)

    def take(self, ended: Frames, unsent: Frames) -> None:
        """Take note of frames that were sent; controllers keep the others."""
        echoes, self._waiting = ended.copy(), unsent
        echoes["flags"] |= ECHO
        self.senders.take_echoes(self._bus, echoes)

    def offer(self, period: int) -> Frames:
        """Return the frames that controllers hold, with those of the slots that have begun since the sample before."""
        known, now_ns = self._sample(period), period * SAMPLE_NS
        number, since = divmod(period, self._sync_samples)
        if since == 0:
            self.senders.take_sync(self._bus, number % SYNC_OVERFLOW + 1, now_ns)
        burst, _ = self.senders.take_slots(now_ns, *known)
        return np.concatenate([self._waiting, burst])


def _sync_samples(layout: Layout) -> int:
    """Return the number of samples from SYNC to SYNC."""
    return round(layout.sync.period_s * 1e9 / SAMPLE_NS)


def sync_frames(layout: Layout, samples: int) -> Frames:
    """Return the SYNCs of a bus with stepped nodes."""
    each = _sync_samples(layout)
    syncs = frames(-(-samples // each))
    number = np.arange(len(syncs))
    syncs["can_id"], syncs["length"], syncs["data"][:, 0] = SYNC_COB_ID, 1, number % SYNC_OVERFLOW + 1
    syncs["time_ns"] = number * each * SAMPLE_NS
    return syncs


def touched_frames(contract: Contract, bus: int, source: TaxelSource, seconds: float, seed: int = 0) -> Frames:
    """Return the frames of sums that the nodes of bus number `bus` send, with the times of their ends.

    Parameters
    ----------
    contract : Contract
        Of a layout with steps.
    source : TaxelSource
        Touch in steps of 10 ms.
    seed : int
        Of noise and clocks.
    """
    calibration, nodes = Calibration(contract.layout.taxels, contract.phi.wired.taxels), contract.on_bus(bus)
    blocks = [node.block for node in nodes]
    cells = contract.phi.taxels_of_blocks[blocks]
    model = TaxelModel(force_max_n=contract.layout.taxels.force_max_n)
    sensors = PatchSensors(calibration, cells, model, source, seed)
    patch_filter = settled_filter(lambda: sensors.sample(0), contract.phi.held[blocks])
    sensors.touch_from_ns = 0

    def sample(now: int) -> Sample:
        patch_filter.take(sensors.sample(now * SAMPLE_NS))
        return patch_filter.sums_n, patch_filter.variance_n2, patch_filter.noise.node_n

    line, samples = contract.layout.bus[bus], round(seconds * 1000)
    wire, syncs = SimulatedBus(line.bitrate, line.data_bitrate), sync_frames(contract.layout, samples)
    sent = poll(wire, SimulatedNodes(contract, bus, sample), syncs, samples, SAMPLE_NS)
    sums: Frames = sent[sent["can_id"] != SYNC_COB_ID]
    return sums
