"""When a node sends which sums: news first, then details, then what has not been said for long."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive import (
    BLOCK_SUMS,
    FINE_LEVELS,
    FINE_LIMIT,
    GROUP_SUMS,
    LEVELS,
    Bytes,
    Companding,
    SendingRule,
    check_of,
    coarse_code,
    coarse_step,
    fine_steps,
    hold_coarse,
    pack_fine,
    unpack_fine,
)
from skin.compiled import njit
from skin.walsh import GROUPS

#: Why a frame is to be sent.
NEWS, DETAIL, REFRESH = range(3)
#: Nothing is to be sent.
SILENT: Final = -1
_LONG_AGO: Final = -(1 << 30)
_NEVER: Final = 1 << 60

Integers = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.float64]


class Groups(NamedTuple):
    """What the nodes of a bus know of what they sent; times in samples.

    Attributes
    ----------
    known_n, coarse_n : arrays of float64, shape (nodes, BLOCK_SUMS)
        What a receiver that got every frame shows, and the values of the newest coarse frames.
    check : array of int64, shape (nodes, GROUPS)
        Check of the newest coarse frame, -1 before the first.
    since, sent_at, refresh_at, refresh_after, refreshes, fine_turn : arrays of int64, shape (nodes, GROUPS)
        Since when there is news (-1: none); when the last frame of any kind was sent; when a refresh is
        due, the time between refreshes, how many are left, and whether the next is fine.
    level, reason, is_fine : arrays of int64, shape (nodes, GROUPS)
        What is to be sent: urgency or `SILENT`, why, and in which kind of frame.
    is_zero : array of int64, shape (nodes, GROUPS)
        Whether the newest fine payload was made of sums that are all 0.
    is_wanted : array of int64, shape (nodes, GROUPS)
        Whether somebody asked for a coarse frame that was not sent yet (`ask`).
    under_way : array of int64, shape (nodes, GROUPS)
        Until when a controller may hold a frame of the group, in nanoseconds; 0: it holds none. Nothing is decided
        while it may.
    """

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


def new_groups(nodes: int) -> Groups:
    """Return the state of nodes that have sent nothing."""

    def full(value: int) -> Integers:
        return np.full((nodes, GROUPS), value, np.int64)

    return Groups(
        known_n=np.zeros((nodes, BLOCK_SUMS)),
        coarse_n=np.zeros((nodes, BLOCK_SUMS)),
        check=full(-1),
        since=full(-1),
        sent_at=full(_LONG_AGO),
        refresh_at=full(_NEVER),
        refresh_after=full(0),
        refreshes=full(0),
        fine_turn=full(0),
        level=full(SILENT),
        reason=full(NEWS),
        is_fine=full(0),
        is_zero=full(0),
        is_wanted=full(0),
        under_way=full(0),
    )


def ask(node: int, group: int, now: int, groups: Groups) -> None:
    """Have a group sent in a coarse frame as a refresh, whatever was sent before."""
    groups.is_wanted[node, group] = 1
    groups.refresh_at[node, group] = now
    groups.refreshes[node, group] = max(1, groups.refreshes[node, group])


def noise_threshold_n2(noise_n: Numbers, noise_ratio: float | Numbers) -> Numbers:
    """Return the part of the threshold that is the noise's, newtons squared, for nodes of the noise `noise_n`."""
    return GROUP_SUMS * BLOCK_SUMS * np.square(noise_ratio * noise_n)


@njit(cache=True, nogil=True)
def look(  # noqa: PLR0917  compiled functions take no keywords
    node: int,
    now: int,
    sums_n: npt.NDArray[np.float32],
    variance_n2: npt.NDArray[np.float32],
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
    sums_n, variance_n2 : arrays of float32, shape (BLOCK_SUMS,)
        The node's sums now, and their variances.
    noise_n2 : float
        See `noise_threshold_n2`.
    """
    for group in range(GROUPS):
        if groups.under_way[node, group] == 0:
            _look_at_group(node, group, now, sums_n, variance_n2, noise_n2, rule, law, groups)


@njit(cache=True, nogil=True)
def _look_at_group(  # noqa: PLR0917  compiled functions take no keywords
    node: int,
    group: int,
    now: int,
    sums_n: npt.NDArray[np.float32],
    variance_n2: npt.NDArray[np.float32],
    noise_n2: float,
    rule: SendingRule,
    law: Companding,
    groups: Groups,
) -> None:
    coarse_n2, fine_n2 = _differences_n2(node, group, sums_n, rule, law, groups)
    variance = 0.0
    for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
        variance += variance_n2[place]
    threshold = noise_n2 + rule.variance_ratio * variance
    level, reason, is_fine = SILENT, NEWS, 0
    wait = now - groups.sent_at[node, group]
    if coarse_n2 > threshold:
        if groups.since[node, group] < 0:
            groups.since[node, group] = now
        if wait >= rule.inhibit:
            level = _urgency(coarse_n2 / threshold, now - groups.since[node, group], rule)
        if groups.is_wanted[node, group] == 1:
            reason = REFRESH  # what was asked for is sent whatever the budget
    else:
        groups.since[node, group] = -1
        if groups.refreshes[node, group] > 0 and now >= groups.refresh_at[node, group]:
            level = min(LEVELS - 1, (now - groups.refresh_at[node, group]) // rule.overdue)
            may_be_fine = groups.fine_turn[node, group] == 1 and groups.is_wanted[node, group] == 0
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
def _differences_n2(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, sums_n: npt.NDArray[np.float32], rule: SendingRule, law: Companding, groups: Groups
) -> tuple[float, float]:
    """Return the squared difference of a group from what is known, as coarse frames and as fine frames tell it.

    A coarse frame with the code of what is known changes nothing, however far the sum is from it.
    """
    first = GROUP_SUMS * group
    coarse_n2, fine_n2 = 0.0, 0.0
    for place in range(first, first + GROUP_SUMS):
        now_n, known = float(sums_n[place]), groups.known_n[node, place]
        error, is_mean = now_n - known, place == 0
        is_far = abs(error) > rule.rounding * coarse_step(known, is_mean, law)
        if is_far and coarse_code(now_n, is_mean, law) != coarse_code(known, is_mean, law):
            coarse_n2 += error * error
        if abs(error) > rule.rounding * law.fine_n:
            fine_n2 += error * error
    return coarse_n2, fine_n2


@njit(cache=True, nogil=True)
def _is_in_reach(node: int, group: int, sums_n: npt.NDArray[np.float32], law: Companding, groups: Groups) -> bool:
    """Tell whether a fine frame can tell all sums of a group."""
    if groups.check[node, group] < 0:
        return False
    for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
        away = fine_steps(float(sums_n[place]), law) - fine_steps(groups.coarse_n[node, place], law)
        if abs(away) > FINE_LIMIT:
            return False
    return True


@njit(cache=True, nogil=True)
def _urgency(ratio: float, waited: int, rule: SendingRule) -> int:
    """Return the level of news; the highest is for what waited, so that no motion of others holds it back for ever."""
    if waited >= rule.patience:
        return LEVELS - 1
    # Compared before it is made whole: with a tiny number of the rule it is too large for an integer.
    return int(min(float(LEVELS - 2), (np.log2(ratio) + waited / rule.doubling) / rule.level_ratio))


@njit(cache=True, nogil=True)
def frame_level(node: int, group: int, groups: Groups) -> int:
    """Return the urgency that the identifier of a group's frame carries: fine frames know fewer levels."""
    level = groups.level[node, group]
    return int(min(level, FINE_LEVELS - 1)) if groups.is_fine[node, group] else int(level)


@njit(cache=True, nogil=True)
def make_payload(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, sums_n: npt.NDArray[np.float32], law: Companding, groups: Groups, payload: Bytes
) -> None:
    """Write the payload of a group's frame, 8 bytes, of the present sums."""
    first = GROUP_SUMS * group
    if groups.is_fine[node, group]:
        steps, is_zero = np.empty(GROUP_SUMS, np.int64), True
        for place in range(GROUP_SUMS):
            steps[place] = fine_steps(float(sums_n[first + place]), law)
            is_zero = is_zero and sums_n[first + place] == 0
        groups.is_zero[node, group] = int(is_zero)
        pack_fine(steps, groups.check[node, group], payload)
    else:
        for place in range(GROUP_SUMS):
            payload[place] = coarse_code(float(sums_n[first + place]), first + place == 0, law)


@njit(cache=True, nogil=True)
def note_sent(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, now: int, is_fine: bool, rule: SendingRule, law: Companding, groups: Groups, payload: Bytes
) -> None:
    """Take note of a frame that was sent: hold what a receiver holds of its payload, and plan the next refresh."""
    first = GROUP_SUMS * group
    mine = slice(first, first + GROUP_SUMS)
    if not is_fine:
        hold_coarse(payload, first, True, law, groups.known_n[node], groups.coarse_n[node])
        is_zero = True
        for place in range(first, first + GROUP_SUMS):
            is_zero = is_zero and groups.coarse_n[node, place] == 0
        groups.check[node, group] = check_of(payload)
    elif groups.check[node, group] == int(payload[GROUP_SUMS - 1]):
        unpack_fine(payload, groups.coarse_n[node, mine], law, groups.known_n[node, mine])
        is_zero = groups.is_zero[node, group] == 1
    else:
        return
    _plan_refresh(node, group, now, is_fine, is_zero, rule, groups)
    groups.sent_at[node, group] = now
    groups.since[node, group], groups.level[node, group] = -1, SILENT


@njit(cache=True, nogil=True)
def _plan_refresh(  # noqa: PLR0917  compiled functions take no keywords
    node: int, group: int, now: int, is_fine: bool, is_zero: bool, rule: SendingRule, groups: Groups
) -> None:
    reason = groups.reason[node, group]
    if is_fine and groups.is_wanted[node, group]:
        return  # the coarse frame was asked for while this one was under way
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
    if reason != DETAIL or not is_fine:
        groups.refresh_at[node, group] = now + groups.refresh_after[node, group]
