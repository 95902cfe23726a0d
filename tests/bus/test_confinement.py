"""Error counters and states of controllers (ISO 11898-1, fault confinement)."""

import numpy as np
import pytest

from bus.controller import Controller
from bus.error_frames import ErrorClass, State, state_of_report, state_report
from bus.faults import Fault
from bus.outbox import DISCARDED, OTHERS, OWNER, Events
from bus.simulated_bus import SimulatedBus
from dbc.frame import ERROR
from tests.bus.harness import burst, frame

BIT_NS = 1000
#: ISO 11898-1: 128 occurrences of eleven recessive bits.
RECOVERY_NS = 128 * 11 * BIT_NS


def reports(events: Events) -> list[ErrorClass]:
    only = events.frames[events.frames["flags"] & DISCARDED == ERROR]
    return [ErrorClass(int(one)) for one in only["can_id"]]


def test_alone_on_the_bus_a_frame_is_repeated_until_somebody_acknowledges() -> None:
    bus = SimulatedBus()
    alone = bus.attach("alone")
    bus.submit(alone, burst([0x181]), 0)
    events = bus.run_until(100_000_000)
    assert alone.state is State.PASSIVE
    assert alone.controllers[0].transmit_errors == 128  # and no further: it never goes bus-off
    acks = [why for why in reports(events) if why & ErrorClass.ACK]
    assert len(acks) == 17
    assert bus.counts.transmitted == 0
    bus.attach("listener")
    events = bus.run_until(200_000_000)
    assert list(events.frames["can_id"][events.frames["flags"] == 0]) == [0x181]
    assert events.frames["time_ns"][0] > 100_000_000
    assert alone.controllers[0].transmit_errors == 127
    assert alone.state is State.WARNING


def test_a_listener_without_controllers_acknowledges_nothing() -> None:
    bus = SimulatedBus()
    alone = bus.attach("alone")
    bus.attach("monitor", listen_only=True)
    bus.submit(alone, burst([0x181]), 0)
    bus.run_until(10_000_000)
    assert bus.counts.transmitted == 0


def test_bus_off_after_32_errors_and_recovery_after_restart_and_128_times_11_bits() -> None:
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)], restart_s=0.1)
    bad, good = bus.attach("bad"), bus.attach("good")
    bus.submit(bad, burst([0x100, 0x101]), 0)
    events = bus.run_until(90_000_000)
    assert bad.state is State.BUS_OFF
    assert bus.counts.errors == 32
    assert good.controllers[0].receive_errors == 32
    assert (events.frames["flags"] & DISCARDED == DISCARDED).sum() == 2
    off = events.frames[events.frames["can_id"] == ErrorClass.BUS_OFF | ErrorClass.COUNTERS]
    assert len(off) == 1
    assert bus.submit(bad, burst([0x100]), 90_000_000) == 1  # given back at once, like a frame for a dead interface
    assert (bus.run_until(91_000_000).frames["flags"] & DISCARDED == DISCARDED).all()
    bus.set_faults([])
    back = bus.run_until(200_000_000).frames
    assert back["time_ns"].tolist() == [off["time_ns"][0] + 100_000_000 + RECOVERY_NS]
    assert back["can_id"][0] & ErrorClass.RESTARTED
    assert bad.state is State.ACTIVE
    bus.submit(bad, burst([0x100]), 200_000_000)
    assert list(bus.run_until().frames["can_id"]) == [0x100]


def test_traffic_of_others_makes_recovery_longer() -> None:
    """A frame holds one of the 128 occurrences, however long it is."""

    def recovery_ns(frames_sent: int) -> int:
        bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)], restart_s=0.0)
        bad, good = bus.attach("bad"), bus.attach("good")
        bus.attach("third")
        bus.submit(bad, burst([0x100]), 0)
        bus.run_until(bus.next_event_ns())
        while bad.state is not State.BUS_OFF:
            bus.run_until(bus.next_event_ns())
        bus.submit(good, burst(range(0x200, 0x200 + frames_sent)), bus.now_ns)
        events = bus.run_until()
        return int(events.frames["time_ns"][events.frames["can_id"] & ErrorClass.RESTARTED != 0][-1])

    quiet, busy = recovery_ns(0), recovery_ns(5)
    assert 5 * 80 * BIT_NS < busy - quiet < 5 * 135 * BIT_NS


def test_traffic_before_the_restart_does_not_make_recovery_longer() -> None:
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)], restart_s=0.1)
    bad, good = bus.attach("bad"), bus.attach("good")
    bus.attach("third")
    bus.submit(bad, burst([0x100]), 0)
    bus.run_until(50_000_000)
    assert bad.state is State.BUS_OFF
    (off_ns,) = {controller.restart_ns - 100_000_000 for controller in bad.controllers.values()}
    bus.submit(good, burst(range(0x200, 0x205)), 50_000_000)
    events = bus.run_until()
    back = events.frames["can_id"] & ErrorClass.RESTARTED != 0
    assert events.frames["time_ns"][back].tolist() == [off_ns + 100_000_000 + RECOVERY_NS]


def test_a_station_that_left_in_bus_off_does_not_recover() -> None:
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)])
    bad = bus.attach("bad")
    bus.attach("good")
    bus.submit(bad, burst([0x100]), 0)
    bus.run_until(50_000_000)
    assert bad.state is State.BUS_OFF
    bus.detach(bad)
    assert bus.next_event_ns() is None
    assert len(bus.run_until().frames) == 0


def test_errors_of_a_station_that_left_are_counted_no_more() -> None:
    bus = SimulatedBus(faults=[Fault(controller="bad:0", bit_error_rate=1.0)])
    bad, good, leaver = bus.attach("bad"), bus.attach("good"), bus.attach("leaver")
    bus.attach("listener")
    bus.submit(bad, burst([0x100]), 0)
    bus.run_until(90_000_000)
    assert good.controllers[0].receive_errors == leaver.controllers[0].receive_errors == 32
    bus.detach(leaver)
    bus.submit(good, burst([0x181] * 10), bus.now_ns)
    bus.run_until(100_000_000)
    assert bus.counts.transmitted == 10
    assert leaver.controllers[0].receive_errors == 32


def test_good_frames_heal_sender_and_receivers() -> None:
    bus = SimulatedBus(faults=[Fault(controller="one:0", bit_error_rate=0.01)], seed=3)
    one, two = bus.attach("one"), bus.attach("two")
    bus.submit(one, burst(range(5)), 0)
    bus.run_until()
    hurt = one.controllers[0].transmit_errors, two.controllers[0].receive_errors
    assert min(hurt) > 0
    bus.set_faults([])
    for _ in range(4):
        bus.submit(one, burst(range(64)), bus.now_ns)
        bus.run_until()
    assert (one.controllers[0].transmit_errors, two.controllers[0].receive_errors) == (0, 0)


def test_two_controllers_with_one_identifier_and_different_data_destroy_each_other() -> None:
    bus = SimulatedBus(restart_s=1.0)
    one, two = bus.attach("one"), bus.attach("two")
    bus.attach("third")
    bus.submit(one, frame(0x181, b"\x01\x02"), 5)
    bus.submit(two, frame(0x181, b"\x01\x03"), 5)
    bus.run_until(500_000_000)
    assert (one.state, two.state) == (State.BUS_OFF, State.BUS_OFF)
    assert bus.counts.transmitted == 0


def test_an_error_frame_takes_20_bits_and_an_intermission_follows() -> None:
    bus = SimulatedBus()
    one, two = bus.attach("one"), bus.attach("two")
    bus.submit(one, frame(0x181, b"\x01\x02"), 5)
    bus.submit(two, frame(0x181, b"\x01\x03"), 5)
    events = bus.run_until(1_000_000)
    mine = (events.owner == one.number) & (events.frames["can_id"] & ErrorClass.PROTOCOL != 0)
    times_ns = events.frames["time_ns"][mine]
    clash = 19 + 8  # the second byte differs
    assert times_ns[0] == 5 + (clash + 20) * BIT_NS
    assert (np.diff(times_ns[:10]) == (clash + 20 + 3) * BIT_NS).all()  # all error active: nobody waits longer
    assert bus.counts.busy_ns == bus.counts.errors * (clash + 20 + 3) * BIT_NS


def test_two_controllers_with_equal_frames_do_not_notice_each_other() -> None:
    bus = SimulatedBus()
    one, two = bus.attach("one"), bus.attach("two")
    bus.submit(one, frame(0x000, b"\x01\x00"), 5)
    bus.submit(two, frame(0x000, b"\x01\x00"), 5)
    events = bus.run_until()
    assert sorted(events.owner.tolist()) == [one.number, two.number]
    assert bus.counts.errors == 0
    assert len(set(events.frames["time_ns"].tolist())) == 1
    assert sorted(events.audience.tolist()) == [OWNER, OTHERS | OWNER]  # receivers get one frame, not two


def test_a_passive_transmitter_lets_others_go_first() -> None:
    bus = SimulatedBus()
    weak, other = bus.attach("weak"), bus.attach("other")
    weak.controllers[0].transmit_errors = 130
    bus._confinement.judge(weak.controllers.values(), (), 0, 0)
    bus.submit(weak, burst([0x001, 0x002]), 0)
    bus.run_until(20_000)  # the first is on the wire
    bus.submit(other, burst([0x7FF]), 20_000)
    assert [int(f["can_id"]) for f in bus.run_until().frames if not f["flags"]] == [0x001, 0x7FF, 0x002]


@pytest.mark.parametrize(
    ("transmit", "receive", "state"),
    [(95, 0, State.ACTIVE), (96, 0, State.WARNING), (0, 127, State.WARNING), (128, 0, State.PASSIVE),
     (0, 128, State.PASSIVE), (255, 0, State.PASSIVE), (256, 0, State.BUS_OFF), (0, 255, State.PASSIVE)],
)  # fmt: skip
def test_states_follow_the_counters(transmit: int, receive: int, state: State) -> None:
    controller = Controller("x:0", 0, 0, transmit_errors=transmit, receive_errors=receive)
    controller.judge()
    assert controller.state is state
    report = state_report(state, transmit, receive)[0]
    assert state_of_report(report, State.ACTIVE) is state
    assert report["data"][6:8].tolist() == [min(transmit, 255), receive]


def test_a_passive_receiver_falls_back_below_the_limit() -> None:
    controller = Controller("x:0", 0, 0, receive_errors=200)
    controller.received()
    assert 119 <= controller.receive_errors <= 127


def test_a_controller_without_power_neither_sends_nor_acknowledges() -> None:
    bus = SimulatedBus(faults=[Fault(controller="dead:*", off=True)])
    alive, dead = bus.attach("alive"), bus.attach("dead")
    bus.submit(dead, burst([0x100]), 0)
    bus.submit(alive, burst([0x200]), 0)
    events = bus.run_until(50_000_000)
    assert dead.off
    assert (events.frames["flags"] & DISCARDED == DISCARDED).sum() == 1
    assert bus.counts.transmitted == 0
    bus.set_faults([])
    got = bus.run_until().frames
    assert list(got["can_id"][got["flags"] == 0]) == [0x200]


def test_a_controller_without_power_counts_no_errors_of_others() -> None:
    bus = SimulatedBus(faults=[Fault(controller="dead:0", off=True), Fault(controller="bad:0", bit_error_rate=1.0)])
    bad, dead, good = bus.attach("bad"), bus.attach("dead"), bus.attach("good")
    bus.submit(bad, burst([0x100]), 0)
    bus.run_until(50_000_000)
    assert (dead.controllers[0].receive_errors, good.controllers[0].receive_errors) == (0, 32)


def test_a_controller_that_loses_power_gets_its_waiting_frames_back() -> None:
    bus = SimulatedBus()
    alive = bus.attach("alive")
    bus.attach("second")
    bus.attach("third")
    bus.submit(alive, burst([0x100, 0x101]), 0)
    bus.set_faults([Fault(controller="alive:0", off=True)])
    assert (bus.run_until().frames["flags"] == DISCARDED).tolist() == [True, True]
    assert (bus.counts.transmitted, bus.counts.discarded) == (0, 2)


def test_same_seed_same_events() -> None:
    def run(seed: int) -> bytes:
        faults = [Fault(bit_error_rate=2e-4, loss_ratio=0.1, duplicate_ratio=0.05, delay_ratio=0.1, delay_s=1e-3)]
        bus = SimulatedBus(faults=faults, seed=seed)
        one, two = bus.attach("one"), bus.attach("two")
        parts = []
        for cycle in range(20):
            bus.submit(one, burst(range(0x100, 0x120)), cycle * 10_000_000)
            bus.submit(two, burst(range(0x200, 0x220)), cycle * 10_000_000)
            parts.append(bus.run_until((cycle + 1) * 10_000_000 - 1).frames)
        return np.concatenate(parts).tobytes()

    assert run(1) == run(1)
    assert run(1) != run(2)
