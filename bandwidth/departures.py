"""Differences between a measured bus and its plan: missing, late, wrong or unplanned frames."""

from collections.abc import Iterator, Sequence
from itertools import compress, pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.adaptive_log import UNREFINED, SumFrames, sum_frames
from bandwidth.adaptive_plan import AdaptiveBusPlan
from bandwidth.measured import (
    FOREIGN,
    STATE,
    BusLoad,
    Identifiers,
    Measured,
    cycles_of,
    is_plain,
    is_sync,
    whole_cycles,
)
from bandwidth.plan import BusPlan
from dbc.adaptive import PAUSE_MS, SendingRule
from dbc.canopen import BASE_ID_MASK, HEARTBEAT_BASE
from dbc.contract import Contract, Tpdo
from dbc.dictionary import HEARTBEAT_MS, SILENT_AFTER_S
from dbc.frame import ERROR, Frames
from dbc.frame_bits import frame_time_ns
from dbc.packing import COUNTER_BYTES
from skin.ranges import ranges_text
from skin.sync_counter import next_counter

#: Largest relative difference between the mean SYNC period and the layout's.
PERIOD_TOLERANCE = 0.01
#: With more late nodes than this, one line names all: a single late cycle makes all nodes late.
NAMED_AT_MOST = 4
#: A group whose sums are not 0 is silent when its refresh is later than planned by this.
LATE_MS: Final = 100.0
#: How exactly a log tells when a frame began.
CLOCK_NS: Final = 100_000


def departures(contract: Contract, bus: int, seen: Frames, parts: Sequence[Measured]) -> list[str]:
    """Return one line for every difference between bus number `bus` and its plan.

    Parameters
    ----------
    seen : array of FRAME
        In bus order, with times.
    parts : sequence of Measured
        Result of `measure_states` for this bus.
    """
    lines = [line for part in parts for line in _in_state(contract, bus, part)]
    # Counters and heartbeats go on from state to state, each of which has a part of them.
    taken, seconds = whole_cycles(seen)
    rest = [*counters(taken), *heartbeats(contract, bus, taken, seconds)]
    return lines + [f"{contract.layout.bus[bus].name}: {line}" for line in rest]


def _in_state(whole: Contract, bus: int, part: Measured) -> list[str]:
    """Return the differences in one state of the nodes."""
    contract, seen, planned, load = whole.states[part.state], part.frames, part.plan, part.load
    taken, seconds = whole_cycles(seen)
    lines = [*_load(planned, load), *foreign(load), *errors(seen), *_other_state(load)]
    syncs = int(is_sync(seen).sum())
    rest: list[str] = []
    if isinstance(planned, BusPlan):
        unchecked = "cycles cannot be told apart"
        with_syncs = [*_cycles(contract, bus, taken), *_late(contract, bus, taken, planned)] if syncs > 1 else []
    else:
        unchecked, sums = "pauses cannot be checked", sum_frames(contract, bus, taken)
        ended_ns = int(taken["time_ns"][0]) + round(seconds * 1e9)
        rest = [*_unrefined(sums), *_silent(sums, planned, ended_ns)]
        with_syncs = [*_paused(contract, bus, taken)] if syncs > 1 else []
    if syncs > 1:
        lines += [*sync(contract, taken, seconds), *with_syncs]
    else:
        lines.append(f"{'one' if syncs else 'no'} SYNC: {unchecked}")
    lines += [*_misshapen(whole, bus, taken), *rest]
    return [f"{load.title}: {line}" for line in lines]


def _load(planned: BusPlan | AdaptiveBusPlan, load: BusLoad) -> Iterator[str]:
    # Requests for a state are not planned: four a second, and more at a switch.
    found = load.load_exact - sum(each.load_exact for each in load.identifiers if each.kind == STATE)
    if found > planned.load_worst:
        yield f"load {found:.1%}, at most {planned.load_worst:.1%} were planned"


def foreign(load: BusLoad) -> Iterator[str]:
    """Find identifiers that are not planned, emergencies, and other devices that send more than planned."""
    for each in load.identifiers:
        if each.kind == FOREIGN:
            yield f"{each.name} is not planned: {each.frames} frames, {each.load_exact:.2%} of the bus"
        elif each.kind == "EMCY":
            yield f"node {each.node_id} sent {each.frames} emergencies"
        elif each.message is not None and each.rate_hz > _most_hz(each.planned_rate_hz, load.seconds):
            planned = f"{each.planned_rate_hz:.2f} a second were planned"
            yield f"'{each.message}' of another device comes {each.rate_hz:.2f} times a second, {planned}"


def _other_state(load: BusLoad) -> Iterator[str]:
    """Find nodes that send the sums of the state which was not asked for."""
    if load.state is None:
        return
    is_astray = [each.kind == Tpdo.kind and each.planned_rate_hz is None for each in load.identifiers]
    for node in load.nodes:
        astray = [each.frames for each in compress(load.identifiers, is_astray) if each.node_id == node.node_id]
        if astray:
            yield f"node {node.node_id}: {sum(astray)} TPDOs of the other state"


def _most_hz(planned_hz: float | None, seconds: float) -> float:
    """Return the highest rate that a log of some seconds may show of a planned rate."""
    return float("inf") if planned_hz is None else planned_hz * (1 + PERIOD_TOLERANCE) + 1 / seconds


def errors(seen: Frames) -> Iterator[str]:
    """Count the errors that the log reports."""
    reported = int((seen["flags"] & ERROR != 0).sum())
    if reported:
        yield f"{reported} errors reported"


def sync(contract: Contract, taken: Frames, seconds: float) -> Iterator[str]:
    """Compare period and length of SYNC with the layout."""
    syncs = taken[is_sync(taken)]
    period_s = seconds / len(syncs)
    if abs(period_s / contract.layout.sync.period_s - 1) > PERIOD_TOLERANCE:
        yield f"SYNC every {period_s * 1e3:.3f} ms, {contract.layout.sync.period_s * 1e3:.3f} ms were planned"
    others = int((syncs["length"] != COUNTER_BYTES).sum())
    if others:
        yield f"{others} SYNCs have another length than the planned {COUNTER_BYTES} byte"


def counters(taken: Frames) -> Iterator[str]:
    """Find SYNC counters that do not follow each other."""
    found = taken["data"][is_sync(taken), 0].tolist()
    skips = sum(after != next_counter(before) for before, after in pairwise(found))
    if skips:
        yield f"{skips} SYNC counters do not follow each other"


def _cycles(contract: Contract, bus: int, taken: Frames) -> Iterator[str]:
    """Compare the TPDOs of each cycle with the planned TPDOs of its turn."""
    table = contract.table
    row = _rows(contract, bus, taken)
    counters = taken["data"][is_sync(taken), 0]
    turns = np.array([contract.turn_of(int(counter)) for counter in counters])
    is_tpdo = row >= 0
    rows, cycle = row[is_tpdo], cycles_of(taken)[is_tpdo]
    right = table.turn[rows] == turns[cycle]
    came = np.zeros((len(counters), len(table.cob_id)), np.intp)
    np.add.at(came, (cycle, rows), 1)
    due = (table.bus == bus) & (table.turn == turns[:, None])
    of_node = [node.node_id for node in contract.nodes]
    for what, per_row in (
        ("TPDOs missing", (due & (came == 0)).sum(axis=0)),
        ("TPDOs came again in the same cycle", np.maximum(came - 1, 0).sum(axis=0)),
        ("TPDOs came in cycles of the other turn", np.bincount(rows[~right], minlength=len(table.cob_id))),
    ):
        for node in np.unique(table.node[per_row > 0]).tolist():
            yield f"node {of_node[node]}: {int(per_row[table.node == node].sum())} {what}"


def _rows(contract: Contract, bus: int, taken: Frames) -> npt.NDArray[np.intp]:
    """Return the row of each frame in the contract's table of TPDOs, -1 for other frames."""
    known = is_plain(taken) & (taken["can_id"] <= BASE_ID_MASK)
    row: npt.NDArray[np.intp] = np.where(known, contract.table.row_of[bus, taken["can_id"] & BASE_ID_MASK], -1)
    return row


def _late(contract: Contract, bus: int, taken: Frames, planned: BusPlan) -> Iterator[str]:
    """Compare the time from SYNC to the end of each node's TPDOs with its bound."""
    syncs = taken["time_ns"][is_sync(taken)]
    after_ms = (taken["time_ns"] - syncs[cycles_of(taken)]) * 1e-6
    plain = is_plain(taken)
    late: dict[int, str] = {}
    sending = [node for node in contract.on_bus(bus) if node.tpdos]
    for node, plan in zip(sending, planned.node_plans, strict=True):
        mine = plain & np.isin(taken["can_id"], [tpdo.cob_id for tpdo in node.tpdos])
        bound_ms = planned.window_ms if plan.response_ms is None else plan.response_ms
        count = int((after_ms[mine] > bound_ms).sum())
        if count:
            latest_ms = float(after_ms[mine].max())
            late[node.node_id] = (
                f"{count} TPDOs later than {bound_ms:.2f} ms after SYNC, the latest after {latest_ms:.2f} ms"
            )
    if len(late) > NAMED_AT_MOST:
        last = max(late)
        yield f"nodes {ranges_text(late)}: late TPDOs; node {last}: {late[last]}"
    else:
        yield from (f"node {node_id}: {what}" for node_id, what in late.items())


def heartbeats(contract: Contract, bus: int, taken: Frames, seconds: float) -> Iterator[str]:
    """Find nodes that were silent for too long."""
    if seconds <= SILENT_AFTER_S:
        return
    ends = taken["time_ns"][0], taken["time_ns"][0] + round(seconds * 1e9)
    for node in contract.on_bus(bus):
        beats = taken["time_ns"][is_plain(taken) & (taken["can_id"] == HEARTBEAT_BASE + node.node_id)]
        longest_s = float(np.diff(np.concatenate([ends[:1], beats, ends[1:]])).max()) * 1e-9
        if longest_s > SILENT_AFTER_S:
            yield f"node {node.node_id}: no heartbeat for {longest_s:.1f} s, one every {HEARTBEAT_MS} ms was planned"


def _misshapen(contract: Contract, bus: int, taken: Frames) -> Iterator[str]:
    identifiers = Identifiers(contract, bus)
    wrong = identifiers.is_sums(taken) & ~identifiers.is_right(taken)
    for node_id, count in _by_node(contract, bus, taken[wrong]).items():
        yield f"node {node_id}: {count} TPDOs have another length or format"


def _paused(contract: Contract, bus: int, taken: Frames) -> Iterator[str]:
    """Find sums that began in the pause after a SYNC; the frame right behind a SYNC may have been on its way."""
    line = contract.layout.bus[bus]
    took_ns = frame_time_ns(taken, line.bitrate, line.data_bitrate)
    syncs = np.flatnonzero(is_sync(taken))
    newest = syncs[np.cumsum(is_sync(taken)) - 1]
    since_ns = taken["time_ns"].astype(np.int64) - took_ns - taken["time_ns"][newest].astype(np.int64)
    is_early = since_ns < PAUSE_MS * 1_000_000 - CLOCK_NS
    is_next = np.arange(len(taken)) == newest + 1
    wrong = Identifiers(contract, bus).is_sums(taken) & is_early & ~is_next
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
        for group in np.unique(sums.group).tolist():
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
    """Return how many of some TPDOs each node sent."""
    nodes = (node for state in contract.states for node in state.on_bus(bus))
    owner = {tpdo.cob_id: node.node_id for node in nodes for tpdo in node.all_tpdos}
    senders = [owner[int(can_id)] for can_id in wrong["can_id"]]
    return {node_id: senders.count(node_id) for node_id in sorted(set(senders))}
