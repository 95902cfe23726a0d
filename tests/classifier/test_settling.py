"""How one cycle changes the settled decision, by arithmetic."""

import numpy as np
import pytest

from canskin.messages import UNKNOWN_OBJECT
from classifier.settling import Seen, Settling, logistic

DOME, PLATE = 0, 1
#: Contact or not: as likely as not.
SEEN = Seen(DOME, confidence=0.9, contact=0.5, novelty=2.0)


@pytest.fixture
def settling() -> Settling:
    return Settling(("dome", "plate"))


def test_belief_is_of_each_object_and_of_no_contact(settling: Settling) -> None:
    """Half of it is of contact, and nine tenths of that are of the winner."""
    settling.take(SEEN)
    assert settling.belief == pytest.approx([0.45, 0.05, 0.5])
    settling.take(SEEN._replace(winner=PLATE))
    assert settling.belief == pytest.approx([0.6 * 0.45 + 0.4 * 0.05, 0.6 * 0.05 + 0.4 * 0.45, 0.5])
    settling.take(SEEN._replace(winner=PLATE, contact=0.0))
    assert settling.belief == pytest.approx([0.6 * 0.29, 0.6 * 0.21, 0.6 * 0.5 + 0.4])
    assert settling.belief.sum() == pytest.approx(1.0)
    assert settling.decision() == ("", pytest.approx(0.7), False)


def test_novelty_settles_by_a_tenth_and_counts_as_far_as_the_skin_is_touched(settling: Settling) -> None:
    settling.take(SEEN)
    assert settling.novelty == pytest.approx(0.1 * 0.25 * 2)  # contact and belief in it are a half each
    settling.take(SEEN)
    assert settling.novelty == pytest.approx(0.05 + 0.1 * (0.25 * 2 - 0.05))
    settling.take(SEEN._replace(contact=1.0))
    assert settling.novelty == pytest.approx(0.095 + 0.1 * (0.7 * 2 - 0.095))


def test_the_novelty_of_one_cycle_is_three_at_most(settling: Settling) -> None:
    settling.take(SEEN._replace(novelty=50.0))
    assert settling.novelty == pytest.approx(0.1 * 0.25 * 3)


@pytest.mark.parametrize(("novelty", "label"), [(1.5, UNKNOWN_OBJECT), (0.5, "plate")])
def test_half_beyond_or_below_the_limit_of_novelty_a_decision_is_95_percent_sure(
    settling: Settling, novelty: float, label: str
) -> None:
    for _ in range(200):
        settling.take(Seen(PLATE, confidence=1.0, contact=1.0, novelty=novelty))
    assert settling.decision() == (label, pytest.approx(0.95, abs=0.005), False)


def test_what_is_forgotten_does_not_count(settling: Settling) -> None:
    settling.take(SEEN)
    settling.forget()
    settling.take(SEEN._replace(winner=PLATE, novelty=0.0))
    assert settling.belief == pytest.approx([0.05, 0.45, 0.5])
    assert settling.novelty == 0.0


def weights(settling: Settling, times_ms: list[int]) -> list[float]:
    """Return the weights of cycles in parts of a period, by how much each moves the belief in no contact."""
    found = []
    for place, time_ms in enumerate(times_ms):
        contact, before = place % 2, settling.belief[-1]
        settling.take(SEEN._replace(contact=contact), time_ms * 1_000_000)
        left = (settling.belief[-1] - (1 - contact)) / (before - (1 - contact))
        found.append(float(np.log(left) / np.log(0.6)))
    return found


def test_cycles_count_by_the_time_that_has_passed(settling: Settling) -> None:
    """A period is 10 ms; what a late cycle has over a period counts in the next one, up to a period."""
    settling.take(SEEN, 1_000_000_000)
    times_ms = [1002, 1004, 1009, 1019, 1059, 1061, 1063, 900]
    assert weights(settling, times_ms) == pytest.approx([1.0, 0.4, 0.5, 1.0, 1.0, 1.0, 0.4, 1.0])


def test_a_late_cycle_takes_no_weight_from_the_next(settling: Settling) -> None:
    settling.take(SEEN, 1_000_000_000)
    assert weights(settling, [1010, 1020, 1035, 1040, 1050]) == pytest.approx([1.0] * 5)
    assert weights(settling, list(range(1052, 1092, 2)))[-1] == pytest.approx(0.2)


def test_a_peak_far_from_the_threshold_is_no_overflow() -> None:
    assert logistic(1e9) == 1.0
    assert logistic(-1e9) == pytest.approx(0.0, abs=1e-200)
    assert logistic(np.log(3)) == pytest.approx(0.75)
