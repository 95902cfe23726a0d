"""What a scheme sends on simulated buses: exact bits, arbitration by identifier, no faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from bus.polling import Polled, poll
from bus.simulated_bus import SimulatedBus
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID, NmtState
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import Frames, frames
from dbc.frame_bits import wire_bits
from skin.layout import Bus, Layout, PhiParameters, Taxels

#: Touches are known every millisecond.
TICK_NS: Final = 1_000_000
#: Cells of one node, as on the default skin.
NODE_CELLS: Final = 32
BUSES: Final = 4

Places = npt.NDArray[np.intp]
Nanoseconds = npt.NDArray[np.int64]


@cache
def patches(side: int) -> npt.NDArray[np.int64]:
    """Return the cells of every node of an array of `side` x `side`, shape (BUSES, nodes, cells), row-major indices.

    A node holds `NODE_CELLS` neighbours, four high and eight wide, or fewer on an array that would not reach all buses.
    Neighbouring nodes are on different buses.
    """
    per_node = min(NODE_CELLS, side * side // BUSES)
    layout = Layout(
        taxels=Taxels(rows=side, columns=side),
        measurement=PhiParameters(block_size=per_node, wiring="board"),
        bus=[Bus(name=f"bus{number}", nodes=side * side // per_node // BUSES) for number in range(BUSES)],
    )
    return np.stack(layout.patches()).astype(np.int64)


def lines_of(side: int) -> tuple[Bus, ...]:
    """Return the classic buses of an array of `side` x `side`."""
    nodes = patches(side).shape[1]
    return tuple(Bus(name=f"bus{number}", nodes=nodes) for number in range(BUSES))


@dataclass(frozen=True, eq=False)
class Sent:
    """Frames that were carried.

    Attributes
    ----------
    frames : array of FRAME, shape (k,)
        `time_ns` is the end of the frame.
    bus : array of int, shape (k,)
    ticks : int
        Milliseconds that were looked at.
    """

    frames: Frames
    bus: Places
    ticks: int

    @property
    def ended_ns(self) -> Nanoseconds:
        """When each frame had been received."""
        ended: Nanoseconds = self.frames["time_ns"]
        return ended

    @property
    def kbit_per_s(self) -> float:
        """Bits a second over all buses."""
        return sum(int(part.sum()) for part in wire_bits(self.frames)) / (self.ticks * TICK_NS * 1e-9) / 1e3


def carry(asked: Frames, bus: Places, lines: Sequence[Bus], ticks: int) -> Sent:
    """Send frames that are known beforehand, and the heartbeats of all nodes; the given frames come first in `Sent`.

    Parameters
    ----------
    asked : array of FRAME, shape (k,)
        `time_ns` is the earliest start.
    bus : array of int, shape (k,)
    """
    beats = [heartbeats(line, ticks) for line in lines]
    every = np.concatenate([asked, *beats])
    places = np.concatenate([bus, np.repeat(np.arange(len(lines)), [len(each) for each in beats])])
    for number, line in enumerate(lines):
        mine = np.flatnonzero(places == number)
        mine = mine[np.argsort(every["time_ns"][mine], kind="stable")]
        wire = SimulatedBus(line.bitrate, line.data_bitrate)
        nodes = wire.attach("nodes", len(mine))
        wire.attach("gateway")
        wire.submit(nodes, every[mine])
        ended = wire.run_until().frames
        # Frames of one identifier end in the order of their times.
        queued, came = (np.argsort(each["can_id"], kind="stable") for each in (every[mine], ended))
        every["time_ns"][mine[queued]] = ended["time_ns"][came]
    return Sent(every, places, ticks)


def carry_polled(nodes: Sequence[Polled], lines: Sequence[Bus], ticks: int, calls: Frames) -> Sent:
    """Send what the nodes of each bus offer in each millisecond, all heartbeats, and `calls` on every bus."""
    parts = []
    for mine, line in zip(nodes, lines, strict=True):
        wire = SimulatedBus(line.bitrate, line.data_bitrate)
        parts.append(poll(wire, mine, np.concatenate([calls, heartbeats(line, ticks)]), ticks, TICK_NS))
    bus = np.repeat(np.arange(len(lines)), [len(part) for part in parts])
    return Sent(np.concatenate(parts), bus, ticks)


def heartbeats(line: Bus, ticks: int) -> Frames:
    """Return the heartbeats of the nodes of a bus, whose first are spread over a period, in the order of time."""
    first = np.arange(line.nodes, dtype=np.int64) * HEARTBEAT_MS * TICK_NS // line.nodes + TICK_NS // 2
    rounds = -(-ticks // HEARTBEAT_MS)
    beats = frames(rounds * line.nodes)
    beats["time_ns"] = (first + HEARTBEAT_MS * TICK_NS * np.arange(rounds)[:, None]).ravel()
    beats["can_id"] = HEARTBEAT_BASE + 1 + np.tile(np.arange(line.nodes), rounds)
    beats["length"], beats["data"][:, 0] = 1, NmtState.OPERATIONAL
    return beats[beats["time_ns"] < ticks * TICK_NS]


def syncs(times_ns: Nanoseconds, buses: int) -> tuple[Frames, Places]:
    """Return a SYNC without counter on every bus at each time, and its bus."""
    calls = frames(buses * len(times_ns))
    calls["can_id"], calls["time_ns"] = SYNC_COB_ID, np.tile(times_ns, buses)
    return calls, np.repeat(np.arange(buses), len(times_ns))
