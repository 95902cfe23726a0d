"""Novelty: the distance of an observation from all training data.

Each trained object has some regions in the feature space, each with a centre and a covariance, for example pressed in
fully, half, hardly. An observation belongs to the nearest region by Mahalanobis distance. Each region has its own limit
of this distance.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shell.compiled import njit

Float64 = npt.NDArray[np.float64]


class Regions(NamedTuple):
    """Regions of the trained touches; without regions the novelty is 0.

    Attributes
    ----------
    centres : array, shape (regions, features)
    whitening : array, shape (regions, features, features)
        W of each region: ``|W (features - centre)|`` is the Mahalanobis distance.
    limits : array, shape (regions,)
        Distances that trained touches rarely exceed.
    """

    centres: Float64
    whitening: Float64
    limits: Float64


def _nearest(features: Float64, centres: Float64, whitening: Float64) -> tuple[int, float]:
    best, least = -1, math.inf
    for region in range(centres.shape[0]):
        squared = 0.0
        for row in range(features.size):
            part = 0.0
            for column in range(features.size):
                part += whitening[region, row, column] * (features[column] - centres[region, column])
            squared += part * part
            if squared >= least:
                break
        if squared < least:
            best, least = region, squared
    return best, math.sqrt(least)


#: ``nearest(features, centres, whitening)``: the nearest region, -1 without regions, and its distance.
nearest: Callable[[Float64, Float64, Float64], tuple[int, float]] = njit(cache=True)(_nearest)


def novelty(features: Float64, regions: Regions) -> float:
    """Return distance to the nearest region / limit of this region; above 1: unlike all trained touches."""
    region, distance = nearest(features, regions.centres, regions.whitening)
    return distance / float(regions.limits[region]) if region >= 0 else 0.0
