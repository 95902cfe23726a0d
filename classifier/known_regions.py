"""Training of `classifier.novelty`: a Gaussian mixture per object, limits from validation touches."""

import warnings
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from classifier.novelty import Float64, Regions, nearest, novelty
from classifier.samples import MOST_LOST_RATIO, FeatureExtractor

#: Most regions per object.
REGIONS_PER_OBJECT: Final = 4
#: Fewest observations per region for a useful covariance; with less data an object has fewer regions.
LEAST_PER_REGION: Final = 60
#: The limit of a region is max(1.4 q80, q98). q80 and q98 are quantiles of the distances of validation touches.
#: Outliers do not change q80; q98 keeps 98 % of the validation touches within the limit.
_LIMIT_QUANTILE: Final = 0.8
_LIMIT_MULTIPLE: Final = 1.4
_LEAST_LIMIT_QUANTILE: Final = 0.98
#: With the slack, this quantile of the novelty is the same with and without missing blocks.
_SLACK_QUANTILE: Final = 0.95
#: Factor of the slack of single cycles: the effect of a dead block does not average out over cycles, unlike noise.
_SLACK_MULTIPLE: Final = 2.0
#: Regularisation: added to the variance of each feature, relative to its variance over all touches.
_REGULARISATION: Final = 1e-2
_LEAST_FOR_LIMIT: Final = 10
_STARTS: Final = 2


class KnownRegions(NamedTuple):
    """Regions and limits of the trained objects.

    Attributes
    ----------
    regions : Regions
    slack : float
        Limits grow by the factor 1 + `slack` x fraction of missing blocks.
    unknown_ratio : float
        Part of the validation touches beyond the limits, without missing blocks.
    """

    regions: Regions
    slack: float
    unknown_ratio: float


def fit_known(
    sums: npt.NDArray[Any],
    names: npt.NDArray[np.str_],
    split: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]],
    extractor: FeatureExtractor,
    rng: np.random.Generator,
) -> KnownRegions:
    """Fit regions to the development touches, and their limits to the validation touches.

    Parameters
    ----------
    sums : array of int32 or float32, shape (count, m)
        Sums of touches, with noise.
    names : array, shape (count,)
    split : (array of int, array of int)
        Development and validation: rows of `sums`.
    extractor : FeatureExtractor
        Computes the features of sums.
    """
    development, validation = split
    whole = np.zeros(len(sums), np.intp)
    features = extractor.features(sums, whole, rng)
    unseen = features[validation]
    regions = fit_regions(features[development], names[development], unseen, int(rng.integers(2**31)))
    if not regions.limits.size:
        return KnownRegions(regions, 0.0, 0.0)
    lost = int(extractor.blocks * MOST_LOST_RATIO)
    spoilt = extractor.features(sums[validation], np.full(len(validation), lost), rng, validation)
    ratio = extractor.blocks / lost if lost else 0.0
    without, with_loss = (np.array([novelty(one, regions) for one in seen]) for seen in (unseen, spoilt))
    wider = float(np.quantile(with_loss, _SLACK_QUANTILE) / np.quantile(without, _SLACK_QUANTILE)) - 1
    return KnownRegions(regions, _SLACK_MULTIPLE * max(0.0, wider) * ratio, float(np.mean(without > 1)))


def fit_regions(features: Float64, names: npt.NDArray[np.str_], unseen: Float64, seed: int) -> Regions:
    """Fit the regions of every object.

    Parameters
    ----------
    features : array, shape (count, features)
        Observations of the trained objects.
    names : array, shape (count,)
        Their objects. If any object has fewer than `LEAST_PER_REGION` observations, no region is made, and the
        classifier reports no unknown objects.
    unseen : array, shape (other count, features)
        Observations of other touches of the same objects, for the limits.
    seed : int
        Of the starts of the fits.
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
    mixture = GaussianMixture(regions, reg_covar=_REGULARISATION, random_state=seed, n_init=_STARTS)
    with warnings.catch_warnings():
        # Convergence is not needed, because the limits are measured afterwards.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return mixture.fit(standard)


def _limits(unseen: Float64, centres: Float64, whitening: Float64) -> Float64:
    """Return each region's limit; a region with fewer than `_LEAST_FOR_LIMIT` touches gets the limit of all touches."""
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
    return max(
        _LIMIT_MULTIPLE * float(np.quantile(distances, _LIMIT_QUANTILE)),
        float(np.quantile(distances, _LEAST_LIMIT_QUANTILE)),
    )
