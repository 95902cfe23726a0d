"""When a bus may have lost frames: reports of the controller, its state, and what its receive side has dropped."""

import numpy as np
import pytest

from bus.link import State
from dbc.frame import ECHO, ERROR, Frames, frames
from gateway.batch import batch_of
from gateway.gathering import Health, Sync
from tests.bus.harness import frame
from tests.layouts import small_contract

TABLE = small_contract().table

#: SocketCAN's classes of error frames (linux/can/error.h).
CONTROLLER, BUS_OFF, RESTARTED, ACKNOWLEDGE = 0x004, 0x040, 0x100, 0x020


def seen(health: Health, arrived: Frames, state: State = State.ACTIVE, dropped: int = 0) -> tuple[bool, bool, bool]:
    """Return whether there is a gap, the bus is down, and has returned."""
    health.look(state, dropped, 7, tells_loss=batch_of(arrived, 0, TABLE).tells_loss)
    return health.has_gap, health.is_down, health.has_returned


def report(why: int, control: int = 0, flags: int = ERROR) -> Frames:
    return np.concatenate([frame(0x181, b"\1\1"), frame(why, bytes((0, control, 0, 0, 0, 0, 0, 0)), flags)])


def test_a_bus_without_events_has_no_gap() -> None:
    health = Health()
    assert (health.has_gap, health.is_down, health.has_returned, health.stamp_error_ns) == (False, False, False, None)
    for state in (State.ACTIVE, State.WARNING, State.PASSIVE):
        assert seen(health, frame(0x181, b"\1\1"), state) == (False, False, False)
        assert seen(health, frames(0), state) == (False, False, False)
    assert health.stamp_error_ns == 7


@pytest.mark.parametrize("state", [State.BUS_OFF, State.LOST])
def test_a_bus_that_is_down_has_gaps_until_it_is_back(state: State) -> None:
    health = Health()
    assert seen(health, frames(0), state) == (True, True, False)
    assert seen(health, frames(0), state) == (True, True, False)
    assert seen(health, frames(0)) == (True, False, True)
    assert seen(health, frames(0)) == (False, False, False)


def test_frames_that_were_dropped_are_one_gap() -> None:
    health = Health()
    gaps = [seen(health, frames(0), dropped=dropped)[0] for dropped in (0, 3, 3, 4, 4)]
    assert gaps == [False, True, False, True, False]


@pytest.mark.parametrize(
    ("why", "control", "flags", "gap"),
    [
        (BUS_OFF, 0, ERROR, True),
        (RESTARTED, 0, ERROR, True),
        (BUS_OFF | ACKNOWLEDGE, 0, ERROR, True),
        (CONTROLLER, 0x01, ERROR, True),
        (CONTROLLER, 0x05, ERROR, True),
        (CONTROLLER, 0x02, ERROR, False),
        (CONTROLLER, 0x00, ERROR, False),
        (ACKNOWLEDGE, 0x01, ERROR, False),
        (BUS_OFF, 0, 0, False),
        (BUS_OFF, 0, ERROR | ECHO, False),
        (CONTROLLER, 0x01, 0, False),
    ],
)
def test_reports_of_a_bus_off_and_of_an_overflow_tell_of_a_gap(
    why: int, control: int, flags: int, *, gap: bool
) -> None:
    """An overflow is bit 0 of byte 1 (CAN_ERR_CRTL_RX_OVERFLOW); ECHO marks a frame of our own that was given back."""
    assert seen(Health(), report(why, control, flags)) == (gap, False, False)


def test_a_sync_knows_when_it_was_due() -> None:
    assert Sync(1, 1, 2_500_000_000, None, 0).due_s == 2.5
