"""What the controllers of adaptive nodes hold: which frames go to the bus next, and what came of them.

A frame expires about a sample after it was made, so that its payload never gets old: a frame that has not won the bus
by then comes back, and is made anew of the next sample's sums. A node takes a frame as sent when its echo comes, and
holds then what a receiver holds.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive import (
    FIRST_COB_ID,
    GROUP_SUMS,
    KINDS,
    LEVELS,
    LOST_NS,
    SAVED_FRAMES,
    SAVING_S,
    Bytes,
    Companding,
    SendingRule,
    carried,
    payload_bytes,
)
from dbc.adaptive_filter import Floats
from dbc.canopen import BASE_ID_MASK
from dbc.frame import BRS, ECHO, ERROR, ESI, FD, FD_BYTES, FRAME, frame_bytes, frames
from nodes.adaptive.sending import (
    DETAIL,
    NEWS,
    NOT_DUE,
    REFRESH,
    Flags,
    Groups,
    Integers,
    Numbers,
    decide,
    make_payload,
    new_groups,
    note_sent,
    tpdo_of,
)
from shell.compiled import borrowed, njit

#: `Controllers.cob_id` of a TPDO that does not exist.
NO_COB_ID: Final = 0
#: Columns of `Controllers.counts`.
SENT, REFUSED = range(2)
_LONG_AGO: Final = -(1 << 40)
#: A `SendingRule` in an array.
RULE: Final = np.dtype([(name, type(value)) for name, value in SendingRule()._asdict().items()])
#: As 2031h holds it: REAL32, or whole.
DEFAULT_RULE: Final = tuple(float(np.float32(value)) for value in SendingRule())
#: Places of fields in the bytes of a frame.
_CAN_ID, _LENGTH, _FLAGS, _DATA = (
    int(FRAME.fields[name][1])  # type: ignore[index]  # FRAME has fields
    for name in ("can_id", "length", "flags", "data")
)
#: Flags of an echo of a classic frame, and of CAN FD.
_PLAIN: Final = ECHO | ERROR
_PLAIN_FD: Final = ECHO | ERROR | FD | BRS | ESI


class Controllers(NamedTuple):
    """The controllers of some nodes.

    Attributes
    ----------
    cob_id, inhibit, made_at : arrays of int64, shape (nodes, KINDS · groups)
        Identifier of each TPDO (`dbc.adaptive.tpdo_index`), or `NO_COB_ID`; its inhibit time and the sample of its
        newest frame, in samples.
    frame_bits : array of int64, shape (nodes, 2)
        What a coarse and a fine frame take of a budget.
    budget, saved : arrays of float64, shape (nodes,)
        Bits a second that a node may send, 0 for no limit, and bits that it has saved up.
    counts : array of int64, shape (nodes, 2)
        Frames sent, and frames that found no room in the transmit queue.
    rule : array of `RULE`, shape (nodes,)
    is_operational, has_due : arrays of bool, shape (nodes,)
        Whether a node may send, and whether it had anything to send at the newest decision.
    """

    cob_id: Integers
    inhibit: Integers
    made_at: Integers
    frame_bits: Integers
    budget: Numbers
    saved: Numbers
    counts: Integers
    rule: npt.NDArray[np.void]
    is_operational: Flags
    has_due: Flags


def new_controllers(frame_bits: Integers, groups: int) -> Controllers:
    """Return the controllers of nodes that have sent nothing and have no limit; `frame_bits` as in `Controllers`."""
    nodes, tpdos = len(frame_bits), KINDS * groups
    return Controllers(
        cob_id=np.full((nodes, tpdos), NO_COB_ID, np.int64),
        inhibit=np.zeros((nodes, tpdos), np.int64),
        made_at=np.full((nodes, tpdos), _LONG_AGO, np.int64),
        frame_bits=frame_bits.copy(),
        budget=np.zeros(nodes),
        saved=np.zeros(nodes),
        counts=np.zeros((nodes, 2), np.int64),
        rule=np.full(nodes, np.array(DEFAULT_RULE, RULE)),
        is_operational=np.zeros(nodes, np.bool_),
        has_due=np.zeros(nodes, np.bool_),
    )


class Chosen(NamedTuple):
    """Room for the frames that a bus gets next.

    Attributes
    ----------
    can_id, node, tpdo, length : arrays of int64, shape (frames,)
    payload : array of uint8, shape (frames, 64)
        Zeros after `length` bytes.
    """

    can_id: Integers
    node: Integers
    tpdo: Integers
    length: Integers
    payload: Bytes


def frame_buffer(count: int) -> Chosen:
    """Return an empty buffer of `count` frames."""
    can_id, node, tpdo, length = np.zeros((4, count), np.int64)
    return Chosen(can_id, node, tpdo, length, np.zeros((count, FD_BYTES), np.uint8))


@njit(cache=True, nogil=True)
def decide_all(  # noqa: PLR0917  compiled functions take no keywords
    now: int,
    now_ns: int,
    passed_s: float,
    sums_n: Floats,
    variance_n2: Floats,
    noise_n2: Numbers,
    law: Companding,
    groups: Groups,
    controllers: Controllers,
) -> bool:
    """Decide what each node is to send, as `nodes.adaptive.sending.decide`; save up budgets. Tell whether any is due.

    Parameters
    ----------
    passed_s : float
        Time since the last decision.
    """
    groups, controllers = borrowed(groups), borrowed(controllers)
    budget, saved, under_way, level = controllers.budget, controllers.saved, groups.under_way, groups.level
    is_operational, has_due = controllers.is_operational, controllers.has_due
    for node in range(has_due.size):
        has_due[node] = False
        if budget[node] > 0:
            least = float(SAVED_FRAMES * level.shape[1] * controllers.frame_bits[node, 0])
            most = max(least, budget[node] * SAVING_S)
            # Refreshes go whatever is saved. Without a limit, their debt would hold news back for minutes.
            owed = max(saved[node], -least)
            saved[node] = min(most, owed + budget[node] * passed_s)
        if not is_operational[node]:
            continue
        for group in range(level.shape[1]):
            if 0 < under_way[node, group] < now_ns:
                under_way[node, group] = 0
    _find_quiet(now, sums_n, law, groups, controllers)
    for node in range(has_due.size):
        if has_due[node]:
            has_due[node] = False
            decide(node, now, sums_n[node], variance_n2[node], noise_n2[node], controllers.rule[node], law, groups)
            for group in range(level.shape[1]):
                is_free = under_way[node, group] == 0
                has_due[node] = has_due[node] or (is_free and level[node, group] != NOT_DUE)
    return bool(has_due.any())


@njit(cache=True, nogil=True, fastmath=True)  # so that the largest of eight is found in one step
def _find_quiet(now: int, sums_n: Floats, law: Companding, groups: Groups, controllers: Controllers) -> None:
    """Silence groups whose receivers are up to date and that need no refresh. Note which nodes have other groups.

    Most nodes have none, and `decide` takes longer.
    """
    known_n, refreshes, refresh_at = groups.known_n, groups.refreshes, groups.refresh_at
    since, level, reason = groups.since, groups.level, groups.reason
    is_fine, under_way = groups.is_fine, groups.under_way
    for node in range(controllers.is_operational.size):
        if not controllers.is_operational[node]:
            continue
        bound = controllers.rule[node].rounding * law.fine_n
        for group in range(level.shape[1]):
            if under_way[node, group] > 0:
                continue
            largest = 0.0
            for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
                largest = max(largest, abs(sums_n[node, place] - known_n[node, place]))
            if largest > bound or (refreshes[node, group] > 0 and now >= refresh_at[node, group]):
                controllers.has_due[node] = True
            else:
                since[node, group], level[node, group] = -1, NOT_DUE
                reason[node, group], is_fine[node, group] = NEWS, 0


@njit(cache=True, nogil=True)
def choose(  # noqa: PLR0917  compiled functions take no keywords
    first: int,
    last: int,
    now: int,
    until_ns: int,
    most: int,
    sums_n: Floats,
    law: Companding,
    groups: Groups,
    controllers: Controllers,
    chosen: Chosen,
) -> int:
    """Make the most urgent frames of nodes `first` to `last` - 1, at most `most`, and return how many.

    The frames, which expire at `until_ns`, are under way from now on.
    """
    groups, controllers = borrowed(groups), borrowed(controllers)
    of_node = groups.level.shape[1]
    keys, count, before = np.empty((last - first) * of_node, np.int64), 0, 0
    for node in range(first, last):
        if controllers.has_due[node]:
            together = carried(of_node, groups.is_fd[node])
            for group in range(of_node):
                if group % together == 0:
                    before = count
                cob_id = _due_cob_id(node, group, now, groups, controllers)
                if cob_id == NO_COB_ID:
                    continue
                keys[count] = (cob_id << 32) + node * of_node + group
                if count > before:  # one frame for the groups that it carries: that of the most urgent
                    keys[before] = min(keys[before], keys[count])
                else:
                    count += 1
    keys[:count].sort()
    done = 0
    for key in keys[:count]:
        place = key & 0xFFFFFFFF
        node, group = place // of_node, place % of_node
        if done == most:
            break
        if _has_budget(node, group, groups, controllers):
            tpdo = tpdo_of(node, group, groups)
            controllers.made_at[node, tpdo] = now
            controllers.saved[node] -= controllers.frame_bits[node, groups.is_fine[node, group]]
            chosen.payload[done] = 0
            chosen.length[done] = make_payload(node, group, sums_n[node], law, groups, chosen.payload[done])
            _note_way(node, group, until_ns + LOST_NS, groups)
            chosen.can_id[done], chosen.node[done], chosen.tpdo[done] = key >> 32, node, tpdo
            done += 1
    return done


@njit(cache=True, nogil=True)
def _due_cob_id(node: int, group: int, now: int, groups: Groups, controllers: Controllers) -> int:
    """Return the identifier of the frame that a group would be sent in now, or `NO_COB_ID`."""
    if groups.level[node, group] == NOT_DUE or groups.under_way[node, group] > 0:
        return NO_COB_ID
    tpdo = tpdo_of(node, group, groups)
    is_inhibited = now - controllers.made_at[node, tpdo] < controllers.inhibit[node, tpdo]
    if is_inhibited or not _has_budget(node, group, groups, controllers):
        return NO_COB_ID
    return int(controllers.cob_id[node, tpdo])


@njit(cache=True, nogil=True)
def give_back(node: int, tpdo: int, groups: Groups, controllers: Controllers) -> None:
    """Take note of a frame that was not sent."""
    of_node = groups.level.shape[1]
    group = tpdo % of_node
    if groups.under_way[node, group] > 0:
        _note_way(node, group, 0, groups)
        controllers.made_at[node, tpdo] = _LONG_AGO
        controllers.saved[node] += controllers.frame_bits[node, int(tpdo >= LEVELS * of_node)]


@njit(cache=True, nogil=True)
def _note_way(node: int, group: int, until_ns: int, groups: Groups) -> None:
    """Set until when the controller may hold a frame of a group, and so of all groups that the frame carries."""
    together = carried(groups.level.shape[1], groups.is_fd[node])
    first = group // together * together
    for each in range(first, first + together):
        groups.under_way[node, each] = until_ns


@njit(cache=True, nogil=True)
def take_echoes(  # noqa: PLR0917  compiled functions take no keywords
    rows: npt.NDArray[np.uint8],
    place_of: npt.NDArray[np.int64],
    now: int,
    law: Companding,
    groups: Groups,
    controllers: Controllers,
) -> tuple[int, int]:
    """Take note of the nodes' own frames among received ones; return how many were sent, and the number of others.

    Parameters
    ----------
    rows : array of uint8, shape (n, bytes of FRAME)
    place_of : array of int64, shape (BASE_ID_MASK + 1,)
        Number of TPDOs · node + TPDO of an identifier, -1 for all others.
    """
    groups, controllers = borrowed(groups), borrowed(controllers)
    sent, others, of_node = 0, 0, groups.level.shape[1]
    for row in rows:
        can_id = int(row[_CAN_ID]) | int(row[_CAN_ID + 1]) << 8 | int(row[_CAN_ID + 2]) << 16
        flags = int(row[_FLAGS])
        place = place_of[can_id] if can_id <= BASE_ID_MASK else -1
        if place < 0 or flags & ECHO == 0:
            others += 1
            continue
        node, tpdo = place // (KINDS * of_node), place % (KINDS * of_node)
        group, is_fine, is_fd = tpdo % of_node, tpdo >= LEVELS * of_node, groups.is_fd[node]
        is_strange = flags & ~(_PLAIN_FD if is_fd else _PLAIN) != 0 or (flags & FD != 0) != is_fd
        if is_strange or row[_LENGTH] != payload_bytes(is_fine, is_fd, of_node):
            others += 1
            continue
        if flags & ERROR:
            give_back(node, tpdo, groups, controllers)
            continue
        sent += 1
        controllers.counts[node, SENT] += 1
        note_sent(node, group, now, is_fine, controllers.rule[node], law, groups, row[_DATA:])
        _note_way(node, group, 0, groups)
    return sent, others


@njit(cache=True, nogil=True)
def _has_budget(node: int, group: int, groups: Groups, controllers: Controllers) -> bool:
    """Tell whether a node may send: refreshes always, news while bits are left, details while news would find some."""
    reason = groups.reason[node, group]
    if controllers.budget[node] == 0 or reason == REFRESH:
        return True
    coarse = controllers.frame_bits[node, 0]
    of_node = groups.level.shape[1]
    frames_of_all = of_node // carried(of_node, groups.is_fd[node])
    # Details leave the bits of a coarse frame for every group.
    kept = frames_of_all * coarse if reason == DETAIL else 0
    return bool(controllers.saved[node] >= controllers.frame_bits[node, groups.is_fine[node, group]] + kept)


def compile_all(law: Companding) -> None:
    """Compile what runs every millisecond, so that no bus waits for it: one frame of one node, there and back."""
    groups, controllers = new_groups(1, 1), new_controllers(np.ones((1, 2), np.int64), 1)
    room, sent = frame_buffer(1), frames(1)
    controllers.cob_id[:] = sent["can_id"] = FIRST_COB_ID
    controllers.is_operational[:] = controllers.has_due[:] = True
    groups.refreshes[:], groups.refresh_at[:] = 1, 0
    sums_n = np.zeros((1, GROUP_SUMS), np.float32)
    decide_all(1, 1, 0.0, sums_n, sums_n, np.ones(1), law, groups, controllers)
    choose(0, 1, 1, 1, 1, sums_n, law, groups, controllers, room)
    give_back(0, 0, groups, controllers)
    take_echoes(frame_bytes(sent), np.zeros(BASE_ID_MASK + 1, np.int64), 1, law, groups, controllers)
