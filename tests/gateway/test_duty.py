"""Who is named to publish: events of tokens, results and statuses in; a name out."""

from collections.abc import Callable
from typing import Any

import pytest

from canskin.messages import Topic
from canskin.peers import Peer
from gateway.duty import BETTER_TIMES, FIT_S, LATE_S, SILENCE_S, Duties, Duty
from tests.messages import measurement, service_status


class Desk:
    """A duty, two or more who can be named, and a clock."""

    def __init__(self, *instances: str) -> None:
        self.said: list[str] = []
        self.now_s, self.duty = 100.0, Duty("reconstructor", self.said.append)
        self.made = dict.fromkeys(instances, 0)
        self.load = dict.fromkeys(instances, 0.1)
        for each in instances:
            self.note(each, is_there=True)

    def note(self, instance: str, *, is_there: bool, scheduling: str = "") -> None:
        peer = Peer("palm", "reconstructor", instance, "1", "Φ", scheduling)
        self.duty.note(peer, is_there, self.now_s)

    def run(self, seconds: float, *alive: str, answers: bool = True) -> list[str]:
        """Send 100 measurements in a second, which those that are `alive` answer; return who was named."""
        named = []
        for cycle in range(round(100 * seconds)):
            self.now_s += 0.01
            self.duty.look(self.now_s)
            self.duty.sent(self.now_s)
            named.append(self.duty.named)
            for each in alive:
                self.made[each] += answers
                if cycle % 100 == 50:
                    made, ratio = self.made[each], self.load[each]
                    status = service_status(1, instance=each, made=made, load_ratio=ratio)
                    self.duty.told(status, self.now_s)
            if answers and self.duty.named in alive:
                self.duty.came(self.duty.named)
        return named


def test_the_first_is_named_until_its_last_token_goes() -> None:
    desk = Desk("b", "c")
    assert desk.run(1.0, "b", "c") == 100 * ["b"]
    desk.note("b", is_there=True, scheduling="realtime")
    desk.note("b", is_there=False)
    assert desk.duty.named == "b"
    desk.note("b", is_there=False, scheduling="realtime")
    assert desk.duty.named == "c"
    desk.note("c", is_there=False)
    assert not desk.duty.named
    assert desk.said == ["reconstructor c publishes: b has left"]


def test_who_is_silent_is_replaced_and_named_again_only_when_it_works() -> None:
    desk = Desk("b", "c")
    desk.run(3.0, "b", "c")
    named = desk.run(1.0, "c")
    assert 0 <= named.index("c") * 0.01 - SILENCE_S < 0.03
    assert named[-1] == "c"
    assert len(desk.said) == 1
    # Nobody is left that works: both are tried.
    assert set(desk.run(3.0)) == {"b", "c"}
    desk.run(2.0, "b", "c")
    assert desk.run(1.0, "b")[-1] == "b"


def test_who_works_is_named_before_who_tells_nothing() -> None:
    desk = Desk("b", "c", "d")
    desk.run(FIT_S + 1, "b", "d")
    named = desk.run(0.3, "d")
    assert (named[0], named[-1], "c" in named) == ("b", "d", False)


def test_slow_results_are_waited_for() -> None:
    desk = Desk("b", "c")
    desk.load = {"b": 1.0, "c": 1.0}
    for _ in range(4):  # each result takes a second of processor
        desk.made = {each: made + 1 for each, made in desk.made.items()}
        desk.run(0.9, answers=False)
        desk.duty.came("b")
        desk.run(0.1)
        for each, made in desk.made.items():
            desk.duty.told(service_status(1, instance=each, made=made, load_ratio=1.0), desk.now_s)
        desk.duty.named = "b"
    assert set(desk.run(1.0)) == {"b"}


@pytest.mark.parametrize(
    ("load_of_b", "load_of_c", "moves"), [(0.9, 0.1, True), (0.3, 0.2, False), (0.1, 0.9, False), (0.5, 0.5, False)]
)
def test_the_lighter_takes_over_after_some_seconds_and_keeps_the_duty(
    load_of_b: float, load_of_c: float, moves: bool
) -> None:
    desk = Desk("b", "c")
    desk.load = {"b": load_of_b, "c": load_of_c}
    assert set(desk.run(BETTER_TIMES - 1, "b", "c")) == {"b"}
    desk.run(2.0, "b", "c")
    assert set(desk.run(60.0, "b", "c")) == {"c" if moves else "b"}


def test_of_equal_loads_the_lower_instance_takes_over_once() -> None:
    desk = Desk("c", "b")
    desk.run(BETTER_TIMES + 1, "b", "c")
    assert set(desk.run(60.0, "b", "c")) == {"b"}


class Fabric:
    """Keeps who is subscribed."""

    def __init__(self) -> None:
        self.readers: dict[str, object] = {}
        self.note: Any = None

    def watch_peers(self, note: object) -> None:
        self.note = note

    def subscribe_bytes(self, topic: Topic, handler: object) -> Callable[[], object]:
        self.readers[topic.name] = handler
        return lambda: self.readers.pop(topic.name)

    subscribe = subscribe_bytes


def test_results_are_received_only_while_two_are_there_and_no_time_counts_in_which_the_gateway_was_late() -> None:
    fabric = Fabric()
    duties = Duties(fabric, "palm", "Φ", lambda _: None)  # type: ignore[arg-type]
    assert not measurement(duty=duties.words).names("reconstructor", "b")
    first, second = (Peer("palm", "reconstructor", each, "1", "Φ") for each in "bc")
    others = Peer("hand", "reconstructor", "d", "1", "Φ"), Peer("palm", "reconstructor", "d", "1", "Ψ")
    for each in (*others, first):
        fabric.note(each, True)
    now_s = 0.0
    duties.turn(now_s)
    told = measurement(duty=duties.words)
    assert [told.names("reconstructor", each) for each in "bcd"] == [True, False, False]
    assert not told.names("classifier", "b")
    assert measurement().names("reconstructor", "c")
    assert not fabric.readers
    fabric.note(second, True)
    for _ in range(100):
        now_s += LATE_S + 0.01
        duties.turn(now_s)
        duties.sent(now_s)
    assert set(fabric.readers) == {"contacts", "services"}
    assert measurement(duty=duties.words).names("reconstructor", "b")
    for _ in range(100):
        now_s += 0.01
        duties.turn(now_s)
        duties.sent(now_s)
    assert measurement(duty=duties.words).names("reconstructor", "c")
    fabric.note(first, False)
    duties.turn(now_s)
    assert not fabric.readers
