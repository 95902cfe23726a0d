"""C from a grid, by a validation set; then both sets together."""

import numpy as np
import pytest
from sklearn.datasets import make_blobs

from classifier.dagsvm import DagSvm
from classifier.validation import choose_C, global_scale, not_validated

X, y = make_blobs(240, centers=4, n_features=5, cluster_std=3.0, random_state=2)
DEVELOPMENT, VALIDATION, TEST = np.arange(100), np.arange(100, 160), np.arange(160, 240)


def test_best_C_of_the_validation_set_is_trained_again_on_both() -> None:
    grid = (1e-6, 0.1, 10.0)
    chosen = choose_C(X, y, DEVELOPMENT, VALIDATION, C_grid=grid)
    scores = [DagSvm(C).fit(X[:100], y[:100]).score(X[100:160], y[100:160]) for C in grid]
    assert grid[int(np.argmax(scores))] == chosen.C
    assert chosen.accuracy == max(scores)
    again = DagSvm(chosen.C).fit(X[:160], y[:160])
    np.testing.assert_array_equal(chosen.machine.predict(X[TEST]), again.predict(X[TEST]))
    development_machine = DagSvm(chosen.C).fit(X[:100], y[:100])
    np.testing.assert_array_equal(chosen.development_machine.predict(X[TEST]), development_machine.predict(X[TEST]))


def test_inner_products_give_the_same_machine() -> None:
    linear = choose_C(X, y, DEVELOPMENT, VALIDATION, C_grid=(1.0,))
    gram = choose_C(X @ X.T, y, DEVELOPMENT, VALIDATION, C_grid=(1.0,), machine=DagSvm(kernel="precomputed"))
    trained = np.arange(160)
    inner = (X @ X.T)[np.ix_(TEST, trained)]
    np.testing.assert_allclose(gram.machine.margins(inner), linear.machine.margins(X[TEST]), atol=1e-2)


def test_global_scale_makes_the_root_mean_square_1() -> None:
    assert np.mean((X * global_scale(X)) ** 2) == pytest.approx(1)
    assert global_scale(np.zeros((2, 2))) == 1


@pytest.mark.parametrize(
    ("touches", "recordings", "told"),
    [
        ((12, 12), (2, 2), {}),
        ((12, 12), (1, 1), dict.fromkeys(("dome", "plate"), "12 touches of this label, in one recording")),
        ((8, 8), (2, 2), dict.fromkeys(("dome", "plate"), "8 touches of this label, in 2 recordings")),
        ((12, 24), (1, 2), {"dome": "12 touches of this label, in one recording"}),
    ],
)
def test_an_accuracy_needs_ten_touches_and_two_recordings_of_each_label(
    touches: tuple[int, int], recordings: tuple[int, int], told: dict[str, str]
) -> None:
    names = ("dome", "plate")
    assert not_validated(*(dict(zip(names, each, strict=True)) for each in (touches, recordings))) == told
