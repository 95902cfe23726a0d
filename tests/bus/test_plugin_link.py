"""What programs of python-can get and cause on a link of the test's own: times, states, queues and errors."""

import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from bus import plugin
from bus.error_frames import State
from bus.plugin import ArbitratedBus
from bus.protocol import Hello
from canskin.errors import BusError, InputError
from dbc.frame import ECHO, ERROR, Frames, frames
from tests.bus.harness import burst, frame


class Wire:
    """A link on which the test says what is accepted and what arrives."""

    def __init__(self, channel: str, hello: Hello, *, wait_s: float) -> None:
        self.opened = channel, hello, wait_s
        self.state = State.ACTIVE
        self.sent: list[Frames] = []
        self.refusals = 0
        self.error: Exception | None = None
        self.arrived: list[Frames] = []
        self.closed = 0
        self.event = os.eventfd(0, os.EFD_NONBLOCK)

    def fileno(self) -> int:
        return self.event

    def receive(self) -> Frames:
        got = np.concatenate([frames(0), *self.arrived])
        self.arrived.clear()
        return got

    def send(self, burst: Frames) -> int:
        if self.error is not None:
            raise self.error
        if self.refusals:
            self.refusals -= 1
            return 0
        self.sent.append(burst.copy())
        return len(burst)

    def close(self) -> None:
        self.closed += 1


class Clock:
    """Time that passes only while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.slept: list[float] = []

    def sleep(self, time_s: float) -> None:
        self.slept.append(time_s)
        self.now_s += time_s


Open = Callable[..., tuple[ArbitratedBus, Wire]]
MESSAGE = can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\1\2", timestamp=1.5)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Open]:
    wires: list[Wire] = []
    buses: list[ArbitratedBus] = []

    def make(*place: Any, **rest: Any) -> Wire:
        wires.append(Wire(*place, **rest))
        return wires[-1]

    def open_it(**options: Any) -> tuple[ArbitratedBus, Wire]:
        monkeypatch.setattr(plugin, "ArbitratedLink", make)
        buses.append(ArbitratedBus("bus7", **options))
        return buses[-1], wires[-1]

    yield open_it
    for bus in buses:
        bus.shutdown()
    for wire in wires:
        os.close(wire.event)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("bus.plugin.time.sleep", clock.sleep)
    monkeypatch.setattr("bus.plugin.time.monotonic", lambda: clock.now_s)
    return clock


def readable(bus: can.BusABC) -> bool:
    return bool(select.select([bus], [], [], 0)[0])


def test_a_program_is_called_python_can_and_takes_the_rates_that_the_bus_has(opened: Open) -> None:
    bus, wire = opened()
    assert wire.opened == ("bus7", Hello(name="python-can"), 0.0)
    assert bus.channel_info == "canskin bus7"
    assert bus.protocol is can.CanProtocol.CAN_20
    bus, wire = opened(bitrate=250_000, data_bitrate=2_000_000, fd=True, name="tool", wait_s=3.0, unknown=1)
    assert wire.opened == ("bus7", Hello(name="tool", bitrate=250_000, data_bitrate=2_000_000, fd=True), 3.0)
    assert bus.protocol is can.CanProtocol.CAN_FD


def test_a_bus_that_cannot_be_opened_is_an_error_of_python_can(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise BusError("no bus")

    monkeypatch.setattr(plugin, "ArbitratedLink", fail)
    with pytest.raises(can.CanInitializationError, match="no bus"):
        ArbitratedBus("bus7")


def test_a_message_is_sent_at_once_whatever_its_time_stamp(opened: Open, clock: Clock) -> None:
    bus, wire = opened()
    bus.send(MESSAGE)
    (sent,) = wire.sent
    assert (sent["can_id"].tolist(), sent["time_ns"].tolist(), sent["length"].tolist()) == ([0x181], [0], [2])
    assert clock.slept == []


@pytest.mark.parametrize("timeout", [None, 0.0, -1.0])
def test_without_a_timeout_a_full_queue_is_tried_once(opened: Open, clock: Clock, timeout: float | None) -> None:
    bus, wire = opened()
    wire.refusals = 5
    with pytest.raises(can.CanOperationError, match="transmit queue full"):
        bus.send(MESSAGE, timeout)
    assert (wire.refusals, clock.slept) == (4, [])


def test_a_sender_looks_for_room_every_millisecond_until_its_timeout(opened: Open, clock: Clock) -> None:
    bus, wire = opened()
    wire.refusals = 3
    bus.send(MESSAGE, 1.0)
    assert (len(wire.sent), clock.slept) == (1, [0.001] * 3)
    wire.refusals = 1000
    with pytest.raises(can.CanOperationError, match="transmit queue full"):
        bus.send(MESSAGE, 0.0045)
    assert 1000 - wire.refusals == 6  # at 0, 1, 2, 3, 4 and 5 ms
    wire.refusals, clock.now_s = 1000, 64.0
    clock.sleep(0.0)
    with pytest.raises(can.CanOperationError, match="transmit queue full"):
        bus.send(MESSAGE, 2.0**-10)
    assert 1000 - wire.refusals == 2  # 0 and 1 ms: 0.98 ms are over


def test_what_arrives_while_a_sender_waits_is_kept(opened: Open, clock: Clock) -> None:
    bus, wire = opened()
    wire.refusals, wire.arrived = 1, [burst([1, 2])]
    bus.send(MESSAGE, 1.0)
    assert clock.slept == [0.001]
    assert not wire.arrived
    assert readable(bus)
    assert [got.arbitration_id for got in (bus.recv(0.0), bus.recv(0.0)) if got] == [1, 2]
    assert not readable(bus)


def test_what_no_controller_could_send_is_an_error_of_python_can(opened: Open) -> None:
    bus, wire = opened()
    wire.error = InputError("CAN FD on a classical link")
    with pytest.raises(can.CanOperationError, match="CAN FD on a classical link"):
        bus.send(MESSAGE)


def test_states_of_a_controller(opened: Open) -> None:
    bus, wire = opened()
    told = {}
    for state in State:
        wire.state = state
        told[state.name] = bus.state
    assert told == {
        "ACTIVE": can.BusState.ACTIVE,
        "WARNING": can.BusState.ACTIVE,
        "PASSIVE": can.BusState.PASSIVE,
        "BUS_OFF": can.BusState.ERROR,
        "LOST": can.BusState.ERROR,
    }
    with pytest.raises(NotImplementedError, match="error counters"):
        bus.state = can.BusState.PASSIVE


def test_bus_off_keeps_from_sending_and_a_lost_bus_from_both(opened: Open) -> None:
    bus, wire = opened()
    wire.state = State.BUS_OFF
    assert bus.recv(0.0) is None
    with pytest.raises(can.CanOperationError, match=r"canskin bus7: bus-off$"):
        bus.send(MESSAGE)
    wire.state, wire.arrived = State.LOST, [burst([5])]
    got = bus.recv(0.0)  # what came before is told first
    assert got is not None
    for use in (lambda: bus.recv(0.0), lambda: bus.send(MESSAGE)):
        with pytest.raises(can.CanOperationError, match="bus7: the process that serves the bus is gone"):
            use()
    assert wire.sent == []


@pytest.mark.parametrize(("own", "expected"), [(False, [1, 4]), (True, [1, 2, 4])])
def test_echoes_come_if_wanted_and_frames_that_were_given_up_never(
    opened: Open, own: bool, expected: list[int]
) -> None:
    bus, wire = opened(receive_own_messages=own)
    wire.arrived = [frame(1), frame(2, flags=ECHO), frame(3, flags=ECHO | ERROR), frame(4, bytes(8), flags=ERROR)]
    got = list(iter(lambda: bus.recv(0.0), None))
    assert [message.arbitration_id for message in got] == expected
    assert [message.is_rx for message in got] == [message.arbitration_id != 2 for message in got]
    assert [message.is_error_frame for message in got] == [message.arbitration_id == 4 for message in got]
    assert {message.channel for message in got} == {"bus7"}


def test_time_stamps_are_those_of_the_wall_clock(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    bus, wire = opened()
    monkeypatch.setattr(plugin, "wall_offset", lambda: type("Offset", (), {"ns": 1_700_000_000_000_000_000}))
    wire.arrived = [frame(1, time_ns=2_500_000_000)]
    got = bus.recv(0.0)
    assert got is not None
    assert got.timestamp == pytest.approx(1_700_000_002.5, abs=1e-6)


def test_messages_that_wait_keep_the_bus_readable_and_their_order(opened: Open) -> None:
    bus, wire = opened()
    assert not readable(bus)
    wire.arrived = [burst([1, 2, 3])]
    first = bus.recv(0.0)
    wire.arrived = [burst([4])]
    assert readable(bus)
    rest = [bus.recv(0.0) for _ in range(3)]
    assert [got.arbitration_id for got in (first, *rest) if got] == [1, 2, 3, 4]
    assert not readable(bus)
    assert bus.recv(0.0) is None


def test_65536_messages_are_kept_for_a_program_that_does_not_read(opened: Open) -> None:
    bus, _ = opened()
    assert bus._messages.maxlen == 65_536


def test_a_receiver_waits_until_its_timeout_and_no_longer(opened: Open, clock: Clock) -> None:
    bus, wire = opened()
    waits: list[float | None] = []

    class Poll:
        def poll(self, timeout_s: float | None, most: int) -> None:
            assert most == 1
            waits.append(timeout_s)
            clock.now_s += 0.25
            if len(waits) == 5:
                wire.arrived = [frame(9)]

        def close(self) -> None: ...

    bus._epoll.close()
    bus._epoll = Poll()  # type: ignore[assignment]
    assert bus._recv_internal(0.5) == (None, False)
    assert waits == [0.5, 0.25]
    assert bus._recv_internal(0.0) == (None, False)
    assert len(waits) == 2
    message, is_filtered = bus._recv_internal(None)
    assert message is not None
    assert (message.arbitration_id, is_filtered, waits[2:]) == (9, False, [None, None, None])


def test_a_bus_is_left_once(opened: Open) -> None:
    bus, wire = opened()
    bus.shutdown()
    bus.shutdown()
    assert wire.closed == 1
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.eventfd_read(bus._waiting)
    with pytest.raises(ValueError, match="closed"):
        bus.fileno()


def test_buses_with_a_socket_are_found_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("right.can", "left.can", "other.sock"):
        (tmp_path / name).touch()
    monkeypatch.setenv("SKIN_BUS_DIR", str(tmp_path))
    assert ArbitratedBus._detect_available_configs() == [
        {"interface": "canskin", "channel": "left"},
        {"interface": "canskin", "channel": "right"},
    ]
