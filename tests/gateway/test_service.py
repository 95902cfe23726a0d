"""The gateway's turn of input and output, with a clock that stalls where a process may."""

import select
import socket
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.link import State
from canskin.messages import GATEWAY, GatewayStatus, Measurement, Topic
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from gateway.calibration import GatewayCalibration
from gateway.collector import Collector
from gateway.service import GatewayService


@pytest.fixture(autouse=True)
def _no_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no turn wait: the tests move the clock."""
    polls = SimpleNamespace(select=lambda *links_and_timeout: select.select(*links_and_timeout[:3], 0))
    monkeypatch.setattr("gateway.service.select", polls)
    monkeypatch.setattr("gateway.service.time", SimpleNamespace(sleep=lambda _rest_s: None))


class Clock:
    def __init__(self) -> None:
        self.now_s = 50.0

    def __call__(self) -> float:
        self.now_s += 1e-5
        return self.now_s


class Echoing:
    """A link on which nobody else speaks; what is sent comes back."""

    dropped = stamp_error_ns = 0
    proves_echo = True
    state = State.ACTIVE

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._near, self._far = socket.socketpair()
        self._waiting: list[Frames] = []
        self.syncs_s: list[float] = []
        self.takes = True
        self.why = ""

    def explain(self) -> str:
        return self.why

    def fileno(self) -> int:
        return self._near.fileno()

    def send(self, burst: Frames) -> int:
        if not self.takes:
            return 0
        echo = burst.copy()
        echo["flags"] |= ECHO
        self._waiting.append(echo)
        self._far.send(b"!")
        if burst["can_id"][0] == SYNC_COB_ID:
            self.syncs_s.append(self._clock.now_s)
        return len(burst)

    def receive(self) -> Frames:
        self._near.recv(4096)
        arrived, self._waiting = [*self._waiting, frames(0)], []
        return np.concatenate(arrived)

    def close(self) -> None:
        self._near.close()
        self._far.close()


class Fabric:
    """Takes messages; publishing the status takes as long as the test wants."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.stall_s = 0.0
        self.statuses: list[GatewayStatus] = []

    def tell_scheduling(self, _: str) -> None:
        """Nobody listens."""

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        if topic is GATEWAY:
            assert isinstance(message, GatewayStatus)
            self.statuses.append(message)
            self._clock.now_s += self.stall_s


def running(small: Contract) -> tuple[GatewayService, Clock, Fabric, list[Echoing]]:
    clock = Clock()
    fabric = Fabric(clock)
    links = [Echoing(clock) for _ in small.layout.bus]
    service = GatewayService(small, dict(enumerate(links)), fabric, clock=clock)
    while not links[0].syncs_s:
        service.turn()
        clock.now_s += 0.02
    return service, clock, fabric, links


def test_syncs_do_not_bunch_after_a_stall(small: Contract) -> None:
    """The loop is held up while it publishes, by more than two periods, when a SYNC is just about to be due."""
    service, clock, fabric, links = running(small)
    period_s = small.layout.sync.period_s
    fabric.stall_s = 2.3 * period_s
    for _ in range(250):
        service.turn()
        clock.now_s += 0.002
    gaps_s = np.diff(links[0].syncs_s)
    assert gaps_s.max() > 2 * period_s
    assert gaps_s.min() >= 0.5 * period_s
    assert service.loop.sync.skipped > 0
    assert fabric.statuses[-1].syncs_skipped > 0
    for link in links:
        link.close()


@pytest.mark.parametrize(
    ("state", "takes", "why", "link", "trouble"),
    [
        (State.LOST, False, "cannot open can1", "lost", "dead: the gateway has lost its interface: cannot open can1"),
        (State.BUS_OFF, True, "", "bus_off", "dead: the gateway's controller is bus-off: wiring, termination or"),
        (State.PASSIVE, False, "", "passive", "troubled: the gateway's controller is error passive: are nodes powered"),
        (State.WARNING, False, "its queue is full", "warning", "without SYNC: its queue is full"),
        (State.ACTIVE, False, "", "active", "without SYNC: the gateway comes too late for it"),
    ],
)
def test_fault_of_a_link_is_told_once_in_log_and_status_and_so_is_its_end(
    small: Contract,
    capsys: pytest.CaptureFixture[str],
    state: State,
    takes: bool,
    why: str,
    link: str,
    trouble: str,
) -> None:
    """It comes and goes some times: that is one fault."""
    service, clock, fabric, links = running(small)

    def turn_until(end_s: float) -> None:
        while clock.now_s < end_s:
            service.turn()
            clock.now_s += 0.01

    for _ in range(3):
        links[1].takes, links[1].state, links[1].why = takes, state, why
        turn_until(clock.now_s + 0.3)
        buses = fabric.statuses[-1].buses
        assert [bus.link for bus in buses] == ["active", link]
        assert not buses[0].trouble
        assert buses[1].trouble.startswith(trouble)
        links[1].takes, links[1].state, links[1].why = True, State.ACTIVE, ""
        turn_until(clock.now_s + 0.6)
        assert [bus.link for bus in fabric.statuses[-1].buses] == ["active", "active"]
    turn_until(clock.now_s + 1.5)
    assert not any(bus.trouble for bus in fabric.statuses[-1].buses)
    about = [line for line in capsys.readouterr().err.splitlines() if line.startswith("gateway: bus1 ")]
    assert len(about) == 2, about
    assert about[0].startswith(f"gateway: bus1 {trouble}")
    assert about[1].startswith("gateway: bus1 works again, after ")
    assert ("SYNCs were not sent" in about[1]) is not takes
    for each in links:
        each.close()


def test_fault_shorter_than_a_look_is_told(small: Contract, capsys: pytest.CaptureFixture[str]) -> None:
    service, clock, fabric, links = running(small)
    before = len(fabric.statuses)
    while len(fabric.statuses) == before:
        service.turn()
        clock.now_s += 0.01
    links[1].state = State.BUS_OFF
    service.turn()
    links[1].state = State.ACTIVE
    while clock.now_s < 60:
        service.turn()
        clock.now_s += 0.01
    assert "bus_off" in {status.buses[1].link for status in fabric.statuses}
    assert capsys.readouterr().err.count("gateway: bus1 dead: the gateway's controller is bus-off") == 1
    for each in links:
        each.close()


class StopAfter:
    """A signal that comes after so many turns."""

    def __init__(self, turns: int) -> None:
        self._left = turns

    def is_set(self) -> bool:
        self._left -= 1
        return self._left < 0


class Keeping(Fabric):
    """A fabric that keeps measurements, too."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self.measurements: list[Measurement] = []

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        super().publish(topic, message)
        if isinstance(message, Measurement):
            self.measurements.append(message)


class Quick(Clock):
    """A clock that goes on by a millisecond whenever somebody looks."""

    def __call__(self) -> float:
        self.now_s += 1e-3
        return self.now_s


def test_it_serves_until_the_signal_finishes_open_cycles_and_stops_the_nodes(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Collector, "is_settled", lambda _self, _counter: False)  # as if nodes were late
    clock = Quick()
    fabric, links = Keeping(clock), [Echoing(clock) for _ in small.layout.bus]
    sent: list[tuple[int, bytes]] = []

    def noting(link: Echoing) -> Callable[[Frames], int]:
        def send(burst: Frames) -> int:
            sent.extend((int(each["can_id"]), each["data"][: each["length"]].tobytes()) for each in burst)
            return Echoing.send(link, burst)

        return send

    for link in links:
        link.send = noting(link)  # type: ignore[method-assign]
    service = GatewayService(small, dict(enumerate(links)), fabric, clock=clock)
    taken, take = [], service.loop.take

    def counted(number: int, arrived: Frames, now_s: float, **options: Any) -> None:
        taken.append(len(arrived))
        take(number, arrived, now_s, **options)

    monkeypatch.setattr(service.loop, "take", counted)
    service.run(StopAfter(0))  # type: ignore[arg-type]
    assert not links[0].syncs_s
    assert len(fabric.statuses) == 1
    stops = [(0, bytes((0x80, node.node_id))) for node in small.nodes]
    assert sent == stops
    stop = SimpleNamespace(is_set=lambda: service.loop.sync.sent > 3 and service.loop.in_flight > 0)
    service.run(stop)  # type: ignore[arg-type]
    assert service.loop.in_flight == 0
    assert len(fabric.measurements) == service.loop.sync.sent > 3
    assert fabric.statuses[-1].cycles == len(fabric.measurements)
    assert sent[-len(stops) :] == stops
    assert 0 < sum(taken) <= len(sent)  # echoes alone
    for link in links:
        link.close()


def test_status_is_published_five_times_a_second(small: Contract) -> None:
    service, clock, fabric, links = running(small)
    first, began_s = len(fabric.statuses), clock.now_s
    while clock.now_s < began_s + 2.0:
        service.turn()
        clock.now_s += 0.002
    assert len(fabric.statuses) - first in {9, 10}
    for link in links:
        link.close()


def test_the_calibration_works_when_nothing_is_due_for_four_milliseconds(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, spares_s = Clock(), list[float]()
    links = [Echoing(clock) for _ in small.layout.bus]
    calibration = GatewayCalibration(small)
    service = GatewayService(small, dict(enumerate(links)), Fabric(clock), calibration=calibration, clock=clock)
    monkeypatch.setattr(calibration, "work", lambda: spares_s.append(service.loop.due_s - clock.now_s))
    while service.loop.sync.sent < 20:
        service.turn()
        clock.now_s += 0.001
    assert len(spares_s) > 200
    assert min(spares_s) > 0.0039
    for link in links:
        link.close()
