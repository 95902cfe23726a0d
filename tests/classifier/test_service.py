"""The service: labels for measurements of its Φ, one complaint about others."""

import threading
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.fabric import Fabric
from canskin.messages import LABEL, MEASUREMENT, Label, Measurement
from classifier.decide import Classifier
from classifier.model import Model
from classifier.samples import simulate_sums
from classifier.service import ClassifierService, make_service, most_waiting
from classifier.settling import Decision
from shell.service import StopSignal
from skin.layout import Layout, Sync
from skin.phi import Sbhe
from tests import messages as make
from tests.messages import Published
from tests.processes import PATIENCE_S


@pytest.fixture
def hub(endpoint: str) -> Iterator[Fabric]:
    fabric = Fabric("small", "hub", endpoint, hub=True)
    yield fabric
    fabric.close()


@pytest.fixture
def service(hub: Fabric, endpoint: str, model: Model, layout: Layout, phi: Sbhe) -> Iterator[ClassifierService]:
    fabric = Fabric("small", "classifier", endpoint)
    yield ClassifierService(Classifier(model, phi), layout, fabric)
    fabric.close()


@pytest.fixture
def measurement(layout: Layout, phi: Sbhe, unseen: tuple[np.ndarray, np.ndarray]) -> Measurement:
    force_n, _ = unseen  # the second is a plate
    sums = simulate_sums(force_n[1:2], layout, phi, 0.001, np.random.default_rng(0))[0]
    return make.measurement(
        7,
        sync_counter=9,
        sampled_mono_ns=123,
        sampled_error_ns=4,
        sums=sums.astype("<i4").tobytes(),
        valid=np.ones(phi.blocks, np.uint8).tobytes(),
        fingerprint=phi.fingerprint,
    )


def test_label_carries_the_cycle(service: ClassifierService, measurement: Measurement) -> None:
    label = service.label(measurement)
    assert label is not None
    assert (label.cycle, label.sync_counter, label.sampled_mono_ns, label.sampled_error_ns) == (7, 9, 123, 4)
    assert label.label == "plate"
    assert label.valid_sums == 512
    assert 0.5 < label.confidence <= 1


def test_valid_sums_count_the_valid_blocks(service: ClassifierService, measurement: Measurement, phi: Sbhe) -> None:
    valid = np.ones(phi.blocks, np.uint8)
    valid[:3] = 0
    label = service.label(msgspec.structs.replace(measurement, valid=valid.tobytes()))
    assert label is not None
    assert label.valid_sums == 512 - phi.starts[3]


def test_other_measurements_are_refused_and_said_once(
    service: ClassifierService, measurement: Measurement, caplog: pytest.LogCaptureFixture
) -> None:
    for odd in ({"fingerprint": "0" * 16}, {"sums": b"\0" * 12}, {"sums": b"\0"}, {"valid": b""}):
        assert service.label(msgspec.structs.replace(measurement, **odd)) is None
    (said,) = caplog.messages
    assert "0000000000000000" in said
    assert service.label(measurement) is not None
    assert service.labelled == 1


def test_over_the_fabric_until_told_to_stop(service: ClassifierService, hub: Fabric, measurement: Measurement) -> None:
    heard = threading.Event()
    got: list[Label] = []
    hub.subscribe(LABEL, lambda label: (got.append(label), heard.set()))
    stop = StopSignal()
    thread = threading.Thread(target=service.run, args=(stop,))
    thread.start()
    try:
        for _ in range(round(PATIENCE_S / 0.02)):
            hub.publish(MEASUREMENT, measurement)
            if heard.wait(0.02):
                break
    finally:
        stop.set()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert got[0].label == "plate"


class Timed:
    """Keeps the times that it is given."""

    def __init__(self) -> None:
        self.times_ns: list[int | None] = []

    def decide(self, *values: Any) -> Decision:
        self.times_ns.append(values[3])
        return Decision("dome", 1.0)


@pytest.mark.parametrize(("keeps_time", "expected"), [(True, [2_000_000, 4_000_000]), (False, [None, None])])
def test_labels_settle_by_the_time_of_the_samples_where_it_is_that_of_the_skin(
    hub: Fabric, measurement: Measurement, layout: Layout, keeps_time: bool, expected: list[int | None]
) -> None:
    timed = Timed()
    service = ClassifierService(timed, layout, hub, keeps_time=keeps_time)  # type: ignore[arg-type]
    for cycle in (1, 2):
        service.label(msgspec.structs.replace(measurement, cycle=cycle, sampled_mono_ns=2_000_000 * cycle))
    assert timed.times_ns == expected


class Waiting(Published):
    """Ends the service with the label of the cycle `last`."""

    def __init__(self, stop: StopSignal, last: int) -> None:
        super().__init__()
        self._stop, self._last = stop, last

    def publish(self, topic: object, message: Any) -> None:
        super().publish(topic, message)
        if message.cycle == self._last:
            self._stop.set()


def test_after_a_pause_the_newest_measurements_that_waited_get_labels(measurement: Measurement, layout: Layout) -> None:
    stop = StopSignal()
    exchange = Waiting(stop, last=29)
    quick = msgspec.structs.replace(layout, sync=Sync(rate_hz=500.0))
    service = ClassifierService(Timed(), quick, exchange)  # type: ignore[arg-type]
    for cycle in range(30):
        exchange.mailboxes[0].put(msgspec.structs.replace(measurement, cycle=cycle))
    service.run(stop)
    assert [each.cycle for each in exchange.messages] == list(range(10, 30))


@pytest.mark.parametrize(
    ("duty", "cycles"), [("classifier=1", [1, 2]), ("classifier=2", [2]), ("reconstructor=2", [1, 2])]
)
def test_a_classifier_that_is_not_named_makes_the_label_and_keeps_it(
    measurement: Measurement, layout: Layout, duty: str, cycles: list[int]
) -> None:
    stop = StopSignal()
    exchange = Waiting(stop, last=2)
    service = make_service(Timed(), layout, exchange, "1")  # type: ignore[arg-type]
    for cycle, named in enumerate((duty, "classifier=1"), 1):
        exchange.mailboxes[0].put(msgspec.structs.replace(measurement, cycle=cycle, duty=named))
    service.run(stop)
    assert [each.cycle for each in exchange.messages] == cycles
    assert exchange.messages[-1].number == 2


@pytest.mark.parametrize(("rate_hz", "count"), [(1, 4), (100, 4), (200, 8), (500, 20), (1000, 40)])
def test_measurements_of_40_ms_may_wait_and_four_at_least(rate_hz: float, count: int) -> None:
    assert most_waiting(rate_hz) == count
