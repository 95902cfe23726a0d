"""The wires of a skin and the work of its converters, from the layout."""

from dataclasses import dataclass

from skin.layout import Layout
from skin.wiring import chain_lengths_m


@dataclass(frozen=True)
class Wiring:
    """Wires between taxels, metres, by `skin.wiring.chain_lengths_m`; conversions of the node with the most taxels."""

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
    """Return the wiring of a layout."""
    lengths_m = chain_lengths_m(layout.phi().taxels_of_blocks, layout.taxels.columns, layout.taxels.pitch_m)
    taxels = layout.measurement.block_size * max(bus.blocks_per_node for bus in layout.bus)
    samples_per_s = layout.samples_per_sync * layout.sync.rate_hz
    return Wiring(float(lengths_m.max()), float(lengths_m.sum()), taxels * samples_per_s)
