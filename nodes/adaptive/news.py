"""Sums of adaptive boards go to the bus when they carry news: when a bus gets frames, and how many."""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.adaptive import PAUSE_MS
from dbc.contract import Contract, sum_frame_bits
from dbc.frame import Frames
from nodes.adaptive.patch_boards import MOST_FRAMES, PatchBoards
from nodes.sending import Sending

#: Least time from a SYNC to the start of a frame of sums.
PAUSE_NS: Final = PAUSE_MS * 1_000_000
#: Frames that a bus gets beyond those that fit until the next decision.
SPARE_FRAMES: Final = 4


class WithNews(Sending):
    """Sums when they carry news, the most urgent first; a TPDO counts as sent when its echo comes.

    Parameters
    ----------
    boards : PatchBoards
        All boards of the process.
    """

    counts_accepted = False

    def __init__(self, contract: Contract, bus: int, boards: PatchBoards) -> None:
        line = contract.layout.bus[bus]
        self._bus, self._boards = bus, boards
        self._period_ns = round(contract.layout.sync.period_s * 1e9)
        self._sync_ns = -(1 << 62)
        self._decision = 0
        self._coarse_ns, self._frame_ns = (
            sum_frame_bits(line, contract.layout.groups, is_fine=is_fine) * 1e9 / line.bitrate
            for is_fine in (False, True)
        )

    def begin(self, now_s: float, since_sync_s: float) -> bool:  # noqa: ARG002  heartbeats may go at any time
        """Sample what is due, on all buses of the process."""
        self._boards.advance(now_s)
        return True

    def news(self, now_s: float) -> Frames | None:
        """Return the frames that can win the bus until the next decision, and a few more: once for each decision."""
        boards = self._boards
        if boards.decision == self._decision:
            return None
        self._decision = boards.decision
        now_ns = round(now_s * 1e9)
        times = self.times(now_ns, boards.pace_ns) if boards.has_due else None
        return None if times is None else boards.choose(self._bus, now_ns, *times)

    def times(self, now_ns: int, pace_ns: float) -> tuple[int, int] | None:
        """Return when frames expire that are made now, and how many the bus gets; None if it gets none.

        These are the frames that can win the bus until the next decision, `pace_ns` from now, and a few more.
        """
        next_ns = self._sync_ns + self._period_ns
        if self._sync_ns <= now_ns < self._sync_ns + PAUSE_NS or now_ns < next_ns < now_ns + self._frame_ns:
            return None
        until_ns = now_ns + int(pace_ns)
        if now_ns < next_ns:
            until_ns = min(until_ns, next_ns)
        return until_ns, min(MOST_FRAMES, SPARE_FRAMES + int(-(-(until_ns - now_ns) // self._coarse_ns)))

    def measure(self, counter: int, time_ns: int) -> None:
        """Leave the bus to others for a while; the first SYNC tells when the touch began."""
        self._sync_ns = time_ns
        self._boards.touched_from(time_ns - max(0, counter - 1) * self._period_ns)

    def count(self, arrived: Frames, is_pdo: npt.NDArray[np.bool_]) -> tuple[int, int, int]:  # noqa: ARG002
        """Take note of the boards' own frames."""
        sent, others = self._boards.take_echoes(self._bus, arrived)
        return sent, 0, others
