"""A trained model: plain arrays, and the metadata that says which skin they belong to."""

from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]
#: "energies" of the smoothed adjoint image (`classifier.features`), or the "sums" themselves as in the paper.
Features = Literal["energies", "sums"]

VERSION: Final = 2
#: What the model card says of the touches of `skin.sources.load_touches`.
SIMULATED: Final = "simulated touches at random places, depths and moments"
ARRAYS: Final = (
    "weights",
    "biases",
    "offset",
    "scale",
    "no_touch",
    "centres",
    "whitening",
    "limits",
    "sum_mean",
    "sum_loadings",
)


class TrainingCard(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a model came about: the model card.

    Attributes
    ----------
    data : str
        Where the touches came from.
    touches, no_touches : int
        Labelled observations, and draws of the untouched skin.
    development, validation : int
        How the touches were split, the same part of every object. The final model was trained on both.
    noise_n : float
        Standard deviation of the taxel noise, clipped to the taxels' range.
    C : float
        Chosen by accuracy on the validation set.
    validation_accuracy : float
        Of the development model with that C, on touches it was not trained with.
    per_object : dict
        The same accuracy, object by object.
    confusion : list of list of int
        Validation touches of each class (row) by the class said (column), of the same model.
    unknown_ratio : float
        Part of the validation touches, each cycle for itself, that look like no known object.
    """

    data: str
    touches: int
    no_touches: int
    development: int
    validation: int
    seed: int
    noise_n: float
    C: float
    validation_accuracy: float
    per_object: dict[str, float]
    confusion: list[list[int]]
    unknown_ratio: float


class Metadata(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a model belongs to, and the numbers its decisions need.

    Attributes
    ----------
    fingerprint : str
        Of the Φ it was trained for.
    newton_per_count : float
        ADC step it was trained for.
    contact_threshold : float
        Largest standardised peak that still counts as no contact.
    false_alarm_ratio : float
        Part of the cycles of an untouched skin above that threshold.
    unknown_slack : float
        The limits of what is known widen by this factor times the part of the blocks that is missing.
    sum_noise : float
        Variance of a sum that `Model.sum_loadings` do not explain; 0 where there are none.
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


@dataclass(frozen=True, eq=False)
class Model:
    """A trained classifier, all arrays float64.

    Attributes
    ----------
    weights : array, shape (pairs, features)
        In the order of `classifier.dag.pairs`, scaled so that the logistic of a margin is its confidence.
    biases : array, shape (pairs,)
    offset, scale : array, shape (features,)
        Subtracted from the features, then multiplied with them.
    no_touch : array, shape (4, widths)
        Of the untouched skin: mean and deviation of the energies, mean and deviation of the peaks.
    centres, whitening, limits : array, shapes (regions, 2 widths), (regions, 2 widths, 2 widths), (regions,)
        What known objects look like, see `classifier.novelty.Regions`.
    sum_mean, sum_loadings : array, shapes (m,) and (m, factors)
        How sums vary together, see `classifier.missing.Factors`; without entries unless the features are "sums".
    """

    metadata: Metadata
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
