"""One turn of the gateway's process: how long it waits, what it hands on, and when the calibration works."""

from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from bus.link import Link, State
from canskin.calibration_messages import CalibrationState, CalibrationStatus
from canskin.messages import GATEWAY, MEASUREMENT, GatewayStatus, Measurement, Topic
from canskin.state_messages import ImagesReply, ImagesRequest
from dbc.contract import Contract
from dbc.frame import Frames, frames
from gateway.calibration import GatewayCalibration
from gateway.loop import GatewayLoop
from gateway.service import GatewayService
from tests import messages as make
from tests.bus.harness import frame

NOW_S = 50.0
NEVER_S = float("inf")
WALL_OFFSET_NS = 77


class Quiet:
    """A link with nothing to read, or with what the test says."""

    def __init__(self, number: int) -> None:
        self.state, self.dropped, self.stamp_error_ns = State.PASSIVE, 10 + number, 20 + number
        self.arrived = frames(0)
        self.reads = 0

    def receive(self) -> Frames:
        self.reads += 1
        return self.arrived

    def send(self, burst: Frames) -> int:
        return len(burst)


class Loop:
    """A loop that keeps what it is told, and returns what the test says."""

    def __init__(self) -> None:
        self.may_sleep_until_s, self.due_s = -NEVER_S, NEVER_S
        self.told: list[tuple[Any, ...]] = []
        self.masters = {0: "master"}
        self.states: Any = None
        self.made: dict[str, list[Measurement]] = {"sync": [], "due": []}

    def take(self, number: int, arrived: Frames, now_s: float, **about: object) -> None:
        self.told.append(("take", number, len(arrived), now_s, about))

    def tick(self, now_s: float) -> None:
        self.told.append(("tick", now_s))

    def send_sync(self, now_s: float, wall_offset_ns: int) -> list[Measurement]:
        self.told.append(("sync", now_s, wall_offset_ns))
        return self.made["sync"]

    def measurements(self, now_s: float, wall_offset_ns: int) -> list[Measurement]:
        self.told.append(("due", now_s, wall_offset_ns))
        return self.made["due"]

    def explain_refused_syncs(self, states: dict[int, State]) -> None:
        self.told.append(("explain", states))

    def status(self, links: dict[int, tuple[State, int]], now_s: float) -> GatewayStatus:
        self.told.append(("status", links, now_s))
        return make.gateway_status(4, cycles_complete=3, sync_rate_hz=0.0)


class Calibration:
    """A calibration that keeps when it worked."""

    def __init__(self) -> None:
        self.told: list[tuple[Any, ...]] = []
        self.wants_images = False

    def tick(self, masters: dict[int, str], now_s: float) -> None:
        self.told.append(("tick", masters, now_s))

    def needs_images(self, now_s: float) -> bool:
        self.told.append(("needs", now_s))
        return self.wants_images

    def work(self) -> None:
        self.told.append(("work",))

    def apply(self, measurement: Measurement) -> Measurement:
        return msgspec.structs.replace(measurement, offsets=b"\1\0\0\0")

    def take(self, measurement: Measurement) -> None:
        self.told.append(("take", measurement))

    def status(self) -> CalibrationStatus:
        return CalibrationStatus(state=CalibrationState.FOLLOWING, revision=6)


class Turns:
    """A service whose clock stands, with what it waited for and published."""

    def __init__(self, contract: Contract, calibration: Calibration | None = None) -> None:
        self.now_s = NOW_S
        self.slept_s: list[float] = []
        self.timeouts_s: list[float] = []
        self.ready: list[Quiet] = []
        self.published: list[tuple[Topic, Any]] = []
        self.links = [Quiet(0), Quiet(1)]
        self.calibration = calibration
        fabric = SimpleNamespace(publish=lambda topic, message: self.published.append((topic, message)))
        self.service = GatewayService(
            contract,
            cast("dict[int, Link]", dict(enumerate(self.links))),
            fabric,
            calibration=cast("GatewayCalibration | None", calibration),
            clock=lambda: self.now_s,
        )
        self.loop = Loop()
        self.service.loop = cast("GatewayLoop", self.loop)

    def select(self, links: list[Quiet], _write: object, _errors: object, timeout_s: float) -> tuple[list[Quiet], ...]:
        assert links == self.links
        self.timeouts_s.append(timeout_s)
        return self.ready, [], []

    def waits(self, *, may_sleep_until_s: float, due_s: float) -> tuple[list[float], list[float]]:
        """Return for how long a turn sleeps, and for how long it waits for frames."""
        self.loop.may_sleep_until_s, self.loop.due_s = may_sleep_until_s, due_s
        self.slept_s.clear()
        self.timeouts_s.clear()
        self.service.turn()
        return self.slept_s, self.timeouts_s

    def statuses(self) -> list[GatewayStatus]:
        return [message for topic, message in self.published if topic is GATEWAY]


@pytest.fixture
def turns(small: Contract, monkeypatch: pytest.MonkeyPatch) -> Turns:
    return _patched(Turns(small), monkeypatch)


@pytest.fixture
def calibrated(small: Contract, monkeypatch: pytest.MonkeyPatch) -> Turns:
    return _patched(Turns(small, Calibration()), monkeypatch)


def _patched(built: Turns, monkeypatch: pytest.MonkeyPatch) -> Turns:
    monkeypatch.setattr("gateway.service.select", built)
    monkeypatch.setattr("gateway.service.time", SimpleNamespace(sleep=built.slept_s.append))
    monkeypatch.setattr("gateway.service.wall_offset", lambda: SimpleNamespace(ns=WALL_OFFSET_NS))
    return built


@pytest.mark.parametrize(
    ("due_s", "timeout_s"), [(-1.0, 0.0), (0.0, 0.0), (0.00390625, 0.00390625), (0.0625, 0.01), (NEVER_S, 0.01)]
)
def test_frames_are_waited_for_until_something_is_due_and_ten_milliseconds_at_most(
    turns: Turns, due_s: float, timeout_s: float
) -> None:
    assert turns.waits(may_sleep_until_s=-NEVER_S, due_s=NOW_S + due_s) == ([], [timeout_s])


@pytest.mark.parametrize(
    ("rests_s", "slept_s"), [(-NEVER_S, []), (0.0, []), (0.00390625, [0.00390625]), (0.0625, [0.01])]
)
def test_frames_rest_as_long_as_they_may(turns: Turns, rests_s: float, slept_s: list[float]) -> None:
    assert turns.waits(may_sleep_until_s=NOW_S + rests_s, due_s=0.0) == (slept_s, [0.0])


def test_a_turn_reads_what_is_ready_looks_at_every_link_and_then_does_what_is_due(turns: Turns) -> None:
    turns.links[1].arrived = np.concatenate([frame(0x181)] * 3)
    turns.ready = [turns.links[1]]
    turns.loop.made = {"sync": [make.measurement(8)], "due": [make.measurement(9)]}
    turns.service.turn()
    assert [link.reads for link in turns.links] == [0, 1]
    assert turns.loop.told[:5] == [
        ("take", 0, 0, NOW_S, {"state": State.PASSIVE, "dropped": 10, "stamp_error_ns": 20}),
        ("take", 1, 3, NOW_S, {"state": State.PASSIVE, "dropped": 11, "stamp_error_ns": 21}),
        ("tick", NOW_S),
        ("sync", NOW_S, WALL_OFFSET_NS),
        ("due", NOW_S, WALL_OFFSET_NS),
    ]
    assert turns.published[:2] == [(MEASUREMENT, make.measurement(8)), (MEASUREMENT, make.measurement(9))]


def test_status_goes_out_with_the_first_turn_and_every_fifth_of_a_second(turns: Turns) -> None:
    for now_s in (50.0, 50.1, 50.19, 50.21, 50.4, 50.42):
        turns.now_s = now_s
        turns.service.turn()
    told = [each[-1] for each in turns.loop.told if each[0] == "status"]
    assert told == [50.0, 50.21, 50.42]
    assert len(turns.statuses()) == 3
    assert turns.statuses()[0].calibration is None
    links = {0: (State.PASSIVE, 10), 1: (State.PASSIVE, 11)}
    assert [each for each in turns.loop.told if each[0] in {"explain", "status"}][:2] == [
        ("explain", {0: State.PASSIVE, 1: State.PASSIVE}),
        ("status", links, 50.0),
    ]


# With a calibration


@pytest.mark.parametrize(("spare_s", "works"), [(0.0, False), (0.0039, False), (0.00401, True), (NEVER_S, True)])
def test_the_calibration_works_when_nothing_is_due_for_four_milliseconds(
    calibrated: Turns, spare_s: float, *, works: bool
) -> None:
    assert calibrated.calibration is not None
    calibrated.waits(may_sleep_until_s=-NEVER_S, due_s=NOW_S + spare_s)
    told = [("tick", {0: "master"}, NOW_S), *([("work",)] if works else [])]
    assert calibrated.calibration.told == told
    (status,) = calibrated.statuses()
    assert status.calibration is not None
    assert (status.calibration.revision, status.cycles, status.cycles_complete) == (6, 4, 3)


def test_images_are_asked_for_as_long_as_the_zero_needs_them(calibrated: Turns) -> None:
    asked: list[tuple[float, bool]] = []
    calibrated.loop.states = SimpleNamespace(
        ask_images=lambda hold_s, *, is_counted: asked.append((hold_s, is_counted))
    )
    assert calibrated.calibration is not None
    calibrated.service.turn()
    assert asked == []
    calibrated.calibration.wants_images = True
    calibrated.service.turn()
    assert asked == [(0.1, False)]
    assert ("needs", NOW_S) in calibrated.calibration.told


def test_measurements_have_their_offsets_and_teach_the_calibration(calibrated: Turns) -> None:
    assert calibrated.calibration is not None
    calibrated.service.publish([make.measurement(1), make.measurement(2)])
    offsets = [(topic is MEASUREMENT, message.cycle, message.offsets) for topic, message in calibrated.published]
    assert offsets == [(True, 1, b"\1\0\0\0"), (True, 2, b"\1\0\0\0")]
    assert calibrated.calibration.told == [("take", make.measurement(1)), ("take", make.measurement(2))]


# Requests for images


def answer(turns: Turns, hold_s: float) -> tuple[bool, str]:
    replies: list[ImagesReply] = []
    turns.service.ask_images(ImagesRequest(hold_s=hold_s), replies.append)  # type: ignore[arg-type]
    (reply,) = replies
    return reply.is_done, reply.text


def test_a_skin_of_one_state_sends_images_all_the_time(turns: Turns) -> None:
    assert answer(turns, 1.0) == (True, "images come all the time")


def test_a_request_is_for_more_than_nothing_and_an_hour_at_most(turns: Turns) -> None:
    held_s: list[float] = []
    turns.loop.states = SimpleNamespace(ask_images=held_s.append)
    limit = "expected images for more than 0 and up to 3600 s, got "
    assert [answer(turns, hold_s) for hold_s in (0.0, -1.0, 3600.5, float("nan"))] == [
        (False, f"{limit}{got} s") for got in ("0", "-1", "3600.5", "nan")
    ]
    assert [answer(turns, hold_s) for hold_s in (0.001, 3600.0)] == [(True, "")] * 2
    assert held_s == [0.001, 3600.0]
