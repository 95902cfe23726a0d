"""From labelled true images to a model: DAGSVMs with C from a grid, chosen on a validation set."""

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning

from classifier.dag import DecisionGraph
from classifier.dagsvm import DagSvm
from classifier.features import Float32
from classifier.model import VERSION, Features, Float64, Metadata, Model, TrainingCard
from classifier.samples import FALSE_ALARM_RATIO, NOISE_N, Untouched, observe_touches, observe_untouched
from skin.errors import InputError
from skin.layout import Layout
from skin.measurement import Sbhe

C_GRID: Final = (0.1, 1.0, 10.0, 100.0)
#: Part of the touches kept for validation.
VALIDATION_RATIO: Final = 0.25
#: Quantile of the margins at which one error is pretended.
_PRETENDED_ERROR: Final = 0.05
_LEAST_TOUCHES: Final = 8

#: Told what is being done and how much of everything is done, 0 to 1.
Progress = Callable[[str, float], None]


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """How to train.

    Attributes
    ----------
    features : {"energies", "sums"}
        "sums" is the paper's classifier: raw sums with one global scale.
    noise_n : float
        Standard deviation of the taxel noise in newtons.
    no_touches : int
        Draws of the untouched skin for the contact threshold.
    """

    features: Features = "energies"
    noise_n: float = NOISE_N
    seed: int = 0
    no_touches: int = 5000
    C_grid: tuple[float, ...] = C_GRID


class _Fit(NamedTuple):
    machine: DagSvm
    C: float
    accuracy: float
    per_object: dict[str, float]
    slope: float


def train(
    force_n: Float32,
    labels: Sequence[str] | npt.NDArray[np.str_],
    layout: Layout,
    *,
    plan: Plan | None = None,
    progress: Progress | None = None,
) -> Model:
    """Train a model for the skin of `layout` on labelled true images.

    Parameters
    ----------
    force_n : array of float32, shape (count, rows, columns)
        True forces in newtons; noise is added here.
    labels : sequence of str, shape (count,)
        Name of the touching object.
    plan : Plan, optional
    progress : callable, optional

    Raises
    ------
    InputError
        If the arrays do not fit the skin or each other, or hold fewer than 2 objects with 8 touches each.
    """
    plan = plan or Plan()
    say: Progress = progress or (lambda _doing, _ratio: None)
    names = np.asarray(labels, np.str_)
    _check(force_n, names, layout, plan)
    phi = layout.phi()
    rng = np.random.default_rng(plan.seed)
    say("the untouched skin", 0.0)
    untouched = observe_untouched(layout, phi, plan.noise_n, plan.no_touches, rng)
    say("the touches", 0.3)
    features = observe_touches(
        force_n, layout, phi, kind=plan.features, no_touch=untouched.no_touch, noise_n=plan.noise_n, rng=rng
    )
    offset, scale = _standard(features, plan.features)
    fit = _fit((features - offset) * scale, names, plan, rng, say)
    planes = fit.machine.weights_ * fit.slope, fit.machine.biases_ * fit.slope
    about = _metadata(layout, phi, plan, untouched, fit, touches=len(names))
    return Model(about, *planes, offset, scale, untouched.no_touch)


def _metadata(layout: Layout, phi: Sbhe, plan: Plan, untouched: Untouched, fit: _Fit, *, touches: int) -> Metadata:
    card = TrainingCard(
        touches=touches,
        no_touches=plan.no_touches,
        seed=plan.seed,
        noise_n=plan.noise_n,
        C=fit.C,
        validation_accuracy=fit.accuracy,
        per_object=fit.per_object,
    )
    return Metadata(
        version=VERSION,
        fingerprint=phi.fingerprint,
        sums=phi.shape[0],
        rows=layout.taxels.rows,
        columns=layout.taxels.columns,
        newton_per_count=layout.taxels.newton_per_count,
        features=plan.features,
        classes=[str(name) for name in fit.machine.classes_],
        contact_threshold=untouched.contact_threshold,
        false_alarm_ratio=FALSE_ALARM_RATIO,
        card=card,
    )


def _check(force_n: Float32, names: npt.NDArray[np.str_], layout: Layout, plan: Plan) -> None:
    shape = (len(names), layout.taxels.rows, layout.taxels.columns)
    if force_n.shape != shape:
        raise InputError(f"expected images of shape {shape}, one per label: got {force_n.shape}")
    if not np.isfinite(force_n).all():
        raise InputError("the images hold values that are not finite: every taxel needs a force in newtons")
    objects, counts = np.unique(names, return_counts=True)
    if objects.size < 2 or counts.min() < _LEAST_TOUCHES:
        raise InputError(
            f"expected 2 or more objects with {_LEAST_TOUCHES} or more touches each, got {objects.size} objects"
            f" and {len(names)} touches: name more objects or ask for more touches"
        )
    if "" in objects:
        raise InputError("an object's name is empty: every touch needs one")
    if not 0 < plan.noise_n < layout.taxels.force_max_n or not plan.C_grid or plan.no_touches < 2:
        raise InputError(f"expected noise between 0 and {layout.taxels.force_max_n} N and a C: got {plan}")


def _standard(features: Float64, kind: Features) -> tuple[Float64, Float64]:
    """Return offset and scale: one global scale for raw sums, each feature its own otherwise."""
    if kind == "sums":
        rms = math.sqrt(float(np.square(features).mean())) or 1.0
        return np.zeros(features.shape[1]), np.full(features.shape[1], 1 / rms)
    return features.mean(axis=0), 1 / np.maximum(features.std(axis=0), 1e-9)


def _fit(features: Float64, names: npt.NDArray[np.str_], plan: Plan, rng: np.random.Generator, say: Progress) -> _Fit:
    """Choose C on a validation set, then train again on everything."""
    held = _held_out(names, rng)
    best: _Fit | None = None
    for step, C in enumerate(plan.C_grid):
        say(f"C = {C:g}", 0.5 + 0.4 * step / len(plan.C_grid))
        machine = _fitted(DagSvm(C), features[~held], names[~held])
        right = machine.predict(features[held]) == names[held]
        if best is None or right.mean() > best.accuracy:
            per_object = {str(name): float(right[names[held] == name].mean()) for name in machine.classes_}
            slope = _slope(machine, features[held], names[held])
            best = _Fit(machine, C, float(right.mean()), per_object, slope)
    if best is None:
        raise InputError("expected at least one C to try")
    say("the final fit", 0.9)
    return best._replace(machine=_fitted(DagSvm(best.C), features, names))


def _fitted(machine: DagSvm, features: Float64, names: npt.NDArray[np.str_]) -> DagSvm:
    with warnings.catch_warnings():
        # A pair cut short by max_iter is still judged on the validation set, like any other.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return machine.fit(features, names)


def _held_out(names: npt.NDArray[np.str_], rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Choose the validation set, the same part of every object."""
    held = np.zeros(len(names), np.bool_)
    for name in np.unique(names):
        where = rng.permutation(np.flatnonzero(names == name))
        held[where[: max(1, round(VALIDATION_RATIO * where.size))]] = True
    return held


def _slope(machine: DagSvm, features: Float64, names: npt.NDArray[np.str_]) -> float:
    """Fit how fast confidence grows with the margins, by likelihood of right and wrong on a fine grid.

    One pretended error where margins are small keeps the slope finite when no observation errs.
    """
    graph = DecisionGraph(machine.classes_.size)
    margins = machine.margins(features)
    paths = np.array([[margin for _, margin in graph.walk(row)] for row in margins])
    right = np.append(machine.predict(features) == names, False)
    paths = np.vstack([paths, np.quantile(paths, _PRETENDED_ERROR, axis=0)])
    slopes = np.geomspace(0.01, 1000, 300)
    costs = []
    for slope in slopes:
        log_confidence = -np.logaddexp(0, -slope * paths).sum(axis=1)
        log_doubt = np.log(np.maximum(-np.expm1(log_confidence), 1e-300))
        costs.append(-np.where(right, log_confidence, log_doubt).sum())
    return float(slopes[int(np.argmin(costs))])
