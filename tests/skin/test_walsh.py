"""Patches and Walsh rows, against figures that are computed another way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import hadamard

from canskin.errors import InputError
from skin.surface import grid_surface
from skin.walsh import GROUPS, Indices, grouped_rows, neighbours, patch_shape, patches, walsh_matrix

NO_GAPS = np.zeros(0, np.intp)


def of_grid(rows: int, columns: int, taxels: int, blocks: list[int], gaps: Indices = NO_GAPS) -> list[Indices]:
    return patches(grid_surface(rows, columns, 0.004, gaps), taxels, blocks, gaps)


@pytest.mark.parametrize(("taxels", "shape"), [(8, (2, 4)), (16, (4, 4)), (32, (4, 8)), (64, (8, 8))])
def test_patches_are_square_or_twice_as_wide(taxels: int, shape: tuple[int, int]) -> None:
    assert patch_shape(taxels) == shape


@pytest.mark.parametrize("taxels", [4, 8, 16, 32, 64, 128])
def test_rows_of_a_patch_are_all_rows_of_its_hadamard_matrix(taxels: int) -> None:
    rows = grouped_rows(taxels)
    assert sorted(rows.ravel().tolist()) == list(range(taxels))
    walsh = walsh_matrix(taxels)
    assert np.array_equal(walsh @ walsh.T, taxels * np.eye(taxels))
    assert np.array_equal(walsh, hadamard(taxels)[rows.ravel()])


@pytest.mark.parametrize("taxels", [8, 32, 128])
def test_groups_are_quarters_of_the_sequencies(taxels: int) -> None:
    high, wide = patch_shape(taxels)
    walsh = walsh_matrix(taxels).reshape(GROUPS, -1, high, wide)
    for group in range(GROUPS):
        down = [int((np.diff(row[:, 0]) != 0).sum()) for row in walsh[group]]
        across = [int((np.diff(row[0]) != 0).sum()) for row in walsh[group]]
        expected = [
            (a, b)
            for a in range(group // 2 * (high // 2), (group // 2 + 1) * (high // 2))
            for b in range(group % 2 * (wide // 2), (group % 2 + 1) * (wide // 2))
        ]
        assert list(zip(down, across, strict=True)) == expected


def test_first_group_alone_gives_the_means_of_two_by_two_taxels() -> None:
    patch = np.random.default_rng(1).uniform(size=(4, 8))
    first = walsh_matrix(32)[:8]
    coarse = (first.T @ (first @ patch.ravel()) / 32).reshape(4, 8)
    means = patch.reshape(2, 2, 4, 2).mean(axis=(1, 3)).repeat(2, 0).repeat(2, 1)
    assert coarse == pytest.approx(means, abs=1e-6)


def test_patch_beside_or_below_is_on_another_bus() -> None:
    bus_of = np.empty(4096, int)
    for bus, held in enumerate(of_grid(64, 64, 32, [32] * 4)):
        assert held.shape == (32, 32)
        bus_of[held.ravel()] = bus
    patch_bus = bus_of.reshape(64, 64)[::4, ::8]
    assert (patch_bus[1:] != patch_bus[:-1]).all()
    assert (patch_bus[:, 1:] != patch_bus[:, :-1]).all()


@given(st.data())
def test_every_taxel_is_in_one_patch_whatever_the_buses_take(data: st.DataObject) -> None:
    total, blocks = 32, []
    while total:
        blocks.append(data.draw(st.integers(1, total)))
        total -= blocks[-1]
    dealt = of_grid(32, 32, 32, blocks)
    assert [len(held) for held in dealt] == blocks
    assert sorted(np.concatenate(dealt).ravel().tolist()) == list(range(1024))
    for patch in np.concatenate(dealt):
        rows, columns = np.divmod(patch, 32)
        assert (np.ptp(rows), np.ptp(columns)) == (3, 7)


@pytest.mark.parametrize(
    ("grid", "taxels", "blocks"), [((64, 60), 32, [121]), ((64, 64), 32, [100]), ((64, 64), 24, [171])]
)
def test_patches_that_do_not_fit_are_refused(grid: tuple[int, int], taxels: int, blocks: list[int]) -> None:
    with pytest.raises(InputError, match="patches"):
        of_grid(*grid, taxels, blocks)


@given(st.integers(1, 20), st.integers(1, 20), st.integers(2, 6), st.integers(0, 9))
def test_neighbours_hold_every_taxel_once_and_their_empty_places_lie_together(
    rows: int, columns: int, log_taxels: int, more: int
) -> None:
    taxels, count = 2**log_taxels, rows * columns
    blocks = min(count, -(-count // taxels) + more)
    dealt = neighbours(np.stack(np.divmod(np.arange(count), columns), axis=1), blocks, taxels)
    assert sorted(dealt.ravel().tolist()) == list(range(blocks * taxels))
    held = (dealt < count).sum(axis=1)
    assert np.ptp(held) <= 1
    high, wide = patch_shape(taxels)
    for patch in dealt.reshape(blocks, high // 2, 2, wide // 2, 2).swapaxes(2, 3).reshape(blocks, -1, 4):
        inside = (patch < count).sum(axis=1)
        assert ((inside > 0) & (inside < 4)).sum() <= 1  # of the cells whose means are group 0


def test_cells_of_a_patch_of_any_shape_are_neighbours() -> None:
    """On a mat of 10 x 10 taxels, and on one that is bent to half a tube."""
    flat = np.stack(np.divmod(np.arange(100), 10), axis=1).astype(float)
    angle = flat[:, 1] / 9 * np.pi
    bent = np.stack((flat[:, 0], 2.86 * np.cos(angle), 2.86 * np.sin(angle)), axis=1)
    for positions in (flat, bent):
        for patch in neighbours(positions, 4, 32).reshape(4, 2, 2, 4, 2).swapaxes(2, 3).reshape(-1, 4):
            cell = flat[patch[patch < 100]]
            assert (np.ptp(cell, axis=0) <= 3).all() if len(cell) else True


def test_patches_end_at_gaps_where_boards_have_room() -> None:
    """Four fingers of 4 x 8 and a palm: each finger is one board."""
    shape = np.array([list(line) for line in [*["####.####.####.####"] * 8, "." * 19, *["#" * 19] * 6]])
    gaps = np.flatnonzero(shape.ravel() == ".")
    (dealt,) = of_grid(*shape.shape, 32, [8], gaps)
    fingers = [patch for patch in dealt if (patch // 19 < 8).any()]
    assert len(fingers) == 4
    for patch in fingers:
        rows, columns = np.divmod(patch, 19)
        assert (np.ptp(rows), np.ptp(columns)) == (7, 3)
