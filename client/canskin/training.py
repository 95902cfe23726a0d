"""Classifiers of real touches that a program trains itself, where the application is installed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from canskin.application import from_application

#: Group of the application's entry points.
GROUP: Final = "canskin.training"


def labelled_touches(recordings: str | Path | Sequence[str | Path]) -> Any:
    """Return the labelled touches of recordings of one skin, as arrays for scikit-learn.

    Parameters
    ----------
    recordings : path or sequence of paths
        Recordings (.mcap) whose touches have labels (``skin record --label``, ``skin label``), or folders of them.

    Returns
    -------
    classifier.recorded.LabelledTouches
        For each cycle ``energies``, shape (count, features), ``sums``, shape (count, m), ``labels``, and the groups of
        a cross-validation, ``touch`` and ``recording``.

    Raises
    ------
    InputError
        If the application is not installed here, or a recording cannot be used.
    """
    return from_application(GROUP, "labelled_touches")(recordings)


def export_model(path: str | Path, estimator: Any, data: Any, *, seed: int = 0) -> Any:
    """Write a linear classifier of scikit-learn as a model for ``skin classify --model``: arrays and JSON, no pickle.

    Parameters
    ----------
    path : path
        Model file, .npz.
    estimator : object
        Fitted on ``data.energies`` or ``data.sums`` and on ``data.labels``: LogisticRegression, LinearSVC, SVC with a
        linear kernel, LinearDiscriminantAnalysis or another linear classifier, alone or in a Pipeline after a
        StandardScaler.
    data : classifier.recorded.LabelledTouches
        Of `labelled_touches`.
    seed : int
        Of the parts of the cross-validation.

    Returns
    -------
    classifier.model.TrainingCard
        The model card, with the cross-validation of copies of the estimator.

    Raises
    ------
    InputError
        If the application is not installed here, or the estimator is not linear or was fitted on other features.
    ModelError
        If the file cannot be written.
    """
    return from_application(GROUP, "export_model")(path, estimator, data, seed=seed)
