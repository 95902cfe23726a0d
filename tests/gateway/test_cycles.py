"""When SYNCs go out: on a grid, never two close together, and counted where they are skipped."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.cycles import LATEST, RATE_SYNCS, SyncClock

PERIOD_S = 0.01


def started() -> SyncClock:
    clock = SyncClock(PERIOD_S)
    clock.start(1.0)
    return clock


def test_nothing_is_due_before_the_start() -> None:
    clock = SyncClock(PERIOD_S)
    assert clock.take(1e9) is None
    assert not clock.runs


def test_lateness_of_one_does_not_move_the_next() -> None:
    clock = started()
    assert clock.take(0.9999) is None
    assert clock.take(1.004) == 1.0
    assert clock.take(1.0099) is None
    assert clock.take(1.0101) == pytest.approx(1.01)
    assert (clock.counter, clock.sent, clock.skipped) == (2, 2, 0)


def test_what_is_due_too_late_is_skipped_and_counted() -> None:
    clock = started()
    assert clock.take(1.0) == 1.0
    assert clock.take(1.0378) is None  # 1.01 and 1.02 missed, 1.03 too late
    assert clock.skipped == 3
    assert clock.take(1.0401) == pytest.approx(1.04)
    assert clock.counter == 2


@pytest.mark.parametrize(("late_s", "is_sent"), [(0.00499, True), (0.00501, False)])
def test_half_a_period_is_too_late(late_s: float, is_sent: bool) -> None:
    clock = started()
    assert (clock.take(1.0 + late_s) is not None) == is_sent
    assert clock.skipped == 1 - is_sent


def test_missed_periods_are_skipped_but_for_the_newest() -> None:
    clock = started()
    assert clock.take(1.031) == pytest.approx(1.03)
    assert clock.skipped == 3
    assert clock.due_s == pytest.approx(1.04)


def test_counter_comes_round_at_240() -> None:
    clock = started()
    counters = []
    for number in range(241):
        clock.take(1.0 + number * PERIOD_S + 1e-6)
        counters.append(clock.counter)
    assert counters == [*range(1, 241), 1]


@given(st.lists(st.floats(0, 0.05), min_size=1, max_size=200))
def test_two_are_never_close_and_every_period_is_accounted_for(stalls_s: list[float]) -> None:
    clock, now_s, sent_s = started(), 1.0, []
    for stall_s in stalls_s:
        now_s += stall_s
        if clock.take(now_s) is not None:
            sent_s.append(now_s)
    gaps_s = [later - earlier for earlier, later in pairwise(sent_s)]
    assert all(gap_s >= LATEST * PERIOD_S - 1e-9 for gap_s in gaps_s)
    assert clock.sent == len(sent_s)
    assert clock.sent + clock.skipped == round((clock.due_s - 1.0) / PERIOD_S)


def test_the_rate_is_that_of_the_syncs_sent_since_the_start() -> None:
    assert SyncClock(PERIOD_S).rate_hz(5.0) == 0.0
    clock = started()
    assert clock.rate_hz(0.5) == clock.rate_hz(1.0) == 0.0
    for number in range(RATE_SYNCS):
        assert clock.rate_hz(1.0 + number * PERIOD_S) == 0.0  # too few
        assert clock.take(1.0 + (number + 0.1) * PERIOD_S) is not None
    assert clock.rate_hz(1.0 + RATE_SYNCS) == 1.0
    clock.stop()
    assert not clock.runs
    assert clock.take(1e9) is None
    assert clock.rate_hz(1.0 + 2 * RATE_SYNCS) == 0.5


def test_a_period_that_changes_counts_from_the_next_sync_on() -> None:
    """A SYNC that was followed by a long period is not followed by another soon."""
    clock = started()
    clock.period_s = 0.05
    assert clock.take(1.0) == 1.0
    assert clock.due_s == pytest.approx(1.05)
    clock.period_s = 0.01
    assert clock.take(1.05) == pytest.approx(1.05)
    assert clock.due_s == pytest.approx(1.06)
    clock.start(1.0525)
    assert clock.take(1.0525) is None  # a quarter of a period after the last
    assert clock.skipped == 1
    clock.start(1.056)
    assert clock.take(1.056) == 1.056
