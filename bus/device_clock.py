"""The clock of a CAN controller, followed by the kernel's time stamps of the same frames.

A kernel stamps a frame in the interrupt after its end: late by the latency of the interrupt. A controller stamps by its
own clock, without that latency. The start of that clock, its rate and the bit that is stamped depend on the device. For
frames of one kind

    kernel stamp - device stamp = offset + drift + latency, latency >= least latency.

The line below these differences is offset, drift and least latency. So a device stamp on this line is the end of the
frame plus the least latency: the jitter is gone. The tests use computed stamps; no interface with such a clock was at
hand.
"""

from collections import deque
from typing import Final, NamedTuple

import numpy as np

#: Length of a bucket of time, and number of buckets of which the least difference is kept.
BUCKET_NS: Final = 1_000_000_000
BUCKETS: Final = 16
#: Buckets before the line is used.
LEAST_BUCKETS: Final = 3
#: After a longer pause the line is not used: nothing told how the clocks drifted.
PAUSE_NS: Final = 2 * BUCKET_NS
#: A device stamp at this distance from the line: the device's clock began anew, or the wall clock was set.
JUMP_NS: Final = 100_000_000


class _Least(NamedTuple):
    """The least difference of a bucket."""

    device_ns: int
    difference_ns: int


class DeviceClock:
    """Turns the device stamps of one kind of frames into times on the clock of the kernel stamps.

    Attributes
    ----------
    error_ns : int
        Largest distance of a bucket's least difference from the line; 0 while there is no line.
    """

    def __init__(self) -> None:
        self.error_ns = self._bucket = 0
        self._buckets: deque[_Least] = deque(maxlen=BUCKETS)
        self._least: _Least | None = None
        #: Origin, slope and difference at the origin.
        self._line: tuple[int, float, float] | None = None

    def take(self, device_ns: int, kernel_ns: int) -> int:
        """Use the two stamps of a frame; return the time of the device stamp, at most `kernel_ns`."""
        difference_ns = kernel_ns - device_ns
        last = self._least
        if last is not None and (
            not -BUCKET_NS < device_ns - last.device_ns <= PAUSE_NS or abs(difference_ns - last.difference_ns) > JUMP_NS
        ):
            self._begin_anew()
        bucket = device_ns // BUCKET_NS
        if self._least is None or bucket != self._bucket:
            self._close()
            self._bucket, self._least = bucket, _Least(device_ns, difference_ns)
        elif difference_ns < self._least.difference_ns:
            self._least = _Least(device_ns, difference_ns)
        if self._line is None:
            return kernel_ns
        origin_ns, slope, first_ns = self._line
        return min(kernel_ns, device_ns + round(first_ns + slope * (device_ns - origin_ns)))

    def _begin_anew(self) -> None:
        self.error_ns = 0
        self._buckets.clear()
        self._least = self._line = None

    def _close(self) -> None:
        """End a bucket, and lay the line below all of them: least squares, moved down to the lowest."""
        if self._least is None:
            return
        self._buckets.append(self._least)
        if len(self._buckets) < LEAST_BUCKETS:
            return
        origin_ns, base_ns = self._buckets[0]
        device = np.array([each.device_ns - origin_ns for each in self._buckets], np.float64)
        difference = np.array([each.difference_ns - base_ns for each in self._buckets], np.float64)
        slope, first_ns = np.polyfit(device, difference, 1)
        above = difference - (first_ns + slope * device)
        self.error_ns = round(float(above.max() - above.min()))
        self._line = origin_ns, float(slope), float(base_ns + first_ns + above.min())
