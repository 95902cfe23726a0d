"""Sampling instants on the wall clock."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skin.wall_times import Clocks, WallTimes, nearest


def test_the_newest_measurement_that_is_not_later_tells_the_offset() -> None:
    wall = WallTimes(7)
    assert wall.time_ns(100) == 107
    wall.take(Clocks(sampled_mono_ns=100))  # does not know
    assert wall.time_ns(100) == 107
    for sampled_ns, offset_ns in ((100, 1000), (200, 2000)):
        wall.take(Clocks(sampled_mono_ns=sampled_ns, wall_offset_ns=offset_ns))
    assert [wall.time_ns(each) for each in (50, 100, 199, 200, 300)] == [1050, 1100, 1199, 2200, 2300]


def test_nothing_is_told_before_the_first_measurement() -> None:
    wall = WallTimes()
    assert wall.time_ns(100) is None
    wall.take(Clocks(sampled_mono_ns=100, wall_offset_ns=0))  # the replay of a log: its frames have Unix times
    assert wall.time_ns(100) == 100


@pytest.mark.parametrize("offset_ns", [-101, 2**62])
def test_an_instant_that_no_wall_clock_has_is_none(offset_ns: int) -> None:
    assert WallTimes(offset_ns).time_ns(100) is None


def test_after_a_restart_of_the_machine_its_new_clock_counts() -> None:
    wall = WallTimes(7, kept=2)
    for sampled_ns, offset_ns in ((1000, 10), (2000, 20), (3000, 30), (100, 5000), (200, 6000)):
        wall.take(Clocks(sampled_mono_ns=sampled_ns, wall_offset_ns=offset_ns))
    assert [wall.time_ns(each) for each in (100, 150, 200)] == [5100, 5150, 6200]


@given(
    st.lists(st.integers(-(2**40), 2**62), min_size=1, unique=True), st.lists(st.integers(-(2**40), 2**62), min_size=1)
)
def test_the_nearest_time_is_found(times_ns: list[int], wanted_ns: list[int]) -> None:
    ascending = np.array(sorted(times_ns), np.int64)
    wanted = np.array(wanted_ns, np.int64)
    apart = np.abs(ascending[:, None] - wanted)
    place, is_near = nearest(ascending, wanted, 1000)
    np.testing.assert_array_equal(np.abs(ascending[place] - wanted), apart.min(axis=0))
    np.testing.assert_array_equal(is_near, apart.min(axis=0) < 1000)
