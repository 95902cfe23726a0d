"""DAGSVM: one linear soft-margin SVM per pair of classes, decided on a graph (section II-C of the paper)."""

from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.svm import SVC
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from classifier.dag import DecisionGraph, pairs


class DagSvm(ClassifierMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn is untyped
    """Linear one-vs-one SVM with a directed acyclic decision graph; a scikit-learn classifier.

    Parameters
    ----------
    C : float
        Balance between a wide margin and the hinge loss.
    max_iter : int
        Most iterations of the solver per pair, -1 for no limit.

    Attributes
    ----------
    classes_ : array, shape (M,)
    weights_ : array, shape (M (M - 1) / 2, features)
        Normals of the hyperplanes, in the order of `classifier.dag.pairs`.
    biases_ : array, shape (M (M - 1) / 2,)
    n_iter_ : int
        Most iterations any pair took.
    """

    def __init__(self, C: float = 1.0, max_iter: int = 200_000) -> None:
        self.C = C
        self.max_iter = max_iter

    def fit(self, X: Any, y: Any) -> "DagSvm":
        """Train every pair on the observations `X`, shape (count, features), labelled `y`.

        Raises
        ------
        ValueError
            If an array cannot be used, or all labels are the same.
        """
        X, y = validate_data(self, X, y)
        check_classification_targets(y)
        self.classes_, codes = np.unique(y, return_inverse=True)
        if self.classes_.size < 2:
            raise ValueError(f"at least 2 classes are needed: got {self.classes_.size} class")
        planes = [self._plane(X, codes, first, second) for first, second in pairs(self.classes_.size)]
        self.weights_ = np.array([plane.coef_[0] for plane in planes])
        self.biases_ = np.array([plane.intercept_[0] for plane in planes])
        self.n_iter_ = max(int(plane.n_iter_.max()) for plane in planes)
        return self

    def _plane(self, X: npt.NDArray[np.float64], codes: npt.NDArray[np.intp], first: int, second: int) -> SVC:
        both = (codes == first) | (codes == second)
        return SVC(C=self.C, kernel="linear", max_iter=self.max_iter).fit(X[both], codes[both] == first)

    def margins(self, X: Any) -> npt.NDArray[np.float64]:
        """Return the signed margin of every pair, positive for its first class, shape (count, pairs)."""
        check_is_fitted(self)
        X = validate_data(self, X, reset=False)
        signed: npt.NDArray[np.float64] = X @ self.weights_.T + self.biases_
        return signed

    def decision_function(self, X: Any) -> npt.NDArray[np.float64]:
        """Return scores whose largest is the class decided for.

        Returns
        -------
        array, shape (count, M), or (count,) for two classes
            Classes score higher the later the graph rules them out: the class ruled out at step s = 1, 2, …
            lies between s - 1 and s, below s by more the clearer it lost; the remaining class is M - 1 plus
            the smallest margin of its path. For two classes, the margin of ``classes_[1]``.
        """
        margins = self.margins(X)
        count = self.classes_.size
        if count == 2:
            return -margins[:, 0]
        graph = DecisionGraph(count)
        scores = np.empty((len(margins), count))
        for row, scored in zip(margins, scores, strict=True):
            scored[:] = np.inf
            for step, (loser, margin) in enumerate(graph.walk(row), start=1):
                scored[loser] = step - margin / (1.0 + margin)
            winner = int(np.argmax(scored))
            scored[winner] = count - 1 + min(margin for _, margin in graph.walk(row))
        return scores

    def predict(self, X: Any) -> npt.NDArray[Any]:
        """Return the label of every observation of `X`, shape (count,)."""
        margins = self.margins(X)
        graph = DecisionGraph(self.classes_.size)
        labels: npt.NDArray[Any] = self.classes_[[graph.decide(row)[0] for row in margins]]
        return labels
