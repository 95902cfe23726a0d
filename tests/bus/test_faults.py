"""Faults happen as often as their rules say, and every frame is accounted for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.faults import Fault, FaultSchedule, parse_fault
from bus.outbox import DISCARDED, OTHERS, OWNER
from bus.simulated_bus import SimulatedBus
from canskin.errors import InputError
from dbc.frame_bits import wire_bits
from tests.bus.harness import burst, frame

ratios = st.floats(0, 0.4)


@settings(max_examples=10, deadline=None)
@given(ratios, ratios, ratios, st.sampled_from([0.0, 1e-4, 1e-3]), st.integers(0, 9))
def test_sent_is_delivered_plus_lost(loss: float, again: float, delay: float, bit_error: float, seed: int) -> None:
    rule = Fault(loss_ratio=loss, duplicate_ratio=again, delay_ratio=delay, delay_s=2e-3, bit_error_rate=bit_error)
    bus = SimulatedBus(faults=[rule], seed=seed, restart_s=0.0)
    one, two = bus.attach("one"), bus.attach("two")
    delivered = echoed = discarded = 0
    for _ in range(5):
        bus.submit(one, burst(range(0x100, 0x140)), bus.now_ns)
        bus.submit(two, burst(range(0x200, 0x240)), bus.now_ns)
        events = bus.run_until()
        flags, audience = events.frames["flags"], events.audience
        delivered += int(((audience & OTHERS != 0) & (flags == 0)).sum())
        echoed += int(((audience & OWNER != 0) & (flags == 0)).sum())
        discarded += int((flags & DISCARDED == DISCARDED).sum())
        assert (np.diff(events.frames["time_ns"]) >= 0).all()
    counts = bus.counts
    assert counts.accepted == 640
    assert counts.accepted == counts.transmitted + counts.discarded
    assert (echoed, discarded) == (counts.transmitted, counts.discarded)
    assert delivered == counts.transmitted - counts.lost + counts.duplicated


def test_bit_errors_come_as_often_as_the_rate_says() -> None:
    rate = 1e-4
    bus = SimulatedBus(faults=[Fault(bit_error_rate=rate)], seed=1)
    one, _ = bus.attach("one"), bus.attach("two")
    sent = burst(range(0x100, 0x1C0))
    bits = int(wire_bits(sent)[0].sum())
    rounds = 100
    for _ in range(rounds):
        bus.submit(one, sent, bus.now_ns)
        bus.run_until()
    expected = rounds * bits * rate
    assert abs(bus.counts.errors - expected) < 5 * expected**0.5
    assert bus.counts.transmitted == rounds * len(sent)


def test_rules_aim_at_controllers_and_identifiers() -> None:
    rules = [Fault(controller="nodes:3", loss_ratio=1.0), Fault(can_id=0x080, mask=0x7FF, loss_ratio=1.0)]
    bus = SimulatedBus(faults=rules)
    nodes, gateway = bus.attach("nodes"), bus.attach("gateway")
    bus.submit(nodes, np.concatenate([frame(0x183, port=3), frame(0x184, port=4)]), 0)
    bus.submit(gateway, np.concatenate([frame(0x080), frame(0x000)]), 0)
    events = bus.run_until()
    reached = events.frames["can_id"][events.audience & OTHERS != 0]
    assert list(reached) == [0x000, 0x184]
    assert sorted(events.frames["can_id"][events.audience & OWNER != 0].tolist()) == [0x000, 0x080, 0x183, 0x184]


def test_a_rule_of_a_mask_alone_aims_at_identifiers_without_these_bits() -> None:
    book = FaultSchedule([Fault(mask=0x780, loss_ratio=1.0)])
    assert [book.odds("a:0", can_id).loss for can_id in (0x000, 0x07F, 0x080, 0x181)] == [1, 1, 0, 0]


def test_a_delayed_frame_is_overtaken() -> None:
    bus = SimulatedBus(faults=[Fault(can_id=0x100, mask=0x7FF, delay_ratio=1.0, delay_s=1e-3)])
    one, _ = bus.attach("one"), bus.attach("two")
    bus.submit(one, burst([0x100, 0x101]), 0)
    events = bus.run_until()
    assert list(events.frames["can_id"][events.audience & OTHERS != 0]) == [0x101, 0x100]
    assert list(events.frames["can_id"][events.audience & OWNER != 0]) == [0x100, 0x101]
    echo, late = (events.frames["time_ns"][events.frames["can_id"] == 0x100]).tolist()
    assert late - echo == 1_000_000


def test_the_largest_value_counts_where_rules_meet() -> None:
    book = FaultSchedule([Fault(loss_ratio=0.1, delay_ratio=0.5, delay_s=0.2), Fault(controller="a:*", loss_ratio=0.3)])
    assert book.odds("a:1", 5) == (0.3, 0.0, 0.5, 200_000_000, 0.0)
    assert book.odds("b:1", 5).loss == 0.1
    assert FaultSchedule([Fault(controller="a:*", loss_ratio=0.3)]).odds("b:1", 5) == (0.0, 0.0, 0.0, 0, 0.0)


def test_a_controller_without_power_is_one_that_a_rule_names() -> None:
    book = FaultSchedule([Fault(controller="a:*", off=True), Fault(loss_ratio=1.0)])
    assert (book.is_off("a:1"), book.is_off("b:1"), FaultSchedule().is_off("a:1")) == (True, False, False)


def test_rules_are_written_as_pairs() -> None:
    assert parse_fault("controller=nodes:7, can_id=0x181,mask=0x7FF,loss_ratio=0.5") == Fault(
        controller="nodes:7", can_id=0x181, mask=0x7FF, loss_ratio=0.5
    )
    assert parse_fault("controller=nodes:*,off") == Fault(controller="nodes:*", off=True)


@pytest.mark.parametrize(
    "text", ["loss=0.1", "loss_ratio=2", "loss_ratio=much", "can_id=0xZZ", "delay_s=-1", "delay_s=inf"]
)
def test_a_wrong_rule_names_the_keys(text: str) -> None:
    with pytest.raises(InputError, match="bit_error_rate"):
        parse_fault(text)
