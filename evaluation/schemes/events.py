"""Event-triggered acquisition: a taxel is sent when it has changed by a threshold since it was sent last."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.frame import FRAME, Frames, frame_bytes, frames
from evaluation.schemes.event_kernel import (
    ASKED,
    COUNT,
    EMPTY_BITS,
    ENDED,
    EVENTS,
    NODE,
    SINCE,
    VALUE_BITS,
    Record,
    Rule,
    new_nodes,
    send_on_delta,
)
from evaluation.schemes.judge import Updates, ValueRun
from evaluation.schemes.patches import lines_of, patches
from evaluation.schemes.wire import TICK_NS, Asked, Nanoseconds, Sent, first_beats_ns

BIT_NS: Final = 1000
#: No classic frame is shorter, so that a bus cannot send more in a tick.
FRAMES_PER_TICK: Final = TICK_NS // (EMPTY_BITS * BIT_NS) + 1
_FIRST_BYTE: Final = FRAME.fields["can_id"][1]  # type: ignore[index]  # FRAME has fields


@dataclass(frozen=True, eq=False)
class EventRun(ValueRun):
    """What event-triggered nodes sent; the latency counts from the sample that reached the threshold.

    `waiting_ns`: for how long the changes that were not sent by the end had waited.
    """

    waiting_ns: Nanoseconds


def run_events(
    counts: npt.NDArray[np.int16], newton_per_count: float, threshold_n: float, dead_ms: int = 1
) -> EventRun:
    """Run the skin of 64 x 64 taxels on its buses.

    Parameters
    ----------
    counts : array of int16, shape (ticks, 4096)
        What every taxel reads, each millisecond.
    newton_per_count, threshold_n, dead_ms
        See `evaluation.schemes.schemes.Events`.
    """
    side = round(counts.shape[1] ** 0.5)
    held = patches(side)
    rule = Rule(max(1, round(threshold_n / newton_per_count)), dead_ms, BIT_NS)
    parts = [_run_bus(counts, mine, rule) for mine in held]
    bus = np.repeat(np.arange(len(held)), [len(part[0]) for part in parts])
    sent, log, since, unsent = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    wire = Sent(Asked(sent, bus, log[:, ASKED]), log[:, ENDED], lines_of(side), len(counts))
    frame, slot = np.nonzero(np.arange(EVENTS) < log[:, COUNT, None])
    low, high = (sent["data"][frame, 2 * slot + byte].astype(np.int64) for byte in (0, 1))
    word = low | high << 8
    taxel = held[bus[frame], log[frame, NODE], word >> VALUE_BITS]
    values = ((word & (1 << VALUE_BITS) - 1) * newton_per_count).astype(np.float32)
    arrived = wire.arrived_ns[frame]
    latency = arrived - since[frame, slot] * TICK_NS
    waiting = (len(counts) - unsent) * TICK_NS
    return EventRun(wire, Updates(arrived, taxel, values), frame, latency, waiting)


def _run_bus(
    counts: npt.NDArray[np.int16], held: npt.NDArray[np.int64], rule: Rule
) -> tuple[Frames, npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return frames, log, and since when events had waited, those of every frame and those never sent."""
    capacity = len(counts) * FRAMES_PER_TICK
    sent = frames(capacity)
    rows = frame_bytes(sent)[:, _FIRST_BYTE:]
    record = Record(rows, np.empty((capacity, 5), np.int64), np.empty((capacity, EVENTS), np.int64))
    nodes = new_nodes(first_beats_ns(len(held)))
    count = send_on_delta(np.ascontiguousarray(counts[:, held]), rule, nodes, record)
    unsent = nodes.taxels[SINCE]
    return sent[:count].copy(), record.log[:count], record.since[:count], unsent[unsent >= 0]
