"""Load of a bus: time of its frames (exact stuffing) / time that passed."""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.frame import ERROR, FRAME, frames
from dbc.frame_bits import frame_time_ns
from skin.layout import Bus

#: A load of less time says nothing: the sums of one SYNC come together.
LEAST_S: Final = 0.1


class LoadMeter:
    """Measures the load of one bus, since the last `take_ratio` and since SYNC started.

    Parameters
    ----------
    wires : Bus
        Bit rates.
    """

    def __init__(self, wires: Bus, now_s: float) -> None:
        self._wires = wires
        frame_time_ns(frames(1), wires.bitrate, wires.data_bitrate)  # compiled before the first cycle
        self._waiting: list[npt.NDArray[np.uint8]] = []
        self._busy_ns = self._total_busy_ns = 0
        self._since_s = self._start_s = now_s

    def take(self, rows: npt.NDArray[np.uint8]) -> None:
        """Keep frames of the bus, the gateway's own included, until `account`; see `gateway.batch.Batch`."""
        self._waiting.append(rows)

    def account(self) -> None:
        """Add up the time of the kept frames; one call for many frames is cheaper than many calls."""
        if not self._waiting:
            return
        # As bytes: np.concatenate compares the fields of records, array by array.
        taken = np.concatenate(self._waiting).reshape(-1).view(FRAME)
        self._waiting.clear()
        taken = taken[taken["flags"] & ERROR == 0]
        busy_ns = int(frame_time_ns(taken, self._wires.bitrate, self._wires.data_bitrate).sum())
        self._busy_ns += busy_ns
        self._total_busy_ns += busy_ns

    def restart(self, now_s: float) -> None:
        """Clear the load and count from `now_s`, the start of SYNC."""
        self._waiting.clear()
        self._busy_ns = self._total_busy_ns = 0
        self._since_s = self._start_s = now_s

    def take_ratio(self, now_s: float) -> float:
        """Return the load since the last call, and begin anew; 0 if that is less than `LEAST_S` ago."""
        if now_s - self._since_s < LEAST_S:
            return 0.0
        self.account()
        load_ratio = _ratio(self._busy_ns, now_s - self._since_s)
        self._busy_ns, self._since_s = 0, now_s
        return load_ratio

    def mean_ratio(self, now_s: float) -> float:
        """Return the load since `restart`."""
        return _ratio(self._total_busy_ns, now_s - self._start_s)


def _ratio(busy_ns: int, elapsed_s: float) -> float:
    return busy_ns * 1e-9 / elapsed_s if elapsed_s > 0 else 0.0
