"""C from a grid, by a validation set; then both sets together."""

import numpy as np
import pytest
from sklearn.datasets import make_blobs

from classifier.dagsvm import DagSvm
from classifier.validation import choose_C, global_scale

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


def test_progress_grows() -> None:
    told: list[float] = []
    choose_C(X, y, DEVELOPMENT, VALIDATION, C_grid=(0.1, 1.0), progress=lambda _doing, part: told.append(part))
    assert told == [0, 1 / 3, 2 / 3]


def test_no_C_is_no_choice() -> None:
    with pytest.raises(ValueError, match="at least one C"):
        choose_C(X, y, DEVELOPMENT, VALIDATION, C_grid=())


def test_global_scale_makes_the_root_mean_square_1() -> None:
    assert np.mean((X * global_scale(X)) ** 2) == pytest.approx(1)
    assert global_scale(np.zeros((2, 2))) == 1
