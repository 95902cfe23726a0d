"""Training of `classifier.novelty`: a Gaussian mixture for each object, limits from touches it was not fitted to."""

import warnings
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from classifier.novelty import Float64, Regions, nearest, novelty
from classifier.samples import MOST_LOST_RATIO, Watcher

#: Regions per object, from hardly touching to pressed in fully.
REGIONS_PER_OBJECT: Final = 4
#: With fewer observations a region's covariance means little: the object gets fewer regions.
LEAST_PER_REGION: Final = 60
#: A region's limit is this multiple of the distance that most known touches keep, a quantile that does not hang on a
#: handful of touches, and no less than nearly all of them keep.
_MOST: Final = 0.8
_MULTIPLE: Final = 1.4
_NEARLY_ALL: Final = 0.98
#: Quantile of the novelty that must stay what it is when blocks are missing.
_RARE: Final = 0.95
#: A dead block stays dead, and what it does to one touch does not average out over its cycles as noise does: the limits
#: widen by this multiple of what single cycles need.
_LASTING: Final = 2.0
#: Added to the variances, in parts of the variance of each feature over all touches.
_FLOOR: Final = 1e-2
_LEAST_FOR_LIMIT: Final = 10
_STARTS: Final = 2


class Known(NamedTuple):
    """What a model knows.

    Attributes
    ----------
    regions : Regions
    slack : float
        The limits widen by this factor times the part of the blocks that is missing.
    unknown_ratio : float
        Part of the validation touches beyond the limits, without missing blocks.
    """

    regions: Regions
    slack: float
    unknown_ratio: float


def know(
    sums: npt.NDArray[np.int32],
    names: npt.NDArray[np.str_],
    split: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]],
    watcher: Watcher,
    rng: np.random.Generator,
) -> Known:
    """Fit regions to the development touches, and their limits to the validation touches.

    Parameters
    ----------
    sums : array of int32, shape (count, m)
        Of touches as the skin feels them, with its noise.
    names : array, shape (count,)
    split : (array of int, array of int)
        Development and validation: rows of `sums`.
    watcher : Watcher
        Makes features of sums.
    """
    development, validation = split
    whole = np.zeros(len(sums), np.intp)
    features = watcher.features(sums, whole, rng)
    unseen = features[validation]
    regions = fit_regions(features[development], names[development], unseen, int(rng.integers(2**31)))
    if not regions.limits.size:
        return Known(regions, 0.0, 0.0)
    lost = int(watcher.blocks * MOST_LOST_RATIO)
    spoilt = watcher.features(sums[validation], np.full(len(validation), lost), rng)
    ratio = watcher.blocks / lost if lost else 0.0
    without, with_loss = (np.array([novelty(one, regions) for one in seen]) for seen in (unseen, spoilt))
    wider = float(np.quantile(with_loss, _RARE) / np.quantile(without, _RARE)) - 1
    return Known(regions, _LASTING * max(0.0, wider) * ratio, float(np.mean(without > 1)))


def fit_regions(features: Float64, names: npt.NDArray[np.str_], unseen: Float64, seed: int) -> Regions:
    """Fit the regions of every object.

    Parameters
    ----------
    features : array, shape (count, features)
        Observations of known objects.
    names : array, shape (count,)
        Of their objects. With fewer than `LEAST_PER_REGION` of any, no region is made at all: too little is known to
        call anything new.
    unseen : array, shape (other count, features)
        Observations of other touches of the same objects, for the limits.
    seed : int
        Of where the fits start.
    """
    width = features.shape[1]
    objects, counts = np.unique(names, return_counts=True)
    if counts.min() < LEAST_PER_REGION or not len(unseen):
        return Regions(np.zeros((0, width)), np.zeros((0, width, width)), np.zeros(0))
    offset, spread = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-9)
    centres, whitening = [], []
    for name in objects:
        mixture = _mixture((features[names == name] - offset) / spread, seed)
        centres.append(mixture.means_ * spread + offset)
        # precisions_cholesky_ is upper triangular: |Pᵀ (x - centre)| is the distance.
        whitening.append(mixture.precisions_cholesky_.transpose(0, 2, 1) / spread)
    everywhere = np.concatenate(centres), np.ascontiguousarray(np.concatenate(whitening))
    return Regions(*everywhere, _limits(unseen, *everywhere))


def _mixture(standard: Float64, seed: int) -> GaussianMixture:
    regions = min(REGIONS_PER_OBJECT, len(standard) // LEAST_PER_REGION)
    mixture = GaussianMixture(regions, reg_covar=_FLOOR, random_state=seed, n_init=_STARTS)
    with warnings.catch_warnings():
        # Regions that still move a little are as good: their limits are measured.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return mixture.fit(standard)


def _limits(unseen: Float64, centres: Float64, whitening: Float64) -> Float64:
    """Return each region's limit; a region that hardly any touch comes to gets that of all together."""
    near = [nearest(one, centres, whitening) for one in unseen]
    regions, distances = np.array([region for region, _ in near]), np.array([distance for _, distance in near])
    limits = np.full(len(centres), _limit(distances))
    for region in range(len(centres)):
        own = distances[regions == region]
        if own.size >= _LEAST_FOR_LIMIT:
            limits[region] = _limit(own)
    limited: Float64 = np.maximum(limits, 1e-9)
    return limited


def _limit(distances: Float64) -> float:
    return max(_MULTIPLE * float(np.quantile(distances, _MOST)), float(np.quantile(distances, _NEARLY_ALL)))
