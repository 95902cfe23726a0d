"""Selection of the Hadamard rows to send, so that few sums separate the objects.

Blocks and permutation of the SBHE stay; only the kept rows are selected, one after the other. For Gaussian classes with
the mean covariance of a pair, two objects at Mahalanobis distance d are confused with a probability below exp(-d² / 8)
(the Bhattacharyya bound). The next row is the row with the smallest sum of these bounds over all pairs.
"""

from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from classifier.dag import pairs
from classifier.samples import simulate_means
from skin.layout import Layout, changed, require_sending, validated
from skin.phi import Sbhe

#: A row counts as noise if the selected rows leave less than this part of its variance unexplained, or if its variance
#: is below this part of the mean variance.
_LEAST_REST: Final = 1e-3


def choose_rows(phi: Sbhe, sums: npt.NDArray[Any], labels: npt.NDArray[Any], count: int) -> Sbhe:
    """Return `phi` with the `count` rows that separate the labelled observations best; raise InputError for too few.

    Parameters
    ----------
    phi : Sbhe
        Its kept rows are the candidates.
    sums : array, shape (observations, m)
        Measured with `phi`; at least 2 observations per label.
    labels : array, shape (observations,)
    count : int
        Number of rows to keep; memory and time grow with its square: 0.5 GB and a minute for 256 of 4096.
    """
    if sums.shape != (len(labels), phi.shape[0]):
        raise InputError(f"expected sums of shape {(len(labels), phi.shape[0])}, got {sums.shape}")
    if not 0 < count <= phi.shape[0]:
        raise InputError(f"expected 1 to {phi.shape[0]} rows to keep, got {count}")
    classes, sizes = np.unique(labels, return_counts=True)
    if classes.size < 2 or sizes.min() < 2:
        raise InputError("expected 2 or more labels with 2 or more observations each")
    chosen = _chosen([np.asarray(sums[labels == name], np.float32) for name in classes], count)
    kept = np.zeros_like(phi.kept)
    kept[phi.block_of_sum[chosen], phi.row_of_sum[chosen]] = True
    return replace(phi, kept=kept)


def with_chosen_rows(
    layout: Layout,
    force_n: npt.NDArray[np.float32],
    labels: npt.NDArray[np.str_],
    count: int,
    *,
    noise_n: float,
    seed: int = 0,
) -> Layout:
    """Return the layout, not of steps, with the `count` rows of Φ that separate labelled touches best.

    Parameters
    ----------
    layout : Layout
        All rows of its blocks are candidates.
    force_n : array, shape (touches, rows, columns)
        True forces in newtons.
    labels : array, shape (touches,)
    noise_n : float
        Standard deviation of the taxel noise.
    seed : int
        Of the noise.
    """
    require_sending(layout, "synchronous", "a choice of rows is", "stepped nodes send every row")
    drawn = layout.phi()
    every = replace(drawn, kept=np.ones_like(drawn.kept))
    sums = simulate_means(force_n, layout, every, noise_n, np.random.default_rng(seed))
    chosen = choose_rows(every, sums, labels, count)
    rows = tuple(zip(chosen.block_of_sum.tolist(), chosen.row_of_sum.tolist(), strict=True))
    return validated(changed(layout, measurement={"sums": count, "rows": rows, "selection": "balanced"}))


def _chosen(observed: list[npt.NDArray[np.float32]], count: int) -> list[int]:
    """Return the selected columns; each selected column is projected out of all, per pair (Gram-Schmidt)."""
    first, second = np.array(pairs(len(observed))).T
    means = np.stack([one.mean(axis=0, dtype=np.float64) for one in observed])
    centred = [one - mean.astype(np.float32) for one, mean in zip(observed, means, strict=True)]
    variances = np.stack([np.square(one).sum(axis=0, dtype=np.float64) / (len(one) - 1) for one in centred])
    apart = means[first] - means[second]
    rest = (variances[first] + variances[second]) / 2
    # A constant row has no information; without noise its information would appear infinite.
    whole = np.maximum(rest, _LEAST_REST * rest.mean(axis=1, keepdims=True) + np.finfo(np.float32).tiny)
    squared, chosen = np.zeros(first.size), list[int]()
    explained = np.empty((count, *apart.shape), np.float32)
    for step in range(count):
        usable = np.maximum(rest, _LEAST_REST * whole)
        bounds = np.exp(-(squared[:, None] + np.square(apart) / usable) / 8).sum(axis=0)
        bounds[chosen] = np.inf
        best = int(np.argmin(bounds))
        chosen.append(best)
        squared += apart[:, best] ** 2 / usable[:, best]
        shared = np.stack([one[:, best] @ one / (len(one) - 1) for one in centred])
        before = explained[:step]
        part = (shared[first] + shared[second]) / 2 - np.einsum("kp,kpr->pr", before[:, :, best], before)
        # With few observations the remaining variance is rounding error: the explained variance is limited to it.
        left = np.sqrt(rest)
        part = np.clip(part / np.sqrt(usable[:, best, None]), -left, left)
        apart = apart - part * (apart[:, best] / np.sqrt(usable[:, best]))[:, None]
        rest = np.maximum(rest - np.square(part), 0)
        explained[step] = part
    return chosen
