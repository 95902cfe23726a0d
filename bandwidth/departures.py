"""Differences between a measured bus and its plan: missing, late, wrong or unplanned frames."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.measured import (
    FOREIGN,
    BusLoad,
    Identifiers,
    cycles_of,
    is_plain,
    is_sync,
    whole_cycles,
)
from bandwidth.plan import BusPlan
from dbc.canopen import BASE_ID_MASK, HEARTBEAT_BASE
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS, SILENT_AFTER_S, slot_offset_us
from dbc.frame import ERROR, Frames
from dbc.packing import COUNTER_BYTES
from dbc.patch_filter import SAMPLE_NS
from dbc.steps import LATE_SLOTS, slots_since
from skin.ranges import ranges_text
from skin.sync_counter import next_counter

#: Largest relative difference between the mean SYNC period and the layout's.
PERIOD_TOLERANCE = 0.01
#: With more late nodes than this, one line names all: a single late cycle makes all nodes late.
NAMED_AT_MOST = 4
#: A frame that ends so much before its slot, in slots, is not late by nearly all slots: boards have other clocks.
_EARLY: Final = 0.5


def departures(contract: Contract, bus: int, seen: Frames, planned: BusPlan, load: BusLoad) -> list[str]:
    """Return one line for every difference between bus number `bus` and its plan.

    Parameters
    ----------
    seen : array of FRAME
        In bus order, with times.
    load : BusLoad
        Result of `bandwidth.measured.measure` for this bus.
    """
    taken, seconds = whole_cycles(seen)
    lines = [*_load(planned, load), *foreign(load), *errors(seen)]
    syncs = int(is_sync(seen).sum())
    if syncs > 1:
        compare = _slots if contract.in_steps else _cycles
        lines += [*sync(contract, taken, seconds), *compare(contract, bus, taken, planned)]
    else:
        lines.append(f"{'one' if syncs else 'no'} SYNC: cycles cannot be told apart")
    lines += [*_misshapen(contract, bus, taken), *counters(taken), *heartbeats(contract, bus, taken, seconds)]
    return [f"{load.name}: {line}" for line in lines]


def _load(planned: BusPlan, load: BusLoad) -> Iterator[str]:
    if load.load_exact > planned.load_worst:
        yield f"load {load.load_exact:.1%}, at most {planned.load_worst:.1%} were planned"


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


def _cycles(contract: Contract, bus: int, taken: Frames, planned: BusPlan) -> Iterator[str]:
    """Compare the TPDOs of each cycle with the planned TPDOs of its turn, and their times with their bounds."""
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
    syncs = taken["time_ns"][is_sync(taken)]
    after_ms = (taken["time_ns"] - syncs[cycles_of(taken)]) * 1e-6
    yield from _late(contract, bus, taken, planned, after_ms, "SYNC")


def _slots(contract: Contract, bus: int, taken: Frames, planned: BusPlan) -> Iterator[str]:
    """Compare the time from the sample of each frame to its end with its bound, and find boards that are silent.

    A frame names its slot by 2022h, and the board samples within `SAMPLE_NS` after its place in the slot. A board is
    silent for `Contract.keep_max` slots at most.
    """
    slot_s, is_mine = contract.layout.steps.slot_s, _rows(contract, bus, taken) >= 0
    syncs = np.flatnonzero(is_sync(taken))
    newest = taken[syncs[np.maximum(cycles_of(taken), 0)]]
    since_s = (taken["time_ns"].astype(np.int64) - newest["time_ns"].astype(np.int64)) * 1e-9
    begun = np.floor(since_s / slot_s + _EARLY).astype(np.int64)
    first = (newest["data"][:, 0].astype(np.int64) - 1) * contract.slots
    after_ms = 1e3 * (since_s - (begun - slots_since(taken["data"][:, 0], first + begun)) * slot_s)
    ends_ns, most_s = taken["time_ns"][[0, -1]], (contract.keep_max + LATE_SLOTS) * slot_s
    for node in contract.on_bus(bus):
        mine = is_mine & np.isin(taken["can_id"], [tpdo.cob_id for tpdo in node.tpdos])
        after_ms[mine] -= 1e-3 * slot_offset_us(contract, node) + SAMPLE_NS * 1e-6
        times_ns = np.concatenate([ends_ns[:1], taken["time_ns"][mine], ends_ns[1:]]).astype(np.int64)
        longest_s = float(np.diff(times_ns).max()) * 1e-9
        if longest_s > most_s:
            yield f"node {node.node_id}: no sums for {longest_s:.1f} s, a check every {most_s:.1f} s was planned"
    yield from _late(contract, bus, taken, planned, after_ms, "its sample")


def _rows(contract: Contract, bus: int, taken: Frames) -> npt.NDArray[np.intp]:
    """Return the row of each frame in the contract's table of TPDOs, -1 for other frames."""
    known = is_plain(taken) & (taken["can_id"] <= BASE_ID_MASK)
    row: npt.NDArray[np.intp] = np.where(known, contract.table.row_of[bus, taken["can_id"] & BASE_ID_MASK], -1)
    return row


def _late(  # noqa: PLR0917
    contract: Contract, bus: int, taken: Frames, planned: BusPlan, after_ms: npt.NDArray[np.float64], what: str
) -> Iterator[str]:
    """Compare the time from SYNC, or from its sample, to the end of each node's TPDOs with its bound."""
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
                f"{count} TPDOs later than {bound_ms:.2f} ms after {what}, the latest after {latest_ms:.2f} ms"
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


def _by_node(contract: Contract, bus: int, wrong: Frames) -> dict[int, int]:
    """Return how many of some TPDOs each node sent."""
    owner = {tpdo.cob_id: node.node_id for node in contract.on_bus(bus) for tpdo in node.tpdos}
    senders = [owner[int(can_id)] for can_id in wrong["can_id"]]
    return {node_id: senders.count(node_id) for node_id in sorted(set(senders))}
