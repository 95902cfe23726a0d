"""At a SYNC every block samples the same instant of the touch."""

from collections import deque
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dbc.contract import SYNC_OVERFLOW
from dbc.indices import OD_GAIN, OD_OFFSET, OD_TEST_PATTERN
from nodes.electronics import PATTERN_OFF, Electronics
from skin.measurement import Sbhe
from skin.messages import Truth
from skin.sources import TaxelSource
from skin.taxel import to_newtons

#: Longest time between the SYNC frames of one cycle on different buses: frames without counter, and frames with the
#: same counter. A busy master delays frames. A counter returns after 240 periods, 120 ms or more.
UNNUMBERED_SYNC_SPREAD_NS: Final = 2_000_000
NUMBERED_SYNC_SPREAD_NS: Final = 100_000_000
#: Cycles whose sums are kept, because some buses are read later than others.
KEPT_CYCLES: Final = 8


class Sampler:
    """Turns SYNC counters into sums, once per cycle for all buses.

    The step of the taxel source follows the SYNC counter. So all processes of nodes that were started before the
    first SYNC measure the same touch, even if one process misses a SYNC.

    Attributes
    ----------
    sums : array of int32, shape (m,)
        The newest sums.
    """

    def __init__(self, phi: Sbhe, source: TaxelSource, electronics: Electronics) -> None:
        self.sums = np.zeros(phi.shape[0], np.int32)
        self._phi = phi
        self._source = source
        self._electronics = electronics
        self._patterns = np.full(phi.blocks, PATTERN_OFF, np.uint8)
        self._step = -1
        self._counter = 0
        self._kept: deque[tuple[int, int, npt.NDArray[np.int32]]] = deque(maxlen=KEPT_CYCLES)
        self._truth: Truth | None = None

    def first_sum(self, block: int) -> int:
        """Return the index of the first sum of `block`."""
        return int(self._phi.starts[block])

    def adjust(self, block: int, index: int, subindex: int, value: float) -> None:
        """Apply a write to a block's calibration or test pattern (2010h, 2011h, 2021h)."""
        size, chain = self._phi.block_size, self._chain(block)
        if index == OD_GAIN and 1 <= subindex <= size:
            self._electronics.gain[chain[subindex - 1]] = value
        elif index == OD_OFFSET and 1 <= subindex <= size:
            self._electronics.offset[chain[subindex - 1]] = value
        elif index == OD_TEST_PATTERN:
            self._electronics.set_pattern(chain, int(value))
            self._patterns[block] = int(value)

    def reset(self, block: int) -> None:
        """Set a block to the defaults: gain 1, offset 0, no test pattern; begin its averages anew."""
        chain = self._chain(block)
        self._electronics.gain[chain] = 1
        self._electronics.offset[chain] = 0
        self._electronics.set_pattern(chain, PATTERN_OFF)
        self._electronics.restart(block)
        self._patterns[block] = PATTERN_OFF

    def pattern(self, block: int) -> int:
        """Return the test pattern of a block."""
        return int(self._patterns[block])

    def saturated(self, block: int) -> int:
        """Count the taxels of `block` at the top of their range."""
        return int((self._electronics.sampled[self._chain(block)] >= self._electronics.taxels.count_max).sum())

    def _chain(self, block: int) -> npt.NDArray[np.intp]:
        """Return the taxels of a block in chain order."""
        size = self._phi.block_size
        return self._phi.order[block * size : (block + 1) * size]

    def sample(self, counter: int, time_ns: int) -> npt.NDArray[np.int32]:
        """Return the sums, shape (m,), at the SYNC `counter` (0: a SYNC without counter) seen at `time_ns`."""
        within_ns = NUMBERED_SYNC_SPREAD_NS if counter else UNNUMBERED_SYNC_SPREAD_NS
        for known, seen_ns, sums in self._kept:
            if known == counter and abs(time_ns - seen_ns) < within_ns:
                return sums
        if self._step < 0:
            self._step = max(0, counter - 1)
        else:
            missed = (counter - self._counter) % SYNC_OVERFLOW or 1
            self._step += missed
            if missed > 1 and self._electronics.averages:
                self._electronics.prepare(self._source.frame(self._step - 1).force_n, self._step - 1)
        self._counter = counter
        frame = self._source.frame(self._step)
        exact: npt.NDArray[Any] = self._phi.forward(self._electronics.read(frame.force_n, self._step))
        self.sums = np.rint(exact).astype(np.int32)
        self._kept.append((counter, time_ns, self.sums))
        self._truth = Truth(
            step=self._step,
            sync_counter=counter,
            sync_mono_ns=time_ns,
            true=frame.force_n.astype("<f4").tobytes(),
            sensor=to_newtons(self._electronics.sampled, self._electronics.taxels).astype("<f4").tobytes(),
            label=frame.label,
        )
        return self.sums

    def prepare(self) -> None:
        """Sample ahead what the next SYNC will most likely ask for."""
        step = self._step + 1
        if step > 0 and step != self._electronics.sampled_ahead:
            self._electronics.prepare(self._source.frame(step).force_n, step)

    def take_truth(self) -> Truth | None:
        """Return the true forces and the sensor signal of the newest cycle, once."""
        truth, self._truth = self._truth, None
        return truth
