"""Error counters, states and reports of controllers (ISO 11898-1, fault confinement)."""

import numpy as np
import pytest

from bus.controller import Controller
from bus.error_frames import ErrorClass, State, ack_report, bit_report, state_of_report, state_report
from bus.faults import Fault
from bus.outbox import DISCARDED, OTHERS, OWNER
from bus.simulated_bus import SimulatedBus
from dbc.frame import ERROR, Frames
from tests.bus.harness import burst, frame

BIT_NS = 1000
#: ISO 11898-1: 128 occurrences of eleven recessive bits.
RECOVERY_NS = 128 * 11 * BIT_NS


def test_bus_off_after_32_errors_and_recovery_after_restart_and_128_times_11_bits() -> None:
    faults = [Fault(controller="bad:0", can_id=0x100, mask=0x700, bit_error_rate=1.0)]
    bus = SimulatedBus(faults=faults, restart_s=0.1)
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
    back = bus.run_until(200_000_000).frames
    assert back["time_ns"].tolist() == [off["time_ns"][0] + 100_000_000 + RECOVERY_NS]
    assert back["can_id"][0] & ErrorClass.RESTARTED
    assert bad.state is State.ACTIVE
    bus.submit(bad, burst([0x200]), 200_000_000)
    assert list(bus.run_until().frames["can_id"]) == [0x200]


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
    bus = SimulatedBus(faults=[Fault(can_id=0, mask=0x700, bit_error_rate=0.01)], seed=3)
    one, two = bus.attach("one"), bus.attach("two")
    bus.submit(one, burst(range(5)), 0)
    bus.run_until()
    hurt = one.controllers[0].transmit_errors, two.controllers[0].receive_errors
    assert min(hurt) > 0
    for _ in range(4):
        bus.submit(one, burst(range(0x100, 0x140)), bus.now_ns)
        bus.run_until()
    assert (one.controllers[0].transmit_errors, two.controllers[0].receive_errors) == (0, 0)


def test_two_controllers_with_one_identifier_and_different_data_destroy_each_other() -> None:
    """Each error frame takes 20 bits, and an intermission follows."""
    bus = SimulatedBus(restart_s=1.0)
    one, two = bus.attach("one"), bus.attach("two")
    bus.attach("third")
    bus.submit(one, frame(0x181, b"\x01\x02"), 5)
    bus.submit(two, frame(0x181, b"\x01\x03"), 5)
    events = bus.run_until(1_000_000)
    mine = (events.owner == one.number) & (events.frames["can_id"] & ErrorClass.PROTOCOL != 0)
    times_ns = events.frames["time_ns"][mine]
    clash = 19 + 8  # the second byte differs
    assert times_ns[0] == 5 + (clash + 20) * BIT_NS
    assert (np.diff(times_ns[:10]) == (clash + 20 + 3) * BIT_NS).all()  # all error active: nobody waits longer
    assert bus.counts.busy_ns == bus.counts.errors * (clash + 20 + 3) * BIT_NS
    bus.run_until(500_000_000)
    assert (one.state, two.state) == (State.BUS_OFF, State.BUS_OFF)
    assert bus.counts.transmitted == 0


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


def test_a_controller_without_power_neither_sends_nor_acknowledges() -> None:
    bus = SimulatedBus(faults=[Fault(controller="dead:*", off=True)])
    alive, dead = bus.attach("alive"), bus.attach("dead")
    bus.submit(dead, burst([0x100]), 0)
    bus.submit(alive, burst([0x200]), 0)
    events = bus.run_until(50_000_000)
    assert dead.off
    assert (events.frames["flags"] & DISCARDED == DISCARDED).sum() == 1
    assert bus.counts.transmitted == 0
    bus.attach("late")
    got = bus.run_until().frames
    assert list(got["can_id"][got["flags"] == 0]) == [0x200]


def test_a_controller_without_power_counts_no_errors_of_others() -> None:
    bus = SimulatedBus(faults=[Fault(controller="dead:0", off=True), Fault(controller="bad:0", bit_error_rate=1.0)])
    bad, dead, good = bus.attach("bad"), bus.attach("dead"), bus.attach("good")
    bus.submit(bad, burst([0x100]), 0)
    bus.run_until(50_000_000)
    assert (dead.controllers[0].receive_errors, good.controllers[0].receive_errors) == (0, 32)


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


@pytest.mark.parametrize(("before", "after"), [(0, 0), (1, 0), (2, 1), (127, 126), (128, 119), (255, 119)])
def test_a_received_frame_takes_one_error_back_or_ends_passive_at_119(before: int, after: int) -> None:
    controller = Controller("a:0", 0, 0, receive_errors=before)
    controller.received()
    assert controller.receive_errors == after


# Reports, byte by byte as Linux has them in ``include/uapi/linux/can/error.h``

CRTL, PROT, ACK, BUSOFF, BUSERROR, RESTARTED, CNT = 0x004, 0x008, 0x020, 0x040, 0x080, 0x100, 0x200


@pytest.mark.parametrize(
    ("report", "why", "data"),
    [
        (state_report(State.WARNING, 96, 0), CRTL | CNT, "00 08 00 00 00 00 60 00"),
        (state_report(State.WARNING, 0, 97), CRTL | CNT, "00 04 00 00 00 00 00 61"),
        (state_report(State.PASSIVE, 128, 5), CRTL | CNT, "00 20 00 00 00 00 80 05"),
        (state_report(State.PASSIVE, 5, 128), CRTL | CNT, "00 10 00 00 00 00 05 80"),
        (state_report(State.ACTIVE, 95, 94), CRTL | CNT, "00 40 00 00 00 00 5f 5e"),
        (state_report(State.ACTIVE, 0, 0, restarted=True), CRTL | RESTARTED | CNT, "00 40 00 00 00 00 00 00"),
        (state_report(State.BUS_OFF, 256, 3), BUSOFF | CNT, "00 00 00 00 00 00 ff 03"),
        (ack_report(8, 0), ACK | BUSERROR | CNT, "00 00 80 19 00 00 08 00"),
        (bit_report(8, 300), PROT | BUSERROR | CNT, "00 00 81 00 00 00 08 ff"),
    ],
)
def test_reports_have_the_bytes_of_socketcan(report: Frames, why: int, data: str) -> None:
    (one,) = report
    assert (one["can_id"], one["flags"], one["length"]) == (why, ERROR, 8)
    assert one["data"][:8].tobytes().hex(" ") == data
