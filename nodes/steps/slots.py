"""Sums of stepped boards go to the bus in slots, when they are worth their bits."""

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract
from dbc.frame import Frames
from nodes.steps.patch_boards import PatchBoards
from nodes.timing import Timing


class InSlots(Timing):
    """Words in the slots of each board; a TPDO counts as sent when its echo comes.

    Parameters
    ----------
    boards : PatchBoards
        All boards of the process.
    """

    counts_accepted = False

    def __init__(self, contract: Contract, bus: int, boards: PatchBoards) -> None:
        self._bus, self._boards = bus, boards
        self._period_ns = round(contract.layout.sync.period_s * 1e9)

    def begin(self, now_s: float, since_sync_s: float) -> bool:  # noqa: ARG002  heartbeats may go at any time
        """Sample what is due, on all buses of the process."""
        self._boards.advance(now_s)
        return True

    def news(self, now_s: float) -> Frames:
        """Return the frames of the slots that have begun."""
        return self._boards.choose(self._bus, round(now_s * 1e9))

    def measure(self, counter: int, time_ns: int) -> None:
        """Begin the slots of a SYNC; the first SYNC tells when the touch began."""
        self._boards.take_sync(self._bus, counter, time_ns)
        self._boards.touched_from(time_ns - max(0, counter - 1) * self._period_ns)

    def count(self, arrived: Frames, is_pdo: npt.NDArray[np.bool_]) -> tuple[int, int, int]:  # noqa: ARG002
        """Take note of the boards' own frames."""
        sent, others = self._boards.take_echoes(self._bus, arrived)
        return sent, 0, others
