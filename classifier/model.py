"""A trained model: arrays, and metadata with the skin that they belong to."""

from dataclasses import dataclass, fields
from typing import Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from skin.surface import Surface
from skin.ways_of_sending import SendingName

Float64 = npt.NDArray[np.float64]
#: "energies" of the smoothed adjoint image (`classifier.features`), or "sums" as in the paper.
Features = Literal["energies", "sums"]

VERSION: Final = 2
#: Text of the model card for touches of `skin.sources.load_touches`.
SIMULATED: Final = "simulated touches at random places, depths and moments"


class TrainingCard(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The model card: data and results of the training.

    Attributes
    ----------
    data : str
        Source of the touches.
    touches, no_touches : int
        Number of labelled touches, and of draws or recorded cycles of the untouched skin; 0: too few were recorded.
    development, validation : int
        Number of touches in each set, the same part of every object. The final model is trained on both sets.
    noise_n : float
        Standard deviation of the taxel noise, clipped to the taxels' range; 0 for recorded touches.
    C : float
        The C with the best accuracy on the validation set; 0 of a classifier of scikit-learn without C.
    validation_accuracy : float or None
        Accuracy on the validation set, with this C and training on the development set; None if none holds.
    per_object : dict
        This accuracy for each object; empty if none holds, as `confusion`.
    confusion : list of list of int
        Number of validation touches by true class (row) and decided class (column), of the same model.
    unknown_ratio : float
        Part of the validation touches beyond all limits, each cycle decided alone.
    cycles : int
        Of recorded touches: number of their cycles. `development`, `validation`, `confusion` and the accuracies count
        cycles; each was decided by a machine that was trained without its touch, or without its recording.
    recordings : list of str
        Names of the recordings; none for simulated touches.
    validated_by : {"", "touch", "recording"}
        What was left out of the training for its validation; empty for simulated touches.
    accuracy_by_touch : float or None
        Accuracy if only the touch is left out; for comparison with that by recording.
    not_validated : dict
        The labels because of which no accuracy holds, and why (`classifier.validation.not_validated`).
    warnings : list of str
        Why the accuracy may be worse on other touches.
    """

    data: str
    touches: int
    no_touches: int
    development: int
    validation: int
    seed: int
    noise_n: float
    C: float
    validation_accuracy: float | None
    per_object: dict[str, float]
    confusion: list[list[int]]
    unknown_ratio: float
    cycles: int = 0
    recordings: list[str] = []
    validated_by: Literal["", "touch", "recording"] = ""
    accuracy_by_touch: float | None = None
    not_validated: dict[str, str] = {}
    warnings: list[str] = []


class Metadata(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The skin of a model, and the constants of its decisions.

    Attributes
    ----------
    fingerprint : str
        Of the Φ of the training.
    newton_per_count : float
        ADC step of the training.
    sending : {"synchronous", "steps"}
        How the skin sends its sums. Of steps those of `classifier.used_sums` are used.
    contact_threshold : float
        Largest standardised peak that still counts as no contact.
    false_alarm_ratio : float
        Part of the cycles of an untouched skin above the threshold.
    unknown_slack : float
        Limits grow by the factor 1 + `unknown_slack` x fraction of missing blocks.
    cycles : int
        Number of cycles over which sums are means (`classifier.newest_sums.NewestSums`).
    surface : str
        `Surface.fingerprint`: where the taxels lie; empty for a grid.
    sum_noise : float
        Variance of a sum that `Model.sum_loadings` do not explain; 0 without loadings.
    """

    version: int
    fingerprint: str
    sums: int
    rows: int
    columns: int
    newton_per_count: float
    features: Features
    classes: list[str]
    contact_threshold: float
    false_alarm_ratio: float
    unknown_slack: float
    sum_noise: float
    card: TrainingCard
    sending: SendingName = "synchronous"
    cycles: int = 1
    surface: str = ""


@dataclass(frozen=True, eq=False)
class Model:
    """A trained classifier, all arrays float64.

    Attributes
    ----------
    surface : Surface
        Of the skin.
    weights : array, shape (pairs, features)
        In the order of `classifier.dag.pairs`, scaled so that the logistic of a margin is its confidence.
    biases : array, shape (pairs,)
    offset, scale : array, shape (features,)
        Subtracted from the features, then multiplied with them.
    no_touch : array, shape (4, widths)
        Untouched skin: mean and standard deviation of the energies, mean and standard deviation of the peaks.
    centres, whitening, limits : array, shapes (regions, 2 widths), (regions, 2 widths, 2 widths), (regions,)
        Regions of the trained objects, see `classifier.novelty.Regions`.
    sum_mean, sum_loadings : array, shapes (m,) and (m, factors)
        Factors of the sums, see `classifier.missing.Factors`; empty unless the features are "sums".
    """

    metadata: Metadata
    surface: Surface
    weights: Float64
    biases: Float64
    offset: Float64
    scale: Float64
    no_touch: Float64
    centres: Float64
    whitening: Float64
    limits: Float64
    sum_mean: Float64
    sum_loadings: Float64


#: Names of the arrays of a model.
ARRAYS: Final = tuple(each.name for each in fields(Model) if each.type is Float64)
