"""Layouts that trade rate, sums and bits at the same bus time, each one that `skin plan` finds no fault with."""

from collections.abc import Iterator
from itertools import product
from typing import Final

import msgspec

from bandwidth.alternatives import BLOCKS_PER_NODE, with_buses, with_rate, with_sums
from bandwidth.highest_rate import highest_rate_hz
from canskin.errors import LayoutError
from skin.layout import SUM_BITS, Bus, Layout, load_layout, validated

#: Part of each bus that frames with the most stuff bits may use; the default skin uses 0.87.
BUDGET: Final = 0.9
#: Rows of 32 that every block sends.
ROWS: Final = (4, 8, 16, 32)
#: The recorded touches have one image a millisecond: more cycles would see nothing new.
RATE_MAX_HZ: Final = 1000.0
_FD: Final = Bus(name="bus0", nodes=1, fd=True, data_bitrate=5_000_000)
#: How many buses of which kind.
WIRES: Final = {
    "one classic bus": (1, Bus(name="bus0", nodes=1)),
    "four classic buses": (4, Bus(name="bus0", nodes=1)),
    "one FD bus": (1, _FD),
}


def points() -> Iterator[tuple[str, Layout]]:
    """Yield every combination that can be laid out with its wires, with as many blocks per node as make it fastest.

    Each layout has the highest rate that keeps `BUDGET` and the window (1007h).
    """
    for wires, rows, bits in product(WIRES, ROWS, sorted(SUM_BITS)):
        found = list(_layouts(wires, rows, bits))
        if found:
            yield wires, max(found, key=lambda layout: layout.sync.rate_hz)


def _layouts(wires: str, rows: int, bits: int) -> Iterator[Layout]:
    """Yield one layout for each number of blocks per node that is possible, each at its highest rate."""
    start = load_layout()
    buses, like = WIRES[wires]
    encoding = msgspec.structs.replace(start.encoding, sum_bits=bits, offset_binary=True)
    start = msgspec.structs.replace(with_sums(start, rows * start.blocks), encoding=encoding)
    for per_node in BLOCKS_PER_NODE:
        layout = with_buses(start, buses, msgspec.structs.replace(like, blocks_per_node=per_node))
        try:
            rate_hz = min(RATE_MAX_HZ, highest_rate_hz(layout, BUDGET))
        except LayoutError:
            continue  # more nodes than node-IDs, or more frames than identifiers
        if rate_hz > 0:
            yield validated(with_rate(layout, rate_hz))
