"""What all boards of a process share: their taxels, when these are sampled, calibration and test patterns."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from canskin.messages import Truth
from dbc import indices as od
from dbc.board_sums import PATTERN_OFF
from dbc.frame import Frames, frames
from nodes.electronics import Calibration
from skin.phi import Sbhe
from skin.zero_drift import DRIFT_N_PER_K, REST_K

#: When a synchronous node has to do something by itself: never.
NEVER_S = float("inf")


class Hardware(ABC):
    """The electronics of the boards of a process, as their nodes and the segments of their buses see it."""

    #: Whether a TPDO counts as sent as soon as the transmit queue has accepted it.
    counts_accepted: ClassVar[bool]

    def __init__(self, phi: Sbhe, calibration: Calibration) -> None:
        self._phi = phi.wired
        self._calibration = calibration
        self._patterns = np.full(phi.blocks, PATTERN_OFF, np.uint8)
        #: The block of the skin on which the board of a block sits: LSS may give any node-ID to any board.
        self._sites = np.arange(phi.blocks)

    @property
    def sums(self) -> npt.NDArray[np.int32]:
        """The newest sums of boards in Python, shape (m,); boards in C tell their own."""
        raise NotImplementedError

    @abstractmethod
    def counts(self, block: int) -> npt.NDArray[np.int32]:
        """Return what the taxels of a block read last, in counts."""

    @abstractmethod
    def take_truth(self) -> Truth | None:
        """Return the oldest truth that was not returned yet."""

    @property
    def due_s(self) -> float:
        """When something has to be done that no frame asks for, in monotonic seconds."""
        return NEVER_S

    @property
    def is_sending(self) -> bool:
        """Whether echoes of frames are awaited that nobody will ask for again."""
        return False

    @abstractmethod
    def prepare(self) -> None:
        """Do beforehand what a SYNC will ask for."""

    @abstractmethod
    def begin(self, now_s: float, since_sync_s: float) -> bool:
        """Sample what is due by time; tell whether this is a time for heartbeats."""

    @abstractmethod
    def at_sync(self, bus: int, counter: int, time_ns: int) -> npt.NDArray[np.int32] | None:
        """Return what the boards of a bus measure at a SYNC, if they send at SYNC; the counter is 0 without one."""

    def news(self, bus: int, now_s: float) -> Frames:  # noqa: ARG002  not all boards send by themselves
        """Return the frames that the boards of a bus send by themselves: each once."""
        return frames(0)

    @abstractmethod
    def count(self, bus: int, arrived: Frames, is_pdo: npt.NDArray[np.bool_]) -> tuple[int, int, int]:
        """Count the boards' own TPDOs among the received frames of a bus.

        Returns
        -------
        sent, dropped : int
            By how much the numbers of TPDOs sent and dropped change.
        others : int
            Frames that the boards still have to take.
        """

    def first_sum(self, block: int) -> int:
        """Return the index of the first sum of `block`."""
        return int(self._phi.starts[block])

    def place(self, block: int, site: int) -> None:
        """Let the board of a block sit on another block of the skin: it feels the taxels there."""
        self._sites[block] = site

    def adjust(self, block: int, index: int, subindex: int, value: float) -> None:
        """Apply a write to a block's calibration or test pattern (2010h, 2011h, 2021h)."""
        size, chain = self._phi.block_size, self._chain(block)
        if index == od.GAIN and 1 <= subindex <= size:
            self._calibration.gain[chain[subindex - 1]] = value
        elif index == od.OFFSET and 1 <= subindex <= size:
            self._calibration.offset[chain[subindex - 1]] = value
        elif index == od.TEST_PATTERN:
            self._calibration.set_pattern(chain, int(value))
            self._patterns[block] = int(value)

    def reset(self, block: int) -> None:
        """Set a block to the defaults: gain 1, offset 0, no test pattern."""
        chain = self._chain(block)
        self._calibration.gain[chain] = 1
        self._calibration.offset[chain] = 0
        self._calibration.set_pattern(chain, PATTERN_OFF)
        self._patterns[block] = PATTERN_OFF

    def pattern(self, block: int) -> int:
        """Return the test pattern of a block."""
        return int(self._patterns[block])

    def saturated(self, block: int) -> int:
        """Count the taxels of `block` at the top of their range."""
        return int((self.counts(block) >= self._calibration.taxels.count_max).sum())

    def _drifted_n(self) -> npt.NDArray[np.float32]:
        """Return how far the zeros of the taxels have drifted by place, newtons, shape (rows, columns) or (n,)."""
        return np.zeros(self._calibration.taxels.count, np.float32)

    def temperature_k(self, blocks: range) -> float:
        """Return the simulated temperature of the board of some blocks, kelvin: that which explains their drift."""
        drifted_n = self._drifted_n().ravel()
        chains = self._phi.taxels_of_blocks[self._sites[blocks]]
        return REST_K + float(drifted_n[chains[chains < drifted_n.size]].mean()) / DRIFT_N_PER_K

    def _chain(self, block: int) -> npt.NDArray[np.intp]:
        """Return the taxels that the board of a block feels, in chain order."""
        size, site = self._phi.block_size, self._sites[block]
        return self._phi.order[site * size : (site + 1) * size]
