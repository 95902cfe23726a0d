"""Training: what comes out, that it repeats, and what is refused."""

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from classifier.decide import Classifier
from classifier.model import Model
from classifier.samples import simulate_sums
from classifier.training import TrainingOptions, train
from skin.layout import Layout
from skin.measurement import Sbhe

Labelled = tuple[np.ndarray, np.ndarray]


def accuracy(model: Model, layout: Layout, phi: Sbhe, unseen: Labelled) -> float:
    force_n, labels = unseen
    sums = simulate_sums(force_n, layout, phi, 0.001, np.random.default_rng(5))
    classifier = Classifier(model, phi, settling=1.0)
    valid = np.ones(phi.blocks, np.uint8)
    return float(np.mean([classifier.decide(y, valid).label for y in sums] == labels))


def test_unseen_touches_at_any_place_and_depth(model: Model, layout: Layout, phi: Sbhe, unseen: Labelled) -> None:
    assert accuracy(model, layout, phi, unseen) > 0.97
    assert model.metadata.card.validation_accuracy > 0.97
    assert set(model.metadata.card.per_object) == {"dome", "plate"}


def test_paper_mode_learns_from_raw_sums(raw_model: Model, layout: Layout, phi: Sbhe, unseen: Labelled) -> None:
    assert raw_model.weights.shape == (1, 512)
    assert np.ptp(raw_model.scale) == 0  # one global scale
    assert accuracy(raw_model, layout, phi, unseen) > 0.6  # better than chance: a plate weighs more


def test_card_tells_data_split_and_confusion(model: Model) -> None:
    card = model.metadata.card
    assert (card.touches, card.development, card.validation) == (240, 180, 60)
    confusion = np.array(card.confusion)
    assert confusion.sum() == 60
    assert confusion.trace() == pytest.approx(60 * card.validation_accuracy)
    assert list(card.per_object.values()) == pytest.approx(list(confusion.diagonal() / confusion.sum(axis=1)))
    assert card.data == "given images"
    assert card.unknown_ratio < 0.2


@pytest.mark.heavy
def test_same_seed_same_model(layout: Layout, touches: Labelled) -> None:
    one, two, other = (
        train(*touches, layout, options=TrainingOptions(no_touches=200, seed=seed, C_grid=(1.0,))) for seed in (3, 3, 4)
    )
    assert msgspec.json.encode(one.metadata) == msgspec.json.encode(two.metadata)
    np.testing.assert_array_equal(one.weights, two.weights)
    assert not np.array_equal(one.weights, other.weights)


@pytest.mark.heavy
def test_progress_tells_what_is_done(layout: Layout, touches: Labelled) -> None:
    said: list[tuple[str, float]] = []
    train(*touches, layout, options=TrainingOptions(no_touches=200), progress=lambda *step: said.append(step))
    ratios = [ratio for _, ratio in said]
    assert ratios == sorted(ratios)
    assert "C = 0.1" in [doing for doing, _ in said]


def test_images_that_cannot_be_used(layout: Layout, touches: Labelled) -> None:
    force_n, labels = touches
    with pytest.raises(InputError, match="expected images of shape"):
        train(force_n[:, :16], labels, layout)
    with pytest.raises(InputError, match="one per label"):
        train(force_n, labels[:-1], layout)
    with pytest.raises(InputError, match="2 or more objects"):
        train(force_n[::2], labels[::2], layout)
    with pytest.raises(InputError, match="8 or more touches"):
        train(force_n[:12], labels[:12], layout)
    with pytest.raises(InputError, match="name is empty"):
        train(force_n, np.where(labels == "dome", "", labels), layout)
    broken = force_n.copy()
    broken[3, 1, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        train(broken, labels, layout)
    with pytest.raises(InputError, match="unknown object"):
        train(force_n, np.where(labels == "dome", "unknown object", labels), layout)
    for options, says in (
        (TrainingOptions(noise_n=0.0), "expected noise above 0 and below 0.02 N, got 0.0 N$"),
        (TrainingOptions(C_grid=()), "expected one C or more"),
        (TrainingOptions(C_grid=(-1.0,)), "each above 0"),
        (TrainingOptions(no_touches=1), "2 or more draws"),
    ):
        with pytest.raises(InputError, match=says):
            train(force_n, labels, layout, options=options)


def test_rows_that_show_no_contact_are_refused(layout: Layout, touches: Labelled) -> None:
    rows = tuple((block, 0) for block in range(3))
    measurement = msgspec.structs.replace(layout.measurement, sums=3, rows=rows, selection="balanced")
    with pytest.raises(InputError, match="all 3 rows of this layout are row 0"):
        train(*touches, msgspec.structs.replace(layout, measurement=measurement))
