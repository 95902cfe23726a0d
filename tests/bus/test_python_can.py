"""Any interface of python-can as a link: with and without a file descriptor."""

import time

import can
import numpy as np
import pytest

from bus.error_frames import State
from bus.link import Filter, open_link
from bus.messages import to_frame
from bus.python_can import PythonCanLink
from canskin.errors import BusError
from dbc.frame import ECHO, EXTENDED, FD
from tests.bus.harness import PATIENCE_S, burst, collect, frame, linked, serving


def test_frames_go_both_ways_and_are_echoed() -> None:
    with can.Bus(interface="virtual", channel="both ways") as other:
        link = open_link("virtual", "both ways", 1_000_000)
        try:
            assert isinstance(link, PythonCanLink)
            assert link.send(np.concatenate([frame(0x181, b"\x01", port=3), frame(0x12345, flags=EXTENDED)])) == 2
            echoes = collect(link, 2)
            assert echoes["flags"].tolist() == [ECHO, ECHO | EXTENDED]
            assert echoes["port"].tolist() == [3, 0]
            got = other.recv(PATIENCE_S)
            assert got is not None
            assert (got.arbitration_id, bytes(got.data), got.is_extended_id) == (0x181, b"\x01", False)
            other.send(can.Message(arbitration_id=0x601, data=b"\x02\x03", is_extended_id=False))
            arrived = collect(link, 1)[0]
            assert (arrived["can_id"], arrived["flags"], bytes(arrived["data"][:2])) == (0x601, 0, b"\x02\x03")
            assert abs(int(arrived["time_ns"]) - time.monotonic_ns()) < 60e9
            assert link.state is State.ACTIVE
        finally:
            link.close()
            link.close()


def test_interfaces_with_a_descriptor_are_read_without_a_thread() -> None:
    with serving("bus0"), linked("other") as (other,):
        link = PythonCanLink("canskin", "bus0", 1_000_000, filters=[Filter(0x180, 0x780)])
        try:
            assert link._thread is None
            other.send(burst([0x100, 0x181, 0x182]))
            assert collect(link, 2)["can_id"].tolist() == [0x181, 0x182]
            link.send(frame(0x183))
            assert collect(link, 1)["flags"].tolist() == [ECHO]
        finally:
            link.close()


def test_an_interface_that_fails_is_lost_and_read_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving("bus0"):
        link = PythonCanLink("canskin", "bus0", 1_000_000)
    try:
        until = time.monotonic() + PATIENCE_S
        while link.state is not State.LOST:
            assert time.monotonic() < until
            link.receive()
        assert not link._epoll.poll(0)
        monkeypatch.setattr(link._bus, "recv", None)
        assert not len(link.receive())
        assert link.send(frame(1)) == 0
    finally:
        link.close()


def test_a_caller_that_does_not_receive_loses_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus.python_can.QUEUE_FRAMES", 10)
    link = open_link("virtual", "full", 1_000_000)
    try:
        assert link.send(burst(range(15))) == 15
        assert link.dropped == 5
        assert len(collect(link, 10)) == 10
    finally:
        link.close()


@pytest.mark.parametrize(("interface", "what"), [("no-such", "no-such"), ("pcan", "pcan")])
def test_what_python_can_says_becomes_one_line(interface: str, what: str) -> None:
    with pytest.raises(BusError, match=what) as caught:
        open_link(interface, "channel", 1_000_000)
    assert "\n" not in str(caught.value)


def test_fd_messages_keep_their_flags() -> None:
    record = to_frame(can.Message(arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(12)), 0)[0]
    assert (record["flags"], record["length"]) == (FD, 12)
