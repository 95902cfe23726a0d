"""Steps: nodes filter their own patch, and send what is worth its bits in their slots."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.dictionary import slot_offset_us
from dbc.frame import ECHO, Frames
from dbc.steps import COUNT, slots_since
from evaluation.schemes.board import Board, newtons, settled
from evaluation.schemes.judge import Images
from evaluation.schemes.scenes import SIDE
from evaluation.schemes.wire import NODE_CELLS, TICK_NS, Nanoseconds, Sent, carry_polled, patches
from gateway.batch import batch_of
from gateway.stepped_state import new_sums, slots_of, take_all
from nodes.steps.filtering import PatchFilter
from nodes.steps.simulated import Sample, SimulatedNodes, sync_frames
from reconstructor.walsh import WalshReconstructor
from shell.compiled import hold
from touch.contact import Force


@dataclass(frozen=True, eq=False)
class SteppedRun:
    """What the nodes of a skin sent.

    Attributes
    ----------
    sent : Sent
        Bus by bus.
    latency_ns : array of int64
        From the sample to the end of each frame of sums.
    images : Images
        An image a millisecond of the frames that have come.
    """

    sent: Sent
    latency_ns: Nanoseconds
    images: Images


class _Followed(SimulatedNodes):
    """The nodes of a bus, which have run for long, and the gateway that follows them.

    Attributes
    ----------
    known_n : list of arrays of float32, shape (nodes, NODE_CELLS)
        What the gateway holds at each millisecond, newtons.
    """

    def __init__(self, contract: Contract, bus: int, sample: Callable[[int], Sample]) -> None:
        super().__init__(contract, bus, sample)
        table, nodes, state = contract.parts, contract.on_bus(bus), self.senders.state
        self._table, self._number, self._unit_n = table, bus, contract.unit_n
        self._mine = np.flatnonzero(np.isin(table.block, [node.block for node in nodes]))
        self._parts = len(self._mine) // len(nodes)
        self._slots, self._sums = slots_of(contract), new_sums(contract)
        is_proven = np.ones(len(contract.nodes), np.bool_)
        self._known = hold((is_proven, self._slots, contract.parts, self._sums))
        self.known_n: list[Force] = []
        # An untouched skin at rest: every sum has been told, and is 0; the next checks are spread over their period.
        groups, boards = int(table.form[:, 3].max()), len(state.slot)
        silent = np.arange(boards) * contract.keep_max // boards + 1
        state.unset[:], state.keep[:], state.slot[:] = groups, contract.keep_max, -silent % contract.slot_cycle
        sums = self._sums
        sums.slot[:], sums.word_count[:] = np.repeat(state.slot, table.parts), COUNT - 1
        sums.newest_ns[:] = -np.repeat(silent, table.parts) * self._slots.slot_ns
        sums.missing[:] = sums.unknown[:] = 0

    def take(self, ended: Frames, unsent: Frames) -> None:
        """Take note of frames that ended, as nodes and as the gateway."""
        super().take(ended, unsent)
        arrived = ended.copy()
        arrived["flags"][arrived["can_id"] == SYNC_COB_ID] |= ECHO
        take_all(batch_of(arrived, self._number, self._table), self._known)

    def offer(self, period: int) -> Frames:
        """Return the frames that take part in arbitration."""
        held = self._sums.known[self._mine, : NODE_CELLS // self._parts].reshape(-1, NODE_CELLS)
        self.known_n.append(held.astype(np.float32) * np.float32(self._unit_n))
        return super().offer(period)


def run_stepped(board: Board, contract: Contract) -> SteppedRun:
    """Run the skin of 64 x 64 taxels on the buses of a contract with steps.

    Nodes learn their noise from what they read before, while nothing touched.
    """
    held, ticks = patches(SIDE), len(board.counts)
    cells = held.reshape(-1, held.shape[2])
    node_filter = settled(PatchFilter, board.idle, cells)
    sums_n, variance_n2 = np.empty((2, ticks, *cells.shape), np.float32)
    node_n = np.empty((ticks, len(cells)))
    for tick, sample in enumerate(board.counts):
        node_filter.take(newtons(sample[cells]))
        sums_n[tick], variance_n2[tick] = node_filter.sums_n, node_filter.variance_n2
        node_n[tick] = node_filter.noise.node_n

    def sample_of(mine: slice) -> Callable[[int], Sample]:
        return lambda tick: (sums_n[tick, mine], variance_n2[tick, mine], node_n[tick, mine])

    lines = contract.layout.bus
    share = len(cells) // len(lines)
    nodes = [
        _Followed(contract, number, sample_of(slice(number * share, (number + 1) * share)))
        for number in range(len(lines))
    ]
    sent = carry_polled(nodes, lines, ticks, sync_frames(contract.layout, ticks))
    solver = WalshReconstructor(list(held), SIDE, SIDE, float(np.median(node_n)))
    solved = [solver.solve(np.concatenate([each.known_n[tick] for each in nodes])).ravel() for tick in range(ticks)]
    images = Images(np.arange(ticks, dtype=np.int64) * TICK_NS, np.stack(solved))
    return SteppedRun(sent, _latency_ns(contract, sent), images)


def _latency_ns(contract: Contract, sent: Sent) -> Nanoseconds:
    """Return the time from the sample of each frame of sums to its end: a node uses the next sample in its slot."""
    found, slot_ns = [], round(contract.layout.steps.slot_s * 1e9)
    for bus in range(len(contract.layout.bus)):
        mine = sent.frames[sent.bus == bus]
        offsets_ns = {
            tpdo.cob_id: 1000 * slot_offset_us(contract, node) for node in contract.on_bus(bus) for tpdo in node.tpdos
        }
        mine = mine[np.isin(mine["can_id"], list(offsets_ns))]
        offset_ns = np.array([offsets_ns[int(each)] for each in mine["can_id"]], np.int64)
        newest = (mine["time_ns"] - offset_ns) // slot_ns
        begun_ns = (newest - slots_since(mine["data"][:, 0], newest)) * slot_ns + offset_ns
        found.append(mine["time_ns"] - -(-begun_ns // TICK_NS) * TICK_NS)
    return np.concatenate(found)
