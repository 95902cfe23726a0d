"""From labelled true forces to a model: DAGSVM with C from a grid, chosen on a validation set."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import UNKNOWN_OBJECT
from classifier.confidence import confidence_slope
from classifier.features import Float32
from classifier.known_regions import KnownRegions, fit_known
from classifier.missing import NO_FACTORS, Factors, fit_factors
from classifier.model import VERSION, Features, Float64, Metadata, Model, TrainingCard
from classifier.modelfile import skin_of
from classifier.samples import (
    FALSE_ALARM_RATIO,
    FeatureExtractor,
    draw_missing_counts,
    draw_noise_levels,
    observe_untouched,
    simulate_means,
)
from classifier.used_sums import classified_phi
from classifier.validation import Chosen, choose_C, global_scale
from skin.layout import Layout
from skin.phi import Phi, Sbhe
from skin.taxel import NOISE_N

#: C is chosen from these.
C_GRID: Final = (0.1, 1.0, 10.0, 100.0)
#: Part of the touches in the validation set.
VALIDATION_RATIO: Final = 0.25
_LEAST_TOUCHES: Final = 8
#: Regions are fitted with noise of this part of `noise_n` or more. So trained objects are still named on a skin with
#: less noise, but fewer unknown objects are found.
_QUIET_RATIO: Final = 0.8

#: Called with the name of the step and the finished part of the training, 0 to 1.
Progress = Callable[[str, float], None]


class TrainingOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of the training.

    Attributes
    ----------
    features : {"energies", "sums"}
        "sums" is the paper's classifier: sums with one global scale.
    noise_n : float
        Standard deviation of the taxel noise in newtons.
    no_touches : int
        Number of draws of the untouched skin for the contact threshold.
    data : str
        Source of the touches, for the model card.
    """

    features: Features = "energies"
    noise_n: float = NOISE_N
    seed: int = 0
    no_touches: int = 5000
    C_grid: tuple[float, ...] = C_GRID
    data: str = "given images"


class _Split(NamedTuple):
    development: npt.NDArray[np.intp]
    validation: npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class _Training:
    """Common inputs of the steps of a training."""

    options: TrainingOptions
    layout: Layout
    phi: Phi
    names: npt.NDArray[np.str_]
    split: _Split
    extractor: FeatureExtractor
    rng: np.random.Generator

    def sums(self, force_n: Float32, noise_n: float | Float64) -> npt.NDArray[np.int32]:
        """Return the sums of true forces with noise, as the classifier averages them."""
        return simulate_means(force_n, self.layout, self.phi, noise_n, self.rng)


def train(
    force_n: Float32,
    labels: Sequence[str] | npt.NDArray[np.str_],
    layout: Layout,
    *,
    options: TrainingOptions | None = None,
    progress: Progress | None = None,
) -> Model:
    """Train a model for the skin of `layout` on labelled true forces of 2 objects or more, 8 touches of each or more.

    Parameters
    ----------
    force_n : array of float32, shape (count, rows, columns)
        True forces in newtons; noise is added here.
    labels : sequence of str, shape (count,)
        Name of the touching object.
    """
    options = options or TrainingOptions()
    say: Progress = progress or (lambda _doing, _ratio: None)
    names = np.asarray(labels, np.str_)
    _check(force_n, names, layout, options)
    phi = classified_phi(layout)
    if options.features == "sums" and phi.frames > 1:
        raise InputError("sums whose Φ changes from frame to frame are no features: expected energies")
    if isinstance(phi, Sbhe) and not phi.row_of_sum.any():
        raise InputError(
            f"all {phi.shape[0]} rows of this layout are row 0, the sum of a block, which shows no contact: "
            "choose more rows, or others"
        )
    rng = np.random.default_rng(options.seed)
    say("the untouched skin", 0.0)
    untouched = observe_untouched(layout, phi, options.noise_n, options.no_touches, rng)
    say("the touches", 0.2)
    extractor = FeatureExtractor(layout, phi, untouched.no_touch)
    training = _Training(options, layout, phi, names, _split(names, rng), extractor, rng)
    plain = training.sums(force_n, options.noise_n)
    features, factors = _features(training, force_n, plain)
    offset, scale = _standard(features, options.features, training.split)
    standard = (features - offset) * scale
    chosen = choose_C(
        standard,
        names,
        *training.split,
        C_grid=options.C_grid,
        progress=lambda doing, part: say(doing, 0.5 + 0.4 * part),
    )
    say("what is known", 0.9)
    quieter = training.sums(force_n, draw_noise_levels(len(names), options.noise_n, _QUIET_RATIO, rng))
    known = fit_known(quieter, names, training.split, extractor, rng)
    held = training.split.validation
    margins = chosen.development_machine.margins(standard[held])
    slope = confidence_slope(margins, chosen.development_machine.classes_, names[held])
    about = metadata_of(
        layout,
        phi,
        features=options.features,
        classes=chosen.machine.classes_,
        contact_threshold=untouched.contact_threshold,
        known=known,
        factors=factors,
        card=_card(training, chosen, standard, known),
    )
    planes = chosen.machine.weights_ * slope, chosen.machine.biases_ * slope
    learnt = *planes, offset, scale, untouched.no_touch, *known.regions, factors.mean, factors.loadings
    return Model(about, layout.taxels.surface, *learnt)


def metadata_of(
    layout: Layout,
    phi: Phi,
    *,
    features: Features,
    classes: npt.NDArray[np.str_],
    contact_threshold: float,
    known: KnownRegions,
    factors: Factors,
    card: TrainingCard,
) -> Metadata:
    """Return the metadata of a model of a skin."""
    return Metadata(
        version=VERSION,
        **skin_of(layout, phi),
        features=features,
        classes=[str(name) for name in classes],
        contact_threshold=contact_threshold,
        false_alarm_ratio=FALSE_ALARM_RATIO,
        unknown_slack=known.slack,
        sum_noise=factors.noise,
        card=card,
    )


def _features(training: _Training, force_n: Float32, plain: npt.NDArray[np.int32]) -> tuple[Float64, Factors]:
    """Return the features for training and, for the features "sums", the factors of the sums.

    Sums have the same noise in all touches, as in the paper. Energies include lower noise and missing blocks.
    """
    if training.options.features == "sums":
        raw = plain.astype(np.float64)
        return raw, fit_factors(raw[training.split.development])
    count, rng = len(force_n), training.rng
    sums = training.sums(force_n, draw_noise_levels(count, training.options.noise_n, 0.0, rng))
    features = training.extractor.features(sums, draw_missing_counts(count, training.extractor.blocks, rng), rng)
    return features, NO_FACTORS


def _card(training: _Training, chosen: Chosen, standard: Float64, known: KnownRegions) -> TrainingCard:
    options, held, classes = training.options, training.split.validation, chosen.development_machine.classes_
    true, said = training.names[held], chosen.development_machine.predict(standard[held])
    return TrainingCard(
        data=options.data,
        touches=len(training.names),
        no_touches=options.no_touches,
        development=len(training.split.development),
        validation=len(held),
        seed=options.seed,
        noise_n=options.noise_n,
        C=chosen.C,
        validation_accuracy=chosen.accuracy,
        **confused(classes, true, said),
        unknown_ratio=known.unknown_ratio,
    )


def confused(classes: npt.NDArray[np.str_], true: npt.NDArray[np.str_], said: npt.NDArray[np.str_]) -> dict[str, Any]:
    """Return `per_object` and `confusion` of a `TrainingCard`; `classes` are in the order of the alphabet."""
    confusion = np.zeros((classes.size, classes.size), np.int64)
    np.add.at(confusion, (np.searchsorted(classes, true), np.searchsorted(classes, said)), 1)
    ratios = confusion.diagonal() / confusion.sum(axis=1)
    per_object = {str(name): float(part) for name, part in zip(classes, ratios, strict=True)}
    return {"per_object": per_object, "confusion": confusion.tolist()}


def _check(force_n: Float32, names: npt.NDArray[np.str_], layout: Layout, options: TrainingOptions) -> None:
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
    if UNKNOWN_OBJECT in objects:
        raise InputError(f"no object can be called '{UNKNOWN_OBJECT}': the classifier gives unknown objects this label")
    if not 0 < options.noise_n < layout.taxels.force_max_n:
        raise InputError(f"expected noise above 0 and below {layout.taxels.force_max_n} N, got {options.noise_n} N")
    if not options.C_grid or min(options.C_grid) <= 0:
        raise InputError(f"expected one C or more, each above 0, got {options.C_grid}")
    if options.no_touches < 2:
        raise InputError(f"expected 2 or more draws of the untouched skin, got {options.no_touches}")


def _standard(features: Float64, kind: Features, split: _Split) -> tuple[Float64, Float64]:
    """Return offset and scale: one global scale for sums, one scale per feature for energies."""
    if kind == "sums":
        scale = global_scale(features[split.development])
        return np.zeros(features.shape[1]), np.full(features.shape[1], scale)
    return features.mean(axis=0), 1 / np.maximum(features.std(axis=0), 1e-9)


def _split(names: npt.NDArray[np.str_], rng: np.random.Generator) -> _Split:
    """Draw the validation set, the same part of every object."""
    held = np.zeros(len(names), np.bool_)
    for name in np.unique(names):
        where = rng.permutation(np.flatnonzero(names == name))
        held[where[: max(1, round(VALIDATION_RATIO * where.size))]] = True
    return _Split(np.flatnonzero(~held), np.flatnonzero(held))
