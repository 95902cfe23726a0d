"""Which frames go to the bus next, what a budget lets through, and what comes of echoes."""

import numpy as np
import pytest

from dbc.adaptive import cob_id, companding
from dbc.frame import BRS, ECHO, ERROR, ESI, EXTENDED, FD, REMOTE, frame_bytes
from nodes.adaptive.controllers import (
    choose,
    decide_all,
    frame_buffer,
    give_back,
    new_controllers,
    take_echoes,
)
from nodes.adaptive.sending import DETAIL, NEWS, NOT_DUE, REFRESH, new_groups
from tests.bus.harness import frame
from tests.layouts import BLOCK_SUMS

LAW = companding(0.02, 0.5e-3, BLOCK_SUMS)
NODES, GROUPS, MS = 3, 4, 1_000_000
#: A classic frame of 8 bytes with the most stuff bits, and intermission.
FRAME_BITS = 135
#: On CAN FD a fine frame is longer; here it is everywhere, to be told from a coarse one.
FINE_BITS = 150


class Controllers:
    """Some nodes, whose frames the test decides."""

    def __init__(self) -> None:
        self.groups = new_groups(NODES, GROUPS)
        self.controllers = new_controllers(np.array([[FRAME_BITS, FINE_BITS]] * NODES), GROUPS)
        self.sums_n = np.full((NODES, 32), 0.01, np.float32)
        self.has_due, self.room = self.controllers.has_due, frame_buffer(16)
        for node in range(NODES):
            for group in range(GROUPS):
                for level in range(6):
                    self.controllers.cob_id[node, 4 * (5 - level) + group] = cob_id(
                        node, level, group, False, groups=GROUPS
                    )
                for level in range(2):
                    self.controllers.cob_id[node, 24 + 4 * (1 - level) + group] = cob_id(
                        node, level, group, True, groups=GROUPS
                    )

    def want(self, node: int, group: int, level: int, reason: int = NEWS, is_fine: int = 0) -> None:
        self.has_due[node] = True
        self.groups.level[node, group], self.groups.reason[node, group] = level, reason
        self.groups.is_fine[node, group] = is_fine

    def choose(self, now: int = 100, first: int = 0, last: int = NODES, most: int = 16) -> list[int]:
        parts = self.sums_n, LAW, self.groups, self.controllers, self.room
        count = choose(first, last, now, 5 * MS, most, *parts)
        return self.room.can_id[:count].tolist()

    def decide(
        self, passed_s: float, now: int = 1, now_ns: int = 1, is_operational: bool = True, noise_n2: float = 1e-9
    ) -> list[bool]:
        self.controllers.is_operational[:] = is_operational
        variance_n2, noises_n2 = np.zeros((NODES, 32), np.float32), np.full(NODES, noise_n2)
        parts = self.sums_n, variance_n2, noises_n2, LAW, self.groups, self.controllers
        decide_all(now, now_ns, passed_s, *parts)
        return self.has_due.tolist()


@pytest.fixture
def made() -> Controllers:
    return Controllers()


def test_the_most_urgent_frames_of_all_nodes_go_first(made: Controllers) -> None:
    made.want(0, 1, 0)
    made.want(2, 0, 5)
    made.want(2, 2, 1, DETAIL, is_fine=1)
    made.want(1, 3, 5)
    made.want(1, 2, 4)
    expected = [
        cob_id(2, 5, 0, False, GROUPS),
        cob_id(1, 5, 3, False, GROUPS),
        cob_id(1, 4, 2, False, GROUPS),
        cob_id(0, 0, 1, False, GROUPS),
    ]
    expected.append(cob_id(2, 1, 2, True, GROUPS))  # details after all news
    assert made.choose(most=3) == expected[:3]
    assert made.room.node[:3].tolist() == [2, 1, 1]
    assert made.room.tpdo[:3].tolist() == [0, 3, 6]
    assert made.room.length[:3].tolist() == [8, 8, 8]
    # What is under way is not sent twice; a frame is given up 500 ms after it has expired.
    assert made.groups.under_way[2, 0] == 505 * MS
    assert made.choose() == expected[3:]
    assert made.choose() == []


def test_frames_of_one_bus_only_are_chosen(made: Controllers) -> None:
    for node in range(NODES):
        made.want(node, 0, 3)
    assert made.choose(first=1, last=2) == [cob_id(1, 3, 0, False, GROUPS)]
    assert made.choose() == [cob_id(0, 3, 0, False, GROUPS), cob_id(2, 3, 0, False, GROUPS)]


def test_inhibit_time_counts_from_the_newest_frame_of_the_tpdo(made: Controllers) -> None:
    made.controllers.inhibit[:] = 20
    made.want(0, 0, 3)
    assert made.choose(now=100) == [cob_id(0, 3, 0, False, GROUPS)]
    made.groups.under_way[:] = 0
    assert made.choose(now=119) == []
    made.want(0, 0, 4)  # another TPDO
    assert made.choose(now=119) == [cob_id(0, 4, 0, False, GROUPS)]
    made.groups.under_way[:] = 0
    made.want(0, 0, 3)
    assert made.choose(now=120) == [cob_id(0, 3, 0, False, GROUPS)]
    # A frame that was not sent does not count.
    give_back(0, 8, made.groups, made.controllers)
    assert made.choose(now=121) == [cob_id(0, 3, 0, False, GROUPS)]


def test_a_tpdo_without_identifier_and_a_silent_group_send_nothing(made: Controllers) -> None:
    made.want(0, 0, 3)
    made.want(0, 1, NOT_DUE)
    assert (new_controllers(np.ones((1, 2), np.int64), GROUPS).cob_id == 0).all()
    made.controllers.cob_id[0, 8] = 0
    assert made.choose() == []


def test_no_inhibit_time_holds_the_first_frame_or_one_that_was_given_back(made: Controllers) -> None:
    made.controllers.inhibit[:] = 6553  # 1800h:3 at its end, in samples
    for _ in range(2):
        made.want(0, 0, 3)
        assert made.choose(now=1) == [cob_id(0, 3, 0, False, GROUPS)]
        assert made.choose(now=1) == []
        give_back(0, 8, made.groups, made.controllers)


def test_there_is_room_for_the_longest_payload() -> None:
    room = frame_buffer(3)
    assert (room.payload.shape, room.can_id.shape) == ((3, 64), (3,))


@pytest.mark.parametrize(
    ("saved", "reason", "goes"),
    [
        (FRAME_BITS - 1, NEWS, False),
        (FRAME_BITS, NEWS, True),
        (4 * FRAME_BITS + FINE_BITS - 1, DETAIL, False),  # four coarse frames are kept for news
        (4 * FRAME_BITS + FINE_BITS, DETAIL, True),
        (-1000, REFRESH, True),
    ],
)
def test_a_budget_lets_refreshes_through_and_keeps_room_for_news(
    made: Controllers, saved: int, reason: int, goes: bool
) -> None:
    made.controllers.budget[0], made.controllers.saved[0] = 1000, saved
    made.want(0, 0, 1, reason, is_fine=int(reason == DETAIL))
    assert len(made.choose()) == goes
    assert made.controllers.saved[0] == saved - (FINE_BITS if reason == DETAIL else FRAME_BITS) * goes
    tpdo = 24 if reason == DETAIL else 16
    give_back(0, tpdo, made.groups, made.controllers)
    assert made.controllers.saved[0] == saved
    give_back(0, tpdo, made.groups, made.controllers)  # nothing is under way any more
    assert made.controllers.saved[0] == saved


@pytest.mark.parametrize(("saved", "goes"), [(FRAME_BITS + FINE_BITS - 1, False), (FRAME_BITS + FINE_BITS, True)])
def test_details_on_can_fd_leave_room_for_the_one_frame_of_all_groups(
    made: Controllers, saved: int, goes: bool
) -> None:
    made.groups.is_fd[0] = True
    made.controllers.budget[0], made.controllers.saved[0] = 1000, saved
    made.want(0, 2, 0, DETAIL, is_fine=1)
    assert len(made.choose()) == goes
    assert made.controllers.saved[0] == saved - FINE_BITS * goes
    assert bool((made.groups.under_way[0] == 505 * MS).all()) == goes


def test_one_frame_on_can_fd_carries_the_most_urgent_identifier_and_others_keep_theirs(made: Controllers) -> None:
    made.groups.is_fd[1] = True
    for group, level in enumerate((1, 4, 5, 2)):
        made.want(1, group, level)
    made.want(0, 0, 3)
    made.want(2, 1, 0)
    expected = [
        cob_id(1, 5, 0, False, GROUPS),
        cob_id(0, 3, 0, False, GROUPS),
        cob_id(2, 0, 1, False, GROUPS),
    ]
    assert made.choose() == expected
    assert made.room.length[:3].tolist() == [32, 8, 8]
    assert (made.groups.under_way[1] > 0).all()
    give_back(1, 0, made.groups, made.controllers)
    assert not made.groups.under_way[1].any()


def test_without_a_budget_everything_goes(made: Controllers) -> None:
    made.controllers.saved[0] = -9999
    made.want(0, 0, 1, DETAIL, is_fine=1)
    assert len(made.choose()) == 1


def test_budgets_are_saved_up_to_eight_frames_or_a_quarter_of_a_second(made: Controllers) -> None:
    made.controllers.budget[:] = 1000, 24_000, 0
    made.decide(0.1)
    assert made.controllers.saved.tolist() == [100, 2400, 0]
    made.decide(9.0, is_operational=False)
    assert made.controllers.saved.tolist() == [8 * FRAME_BITS, 6000, 0]
    made.controllers.saved[:] = -8 * FRAME_BITS - 500, -200, -200
    made.decide(0.1)  # what refreshes owe has a limit, too
    assert made.controllers.saved.tolist() == [-8 * FRAME_BITS + 100, 2200, -200]


def test_nodes_that_run_and_have_news_are_due_and_others_not(made: Controllers) -> None:
    made.sums_n[1] = 0
    assert made.decide(0.0) == [True, False, True]
    assert (made.groups.level[1] == NOT_DUE).all()
    assert (made.groups.level[[0, 2]] > NOT_DUE).all()
    assert made.decide(0.0, is_operational=False) == [False] * NODES
    made.groups.refreshes[1, 2], made.groups.refresh_at[1, 2] = 1, 50
    assert made.decide(0.0, now=49)[1] is False
    assert made.decide(0.0, now=50)[1] is True
    assert made.groups.level[1].tolist() == [NOT_DUE, NOT_DUE, 0, NOT_DUE]
    assert made.groups.reason[1, 2] == REFRESH


def test_news_is_a_difference_from_what_is_known_of_any_free_group_of_any_running_node(made: Controllers) -> None:
    made.groups.known_n[:] = made.sums_n
    assert made.decide(0.0) == [False] * NODES
    made.sums_n[2, 31] *= -1
    assert made.decide(0.0) == [False, False, True]
    made.groups.under_way[2, 0] = 100
    assert made.decide(0.0) == [False, False, True]
    variance_n2, noise_n2 = np.zeros((NODES, 32), np.float32), np.full(NODES, 1e-9)
    parts = variance_n2, noise_n2, LAW, made.groups, made.controllers
    made.controllers.is_operational[:] = False, True, True
    assert decide_all(1, 1, 0.0, made.sums_n, *parts)
    assert made.has_due.tolist() == [False, False, True]
    made.sums_n[2, 31] *= -1
    assert not decide_all(1, 1, 0.0, made.sums_n, *parts)
    made.sums_n[2] *= -1
    assert decide_all(1, 1, 0.0, made.sums_n, *parts)


def test_news_that_has_gone_is_forgotten(made: Controllers) -> None:
    """When it comes back, it has not waited since then."""
    made.groups.known_n[:] = made.sums_n
    made.groups.since[1, 2], made.groups.level[1, 2] = 5, 3
    made.groups.reason[1, 2], made.groups.is_fine[1, 2] = REFRESH, 1
    made.decide(0.0)
    told = [each[1, 2] for each in (made.groups.since, made.groups.level, made.groups.reason, made.groups.is_fine)]
    assert told == [-1, -1, 0, 0]


def test_a_frame_that_is_under_way_is_waited_for_until_it_is_given_up(made: Controllers) -> None:
    made.sums_n[1:] = 0
    made.groups.under_way[0] = 100
    assert made.decide(0.0, now_ns=100) == [False] * NODES
    assert (made.groups.under_way[0] == 100).all()
    assert made.decide(0.0, now_ns=101) == [True, False, False]
    assert not made.groups.under_way.any()


def test_a_difference_below_the_noise_makes_no_node_due(made: Controllers) -> None:
    assert made.decide(0.0, noise_n2=1e9) == [False] * NODES
    made.groups.under_way[1] = 100
    assert made.decide(0.0, noise_n2=1e-9) == [True, False, True]
    made.groups.under_way[1, 3] = 0  # one group is free again
    assert made.decide(0.0, noise_n2=1e-9) == [True, True, True]
    made.groups.under_way[:, 1:] = 100
    made.groups.level[:, 1:] = 3
    assert made.decide(0.0, noise_n2=1e9) == [False] * NODES


@pytest.mark.parametrize("is_fd", [False, True])
def test_an_echo_has_the_flags_of_its_bus(made: Controllers, is_fd: bool) -> None:
    made.groups.is_fd[:] = is_fd
    places = np.full(0x800, -1, np.int64)
    places[0x123] = 32 * 1
    payload = bytes([128] * (32 if is_fd else 8))

    def taken(flags: int) -> tuple[int, int]:
        row = frame_bytes(frame(0x123, payload, flags))
        return take_echoes(row, places, 7, LAW, made.groups, made.controllers)

    kinds = (FD, FD | BRS, FD | ESI, FD | BRS | ESI) if is_fd else (0,)
    assert {taken(ECHO | kind) for kind in kinds} == {(1, 0)}
    assert {taken(ECHO | ERROR | kind) for kind in kinds} == {(0, 0)}
    strange = [ECHO, ECHO | BRS] if is_fd else [ECHO | FD, ECHO | BRS, ECHO | ESI]
    strange += [ECHO | kinds[0] | other for other in (EXTENDED, REMOTE)]
    assert {taken(flags) for flags in (*strange, *kinds)} == {(0, 1)}
    assert made.controllers.counts[1].tolist() == [len(kinds), 0]


def test_only_own_frames_are_taken_as_echoes(made: Controllers) -> None:
    places = np.full(0x800, -1, np.int64)
    identifier = cob_id(1, 3, 2, False, GROUPS)
    places[identifier] = 32 * 1 + 4 * (5 - 3) + 2
    made.groups.under_way[1, 2], made.groups.since[1, 2] = 999, 5
    made.controllers.saved[1] = 10
    rows = frame_bytes(
        np.concatenate(
            [
                frame(identifier, bytes(8)),
                frame(identifier, bytes(7), ECHO),
                frame(identifier, bytes(8), ECHO | EXTENDED),
                frame(identifier, bytes(8), ECHO | REMOTE),
                frame(identifier | 0x10000, bytes(8), ECHO | EXTENDED),
                frame(identifier + 1, bytes(8), ECHO),
                frame(0x7FF, bytes(8), ECHO),
            ]
        )
    )
    assert take_echoes(rows, places, 7, LAW, made.groups, made.controllers) == (0, 7)
    assert made.groups.under_way[1, 2] == 999
    refused = frame_bytes(frame(identifier, bytes(8), ECHO | ERROR))
    assert take_echoes(refused, places, 7, LAW, made.groups, made.controllers) == (0, 0)
    assert (made.groups.under_way[1, 2], made.controllers.saved[1]) == (0, 10 + FRAME_BITS)
    made.groups.under_way[1, 2] = 999
    payload = bytes((200, *[128] * 7))
    sent = frame_bytes(frame(identifier, payload, ECHO))
    assert take_echoes(sent, places, 7, LAW, made.groups, made.controllers) == (1, 0)
    assert made.controllers.counts.tolist() == [[0, 0], [1, 0], [0, 0]]
    assert (made.groups.under_way[1, 2], made.groups.since[1, 2], made.groups.sent_at[1, 2]) == (0, -1, 7)
    assert made.groups.known_n[1, 16] > 0
    assert not made.groups.known_n[[0, 2]].any()
