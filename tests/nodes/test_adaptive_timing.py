"""When a bus gets frames of adaptive nodes, and how many: those that can win it until the next decision, and four."""

import pytest

from dbc.contract import Contract
from nodes.adaptive.timing import SendingTimes
from skin.layout import load_layout

MS, SECOND = 1_000_000, 1_000_000_000


@pytest.fixture(scope="module")
def times() -> SendingTimes:
    """Classic CAN at 1 Mbit/s: every frame of sums lasts 135 µs at most."""
    made = SendingTimes(Contract.from_layout(load_layout()), 0)
    made.sync_ns = 5 * SECOND
    return made


def test_before_the_first_sync_a_bus_gets_what_fits_and_four_more() -> None:
    times = SendingTimes(Contract.from_layout(load_layout()), 0)
    assert times.next(0, 1e6) == (MS, 12)  # 7.4 frames a millisecond
    assert times.next(0, 8 * 135_000.0) == (1_080_000, 12)
    assert times.next(7, 8 * 135_000 + 1.0) == (1_080_008, 13)
    assert times.next(7, 60 * 135_000.0) == (8_100_007, 64)
    assert times.next(7, 61 * 135_000.0) == (8_235_007, 64)


def test_no_frame_starts_with_a_sync_or_right_after_it(times: SendingTimes) -> None:
    pause_ns = 2 * MS
    assert times.next(5 * SECOND - 1, 1e6) is not None
    assert times.next(5 * SECOND, 1e6) is None
    assert times.next(5 * SECOND + pause_ns - 1, 1e6) is None
    assert times.next(5 * SECOND + pause_ns, 1e6) == (5 * SECOND + pause_ns + MS, 12)


def test_a_frame_that_would_run_into_the_next_sync_waits(times: SendingTimes) -> None:
    next_ns = 5 * SECOND + 10 * MS
    assert times.next(next_ns - 134_999, 1e6) is None
    assert times.next(next_ns - 1, 1e6) is None
    assert times.next(next_ns - 135_000, 1e6) == (next_ns, 5)
    assert times.next(next_ns - MS, 2e6) == (next_ns, 12)
    assert times.next(next_ns, 1e6) == (next_ns + MS, 12)  # this SYNC is late
