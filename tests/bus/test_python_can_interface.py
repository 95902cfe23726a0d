"""What a link asks of an interface of python-can, and what it makes of the answers: here an interface of the test."""

import os
import select
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from bus.error_frames import State
from bus.link import Filter
from bus.python_can import PythonCanLink
from canskin.errors import InputError
from dbc.frame import BRS, ECHO, FD
from tests.bus.harness import PATIENCE_S, burst, frame


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


def test_an_interface_is_opened_with_rates_and_filters_alone(opened: Open) -> None:
    """Nothing comes from python-can's own files. CAN FD without a data bit rate has that of the identifier."""
    place = {"channel": "line", "interface": "kind", "ignore_config": True, "bitrate": 500_000}
    assert opened()[1].options == place
    assert opened(data_bitrate=2_000_000)[1].options == place
    assert opened(fd=True, data_bitrate=2_000_000)[1].options == {**place, "fd": True, "data_bitrate": 2_000_000}
    assert opened(fd=True)[1].options == {**place, "fd": True, "data_bitrate": 500_000}
    filters = [Filter(0x180, 0x780), Filter(0x181, 0x7FF, extended=False), Filter(5, 6, extended=True)]
    assert opened(filters=filters)[1].options["can_filters"] == [
        {"can_id": 0x180, "can_mask": 0x780},
        {"can_id": 0x181, "can_mask": 0x7FF, "extended": False},
        {"can_id": 5, "can_mask": 6, "extended": True},
    ]


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


def test_a_call_takes_1024_messages_at_most_and_does_not_wait(opened: Open) -> None:
    link, interface = opened()
    interface.arrived.extend(can.Message(arbitration_id=each, is_extended_id=False) for each in range(1100))
    assert link.receive()["can_id"].tolist() == list(range(1024))
    assert set(interface.waits) == {0.0}
    assert link.receive()["can_id"].tolist() == list(range(1024, 1100))
    assert not len(link.receive())
    assert link.dropped == 0


def test_a_message_is_stamped_with_the_time_of_the_wall_clock(opened: Open) -> None:
    link, interface = opened()
    before_ns = time.monotonic_ns()
    interface.arrived.append(can.Message(arbitration_id=1, is_extended_id=False, timestamp=time.time() - 5))
    (got,) = link.receive()
    assert abs(int(got["time_ns"]) + 5_000_000_000 - before_ns) < 2_000_000_000


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


def test_an_interface_is_shut_down_once(opened: Open) -> None:
    link, interface = opened()
    link.close()
    link.close()
    assert interface.shutdowns == 1
    with pytest.raises(ValueError, match="closed"):
        link.fileno()


def test_an_interface_without_a_descriptor_is_read_by_a_thread_until_it_is_closed(opened: Open) -> None:
    link, interface = opened(Blind)
    thread = link._thread
    assert thread is not None
    assert (thread.daemon, thread.name) == (True, "read line")
    interface.arrived.append(can.Message(arbitration_id=7, is_extended_id=False))
    os.write(interface.mouth, b"x")  # and from now on the interface waits no more
    assert select.select([link], [], [], PATIENCE_S)[0] == [link]
    assert link.receive()["can_id"].tolist() == [7]
    link.close()
    assert not thread.is_alive()
    assert set(interface.waits) == {0.0, 0.1}


def test_a_thread_ends_when_its_interface_fails(opened: Open) -> None:
    link, interface = opened(Blind)
    assert link._thread is not None
    interface.error = OSError("unplugged")
    os.write(interface.mouth, b"x")
    link._thread.join(PATIENCE_S)
    assert not link._thread.is_alive()
    assert link.state is State.LOST
    assert not len(link.receive())
