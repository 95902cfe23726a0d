"""When frames, error frames, retries and recoveries end, to the nanosecond, and what they count (ISO 11898-1).

At 1 Mbit/s a bit is a microsecond. An error frame has 6 bits of flag, 6 of its echo and 8 of delimiter, intermission 3.
The last 1 + 7 bits of a frame are ACK delimiter and end of frame.
"""

from typing import Any

import numpy as np
import pytest

from bus.error_frames import ErrorClass, State
from bus.faults import Fault, FaultSchedule
from bus.outbox import OTHERS, OWNER, Events
from bus.simulated_bus import SimulatedBus
from dbc.frame import ERROR
from dbc.frame_bits import frame_time_ns
from tests.bus.harness import burst, frame

BIT_NS = 1000
BOTH = 3
#: 34 + 8 bits, 15 - 2 of the end: no stuff bits in 0x555 and 0x55. With intermission.
SENT = frame(0x2AA, b"\x55", time_ns=5)


def lasts_ns(one: Any = SENT) -> int:
    return int(frame_time_ns(one, 1_000_000)[0])


def plain(events: Events) -> list[tuple[int, int, int]]:
    """Return end, owner and audience of the frames among the events."""
    return [
        (int(one["time_ns"]), int(owner), int(audience))
        for one, owner, audience in zip(events.frames, events.owner, events.audience, strict=True)
        if not one["flags"]
    ]


def reports(events: Events, kind: ErrorClass) -> list[int]:
    is_report = (events.frames["flags"] == ERROR) & (events.frames["can_id"] & kind != 0)
    return list(events.frames["time_ns"][is_report])


def once(monkeypatch: pytest.MonkeyPatch, *after_ns: int) -> None:
    """Disturb the first frames, `after_ns` after the start of each."""
    left = [*after_ns]
    monkeypatch.setattr(FaultSchedule, "draw_error_ns", lambda *_: left.pop(0) if left else None)


@pytest.mark.parametrize("bitrate", [1_000_000, 250_000])
def test_a_disturbed_frame_ends_with_an_error_frame_and_is_sent_again(
    monkeypatch: pytest.MonkeyPatch, bitrate: int
) -> None:
    once(monkeypatch, 10_000)
    bus = SimulatedBus(bitrate, faults=[Fault(loss_ratio=0.0)])
    one, two = bus.attach("one"), bus.attach("two")
    bus.submit(one, SENT)
    events = bus.run_until()
    bit_ns, frame_ns = 10**9 // bitrate, int(frame_time_ns(SENT, bitrate)[0])
    error_ns = 5 + 10_000 + 20 * bit_ns
    assert reports(events, ErrorClass.PROTOCOL) == [error_ns]
    assert plain(events) == [(error_ns + frame_ns, one.number, BOTH)]  # 3 bits later, and 3 bits of its own
    assert bus.counts.errors == bus.counts.transmitted == 1
    assert bus.counts.busy_ns == 10_000 + 23 * bit_ns + frame_ns
    assert (one.controllers[0].transmit_errors, two.controllers[0].receive_errors) == (7, 0)
    assert bus.waiting(one) == 0


def test_a_duplicate_is_disturbed_in_the_last_bit_of_its_end() -> None:
    bus = SimulatedBus(faults=[Fault(duplicate_ratio=1.0)])
    one, _ = bus.attach("one"), bus.attach("two")
    bus.submit(one, SENT)
    events = bus.run_until()
    first_ns = 5 + lasts_ns() - 3 * BIT_NS
    assert reports(events, ErrorClass.PROTOCOL) == [first_ns + 20 * BIT_NS]
    again_ns = first_ns + 23 * BIT_NS
    assert plain(events) == [(first_ns, one.number, OTHERS), (again_ns + lasts_ns() - 3 * BIT_NS, one.number, BOTH)]
    counts = bus.counts
    assert (counts.accepted, counts.transmitted, counts.errors, counts.duplicated, counts.lost) == (1, 1, 1, 1, 0)
    assert counts.busy_ns == 2 * lasts_ns() + 20 * BIT_NS


def test_a_duplicate_of_two_senders_is_that_of_the_first_in_the_queue() -> None:
    bus = SimulatedBus(faults=[Fault(duplicate_ratio=1.0)])
    one, two = bus.attach("one"), bus.attach("two")
    bus.submit(two, SENT)
    bus.submit(one, SENT)
    told = plain(bus.run_until())
    assert [each[1:] for each in told] == [(two.number, OTHERS), (two.number, BOTH), (one.number, OWNER)]
    assert told[1][0] == told[2][0]
    assert (bus.counts.transmitted, bus.counts.duplicated, bus.counts.errors) == (2, 1, 1)


def test_a_frame_that_nobody_acknowledges_fails_behind_the_ack_slot() -> None:
    """16 times 8 errors make the sender passive: it waits 8 bits more, fails once more, and tries no further."""
    bus = SimulatedBus()
    one = bus.attach("one")
    bus.submit(one, SENT)
    events = bus.run_until()
    round_ns = lasts_ns() - 11 * BIT_NS + 20 * BIT_NS
    ends_ns = [5 + (each + 1) * round_ns + each * 3 * BIT_NS for each in range(16)]
    assert reports(events, ErrorClass.ACK) == [*ends_ns, ends_ns[-1] + (3 + 8) * BIT_NS + round_ns]
    assert (bus.counts.errors, bus.waiting(one), bus.next_event_ns()) == (17, 1, None)
    assert bus.counts.busy_ns == 17 * (round_ns + 3 * BIT_NS)
    now_ns = bus.now_ns
    listener = bus.attach("two")
    (again,) = plain(bus.run_until())
    free_ns = ends_ns[-1] + (3 + 8) * BIT_NS + round_ns + 3 * BIT_NS
    assert now_ns == free_ns - 3 * BIT_NS
    # The sender is passive still: it waits for 8 bits behind the intermission.
    assert again == (free_ns + 8 * BIT_NS + lasts_ns() - 3 * BIT_NS, one.number, BOTH)
    assert listener.controllers[0].receive_errors == 0
    assert (one.controllers[0].transmit_errors, one.state) == (127, State.WARNING)


def test_a_station_that_left_acknowledges_nothing() -> None:
    bus = SimulatedBus()
    one, two = bus.attach("one"), bus.attach("two")
    bus.detach(two)
    bus.submit(one, SENT)
    assert plain(bus.run_until()) == []
    assert (bus.counts.transmitted, one.state) == (0, State.PASSIVE)


def test_lost_and_delayed_frames_are_counted_and_echoed_at_their_end() -> None:
    bus = SimulatedBus(faults=[Fault(can_id=1, mask=1, loss_ratio=1.0), Fault(delay_ratio=1.0, delay_s=1e-3)])
    one, two = bus.attach("one"), bus.attach("two")
    sent = np.concatenate([frame(1), frame(2, time_ns=1_000_000)])
    bus.submit(one, sent[:1])
    bus.submit(two, sent[:1])
    told = plain(bus.run_until())
    end_ns = lasts_ns(sent[:1]) - 3 * BIT_NS
    assert told == [(end_ns, one.number, OWNER), (end_ns, two.number, OWNER)]
    assert (bus.counts.lost, bus.counts.delayed, bus.counts.transmitted) == (1, 0, 2)
    assert bus.counts.busy_ns == lasts_ns(sent[:1])  # both are on the wire together
    bus.submit(one, sent[1:])
    told, end_ns = plain(bus.run_until()), lasts_ns(sent[1:]) - 3 * BIT_NS
    assert told == [(1_000_000 + end_ns, one.number, OWNER), (2_000_000 + end_ns, one.number, OTHERS)]
    assert (bus.counts.lost, bus.counts.delayed) == (1, 1)


def off_at(bus: SimulatedBus) -> int:
    """Run until the next controller is bus-off; return when."""
    while True:
        event_ns = bus.next_event_ns()
        assert event_ns is not None
        found = reports(bus.run_until(event_ns), ErrorClass.BUS_OFF)
        if found:
            return found[0]


@pytest.mark.parametrize(("options", "restart_ns"), [({}, 100_000_000), ({"restart_s": 3600.0}, 3_600_000_000_000)])
def test_a_controller_that_is_bus_off_comes_back_on_the_nanosecond(options: dict[str, float], restart_ns: int) -> None:
    """After the restart delay, 128 times 11 recessive bits; a frame meanwhile holds 11 of them."""
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)], **options)  # type: ignore[arg-type]
    bad, good = bus.attach("bad"), bus.attach("good")
    bus.attach("third")
    bus.submit(bad, burst([0x100]))
    back_ns = off_at(bus) + restart_ns + 128 * 11 * BIT_NS
    assert bus.next_event_ns() == back_ns
    assert bad.controllers[0].restart_ns == back_ns - 128 * 11 * BIT_NS
    at_restart = frame(0x2AA, b"\x55", time_ns=bad.controllers[0].restart_ns)
    bus.submit(good, at_restart)
    assert len(plain(bus.run_until(back_ns - 1))) == 1
    back_ns += lasts_ns() - 11 * BIT_NS
    assert bus.next_event_ns() == back_ns
    assert bad.state is State.BUS_OFF
    assert reports(bus.run_until(back_ns), ErrorClass.RESTARTED) == [back_ns]
    assert bad.state is State.ACTIVE
    assert (bus.next_event_ns(), bus.now_ns) == (None, back_ns)


def test_a_frame_just_before_the_restart_holds_nothing_of_the_recovery() -> None:
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)])
    bad, good = bus.attach("bad"), bus.attach("good")
    bus.attach("third")
    bus.submit(bad, burst([0x100]))
    restart_ns = off_at(bus) + 100_000_000
    bus.submit(good, frame(0x2AA, b"\x55", time_ns=restart_ns - 1))
    assert reports(bus.run_until(), ErrorClass.RESTARTED) == [restart_ns + 128 * 11 * BIT_NS]
    assert bad.state is State.ACTIVE


def test_controllers_that_are_bus_off_recover_in_the_order_of_their_errors() -> None:
    bus = SimulatedBus(faults=[Fault(controller="bad*", bit_error_rate=1.0)])
    first, second = bus.attach("bad1"), bus.attach("bad2")
    bus.attach("good")
    bus.attach("other")
    bus.submit(first, burst([0x100]))
    first_ns = off_at(bus)
    bus.submit(second, burst([0x100]))
    second_ns = off_at(bus)
    later_ns = 100_000_000 + 128 * 11 * BIT_NS
    events = bus.run_until()
    back = events.frames["can_id"] & ErrorClass.RESTARTED != 0
    assert events.frames["time_ns"][back].tolist() == [first_ns + later_ns, second_ns + later_ns]
    assert events.owner[back].tolist() == [first.number, second.number]


def test_a_recovery_comes_before_a_frame_that_starts_with_it() -> None:
    """The controller that comes back acknowledges: the only other one does not stay alone."""
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)])
    bad, good = bus.attach("bad"), bus.attach("good")
    bus.submit(bad, burst([0x100]))
    back_ns = off_at(bus) + 100_000_000 + 128 * 11 * BIT_NS
    bus.submit(good, frame(0x2AA, b"\x55", time_ns=back_ns))
    assert plain(bus.run_until()) == [(back_ns + lasts_ns() - 3 * BIT_NS, good.number, BOTH)]
    assert bus.counts.errors == 32
    assert bad.controllers[0].receive_errors == 0


def test_a_passive_controller_waits_eight_bits_behind_its_own_frames_alone() -> None:
    bus = SimulatedBus()
    weak, other = bus.attach("weak"), bus.attach("other")
    weak.controllers[0].transmit_errors = 140
    bus._confinement.judge(weak.controllers.values(), (), 0, 0)
    bus.submit(weak, np.concatenate([SENT, SENT, SENT]))
    ends_ns = [end for end, _, _ in plain(bus.run_until())]
    assert np.diff(ends_ns).tolist() == 2 * [lasts_ns() + 8 * BIT_NS]

    begin_ns = bus.now_ns + 1_000_000
    bus.submit(other, frame(0x155, b"\x55", time_ns=begin_ns))
    bus.submit(weak, frame(0x2AA, b"\x55", time_ns=begin_ns))
    (ahead_ns, first, _), (behind_ns, second, _) = plain(bus.run_until())
    assert (first, second) == (other.number, weak.number)
    assert behind_ns - ahead_ns == lasts_ns()
