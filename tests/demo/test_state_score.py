"""Figures of recognition and of images."""

import pytest

from canskin.messages import BusState, FrameCounts, GatewayStatus, Label, Measurement
from demo.state_score import StateScore


def status(state: str, load: float, switches: int = 0, switch_s: float = 0.0) -> GatewayStatus:
    bus = BusState(name="bus0", load_ratio=load, nodes=[], nmt=b"")
    return GatewayStatus(
        time_ns=0,
        cycles=1,
        cycles_complete=1,
        frames=FrameCounts(),
        sync_rate_hz=1.0,
        buses=[bus],
        state=state,
        switches=switches,
        switch_s=switch_s,
    )


def label(cycle: int) -> Label:
    return Label(cycle=cycle, sync_counter=1, sampled_mono_ns=0, label="ring", confidence=1.0, valid_sums=64)


def test_loads_and_labels_count_in_their_state() -> None:
    score = StateScore()
    for state, load in (("recognition", 0.9), ("recognition", 0.1), ("images", 0.5), ("images", 0.7)):
        score.take_gateway(status(state, load, *((1, 0.08) if state == "images" else ())))
    score.take_measurement(Measurement(cycle=7, sync_counter=1, sampled_mono_ns=0, sums=b"", valid=b"", fingerprint=""))
    for cycle, is_right in ((6, False), (8, True), (7, True)):
        score.count_label(label(cycle), is_right=is_right)
    figures = score.figures()
    assert (figures["recognition"].bus_load, figures["images"].bus_load) == ([0.1], [0.7])
    assert figures["recognition"].label_accuracy == 0.5
    assert figures["images"].label_accuracy == 1.0
    assert (score.switches, score.switch_ms) == (1, [pytest.approx(80)])


def test_nodes_without_states_have_no_figures() -> None:
    score = StateScore()
    score.take_gateway(status("", 0.5))
    score.take_gateway(status("", 0.5))
    assert score.figures() == {}
