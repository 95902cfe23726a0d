"""When a bus gets frames of adaptive nodes, and how many: those that can win it until the next decision, and four."""

import pytest

from dbc.contract import Contract
from nodes.adaptive.boards import AdaptiveBoards
from nodes.adaptive.news import WithNews
from tests.layouts import in_one_instant
from tests.nodes.helpers import Still

MS, SECOND = 1_000_000, 1_000_000_000


def new() -> WithNews:
    """Classic CAN at 1 Mbit/s: every frame of sums lasts 135 µs at most."""
    contract = Contract.from_layout(in_one_instant())
    return WithNews(contract, 0, AdaptiveBoards(contract, [], Still(contract)))


@pytest.fixture(scope="module")
def times() -> WithNews:
    made = new()
    made.measure(0, 5 * SECOND)
    return made


def test_before_the_first_sync_a_bus_gets_what_fits_and_four_more() -> None:
    times = new()
    assert times.times(0, 1e6) == (MS, 12)  # 7.4 frames a millisecond
    assert times.times(0, 8 * 135_000.0) == (1_080_000, 12)
    assert times.times(7, 8 * 135_000 + 1.0) == (1_080_008, 13)
    assert times.times(7, 60 * 135_000.0) == (8_100_007, 64)
    assert times.times(7, 61 * 135_000.0) == (8_235_007, 64)


def test_no_frame_starts_with_a_sync_or_right_after_it(times: WithNews) -> None:
    pause_ns = 2 * MS
    assert times.times(5 * SECOND - 1, 1e6) is not None
    assert times.times(5 * SECOND, 1e6) is None
    assert times.times(5 * SECOND + pause_ns - 1, 1e6) is None
    assert times.times(5 * SECOND + pause_ns, 1e6) == (5 * SECOND + pause_ns + MS, 12)


def test_a_frame_that_would_run_into_the_next_sync_waits(times: WithNews) -> None:
    next_ns = 5 * SECOND + 10 * MS
    assert times.times(next_ns - 134_999, 1e6) is None
    assert times.times(next_ns - 1, 1e6) is None
    assert times.times(next_ns - 135_000, 1e6) == (next_ns, 5)
    assert times.times(next_ns - MS, 2e6) == (next_ns, 12)
    assert times.times(next_ns, 1e6) == (next_ns + MS, 12)  # this SYNC is late
