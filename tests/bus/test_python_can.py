"""Any interface of python-can as a link: an interface of the test, and some of python-can itself."""

import os
import select
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import can
import numpy as np
import pytest

from bus.error_frames import State
from bus.link import open_link
from bus.python_can import PythonCanLink
from canskin.errors import BusError, InputError
from dbc.frame import BRS, ECHO, EXTENDED, FD
from tests.bus.harness import PATIENCE_S, await_state, burst, collect, frame


class Interface:
    """A bus of python-can that does what the test says; its descriptor is readable while `arrived` has messages."""

    def __init__(self, **options: Any) -> None:
        self.options = options
        self.arrived: deque[can.Message] = deque()
        self.sent: list[can.Message] = []
        self.waits: list[float] = []
        self.shutdowns = 0
        #: Messages that are accepted before the interface is full.
        self.room = 1000
        self.error: Exception | None = None
        self.told: can.BusState | Exception = can.BusState.ACTIVE
        self.ear, self.mouth = os.pipe()

    def fileno(self) -> int:
        return self.ear

    @property
    def state(self) -> can.BusState:
        if isinstance(self.told, Exception):
            raise self.told
        return self.told

    def recv(self, timeout_s: float) -> can.Message | None:
        self.waits.append(timeout_s)
        if self.error is not None:
            raise self.error
        return self.arrived.popleft() if self.arrived else None

    def send(self, message: can.Message) -> None:
        if len(self.sent) >= self.room:
            raise can.CanOperationError("full")
        self.sent.append(message)

    def shutdown(self) -> None:
        self.shutdowns += 1


class Blind(Interface):
    """An interface without a descriptor, which waits as long as it is asked to."""

    def fileno(self) -> int:
        raise NotImplementedError

    def recv(self, timeout_s: float) -> can.Message | None:
        select.select([self.ear], [], [], timeout_s)
        return super().recv(timeout_s)


Open = Callable[..., tuple[PythonCanLink, Any]]


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Open]:
    made: list[Interface] = []
    links: list[PythonCanLink] = []

    def open_it(kind: type[Interface] = Interface, bitrate: int = 500_000, **options: Any) -> tuple[PythonCanLink, Any]:
        def make(**given: Any) -> Interface:
            made.append(kind(**given))
            return made[-1]

        monkeypatch.setattr(can, "Bus", make)
        links.append(PythonCanLink("kind", "line", bitrate, **options))
        return links[-1], made[-1]

    yield open_it
    for link in links:
        link.close()
    for one in made:
        os.close(one.ear)
        os.close(one.mouth)


def readable(link: PythonCanLink) -> bool:
    return bool(select.select([link], [], [], 0)[0])


def test_an_interface_is_opened_with_rates_alone(opened: Open) -> None:
    """Nothing comes from python-can's own files. CAN FD without a data bit rate has that of the identifier."""
    place = {"channel": "line", "interface": "kind", "ignore_config": True, "bitrate": 500_000}
    assert opened()[1].options == place
    assert opened(data_bitrate=2_000_000)[1].options == place
    assert opened(fd=True, data_bitrate=2_000_000)[1].options == {**place, "fd": True, "data_bitrate": 2_000_000}
    assert opened(fd=True)[1].options == {**place, "fd": True, "data_bitrate": 500_000}


def test_what_an_interface_tells_of_its_controller(opened: Open) -> None:
    link, interface = opened()
    states = []
    for told in (
        can.BusState.ACTIVE,
        can.BusState.PASSIVE,
        can.BusState.ERROR,
        NotImplementedError(),
        can.CanOperationError("no answer"),
    ):
        interface.told = told
        states.append(link.state)
    assert states == [State.ACTIVE, State.PASSIVE, State.BUS_OFF, State.ACTIVE, State.ACTIVE]
    assert link.keeps_order is False
    assert link.stamp_error_ns is None
    assert link.dropped == 0


def test_each_accepted_frame_is_echoed_and_wakes_the_reader(opened: Open) -> None:
    link, interface = opened()
    assert not readable(link)
    sent = burst([0x181, 0x182, 0x183])
    sent["port"] = [1, 2, 3]
    sent["expires_ns"] = 1 << 62
    interface.room = 2
    before_ns = time.monotonic_ns()
    assert link.send(sent) == 2
    assert [message.arbitration_id for message in interface.sent] == [0x181, 0x182]
    assert readable(link)
    echoes = link.receive()
    assert not readable(link)
    assert echoes["can_id"].tolist() == [0x181, 0x182]
    assert echoes["port"].tolist() == [1, 2]
    assert echoes["flags"].tolist() == [ECHO, ECHO]
    assert echoes["expires_ns"].tolist() == [0, 0]
    assert (echoes["data"] == sent["data"][:2]).all()
    assert ((echoes["time_ns"] >= before_ns) & (echoes["time_ns"] <= time.monotonic_ns())).all()
    assert sent["flags"].tolist() == [0, 0, 0]


def test_a_frame_that_is_late_is_not_sent_nor_any_behind_it(opened: Open) -> None:
    link, interface = opened()
    sent = burst([0x181, 0x182, 0x183])
    sent["expires_ns"] = [0, 1, 0]
    assert link.send(sent) == 1
    assert [message.arbitration_id for message in interface.sent] == [0x181]


def test_can_fd_needs_a_link_with_can_fd(opened: Open) -> None:
    one = frame(0x181, bytes(12), FD | BRS)
    with pytest.raises(InputError, match="CAN FD on a classical link"):
        opened()[0].send(one)
    link, interface = opened(fd=True)
    assert link.send(one) == 1
    assert (interface.sent[0].is_fd, interface.sent[0].bitrate_switch, interface.sent[0].dlc) == (True, True, 12)


@pytest.mark.parametrize("error", [can.CanOperationError("gone"), OSError("gone")])
def test_an_interface_whose_reading_fails_is_not_read_again(opened: Open, error: Exception) -> None:
    link, interface = opened()
    os.write(interface.mouth, b"x")
    assert readable(link)
    interface.error = error
    assert not len(link.receive())
    assert link.state is State.LOST
    assert not readable(link)
    waits = len(interface.waits)
    assert not len(link.receive())
    assert len(interface.waits) == waits == 1


def test_an_interface_without_a_descriptor_is_read_until_it_fails(opened: Open) -> None:
    link, interface = opened(Blind)
    interface.arrived.append(can.Message(arbitration_id=7, is_extended_id=False))
    os.write(interface.mouth, b"x")  # and from now on the interface waits no more
    assert select.select([link], [], [], PATIENCE_S)[0] == [link]
    assert link.receive()["can_id"].tolist() == [7]
    interface.error = OSError("unplugged")
    await_state(link, State.LOST)
    assert not len(link.receive())


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


@pytest.mark.parametrize(("interface", "what"), [("no-such", "no-such"), ("pcan", "pcan")])
def test_what_python_can_says_becomes_one_line(interface: str, what: str) -> None:
    with pytest.raises(BusError, match=what) as caught:
        open_link(interface, "channel", 1_000_000)
    assert "\n" not in str(caught.value)
