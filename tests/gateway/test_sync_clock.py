"""When SYNCs go out: on a grid, never two close together, and counted where they are skipped."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.sync_clock import LATEST, RATE_SYNCS, SyncClock

PERIOD_S = 0.01


def started() -> SyncClock:
    clock = SyncClock(PERIOD_S)
    clock.start(1.0)
    return clock


def test_nothing_is_due_before_the_start() -> None:
    clock = SyncClock(PERIOD_S)
    assert clock.take(1e9) is None
    assert not clock.runs


@pytest.mark.parametrize(
    ("takes", "sent", "skipped"),
    [
        ([(0.9999, None), (1.004, 1.0), (1.0099, None), (1.0101, 1.01)], 2, 0),  # lateness does not move the next
        ([(1.0, 1.0), (1.0378, None), (1.0401, 1.04)], 2, 3),  # 1.01 and 1.02 missed, 1.03 too late
        ([(1.00499, 1.0)], 1, 0),
        ([(1.00501, None)], 0, 1),
        ([(1.031, 1.03), (1.04, 1.04)], 2, 3),  # missed but for the newest
    ],
)
def test_what_is_due_too_late_is_skipped_and_counted(
    takes: list[tuple[float, float | None]], sent: int, skipped: int
) -> None:
    """Half a period is too late."""
    clock = started()
    for now_s, due_s in takes:
        assert clock.take(now_s) == (None if due_s is None else pytest.approx(due_s))
    assert (clock.counter, clock.sent, clock.skipped) == (sent, sent, skipped)


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
