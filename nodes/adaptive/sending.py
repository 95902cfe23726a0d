"""When a node sends which sums: news first, then details, then what has not been said for long."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive import (
    FINE_LEVELS,
    FINE_LIMIT,
    GROUP_SUMS,
    LEVELS,
    NO_CHECK,
    Bytes,
    Companding,
    SendingRule,
    carried,
    check_of,
    coarse_code,
    coarse_step,
    coarse_value,
    fine_steps,
    has_same_code,
    hold,
    pack_fine,
    part_of,
    parts_of,
    tpdo_index,
)
from dbc.adaptive_filter import LEAST_PART, LOG2_SERIES, Floats
from shell.compiled import njit

#: Why a frame is to be sent.
NEWS, DETAIL, REFRESH = range(3)
#: Nothing is to be sent.
NOT_DUE: Final = -1
_LONG_AGO: Final = -(1 << 30)
_NEVER: Final = 1 << 60

Integers = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class Groups(NamedTuple):
    """What nodes with the same number of groups know of what they sent; times in samples.

    Attributes
    ----------
    is_fd : array of bool, shape (nodes,)
        Whether a frame of the node carries several groups (CAN FD).
    known_n, coarse_n : arrays of float64, shape (nodes, sums)
        What a receiver that got every frame shows, and the values of the newest coarse frames.
    check : array of int64, shape (nodes, groups)
        Check of the newest coarse frame, `NO_CHECK` before the first.
    since, sent_at, refresh_at, refresh_after, refreshes, fine_turn : arrays of int64, shape (nodes, groups)
        Since when there is news (-1: none); when the last frame of any kind was sent; when a refresh is
        due, the time between refreshes, how many are left, and whether the next is fine.
    level, reason, is_fine : arrays of int64, shape (nodes, groups)
        What is to be sent: urgency or `NOT_DUE`, why, and in which kind of frame.
    is_zero : array of int64, shape (nodes, groups)
        Whether the newest fine payload was made of sums that are all 0.
    is_wanted : array of int64, shape (nodes, groups)
        Whether somebody asked for a coarse frame that was not sent yet (`ask`).
    under_way : array of int64, shape (nodes, groups)
        Until when a controller may hold a frame of the group, in nanoseconds; 0: it holds none. Nothing is decided
        while it may.
    """

    is_fd: Flags
    known_n: Numbers
    coarse_n: Numbers
    check: Integers
    since: Integers
    sent_at: Integers
    refresh_at: Integers
    refresh_after: Integers
    refreshes: Integers
    fine_turn: Integers
    level: Integers
    reason: Integers
    is_fine: Integers
    is_zero: Integers
    is_wanted: Integers
    under_way: Integers


def new_groups(nodes: int, groups: int, is_fd: bool | Flags = False) -> Groups:
    """Return the state of nodes that have sent nothing; `is_fd` of shape (nodes,), or one value for all."""

    def full(value: int) -> Integers:
        return np.full((nodes, groups), value, np.int64)

    return Groups(
        is_fd=np.full(nodes, is_fd, np.bool_),
        known_n=np.zeros((nodes, GROUP_SUMS * groups)),
        coarse_n=np.zeros((nodes, GROUP_SUMS * groups)),
        check=full(NO_CHECK),
        since=full(-1),
        sent_at=full(_LONG_AGO),
        refresh_at=full(_NEVER),
        refresh_after=full(0),
        refreshes=full(0),
        fine_turn=full(0),
        level=full(NOT_DUE),
        reason=full(NEWS),
        is_fine=full(0),
        is_zero=full(0),
        is_wanted=full(0),
        under_way=full(0),
    )


def ask(node: int, group: int, now: int, groups: Groups) -> None:
    """Have a group sent in a coarse frame as a refresh, whatever was sent before.

    A group that is asked for again keeps the urgency for which it has waited.
    """
    if not groups.is_wanted[node, group]:
        groups.refresh_at[node, group] = now
    groups.is_wanted[node, group] = 1
    groups.refreshes[node, group] = max(1, groups.refreshes[node, group])


def noise_threshold_n2(noise_n: Numbers, noise_ratio: float | Numbers, taxels: int) -> Numbers:
    """Return the part of the threshold that is the noise's, newtons squared, for nodes of `taxels` and `noise_n`."""
    return GROUP_SUMS * taxels * np.square(noise_ratio * noise_n)


@njit(cache=True, nogil=True, inline="always")
def decide(  # noqa: PLR0917  compiled functions take no keywords
    node: int,
    now: int,
    sums_n: Floats,
    variance_n2: Floats,
    noise_n2: float,
    rule: SendingRule,
    law: Companding,
    groups: Groups,
) -> None:
    """Decide what each group of a node is to send.

    Parameters
    ----------
    node, now : int
        Place of the node; the sample's number.
    sums_n, variance_n2 : arrays of float32, shape (sums,)
        The node's sums now, and their variances.
    noise_n2 : float
        See `noise_threshold_n2`.
    """
    for group in range(groups.level.shape[1]):
        if groups.under_way[node, group] == 0:
            _decide_group(node, group, now, sums_n, variance_n2, noise_n2, rule, law, groups)


@njit(cache=True, nogil=True, inline="always")
def _decide_group(  # noqa: PLR0917  compiled functions take no keywords
    node: int,
    group: int,
    now: int,
    sums_n: Floats,
    variance_n2: Floats,
    noise_n2: float,
    rule: SendingRule,
    law: Companding,
    groups: Groups,
) -> None:
    coarse_n2, fine_n2 = _differences_n2(group, sums_n, groups.known_n[node], rule.rounding, law)
    variance = 0.0
    for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
        variance += variance_n2[place]
    threshold = noise_n2 + rule.variance_ratio * variance
    level, reason, is_fine = NOT_DUE, NEWS, 0
    wait = now - groups.sent_at[node, group]
    overdue = min(LEVELS - 1, (now - groups.refresh_at[node, group]) // rule.overdue)
    if coarse_n2 > threshold:
        if groups.since[node, group] < 0:
            groups.since[node, group] = now
        if wait >= rule.inhibit:
            level = urgency(coarse_n2 / threshold, now - groups.since[node, group], rule)
            if groups.is_wanted[node, group] == 1:
                level, reason = max(level, overdue), REFRESH  # what was asked for is sent whatever the budget
    else:
        groups.since[node, group] = -1
        if groups.refreshes[node, group] > 0 and now >= groups.refresh_at[node, group]:
            level = overdue
            # On CAN FD a fine frame has the coarse codes, too: there is no turn to take.
            is_turn = groups.fine_turn[node, group] == 1 or groups.is_fd[node]
            may_be_fine = is_turn and groups.is_wanted[node, group] == 0
            # A fine frame knows no higher level: a refresh that waits longer is coarse, whoever's turn it is.
            may_be_fine = may_be_fine and level < FINE_LEVELS
            reason, is_fine = REFRESH, int(may_be_fine and _is_in_reach(node, group, sums_n, law, groups))
        elif (
            wait >= rule.fine_wait
            and fine_n2 > rule.fine_ratio * noise_n2 + rule.variance_ratio * variance
            and _is_in_reach(node, group, sums_n, law, groups)
        ):
            level, reason, is_fine = 0, DETAIL, 1
    groups.level[node, group], groups.reason[node, group] = level, reason
    groups.is_fine[node, group] = is_fine


@njit(cache=True, nogil=True)
def log2_of(value: float) -> float:
    """Return the binary logarithm of a number above 0, to 1e-15.

    A library's `log2` may round differently on another machine.
    """
    part, exponent = math.frexp(value)
    if part < LEAST_PART:
        part, exponent = part + part, exponent - 1
    ratio = (part - 1.0) / (part + 1.0)
    square = ratio * ratio
    total = LOG2_SERIES[-1]
    for place in range(len(LOG2_SERIES) - 2, -1, -1):
        total = LOG2_SERIES[place] + square * total
    return exponent + ratio * total


@njit(cache=True, nogil=True)
def urgency(ratio: float, waited: int, rule: SendingRule) -> int:
    """Return the level of news that exceeds its threshold by `ratio` and has waited for `waited` samples.

    The highest level is for what waited, so that no motion of others holds it back for ever.
    """
    if waited >= rule.patience:
        return LEVELS - 1
    # Compared before it is made whole: with a tiny number of the rule it is too large for an integer.
    return int(min(float(LEVELS - 2), (log2_of(ratio) + waited / rule.doubling) / rule.level_ratio))


@njit(cache=True, nogil=True, inline="always")
def _differences_n2(
    group: int, sums_n: Floats, known_n: Numbers, rounding: float, law: Companding
) -> tuple[float, float]:
    """Return the squared difference of a group from what is known, as coarse frames and as fine frames tell it.

    A coarse frame with the code of what is known changes nothing, however far the sum is from it.
    """
    first = GROUP_SUMS * group
    coarse_n2, fine_n2 = 0.0, 0.0
    for place in range(first, first + GROUP_SUMS):
        now_n, known = float(sums_n[place]), known_n[place]
        error, is_mean = now_n - known, place == 0
        if abs(error) <= rounding * law.fine_n:
            continue  # less than the least coarse step, too
        fine_n2 += error * error
        is_far = abs(error) > rounding * coarse_step(known, is_mean, law)
        if is_far and not has_same_code(now_n, known, is_mean, law):
            coarse_n2 += error * error
    return coarse_n2, fine_n2


@njit(cache=True, nogil=True)
def _is_in_reach(node: int, group: int, sums_n: Floats, law: Companding, groups: Groups) -> bool:
    """Tell whether a fine frame can tell all sums of a group: it refines the newest coarse codes, or on FD its own."""
    is_fd = groups.is_fd[node]
    if groups.check[node, group] == NO_CHECK and not is_fd:
        return False
    for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
        now_n, coarse_n = float(sums_n[place]), groups.coarse_n[node, place]
        if is_fd:
            coarse_n = coarse_value(coarse_code(now_n, place == 0, law), place == 0, law)
        if abs(fine_steps(now_n, law) - fine_steps(coarse_n, law)) > FINE_LIMIT:
            return False
    return True


@njit(cache=True, nogil=True)
def frame_level(node: int, group: int, groups: Groups) -> int:
    """Return the urgency that the identifier of a group's frame carries: fine frames know fewer levels."""
    level = groups.level[node, group]
    return int(min(level, FINE_LEVELS - 1)) if groups.is_fine[node, group] else int(level)


@njit(cache=True, nogil=True)
def tpdo_of(node: int, group: int, groups: Groups) -> int:
    """Return the TPDO (`dbc.adaptive.tpdo_index`) of the frame that a group is to be sent in."""
    is_fine, together = groups.is_fine[node, group] == 1, carried(groups.level.shape[1], groups.is_fd[node])
    return int(
        tpdo_index(frame_level(node, group, groups), group // together * together, is_fine, groups.level.shape[1])
    )


@njit(cache=True, nogil=True)
def make_payload(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, sums_n: Floats, law: Companding, groups: Groups, payload: Bytes
) -> int:
    """Write the payload of a group's frame of the present sums; return its bytes (`dbc.adaptive.payload_bytes`)."""
    is_fine, is_fd, count = groups.is_fine[node, group] == 1, groups.is_fd[node], groups.level.shape[1]
    parts, together = parts_of(is_fine, is_fd, count), carried(count, is_fd)
    for part in range(parts):
        each, is_fine_part = part_of(part, group // together * together, is_fine, is_fd, count)
        mine, first = payload[GROUP_SUMS * part : GROUP_SUMS * (part + 1)], GROUP_SUMS * each
        if is_fine_part:
            of_coarse = GROUP_SUMS * (part % together)
            coarse = payload[of_coarse : of_coarse + GROUP_SUMS]
            check = check_of(coarse) if is_fd else groups.check[node, each]
            _make_fine(node, each, check, coarse, sums_n, law, groups, mine)
        else:
            for place in range(GROUP_SUMS):
                mine[place] = coarse_code(float(sums_n[first + place]), first + place == 0, law)
    return int(GROUP_SUMS * parts)


@njit(cache=True, nogil=True)
def _make_fine(  # noqa: PLR0917  compiled functions take no keywords
    node: int,
    group: int,
    check: int,
    coarse: Bytes,
    sums_n: Floats,
    law: Companding,
    groups: Groups,
    payload: Bytes,
) -> None:
    """Write the fine payload of a group.

    On CAN FD all groups of a frame are refined as soon as one has details. A sum out of the reach of its coarse code in
    the same frame is brought as near as the reach allows.
    """
    steps, is_zero = np.empty(GROUP_SUMS, np.int64), True
    for place in range(GROUP_SUMS):
        each = GROUP_SUMS * group + place
        steps[place] = fine_steps(float(sums_n[each]), law)
        if groups.is_fd[node]:
            near = fine_steps(coarse_value(int(coarse[place]), each == 0, law), law)
            steps[place] = max(near - FINE_LIMIT, min(near + FINE_LIMIT, steps[place]))
        is_zero = is_zero and sums_n[each] == 0
    groups.is_zero[node, group] = int(is_zero)
    pack_fine(steps, check, payload)


@njit(cache=True, nogil=True)
def note_sent(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, now: int, is_fine: bool, rule: SendingRule, law: Companding, groups: Groups, payload: Bytes
) -> None:
    """Take note of a frame that was sent: hold what a receiver holds of its payload, and plan the next refresh.

    `group` and `is_fine` are those of the identifier.
    """
    is_fd, known_n, coarse_n = groups.is_fd[node], groups.known_n[node], groups.coarse_n[node]
    if not hold(payload, group, is_fine, is_fd, law, known_n, coarse_n, groups.check[node]):
        return
    for each in range(group, group + carried(groups.level.shape[1], is_fd)):
        is_zero = groups.is_zero[node, each] == 1
        if not is_fine:
            is_zero = not coarse_n[GROUP_SUMS * each : GROUP_SUMS * (each + 1)].any()
        _plan_refresh(node, each, now, is_fine, is_zero, rule, groups)
        groups.sent_at[node, each] = now
        groups.since[node, each], groups.level[node, each] = -1, NOT_DUE


@njit(cache=True, nogil=True)
def _plan_refresh(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, now: int, is_fine: bool, is_zero: bool, rule: SendingRule, groups: Groups
) -> None:
    reason, is_fd = groups.reason[node, group], groups.is_fd[node]
    if is_fine and groups.is_wanted[node, group] and not is_fd:
        return  # the coarse frame was asked for while this one was under way
    if is_fd and groups.refresh_after[node, group] == 0:
        reason = NEWS  # the first frame that carries the group
    elif is_fd and groups.level[node, group] == NOT_DUE and groups.since[node, group] < 0:
        reason = DETAIL  # the group had no news: the frame was sent for another one
    if reason == NEWS or groups.is_wanted[node, group]:
        groups.is_wanted[node, group] = 0
        groups.refresh_after[node, group] = rule.refresh
        groups.refreshes[node, group] = rule.zero_refreshes
        groups.fine_turn[node, group] = 0
    elif reason == REFRESH:
        groups.refresh_after[node, group] = min(2 * groups.refresh_after[node, group], rule.refresh_max)
        groups.refreshes[node, group] = min(groups.refreshes[node, group] - 1, rule.zero_refreshes)
        groups.fine_turn[node, group] = 1 - groups.fine_turn[node, group]
    if not is_zero:
        groups.refreshes[node, group] = _NEVER
    if reason != DETAIL or not is_fine or is_fd:
        groups.refresh_at[node, group] = now + groups.refresh_after[node, group]


def present_codes(sums_n: Any, law: Companding, groups: Groups, node: int) -> tuple[Bytes, Bytes]:
    """Return a node's coarse and fine payloads of the present sums: the contents of 2110h and 2111h.

    Returns
    -------
    coarse : array of uint8, shape (sums,)
    fine : array of uint8, shape (groups, GROUP_SUMS)
    """
    shown = Groups._make(each[node : node + 1].copy() for each in groups)
    count = shown.level.shape[1]
    codes, together = np.zeros((2, count, GROUP_SUMS), np.uint8), carried(count, shown.is_fd[0])
    for is_fine in range(2):
        shown.is_fine[:] = is_fine
        for group in range(0, count, together):
            payload = np.zeros(2 * codes[0].size, np.uint8)
            length = make_payload(0, group, sums_n, law, shown, payload)
            codes[is_fine, group : group + together] = payload[:length].reshape(-1, GROUP_SUMS)[-together:]
    return codes[0].ravel(), codes[1]
