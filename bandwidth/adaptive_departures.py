"""Differences between a log of adaptive nodes and the layout: what a node must not send, and what it must."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np

from bandwidth.adaptive_log import UNREFINED, SumFrames, sum_frames
from bandwidth.adaptive_plan import AdaptiveBusPlan
from bandwidth.departures import errors, foreign, heartbeats, sync
from bandwidth.measured import BusLoad, is_sum_frame, is_sum_shape, is_sync, whole_cycles
from dbc.adaptive import PAUSE_MS, SendingRule
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.frame_bits import frame_time_ns
from skin.walsh import GROUPS

#: A group whose sums are not 0 is silent when its refresh is later than planned by this.
LATE_MS: Final = 100.0
#: How exactly a log tells when a frame began.
CLOCK_NS: Final = 100_000


def adaptive_departures(
    contract: Contract, bus: int, seen: Frames, planned: AdaptiveBusPlan, load: BusLoad
) -> list[str]:
    """Return one line for every difference between bus number `bus` and the layout; parameters as for `departures`."""
    taken, seconds = whole_cycles(seen)
    lines = [*foreign(contract, bus, load), *errors(seen)]
    syncs = int(is_sync(seen).sum())
    if syncs > 1:
        lines += [*sync(contract, taken, seconds), *_paused(contract, bus, taken)]
    else:
        lines.append(f"{'one' if syncs else 'no'} SYNC: pauses cannot be checked")
    sums = sum_frames(contract, bus, taken)
    ended_ns = int(taken["time_ns"][0]) + round(seconds * 1e9)
    lines += [
        *_misshapen(contract, bus, taken),
        *_unrefined(sums),
        *_silent(sums, planned, ended_ns),
        *heartbeats(contract, bus, taken, seconds),
    ]
    return [f"{planned.name}: {line}" for line in lines]


def _misshapen(contract: Contract, bus: int, taken: Frames) -> Iterator[str]:
    mine = taken[is_sum_frame(contract, bus, taken)]
    for node_id, count in _by_node(contract, bus, mine[~is_sum_shape(contract, bus, mine)]).items():
        yield f"node {node_id}: {count} frames of sums have another length or format"


def _paused(contract: Contract, bus: int, taken: Frames) -> Iterator[str]:
    """Find sums that began in the pause after a SYNC; the frame right behind a SYNC may have been on its way."""
    line = contract.layout.bus[bus]
    took_ns = frame_time_ns(taken, line.bitrate, line.data_bitrate)
    syncs = np.flatnonzero(is_sync(taken))
    newest = syncs[np.cumsum(is_sync(taken)) - 1]
    since_ns = taken["time_ns"].astype(np.int64) - took_ns - taken["time_ns"][newest].astype(np.int64)
    is_early = since_ns < PAUSE_MS * 1_000_000 - CLOCK_NS
    is_next = np.arange(len(taken)) == newest + 1
    wrong = is_sum_frame(contract, bus, taken) & is_early & ~is_next
    for node_id, count in _by_node(contract, bus, taken[wrong]).items():
        yield f"node {node_id}: {count} frames of sums began in the {PAUSE_MS} ms after a SYNC"


def _unrefined(sums: SumFrames) -> Iterator[str]:
    wrong = sums.says == UNREFINED
    for node_id in np.unique(sums.node_id[wrong]).tolist():
        count = int((sums.node_id[wrong] == node_id).sum())
        yield f"node {node_id}: {count} fine frames do not refine the newest coarse frame of their group"


def _silent(sums: SumFrames, planned: AdaptiveBusPlan, ended_ns: int) -> Iterator[str]:
    """Find groups whose sums are not 0 and that were not sent again in time."""
    if planned.refresh_ms is None:
        return
    most_ms = SendingRule().refresh_max + planned.refresh_ms + LATE_MS
    for node_id in np.unique(sums.node_id).tolist():
        for group in range(GROUPS):
            mine = np.flatnonzero((sums.node_id == node_id) & (sums.group == group))
            times_ns = [*sums.frames["time_ns"][mine].tolist(), ended_ns]
            gaps_ms = [
                (after - before) * 1e-6
                for place, (before, after) in zip(mine, pairwise(times_ns), strict=True)
                if not sums.is_zero[place]
            ]
            if max(gaps_ms, default=0.0) > most_ms:
                who = f"node {node_id}" if sums.is_fd else f"node {node_id}: group {group}"
                yield (
                    f"{who} was silent for {max(gaps_ms) * 1e-3:.1f} s, "
                    f"its sums are not 0; a frame every {most_ms * 1e-3:.1f} s was planned"
                )


def _by_node(contract: Contract, bus: int, wrong: Frames) -> dict[int, int]:
    """Return how many of these frames of sums each node sent."""
    owner = {tpdo.cob_id: node.node_id for node in contract.on_bus(bus) for tpdo in node.adaptive_tpdos}
    senders = [owner[int(can_id)] for can_id in wrong["can_id"]]
    return {node_id: senders.count(node_id) for node_id in sorted(set(senders))}
