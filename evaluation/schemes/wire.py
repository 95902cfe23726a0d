"""Buses that carry whatever a scheme sends: exact bits, arbitration by identifier, no faults.

`bus.core` serves a running bus, frame by frame, and takes some 90 µs for each; here all frames of a bus are known
beforehand, and each takes some 3 µs. The schemes send tens of millions. The tests hold this model against `bus.core`.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID, NmtState
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import Frames, frames
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns, wire_bits
from evaluation.result import Row
from skin.compiled import njit
from skin.layout import Bus

#: Touches are known every millisecond.
TICK_NS: Final = 1_000_000
#: Load is also looked at in windows of this length, where a burst shows.
WINDOW_NS: Final = 100 * TICK_NS

Places = npt.NDArray[np.intp]
Nanoseconds = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Asked:
    """Frames that are ready to be sent.

    Attributes
    ----------
    frames : array of FRAME, shape (k,)
    bus : array of int, shape (k,)
    time_ns : array of int64, shape (k,)
        From when on.
    """

    frames: Frames
    bus: Places
    time_ns: Nanoseconds

    def __len__(self) -> int:
        return len(self.frames)

    @staticmethod
    def joined(parts: "Sequence[Asked]") -> "Asked":
        """Return the frames of all parts, in their order."""
        fields = ("frames", "bus", "time_ns")
        return Asked(*(np.concatenate([getattr(part, field) for part in parts]) for field in fields))


@dataclass(frozen=True, eq=False)
class Sent:
    """Frames that were carried.

    Attributes
    ----------
    asked : Asked
    free_ns : array of int64, shape (k,)
        When the bus was free behind each frame, intermission included.
    lines : sequence of Bus
        The buses' bit rates.
    ticks : int
        Milliseconds that were looked at.
    """

    asked: Asked
    free_ns: Nanoseconds
    lines: Sequence[Bus]
    ticks: int

    @property
    def arrived_ns(self) -> Nanoseconds:
        """When each frame had been received."""
        pause = np.array([round(INTERMISSION_BITS * 1e9 / line.bitrate) for line in self.lines])
        arrived: Nanoseconds = self.free_ns - pause[self.asked.bus]
        return arrived

    def traffic(self) -> Row:
        """Return bits a second over all buses, the fullest bus's load and that of its worst window."""
        sent, bus = self.asked.frames, self.asked.bus
        bits = sum(int(part.sum()) for part in wire_bits(sent))
        windows = max(1, self.ticks * TICK_NS // WINDOW_NS)
        busy_ns = np.zeros((len(self.lines), windows))
        for number, line in enumerate(self.lines):
            mine = bus == number
            window = np.minimum(self.free_ns[mine] // WINDOW_NS, windows - 1)
            np.add.at(busy_ns[number], window, frame_time_ns(sent[mine], line.bitrate, line.data_bitrate))
        seconds = self.ticks * TICK_NS * 1e-9
        return {
            "kbit_per_s": bits / seconds / 1e3,
            "load": float(busy_ns.sum(axis=1).max()) / (self.ticks * TICK_NS),
            "load_peak": float(busy_ns.max()) * windows / (self.ticks * TICK_NS),
        }


def carry(asked: Sequence[Asked], lines: Sequence[Bus], ticks: int) -> Sent:
    """Arbitrate frames on buses, with the heartbeats of all nodes; the given frames come first in what is returned."""
    every = Asked.joined([*asked, heartbeats(lines, ticks)])
    free_ns = np.empty(len(every), np.int64)
    for number, line in enumerate(lines):
        mine = np.flatnonzero(every.bus == number)
        mine = mine[np.argsort(every.time_ns[mine], kind="stable")]
        took_ns = frame_time_ns(every.frames[mine], line.bitrate, line.data_bitrate)
        free_ns[mine] = _arbitrate(every.time_ns[mine], every.frames["can_id"][mine].astype(np.int64), took_ns)
    return Sent(every, free_ns, lines, ticks)


def first_beats_ns(nodes: int) -> Nanoseconds:
    """Return when each node of a bus sends its first heartbeat: spread over a period."""
    return np.arange(nodes, dtype=np.int64) * HEARTBEAT_MS * TICK_NS // nodes + TICK_NS // 2


def heartbeats(lines: Sequence[Bus], ticks: int) -> Asked:
    """Return the heartbeats of all nodes."""
    rounds = -(-ticks // HEARTBEAT_MS) if ticks else 0
    parts = []
    for number, line in enumerate(lines):
        turns = HEARTBEAT_MS * TICK_NS * np.arange(rounds, dtype=np.int64)[:, None]
        times = (first_beats_ns(line.nodes) + turns).ravel()
        beats = frames(len(times))
        beats["can_id"] = HEARTBEAT_BASE + 1 + np.tile(np.arange(line.nodes), rounds)
        beats["length"], beats["data"][:, 0] = 1, NmtState.OPERATIONAL
        due = times < ticks * TICK_NS
        parts.append(Asked(beats[due], np.full(int(due.sum()), number), times[due]))
    return Asked.joined(parts)


def syncs(times_ns: Nanoseconds, lines: Sequence[Bus]) -> Asked:
    """Return a SYNC without counter on every bus at each time."""
    calls = frames(len(times_ns))
    calls["can_id"] = SYNC_COB_ID
    buses = len(lines)
    return Asked(np.tile(calls, buses), np.repeat(np.arange(buses), len(times_ns)), np.tile(times_ns, buses))


@njit(cache=True, nogil=True)
def _arbitrate(asked_ns: Any, identifier: Any, took_ns: Any) -> Any:
    """Return when the bus is free behind each frame, ns.

    Whenever the bus is free, the frame with the lowest identifier that waits is sent; of equal ones the older.

    Parameters
    ----------
    asked_ns : array of int64, shape (k,)
        Ascending.
    identifier, took_ns : arrays of int64, shape (k,)
    """
    free_ns = np.zeros(asked_ns.size, np.int64)
    waiting = [(np.int64(0), 0)]
    waiting.pop()
    now, come, done = np.int64(0), 0, 0
    while done < asked_ns.size:
        while come < asked_ns.size and (asked_ns[come] <= now or not waiting):
            now = max(now, asked_ns[come])
            heapq.heappush(waiting, (identifier[come], come))
            come += 1
        frame = heapq.heappop(waiting)[1]
        now += took_ns[frame]
        free_ns[frame] = now
        done += 1
    return free_ns
