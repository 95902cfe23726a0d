"""Models of recorded touches: our own machine, or a linear classifier that a user has made in scikit-learn."""

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import LeaveOneGroupOut, StratifiedKFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC, NuSVC

from canskin.errors import InputError
from classifier.confidence import confidence_slope
from classifier.dag import pairs, walked
from classifier.dagsvm import DagSvm
from classifier.known_regions import KnownRegions, fit_known
from classifier.missing import NO_FACTORS, fit_factors
from classifier.model import Features, Float64, Model, TrainingCard
from classifier.modelfile import save_model
from classifier.novelty import Regions
from classifier.recorded import LabelledTouches
from classifier.samples import draw_missing_counts
from classifier.training import C_GRID, Progress, confused, metadata_of
from classifier.validation import FEW_TOUCHES, global_scale, not_validated
from shell.output import check_output_path

#: Fewer touches of a label are refused.
LEAST_TOUCHES: Final = 3
#: Parts of the touches, of which each is left out of one training.
_FOLDS: Final = 5
#: Part of the decisions of an estimator that its planes must repeat: a vote of pairs (SVC) may differ from the graph.
_LEAST_SAME: Final = 0.98
_EXPECTED: Final = (
    "expected a fitted linear classifier of scikit-learn (LogisticRegression, LinearSVC, SVC with a linear kernel,"
    " LinearDiscriminantAnalysis, ...) or classifier.dagsvm.DagSvm, alone or in a Pipeline after a StandardScaler"
)

Fold = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]


class GlobalScaler(StandardScaler):  # type: ignore[misc]  # scikit-learn is untyped
    """One scale for all features, as the paper's classifier has."""

    def fit(self, X: Any, y: Any = None, sample_weight: Any = None) -> "GlobalScaler":
        """Fit the scale: the root mean square of all values becomes 1."""
        super().fit(X, y, sample_weight)
        width = np.shape(X)[1]
        self.mean_, self.scale_ = np.zeros(width), np.full(width, 1 / global_scale(X))
        return self


class _Planes(NamedTuple):
    """A linear classifier: margins of the pairs of classes are ``((x - offset) * scale) @ weights.T + biases``."""

    classes: npt.NDArray[np.str_]
    offset: Float64
    scale: Float64
    weights: Float64
    biases: Float64

    def margins(self, X: npt.NDArray[Any]) -> Float64:
        margins: Float64 = ((X - self.offset) * self.scale) @ self.weights.T + self.biases
        return margins

    def said(self, margins: Float64) -> npt.NDArray[np.str_]:
        return self.classes[walked(margins, self.classes.size)[0]]


class _Held(NamedTuple):
    """Decisions on cycles that were left out of the training, in the order of `rows`."""

    rows: npt.NDArray[np.intp]
    margins: Float64
    said: npt.NDArray[np.str_]
    accuracy: float


def train_recorded(
    data: LabelledTouches, *, features: Features = "energies", seed: int = 0, progress: Progress | None = None
) -> Model:
    """Train a model of recorded touches: DAGSVM, with C from a grid.

    C is the best in a cross-validation that leaves out whole recordings, where every label is in two recordings or
    more, else whole touches.
    """
    say: Progress = progress or (lambda _doing, _ratio: None)
    data = _checked(data, features)
    X = _input(data, features, seed)
    scaler = GlobalScaler() if features == "sums" else StandardScaler()
    machines = [make_pipeline(clone(scaler), DagSvm(C=C)) for C in C_GRID]
    folds = _strict(data, seed)[1]
    best, held = machines[0], None
    for number, machine in enumerate(machines):
        say(f"C = {C_GRID[number]:g}", number / (len(machines) + 1))
        tried = _cross_validated(machine, X, data.labels, folds)
        if held is None or tried.accuracy > held.accuracy:
            best, held = machine, tried
    say("the final fit", len(machines) / (len(machines) + 1))
    return _model(_fitted(best, X, data.labels), data, X, features, seed)


def export_model(path: str | Path, estimator: Any, data: LabelledTouches, *, seed: int = 0) -> TrainingCard:
    """Write a classifier that was made in scikit-learn as a model for ``skin classify --model``; return its card.

    The file has arrays and JSON, and no code (pickle). For the card, copies of the estimator are trained without each
    recording or touch.

    Parameters
    ----------
    path : path
        Model file, .npz.
    estimator : object
        A fitted linear classifier of two labels or more, or a Pipeline of a StandardScaler and one.
    data : LabelledTouches
        `labelled_touches`; the estimator was fitted on its `energies` or its `sums`, and on its `labels`.
    seed : int
        Of the parts of the cross-validation.
    """
    target = Path(path)
    check_output_path(target, "model", ".npz")
    planes = _planes_of(estimator)
    width = planes.weights.shape[1]
    widths: dict[int, Features] = {data.sums.shape[1]: "sums", data.energies.shape[1]: "energies"}
    if width not in widths:
        expected = " or ".join(f"{count} ({name})" for count, name in widths.items())
        raise InputError(f"the estimator takes {width} features: expected {expected} of these recordings")
    data = _checked(data, widths[width])
    X = np.asarray(data.sums if widths[width] == "sums" else data.energies, np.float64)
    if set(planes.classes) != set(data.labels):
        known, has = ", ".join(planes.classes), ", ".join(np.unique(data.labels))
        raise InputError(f"the estimator knows {known}, the recordings have {has}: fit it on the labels of these")
    model = _model(estimator, data, X, widths[width], seed)
    save_model(model, target)
    return model.metadata.card


def _checked(data: LabelledTouches, features: Features) -> LabelledTouches:
    """Return the cycles that can be used; refuse too few."""
    if features == "sums":
        if data.phi.frames > 1:
            raise InputError("sums whose Φ changes from frame to frame are no features: expected energies")
        data = data.whole()
    counts = _count_of_labels(data, data.touch)
    if len(counts) < 2 or min(counts.values()) < LEAST_TOUCHES:
        told = ", ".join(f"{count} of '{name}'" for name, count in counts.items()) or "none"
        raise InputError(
            f"expected {LEAST_TOUCHES} or more touches of 2 labels or more, got {told}, and {data.unlabelled} without"
            " label: see 'skin label', and record more"
        )
    return data


def _count_of_labels(data: LabelledTouches, groups: npt.NDArray[np.intp]) -> dict[str, int]:
    """Return the number of touches or recordings of each label."""
    return {str(name): np.unique(groups[data.labels == name]).size for name in np.unique(data.labels)}


def _input(data: LabelledTouches, features: Features, seed: int) -> Float64:
    """Return the features of the training; energies include missing blocks, as of simulated touches."""
    if features == "sums":
        return np.asarray(data.sums, np.float64)
    rng, extractor = np.random.default_rng(seed), data.extractor
    return extractor.features(data.sums, draw_missing_counts(len(data.labels), extractor.blocks, rng), rng)


def _by_touch(data: LabelledTouches, parts: int, seed: int) -> list[Fold]:
    """Return folds of whole touches, of each label the same part."""
    touches, first = np.unique(data.touch, return_index=True)
    split = StratifiedKFold(parts, shuffle=True, random_state=seed).split(touches, data.labels[first])
    held = [np.isin(data.touch, touches[left_out]) for _, left_out in split]
    return [(np.flatnonzero(~each), np.flatnonzero(each)) for each in held]


def _strict(data: LabelledTouches, seed: int) -> tuple[Literal["recording", "touch"], list[Fold]]:
    """Return the strictest folds that leave no label without training: by recording, else by touch."""
    if min(_count_of_labels(data, data.recording).values()) > 1:
        return "recording", list(LeaveOneGroupOut().split(data.labels, groups=data.recording))
    return "touch", _touch_folds(data, seed)


def _touch_folds(data: LabelledTouches, seed: int) -> list[Fold]:
    return _by_touch(data, min(_FOLDS, *_count_of_labels(data, data.touch).values()), seed)


def _cross_validated(estimator: Any, X: Float64, labels: npt.NDArray[np.str_], folds: Iterable[Fold]) -> _Held:
    rows, margins, said = [], [], []
    for development, held in folds:
        planes = _planes_of(_fitted(clone(estimator), X[development], labels[development]))
        rows.append(held)
        margins.append(planes.margins(X[held]))
        said.append(planes.said(margins[-1]))
    every, names = np.concatenate(rows), np.concatenate(said)
    return _Held(every, np.concatenate(margins), names, float(np.mean(names == labels[every])))


def _fitted(estimator: Any, X: Float64, labels: npt.NDArray[np.str_]) -> Any:
    with warnings.catch_warnings():
        # Machines that max_iter has stopped are validated like the others.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(X, labels)


def _model(estimator: Any, data: LabelledTouches, X: Float64, features: Features, seed: int) -> Model:
    """Return the model of a fitted estimator, with its cross-validation."""
    planes = _planes_of(estimator)
    same = float(np.mean(planes.said(planes.margins(X)) == np.asarray(estimator.predict(X))))
    if not same >= _LEAST_SAME:
        raise InputError(f"{_name(estimator)} decides otherwise than by its planes in {1 - same:.0%}: {_EXPECTED}")
    kind, folds = _strict(data, seed)
    held = _cross_validated(estimator, X, data.labels, folds)
    lacks = not_validated(_count_of_labels(data, data.touch), _count_of_labels(data, data.recording))
    by_touch = _cross_validated(estimator, X, data.labels, _touch_folds(data, seed)).accuracy if not lacks else None
    known = _known(data, seed)
    factors = fit_factors(X) if features == "sums" else NO_FACTORS
    true = data.labels[held.rows]
    card = TrainingCard(
        data="touches of recordings",
        touches=np.unique(data.touch).size,
        no_touches=data.still,
        development=round(float(np.mean([len(each) for each, _ in folds]))),
        validation=len(held.rows),
        seed=seed,
        noise_n=0.0,
        C=float(getattr(_last(estimator), "C", 0.0)),
        validation_accuracy=held.accuracy if not lacks else None,
        **(confused(np.unique(data.labels), true, held.said) if not lacks else {"per_object": {}, "confusion": []}),
        unknown_ratio=known.unknown_ratio,
        cycles=len(data.labels),
        recordings=list(data.files),
        validated_by=kind,
        accuracy_by_touch=by_touch,
        not_validated=lacks,
        warnings=_warnings(data),
    )
    about = metadata_of(
        data.layout,
        data.phi,
        features=features,
        classes=planes.classes,
        contact_threshold=data.untouched.contact_threshold,
        known=known,
        factors=factors,
        card=card,
    )
    slope = confidence_slope(held.margins, planes.classes, true)
    learnt = planes.weights * slope, planes.biases * slope, planes.offset, planes.scale, data.untouched.no_touch
    return Model(about, data.layout.taxels.surface, *learnt, *known.regions, factors.mean, factors.loadings)


def _known(data: LabelledTouches, seed: int) -> KnownRegions:
    """Return the regions of one half of the touches, with limits of the other; none of too few touches."""
    if min(_count_of_labels(data, data.touch).values()) < FEW_TOUCHES:
        width = data.energies.shape[1]
        return KnownRegions(Regions(np.zeros((0, width)), np.zeros((0, width, width)), np.zeros(0)), 0.0, 0.0)
    half = _by_touch(data, 2, seed)[0]
    return fit_known(data.sums, data.labels, half, data.extractor, np.random.default_rng(seed))


def _warnings(data: LabelledTouches) -> list[str]:
    """Return why the accuracy may be worse on other touches."""
    told = []
    counts = _count_of_labels(data, data.touch)
    few = [f"'{name}' {count}" for name, count in counts.items() if count < FEW_TOUCHES]
    if few:
        told.append(
            f"fewer than {FEW_TOUCHES} touches: {', '.join(few)}; no accuracy or unknown object is told: record more"
        )
    if alone := [name for name, count in _count_of_labels(data, data.recording).items() if count < 2]:
        told.append(
            f"in one recording only: {', '.join(map(repr, alone))}; a difference of recordings may pass for one of"
            " objects, so no accuracy is told: record them again, another day"
        )
    if data.unlabelled:
        told.append(f"{data.unlabelled} touches have no label and are not used: see 'skin label'")
    if not data.still:
        told.append("too few cycles of the untouched skin: its noise is simulated; record some seconds without touch")
    return told


def _planes_of(estimator: Any) -> _Planes:
    """Return the planes of a fitted linear classifier."""
    steps: Sequence[tuple[str, Any]] = estimator.steps if isinstance(estimator, Pipeline) else [("", estimator)]
    last, before = steps[-1][1], [step for _, step in steps[:-1] if step not in {None, "passthrough"}]
    if not all(isinstance(step, StandardScaler) for step in before):
        raise InputError(f"a Pipeline with {', '.join(map(_name, before))}: {_EXPECTED}")
    try:
        classes, weights, biases = _pairs_of(last)
        offset, scale = np.zeros(weights.shape[1]), np.ones(weights.shape[1])
        for step in before:
            mean = 0.0 if step.mean_ is None or not step.with_mean else step.mean_
            own = 1.0 if step.scale_ is None else 1.0 / step.scale_
            offset, scale = offset + mean / scale, scale * own
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{_name(last)}: {_EXPECTED}") from error
    if not all(isinstance(name, str) and name for name in classes.tolist()):
        raise InputError(f"classes {classes.tolist()}: expected names, the labels of the recordings")
    arrays = offset, scale, weights, biases
    if not all(np.isfinite(each).all() for each in arrays):
        raise InputError(f"{_name(last)}: its coefficients are not finite")
    return _Planes(classes.astype(np.str_), *(np.asarray(each, np.float64) for each in arrays))


def _pairs_of(machine: Any) -> tuple[npt.NDArray[Any], Float64, Float64]:
    """Return the classes of a fitted machine, and a plane for each pair, positive for the first class of the pair."""
    if isinstance(machine, DagSvm):
        return machine.classes_, machine.weights_, machine.biases_
    coefficients = machine.coef_.toarray() if hasattr(machine.coef_, "toarray") else np.asarray(machine.coef_)
    classes, biases = np.asarray(machine.classes_), np.ravel(machine.intercept_)
    biases = np.broadcast_to(biases, len(coefficients))
    count = classes.size
    if coefficients.ndim != 2 or count < 2:
        raise ValueError
    if count == 2 and len(coefficients) == 1:  # positive for the second class
        return classes, -coefficients, -biases
    if isinstance(machine, SVC | NuSVC):
        return classes, coefficients, biases
    if len(coefficients) != count:
        raise ValueError
    first, second = np.array(pairs(count)).T
    return classes, coefficients[first] - coefficients[second], biases[first] - biases[second]


def _last(estimator: Any) -> Any:
    return estimator.steps[-1][1] if isinstance(estimator, Pipeline) else estimator


def _name(estimator: Any) -> str:
    return type(estimator).__name__
