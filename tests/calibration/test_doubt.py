"""Forces that stand still are doubtful: they may be errors of the zero."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.doubt import LEAST_RATIO, MOST_RATIO, STILL_S, Doubt

RANGE_N, WINDOW_S = 20e-3, 0.25
WINDOWS = round(STILL_S / WINDOW_S)


def looked_at(force_n: Callable[[int], float], windows: int = 3 * WINDOWS) -> Doubt:
    """Return a doubt that has seen forces on the first of two taxels; the other feels nothing."""
    doubt = Doubt(2, RANGE_N, WINDOW_S)
    for window in range(windows):
        doubt.take(np.array([force_n(window), 0.0]), window + 1)
    return doubt


def test_a_force_that_stands_still_for_six_seconds_is_doubtful() -> None:
    before, after = looked_at(lambda _: 2e-3, WINDOWS - 1), looked_at(lambda _: 2e-3, WINDOWS)
    assert not before.taxels.any()
    assert before.since_ns == 0
    assert after.taxels.tolist() == [True, False]
    assert after.since_ns == WINDOWS


def test_the_time_is_that_of_the_first_doubtful_taxel_until_none_is_left() -> None:
    doubt = Doubt(2, RANGE_N, WINDOW_S)
    for window in range(2 * WINDOWS):
        doubt.take(np.array([2e-3, 1e-3 if window >= 10 else 0.0]), window + 1)
    assert doubt.taxels.all()
    assert doubt.since_ns == WINDOWS
    doubt.take(np.zeros(2), 100)
    assert (doubt.taxels.any(), doubt.since_ns) == (False, 0)


@pytest.mark.parametrize(
    ("force_n", "is_doubtful"),
    [
        (lambda _: 0.9 * LEAST_RATIO * RANGE_N, False),
        (lambda _: 1.1 * LEAST_RATIO * RANGE_N, True),
        (lambda _: 0.99 * MOST_RATIO * RANGE_N, True),
        (lambda _: 1.01 * MOST_RATIO * RANGE_N, False),
        (lambda window: 5e-3 * (window % 2), False),  # moving
        (lambda window: 5e-3 if window % 12 else 0.0, False),  # comes again and again
        (lambda window: 4e-3 + 1e-3 * (-1) ** window, False),  # fluctuating
        (lambda window: 4e-3 + 0.1e-3 * (-1) ** window, True),
        (lambda window: 7e-3 * window / (3 * WINDOWS), True),  # warms
        (lambda window: 2e-3 if window < 3 * WINDOWS - 5 else 7e-3, False),  # something heavy lies on it
        (lambda window: 7e-3 if window < 2 * WINDOWS else 4e-3, True),  # a part has gone
        (lambda window: 2e-3 if window != 3 * WINDOWS - 10 else 5e-3, True),  # an object has passed
    ],
)
def test_what_is_doubtful_in_the_end(force_n: Callable[[int], float], is_doubtful: bool) -> None:
    assert looked_at(force_n).taxels.tolist() == [is_doubtful, False]


def test_what_moves_the_zero_moves_what_was_seen() -> None:
    """A zero that follows half of a force leaves half of the doubt."""
    doubt = looked_at(lambda _: 2e-3)
    doubt.move(np.array([1e-3, 0.0]))
    doubt.take(np.array([1e-3, 0.0]), 100)
    assert doubt.taxels.tolist() == [True, False]
    doubt.move(np.array([1e-3, 0.0]))
    doubt.take(np.array([2e-3, 0.0]), 101)  # new: it has to stand still first
    assert not doubt.taxels.any()
