"""DAGSVM: one soft-margin SVM per pair of classes, and a decision graph (section II-C of the paper)."""

from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.svm import SVC
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from classifier.dag import Float64, walked

Kernel = Literal["linear", "precomputed"]


class DagSvm(ClassifierMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn is untyped
    """One-vs-one SVM with a directed acyclic decision graph; a scikit-learn classifier.

    Parameters
    ----------
    C : float
        Weight of the hinge loss, the same for every pair.
    kernel : {"linear", "precomputed"}
        The paper uses "linear". "precomputed" takes inner products in place of observations, shape (count, trained):
        this is faster for long signals and several C.
    max_iter : int
        Most iterations of the solver per pair, -1 for no limit.

    Attributes
    ----------
    classes_ : array, shape (M,)
    weights_ : array, shape (M (M - 1) / 2, features)
        Normals of the hyperplanes, in the order of `classifier.dag.pairs`; linear kernel only.
    biases_ : array, shape (M (M - 1) / 2,)
        Linear kernel only.
    machine_ : sklearn.svm.SVC
        The trained machines of all pairs.
    n_iter_ : int
        Largest number of iterations of a pair.
    """

    def __init__(self, C: float = 1.0, kernel: Kernel = "linear", max_iter: int = 200_000) -> None:
        self.C = C
        self.kernel = kernel
        self.max_iter = max_iter

    def __sklearn_tags__(self) -> Any:
        """Return the tags of scikit-learn."""
        tags = super().__sklearn_tags__()
        tags.input_tags.pairwise = self.kernel == "precomputed"
        return tags

    def fit(self, X: Any, y: Any) -> "DagSvm":
        """Train every pair on the observations `X`, shape (count, features), labelled `y`."""
        X, y = validate_data(self, X, y)
        check_classification_targets(y)
        self.classes_, codes = np.unique(y, return_inverse=True)
        if self.classes_.size < 2:
            raise ValueError(f"at least 2 classes are needed: got {self.classes_.size} class")
        machine = SVC(C=self.C, kernel=self.kernel, max_iter=self.max_iter, decision_function_shape="ovo")
        self.machine_ = machine.fit(X, codes)
        if self.kernel == "linear":
            self.weights_ = self._sign * machine.coef_
            self.biases_ = self._sign * machine.intercept_
        self.n_iter_ = int(machine.n_iter_.max())
        return self

    @property
    def _sign(self) -> float:
        """Sign of SVC's margins: positive for the first class of a pair, but with two classes for the second."""
        return -1.0 if self.classes_.size == 2 else 1.0

    def margins(self, X: Any) -> Float64:
        """Return the signed margin of every pair, positive for its first class, shape (count, pairs)."""
        check_is_fitted(self)
        X = validate_data(self, X, reset=False)
        if self.kernel == "linear":
            signed: Float64 = X @ self.weights_.T + self.biases_
        else:
            signed = self._sign * self.machine_.decision_function(X).reshape(len(X), -1)
        return signed

    def predict(self, X: Any) -> npt.NDArray[Any]:
        """Return the label of every observation of `X`, shape (count,)."""
        winners, _ = walked(self.margins(X), self.classes_.size)
        labels: npt.NDArray[Any] = self.classes_[winners]
        return labels
