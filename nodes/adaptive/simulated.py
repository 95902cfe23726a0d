"""Adaptive nodes on a simulated bus, for plans and comparisons: the decisions of running boards, without a clock."""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from bus.polling import poll
from bus.simulated_bus import SimulatedBus
from dbc.adaptive import FIRST_COB_ID, GROUP_SUMS, KINDS, PAUSE_MS, Companding, SendingRule, carried, column_of
from dbc.adaptive_filter import SAMPLE_NS
from dbc.canopen import BASE_ID_MASK, SYNC_COB_ID
from dbc.contract import Contract, frame_flags, sum_frame_bits
from dbc.frame import ECHO, Frames, frame_bytes, frames
from nodes.adaptive.controllers import (
    NO_COB_ID,
    choose,
    decide_all,
    frame_buffer,
    give_back,
    new_controllers,
    take_echoes,
)
from nodes.adaptive.filtering import settled_filter
from nodes.adaptive.sending import Integers, Numbers, new_groups, noise_threshold_n2
from nodes.adaptive.sensors import PatchSensors
from nodes.electronics import Calibration
from skin.layout import Bus
from skin.sending import IDENTIFIERS
from skin.sources import TaxelSource
from skin.sync_counter import SYNC_OVERFLOW
from skin.taxel import TaxelModel

#: Samples between two SYNCs.
SYNC_SAMPLES: Final = 100
#: More frames than a bus of 1 Mbit/s carries in a sample.
_MOST_FRAMES: Final = 16
Sums = npt.NDArray[np.float32]
#: Sums of a sample, newtons, and their variances, shape (nodes, sums), and `noise_threshold_n2`, shape (nodes,).
Sample = tuple[Sums, Sums, Numbers]


class SimulatedNodes:
    """All nodes of a bus, operational from the beginning, for `bus.polling.poll` in periods of a sample.

    Parameters
    ----------
    taxels : int
        Of a node.
    sample : callable
        Returns what the filters make of sample number n, which is asked for in order.

    Attributes
    ----------
    groups : nodes.adaptive.sending.Groups
    """

    def __init__(self, line: Bus, law: Companding, taxels: int, sample: Callable[[int], Sample]) -> None:
        self._law, self._sample, self._now = law, sample, -1
        groups = self._count = taxels // GROUP_SUMS
        self.groups = new_groups(line.nodes, groups, line.fd)
        bits = [sum_frame_bits(line, groups, is_fine=is_fine) for is_fine in (False, True)]
        self._controllers = new_controllers(np.tile(np.array(bits, np.int64), (line.nodes, 1)), groups)
        self._tpdos, self._together = KINDS * groups, carried(groups, line.fd)
        tpdos = np.arange(self._tpdos)
        columns = np.array([column_of(each, groups, is_fd=line.fd) for each in line.ids])
        cob_ids = FIRST_COB_ID + IDENTIFIERS // groups * tpdos + columns[:, None]
        self._controllers.cob_id[:] = np.where(tpdos % self._together > 0, NO_COB_ID, cob_ids)
        self._place_of = np.full(BASE_ID_MASK + 1, -1, np.int64)
        node, tpdo = np.nonzero(self._controllers.cob_id)
        self._place_of[self._controllers.cob_id[node, tpdo]] = node * self._tpdos + tpdo
        self._controllers.is_operational[:] = True
        self._room, self._burst = frame_buffer(_MOST_FRAMES), frames(_MOST_FRAMES)
        self._burst["flags"] = frame_flags(line)
        self._offered_since = np.full((line.nodes, groups), -1, np.int64)
        self._since: list[Integers] = []

    @property
    def since(self) -> Integers:
        """Of each frame of sums that ended: the sample that was first news, -1 for a frame without news."""
        return np.concatenate(self._since) if self._since else np.zeros(0, np.int64)

    def take(self, ended: Frames, unsent: Frames) -> None:
        """Take note of sums that were sent, and of those that come back."""
        for place in self._place_of[unsent["can_id"]].tolist():
            node, tpdo = divmod(place, self._tpdos)
            give_back(node, tpdo, self.groups, self._controllers)
        places = self._place_of[ended["can_id"]]
        places = places[places >= 0]
        if not len(places):
            return
        self._since.append(self._offered_since[places // self._tpdos, places % self._count])
        echoes = ended.copy()
        echoes["flags"] |= ECHO
        take_echoes(frame_bytes(echoes), self._place_of, self._now, self._law, self.groups, self._controllers)

    def offer(self, period: int) -> Frames:
        """Return the most urgent frames of a sample; none in the pause after a SYNC."""
        self._now = period
        sums_n, variance_n2, noise_n2 = self._sample(period)
        now_ns = period * SAMPLE_NS
        parts = self._law, self.groups, self._controllers
        is_due = decide_all(period, now_ns, 1e-3, sums_n, variance_n2, noise_n2, *parts)
        if not is_due or period % SYNC_SAMPLES < PAUSE_MS:
            return self._burst[:0]
        room, nodes = self._room, len(sums_n)
        count = int(choose(0, nodes, period, now_ns + SAMPLE_NS, _MOST_FRAMES, sums_n, *parts, room))
        burst, node, group = self._burst[:count], room.node[:count], room.tpdo[:count] % self._count
        burst["can_id"], burst["length"], burst["data"] = room.can_id[:count], room.length[:count], room.payload[:count]
        # On CAN FD a frame tells several groups.
        since = self.groups.since[node[:, None], group[:, None] + np.arange(self._together)]
        oldest = np.where(since >= 0, since, period + 1).min(axis=1)
        self._offered_since[node, group] = np.where(oldest > period, -1, oldest)
        return burst


def sync_frames(samples: int) -> Frames:
    """Return the SYNCs of a bus with adaptive nodes."""
    syncs = frames(-(-samples // SYNC_SAMPLES))
    number = np.arange(len(syncs))
    syncs["can_id"], syncs["length"], syncs["data"][:, 0] = SYNC_COB_ID, 1, number % SYNC_OVERFLOW + 1
    syncs["time_ns"] = number * SYNC_SAMPLES * SAMPLE_NS
    return syncs


def touched_frames(contract: Contract, bus: int, source: TaxelSource, seconds: float, seed: int = 0) -> Frames:
    """Return the frames of sums that the nodes of bus number `bus` send, with the times of their ends.

    Parameters
    ----------
    contract : Contract
        Of a layout with adaptive sending.
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
        noise_n2 = noise_threshold_n2(patch_filter.noise.node_n, SendingRule().noise_ratio, contract.phi.block_size)
        return patch_filter.sums_n, patch_filter.variance_n2, noise_n2

    line, samples = contract.layout.bus[bus], round(seconds * 1000)
    simulated = SimulatedNodes(line, contract.law, contract.phi.block_size, sample)
    wire = SimulatedBus(line.bitrate, line.data_bitrate)
    sent = poll(wire, simulated, sync_frames(samples), samples, SAMPLE_NS)
    sums: Frames = sent[sent["can_id"] != SYNC_COB_ID]
    return sums
