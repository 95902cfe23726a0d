"""Differences between a measured bus and its plan: missing, late, wrong or unplanned frames."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from bandwidth.measured import (
    FOREIGN,
    BusLoad,
    cycles_of,
    is_due,
    is_plain,
    is_sync,
    kind_of,
    tpdo_rows,
    whole_cycles,
)
from bandwidth.plan import BusPlan
from dbc.canopen import HEARTBEAT_BASE
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS, SILENT_AFTER_S
from dbc.frame import ERROR, Frames
from skin.ranges import ranges_text
from skin.sync_counter import next_counter

#: Largest relative difference between the mean SYNC period and the layout's.
PERIOD_TOLERANCE = 0.01
#: With more late nodes than this, one line names all: a single late cycle makes all nodes late.
NAMED_AT_MOST = 4


def departures(contract: Contract, bus: int, seen: Frames, planned: BusPlan, load: BusLoad) -> list[str]:
    """Return one line for every difference between bus number `bus` and its plan.

    Parameters
    ----------
    seen : array of FRAME
        In bus order, with times.
    planned, load : BusPlan, BusLoad
        Results of `plan` and `measure` for this bus.
    """
    taken, seconds = whole_cycles(seen)
    lines = [*_load(planned, load), *foreign(contract, bus, load), *errors(seen)]
    syncs = int(is_sync(seen).sum())
    if syncs > 1:
        lines += [
            *sync(contract, taken, seconds),
            *_cycles(contract, bus, taken),
            *_late(contract, bus, taken, planned),
        ]
    else:
        lines.append(f"{'one' if syncs else 'no'} SYNC: cycles cannot be told apart")
    lines += [*heartbeats(contract, bus, taken, seconds)]
    return [f"{planned.name}: {line}" for line in lines]


def _load(planned: BusPlan, load: BusLoad) -> Iterator[str]:
    if load.load_exact > planned.load_worst:
        yield f"load {load.load_exact:.1%}, at most {planned.load_worst:.1%} were planned"


def foreign(contract: Contract, bus: int, load: BusLoad) -> Iterator[str]:
    """Find identifiers that are not planned, and emergencies."""
    for each in load.identifiers:
        if each.kind == FOREIGN:
            yield f"{each.name} is not planned: {each.frames} frames, {each.load_exact:.2%} of the bus"
        elif each.kind == "EMCY":
            yield f"node {kind_of(contract, bus, each.cob_id)[1]} sent {each.frames} emergencies"


def errors(seen: Frames) -> Iterator[str]:
    """Count the errors that the log reports."""
    reported = int((seen["flags"] & ERROR != 0).sum())
    if reported:
        yield f"{reported} errors reported"


def sync(contract: Contract, taken: Frames, seconds: float) -> Iterator[str]:
    """Compare period, length and counters of SYNC with the layout."""
    syncs = taken[is_sync(taken)]
    period_s = seconds / len(syncs)
    if abs(period_s / contract.layout.sync.period_s - 1) > PERIOD_TOLERANCE:
        yield f"SYNC every {period_s * 1e3:.3f} ms, {contract.layout.sync.period_s * 1e3:.3f} ms were planned"
    length = int(contract.sync(0)["length"][0])
    others = int((syncs["length"] != length).sum())
    if others:
        yield f"{others} SYNCs have another length than the planned {length} bytes"
    if not contract.sync_overflow:
        gaps = np.rint(np.diff(syncs["time_ns"]) * 1e-9 / contract.layout.sync.period_s) - 1
        skipped = int(gaps[gaps > 0].sum())
        if skipped:
            yield f"{skipped} periods without SYNC"
        return
    counters = syncs["data"][:, 0].tolist()
    skips = sum(after != next_counter(before) for before, after in pairwise(counters))
    if skips:
        yield f"{skips} SYNC counters do not follow each other"


def _cycles(contract: Contract, bus: int, taken: Frames) -> Iterator[str]:
    """Compare the TPDOs of each cycle with the planned TPDOs of its phase."""
    table = contract.table
    row = tpdo_rows(contract, bus, taken)
    counters = taken["data"][is_sync(taken), 0]
    phases = np.array([contract.phase_of(int(counter)) for counter in counters])
    is_tpdo = row >= 0
    rows, cycle = row[is_tpdo], cycles_of(taken)[is_tpdo]
    right = table.phase[rows] == phases[cycle]
    came = np.zeros((len(counters), len(table.cob_id)), np.intp)
    np.add.at(came, (cycle, rows), 1)
    due = (table.bus == bus) & (table.phase == phases[:, None])
    misshapen = ~is_due(contract, bus, taken)[is_tpdo]
    of_node = [node.node_id for node in contract.nodes]
    for what, per_row in (
        ("TPDOs missing", (due & (came == 0)).sum(axis=0)),
        ("TPDOs came again in the same cycle", np.maximum(came - 1, 0).sum(axis=0)),
        ("TPDOs came in cycles of the other phase", np.bincount(rows[~right], minlength=len(table.cob_id))),
        ("TPDOs have another length or format", np.bincount(rows[misshapen], minlength=len(table.cob_id))),
    ):
        for node in np.unique(table.node[per_row > 0]).tolist():
            yield f"node {of_node[node]}: {int(per_row[table.node == node].sum())} {what}"


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
