"""The collector: SYNCs of others, SYNCs that ask for nothing, and what is known of the instant of a SYNC."""

import numpy as np

from dbc.canopen import SYNC_COB_ID
from tests.bus.harness import frame
from tests.gateway.cycles import burst, echo, new_collector, whole_cycle


def test_foreign_syncs_are_counted_from_the_last_question_on() -> None:
    collector = new_collector()
    assert [collector.take_foreign_syncs(bus) for bus in range(4)] == [0, 0, 0, 0]
    collector.take(2, np.concatenate([frame(SYNC_COB_ID, b"\1")] * 3), 0)
    assert [collector.take_foreign_syncs(bus) for bus in (1, 2, 2)] == [0, 3, 0]


def error_ns(stamp_error_ns: int | None) -> int:
    """Return the bound of an echo 0.7 ms after the SYNC was sent, with answers 0.9 ms and 1 ms after that."""
    collector = new_collector()
    collector.open(1, 10_000_000, 10_000_000)
    start, sent = echo(1), burst(0, 1)[:2]
    start["time_ns"] = 10_700_000
    sent["time_ns"] = 10_900_000, 11_000_000
    collector.take(0, np.concatenate((start, sent)), stamp_error_ns)
    return collector.close(1).times.error_ns


def test_the_first_answer_bounds_the_instant_where_there_are_no_time_stamps() -> None:
    assert 0 < error_ns(1_000) < 701_000
    assert error_ns(None) - error_ns(1_000) == 900_000 - (700_000 + 1_000)


def test_frames_after_a_sync_that_asks_for_none_are_late() -> None:
    collector = new_collector()
    whole_cycle(collector, 1)
    whole_cycle(collector, 2)
    collector.open(3)
    collector.rest(3, 0, None)
    collector.take(0, np.concatenate((echo(3), burst(0, 3))), 0)
    assert (collector.counts.accepted, collector.counts.late) == (512, 64)


def test_frames_before_the_first_sync_are_of_no_cycle() -> None:
    collector = new_collector()
    collector.take(0, np.concatenate((burst(0, 1), burst(0, 2))), 0)
    assert (collector.counts.accepted, collector.counts.late) == (0, 128)


def swapped_after(cycles: int, *, also_right: bool) -> list[int]:
    """Return the nodes of swapped phases, when the first node of bus 0 answers so many SYNCs with wrong PDOs."""
    collector = new_collector()
    for counter in range(1, cycles + 1):
        right, wrong = burst(0, counter), burst(0, counter + 1)
        is_of_node = right["can_id"] & 0x7F == 1
        sent = [right if also_right else right[~is_of_node], wrong[wrong["can_id"] & 0x7F == 1]]
        collector.open(counter)
        collector.take(0, np.concatenate((echo(counter), *sent)), 0)
        collector.close(counter)
    found = collector.take_swapped()
    assert collector.take_swapped() == []
    return found


def test_a_node_that_answers_five_syncs_with_the_other_phase_alone_is_told_once() -> None:
    assert swapped_after(4, also_right=False) == []
    assert swapped_after(5, also_right=False) == [0]
    assert swapped_after(6, also_right=False) == [0]
    assert swapped_after(6, also_right=True) == []
