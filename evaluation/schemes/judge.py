"""How good the image in use is, at every millisecond and against the truth of that millisecond."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from evaluation.result import Row
from evaluation.schemes.wire import TICK_NS
from skin.psnr import decibels
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

#: No image of a 10-bit converter is better: PSNR is not counted above it, or an idle skin's would be infinite.
PSNR_MOST_DB: Final = 71.0
#: A taxel that is off by more shows something that is not there: four times the sensor noise.
WRONG_N: Final = 0.004


@dataclass(frozen=True, eq=False)
class Images:
    """Whole images, each in use until the next.

    Attributes
    ----------
    ready_ns : array of int64, shape (k,)
        From when on, ascending.
    force_n : array of float32, shape (k, n)
    """

    ready_ns: npt.NDArray[np.int64]
    force_n: Force

    def judged(self, true_n: Force) -> npt.NDArray[np.float64]:
        """Compare with the truth, shape (ticks, n); see `_judge_images`."""
        ticks = np.arange(len(true_n), dtype=np.int64) * TICK_NS
        used = np.searchsorted(self.ready_ns, ticks, side="right") - 1
        found: npt.NDArray[np.float64] = _judge_images(true_n, self.force_n, used, WRONG_N)
        return found


@dataclass(frozen=True, eq=False)
class Updates:
    """Single taxels that arrive, each shown until its next value.

    Attributes
    ----------
    ready_ns, taxel : arrays of int64, shape (k,)
        In any order.
    force_n : array of float32, shape (k,)
    """

    ready_ns: npt.NDArray[np.int64]
    taxel: npt.NDArray[np.int64]
    force_n: Force

    def judged(self, true_n: Force) -> npt.NDArray[np.float64]:
        """Compare with the truth, shape (ticks, n); see `_judge_images`."""
        order = np.argsort(self.ready_ns, kind="stable")
        ticks = -(-self.ready_ns[order] // TICK_NS)
        found: npt.NDArray[np.float64] = _judge_updates(true_n, ticks, self.taxel[order], self.force_n[order], WRONG_N)
        return found

    def kept(self, places: npt.NDArray[np.bool_]) -> "Updates":
        """Return the updates at `places`, shape (k,)."""
        return Updates(self.ready_ns[places], self.taxel[places], self.force_n[places])

    def held(self, ready_ns: npt.NDArray[np.int64], taxels: int) -> Images:
        """Return the images that are shown at `ready_ns`, ascending."""
        order = np.argsort(self.ready_ns, kind="stable")
        until = np.searchsorted(self.ready_ns[order], ready_ns, side="right")
        shown, images, done = np.zeros(taxels, np.float32), np.empty((len(ready_ns), taxels), np.float32), 0
        for number, end in enumerate(until.tolist()):
            part = order[done:end]
            shown[self.taxel[part]] = self.force_n[part]
            images[number], done = shown, end
        return Images(ready_ns, images)


def quality(true_n: Force, shown: Images | Updates) -> Row:
    """Return the figures of what is shown.

    Parameters
    ----------
    true_n : array of float32, shape (ticks, n)
        One tick a millisecond.
    shown : Images or Updates

    Returns
    -------
    dict
        ``psnr_mean_db``, ``psnr_least_db`` and ``psnr_peak_db`` over all ticks, at most `PSNR_MOST_DB`; ``error_mn``
        and ``touched_error_mn``, root mean square over all ticks of all taxels and of those that are touched;
        ``longest_wrong_ms``, for how long any one taxel was off by more than `WRONG_N`.
    """
    total, touched, count, wrong = shown.judged(true_n).T
    psnr_db = np.minimum(decibels(total / true_n.shape[1], FORCE_MAX_N), PSNR_MOST_DB)
    return {
        "psnr_mean_db": float(psnr_db.mean()),
        "psnr_least_db": float(psnr_db.min()),
        "psnr_peak_db": float(psnr_db.max()),
        "error_mn": 1e3 * float(np.sqrt(total.mean() / true_n.shape[1])),
        "touched_error_mn": 1e3 * float(np.sqrt(touched.sum() / count.sum())) if count.any() else None,
        "longest_wrong_ms": int(wrong.max()),
    }


@njit(cache=True, nogil=True)
def _judge_images(true: Any, images: Any, used: Any, limit: float) -> Any:
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
def _judge_updates(true: Any, ticks: Any, taxels: Any, values: Any, limit: float) -> Any:
    """Compare an image whose taxels are replaced one by one with the truth, see `_judge_images`.

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
