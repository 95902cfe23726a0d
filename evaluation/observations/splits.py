"""Splits of the observations by perturbation: all objects of a perturbation are in the same part (section VI-B)."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from evaluation.observations.signals import OBJECTS
from touch.classification_poses import PERTURBATIONS

Indices = npt.NDArray[np.intp]


class Split(NamedTuple):
    """Rows of a signal in each part."""

    development: Indices
    validation: Indices
    test: Indices

    @property
    def training(self) -> Indices:
        """Development and validation set together."""
        return np.concatenate([self.development, self.validation])


def draw_split(number: int, development: float, validation: float, seed: int = 0) -> Split:
    """Return split number `number`: parts of the perturbations, at least one in each, drawn uniformly.

    Parameters
    ----------
    development, validation : float
        Ratios of the 360 perturbations; what is left is the test set.
    """
    first = max(1, round(development * PERTURBATIONS))
    second = first + max(1, round(validation * PERTURBATIONS))
    drawn = np.random.default_rng([seed, number]).permutation(PERTURBATIONS)
    return Split(*(rows_of(part) for part in (drawn[:first], drawn[first:second], drawn[second:])))


def rows_of(perturbations: Indices) -> Indices:
    """Return the rows of all objects of the given perturbations."""
    objects = np.arange(OBJECTS)[:, None] * PERTURBATIONS
    return (objects + np.sort(perturbations)).ravel()
