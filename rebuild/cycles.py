"""The sums of every cycle, from a log or from a recording."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class Cycles:
    """Measured cycles of one skin, in the order of time.

    Attributes
    ----------
    counts : array of int32, shape (cycles, m)
        Sums in ADC counts, 0 where invalid.
    valid : array of bool, shape (cycles, blocks)
        True if every sum of the block came in this cycle.
    time_ns : array of int64, shape (cycles,)
        Time of the SYNC: on the clock of the log; of a recording, from 0.
    """

    counts: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    time_ns: npt.NDArray[np.int64]
