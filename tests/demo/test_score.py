"""The figures of a run, from messages in any order."""

import msgspec
import numpy as np
import pytest

from canskin.calibration_messages import CalibrationState, CalibrationStatus
from canskin.messages import FrameCounts, Image, Label, Truth
from demo.report import Percentiles
from demo.score import HISTORY, Score
from tests import messages as make
from tests.demo.helpers import pixels
from tests.layouts import in_one_instant

LAYOUT = in_one_instant()
PERIOD_NS = 10_000_000


def truth(cycle: int, force_n: float = 0.01, label: str = "cup") -> Truth:
    return make.truth(
        cycle,
        sampled_mono_ns=cycle * PERIOD_NS,
        true=pixels(force_n),
        sensor=pixels(force_n, 0.002),
        label=label,
    )


def image(cycle: int, force_n: float = 0.01, latency_ms: int = 9) -> Image:
    return make.image(
        cycle,
        sampled_mono_ns=cycle * PERIOD_NS,
        published_mono_ns=cycle * PERIOD_NS + latency_ms * 1_000_000,
        pixels=pixels(force_n, 0.001),
        valid=bytes(128),
    )


def label(cycle: int, name: str) -> Label:
    return make.label(cycle, name, sampled_mono_ns=cycle * PERIOD_NS, valid_sums=1024)


@pytest.fixture
def score() -> Score:
    return Score(LAYOUT)


def test_psnr_of_contact_cycles_whichever_message_comes_first(score: Score) -> None:
    score.take_truth(truth(1))
    score.take_image(image(1))
    score.take_image(image(2))
    score.take_truth(truth(2))
    score.take_truth(truth(3, force_n=0.001))
    score.take_image(image(3, force_n=0.001))
    report = score.report()
    assert report.contact_cycles == 2
    assert report.psnr_image_db == pytest.approx(20 * np.log10(20), abs=0.01)
    assert report.psnr_sensor_db == pytest.approx(20 * np.log10(10), abs=0.01)
    assert report.latency_ms == Percentiles(p50=9.0, p99=9.0)
    assert score.snapshot is not None


def test_a_message_of_240_cycles_later_is_no_pair(score: Score) -> None:
    score.take_truth(truth(1))
    score.take_image(image(241))
    assert score.report().contact_cycles == 0


def test_labels_count_while_an_object_touches(score: Score) -> None:
    for cycle, said in enumerate(("cup", "ring", "cup", ""), 1):
        score.take_label(label(cycle, said))
        score.take_truth(truth(cycle))
    score.take_truth(truth(5, label=""))
    score.take_label(label(5, "cup"))
    assert (score.report().label_accuracy, score.report().labelled_ratio) == (0.5, 1.0)


def test_contact_cycles_without_a_label_count_as_not_right(score: Score) -> None:
    score.take_truth(truth(1))
    assert (score.report().label_accuracy, score.report().labelled_ratio) == (None, 0.0)
    for running, said in (({}, "no label came"), ({"bus": 0.3}, "no label came: no classifier ran")):
        score.cpu_ratio = running
        assert ("label", said) in score.report().rows()
    for cycle in (2, 3, 4):
        score.take_truth(truth(cycle))
    score.take_label(label(2, "cup"))
    score.take_label(label(3, "ring"))
    assert (score.report().label_accuracy, score.report().labelled_ratio) == (0.25, 0.5)
    assert ("label", "right on 25.0% of the contact cycles; 50.0% got a label") in score.report().rows()


def test_frames_balance_and_the_worst_nodes_are_named(score: Score) -> None:
    bus = make.bus_state(
        mean_load_ratio=0.7,
        nodes=[1, 2, 3],
        nmt=b"\5\5\5",
        missing=[0, 4, 9],
        late=[0, 1, 0],
        emcy=[0, 0, 65296],
    )
    score.take_gateway(
        make.gateway_status(
            10,
            cycles_complete=9,
            frames=FrameCounts(accepted=97, missing=13, late=1, foreign=3),
            buses=[bus],
        )
    )
    for process, sent in (("1", 60), ("2", 40)):
        score.take_nodes(
            make.nodes_status(process, frames_sent=sent, frames_dropped=2),
        )
    report = score.report()
    assert report.frames_sent == report.frames_received + report.frames_lost == 100
    assert report.frames_dropped == 4
    assert [(row.node, row.missing, row.emcy) for row in report.nodes_missing] == [
        (3, 9, "FF10h"),
        (2, 4, "0000h"),
    ]


def test_nothing_measured_is_none_and_not_zero(score: Score) -> None:
    report = score.report()
    assert report.psnr_image_db is None
    assert report.label_accuracy is None
    assert report.latency_ms == Percentiles(p50=None, p99=None)


def test_messages_of_another_size_are_left_alone(score: Score) -> None:
    score.take_truth(msgspec.structs.replace(truth(1), true=b"1234"))
    score.take_image(msgspec.structs.replace(image(1), pixels=b""))
    score.take_truth(truth(2))
    assert score.report().contact_cycles == 0


def test_what_the_newest_label_tells(score: Score) -> None:
    assert score.label_text() == "no label"
    for name, said in (("cup", "cup"), ("", "no contact")):
        score.take_label(label(1, name))
        assert score.label_text() == said
        score.take_label(msgspec.structs.replace(label(1, name), valid_sums=255))
        assert score.label_text() == "not measured"


def test_a_run_of_days_keeps_the_last_hour(score: Score, monkeypatch: pytest.MonkeyPatch) -> None:
    assert {score.latency_ms.maxlen, score.psnr_image_db.maxlen, score.psnr_sensor_db.maxlen} == {HISTORY}
    monkeypatch.setattr("demo.score.HISTORY", 3)
    score = Score(LAYOUT)
    for cycle in range(1, 11):
        score.take_truth(truth(cycle))
        score.take_image(image(cycle, latency_ms=cycle))
    assert list(score.latency_ms) == [8.0, 9.0, 10.0]
    assert score.report().contact_cycles == 10


def test_sensor_that_only_rounds_is_said_to_add_no_noise(score: Score) -> None:
    assert score.report().sensor_adds_noise is None
    score.take_truth(msgspec.structs.replace(truth(1), sensor=pixels(0.01)))
    score.take_image(image(1))
    assert score.report().sensor_adds_noise is False


@pytest.mark.parametrize("taxels", [0, 144])
def test_taxels_in_doubt_are_told(score: Score, taxels: int) -> None:
    zero = CalibrationStatus(state=CalibrationState.FOLLOWING, doubtful_taxels=taxels)
    score.take_gateway(make.gateway_status(calibration=zero))
    assert score.report().doubtful_taxels == taxels
    assert [text.split()[0] for name, text in score.report().rows() if name == "in doubt"] == [str(taxels)][
        : bool(taxels)
    ]
