"""How good the image in use is, at every millisecond and against the truth of that millisecond."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from evaluation.result import Row
from evaluation.schemes.wire import TICK_NS, Nanoseconds, Sent
from skin.ground_truth import LATENESS_NS
from skin.psnr import decibels
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

#: No image of a 10-bit converter is better: PSNR is not counted above it, or an idle skin's would be infinite.
PSNR_MOST_DB: Final = 71.0


@dataclass(frozen=True, eq=False)
class Images:
    """Whole images, each in use until the next.

    Attributes
    ----------
    ready_ns : array of int64, shape (k,)
        When the last frame of each had come, ascending; `LATENESS_NS` later it is in use, whatever the scheme.
    force_n : array of float32, shape (k, n)
    """

    ready_ns: Nanoseconds
    force_n: Force

    def used(self, times_ns: Nanoseconds) -> npt.NDArray[np.intp]:
        """Return the number of the image in use at each time; -1 before the first."""
        return np.asarray(np.searchsorted(self.ready_ns, times_ns - LATENESS_NS, side="right") - 1)


class ValueRun(NamedTuple):
    """What nodes that send single values sent; each value is in use until the next of its taxel.

    Attributes
    ----------
    sent : Sent
    ready_ns, taxel : arrays of int64, shape (values,)
        In any order.
    force_n : array of float32, shape (values,)
    latency_ns : array of int64
        From the sample to the end of the frame that brings it.
    """

    sent: Sent
    ready_ns: Nanoseconds
    taxel: npt.NDArray[np.int64]
    force_n: Force
    latency_ns: Nanoseconds

    def held(self, ticks: int, taxels: int) -> Images:
        """Return an image for each tick, of the values that have come when it must be ready."""
        ready_ns = np.arange(ticks, dtype=np.int64) * TICK_NS - LATENESS_NS
        order = np.argsort(self.ready_ns, kind="stable")
        until = np.searchsorted(self.ready_ns[order], ready_ns, side="right")
        shown, images, done = np.zeros(taxels, np.float32), np.empty((ticks, taxels), np.float32), 0
        for number, end in enumerate(until.tolist()):
            part = order[done:end]
            shown[self.taxel[part]] = self.force_n[part]
            images[number], done = shown, end
        return Images(ready_ns, images)


def quality(true_n: Force, images: Images) -> Row:
    """Return the figures of what is shown.

    Parameters
    ----------
    true_n : array of float32, shape (ticks, n)
        One tick a millisecond.

    Returns
    -------
    dict
        ``psnr_mean_db`` over all ticks, each at most `PSNR_MOST_DB`; ``touched_error_mn``, root mean square over all
        ticks of the taxels that are touched, None where nothing touches.
    """
    ticks, taxels = true_n.shape
    total, touched, nothing = np.empty(ticks), np.empty(ticks), np.zeros(taxels, np.float32)
    used = images.used(np.arange(ticks, dtype=np.int64) * TICK_NS)
    for tick, (true, number) in enumerate(zip(true_n, used.tolist(), strict=True)):
        error = (images.force_n[number] if number >= 0 else nothing) - true.astype(np.float64)
        square = error * error
        total[tick], touched[tick] = square.sum(), square[true > 0].sum()
    count = np.count_nonzero(true_n > 0)
    return {
        "psnr_mean_db": float(np.minimum(decibels(total / taxels, FORCE_MAX_N), PSNR_MOST_DB).mean()),
        "touched_error_mn": 1e3 * float(np.sqrt(touched.sum() / count)) if count else None,
    }
