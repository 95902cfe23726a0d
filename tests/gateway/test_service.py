"""The gateway's turn of input and output, with a clock that stalls where a process may."""

import socket
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast
from unittest import mock

import numpy as np
import pytest

from bus.link import State
from canskin.messages import Fault, GatewayStatus, Measurement, NodeFault
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from gateway.calibration import GatewayCalibration
from gateway.collector import Collector
from gateway.duty import Duties
from gateway.frozen_boards import FROZEN
from gateway.service import GatewayService
from shell.service import StopSignal
from tests.messages import Published, bus_state, gateway_status


@pytest.fixture(autouse=True)
def _no_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no turn wait: the tests move the clock."""
    monkeypatch.setattr(GatewayService, "waits_ns", lambda _service: (0, 0))
    monkeypatch.setattr("gateway.service.time", SimpleNamespace(sleep=lambda _rest_s: None))


class Clock:
    """Goes on whenever somebody looks."""

    step_s = 1e-5

    def __init__(self) -> None:
        self.now_s = 50.0

    def __call__(self) -> float:
        self.now_s += self.step_s
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
        self.sent: list[tuple[int, bytes]] = []
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
        self.sent += [(int(each["can_id"]), each["data"][: each["length"]].tobytes()) for each in burst]
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


class Fabric(Published):
    """Publishing the status takes as long as the test wants."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock
        self.stall_s = 0.0

    def publish(self, topic: object, message: Any) -> None:
        super().publish(topic, message)
        if isinstance(message, GatewayStatus):
            self._clock.now_s += self.stall_s


class Served:
    """A service on such links, and its clock."""

    def __init__(
        self, contract: Contract, calibration: GatewayCalibration | None = None, duties: Duties | None = None
    ) -> None:
        self.clock = Clock()
        self.fabric = Fabric(self.clock)
        self.links = [Echoing(self.clock) for _ in contract.layout.bus]
        links = dict(enumerate(self.links))
        self.service = GatewayService(
            contract, links, self.fabric, calibration=calibration, duties=duties, clock=self.clock
        )
        self.loop = self.service.loop

    def turn(self, seconds: float) -> None:
        """Take a turn that lasts so long."""
        self.service.turn()
        self.clock.now_s += seconds

    def turn_until(self, end_s: float, seconds: float = 0.01) -> None:
        while self.clock.now_s < end_s:
            self.turn(seconds)

    @property
    def now_s(self) -> float:
        return self.clock.now_s

    @property
    def statuses(self) -> list[GatewayStatus]:
        return self.fabric.of(GatewayStatus)


@pytest.fixture
def served(small: Contract) -> Iterator[Served]:
    """Return a service that has sent its first SYNC."""
    built = Served(small)
    while not built.links[0].syncs_s:
        built.turn(0.02)
    yield built
    for link in built.links:
        link.close()


def test_each_measurement_names_who_publishes(small: Contract) -> None:
    duties = mock.Mock(words="reconstructor=b")
    served = Served(small, duties=duties)
    while not served.fabric.of(Measurement):
        served.turn(0.02)
    assert {each.duty for each in served.fabric.of(Measurement)} == {"reconstructor=b"}
    assert duties.turn.called
    assert duties.sent.called
    for link in served.links:
        link.close()


def test_syncs_do_not_bunch_after_a_stall(served: Served) -> None:
    """The loop is held up while it publishes, by more than two periods, when a SYNC is just about to be due."""
    period_s = served.loop.sync.period_s
    served.fabric.stall_s = 2.3 * period_s
    for _ in range(250):
        served.turn(0.002)
    gaps_s = np.diff(served.links[0].syncs_s)
    assert gaps_s.max() > 2 * period_s
    assert gaps_s.min() >= 0.5 * period_s
    assert served.loop.sync.skipped > 0
    assert served.statuses[-1].syncs_skipped > 0


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
    served: Served,
    capsys: pytest.CaptureFixture[str],
    state: State,
    takes: bool,
    why: str,
    link: str,
    trouble: str,
) -> None:
    """It comes and goes some times: that is one fault."""
    broken = served.links[1]
    for _ in range(3):
        broken.takes, broken.state, broken.why = takes, state, why
        served.turn_until(served.now_s + 0.3)
        buses = served.statuses[-1].buses
        assert [bus.link for bus in buses] == ["active", link]
        assert not buses[0].trouble
        assert buses[1].trouble.startswith(trouble)
        broken.takes, broken.state, broken.why = True, State.ACTIVE, ""
        served.turn_until(served.now_s + 0.6)
        stays = link if state > State.WARNING else "active"  # for as long as its trouble is told
        assert [bus.link for bus in served.statuses[-1].buses] == ["active", stays]
    served.turn_until(served.now_s + 1.5)
    assert not any(bus.trouble for bus in served.statuses[-1].buses)
    about = [line for line in capsys.readouterr().err.splitlines() if line.startswith("gateway: bus1 ")]
    assert len(about) == 2, about
    assert about[0].startswith(f"gateway: bus1 {trouble}")
    assert about[1].startswith("gateway: bus1 works again, after ")
    assert ("SYNCs were not sent" in about[1]) is not takes


def test_fault_shorter_than_a_look_is_told(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    before = len(served.statuses)
    while len(served.statuses) == before:
        served.turn(0.01)
    served.links[1].state = State.BUS_OFF
    served.service.turn()
    served.links[1].state = State.ACTIVE
    served.turn_until(60)
    assert "bus_off" in {status.buses[1].link for status in served.statuses}
    assert capsys.readouterr().err.count("gateway: bus1 dead: the gateway's controller is bus-off") == 1


def test_it_serves_until_the_signal_finishes_open_cycles_and_stops_the_nodes(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Collector, "is_settled", lambda _self, _counter: False)  # as if nodes were late
    served = Served(small)
    monkeypatch.setattr(Clock, "step_s", 1e-3)
    served.service.run(SimpleNamespace(is_set=lambda: True))  # type: ignore[arg-type]
    assert not served.links[0].syncs_s
    assert len(served.statuses) == 1
    stops = [(0, bytes((0x80, node.node_id))) for node in small.nodes]
    assert [each for link in served.links for each in link.sent] == stops
    loop = served.loop
    served.service.run(SimpleNamespace(is_set=lambda: loop.sync.sent > 3 and loop.in_flight > 0))  # type: ignore[arg-type]
    assert loop.in_flight == 0
    assert len(served.fabric.of(Measurement)) == loop.sync.sent > 3
    assert served.statuses[-1].cycles == len(served.fabric.of(Measurement))
    assert [each for link in served.links for each in link.sent[-2:]] == stops
    for link in served.links:
        link.close()


def test_status_is_published_five_times_a_second(served: Served) -> None:
    first = len(served.statuses)
    served.turn_until(served.now_s + 2.0, 0.002)
    assert len(served.statuses) - first in {9, 10}


def test_the_calibration_works_when_nothing_is_due_for_four_milliseconds(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    calibration, spares_s = GatewayCalibration(small), list[float]()
    served = Served(small, calibration)
    monkeypatch.setattr(calibration, "work", lambda: spares_s.append(served.loop.due_s - served.now_s))
    while served.loop.sync.sent < 20:
        served.turn(0.001)
    assert len(spares_s) > 200
    assert min(spares_s) > 0.0039
    for link in served.links:
        link.close()


def test_a_gateway_gives_signs_of_life_before_sync_and_then_for_cycles_alone(
    small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.service.request_real_time", lambda *_: "")
    served, made, hung_turns = Served(small), list[int](), iter(range(100))
    for name in ("send_sync", "measurements"):
        closes = getattr(served.loop, name)
        monkeypatch.setattr(served.loop, name, lambda *now, closes=closes: [] if hangs() else closes(*now))

    def hangs() -> bool:
        """Let no cycle close from the fifth on, until the service ends."""
        return served.loop.gathering.published == 5 and not stop.is_set()

    def is_set() -> bool:
        served.clock.now_s += 0.01
        if served.loop.gathering.published == 5 and next(hung_turns, None) is None:
            stop.set()
        return stop.is_set()

    stop = StopSignal()
    served.service.run(cast("StopSignal", SimpleNamespace(is_set=is_set)), made.append)
    first = made.index(1)
    assert made[:first] == [0] * first
    assert first > 10
    assert made[first:] == [1, 2, 3, 4, 5]
    for link in served.links:
        link.close()


def test_the_status_names_frozen_boards_unless_there_is_worse(small: Contract, monkeypatch: pytest.MonkeyPatch) -> None:
    calibration, silent = GatewayCalibration(small), NodeFault(Fault.SILENT)
    served = Served(small, calibration)
    monkeypatch.setattr(calibration, "frozen_on", lambda bus: {1: FROZEN, 2: FROZEN} if bus else {})
    buses = [bus_state("bus0"), bus_state("bus1", faults={1: silent})]
    monkeypatch.setattr(served.loop, "status", lambda *_: gateway_status(buses=buses))
    served.service.publish_status()
    assert [bus.faults for bus in served.statuses[-1].buses] == [{}, {1: silent, 2: FROZEN}]
    for link in served.links:
        link.close()
