"""When the RPDO goes out that switches all nodes, when the gateway's own state follows, and what is told of it."""

from dataclasses import dataclass, field

import pytest

from bus.link import Send
from canskin.messages import Measurement
from dbc.dictionary import SkinState
from dbc.frame import ECHO, ERROR, Frames
from gateway.state_switch import StateSwitch
from tests import messages as make
from tests.bus.harness import frame
from tests.gateway.helpers import two_states

CONTRACT = two_states()

#: Far from the next SYNC.
FAR_S = 1e9
RECOGNITION, IMAGES = 0, 1


@dataclass
class Skin:
    """The switch, and the RPDOs that it has sent since they were last taken: bus and state."""

    sent: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.switch = StateSwitch(CONTRACT, {0: self._sender(0), 1: self._sender(1)})

    def _sender(self, bus: int) -> Send:
        def send(burst: Frames) -> int:
            assert (int(burst["can_id"][0]), int(burst["length"][0])) == (0xFF, 1)
            self.sent.append((bus, int(burst["data"][0, 0])))
            return 1

        return send

    def tick(self, now_s: float, sync_due_s: float = FAR_S) -> list[tuple[int, int]]:
        self.switch.tick(now_s, sync_due_s)
        sent, self.sent = self.sent, []
        return sent

    def echo(self, bus: int, state: int, *, flags: int = ECHO, can_id: int = 0xFF) -> None:
        self.switch.take(bus, frame(can_id, bytes((state,)), flags))

    def sync(self, now_s: float) -> SkinState:
        self.switch.take_sync(now_s)
        return self.switch.state

    def to_images(self, now_s: float, hold_s: float = 10.0) -> None:
        """Ask for images, let every bus carry the RPDO, and send a SYNC."""
        self.switch.ask_images(hold_s)
        assert self.tick(now_s) == on_both(IMAGES)
        self.echo(0, IMAGES)
        self.echo(1, IMAGES)
        assert self.sync(now_s) == SkinState.IMAGES


def on_both(state: int) -> list[tuple[int, int]]:
    return [(0, state), (1, state)]


@pytest.fixture
def skin() -> Skin:
    """Return a switch that has told the nodes to recognise, at 1.0 s."""
    built = Skin()
    assert built.tick(1.0) == on_both(RECOGNITION)
    return built


def test_the_state_is_told_from_the_start_on_every_quarter_of_a_second(skin: Skin) -> None:
    assert skin.tick(1.249) == []
    assert skin.tick(1.25) == on_both(RECOGNITION)
    assert skin.tick(1.499) == []
    assert skin.tick(1.5) == on_both(RECOGNITION)
    assert skin.switch.state == SkinState.RECOGNITION


def test_a_switch_is_told_at_once_and_again_at_three_syncs(skin: Skin) -> None:
    skin.switch.ask_images(10.0)
    assert skin.tick(1.1) == on_both(IMAGES)
    assert skin.tick(1.101) == []
    for sync in range(3):
        skin.sync(1.11 + sync / 100)
        assert skin.tick(1.11 + sync / 100) == on_both(IMAGES)
        assert skin.tick(1.115 + sync / 100) == []
    skin.sync(1.14)
    assert skin.tick(1.14) == []
    assert skin.tick(1.379) == []
    assert skin.tick(1.3801) == on_both(IMAGES)


def test_the_state_follows_with_the_first_sync_after_every_bus_has_had_the_rpdo(skin: Skin) -> None:
    skin.switch.ask_images(10.0)
    skin.tick(1.1)
    assert skin.switch.next_period_s == 0.01
    skin.echo(1, IMAGES)
    assert skin.switch.next_period_s == 0.01
    assert skin.sync(1.11) == SkinState.RECOGNITION
    skin.echo(0, IMAGES)
    assert skin.switch.next_period_s == 0.05
    assert skin.switch.state == SkinState.RECOGNITION
    assert skin.switch.status()["state"] == "recognition"
    assert skin.sync(1.12) == SkinState.IMAGES
    assert skin.switch.status()["state"] == "images"
    assert skin.switch.next_period_s == 0.05


def test_a_bus_that_shows_no_rpdo_is_waited_for_at_three_syncs(skin: Skin) -> None:
    skin.switch.ask_images(10.0)
    skin.tick(1.1)
    skin.echo(0, IMAGES)
    assert [skin.sync(1.11 + sync / 100) for sync in range(4)] == [*[SkinState.RECOGNITION] * 3, SkinState.IMAGES]


def test_buses_have_to_show_the_rpdo_of_each_switch_anew(skin: Skin) -> None:
    skin.to_images(1.1, hold_s=0.5)
    assert skin.tick(1.6) == on_both(RECOGNITION)
    assert [skin.sync(1.65 + sync / 20) for sync in range(4)] == [*[SkinState.IMAGES] * 3, SkinState.RECOGNITION]
    skin.to_images(2.0)


@pytest.mark.parametrize(
    ("state", "flags", "can_id"),
    [(IMAGES, 0, 0xFF), (IMAGES, ECHO | ERROR, 0xFF), (IMAGES, ECHO, 0xFE), (RECOGNITION, ECHO, 0xFF)],
)
def test_only_the_gateways_own_rpdo_of_the_new_state_counts(skin: Skin, state: int, flags: int, can_id: int) -> None:
    skin.switch.ask_images(10.0)
    skin.tick(1.1)
    skin.echo(0, IMAGES)
    skin.echo(1, state, flags=flags, can_id=can_id)
    assert skin.sync(1.11) == SkinState.RECOGNITION


def test_no_switch_begins_within_a_quarter_of_a_period_of_recognition_before_sync(skin: Skin) -> None:
    skin.switch.ask_images(10.0)
    assert skin.tick(1.1, 1.1024) == []
    assert skin.sync(1.1024) == SkinState.RECOGNITION
    assert skin.tick(1.1, 1.1026) == on_both(IMAGES)


def test_images_end_when_the_longest_request_has_ended(skin: Skin) -> None:
    skin.to_images(1.25, hold_s=0.5)
    skin.switch.ask_images(0.25)
    assert skin.tick(1.4) == on_both(IMAGES)  # again after the SYNC
    assert skin.tick(1.625) == []
    assert skin.tick(1.749) == on_both(IMAGES)
    assert skin.tick(1.75) == on_both(RECOGNITION)


# What is told of switches


def measured(*, whole: bool = True, images: bool = True) -> Measurement:
    phi = (CONTRACT.phi if images else CONTRACT.states[1].phi).fingerprint
    return make.measurement(valid=b"\1\1\1" + bytes((whole,)), fingerprint=phi)


def told(skin: Skin) -> tuple[int, float]:
    status = skin.switch.status()
    assert set(status) == {"state", "switches", "switch_s"}
    return status["switches"], status["switch_s"]


def test_a_switch_lasts_from_the_request_to_the_first_complete_image_cycle(skin: Skin) -> None:
    assert told(skin) == (0, 0.0)
    skin.to_images(2.0)
    skin.switch.take_measurement(measured(whole=False), 2.0625)
    skin.switch.take_measurement(measured(images=False), 2.0625)
    assert told(skin) == (0, 0.0)
    skin.switch.take_measurement(measured(), 2.125)
    assert told(skin) == (1, 0.125)
    skin.switch.take_measurement(measured(), 2.25)
    assert told(skin) == (1, 0.125)


def test_a_switch_counts_from_the_first_of_its_requests(skin: Skin) -> None:
    skin.switch.ask_images(1.0)
    skin.tick(2.0, 2.001)
    skin.switch.ask_images(1.0)
    skin.tick(2.25)
    skin.switch.take_measurement(measured(), 2.5)
    assert told(skin) == (1, 0.5)


def test_a_request_while_images_come_is_no_switch(skin: Skin) -> None:
    skin.to_images(2.0)
    skin.switch.take_measurement(measured(), 2.125)
    skin.switch.ask_images(20.0)
    skin.tick(2.25)
    skin.switch.take_measurement(measured(), 2.5)
    assert told(skin) == (1, 0.125)


def test_neither_images_without_a_request_nor_those_for_the_zero_are_counted(skin: Skin) -> None:
    skin.switch.take_measurement(measured(), 1.5)
    skin.switch.ask_images(1.0, is_counted=False)
    skin.tick(2.0)
    skin.switch.take_measurement(measured(), 2.5)
    assert told(skin) == (0, 0.0)


def test_images_that_come_after_the_end_of_the_request_are_not_counted(skin: Skin) -> None:
    skin.to_images(2.0, hold_s=0.5)
    skin.tick(2.5)
    skin.switch.take_measurement(measured(), 2.5625)
    assert told(skin) == (0, 0.0)
