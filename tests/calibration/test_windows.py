"""Means and noise of the sums over windows."""

import numpy as np
import pytest

from calibration.windows import Window, WindowMeans, mean_window_s, tare_s
from skin.phi import sbhe

PHI = sbhe(64, 16, block_size=16)
PERIOD_NS = 10_000_000
MS = 1_000_000


class Collected:
    """Windows of some sums that all have the same counts, which become valid at different times."""

    def __init__(self, valid_from_ms: tuple[int, ...], period_s: float = 0.01) -> None:
        self.means = WindowMeans(len(valid_from_ms), period_s, 0.5)
        self._from_ns = np.array(valid_from_ms) * MS

    def take(self, time_ms: float, count: int = 0) -> Window | None:
        counts = np.full(self._from_ns.size, count, np.int32)
        return self.means.take(round(time_ms * MS), counts, round(time_ms * MS) >= self._from_ns)

    def take_all(self, times_ms: range) -> list[Window]:
        """Take the square of the number of each cycle; return the windows that ended."""
        found = [self.take(time_ms, (time_ms // 10) ** 2) for time_ms in times_ms]
        return [window for window in found if window is not None]


def test_a_window_holds_the_cycles_of_a_quarter_of_a_second_that_have_been_valid_for_half_a_second() -> None:
    """Valid from 10 ms on, sums count from 510 ms on; from 130 ms on, 13 cycles of the third window do, half of it."""
    made = Collected((10, 130, 140, 5000))
    found = made.take_all(range(10, 770, 10))
    assert [window.centre_ns for window in found] == [135 * MS, 385 * MS, 635 * MS]
    assert not any(window.known.any() or window.mean_n.any() or window.noise_n.any() for window in found[:2])
    last = found[2]
    assert last.known.tolist() == [True, True, False, False]
    cycles = np.arange(51, 76)
    late = cycles[12:]
    assert last.mean_n == pytest.approx([0.5 * (cycles**2).mean(), 0.5 * (late**2).mean(), 0, 0])
    # k² - (k - 1)² = 2 k - 1; of two normal numbers the mean difference is 2 / √π of their deviation.
    noise_n = [0.5 * (2 * each - 1).mean() * np.pi**0.5 / 2 for each in (cycles, late)]
    assert last.noise_n == pytest.approx([*noise_n, 0, 0])
    assert last.difference_n.tolist() == [0.5 * (2 * 75 - 1)] * 3 + [0]


@pytest.mark.parametrize(("missed", "knows"), [(12, [True] * 4), (13, [False, False, False, True])])
def test_a_sum_settles_again_when_it_was_away_for_more_than_half_a_window(missed: int, knows: list[bool]) -> None:
    """Away from 520 ms on: 12 cycles leave 13 of the third window; after 13 the sum has settled 500 ms later."""
    made, back_ms = Collected((10,)), 520 + 10 * missed
    made.take_all(range(10, 520, 10))
    for time_ms in range(520, back_ms, 10):
        made.means.take(time_ms * MS, np.zeros(1, np.int32), np.zeros(1, np.bool_))
    found = made.take_all(range(back_ms, 1520, 10))
    assert [window.known.all() for window in found] == knows
    whole = np.arange(126, 151)
    assert found[3].mean_n == pytest.approx([0.5 * (whole**2).mean()])
    if knows[0]:
        came = np.r_[51, 64:76]
        assert found[0].mean_n == pytest.approx([0.5 * (came**2).mean()])
        # From each valid cycle to the next, whatever is between them.
        noise_n = 0.5 * np.diff(np.r_[50, came] ** 2).mean() * np.pi**0.5 / 2
        assert found[0].noise_n == pytest.approx([noise_n])


@pytest.mark.parametrize(("time_ms", "comes"), [(259.9, False), (260, True), (509.9, True), (510, False)])
def test_a_window_ends_with_the_first_cycle_after_it_unless_that_is_a_window_late(time_ms: float, comes: bool) -> None:
    made = Collected((10,))
    assert not made.take_all(range(10, 250, 10))
    assert (made.take(time_ms) is not None) == comes


def test_windows_and_zeros_take_as_long_as_the_guide_says() -> None:
    """A quarter of a second, or 8 cycles; eight of them for a zero: 2 s, or 64 cycles."""
    assert [mean_window_s(period_s) for period_s in (0.001, 0.01, 0.05, 1.0)] == [0.25, 0.25, 0.4, 8.0]
    assert [tare_s(period_s) for period_s in (0.01, 0.05)] == [2.0, 3.2]


def test_a_restart_drops_the_cycles_of_the_window() -> None:
    made = Collected((10,))
    made.take_all(range(10, 110, 10))
    made.means.restart()
    found = made.take_all(range(110, 870, 10))
    assert [window.centre_ns for window in found] == [235 * MS, 485 * MS, 735 * MS]
    assert found[2].mean_n == pytest.approx([0.5 * (np.arange(61, 86) ** 2).mean()])
