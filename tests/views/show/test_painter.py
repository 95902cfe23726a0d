"""What is drawn of the messages of a skin."""

from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from canskin.messages import Contact
from canskin.peers import new_peer
from skin.wall_times import Clocks
from tests.health.helpers import Messages
from views.show.painter import Painter

WALL_NS = 1_700_000_000_000_000_000


class Drawn:
    """A canvas that keeps what it is told."""

    def __init__(self) -> None:
        self.images: list[tuple[int, int, np.ndarray]] = []
        self.found: list[tuple[int | None, list[int]]] = []
        self.figures: list[tuple[int, str, float]] = []
        self.lines: list[tuple[str, str]] = []

    def image(self, time_ns: int, cycle: int, measured_n: np.ndarray) -> None:
        self.images.append((time_ns, cycle, measured_n))

    def contacts(self, time_ns: int, cycle: int | None, contacts: Sequence[Contact]) -> None:
        self.found.append((cycle, [each.identity for each in contacts]))

    def figure(self, time_ns: int, name: str, value: float) -> None:
        self.figures.append((time_ns, name, value))

    def line(self, time_ns: int, level: str, text: str) -> None:
        self.lines.append((level, text))

    def close(self) -> None:
        """Nothing waits."""


@pytest.fixture
def drawn() -> Drawn:
    return Drawn()


@pytest.fixture
def painter(messages: Messages, drawn: Drawn) -> Painter:
    painter = Painter(messages.layout, drawn)
    painter.take(Clocks(sampled_mono_ns=0, wall_offset_ns=WALL_NS), 0.0, WALL_NS)
    return painter


def test_image_is_drawn_at_its_sampling_instant(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    painter.take(messages.image(5, sync_s=2.0, invalid=(3,)), 2.1, WALL_NS)
    ((time_ns, cycle, measured_n),) = drawn.images
    is_valid = messages.layout.phi().block_of_taxel.reshape(16, 16) != 3
    assert (time_ns, cycle) == (WALL_NS + 2_000_000_000, 5)
    np.testing.assert_array_equal(measured_n, np.where(is_valid, messages.grid(), np.nan))
    assert drawn.figures[0] == (time_ns, "valid_share", 7 / 8)
    assert drawn.figures[1][1:] == ("force_n", pytest.approx(messages.grid()[is_valid].sum()))


def test_a_blind_skin_has_no_contacts(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    painter.take(messages.contacts(1), 0.0, WALL_NS)
    painter.take(messages.contacts(2, blind=True), 0.0, WALL_NS)
    painter.take(msgspec.structs.replace(messages.contacts(3), contacts=[]), 0.0, WALL_NS)
    assert drawn.found == [(1, [7]), (2, []), (3, [])]


def test_contacts_go_when_no_more_images_come(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    painter.take(messages.contacts(1), 1.0, WALL_NS)
    for now_s in (1.4, 1.6, 1.7):
        painter.look(now_s, WALL_NS)
    assert drawn.found == [(1, [7]), (None, [])]


def test_nothing_is_drawn_before_the_clocks_of_the_gateway_are_known(drawn: Drawn, messages: Messages) -> None:
    painter = Painter(messages.layout, drawn)
    for message in (messages.image(), messages.contacts(), messages.label("ring")):
        painter.take(message, 0.0, WALL_NS)
    assert (drawn.images, drawn.found, drawn.figures, drawn.lines, painter.drawn) == ([], [], [], [], 0)


def test_a_label_is_a_curve_and_its_changes_are_lines(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    for label in (messages.label("ring", 0.8), messages.label("ring", 0.9), messages.label("ring", 0.7, valid_sums=0)):
        painter.take(label, 0.0, WALL_NS)
    painter.take(messages.label(""), 0.0, WALL_NS)
    assert [value for _, name, value in drawn.figures if name == "label_confidence"] == [0.8, 0.9, 0.0, 0.0]
    assert [text for _, text in drawn.lines if "touched" in text] == ["touched by: ring", "untouched"]


def test_load_of_each_bus_and_notices_that_begin_and_end(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    painter.take(messages.gateway(nmt=((5, 5, 255, 5), (5, 5, 5, 5))), 1.0, WALL_NS)
    painter.look(1.0, WALL_NS)
    assert [(name, value) for _, name, value in drawn.figures] == [("load/left", 0.8), ("load/right", 0.8)]
    assert ("warning", "left: node 3 silent [node-silent]") in drawn.lines
    painter.take(messages.gateway(), 2.1, WALL_NS)
    painter.look(2.1, WALL_NS)
    assert drawn.lines[-1] == ("info", "over: left: node 3 silent [node-silent]")


def test_a_service_is_gone_when_its_token_is(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    peer = new_peer("palm", "reconstructor", messages.layout.phi().fingerprint)
    painter.take_peer(peer, True, 0.0)
    painter.take(messages.image(), 0.0, WALL_NS)
    painter.look(0.0, WALL_NS)
    painter.look(1.0, WALL_NS)
    assert ("error", "images stopped: no measurements without the gateway [gateway-gone]") in drawn.lines
    painter.take_peer(peer, False, 1.5)
    painter.look(2.0, WALL_NS)
    assert ("error", "images stopped: reconstructor is gone [service-gone]") in drawn.lines


def test_a_recording_tells_of_no_service_that_it_is_gone(painter: Painter, drawn: Drawn, messages: Messages) -> None:
    painter.take(messages.image(), 0.0, WALL_NS)
    painter.take(messages.label(), 0.0, WALL_NS)
    painter.take(messages.gateway(), 1.0, WALL_NS)
    painter.look(1.0, WALL_NS)
    errors = {text for level, text in drawn.lines if level == "error"}
    assert errors == {f"{each} stopped: no more came [service-silent]" for each in ("images", "labels")}
