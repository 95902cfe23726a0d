"""Any interface of python-can as a link: an interface of the test, and some of python-can itself."""

import queue
import select
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from bus.bit_timing import choose_timing
from bus.error_frames import State
from bus.link import open_link
from bus.python_can import PythonCanLink
from canskin.errors import BusError, InputError
from dbc.frame import ECHO, EXTENDED
from tests.bus.harness import await_state, burst, collect, frame
from tests.bus.serial_adapter import SerialAdapter
from tests.processes import PATIENCE_S


class Interface:
    """A bus of python-can that does what the test says."""

    def __init__(self, **options: Any) -> None:
        self.options = options
        self.arrived: queue.SimpleQueue[can.Message | Exception] = queue.SimpleQueue()
        self.sent: list[can.Message] = []
        self.shutdowns = 0
        self.timeout_s: float | None = None
        #: Messages that are accepted before the interface is full.
        self.room = 1000
        self.told: can.BusState | Exception = can.BusState.ACTIVE
        self.refusal: Exception = can.CanOperationError("full")

    @property
    def state(self) -> can.BusState:
        if isinstance(self.told, Exception):
            raise self.told
        return self.told

    def recv(self, timeout_s: float) -> can.Message | None:
        try:
            came = self.arrived.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if isinstance(came, Exception):
            raise came
        return came

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self.timeout_s = timeout
        if len(self.sent) >= self.room:
            raise self.refusal
        self.sent.append(message)

    def shutdown(self) -> None:
        self.shutdowns += 1
        raise AttributeError("the adapter is gone")


@dataclass
class Adapters:
    """The interfaces that python-can opened, and whether there is an adapter to open."""

    made: list[Interface] = field(default_factory=list)
    links: list[PythonCanLink] = field(default_factory=list)
    error: Exception | None = None

    def link(self, interface: str = "kind", bitrate: int = 500_000, **options: Any) -> PythonCanLink:
        self.links.append(PythonCanLink(interface, "line", bitrate, **options))
        return self.links[-1]

    @property
    def newest(self) -> Interface:
        return self.made[-1]

    def make(self, **given: Any) -> Interface:
        if self.error is not None:
            raise self.error
        self.made.append(Interface(**given))
        return self.newest


@pytest.fixture
def adapters(monkeypatch: pytest.MonkeyPatch) -> Iterator[Adapters]:
    made = Adapters()
    monkeypatch.setattr(can, "Bus", made.make)
    yield made
    for link in made.links:
        link.close()


def readable(link: PythonCanLink) -> bool:
    return bool(select.select([link], [], [], 0)[0])


def message(can_id: int, **more: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=False, **more)


def test_an_interface_is_opened_with_rates_alone(adapters: Adapters) -> None:
    """Nothing comes from python-can's own files. CAN FD without a data bit rate has that of the identifier."""
    place = {"channel": "line", "interface": "kind", "ignore_config": True, "bitrate": 500_000}
    for given, expected in (
        ({}, {}),
        ({"data_bitrate": 2_000_000}, {}),
        ({"fd": True, "data_bitrate": 2_000_000}, {"fd": True, "data_bitrate": 2_000_000}),
        ({"fd": True}, {"fd": True, "data_bitrate": 500_000}),
    ):
        adapters.link(**given)
        assert adapters.newest.options == place | expected


def test_pcan_gets_the_timing_of_can_fd_and_ends_bus_off_by_itself(adapters: Adapters) -> None:
    adapters.link("pcan", 1_000_000, fd=True, data_bitrate=5_000_000)
    timing = adapters.newest.options["timing"]
    assert (timing.f_clock, timing.nom_bitrate, timing.data_bitrate) == (80_000_000, 1_000_000, 5_000_000)
    assert (timing.nom_sample_point, timing.data_sample_point) == (75.0, 75.0)
    assert adapters.newest.options["auto_reset"] is True
    adapters.link("pcan", 1_000_000, fd=True, options={"auto_reset": False, "f_clock_mhz": 20})
    assert "timing" not in adapters.newest.options
    assert adapters.newest.options["auto_reset"] is False


def test_both_phases_have_one_prescaler_where_the_clock_allows_and_the_shortest_quanta() -> None:
    for clock_hz, rates_hz, prescalers in (
        (16_000_000, [500_000, 500_000], (2, 2)),
        (20_000_000, [250_000, 500_000], (5, 4)),
        (80_000_000, [1_000_000, 5_000_000], (1, 1)),
    ):
        timing = choose_timing(clock_hz, rates_hz)
        assert timing is not None
        assert (timing["nom_brp"], timing["data_brp"]) == prescalers


def test_rates_that_the_clock_of_can_fd_cannot_make_are_refused(adapters: Adapters) -> None:
    """80 MHz are 11.4 periods of 7 Mbit/s."""
    with pytest.raises(InputError, match="80 MHz can make, got 900 and 7000 kbit/s"):
        adapters.link("pcan", 900_000, fd=True, data_bitrate=7_000_000)
    assert not adapters.made


def test_what_an_interface_tells_of_its_controller(adapters: Adapters) -> None:
    link = adapters.link()
    states = []
    for told in (
        can.BusState.ACTIVE,
        can.BusState.PASSIVE,
        can.BusState.ERROR,
        NotImplementedError(),
        can.CanOperationError("no answer"),
    ):
        adapters.newest.told = told
        states.append(link.state)
    assert states == [State.ACTIVE, State.PASSIVE, State.BUS_OFF, State.ACTIVE, State.ACTIVE]
    assert link.proves_echo is False
    assert link.stamp_error_ns is None
    assert link.dropped == 0


def test_an_interface_that_breaks_while_it_is_asked_is_opened_again(adapters: Adapters) -> None:
    """As one does that another thread shuts down meanwhile."""
    link = adapters.link()
    for asks_state in (True, False):
        broken = adapters.newest
        broken.told = broken.refusal = AttributeError("'NoneType' object has no attribute 'read'")
        broken.room = 0
        assert link.state is State.LOST if asks_state else link.send(frame(1)) == 0
        await_state(link, State.ACTIVE)
        assert adapters.newest is not broken
        assert broken.shutdowns == 1
    assert link.dropped == 2


def test_each_accepted_frame_is_echoed_and_wakes_the_reader(adapters: Adapters) -> None:
    link = adapters.link()
    assert not readable(link)
    sent = burst([0x181, 0x182, 0x183])
    sent["port"] = [1, 2, 3]
    sent["expires_ns"] = 1 << 62
    adapters.newest.room = 2
    before_ns = time.monotonic_ns()
    assert link.send(sent) == 2
    assert [each.arbitration_id for each in adapters.newest.sent] == [0x181, 0x182]
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


def test_an_echo_of_the_interface_is_used_where_it_is_proven_and_else_not(adapters: Adapters) -> None:
    for interface, is_proven in (("kvaser", True), ("gs_usb", False), ("pcan", False)):
        link = adapters.link(interface)
        assert link.proves_echo is is_proven
        assert bool(adapters.newest.options.get("receive_own_messages")) is is_proven
        link.send(frame(0x80))
        adapters.newest.arrived.put(message(0x80, is_rx=False))
        adapters.newest.arrived.put(message(0x181))
        arrived = collect(link, 2)
        assert arrived["can_id"].tolist() == [0x80, 0x181]
        assert arrived["flags"].tolist() == [ECHO, 0]
    assert adapters.link("kvaser", options={"single_handle": True}).proves_echo is False


def test_times_are_those_of_the_read_whatever_the_clock_of_the_adapter_says(adapters: Adapters) -> None:
    link = adapters.link()
    before_ns = time.monotonic_ns()
    adapters.newest.arrived.put(message(7, timestamp=time.time() + 100.0))
    assert before_ns <= collect(link, 1)["time_ns"][0] <= time.monotonic_ns()


def test_a_frame_that_is_late_is_not_sent_nor_any_behind_it(adapters: Adapters) -> None:
    link = adapters.link()
    sent = burst([0x181, 0x182, 0x183])
    sent["expires_ns"] = [0, 1, 0]
    assert link.send(sent) == 1
    assert [each.arbitration_id for each in adapters.newest.sent] == [0x181]


@pytest.mark.parametrize(
    "error",
    [
        *(can.CanOperationError("gone"), OSError("gone"), AttributeError("'NoneType' object has no attribute 'read'")),
        *(struct.error("unpack requires 8 bytes"), RuntimeError("closed"), AssertionError()),
    ],
)
def test_an_adapter_that_was_unplugged_is_opened_again(adapters: Adapters, error: Exception) -> None:
    link, first = adapters.link(), adapters.newest
    adapters.error = can.CanInitializationError("no adapter")
    first.arrived.put(error)
    await_state(link, State.LOST)
    assert link.send(frame(1)) == 0
    assert link.dropped == 1
    adapters.error = None
    await_state(link, State.ACTIVE)
    assert first.shutdowns == 1
    assert adapters.newest is not first
    adapters.newest.arrived.put(message(7))
    assert collect(link, 1)["can_id"].tolist() == [7]
    assert link.send(frame(1)) == 1


@pytest.mark.parametrize("trouble", ["bus-off", "full"])
def test_an_interface_that_is_bus_off_or_takes_nothing_is_opened_again(
    adapters: Adapters, monkeypatch: pytest.MonkeyPatch, trouble: str
) -> None:
    monkeypatch.setattr("bus.python_can.PATIENCE_S", 0.0)
    link, first = adapters.link(), adapters.newest
    if trouble == "full":
        first.room = 0
        assert link.send(frame(1)) == 0
    else:
        first.told = can.BusState.ERROR
    until_s = time.monotonic() + PATIENCE_S
    while adapters.newest is first:
        assert time.monotonic() < until_s
        assert link.state in {State.ACTIVE, State.BUS_OFF, State.LOST}
        select.select([link], [], [], 0.01)
    assert first.shutdowns == 1


def test_a_serial_line_gets_a_limit_and_others_refuse_at_once(adapters: Adapters) -> None:
    """With a limit kvaser and neovi would wait until the frame is on the bus."""
    for interface, limit_s in (("slcan", 0.05), ("robotell", 0.05), ("kvaser", None), ("neovi", None)):
        assert adapters.link(interface).send(frame(1)) == 1
        assert adapters.newest.timeout_s == limit_s
    link = adapters.link("slcan")
    adapters.newest.room = 0
    assert link.send(frame(1)) == 0
    assert link.dropped == 1


def test_what_is_no_frame_is_counted_and_harms_nothing(adapters: Adapters) -> None:
    link = adapters.link()
    for noise in (ValueError("invalid literal"), IndexError("string index")):
        adapters.newest.arrived.put(noise)
    adapters.newest.arrived.put(message(1 << 40))
    adapters.newest.arrived.put(message(7))
    assert collect(link, 1)["can_id"].tolist() == [7]
    assert (link.dropped, link.state) == (3, State.ACTIVE)


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


@pytest.mark.parametrize(
    ("interface", "what"),
    [
        ("no-such", "no-such"),
        ("pcan", "needs PEAK's PCAN-Basic"),
        ("kvaser", "needs Kvaser's linuxcan"),
        ("gs_usb", "needs pip install gs_usb"),
    ],
)
def test_what_python_can_says_becomes_one_line(interface: str, what: str) -> None:
    with pytest.raises(BusError, match=what) as caught:
        open_link(interface, "0" if interface == "kvaser" else "channel", 1_000_000)
    assert "\n" not in str(caught.value)


def test_an_slcan_adapter_on_a_terminal_is_unplugged_and_plugged_again(tmp_path: Path) -> None:
    adapter = SerialAdapter(tmp_path / "ttyACM0")
    link = open_link("slcan", str(adapter.path), 1_000_000, options={"sleep_after_open": 0.0})
    try:
        for number in (0x181, 0x281):
            assert link.send(frame(number, b"\x05")) == 1
            assert adapter.await_frames().tobytes() == frame(number, b"\x05").tobytes()
            adapter.send(frame(number + 1, b"\x06\x07"))
            arrived = collect(link, 2)
            assert arrived["flags"].tolist() == [ECHO, 0]
            assert bytes(arrived["data"][1, :2]) == b"\x06\x07"
            adapter.unplug()
            await_state(link, State.LOST)
            assert link.send(frame(number)) == 0
            adapter.plug()
            await_state(link, State.ACTIVE)
        assert link.dropped == 2
    finally:
        link.close()
        adapter.unplug()


def test_an_slcan_adapter_that_takes_nothing_is_lost_and_opened_when_it_does(tmp_path: Path) -> None:
    """A pseudo-terminal that nobody reads takes some thousand bytes; a part of a frame may be the last."""
    adapter = SerialAdapter(tmp_path / "ttyACM0")
    link, other = (
        open_link("slcan", str(adapter.path), 1_000_000, options={"sleep_after_open": 0.0}) for _ in range(2)
    )
    try:
        sent = burst([0x181] * 100)
        while link.send(sent) == len(sent):
            link.receive()
        assert link.state is State.LOST
        assert link.dropped == 1
        other.close()
        until_s = time.monotonic() + PATIENCE_S
        while link.state is State.LOST:
            assert time.monotonic() < until_s
            adapter.receive()
        adapter.receive()
        assert link.send(frame(0x281, b"\x05")) == 1
        while (arrived := adapter.await_frames())["can_id"][-1] != 0x281:
            pass
        assert arrived[-1:].tobytes() == frame(0x281, b"\x05").tobytes()
    finally:
        link.close()
        adapter.unplug()
