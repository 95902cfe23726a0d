"""Event-triggered acquisition: a taxel is sent when it has changed by a threshold since it was sent last."""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.canopen import TPDO_BASES
from dbc.frame import Frames, frames
from evaluation.schemes.judge import ValueRun
from evaluation.schemes.wire import TICK_NS, carry_polled, lines_of, patches

#: Events a frame of 8 bytes holds: 5 bits of place in the node and 11 of value each.
EVENTS: Final = 4
VALUE_BITS: Final = 11
#: More frames than a bus of 1 Mbit/s carries in a millisecond.
MOST_FRAMES: Final = 22
_FIRST_COB_ID: Final = TPDO_BASES[0] + 1


class EventNodes:
    """The nodes of a bus, for `bus.polling.poll`: each sends its most changed taxels, with their newest values.

    Parameters
    ----------
    counts : array of int16, shape (ticks, nodes, taxels)
        What every taxel reads, each millisecond.
    threshold : int
        Counts by which a taxel has changed since it was sent.

    Attributes
    ----------
    since : array of int64, shape (nodes, taxels)
        The tick at which the change first reached the threshold, -1 without a change that waits.
    """

    def __init__(self, counts: npt.NDArray[np.int16], threshold: int) -> None:
        self._counts, self._threshold = counts.astype(np.int64), threshold
        self._shown = np.zeros(counts.shape[1:], np.int64)
        self.since = np.full(counts.shape[1:], -1, np.int64)
        self._is_under_way = np.zeros(counts.shape[1:], np.bool_)
        self._frames, self._told = 0, [np.zeros((5, 0), np.int64)]

    @property
    def told(self) -> npt.NDArray[np.int64]:
        """Of each event that was sent: its frame among those with events, node, place, counts, and `since`."""
        return np.concatenate(self._told, axis=1)

    def take(self, ended: Frames, unsent: Frames) -> None:
        """Take note of events that were sent, and of those that come back."""
        _, node, place, _ = events_of(unsent)
        self._is_under_way[node, place] = False
        mine = ended[is_event(ended)]
        frame, node, place, value = events_of(mine)
        self._told.append(np.stack([self._frames + frame, node, place, value, self.since[node, place]]))
        self._frames += len(mine)
        self._shown[node, place], self.since[node, place] = value, -1
        self._is_under_way[node, place] = False

    def offer(self, period: int) -> Frames:
        """Return the frames of all changes, those of low node-IDs first: more than a bus carries in a millisecond."""
        change = np.abs(self._counts[period] - self._shown)
        is_free = ~self._is_under_way
        is_changed = (change >= self._threshold) & is_free
        self.since[is_free & ~is_changed] = -1
        self.since[is_changed & (self.since < 0)] = period
        node, place = np.nonzero(is_changed)
        order = np.lexsort((-change[node, place], node))
        node, place = node[order], place[order]
        slot = (np.arange(len(node)) - np.searchsorted(node, node)) % EVENTS
        number = np.cumsum(slot == 0) - 1
        node, place, slot, number = (each[number < MOST_FRAMES] for each in (node, place, slot, number))
        self._is_under_way[node, place] = True
        burst = frames(int(number[-1]) + 1 if len(number) else 0)
        word = place << VALUE_BITS | self._counts[period][node, place]
        burst["can_id"][number] = _FIRST_COB_ID + node
        burst["length"] = 2 * np.bincount(number, minlength=len(burst))
        burst["data"][number, 2 * slot], burst["data"][number, 2 * slot + 1] = word & 0xFF, word >> 8
        return burst


def is_event(sent: Frames) -> npt.NDArray[np.bool_]:
    """Tell which frames hold events."""
    found: npt.NDArray[np.bool_] = (sent["can_id"] >= _FIRST_COB_ID) & (sent["can_id"] < TPDO_BASES[1])
    return found


def events_of(sent: Frames) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the frame, node, place and counts of each event of some frames."""
    frame, slot = np.nonzero(np.arange(EVENTS) < sent["length"][:, None] // 2)
    low, high = (sent["data"][frame, 2 * slot + byte].astype(np.int64) for byte in (0, 1))
    word = low | high << 8
    node = sent["can_id"][frame].astype(np.int64) - _FIRST_COB_ID
    return frame, node, word >> VALUE_BITS, word & (1 << VALUE_BITS) - 1


def run_events(counts: npt.NDArray[np.int16], newton_per_count: float, threshold_n: float) -> ValueRun:
    """Run the skin of 64 x 64 taxels on its buses.

    Parameters
    ----------
    counts : array of int16, shape (ticks, 4096)
        What every taxel reads, each millisecond.
    threshold_n : float
        By how much a taxel must differ from the value that was sent last, newtons.

    Returns
    -------
    ValueRun
        Latencies count from the sample that reached the threshold; a change that was not sent counts to the end.
    """
    side = round(counts.shape[1] ** 0.5)
    held = patches(side)
    nodes = [EventNodes(counts[:, mine], max(1, round(threshold_n / newton_per_count))) for mine in held]
    sent = carry_polled(nodes, lines_of(side), len(counts), frames(0))
    is_mine = is_event(sent.frames)
    parts = []
    for number, each in enumerate(nodes):
        frame, node, place, value, since = each.told
        frame_of = np.flatnonzero(is_mine & (sent.bus == number))[frame]
        parts.append(np.stack([frame_of, held[number, node, place], value, since]))
    frame_of, taxel, value, since = np.concatenate(parts, axis=1)
    ended = sent.ended_ns[frame_of]
    waiting = np.concatenate([each.since[each.since >= 0] for each in nodes])
    latency = np.concatenate([ended - since * TICK_NS, (len(counts) - waiting) * TICK_NS])
    return ValueRun(sent, ended, taxel, (value * newton_per_count).astype(np.float32), latency)
