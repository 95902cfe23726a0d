"""What a log of adaptive nodes holds: frames by kind and level and by node, and what each says of its group."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bandwidth.measured import BusLoad, Identifiers, whole_cycles
from dbc.adaptive import (
    LEVELS,
    NO_CHECK,
    OTHER_CODES,
    Bytes,
    check_of,
    frame_of,
    payload_bytes,
    refines,
)
from dbc.canopen import HEARTBEAT_BASE
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.frame_bits import frame_time_ns
from shell.compiled import njit
from skin.sending import IDENTIFIERS

#: What a frame of sums says: other values than before, the same bytes again (a refresh), details of the newest coarse
#: frame of its group, details of another coarse frame, or details before the first coarse frame of the log.
NEW, AGAIN, REFINING, UNREFINED, EARLY = range(5)
_SAYINGS: Final = 5


@dataclass(frozen=True)
class LevelLoad:
    """Frames of sums of one kind and level of urgency."""

    kind: str
    level: int
    frames: int
    rate_hz: float
    load_exact: float


@dataclass(frozen=True)
class NodeShare:
    """Frames of one node: coarse frames with new values, coarse frames sent again, fine frames, heartbeats.

    `unrefined`: fine frames that do not refine the newest coarse frame of their group.
    """

    node_id: int
    news: int
    again: int
    fine: int
    unrefined: int
    heartbeats: int
    load_exact: float


@dataclass(frozen=True)
class AdaptiveLoad:
    """Load of one bus with adaptive nodes, see `bandwidth.measured.BusLoad`."""

    bus: BusLoad
    levels: list[LevelLoad]
    nodes: list[NodeShare]


@dataclass(frozen=True, eq=False)
class SumFrames:
    """The frames of sums of a log, in its order; on CAN FD (`is_fd`) a frame counts as the first of its groups.

    Attributes
    ----------
    frames : array of FRAME, shape (n,)
    node_id, level, group, says : arrays of int, shape (n,)
        `says` is one of `NEW` to `EARLY`.
    is_fine : array of bool, shape (n,)
    is_zero : array of bool, shape (n,)
        Whether the newest coarse frame of the group, this one included, holds zeros only.
    """

    frames: Frames
    node_id: npt.NDArray[np.int64]
    level: npt.NDArray[np.int64]
    group: npt.NDArray[np.int64]
    is_fine: npt.NDArray[np.bool_]
    says: npt.NDArray[np.int64]
    is_zero: npt.NDArray[np.bool_]
    is_fd: bool


def sum_frames(contract: Contract, bus: int, taken: Frames) -> SumFrames:
    """Find the well-formed frames of sums of bus number `bus`, and follow what each group holds."""
    groups, is_fd, mine = (
        contract.layout.groups,
        contract.layout.bus[bus].fd,
        taken[Identifiers(contract, bus).is_right(taken)],
    )
    parts = np.array(
        [frame_of(int(can_id), groups=groups, is_fd=is_fd) for can_id in mine["can_id"]], np.int64
    ).reshape(-1, 4)
    owner = {tpdo.cob_id: node.node_id for node in contract.on_bus(bus) for tpdo in node.adaptive_tpdos}
    node_id = np.array([owner[int(can_id)] for can_id in mine["can_id"]], np.int64)
    says, is_zero = np.empty(len(mine), np.int64), np.empty(len(mine), np.bool_)
    payloads = np.ascontiguousarray(mine["data"])
    _follow(parts[:, 0], parts[:, 2], parts[:, 3] == 1, payloads, groups, is_fd, says, is_zero)
    return SumFrames(mine, node_id, parts[:, 1], parts[:, 2], parts[:, 3] == 1, says, is_zero, is_fd)


def measure_adaptive(contract: Contract, bus: int, seen: Frames, load: BusLoad) -> AdaptiveLoad:
    """Sort the frames of a bus by kind and level, and by node.

    Parameters
    ----------
    seen : array of FRAME
        In bus order, with times.
    load : BusLoad
        Result of `bandwidth.measured.measure` for them.
    """
    line = contract.layout.bus[bus]
    taken, seconds = whole_cycles(seen)
    sums = sum_frames(contract, bus, taken)
    share = frame_time_ns(sums.frames, line.bitrate, line.data_bitrate) * (1e-9 / seconds)
    levels = []
    for is_fine, level in [(False, level) for level in reversed(range(LEVELS))] + [(True, 1), (True, 0)]:
        mine = (sums.is_fine == is_fine) & (sums.level == level)
        count = int(mine.sum())
        levels.append(
            LevelLoad("fine" if is_fine else "coarse", level, count, count / seconds, float(share[mine].sum()))
        )
    beats = {each.cob_id - HEARTBEAT_BASE: each.frames for each in load.identifiers if each.kind == "heartbeat"}
    loads = {each.node_id: each.load_exact for each in load.nodes}
    nodes = []
    for node in contract.on_bus(bus):
        counts = np.bincount(sums.says[(sums.node_id == node.node_id) & ~sums.is_fine], minlength=_SAYINGS)
        fine = np.bincount(sums.says[(sums.node_id == node.node_id) & sums.is_fine], minlength=_SAYINGS)
        nodes.append(
            NodeShare(
                node_id=node.node_id,
                news=int(counts[NEW]),
                again=int(counts[AGAIN]),
                fine=int(fine.sum()),
                unrefined=int(fine[UNREFINED]),
                heartbeats=beats.get(node.node_id, 0),
                load_exact=loads.get(node.node_id, 0.0),
            )
        )
    return AdaptiveLoad(load, levels, nodes)


@njit(cache=True, nogil=True)
def _follow(  # noqa: PLR0917  compiled functions take no keywords
    node: Any, group: Any, is_fine: Any, payloads: Bytes, groups: int, is_fd: bool, says: Any, is_zero: Any
) -> None:
    size = payload_bytes(False, is_fd, groups)
    check, zero = np.full((IDENTIFIERS, groups), NO_CHECK, np.int64), np.zeros((IDENTIFIERS, groups), np.bool_)
    held = np.zeros((IDENTIFIERS, groups, size), np.uint8)
    for each in range(node.size):
        place, payload = (node[each], group[each]), payloads[each]
        coarse, is_known = payload[:size], check[place] != NO_CHECK
        if is_fine[each]:
            is_right = refines(payload, group[each], is_fd, check[node[each]])
            says[each] = REFINING if is_right else UNREFINED if is_known or is_fd else EARLY
        else:
            says[each] = AGAIN if is_known and (held[place] == coarse).all() else NEW
        if is_fd or not is_fine[each]:
            held[place], check[place] = coarse, check_of(coarse)
            zero[place] = True
            for sum_ in range(size):
                neutral = 0 if group[each] == 0 and sum_ == 0 else OTHER_CODES + 1
                zero[place] = zero[place] and payload[sum_] == neutral
        is_zero[each] = zero[place]
