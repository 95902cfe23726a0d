"""What measurements carry of the zero: offsets, which sums are usable, and which taxels are doubtful."""

import msgspec
import numpy as np
import numpy.typing as npt

from calibration.followed import FollowedZero
from calibration.windows import Bools, Floats
from canskin.messages import Measurement
from skin.layout import Layout


class Corrections:
    """What a window has changed of them.

    Attributes
    ----------
    unaccepted : array of bool, shape (n,)
        Taxels that are doubtful whatever stands on them.
    unaccepted_ns : int
        Since when there are such taxels; 0 without any.
    """

    def __init__(self, layout: Layout) -> None:
        self._is_own = not layout.sends.boards_keep_zero
        self._newton_per_count = layout.taxels.newton_per_count
        self.unaccepted, self.unaccepted_ns = np.zeros(layout.taxels.count, np.bool_), 0
        #: Packed for measurements: doubtful taxels; offsets of steps, which change in some windows only.
        self._doubtful = self._offsets = b""

    def doubt(self, taxels: Bools, time_ns: int) -> None:
        """Doubt some taxels, shape (n,), from `time_ns` to the next call."""
        self.unaccepted, self.unaccepted_ns = taxels, (self.unaccepted_ns or time_ns) if taxels.any() else 0

    def take(self, followed: FollowedZero | None, *, tares: bool) -> None:
        """Pack what a window has changed; without a zero that is to be measured, all taxels are doubtful."""
        doubtful = self.unaccepted | (tares if followed is None else followed.doubt.taxels)
        self._doubtful = np.packbits(doubtful).tobytes() if doubtful.any() else b""
        if followed is not None and not self._is_own:
            offsets = self._counts(followed.zero.follower.level_n)
            self._offsets = offsets.tobytes() if offsets.any() else b""

    def apply(self, measurement: Measurement, followed: FollowedZero | None, usable: Bools) -> Measurement:
        """Return a measurement with its corrections; `usable`, shape (m,), is False for defective sums."""
        offsets, used = self._offsets, usable
        if followed is not None and self._is_own:
            offsets = self._counts(followed.offsets_at_n(measurement.sampled_mono_ns)).tobytes()
            used = usable & followed.zero.follower.known
        if measurement.usable:
            used = used & (np.frombuffer(measurement.usable, np.uint8) != 0)
        return msgspec.structs.replace(
            measurement,
            offsets=offsets,
            usable=b"" if used.all() else used.astype(np.uint8).tobytes(),
            doubtful=self._doubtful,
        )

    def _counts(self, offsets_n: Floats) -> npt.NDArray[np.int32]:
        return np.rint(offsets_n / self._newton_per_count).astype("<i4")
