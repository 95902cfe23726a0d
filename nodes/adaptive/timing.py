"""When adaptive boards may give frames to a bus, and how many."""

from typing import Final

from dbc.adaptive import PAUSE_MS
from dbc.contract import Contract, sum_frame_bits

#: Least time from a SYNC to the start of a frame of sums.
PAUSE_NS: Final = PAUSE_MS * 1_000_000
#: Frames that a bus gets beyond those that fit until the next decision.
SPARE_FRAMES: Final = 4
#: Most frames that a bus gets at once.
MOST_FRAMES: Final = 64


class SendingTimes:
    """The times of one bus.

    Parameters
    ----------
    contract : Contract
    bus : int

    Attributes
    ----------
    period_ns : int
        Time between two SYNCs.
    sync_ns : int
        End of the newest SYNC.
    """

    def __init__(self, contract: Contract, bus: int) -> None:
        line = contract.layout.bus[bus]
        self.period_ns = round(contract.layout.sync.period_s * 1e9)
        self.sync_ns = -(1 << 62)
        self._coarse_ns, self._frame_ns = (
            sum_frame_bits(line, is_fine=is_fine) * 1e9 / line.bitrate for is_fine in (False, True)
        )

    def next(self, now_ns: int, pace_ns: float) -> tuple[int, int] | None:
        """Return when frames expire that are made now, and how many the bus gets; None if it gets none.

        These are the frames that can win the bus until the next decision, `pace_ns` from now, and a few more.
        """
        next_ns = self.sync_ns + self.period_ns
        if self.sync_ns <= now_ns < self.sync_ns + PAUSE_NS or now_ns < next_ns < now_ns + self._frame_ns:
            return None
        until_ns = now_ns + int(pace_ns)
        if now_ns < next_ns:
            until_ns = min(until_ns, next_ns)
        return until_ns, min(MOST_FRAMES, SPARE_FRAMES + int(-(-(until_ns - now_ns) // self._coarse_ns)))
