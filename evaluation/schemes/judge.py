"""How good the image in use is, at every millisecond and against the truth of that millisecond."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from evaluation.result import Row
from evaluation.schemes.board import Board
from evaluation.schemes.wire import TICK_NS, Nanoseconds, Sent
from skin.ground_truth import LATENESS_NS
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
        When the last frame of each had come, ascending; `LATENESS_NS` later it is in use, whatever the scheme.
    force_n : array of float32, shape (k, n)
    """

    ready_ns: npt.NDArray[np.int64]
    force_n: Force

    def used(self, times_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
        """Return the number of the image in use at each time; -1 before the first."""
        return np.asarray(np.searchsorted(self.ready_ns, times_ns - LATENESS_NS, side="right") - 1)


@dataclass(frozen=True, eq=False)
class Updates:
    """Single taxels that arrive, each in use until its next value.

    Attributes
    ----------
    ready_ns, taxel : arrays of int64, shape (k,)
        In any order.
    force_n : array of float32, shape (k,)
    """

    ready_ns: npt.NDArray[np.int64]
    taxel: npt.NDArray[np.int64]
    force_n: Force

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


@dataclass(frozen=True, eq=False)
class ValueRun:
    """What nodes that send single values sent.

    Attributes
    ----------
    sent : Sent
    updates : Updates
        Of shape (values,).
    frame_of : array of int, shape (values,)
        The frame that brought the last bit of each update.
    latency_ns : array of int64
        From the sample to the end of the frame that brings it.
    """

    sent: Sent
    updates: Updates
    frame_of: npt.NDArray[np.int64]
    latency_ns: Nanoseconds

    def received(self, board: Board) -> Updates:
        """Return the updates whose frames reach the receiver."""
        return self.updates.kept(board.arrives(len(self.sent.frames))[self.frame_of])


def moments_ns(ticks: int) -> npt.NDArray[np.int64]:
    """Return when the image must be ready that is in use at each tick."""
    return np.arange(ticks, dtype=np.int64) * TICK_NS - LATENESS_NS


def quality(true_n: Force, shown: Images | Updates) -> Row:
    """Return the figures of what is shown.

    Parameters
    ----------
    true_n : array of float32, shape (ticks, n)
        One tick a millisecond.

    Returns
    -------
    dict
        ``psnr_mean_db``, ``psnr_least_db`` and ``psnr_peak_db`` over all ticks, at most `PSNR_MOST_DB`; ``error_mn``
        and ``touched_error_mn``, root mean square over all ticks of all taxels and of those that are touched;
        ``longest_wrong_ms``, for how long any one taxel was off by more than `WRONG_N`.
    """
    ticks, taxels = true_n.shape
    times_ns = np.arange(ticks, dtype=np.int64) * TICK_NS
    images = shown.held(moments_ns(ticks), taxels) if isinstance(shown, Updates) else shown
    total, touched = np.empty(ticks), np.empty(ticks)
    wrong_ms, longest_wrong_ms, nothing = np.zeros(taxels, np.int64), 0, np.zeros(taxels, np.float32)
    for tick, (true, used) in enumerate(zip(true_n, images.used(times_ns).tolist(), strict=True)):
        error = (images.force_n[used] if used >= 0 else nothing) - true.astype(np.float64)
        square = error * error
        total[tick], touched[tick] = square.sum(), square[true > 0].sum()
        wrong_ms = (wrong_ms + 1) * (np.abs(error) > WRONG_N)
        longest_wrong_ms = max(longest_wrong_ms, int(wrong_ms.max()))
    psnr_db = np.minimum(decibels(total / taxels, FORCE_MAX_N), PSNR_MOST_DB)
    count = np.count_nonzero(true_n > 0)
    return {
        "psnr_mean_db": float(psnr_db.mean()),
        "psnr_least_db": float(psnr_db.min()),
        "psnr_peak_db": float(psnr_db.max()),
        "error_mn": 1e3 * float(np.sqrt(total.mean() / taxels)),
        "touched_error_mn": 1e3 * float(np.sqrt(touched.sum() / count)) if count else None,
        "longest_wrong_ms": longest_wrong_ms,
    }
