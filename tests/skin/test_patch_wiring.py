"""Regions that hold a block, and wires."""

import numpy as np
import pytest

from skin.layout import Layout, layout_text, load_layout, parse_layout
from skin.patch_wiring import chain_lengths_m
from skin.surface import grid_surface


def layout_of(keys: str, rows: int = 32, columns: int = 64) -> Layout:
    return parse_layout(f"[taxels]\nrows = {rows}\ncolumns = {columns}\n[measurement]\n{keys}\n".encode(), "palm.toml")


@pytest.mark.parametrize(("patch", "size"), [(8, 32), (8, 64), (16, 32), (32, 128)])
def test_a_block_is_scattered_within_its_region(patch: int, size: int) -> None:
    layout = layout_of(f"patch = {patch}\nblock_size = {size}")
    chains = layout.phi().taxels_of_blocks
    assert sorted(chains.ravel().tolist()) == list(range(2048))
    down, across = np.divmod(chains, 64)
    region = down // patch * (64 // patch) + across // patch
    assert (region == region[:, :1]).all()
    if patch * patch > size:  # no block is a corner of its region
        assert (np.ptp(down, axis=1) > patch / 2).all()
    assert np.array_equal(layout.phi().kept, layout_of(f"block_size = {size}").phi().kept)


def test_a_region_has_blocks_on_all_buses() -> None:
    layout = layout_of("patch = 16", rows=64)
    down, across = np.divmod(layout.phi().taxels_of_blocks[:, 0], 64)
    bus = np.arange(128) // 32
    for region in range(16):
        held = bus[down // 16 * 4 + across // 16 == region]
        assert np.bincount(held).tolist() == [2, 2, 2, 2]


def test_the_seed_draws_the_regions_too() -> None:
    marks = {layout_of(f"patch = 16\nseed = {seed}").phi().fingerprint for seed in (1, 1, 2)}
    assert len(marks) == 2
    assert parse_layout(layout_text(layout_of("patch = 16")).encode(), "again").phi().fingerprint in marks


def test_chains_go_to_the_nearest_taxel_that_is_left() -> None:
    """On a grid of 8 columns: from 0 three to the right, back over two, and down by the diagonal of a square."""
    chains = np.array([[0, 3, 1, 8], [0, 1, 2, 3]])
    positions_m = grid_surface(8, 8, 0.5, np.zeros(0, np.intp)).positions_m
    assert chain_lengths_m(chains, positions_m).tolist() == pytest.approx([0.5 * (1 + 2**0.5 + 10**0.5), 1.5])


def test_neighbours_have_the_shortest_wires() -> None:
    def wires_m(keys: str) -> float:
        layout = layout_of(keys, rows=64)
        return float(chain_lengths_m(layout.phi().taxels_of_blocks, layout.taxels.surface.positions_m).sum())

    lengths = [wires_m(keys) for keys in ("wiring = 'board'", "patch = 8", "patch = 16", "patch = 32", "")]
    assert lengths == sorted(lengths)
    assert lengths[0] == pytest.approx(128 * 31 * 0.004)  # row by row, no step is longer than a pitch
    assert wires_m("patch = 64") == pytest.approx(lengths[-1])
    assert load_layout().measurement.patch is None
