"""Which answers to a SYNC may be those to an earlier one, bus by bus and row by row."""

import numpy as np
import pytest

from dbc.contract import Contract
from gateway.outstanding import QUIET_NS, ask, came, doubt, new_outstanding, prove, rest

WINDOW_NS = 10_000
PERIOD_NS = 10 * QUIET_NS


class Asking:
    """SYNCs on bus 0 of the small skin, whose rows are 0 to 3: two frames of each of two nodes."""

    def __init__(self, contract: Contract) -> None:
        self.now_ns = 0
        self.table, self.outstanding = contract.table, new_outstanding(contract)
        assert np.flatnonzero(contract.table.bus == 0).tolist() == [0, 1, 2, 3]
        assert contract.table.node[:4].tolist() == [0, 0, 1, 1]

    def ask(self, time_ns: int, window_ns: int = WINDOW_NS) -> list[int]:
        self.now_ns = time_ns
        ask(0, 0, time_ns, window_ns, self.table, self.outstanding)
        return np.flatnonzero(self.outstanding.may_be_old).tolist()

    def rest(self, time_ns: int) -> None:
        rest(0, time_ns, WINDOW_NS, self.table, self.outstanding)

    def came(self, *rows: int) -> None:
        for row in rows:
            came(row, self.now_ns, self.table, self.outstanding)


@pytest.fixture
def asking(small: Contract) -> Asking:
    return Asking(small)


def test_what_did_not_come_within_the_window_before_the_next_sync_may_come_after_it(asking: Asking) -> None:
    assert asking.ask(1_000) == []
    asking.came(0, 3)
    assert asking.ask(1_000 + WINDOW_NS - 1) == [1, 2]


def test_two_syncs_within_a_window_ask_for_two_frames(asking: Asking) -> None:
    asking.ask(1_000)
    asking.ask(2_000)
    asking.came(0, 0, 1, 2)
    assert asking.ask(3_000) == [1, 2, 3]
    asking.came(1, 1, 0, 2, 2, 3)
    assert asking.ask(4_000) == [3]


# What a board holds back


def hang(asking: Asking) -> int:
    """Let node 0 owe the answers to three SYNCs; return the time of the next SYNC."""
    for cycle in range(1, 4):
        asking.ask(cycle * PERIOD_NS)
        asking.came(2, 3)
    return 4 * PERIOD_NS


def test_a_debt_lasts_until_every_old_frame_has_come(asking: Asking) -> None:
    next_ns = hang(asking)
    assert asking.ask(next_ns) == [0, 1]
    asking.now_ns = next_ns + PERIOD_NS - QUIET_NS // 4
    asking.came(0, 1, 0, 1, 2, 3)  # two of four before the next SYNC
    assert asking.ask(next_ns + PERIOD_NS) == [0, 1]
    asking.came(0, 1, 0, 1, 0, 1, 2, 3)
    assert asking.ask(next_ns + 2 * PERIOD_NS) == []


@pytest.mark.parametrize(("rest_ns", "doubtful"), [(QUIET_NS, []), (QUIET_NS - 1, [0, 1])])
def test_a_node_that_sent_once_and_rests_holds_nothing_back(asking: Asking, rest_ns: int, doubtful: list[int]) -> None:
    next_ns = hang(asking) + PERIOD_NS
    asking.ask(next_ns - PERIOD_NS)
    asking.now_ns = next_ns - rest_ns
    asking.came(0, 1, 2, 3)
    assert asking.ask(next_ns) == doubtful


def test_a_node_that_sends_late_in_its_cycle_is_valid_after_three_cycles(asking: Asking) -> None:
    next_ns = hang(asking)
    doubtful = []
    for _ in range(5):
        doubtful.append(asking.ask(next_ns))
        next_ns += PERIOD_NS
        asking.now_ns = next_ns - 1
        asking.came(0, 1, 2, 3)
    assert doubtful == [[0, 1], [0, 1], [0, 1], [], []]


# SYNCs that ask for other frames


def test_the_first_answers_after_a_rest_are_doubtful_whatever_came(asking: Asking) -> None:
    asking.ask(100_000)
    asking.came(0, 1, 2, 3)
    asking.rest(200_000)
    assert asking.ask(300_000) == [0, 1, 2, 3]
    asking.came(0, 1, 2, 3)
    assert asking.ask(400_000) == []


def test_the_second_answers_of_a_node_that_sent_meanwhile_are_doubtful_too(asking: Asking) -> None:
    asking.rest(100_000)
    asking.came(2)
    assert asking.ask(200_000) == [0, 1, 2, 3]
    asking.came(0, 1, 2, 3)
    assert asking.ask(300_000) == [2, 3]
    asking.came(0, 1, 2, 3)
    assert asking.ask(400_000) == []


# Proofs


def doubt_and_prove(asking: Asking, *, sends_meanwhile: bool) -> list[int]:
    """Return the doubtful rows after node 0 was doubted and proven again, and the SYNC before had no answer."""
    node = np.array([0])
    prove(np.array([0, 1]), asking.table, asking.outstanding)
    asking.ask(1_000)
    asking.came(0, 1, 2, 3)
    doubt(node, asking.outstanding)
    asking.ask(2_000)
    if sends_meanwhile:
        asking.came(0)
    prove(node, asking.table, asking.outstanding)
    return asking.ask(3_000)


def test_nothing_is_expected_of_a_node_that_sent_nothing_since_its_doubt(asking: Asking) -> None:
    assert doubt_and_prove(asking, sends_meanwhile=False) == [2, 3]


def test_a_node_that_sent_since_its_doubt_may_send_more(asking: Asking) -> None:
    assert doubt_and_prove(asking, sends_meanwhile=True) == [1, 2, 3]
