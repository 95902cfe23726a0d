"""Which cells a node holds: patches of neighbours, dealt out so that a touch meets all buses alike."""

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from skin import walsh
from skin.layout import Bus

#: Cells of one node, as on the default skin.
NODE_CELLS: Final = 32
BUSES: Final = 4


@cache
def patches(side: int) -> npt.NDArray[np.int64]:
    """Return the cells of every node of an array of `side` x `side`, shape (BUSES, nodes, cells), row-major indices.

    A node holds `NODE_CELLS` cells, four high and eight wide, or fewer on an array that would not reach all buses.
    """
    per_node = min(NODE_CELLS, side * side // BUSES)
    return np.stack(walsh.patches(side, side, per_node, [side * side // per_node // BUSES] * BUSES)).astype(np.int64)


def lines_of(side: int) -> tuple[Bus, ...]:
    """Return the classic buses of an array of `side` x `side`."""
    nodes = patches(side).shape[1]
    return tuple(Bus(name=f"bus{number}", nodes=nodes) for number in range(BUSES))
