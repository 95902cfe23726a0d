"""What is in use at every millisecond against the truth, compiled."""

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def judge_images(true: Any, images: Any, used: Any, limit: float) -> Any:
    """Compare images that are held until the next with the truth.

    Parameters
    ----------
    true : array of float32, shape (ticks, n)
    images : array of float32, shape (k, n)
    used : array of int, shape (ticks,)
        Number of the image in use at each tick; -1: none yet, all zeros.
    limit : float
        An error above it is a wrong taxel.

    Returns
    -------
    array of float64, shape (ticks, 4)
        Squared error over all taxels and over those that are touched, how many are touched, and the ticks for which
        the longest wrong taxel has now been wrong.
    """
    found = np.zeros((true.shape[0], 4))
    wrong, shown = np.zeros(true.shape[1], np.int64), np.zeros(true.shape[1], np.float32)
    for tick in range(true.shape[0]):
        _look(true[tick], images[used[tick]] if used[tick] >= 0 else shown, limit, wrong, found[tick])
    return found


@njit(cache=True, nogil=True)
def judge_updates(true: Any, ticks: Any, taxels: Any, values: Any, limit: float) -> Any:
    """Compare an image whose taxels are replaced one by one with the truth, see `judge_images`.

    Parameters
    ----------
    true : array of float32, shape (ticks, n)
    ticks, taxels : arrays of int, shape (updates,)
        From which tick on each value is in use, ascending, and where.
    values : array of float32, shape (updates,)
    limit : float
    """
    found = np.zeros((true.shape[0], 4))
    wrong, shown = np.zeros(true.shape[1], np.int64), np.zeros(true.shape[1], np.float32)
    done = 0
    for tick in range(true.shape[0]):
        while done < ticks.size and ticks[done] <= tick:
            shown[taxels[done]] = values[done]
            done += 1
        _look(true[tick], shown, limit, wrong, found[tick])
    return found


@njit(cache=True, nogil=True)
def _look(true: Any, shown: Any, limit: float, wrong: Any, found: Any) -> None:
    total, touched, count, longest = 0.0, 0.0, 0, 0
    for taxel in range(true.size):
        error = float(shown[taxel]) - float(true[taxel])
        total += error * error
        if true[taxel] > 0:
            touched += error * error
            count += 1
        wrong[taxel] = wrong[taxel] + 1 if abs(error) > limit else 0
        longest = max(longest, wrong[taxel])
    found[0], found[1], found[2], found[3] = total, touched, count, longest
