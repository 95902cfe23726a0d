"""The sampling instant of a cycle, from send calls, time stamps and answers."""

import numpy as np
import pytest

from bus.told import NO_STAMPS
from canskin.messages import UNKNOWN_ERROR_NS
from dbc.contract import Contract
from gateway.open_cycles import slot_of
from gateway.sync_times import SampledTimes, SyncTimes, note_answer, note_echo

SENT_NS = 1_000_000_000
#: A SYNC of one byte without stuff bits at 1 Mbit/s: 52 bits, to the last bit of end of frame.
FRAME_NS = 52_000
BUSES = 4


@pytest.fixture
def times(stock_contract: Contract) -> SyncTimes:
    made = SyncTimes(stock_contract)
    made.open(7, SENT_NS - 20_000, SENT_NS)
    return made


@pytest.fixture(scope="module")
def stock_contract() -> Contract:
    from skin.layout import load_layout

    return Contract.from_layout(load_layout(None))


def closed(times: SyncTimes) -> SampledTimes:
    found = times.close(7)
    assert found.sent_mono_ns == SENT_NS + FRAME_NS
    return found


def test_a_time_stamp_is_the_estimate_and_the_send_call_its_bound(times: SyncTimes) -> None:
    for bus in range(BUSES):
        note_echo(slot_of(7), bus, SENT_NS + FRAME_NS + 30_000, 500, times.notes)
    found = closed(times)
    assert (found.mono_ns, found.error_ns) == (SENT_NS + FRAME_NS + 30_000, 30_500)
    assert found.bus_ns.tolist() == [found.mono_ns] * BUSES


def test_buses_that_differ_are_within_the_error_of_their_mean(times: SyncTimes) -> None:
    ends_ns = SENT_NS + FRAME_NS + np.array([0, 10_000, 20_000, 90_000])
    for bus, end_ns in enumerate(ends_ns.tolist()):
        note_echo(slot_of(7), bus, end_ns, 0, times.notes)
        note_echo(slot_of(7), bus, end_ns + 1_000_000, 0, times.notes)  # a SYNC on the bus twice: the first counts
    found = closed(times)
    assert found.mono_ns == SENT_NS + FRAME_NS + 30_000
    assert found.error_ns == 60_000 + 90_000
    assert found.bus_ns.tolist() == ends_ns.tolist()


def test_an_exact_stamp_before_the_send_call_is_exact(times: SyncTimes) -> None:
    """A virtual bus sends a SYNC that comes late at the time at which it was due."""
    for bus in range(BUSES):
        note_echo(slot_of(7), bus, SENT_NS, 0, times.notes)
    assert closed(times)[:2] == (SENT_NS, 0)


@pytest.mark.parametrize(("early_ns", "error_ns"), [(0, 300), (300, 300), (301, UNKNOWN_ERROR_NS)])
def test_a_stamp_that_contradicts_the_send_call_proves_nothing(times: SyncTimes, early_ns: int, error_ns: int) -> None:
    for bus in range(BUSES):
        note_echo(slot_of(7), bus, SENT_NS + FRAME_NS - early_ns, 300, times.notes)
    assert closed(times)[:2] == (SENT_NS + FRAME_NS - early_ns, error_ns)


def test_an_answer_that_contradicts_the_send_call_proves_nothing(times: SyncTimes) -> None:
    for bus in range(BUSES):
        note_echo(slot_of(7), bus, SENT_NS + 5_000_000, NO_STAMPS, times.notes)
        note_answer(slot_of(7), bus, SENT_NS + FRAME_NS - 1 if bus == 2 else SENT_NS + 9_000_000, times.notes)
    assert closed(times)[:2] == (SENT_NS + FRAME_NS, UNKNOWN_ERROR_NS)


def test_without_stamps_the_send_call_is_the_estimate_and_the_first_answer_its_bound(times: SyncTimes) -> None:
    for bus in range(BUSES):
        note_echo(slot_of(7), bus, SENT_NS + 5_000_000, NO_STAMPS, times.notes)
        for answer_ns in (400_000, 600_000):
            note_answer(slot_of(7), bus, SENT_NS + FRAME_NS + answer_ns, times.notes)
    assert closed(times)[:2] == (SENT_NS + FRAME_NS, 400_000)


def test_without_stamps_and_answers_the_error_is_unknown(times: SyncTimes) -> None:
    for bus in range(BUSES):
        note_echo(slot_of(7), bus, SENT_NS + 5_000_000, NO_STAMPS, times.notes)
    assert closed(times)[:2] == (SENT_NS + FRAME_NS, UNKNOWN_ERROR_NS)


def test_a_bus_without_sync_has_no_instant(times: SyncTimes) -> None:
    note_echo(slot_of(7), 2, SENT_NS + FRAME_NS, 0, times.notes)
    found = closed(times)
    assert found.bus_ns.tolist() == [0, 0, SENT_NS + FRAME_NS, 0]
    assert found[:2] == (SENT_NS + FRAME_NS, 0)


def test_a_cycle_without_any_sync_has_the_time_of_its_send_call(times: SyncTimes) -> None:
    assert closed(times)[:2] == (SENT_NS + FRAME_NS, UNKNOWN_ERROR_NS)


def test_a_replay_has_the_times_of_the_frames(times: SyncTimes) -> None:
    times.open(8, SENT_NS, None)
    note_echo(slot_of(8), 0, SENT_NS + 1_000, 0, times.notes)
    note_echo(slot_of(8), 1, SENT_NS + 3_000, 0, times.notes)
    assert times.close(8)[:3] == (SENT_NS + 2_000, UNKNOWN_ERROR_NS, 0)


def test_the_mean_of_large_times_is_exact(stock_contract: Contract) -> None:
    """Nanoseconds since 1970 have more digits than a float."""
    times, now_ns = SyncTimes(stock_contract), 1_700_000_000_123_456_789
    times.open(7, now_ns, None)
    for bus, later_ns in enumerate((0, 1, 3, 4)):
        note_echo(slot_of(7), bus, now_ns + later_ns, 0, times.notes)
    assert times.close(7).mono_ns == now_ns + 2
