"""What the controllers of adaptive nodes hold: which frames go to the bus next, and what came of them.

A frame expires about a sample after it was made, so that its payload never gets old: a frame that has not won the bus
by then comes back, and is made anew of the next sample's sums. A node takes a frame as sent when its echo comes, and
holds then what a receiver holds.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive import (
    BLOCK_SUMS,
    FIRST_COB_ID,
    GROUP_SUMS,
    LEVELS,
    LOST_NS,
    SAVED_FRAMES,
    SAVING_S,
    TPDOS,
    Bytes,
    Companding,
    SendingRule,
    payload_bytes,
)
from dbc.canopen import BASE_ID_MASK
from dbc.frame import BRS, ECHO, ERROR, ESI, FD, FRAME, frame_bytes, frames
from nodes.adaptive.sending import (
    DETAIL,
    NEWS,
    NOT_DUE,
    REFRESH,
    Groups,
    Integers,
    Numbers,
    decide,
    make_payload,
    new_groups,
    note_sent,
    tpdo_of,
)
from skin.compiled import borrowed, njit
from skin.walsh import GROUPS

#: `Controllers.cob_id` of a TPDO that does not exist.
NO_COB_ID: Final = 0
#: Columns of `Controllers.counts`.
SENT, REFUSED = range(2)
_LONG_AGO: Final = -(1 << 40)
_ROUNDING: Final = SendingRule._fields.index("rounding")
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
    cob_id, inhibit, made_at : arrays of int64, shape (nodes, TPDOS)
        Identifier of each TPDO (`dbc.adaptive.tpdo_index`), or `NO_COB_ID`; its inhibit time and the sample of its
        newest frame, in samples.
    frame_bits : array of int64, shape (nodes, 2)
        What a coarse and a fine frame take of a budget.
    budget, saved : arrays of float64, shape (nodes,)
        Bits a second that a node may send, 0 for no limit, and bits that it has saved up.
    counts : array of int64, shape (nodes, 2)
        Frames sent, and frames that found no room in the transmit queue.
    """

    cob_id: Integers
    inhibit: Integers
    made_at: Integers
    frame_bits: Integers
    budget: Numbers
    saved: Numbers
    counts: Integers


def new_controllers(frame_bits: Integers) -> Controllers:
    """Return the controllers of nodes that have sent nothing and have no limit; `frame_bits` as in `Controllers`."""
    nodes = len(frame_bits)
    return Controllers(
        cob_id=np.full((nodes, TPDOS), NO_COB_ID, np.int64),
        inhibit=np.zeros((nodes, TPDOS), np.int64),
        made_at=np.full((nodes, TPDOS), _LONG_AGO, np.int64),
        frame_bits=frame_bits.copy(),
        budget=np.zeros(nodes),
        saved=np.zeros(nodes),
        counts=np.zeros((nodes, 2), np.int64),
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
    return Chosen(can_id, node, tpdo, length, np.zeros((count, payload_bytes(True, True)), np.uint8))


@njit(cache=True, nogil=True)
def rule_of(rules: Numbers, node: int) -> SendingRule:
    """Return a node's row of an array of rules, shape (nodes, 13)."""
    row = rules[node]
    return SendingRule(
        row[0],
        row[1],
        row[2],
        row[3],
        row[4],
        int(row[5]),
        row[6],
        int(row[7]),
        int(row[8]),
        int(row[9]),
        int(row[10]),
        int(row[11]),
        int(row[12]),
    )


@njit(cache=True, nogil=True)
def decide_all(  # noqa: PLR0917  compiled functions take no keywords
    now: int,
    now_ns: int,
    passed_s: float,
    is_operational: npt.NDArray[np.bool_],
    sums_n: npt.NDArray[np.float32],
    variance_n2: npt.NDArray[np.float32],
    noise_n2: Numbers,
    rules: Numbers,
    law: Companding,
    groups: Groups,
    controllers: Controllers,
    has_due: npt.NDArray[np.bool_],
) -> bool:
    """Decide what each node is to send, as `nodes.adaptive.sending.decide`; save up budgets.

    Parameters
    ----------
    passed_s : float
        Time since the last decision.
    has_due : array of bool, shape (nodes,)
        Written: whether a node has anything to send.

    Returns
    -------
    bool
        Whether any node has.
    """
    groups, controllers = borrowed(groups), borrowed(controllers)
    budget, saved, under_way, level = controllers.budget, controllers.saved, groups.under_way, groups.level
    for node in range(is_operational.size):
        has_due[node] = False
        if budget[node] > 0:
            least = float(SAVED_FRAMES * controllers.frame_bits[node, 0])
            most = max(least, budget[node] * SAVING_S)
            # Refreshes go whatever is saved. Without a limit, their debt would hold news back for minutes.
            owed = max(saved[node], -least)
            saved[node] = min(most, owed + budget[node] * passed_s)
        if not is_operational[node]:
            continue
        for group in range(GROUPS):
            if 0 < under_way[node, group] < now_ns:
                under_way[node, group] = 0
    _find_quiet(now, is_operational, sums_n, rules, law, groups, has_due)
    for node in range(is_operational.size):
        if has_due[node]:
            has_due[node] = False
            decide(node, now, sums_n[node], variance_n2[node], noise_n2[node], rule_of(rules, node), law, groups)
            for group in range(GROUPS):
                is_free = under_way[node, group] == 0
                has_due[node] = has_due[node] or (is_free and level[node, group] != NOT_DUE)
    return bool(has_due.any())


@njit(cache=True, nogil=True, fastmath=True)  # so that the largest of eight is found in one step
def _find_quiet(  # noqa: PLR0917  compiled functions take no keywords
    now: int,
    is_operational: npt.NDArray[np.bool_],
    sums_n: npt.NDArray[np.float32],
    rules: Numbers,
    law: Companding,
    groups: Groups,
    needs_look: npt.NDArray[np.bool_],
) -> None:
    """Silence groups whose receivers are up to date and that need no refresh. Tell which nodes have other groups.

    Most nodes have none, and `decide` takes longer.
    """
    known_n, refreshes, refresh_at = groups.known_n, groups.refreshes, groups.refresh_at
    since, level, reason, is_fine, under_way = (
        groups.since,
        groups.level,
        groups.reason,
        groups.is_fine,
        groups.under_way,
    )
    for node in range(is_operational.size):
        if not is_operational[node]:
            continue
        bound = rules[node, _ROUNDING] * law.fine_n
        for group in range(GROUPS):
            if under_way[node, group] > 0:
                continue
            largest = 0.0
            for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
                largest = max(largest, abs(sums_n[node, place] - known_n[node, place]))
            if largest > bound or (refreshes[node, group] > 0 and now >= refresh_at[node, group]):
                needs_look[node] = True
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
    sums_n: npt.NDArray[np.float32],
    law: Companding,
    groups: Groups,
    controllers: Controllers,
    has_due: npt.NDArray[np.bool_],
    chosen: Chosen,
) -> int:
    """Make the most urgent frames of nodes `first` to `last` - 1, at most `most`, and return how many.

    The frames, which expire at `until_ns`, are under way from now on.
    """
    groups, controllers = borrowed(groups), borrowed(controllers)
    keys, count = np.empty((last - first) * GROUPS, np.int64), 0
    for node in range(first, last):
        if has_due[node]:
            before = count
            for group in range(GROUPS):
                if groups.level[node, group] == NOT_DUE or groups.under_way[node, group] > 0:
                    continue
                tpdo = tpdo_of(node, group, groups)
                cob_id = controllers.cob_id[node, tpdo]
                is_inhibited = now - controllers.made_at[node, tpdo] < controllers.inhibit[node, tpdo]
                if cob_id == NO_COB_ID or is_inhibited or not _has_budget(node, group, groups, controllers):
                    continue
                keys[count] = (cob_id << 32) + node * GROUPS + group
                if groups.is_fd[node] and count > before:  # one frame for all groups: that of the most urgent
                    keys[before] = min(keys[before], keys[count])
                else:
                    count += 1
    keys[:count].sort()
    done = 0
    for key in keys[:count]:
        place = key & 0xFFFFFFFF
        node, group = place // GROUPS, place % GROUPS
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
def give_back(node: int, tpdo: int, groups: Groups, controllers: Controllers) -> None:
    """Take note of a frame that was not sent."""
    group = tpdo % GROUPS
    if groups.under_way[node, group] > 0:
        _note_way(node, group, 0, groups)
        controllers.made_at[node, tpdo] = _LONG_AGO
        controllers.saved[node] += controllers.frame_bits[node, int(is_fine_tpdo(tpdo))]


@njit(cache=True, nogil=True)
def is_fine_tpdo(tpdo: int) -> bool:
    """Tell whether the frames of a TPDO (`dbc.adaptive.tpdo_index`) are fine."""
    return tpdo >= GROUPS * LEVELS


@njit(cache=True, nogil=True)
def _note_way(node: int, group: int, until_ns: int, groups: Groups) -> None:
    """Set until when the controller may hold a frame of a group, on CAN FD of all groups."""
    if groups.is_fd[node]:
        groups.under_way[node] = until_ns
    else:
        groups.under_way[node, group] = until_ns


@njit(cache=True, nogil=True)
def take_echoes(  # noqa: PLR0917  compiled functions take no keywords
    rows: npt.NDArray[np.uint8],
    place_of: npt.NDArray[np.int64],
    now: int,
    rules: Numbers,
    law: Companding,
    groups: Groups,
    controllers: Controllers,
) -> tuple[int, int]:
    """Take note of the nodes' own frames among received ones; return how many were sent, and the number of others.

    Parameters
    ----------
    rows : array of uint8, shape (n, bytes of FRAME)
    place_of : array of int64, shape (BASE_ID_MASK + 1,)
        TPDOS · node + TPDO of an identifier, -1 for all others.
    """
    groups, controllers = borrowed(groups), borrowed(controllers)
    sent, others = 0, 0
    for row in rows:
        can_id = int(row[_CAN_ID]) | int(row[_CAN_ID + 1]) << 8 | int(row[_CAN_ID + 2]) << 16
        flags = int(row[_FLAGS])
        place = place_of[can_id] if can_id <= BASE_ID_MASK else -1
        if place < 0 or flags & ECHO == 0:
            others += 1
            continue
        node, tpdo = place // TPDOS, place % TPDOS
        group, is_fine, is_fd = tpdo % GROUPS, is_fine_tpdo(tpdo), groups.is_fd[node]
        is_strange = flags & ~(_PLAIN_FD if is_fd else _PLAIN) != 0 or (flags & FD != 0) != is_fd
        if is_strange or row[_LENGTH] != payload_bytes(is_fine, is_fd):
            others += 1
            continue
        if flags & ERROR:
            give_back(node, tpdo, groups, controllers)
            continue
        sent += 1
        controllers.counts[node, SENT] += 1
        note_sent(node, group, now, is_fine, rule_of(rules, node), law, groups, row[_DATA:])
        _note_way(node, group, 0, groups)
    return sent, others


@njit(cache=True, nogil=True)
def _has_budget(node: int, group: int, groups: Groups, controllers: Controllers) -> bool:
    """Tell whether a node may send: refreshes always, news while bits are left, details while news would find some."""
    reason = groups.reason[node, group]
    if controllers.budget[node] == 0 or reason == REFRESH:
        return True
    coarse = controllers.frame_bits[node, 0]
    frames_of_all = 1 if groups.is_fd[node] else GROUPS
    # Details leave the bits of a coarse frame for every group.
    kept = frames_of_all * coarse if reason == DETAIL else 0
    return bool(controllers.saved[node] >= controllers.frame_bits[node, groups.is_fine[node, group]] + kept)


def compile_all(law: Companding) -> None:
    """Compile what runs every millisecond, so that no bus waits for it: one frame of one node, there and back."""
    groups, controllers = new_groups(1), new_controllers(np.ones((1, 2), np.int64))
    room, sent = frame_buffer(1), frames(1)
    controllers.cob_id[:] = sent["can_id"] = FIRST_COB_ID
    groups.refreshes[:], groups.refresh_at[:] = 1, 0
    sums_n, rules = np.zeros((1, BLOCK_SUMS), np.float32), np.array([SendingRule()], np.float64)
    yes = np.ones(1, np.bool_)
    decide_all(1, 1, 0.0, yes, sums_n, sums_n, np.ones(1), rules, law, groups, controllers, yes)
    choose(0, 1, 1, 1, 1, sums_n, law, groups, controllers, yes, room)
    give_back(0, 0, groups, controllers)
    take_echoes(frame_bytes(sent), np.zeros(BASE_ID_MASK + 1, np.int64), 1, rules, law, groups, controllers)
