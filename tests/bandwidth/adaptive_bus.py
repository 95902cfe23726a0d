"""Adaptive nodes on a simulated bus, from sums that a test chooses."""

import numpy as np
import numpy.typing as npt

from bus.polling import poll
from bus.simulated_bus import SimulatedBus
from dbc.adaptive import Companding
from dbc.adaptive_filter import SAMPLE_NS
from dbc.canopen import HEARTBEAT_BASE, NmtState
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import Frames, frames
from nodes.adaptive.simulated import SimulatedNodes, sync_frames
from skin.layout import Bus
from tests.layouts import BLOCK_SUMS


def run_bus(
    line: Bus,
    law: Companding,
    sums_n: npt.NDArray[np.float32],
    noise_n2: npt.NDArray[np.float64],
    first_beats_ns: npt.NDArray[np.int64],
) -> tuple[Frames, SimulatedNodes]:
    """Return all frames of a bus, with SYNCs and heartbeats, and its nodes.

    Parameters
    ----------
    sums_n : array of float32, shape (ticks, nodes, BLOCK_SUMS)
    noise_n2 : array of float64, shape (ticks, nodes)
        Thresholds of news.
    first_beats_ns : array of int64, shape (nodes,)
        When the first heartbeat of each node is due.
    """
    ticks, nodes, _ = sums_n.shape
    quiet = np.zeros_like(sums_n[0])
    boards = SimulatedNodes(line, law, BLOCK_SUMS, lambda tick: (sums_n[tick], quiet, noise_n2[tick]))
    turns = HEARTBEAT_MS * SAMPLE_NS * np.arange(-(-ticks // HEARTBEAT_MS))
    beats = frames(len(turns) * nodes)
    beats["time_ns"] = (first_beats_ns + turns[:, None]).ravel()
    beats["can_id"] = HEARTBEAT_BASE + 1 + np.tile(np.arange(nodes), len(turns))
    beats["length"], beats["data"][:, 0] = 1, NmtState.OPERATIONAL
    others = np.concatenate([sync_frames(ticks), beats[beats["time_ns"] < ticks * SAMPLE_NS]])
    wire = SimulatedBus(line.bitrate, line.data_bitrate)
    return poll(wire, boards, others, ticks, SAMPLE_NS), boards
