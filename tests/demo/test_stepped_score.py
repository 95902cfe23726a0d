"""The figures of a run with steps: the image on show at each instant of the truth."""

import msgspec
import numpy as np
import pytest

from canskin.messages import FrameCounts, GatewayStatus, Image, Label, Truth
from demo.processor_time import ProcessorTime, processor_time, ratios
from demo.report import Percentiles
from demo.score import Score
from skin.layout import Layout, load_layout
from tests import messages as make
from tests.demo.helpers import pixels
from tests.layouts import STEPPED_SKIN

MS = 1_000_000


def truth(time_ms: int, force_n: float = 0.01, label: str = "cup") -> Truth:
    true, sensor = pixels(force_n), pixels(force_n, 0.002)
    return make.truth(
        time_ms // 10, sync_counter=0, sampled_mono_ns=time_ms * MS, true=true, sensor=sensor, label=label
    )


def image(published_ms: int, error_n: float = 0.001, latency_ms: int = 3) -> Image:
    return make.image(
        published_ms,
        sampled_mono_ns=(published_ms - latency_ms) * MS,
        published_mono_ns=published_ms * MS,
        pixels=pixels(0.01, error_n),
        valid=bytes([1] * 128),
    )


def label(time_ms: int, name: str) -> Label:
    return make.label(time_ms, name, sampled_mono_ns=time_ms * MS, valid_sums=4096)


def status(cycles: int, complete: int) -> GatewayStatus:
    buses = [make.bus_state(bus.name, mean_load_ratio=0.05) for bus in STEPPED_SKIN.bus]
    return make.gateway_status(cycles, cycles_complete=complete, frames=FrameCounts(accepted=100), buses=buses)


@pytest.fixture
def score() -> Score:
    return Score(STEPPED_SKIN)


@pytest.mark.parametrize("layout", [STEPPED_SKIN, load_layout()], ids=["steps", "in turns"])
def test_the_image_on_show_is_compared_at_each_truth(layout: Layout) -> None:
    score = Score(layout)
    # Many bad images between two truths count for nothing; so does what comes later.
    for each in (11, 12, 13):
        score.take_image(image(each, error_n=0.02))
    score.take_image(image(19))
    score.take_truth(truth(20))
    score.take_truth(truth(30))
    score.take_truth(truth(40, force_n=0.001))
    score.take_image(image(41, error_n=0.02))
    report = score.report()
    assert report.contact_cycles == 2
    assert report.psnr_image_db == pytest.approx(20 * np.log10(20), abs=0.01)
    assert report.psnr_sensor_db == pytest.approx(20 * np.log10(10), abs=0.01)
    assert report.latency_ms == Percentiles(p50=3.0, p99=3.0)


def test_an_image_without_new_sums_has_no_latency(score: Score) -> None:
    for published_ms in (10, 110, 210):
        score.take_image(image(published_ms, latency_ms=published_ms - 7))
    score.take_image(msgspec.structs.replace(image(300, latency_ms=250), valid_sums=0))
    score.take_image(image(310, latency_ms=5))
    assert list(score.latency_ms) == [3.0, 5.0]


def test_labels_count_at_the_truth_nearest_to_them(score: Score) -> None:
    for each, name in ((18, "cup"), (24, "ring"), (33, "cup")):
        score.take_label(label(each, name))
    for each in (20, 30, 40):
        score.take_truth(truth(each))
    assert score.report().label_accuracy == pytest.approx(2 / 3)


def test_rows_speak_of_measurements_and_frames(score: Score) -> None:
    score.take_gateway(status(500, 480))
    score.take_image(msgspec.structs.replace(image(10), sampled_error_ns=1_200_000))
    score.take_image(image(11))  # a gateway without time stamps knows no age
    score.cpu_ratio = {"nodes": 0.3, "gateway": 0.1}
    report = score.report()
    assert report.kbit_per_s == 200.0
    rows = dict(report.rows())
    assert rows["measurements"] == "500 published, 480 with all blocks valid"
    assert (
        rows["frame to image"] == "3.0 ms, 99 % within 3.0 ms; 99 % of samples are up to 1.2 ms older than their frames"
    )
    assert rows["bus load"] == "5.0%, 5.0%, 5.0%, 5.0%; 200 kbit/s on all"
    assert rows["processors"] == "nodes 30%, gateway 10%; all 40% of one"
    assert not {"cycles", "SYNC to image"} & set(rows)
    document = msgspec.to_builtins(report)
    assert (document["sending"], document["cpu_ratio"]) == ("steps", {"nodes": 0.3, "gateway": 0.1})


def test_a_run_without_a_whole_measurement_fails(score: Score) -> None:
    assert score.report().failure == "no measurement: no sums came"
    score.take_gateway(status(500, 0))
    assert score.report().failure.startswith("no measurement had all blocks valid")
    score.take_gateway(status(500, 1))
    assert score.report().failure == ""


def test_processor_time_over_wall_time() -> None:
    before = {"nodes": ProcessorTime(1, 2.0), "gateway": ProcessorTime(2, 5.0)}
    after = {"nodes": ProcessorTime(1, 3.5), "gateway": ProcessorTime(9, 0.5), "viewer": ProcessorTime(3, 0.25)}
    assert ratios(before, after, 2.0) == {"nodes": 0.75, "gateway": 0.25, "viewer": 0.125}
    assert ratios(before, after, 0.0) == {}
    assert processor_time(2**30) is None
