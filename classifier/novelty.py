"""How far an observation lies from everything the model was trained on.

Each known object is a few regions of the feature space, each a centre and a covariance: an object pressed in fully,
half, hardly. An observation belongs to the nearest region by its Mahalanobis distance; the region's own limit says
which distances known objects reach there.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]


class Regions(NamedTuple):
    """What known touches look like; without any region nothing is ever new.

    Attributes
    ----------
    centres : array, shape (regions, features)
    whitening : array, shape (regions, features, features)
        W of each region: ``|W (features - centre)|`` is the Mahalanobis distance.
    limits : array, shape (regions,)
        Distances that known touches pass only in rare cases.
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


#: ``nearest(features, centres, whitening)``: the nearest region, -1 without any, and the distance to it.
nearest: Callable[[Float64, Float64, Float64], tuple[int, float]] = numba.njit(cache=True)(_nearest)


def novelty(features: Float64, regions: Regions) -> float:
    """Return the distance to the nearest region in parts of its limit: above 1 nothing known looks like this."""
    region, distance = nearest(features, regions.centres, regions.whitening)
    return distance / float(regions.limits[region]) if region >= 0 else 0.0
