"""Sampling instants on the wall clock, for programs that read images: only measurements tell both clocks."""

from bisect import bisect_right
from collections.abc import Iterable
from operator import attrgetter
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.messages import MEASUREMENT, Topic
from recording.mcap_file import read_messages, wall_offset_ns

#: Times on the wall clock end here, in 2038: ROS 2 has int32 seconds.
END_NS: Final = 2**31 * 1_000_000_000
#: Measurements whose clocks a running program keeps: an image is at most some cycles older than the newest measurement.
_KEPT: Final = 64


class Clocks(msgspec.Struct, frozen=True):
    """The clocks of a `canskin.messages.Measurement`, without its sums; no offset from a gateway that tells none."""

    sampled_mono_ns: int
    wall_offset_ns: int | None = None
    cycle: int = 0


#: The clocks of every measurement.
CLOCKS: Final = Topic(MEASUREMENT.name, Clocks)


class WallTimes:
    """The wall clock by the clocks of the measurements: a wall clock may be set during a run.

    Parameters
    ----------
    first_offset_ns : int, optional
        Wall clock minus monotonic clock before the first measurement that tells its own; default: not known. The clocks
        of this machine tell nothing of those of the gateway's.
    kept : int
        Number of measurements whose clocks are kept.
    """

    def __init__(self, first_offset_ns: int | None = None, kept: int = _KEPT) -> None:
        self._first_offset_ns, self._kept = first_offset_ns, kept
        #: Sampling instants and offsets.
        self._clocks: list[tuple[int, int]] = []

    def take(self, clocks: Clocks) -> None:
        """Use the clocks of a measurement."""
        if clocks.wall_offset_ns is None:
            return
        if self._clocks and clocks.sampled_mono_ns < self._clocks[-1][0]:
            self._clocks.clear()  # the gateway's machine has started again, or is another
        self._clocks.append((clocks.sampled_mono_ns, clocks.wall_offset_ns))
        del self._clocks[: -self._kept]

    def time_ns(self, sampled_mono_ns: int) -> int | None:
        """Return a sampling instant on the wall clock, by the newest measurement that is not later.

        None if no offset is known, or if the instant is before 1970 or after `END_NS`.
        """
        offset_ns = self._first_offset_ns
        if self._clocks:
            later = bisect_right(self._clocks, sampled_mono_ns, key=lambda each: each[0])
            offset_ns = self._clocks[max(later - 1, 0)][1]
        if offset_ns is None or not 0 <= sampled_mono_ns + offset_ns < END_NS:
            return None
        return sampled_mono_ns + offset_ns

    def times_ns(self, sampled_mono_ns: Iterable[int]) -> npt.NDArray[np.int64]:
        """Return sampling instants on the wall clock as `time_ns` does; -1 in place of None."""
        found = map(self.time_ns, sampled_mono_ns)
        return np.array([-1 if time_ns is None else time_ns for time_ns in found], np.int64)


def recorded_wall_times(path: Path) -> WallTimes:
    """Return the wall clock of a recorded run: a sampling instant has the same time in every export."""
    found = (read.message for read in read_messages(path, (CLOCKS,), lambda _: None))
    clocks = sorted(found, key=attrgetter("sampled_mono_ns"))
    wall = WallTimes(wall_offset_ns(path), kept=max(1, len(clocks)))
    for each in clocks:
        wall.take(Clocks(each.sampled_mono_ns, each.wall_offset_ns or None))
    return wall


def nearest(
    times_ns: npt.NDArray[np.int64], wanted_ns: npt.NDArray[np.int64], within_ns: float
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Return for each wanted time the place of the nearest of one or more ascending times, and whether that is near."""
    after = np.searchsorted(times_ns, wanted_ns).clip(max=len(times_ns) - 1)
    before = (after - 1).clip(min=0)
    place = np.where(wanted_ns - times_ns[before] <= times_ns[after] - wanted_ns, before, after)
    return place, np.abs(times_ns[place] - wanted_ns) < within_ns
