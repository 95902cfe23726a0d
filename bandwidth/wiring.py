"""The wires of a skin and the work of its converters, from the layout."""

from dataclasses import dataclass

import numpy as np

from skin.layout import Layout
from skin.patch_wiring import chain_lengths_m


@dataclass(frozen=True)
class Wiring:
    """Wires between taxels, metres (`skin.patch_wiring.chain_lengths_m`); conversions of the node with most taxels."""

    longest_chain_m: float
    wires_m: float
    conversions_per_s: float

    def __str__(self) -> str:
        """Return one line."""
        return (
            f"longest chain of taxels {self.longest_chain_m:.2f} m, all chains {self.wires_m:.1f} m, "
            f"{self.conversions_per_s:.0f} conversions a second on a node"
        )


def wiring(layout: Layout) -> Wiring:
    """Return the wiring of a layout, of the blocks that send sums."""
    phi = layout.phi()
    lengths_m = chain_lengths_m(phi.taxels_of_blocks[phi.has_sums], layout.taxels.surface.positions_m)
    samples_per_s = layout.samples_per_sync * layout.sync.rate_hz
    return Wiring(float(lengths_m.max()), float(lengths_m.sum()), _most_converted(layout) * samples_per_s)


def _most_converted(layout: Layout) -> int:
    """Return the taxels or, of an analogue front end, sums of the node with most of them."""
    phi = layout.phi()
    of_blocks = np.diff(phi.starts)
    if not layout.taxels.is_analogue:
        of_blocks = phi.held * (of_blocks > 0)
    most = 0
    for number, bus in enumerate(layout.bus):
        first = layout.first_block(number)
        held = of_blocks[first : first + bus.nodes * bus.blocks_per_node].reshape(bus.nodes, bus.blocks_per_node)
        most = max(most, int(held.sum(axis=1).max()))
    return most
