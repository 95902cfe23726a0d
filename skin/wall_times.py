"""Sampling instants on the wall clock, for programs that read images: only measurements tell both clocks."""

from bisect import bisect_right
from collections.abc import Callable
from typing import Final

import msgspec

from canskin.messages import MEASUREMENT, Topic
from skin.clock import wall_offset

#: Measurements whose clocks a running program keeps: an image is at most some cycles older than the newest measurement.
_KEPT: Final = 64


class Clocks(msgspec.Struct, frozen=True):
    """The clocks of a `canskin.messages.Measurement`, without its sums."""

    sampled_mono_ns: int
    wall_offset_ns: int = 0


#: The clocks of every measurement.
CLOCKS: Final = Topic(MEASUREMENT.name, Clocks)


class WallTimes:
    """The wall clock by the clocks of the measurements: a wall clock may be set during a run.

    Parameters
    ----------
    fallback_ns : callable
        Wall clock minus CLOCK_MONOTONIC before the first measurement that tells its own; default: of this machine.
    kept : int
        Number of measurements whose clocks are kept.
    """

    def __init__(self, fallback_ns: Callable[[], int] = lambda: wall_offset().ns, kept: int = _KEPT) -> None:
        self._fallback_ns, self._kept = fallback_ns, kept
        self._clocks: list[Clocks] = []

    def take(self, clocks: Clocks) -> None:
        """Use the clocks of a measurement."""
        if not clocks.wall_offset_ns:
            return
        if self._clocks and clocks.sampled_mono_ns < self._clocks[-1].sampled_mono_ns:
            self._clocks.clear()  # the gateway's machine has started again, or is another
        self._clocks.append(clocks)
        del self._clocks[: -self._kept]

    def time_ns(self, sampled_mono_ns: int) -> int:
        """Return a sampling instant on the wall clock, by the newest measurement that is not later."""
        if not self._clocks:
            return sampled_mono_ns + self._fallback_ns()
        later = bisect_right(self._clocks, sampled_mono_ns, key=lambda each: each.sampled_mono_ns)
        return sampled_mono_ns + self._clocks[max(later - 1, 0)].wall_offset_ns
