"""Steps: the coarse ones are classified, a hundred times a second, whenever measurements come."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import ModelError
from canskin.fabric import Fabric
from classifier.decide import Classifier
from classifier.learning import train_recorded
from classifier.model import Model
from classifier.modelfile import load_model, save_model
from classifier.newest_sums import FORGET_CYCLES
from classifier.recorded import labelled_touches
from classifier.service import SteppedClassifierService
from classifier.training import TrainingOptions, train
from classifier.used_sums import classified_phi
from skin.layout import Layout
from skin.phi import places
from tests.classifier.conftest import Touches, draw
from tests.layouts import STEPPED, small_layout
from tests.messages import stepped_measurement
from tests.recordings import write_touches

LAYOUT = small_layout(32, 32, **STEPPED)
PHI, CLASSIFIED = LAYOUT.phi(), classified_phi(LAYOUT)


@pytest.fixture(scope="module")
def coarse_model(touches: Touches) -> Model:
    return train(*touches, LAYOUT, options=TrainingOptions(no_touches=1000))


@pytest.fixture
def service(endpoint: str, coarse_model: Model) -> Iterator[SteppedClassifierService]:
    fabric = Fabric("small", "classifier", endpoint, hub=True)
    yield SteppedClassifierService(Classifier(coarse_model, CLASSIFIED), LAYOUT, fabric)
    fabric.close()


def test_the_coarse_sums_are_the_means_of_2_x_2_taxels() -> None:
    assert CLASSIFIED.shape == (256, 1024)
    counts = np.random.default_rng(0).integers(0, 1024, 1024)
    sums = np.asarray(PHI.forward(counts))
    np.testing.assert_array_equal(sums[places(PHI, CLASSIFIED)], CLASSIFIED.forward(counts))
    cells = counts.reshape(16, 2, 16, 2)
    means = cells.mean(axis=(1, 3))
    image = np.asarray(CLASSIFIED.adjoint(sums[places(PHI, CLASSIFIED)].astype(float))).reshape(32, 32) / 32
    np.testing.assert_allclose(image[::2, ::2], means)
    np.testing.assert_allclose(image, np.kron(means, np.ones((2, 2))))


def told_apart(service: SteppedClassifierService, unseen: Touches) -> float:
    """Return which part of the touches gets its label."""
    right = 0
    for force_n, name in zip(*unseen, strict=True):
        for _ in range(5):  # until the touch before counts no more
            label = service.label(stepped_measurement(force_n, layout=LAYOUT))
        assert label is not None
        right += label.label == name
    return right / len(unseen.labels)


def test_objects_are_told_apart(service: SteppedClassifierService, unseen: Touches) -> None:
    assert told_apart(service, unseen) >= 0.97


def test_an_untouched_skin_is_called_nothing(service: SteppedClassifierService) -> None:
    label = service.label(stepped_measurement(np.zeros((32, 32)), layout=LAYOUT))
    assert label is not None
    assert (label.label, label.blind, label.valid_sums) == ("", False, 1024)


def test_a_label_carries_the_newest_measurement_and_settles_without_more(
    service: SteppedClassifierService, unseen: Touches
) -> None:
    touched = stepped_measurement(unseen.force_n[1], layout=LAYOUT, cycle=7, sync_counter=9, sampled_mono_ns=123)
    label = service.label(touched)
    assert label is not None
    assert (label.label, label.cycle, label.sync_counter, label.sampled_mono_ns) == ("plate", 7, 9, 123)
    # The object leaves, and the skin has nothing more to say.
    left = stepped_measurement(np.zeros((32, 32)), layout=LAYOUT, cycle=8)
    labels = [service.label(left), *(service.label(None) for _ in range(FORGET_CYCLES))]
    said = [label.label for label in labels if label is not None]
    assert said[0] == "plate"
    assert set(said[3:]) == {""}
    # A gateway that sends nothing is not spoken for.
    assert service.label(None) is None
    assert service.labelled == 2 + FORGET_CYCLES


def test_blocks_that_are_not_valid_are_missing(service: SteppedClassifierService, unseen: Touches) -> None:
    known = np.ones(PHI.kept.shape, np.bool_)
    known[:3], known[3, 31] = False, False
    label = service.label(stepped_measurement(unseen.force_n[1], known, layout=LAYOUT))
    assert label is not None
    assert (label.valid_sums, label.blind) == (1024 - 4 * 32, False)
    none = np.zeros_like(known)
    said = [service.label(stepped_measurement(unseen.force_n[1], none, layout=LAYOUT)) for _ in range(6)]
    assert said[-1] is not None
    assert (said[-1].label, said[-1].blind, said[-1].valid_sums) == ("", True, 0)


def test_other_measurements_are_refused(service: SteppedClassifierService) -> None:
    good = stepped_measurement(np.zeros((32, 32)), layout=LAYOUT)
    for odd in ({"known": b"", "states": b"", "since_ns": b""}, {"states": b"\0"}, {"fingerprint": "0"}):
        assert service.label(msgspec.structs.replace(good, **odd)) is None
        assert service.label(None) is None
    assert service.label(good) is not None


def test_a_model_tells_how_its_skin_sends(tmp_path: Path, coarse_model: Model, model: Model, layout: Layout) -> None:
    assert (coarse_model.metadata.sending, coarse_model.metadata.fingerprint) == ("steps", CLASSIFIED.fingerprint)
    for each in (coarse_model, model):
        save_model(each, tmp_path / f"{each.metadata.sending}.npz")
    assert load_model(tmp_path / "steps.npz", LAYOUT, CLASSIFIED).metadata == coarse_model.metadata
    with pytest.raises(ModelError, match=r"`model\.sending` is 'synchronous', this skin has 'steps'"):
        load_model(tmp_path / "synchronous.npz", LAYOUT, CLASSIFIED)
    with pytest.raises(ModelError, match=r"`model\.sending` is 'steps', this skin has 'synchronous'"):
        load_model(tmp_path / "steps.npz", layout, layout.phi())


@pytest.mark.heavy
def test_a_model_of_recordings_names_touches_of_another(tmp_path: Path, endpoint: str, unseen: Touches) -> None:
    write_touches(tmp_path / "run.mcap", LAYOUT, *draw(40, 1))
    data = labelled_touches(tmp_path)
    assert (data.sums.shape[1], data.still) == (256, 0)  # boards that nothing touches are silent
    model = train_recorded(data)
    fabric = Fabric("small", "classifier", endpoint, hub=True)
    try:
        of_touches, of_nothing = (
            SteppedClassifierService(Classifier(model, CLASSIFIED), LAYOUT, fabric) for _ in range(2)
        )
        assert told_apart(of_touches, unseen) > 0.95
        test_an_untouched_skin_is_called_nothing(of_nothing)
    finally:
        fabric.close()
