"""Adaptive sums: nodes filter their own patch and send its sums when these are news."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.adaptive import FIRST_COB_ID, GROUP_SUMS, Companding, SendingRule, companding
from dbc.canopen import HEARTBEAT_BASE
from dbc.frame import Frames, frame_bytes
from evaluation.schemes.board import Counts, newtons, settled
from evaluation.schemes.judge import Images
from evaluation.schemes.scenes import SIDE
from evaluation.schemes.wire import NODE_CELLS, TICK_NS, Nanoseconds, Sent, carry_polled, patches
from gateway.adaptive_state import new_sums, take_all
from nodes.adaptive.filtering import PatchFilter
from nodes.adaptive.sending import noise_threshold_n2
from nodes.adaptive.simulated import Sample, SimulatedNodes, sync_frames
from reconstructor.walsh import WalshReconstructor
from skin.layout import Bus
from skin.sending import COARSE_STEP_RATIO
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

_GROUPS: Final = NODE_CELLS // GROUP_SUMS
_LAW: Companding = companding(FORCE_MAX_N, COARSE_STEP_RATIO * FORCE_MAX_N, NODE_CELLS)


@dataclass(frozen=True, eq=False)
class AdaptiveRun:
    """What the nodes of a skin sent.

    Attributes
    ----------
    sent : Sent
        Bus by bus.
    latency_ns : array of int64
        Of news: from the sample that was first news to the end of the frame; of news that was not sent by the end, to
        the end.
    noise_n : float
        Median over the nodes of what they know of their noise.
    """

    sent: Sent
    latency_ns: Nanoseconds
    noise_n: float

    def images(self, arrives: npt.NDArray[np.bool_]) -> Images:
        """Return an image a millisecond of the frames that arrive; a lost frame stays unknown to the receiver."""
        ticks = self.sent.ticks
        shares = [
            _received(self.sent.frames[(self.sent.bus == number) & arrives], line.nodes, ticks, is_fd=line.fd)
            for number, line in enumerate(self.sent.lines)
        ]
        solver = WalshReconstructor(list(patches(SIDE)), SIDE, SIDE, self.noise_n)
        solved = [solver.solve(np.concatenate([each[tick] for each in shares])).ravel() for tick in range(ticks)]
        return Images(np.arange(ticks, dtype=np.int64) * TICK_NS, np.stack(solved))


def _received(sent: Frames, nodes: int, ticks: int, *, is_fd: bool) -> Force:
    """Return what the gateway knows of a bus at each millisecond, newtons, shape (ticks, nodes, NODE_CELLS)."""
    known_n, done, sums = np.empty((ticks, nodes, NODE_CELLS), np.float32), 0, new_sums(nodes, _GROUPS)
    is_proven, has_changed = np.ones(nodes, np.bool_), np.zeros((nodes, _GROUPS), np.bool_)
    for tick, until in enumerate(np.searchsorted(sent["time_ns"], np.arange(ticks) * TICK_NS, side="right")):
        if until > done:
            take_all(frame_bytes(sent[done:until]), False, _LAW, is_proven, sums, has_changed, is_fd)
        known_n[tick], done = sums.value_n, until
    return known_n


def run_adaptive(counts: Counts, idle: Counts, lines: Sequence[Bus]) -> AdaptiveRun:
    """Run the skin of 64 x 64 taxels on its buses.

    Parameters
    ----------
    counts, idle : arrays of int16, shape (ticks, 4096)
        What every taxel reads each millisecond, and what it read before, while nothing touched: nodes learn from that.
    lines : sequence of Bus
        Those of `lines_of`, with other bit rates if wanted.
    """
    held, ticks = patches(SIDE), len(counts)
    cells = held.reshape(-1, held.shape[2])
    node_filter = settled(PatchFilter, idle, cells)
    sums_n, variance_n2 = np.empty((2, ticks, *cells.shape), np.float32)
    node_n = np.empty((ticks, len(cells)))
    for tick, sample in enumerate(counts):
        node_filter.take(newtons(sample[cells]))
        sums_n[tick], variance_n2[tick] = node_filter.sums_n, node_filter.variance_n2
        node_n[tick] = node_filter.noise.node_n
    threshold_n2 = noise_threshold_n2(node_n, SendingRule().noise_ratio, NODE_CELLS)

    def sample_of(mine: slice) -> Callable[[int], Sample]:
        return lambda tick: (sums_n[tick, mine], variance_n2[tick, mine], threshold_n2[tick, mine])

    share = held.shape[1]
    nodes = [
        SimulatedNodes(line, _LAW, NODE_CELLS, sample_of(slice(number * share, (number + 1) * share)))
        for number, line in enumerate(lines)
    ]
    sent = carry_polled(nodes, lines, ticks, sync_frames(ticks))
    since = np.concatenate([each.since for each in nodes])
    told = since >= 0
    can_id = sent.frames["can_id"]
    is_sums = (can_id >= FIRST_COB_ID) & (can_id < HEARTBEAT_BASE)
    latency = sent.ended_ns[is_sums][told] - since[told] * TICK_NS
    waiting = np.concatenate([each.groups.since[each.groups.since >= 0] for each in nodes])
    return AdaptiveRun(sent, np.concatenate([latency, (ticks - waiting) * TICK_NS]), float(np.median(node_n)))
