"""Training: what comes out, that it repeats, and what is refused."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, ModelError
from classifier.decide import Classifier
from classifier.model import Model
from classifier.modelfile import load_model, save_model
from classifier.samples import simulate_sums
from classifier.training import TrainingOptions, train
from skin.layout import Layout
from skin.phi import Sbhe
from tests import surfaces

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


def on_tube(skin: Layout, count: int, seed: int) -> Labelled:
    """Return blunt "dome"s and flat "plate"s anywhere on a tube, 4 to 10 mN deep."""
    rng, positions_m = np.random.default_rng(seed), skin.taxels.surface.positions_m
    labels = np.array([("dome", "plate")[index % 2] for index in range(count)])
    middles = positions_m[rng.integers(0, len(positions_m), count)] + rng.normal(0, 0.002, (count, 3))
    apart = np.linalg.norm(positions_m - middles[:, None], axis=2) / skin.taxels.surface.pitch_m
    profiles = np.where((labels == "dome")[:, None], 1 - (apart / 2.5) ** 2, apart < 4)
    force_n = rng.uniform(0.004, 0.01, (count, 1)) * np.clip(profiles, 0, 1)
    return force_n.astype(np.float32).reshape(count, 1, -1), labels


def test_a_skin_of_positions_is_trained_and_its_model_is_for_its_surface_alone(tmp_path: Path) -> None:
    slow = {"sync": {"rate_hz": 20.0}}
    skin, other = (surfaces.tube_layout(20, radius_m, **slow) for radius_m in (0.03, 0.031))
    model = train(*on_tube(skin, 240, 1), skin, options=TrainingOptions(no_touches=3000))
    assert accuracy(model, skin, skin.phi(), on_tube(skin, 200, 2)) > 0.95
    save_model(model, tmp_path / "tube.npz")
    loaded = load_model(tmp_path / "tube.npz", skin, skin.phi())
    assert accuracy(loaded, skin, skin.phi(), on_tube(skin, 20, 2)) > 0.95
    assert other.phi().fingerprint == skin.phi().fingerprint
    with pytest.raises(ModelError, match=r"trained for another skin \(`model.surface` is"):
        load_model(tmp_path / "tube.npz", other, other.phi())


@pytest.mark.heavy
def test_same_seed_same_model(layout: Layout, touches: Labelled) -> None:
    one, two, other = (
        train(*touches, layout, options=TrainingOptions(no_touches=200, seed=seed, C_grid=(1.0,))) for seed in (3, 3, 4)
    )
    assert msgspec.json.encode(one.metadata) == msgspec.json.encode(two.metadata)
    np.testing.assert_array_equal(one.weights, two.weights)
    assert not np.array_equal(one.weights, other.weights)


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
