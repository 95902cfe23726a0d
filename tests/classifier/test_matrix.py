"""The classifier on sums of any matrix, one for all frames or one for each."""

import numpy as np
import pytest

from canskin.errors import InputError
from classifier.decide import Classifier
from classifier.features import Smoothed
from classifier.samples import simulate_sums
from classifier.training import TrainingOptions, train
from skin.layout import Layout
from skin.matrix import MatrixPhi, signs_of
from skin.phi import sbhe
from skin.surface import grid_surface
from tests.classifier.conftest import Touches
from tests.layouts import small_layout

GRID = grid_surface(16, 16, 0.004, np.arange(0))


def wire(entries: np.ndarray) -> Layout:
    """Return a skin of 32 x 32 taxels whose sums other hardware makes."""
    rows = signs_of(np.asarray(entries, np.int8))
    return small_layout(32, 32, sync={"rate_hz": 20.0}, measurement={"ensemble": "matrix", "matrix": rows})


@pytest.mark.parametrize(("frames", "least"), [(1, 0.9), (7, 0.8)])
def test_objects_are_named_from_sums_of_random_codes(
    touches: Touches, unseen: Touches, frames: int, least: float
) -> None:
    layout = wire(np.random.default_rng(3).integers(0, 2, (frames, 400, 1024)))
    model = train(*touches, layout, options=TrainingOptions(no_touches=1000))
    phi = layout.operator()
    sums = simulate_sums(unseen.force_n, layout, phi, 0.001, np.random.default_rng(4))
    right = 0
    for place, (one, label) in enumerate(zip(sums, unseen.labels, strict=True)):
        classifier = Classifier(model, phi)
        for turn in range(3):
            decision = classifier.decide(one, np.ones(400, np.bool_), place + 1 + 10 * frames * turn)
        right += decision.label == label
    assert right / len(sums) > least


def test_an_offset_of_all_taxels_shows_nothing() -> None:
    codes = MatrixPhi(np.random.default_rng(3).integers(0, 2, (2, 60, 256)))
    smoothed, force = Smoothed(codes, GRID), np.zeros(256, np.int32)
    force[100:104] = 300
    seen = []
    for offset in (0, 50):
        smoothed.measure(codes.of_cycle(2).forward(force + offset), np.ones(60, np.float32), 1.0, 2)
        seen.append(np.concatenate((smoothed.energies, smoothed.peaks)))
    np.testing.assert_allclose(seen[1], seen[0], rtol=1e-3)


def test_a_matrix_of_balanced_sbhe_rows_has_the_image_of_the_sbhe() -> None:
    phi = sbhe(256, 64, seed=1)
    rows = phi.row_of_sum > 0  # the sum of a block is left out of the image of an SBHE
    matrix = MatrixPhi(np.rint(phi.forward(np.eye(256))).T[rows])
    sums = np.asarray(phi.forward(np.random.default_rng(1).integers(0, 500, 256)))
    whole, dense = Smoothed(phi, GRID), Smoothed(matrix, GRID)
    whole.measure(sums, np.ones(8, np.float32), 1.0)
    dense.measure(sums[rows], np.ones(rows.sum(), np.float32), 1.0)
    np.testing.assert_allclose(dense.peaks, whole.peaks * 64 / rows.sum(), rtol=1e-4)


def test_sums_of_changing_codes_are_no_features(touches: Touches) -> None:
    layout = wire(np.random.default_rng(3).integers(0, 2, (2, 40, 1024)))
    with pytest.raises(InputError, match="expected energies"):
        train(*touches, layout, options=TrainingOptions(features="sums"))
