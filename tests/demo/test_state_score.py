"""Figures of recognition and of images."""

import pytest

from canskin.messages import GatewayStatus, Label, Truth
from demo.state_score import REMEMBERED, StateScore
from tests import messages as make


def status(state: str, load: float, switches: int = 0, switch_s: float = 0.0) -> GatewayStatus:
    buses = [make.bus_state(load_ratio=load)]
    return make.gateway_status(buses=buses, state=state, switches=switches, switch_s=switch_s)


def label(cycle: int, name: str) -> Label:
    return make.label(cycle, name, valid_sums=64)


def truth(cycle: int) -> Truth:
    return make.truth(cycle, sampled_mono_ns=cycle, label="ring")


def test_loads_and_labels_count_in_their_state() -> None:
    """A cycle with contact and no label counts, and a label may come before the measurement of its cycle."""
    score = StateScore()
    for state, load in (("recognition", 0.9), ("recognition", 0.1), ("images", 0.5), ("images", 0.7)):
        score.take_gateway(status(state, load, *((1, 0.08) if state == "images" else ())))
    for cycle in range(1, 9):
        score.take_contact(truth(cycle))
    for cycle, name in ((5, ""), (6, "ring"), (7, "ring"), (8, "ring")):
        score.take_label(label(cycle, name), truth(cycle))
    score.take_image_cycle(truth(7))
    figures = score.figures()
    assert (figures["recognition"].bus_load, figures["images"].bus_load) == ([0.1], [0.7])
    assert figures["recognition"].label_accuracy == pytest.approx(2 / 7)
    assert figures["images"].label_accuracy == 1.0
    assert (score.switches, score.switch_ms) == (1, [pytest.approx(80)])


def test_nodes_without_states_have_no_figures() -> None:
    score = StateScore()
    score.take_gateway(status("", 0.5))
    score.take_gateway(status("", 0.5))
    assert score.figures() == {}


def test_cycles_beyond_those_that_wait_are_counted() -> None:
    score = StateScore()
    for _ in range(2):
        score.take_gateway(status("images", 0.5))
    for cycle in range(REMEMBERED + 10):
        score.take_contact(truth(cycle))
        score.take_image_cycle(truth(cycle))
        if cycle % 2:
            score.take_label(label(cycle, "ring"), truth(cycle))
    assert score.figures()["images"].label_accuracy == 0.5
    assert score.figures()["recognition"].label_accuracy is None
