"""What the application 'canskin' offers to programs, where it is installed in their environment."""

from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final

from canskin.errors import InputError
from canskin.skin import Skin

#: Groups of the application's entry points.
SIMULATION: Final = "canskin.simulation"
TRAINING: Final = "canskin.training"


def simulate(layout: str | None = None, *, objects: list[str] | None = None, seed: int = 0) -> Skin:
    """Return a simulated skin in this process, without any service: for notebooks and tests.

    Each step of the iteration computes the next cycle, as fast as the machine can; `Skin.latest` computes one, too.

    Parameters
    ----------
    layout : str, optional
        File of a skin's layout, or the name of a shipped one; without it the default skin.
    objects : list of str, optional
        Names of the objects that touch the skin, see ``skin touch objects``; default: a series of five.
    seed : int
        Of touches and noise.

    Raises
    ------
    InputError
        If the application is not installed here.
    """
    make = _from_application(SIMULATION, "simulate", ", or run 'skin demo' and use canskin.connect()")
    skin: Skin = make(layout, objects=objects, seed=seed)
    return skin


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
    return _from_application(TRAINING, "labelled_touches")(recordings)


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
    return _from_application(TRAINING, "export_model")(path, estimator, data, seed=seed)


def _from_application(group: str, name: str, otherwise: str = "") -> Any:
    """Return the function of an entry point of the application; `otherwise` is what else a user can do."""
    found = list(entry_points(group=group, name=name))
    if not found:
        raise InputError(
            f"canskin.{name}() needs the application 'canskin', and this environment has the client only: install"
            f" the application here{otherwise}"
        )
    return found[0].load()
