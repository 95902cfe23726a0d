"""A trained model: plain arrays, and the metadata that says which skin they belong to."""

from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]
#: "energies" of the smoothed adjoint image (`classifier.features`), or the "sums" themselves as in the paper.
Features = Literal["energies", "sums"]

VERSION: Final = 1
ARRAYS: Final = ("weights", "biases", "offset", "scale", "no_touch")


class TrainingCard(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a model came about.

    Attributes
    ----------
    touches, no_touches : int
        Labelled observations, and draws of the untouched skin.
    noise_n : float
        Standard deviation of the taxel noise, clipped to the taxels' range.
    C : float
        Chosen by accuracy on the validation set.
    validation_accuracy : float
        Of the development model with that C, on touches it was not trained with.
    per_object : dict
        The same accuracy, object by object.
    """

    touches: int
    no_touches: int
    seed: int
    noise_n: float
    C: float
    validation_accuracy: float
    per_object: dict[str, float]


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
    """

    metadata: Metadata
    weights: Float64
    biases: Float64
    offset: Float64
    scale: Float64
    no_touch: Float64
