"""Which blocks are proven: a block is valid in a cycle only if its node was proven during all of the cycle.

`gateway.nmt_master` proves and doubts nodes; each change comes here by way of `Collector.trust`. Steps have no
cycles: there `judge` in `gateway.block_states` says which blocks are valid.
"""

import numpy as np
import numpy.typing as npt


class ProvenBlocks:
    """Blocks of proven nodes, now and in the open cycles.

    Parameters
    ----------
    blocks, slots : int
        Number of blocks, and most cycles that are open.
    """

    def __init__(self, blocks: int, slots: int) -> None:
        self._now = np.zeros(blocks, np.bool_)
        self._all_cycle = np.zeros((slots, blocks), np.bool_)

    def trust(self, blocks: slice, *, proven: bool) -> None:
        """Count `blocks` as proven in the cycles that begin from now on if `proven`; else in no cycle, open or not."""
        self._now[blocks] = proven
        if not proven:
            self._all_cycle[:, blocks] = False

    def begin(self, slot: int) -> None:
        """Begin the cycle of a slot."""
        self._all_cycle[slot] = self._now

    def during(self, slot: int) -> npt.NDArray[np.bool_]:
        """Return the blocks that were proven during all of the cycle of a slot, shape (blocks,); a view."""
        proven: npt.NDArray[np.bool_] = self._all_cycle[slot]
        return proven
