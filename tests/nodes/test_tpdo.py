"""When a PDO is due, and what is in it (CiA 301, 7.2.2 and 7.5.2.37)."""

import pytest

from nodes.sampler import Sampler
from nodes.segment import Segment
from nodes.tpdo import LiveTpdo, is_turn
from tests.bus.harness import frame
from tests.nodes.helpers import START, ArrayLink, give, read, sync, write

COB_ID = 0x181


def set_up(
    segment: Segment, link: ArrayLink, *, every: int, start: int = 0, inhibit_100us: int = 0, event_ms: int = 0
) -> None:
    """Write the communication record of TPDO 1 of node 1, and start the node."""
    for subindex, value, size in (
        (1, 0xC000_0000 | COB_ID, 4),
        (2, every, 1),
        (3, inhibit_100us, 2),
        (5, event_ms, 2),
        (6, start, 1),
        (1, 0x4000_0000 | COB_ID, 4),
    ):
        assert write(segment, link, 0x1800, subindex, value, size) == 0
    give(segment, link, frame(0, bytes((START, 1))))


def first_tpdo(in_python: Segment) -> LiveTpdo:
    return in_python.boards.nodes[0].tpdos[0]


def map_sum_and_error_register(segment: Segment, link: ArrayLink) -> None:
    """Such a PDO is put together object by object."""
    assert write(segment, link, 0x1800, 1, 0xC000_0000 | COB_ID, 4) == 0
    assert write(segment, link, 0x1A00, 0, 0, 1) == 0
    for place, entry in enumerate((0x2100_030E, 0x1001_0008), 1):
        assert write(segment, link, 0x1A00, place, entry, 4) == 0
    assert write(segment, link, 0x1A00, 0, 2, 1) == 0


def sent_at(segment: Segment, link: ArrayLink, *counters: int) -> list[int]:
    """Return those of the SYNC counters that the PDO answers."""
    return [counter for counter in counters if COB_ID in dict(give(segment, link, sync(counter)))]


def test_start_value_and_counter_decide_also_where_the_cycle_does_not_divide_240() -> None:
    """The counter comes round; counted from start value 5, counter 3 is the 238th."""
    turns = [counter for counter in range(1, 241) if is_turn(7, 5, counter, 0)]
    assert turns == [3, *range(5, 240, 7)]


@pytest.mark.parametrize("is_plain", [True, False])
def test_a_cyclic_pdo_has_its_turns(segment: Segment, link: ArrayLink, is_plain: bool) -> None:
    if not is_plain:
        map_sum_and_error_register(segment, link)
    set_up(segment, link, every=3)
    assert sent_at(segment, link, 11, 12, 13, 14, 15, 16, 17) == [13, 16]
    set_up(segment, link, every=7, start=5)
    assert sent_at(segment, link, 1, 2, 3, 4, 5, 6, 12, 18, 19) == [3, 5, 12, 19]
    set_up(segment, link, every=240, start=9)
    assert sent_at(segment, link, 8, 9, 10, 240) == [9]
    set_up(segment, link, every=1)
    assert sent_at(segment, link, 1) == [1]
    give(segment, link, frame(0, b"\x80\1"))
    assert sent_at(segment, link, 2) == []
    set_up(segment, link, every=254)
    assert sent_at(segment, link, 1, 2, 3) == []


def test_acyclic_pdo_is_sent_at_a_sync_after_a_change(segment: Segment, link: ArrayLink) -> None:
    map_sum_and_error_register(segment, link)
    set_up(segment, link, every=0)
    assert sent_at(segment, link, 1, 2, 3) == [1]
    write(segment, link, 0x2021, 0, 2, 1)
    assert sent_at(segment, link, 4, 5, 6) == [4]


@pytest.mark.parametrize("every", [254, 255])
def test_event_driven_pdo_keeps_inhibit_time_and_event_timer(
    in_python: Segment, link: ArrayLink, sampler: Sampler, every: int
) -> None:
    set_up(in_python, link, every=every, inhibit_100us=5000, event_ms=1000)
    tpdo, sent = first_tpdo(in_python), []
    for now_s, has_changed in ((10.0, 0), (10.4999, 1), (10.5, 0), (11.4999, 0), (11.5, 0), (11.9, 1), (12.0001, 0)):
        sampler.sums[:] += 4 * has_changed
        if tpdo.at_event(now_s, in_python.boards.nodes[0].local) is not None:
            sent.append(now_s)
    assert sent == [10.0, 10.5, 11.5, 12.0001]


def test_event_driven_pdo_is_sent_in_operational_only(segment: Segment, link: ArrayLink) -> None:
    set_up(segment, link, every=255)
    give(segment, link, frame(0, b"\x80\1"))
    segment.tick(1e3)
    assert COB_ID not in link.take_sent()["can_id"]
    give(segment, link, frame(0, b"\1\1"))
    segment.tick(2e3)
    assert COB_ID in link.take_sent()["can_id"]


def test_a_pdo_with_another_object_shows_it_as_it_is_now(segment: Segment, link: ArrayLink) -> None:
    map_sum_and_error_register(segment, link)
    set_up(segment, link, every=1)
    for arrived, register in ((sync(1), 0x00), (frame(0x80, b"\1\2"), 0x11), (sync(2), 0x00)):
        payload = dict(give(segment, link, arrived))[COB_ID]
        shown = read(segment, link, 1, 0x2100, 3) & 0x3FFF | register << 14
        assert payload == shown.to_bytes(3, "little")
