"""The plan of buses with adaptive nodes: idle, touched and full load, and how old what they show can get."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from bandwidth.plan import (
    CYCLES_BUFFERED,
    RECEIVED_FRAME_BYTES,
    ForeignPlan,
    bus_time,
    foreign_plans,
    late_foreign,
    milliseconds,
)
from bandwidth.response import UNBOUNDED
from bandwidth.traffic import Disturbance
from bandwidth.urgency import Budgeted, Urgency
from canskin.errors import InputError
from dbc.adaptive import SendingRule
from dbc.contract import Contract, sum_frame
from dbc.frame_bits import frame_time_ns
from skin.choice import ROOM
from skin.sources import load_objects, load_sender

#: Length of the simulated touches.
TOUCHED_S: Final = 16.0
#: Samples of a second: a group sends one frame for each at most.
_SAMPLES_PER_S: Final = 1000


@dataclass(frozen=True)
class AdaptiveNodePlan:
    """Longest times of one node while everything moves; None without a bound.

    `coarse_ms` from the sample that is first news to the end of the group's frame, of the slowest group.
    """

    node_id: int
    coarse_ms: float | None
    heartbeat_response_ms: float | None


@dataclass(frozen=True)
class BudgetPlan:
    """What a budget (2034h) of `bits_per_s` for every node gives: bus load, and longest times; None without a bound.

    `coarse_ms` and `fine_ms` are bounds while every other group, of the node and of all others, spends its budget;
    `fine_ms` bounds details of a node whose coarse sums stay as they are. `full_ms` is the longest time that the bus is
    full, with what nodes have saved up.
    """

    bits_per_s: int
    load: float
    full_ms: float | None
    coarse_ms: float | None
    fine_ms: float | None


@dataclass(frozen=True)
class AdaptiveBusPlan:
    """One bus with adaptive nodes.

    Loads: ``idle`` nothing touches (SYNC and heartbeats), ``touched`` a simulated touched skin, None without
    simulation; ``worst`` every group has news in every sample. `groups_fill` groups with a frame in every sample fill
    the bus.

    Times are upper bounds, None without a bound. While everything moves: `coarse_ms` from the sample that is first
    news to the end of its coarse frame; `refresh_ms` from the time when a refresh is due, or a node has started, to the
    end of its frame; `heartbeat_response_ms` and `sdo_response_ms`. Fine sums then have no bound. After everything has
    come to rest, all sums are shown coarse after `settled_coarse_ms` and fine after `settled_fine_ms`. After a gateway
    has joined, or noticed a loss of frames, all sums have come after `joined_still_ms` if nothing moves, `joined_ms` if
    everything moves.

    `budget_80_bits_per_s` is the budget of a node with which the bus has a load of 80 % at most.
    """

    name: str
    nodes: int
    bitrate: int
    load_idle: float
    load_idle_worst: float
    load_touched: float | None
    load_worst: float
    groups_fill: int
    coarse_ms: float | None
    refresh_ms: float | None
    settled_coarse_ms: float | None
    settled_fine_ms: float | None
    joined_still_ms: float | None
    joined_ms: float | None
    sdo_response_ms: float | None
    heartbeat_response_ms: float | None
    receive_buffer_frames: int
    receive_buffer_bytes: int
    budget_80_bits_per_s: int
    budget: BudgetPlan | None
    node_plans: list[AdaptiveNodePlan]
    foreign: list[ForeignPlan]
    problems: list[str]


def plan_adaptive(
    contract: Contract, *, allowed: Disturbance | None = None, budget_bits_per_s: int = 0, is_touched: bool = True
) -> list[AdaptiveBusPlan]:
    """Plan every bus of a skin with adaptive sending.

    Parameters
    ----------
    allowed : Disturbance, optional
        Disturbances that times include; `jitter_s` is the longest time from a sample until its frame is queued.
    budget_bits_per_s : int
        Budget of every node (2034h), 0 for none; InputError refuses a budget below what refreshes take.
    is_touched : bool
        Whether to simulate a touch for `AdaptiveBusPlan.load_touched`.
    """
    lines = contract.layout.bus
    kinds = [(line.fd, line.bitrate, line.data_bitrate) for line in lines]
    # Neighbouring patches are on different buses, so that one bus stands for all like it: the first.
    touched = {kind: touched_load(contract, kinds.index(kind)) if is_touched else None for kind in set(kinds)}
    return [
        _plan_bus(contract, bus, touched[kind], allowed or Disturbance(), budget_bits_per_s)
        for bus, kind in enumerate(kinds)
    ]


def touched_load(contract: Contract, bus: int) -> float | None:
    """Return the load of the sums of a bus while the default objects press and slide, with exact stuff bits.

    None if no installed package tells what adaptive nodes send.
    """
    try:
        sent_of = load_sender("adaptive")
    except InputError:
        return None
    line = contract.layout.bus[bus]
    sent = sent_of(contract, bus, load_objects(contract.layout, seed=0), TOUCHED_S)
    return float(frame_time_ns(sent, line.bitrate, line.data_bitrate).sum()) * 1e-9 / TOUCHED_S


def _plan_bus(
    contract: Contract, bus: int, touched: float | None, allowed: Disturbance, budget_bits_per_s: int
) -> AdaptiveBusPlan:
    line, urgency = contract.layout.bus[bus], Urgency.of(contract, bus, allowed)
    rate_hz = contract.layout.sync.rate_hz
    idle, idle_worst = (bus_time(urgency.streams, how).load(rate_hz) for how in ("exact", "worst"))
    news_ns, service_ns = urgency.news_ns, urgency.service_ns
    beats_ns = service_ns[urgency.streams.is_heartbeat]
    foreign = foreign_plans(urgency.streams, urgency.foreign_ns)
    settled_ns, joined_ns = urgency.settled_ns, urgency.joined_ns
    wanted = line.nodes * urgency.frames_of_node * _SAMPLES_PER_S * urgency.coarse_frame_ns * 1e-9 + idle_worst
    shortest_ns = frame_time_ns(
        sum_frame(line, contract.layout.groups, is_fine=False), line.bitrate, line.data_bitrate, "none"
    )[0]
    buffered = math.ceil(CYCLES_BUFFERED * 1e9 / (rate_hz * shortest_ns))
    frames_fill = math.ceil((1 - idle_worst) * 1e9 / (_SAMPLES_PER_S * urgency.coarse_frame_ns))
    free = ROOM - idle_worst
    return AdaptiveBusPlan(
        name=line.name,
        nodes=line.nodes,
        bitrate=line.bitrate,
        load_idle=idle,
        load_idle_worst=idle_worst,
        load_touched=None if touched is None else min(1.0, idle + touched),
        load_worst=min(1.0, wanted),
        groups_fill=frames_fill * contract.layout.groups // urgency.frames_of_node,
        coarse_ms=milliseconds(news_ns),
        refresh_ms=milliseconds(urgency.refresh_ns),
        settled_coarse_ms=milliseconds(settled_ns[0]),
        settled_fine_ms=milliseconds(settled_ns[1]),
        joined_still_ms=milliseconds(joined_ns[0]),
        joined_ms=milliseconds(joined_ns[1]),
        sdo_response_ms=milliseconds(service_ns[urgency.streams.is_sdo_response]),
        heartbeat_response_ms=milliseconds(beats_ns),
        receive_buffer_frames=buffered,
        receive_buffer_bytes=buffered * RECEIVED_FRAME_BYTES,
        budget_80_bits_per_s=max(0, int(free * line.bitrate / line.nodes)),
        budget=_budget(urgency, idle_worst, budget_bits_per_s) if budget_bits_per_s else None,
        node_plans=[
            AdaptiveNodePlan(node.node_id, milliseconds(mine), milliseconds(beat))
            for node, mine, beat in zip(contract.on_bus(bus), news_ns, beats_ns, strict=True)
        ],
        foreign=foreign,
        problems=[*_problems(urgency, line.name, news_ns, beats_ns), *late_foreign(line, foreign)],
    )


def _budget(urgency: Urgency, idle_worst: float, bits_per_s: int) -> BudgetPlan:
    load = idle_worst + urgency.nodes * bits_per_s / urgency.streams.bus.bitrate
    spent = Budgeted(urgency, bits_per_s)
    if bits_per_s < spent.least_bits_per_s:
        raise InputError(
            f"expected a budget of 0 (none), or of {spent.least_bits_per_s} bit/s or more, got {bits_per_s}: "
            f"refreshes take {spent.least_bits_per_s} bit/s of a node, and no budget holds them back"
        )
    return BudgetPlan(
        bits_per_s, min(1.0, load), *(milliseconds(each) for each in (spent.full_ns, spent.coarse_ns, spent.fine_ns))
    )


def _problems(urgency: Urgency, name: str, news_ns: np.ndarray, beats_ns: np.ndarray) -> list[str]:
    found = []
    if (news_ns == UNBOUNDED).any():
        patience_ms, each_ms = SendingRule().patience, urgency.frames_of_node * urgency.coarse_frame_ns * 1e-6
        free = 1 - sum(each_ns / interval_ns for each_ns, interval_ns, _ in urgency.above)
        found.append(
            f"{name}: coarse sums have no bound while everything moves: {urgency.nodes} nodes send for "
            f"{urgency.nodes * each_ms:.1f} ms what has waited for {patience_ms} ms; "
            f"{max(0, int(free * patience_ms / each_ms))} nodes or a higher bit rate would do"
        )
    if (beats_ns == UNBOUNDED).any():
        found.append(f"{name}: the pauses after SYNC have no room for all SDO transfers and heartbeats")
    return found
