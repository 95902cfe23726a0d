"""The slope that turns the margins of a DAGSVM into confidences."""

from typing import Final

import numpy as np
import numpy.typing as npt

from classifier.dag import Float64, walked

#: An error is added to the observations, with margins of this quantile.
_PRETENDED_ERROR: Final = 0.05


def confidence_slope(margins: Float64, classes: npt.NDArray[np.str_], names: npt.NDArray[np.str_]) -> float:
    """Fit the slope of confidence against margins by maximum likelihood on a fine grid.

    The added error, with small margins, keeps the slope finite if every observation is right.

    Parameters
    ----------
    margins : array, shape (count, pairs)
        Of observations that were not in the training, see `classifier.dag.walked`.
    classes : array, shape (M,)
    names : array, shape (count,)
        Their labels.
    """
    winners, paths = walked(margins, classes.size)
    right = np.append(classes[winners] == names, False)
    paths = np.vstack([paths, np.quantile(paths, _PRETENDED_ERROR, axis=0)])
    slopes = np.geomspace(0.01, 1000, 300)
    costs = []
    for slope in slopes:
        log_confidence = -np.logaddexp(0, -slope * paths).sum(axis=1)
        log_doubt = np.log(np.maximum(-np.expm1(log_confidence), 1e-300))
        costs.append(-np.where(right, log_confidence, log_doubt).sum())
    return float(slopes[int(np.argmin(costs))])
