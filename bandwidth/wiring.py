"""The wires of a skin and the work of its converters, from the layout."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skin.layout import Layout
from skin.walsh import Indices


@dataclass(frozen=True)
class Wiring:
    """Wires between taxels, metres (`chain_lengths_m`); conversions of the node with most taxels."""

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


def chain_lengths_m(chains: Indices, positions_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the length of each block's wire in metres, shape (blocks,).

    The wire begins at the first taxel of the block and always goes on to the nearest taxel that is left. Such a chain
    is not the shortest. The order of the wire has no effect on Φ: the board knows the sign of each taxel.

    Parameters
    ----------
    chains : array of int, shape (blocks, block size)
        Taxels (`Sbhe.taxels_of_blocks`); empty places need no wire.
    positions_m : array, shape (n, 3)
        Of the taxels, metres.
    """
    places = positions_m[np.where(chains < len(positions_m), chains, chains.min(axis=1, keepdims=True))]
    # To the nanometre: taxels that are as far away are taken in their order, whatever the last bits.
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1).round(9)
    blocks, here = np.arange(len(chains)), np.zeros(len(chains), np.intp)
    length = np.zeros(len(chains))
    for _ in range(chains.shape[1] - 1):
        apart[blocks, :, here] = np.inf  # the wire never comes back
        nearest = apart[blocks, here].argmin(axis=1)
        length += apart[blocks, here, nearest]
        here = nearest
    return length


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
