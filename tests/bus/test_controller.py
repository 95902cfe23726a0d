"""Error counters of one controller (ISO 11898-1, fault confinement)."""

import pytest

from bus.controller import Controller
from bus.error_frames import State


@pytest.mark.parametrize(("before", "after"), [(0, 0), (1, 0), (2, 1), (127, 126), (128, 119), (255, 119)])
def test_a_received_frame_takes_one_error_back_or_ends_passive_at_119(before: int, after: int) -> None:
    controller = Controller("a:0", 0, 0, receive_errors=before)
    controller.received()
    assert controller.receive_errors == after


@pytest.mark.parametrize(("before", "after"), [(0, 0), (1, 0), (8, 7), (200, 199)])
def test_a_sent_frame_takes_one_error_back(before: int, after: int) -> None:
    controller = Controller("a:0", 0, 0, transmit_errors=before)
    controller.transmitted()
    assert controller.transmit_errors == after


def test_errors_count_one_received_and_eight_sent_up_to_their_ends() -> None:
    controller = Controller("a:0", 0, 0, receive_errors=253)
    counts = []
    for _ in range(3):
        controller.receive_failed()
        counts.append(controller.receive_errors)
    assert counts == [254, 255, 255]
    controller.transmit_failed(unacknowledged=True)
    controller.state = State.PASSIVE
    controller.transmit_failed(unacknowledged=True)
    assert controller.transmit_errors == 8
    controller.transmit_failed(unacknowledged=False)
    assert (controller.transmit_errors, controller.disturbed) == (16, True)
    controller.reset()
    assert (controller.transmit_errors, controller.receive_errors, controller.state) == (0, 0, State.ACTIVE)
    assert not controller.disturbed
