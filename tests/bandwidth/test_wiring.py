"""How long the wires of blocks are."""

import numpy as np
import pytest

from bandwidth.wiring import chain_lengths_m, wiring
from skin.layout import changed, load_layout
from skin.surface import grid_surface


def test_chains_go_to_the_nearest_taxel_that_is_left() -> None:
    """On a grid of 8 columns: from 0 three to the right, back over two, and down by the diagonal of a square."""
    chains = np.array([[0, 3, 1, 8], [0, 1, 2, 3]])
    positions_m = grid_surface(8, 8, 0.5, np.zeros(0, np.intp)).positions_m
    assert chain_lengths_m(chains, positions_m).tolist() == pytest.approx([0.5 * (1 + 2**0.5 + 10**0.5), 1.5])


def test_neighbours_have_the_shortest_wires() -> None:
    """Row by row, no step is longer than a pitch."""
    scattered = load_layout()
    board = wiring(changed(scattered, measurement={"wiring": "board"}))
    assert board.wires_m == pytest.approx(128 * 31 * 0.004)
    assert wiring(scattered).wires_m > 5 * board.wires_m
