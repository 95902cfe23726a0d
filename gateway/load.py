"""Load of a bus: time of its frames (exact stuffing) / time that passed."""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.stuff_bits import time_of_all_ns
from skin.layout import Bus

#: A load of less time says nothing: the sums of one SYNC come together.
LEAST_S: Final = 0.1


class LoadMeter:
    """Measures the load of one bus, since the last `take_ratio` and since SYNC started.

    Parameters
    ----------
    wires : Bus
        Bit rates.
    busy_ns : array of int64, shape (1,)
        Counts the time of frames; compiled code (`gateway.turn`) may add to it, too.
    """

    def __init__(self, wires: Bus, now_s: float, busy_ns: npt.NDArray[np.int64]) -> None:
        self._rates = wires.bitrate, wires.data_bitrate or wires.bitrate
        self._busy_ns, self._told_ns = busy_ns, 0
        self._since_s = self._start_s = now_s

    def take(self, rows: npt.NDArray[np.uint8]) -> None:
        """Add frames of the bus, the gateway's own included; see `gateway.batch.Batch`."""
        self._busy_ns[0] += time_of_all_ns(rows, *self._rates)

    def restart(self, now_s: float) -> None:
        """Clear the load and count from `now_s`, the start of SYNC."""
        self._busy_ns[0] = self._told_ns = 0
        self._since_s = self._start_s = now_s

    def take_ratio(self, now_s: float) -> float:
        """Return the load since the last call, and begin anew; 0 if that is less than `LEAST_S` ago."""
        if now_s - self._since_s < LEAST_S:
            return 0.0
        busy_ns = int(self._busy_ns[0])
        load_ratio = _ratio(busy_ns - self._told_ns, now_s - self._since_s)
        self._told_ns, self._since_s = busy_ns, now_s
        return load_ratio

    def mean_ratio(self, now_s: float) -> float:
        """Return the load since `restart`."""
        return _ratio(int(self._busy_ns[0]), now_s - self._start_s)


def _ratio(busy_ns: int, elapsed_s: float) -> float:
    return busy_ns * 1e-9 / elapsed_s if elapsed_s > 0 else 0.0
