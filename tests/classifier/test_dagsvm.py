"""DAGSVM as a scikit-learn classifier."""

from collections.abc import Callable

import numpy as np
import pytest
from sklearn.datasets import make_blobs
from sklearn.model_selection import GridSearchCV
from sklearn.utils.estimator_checks import parametrize_with_checks

from classifier.dagsvm import DagSvm
from classifier.descent import descend


@parametrize_with_checks([DagSvm()])
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_scikit_learn_contract(estimator: DagSvm, check: Callable[[DagSvm], None]) -> None:
    check(estimator)


def test_widest_margin_of_two_points() -> None:
    machine = DagSvm(C=100.0).fit([[-1.0, 0.0], [3.0, 0.0]], ["left", "right"])
    np.testing.assert_allclose(machine.weights_, [[-0.5, 0.0]], atol=1e-6)  # positive for the first class
    np.testing.assert_allclose(machine.biases_, [0.5], atol=1e-6)
    assert list(machine.predict([[0.9, 5.0], [1.1, -5.0]])) == ["left", "right"]


def test_separable_blobs_are_told_apart() -> None:
    X, y = make_blobs(600, centers=6, n_features=8, cluster_std=1.0, random_state=3)
    machine = DagSvm().fit(X[:300], y[:300])
    assert machine.weights_.shape == (15, 8)
    assert np.mean(machine.predict(X[300:]) == y[300:]) > 0.97


def test_compiled_decision_is_the_prediction() -> None:
    X, y = make_blobs(300, centers=7, n_features=3, cluster_std=5.0, random_state=4)
    machine = DagSvm().fit(X, y)
    compiled = [descend(one, machine.weights_, machine.biases_, 7)[0] for one in X]
    np.testing.assert_array_equal(machine.predict(X), compiled)


@pytest.mark.parametrize("classes", [2, 4])
def test_inner_products_give_the_margins_of_the_observations(classes: int) -> None:
    X, y = make_blobs(200, centers=classes, n_features=5, random_state=5)
    whole, products = DagSvm().fit(X, y), DagSvm(kernel="precomputed").fit(X @ X.T, y)
    np.testing.assert_allclose(products.margins(X @ X.T), whole.margins(X), atol=1e-2)
    assert (whole.margins(X).shape[1], products.n_iter_ > 0) == (classes * (classes - 1) // 2, True)


def test_one_class_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 classes"):
        DagSvm().fit([[0.0], [1.0]], ["a", "a"])


def test_grid_search_finds_C() -> None:
    X, y = make_blobs(90, centers=3, cluster_std=2.0, random_state=1)
    search = GridSearchCV(DagSvm(), {"C": [0.01, 1.0]}, cv=2).fit(X, y)
    assert search.best_params_["C"] in {0.01, 1.0}
    assert search.best_score_ > 0.8
