"""Patches and Walsh rows, against figures that are computed another way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import hadamard

from canskin.errors import InputError
from skin.surface import grid_surface
from skin.walsh import Indices, coarse_rows, grouped_rows, neighbours, patch_shape, patches, walsh_matrix

NO_GAPS = np.zeros(0, np.intp)


def of_grid(rows: int, columns: int, taxels: int, blocks: list[int], gaps: Indices = NO_GAPS) -> list[Indices]:
    return patches(grid_surface(rows, columns, 0.004, gaps), taxels, blocks, gaps)


@pytest.mark.parametrize(("taxels", "shape"), [(8, (2, 4)), (16, (4, 4)), (32, (4, 8)), (64, (8, 8))])
def test_patches_are_square_or_twice_as_wide(taxels: int, shape: tuple[int, int]) -> None:
    assert patch_shape(taxels) == shape


@pytest.mark.parametrize("taxels", [8, 16, 32, 64, 128])
def test_rows_of_a_patch_are_all_rows_of_its_hadamard_matrix(taxels: int) -> None:
    rows = grouped_rows(taxels)
    assert sorted(rows.ravel().tolist()) == list(range(taxels))
    walsh = walsh_matrix(taxels)
    assert np.array_equal(walsh @ walsh.T, taxels * np.eye(taxels))
    assert np.array_equal(walsh, hadamard(taxels)[rows.ravel()])


@pytest.mark.parametrize("taxels", [8, 16, 32, 64, 128])
def test_groups_are_parts_of_two_by_four_of_the_table_of_sequencies(taxels: int) -> None:
    high, wide = patch_shape(taxels)
    walsh = walsh_matrix(taxels).reshape(-1, 8, high, wide)
    assert len(walsh) == taxels // 8
    for group, rows in enumerate(walsh):
        first, beside = 2 * (group // (wide // 4)), 4 * (group % (wide // 4))
        down = (np.diff(rows[:, :, 0]) != 0).sum(axis=1).tolist()
        across = (np.diff(rows[:, 0]) != 0).sum(axis=1).tolist()
        expected = [(a, b) for a in (first, first + 1) for b in range(beside, beside + 4)]
        assert list(zip(down, across, strict=True)) == expected


def test_groups_of_less_than_eight_rows_are_refused() -> None:
    with pytest.raises(InputError, match="8 taxels or more, got 4"):
        grouped_rows(4)


@pytest.mark.parametrize("taxels", [8, 16, 32, 64])
def test_a_quarter_of_the_rows_gives_the_means_of_two_by_two_taxels(taxels: int) -> None:
    high, wide = patch_shape(taxels)
    patch = np.random.default_rng(1).uniform(size=(high, wide))
    rows = hadamard(taxels)[coarse_rows(taxels)]
    coarse = (rows.T @ (rows @ patch.ravel()) / taxels).reshape(high, wide)
    means = patch.reshape(high // 2, 2, wide // 2, 2).mean(axis=(1, 3)).repeat(2, 0).repeat(2, 1)
    assert coarse == pytest.approx(means, abs=1e-6)


@given(st.integers(3, 6), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_rows_of_low_sequency_tell_the_sums_of_the_halves_of_halves_of_a_patch_of_any_shape(
    log_taxels: int, missing: int, seed: int
) -> None:
    taxels, random = 2**log_taxels, np.random.default_rng(seed)
    positions = random.uniform(size=(taxels - min(missing, taxels // 2 - 1), 3))
    (patch,) = neighbours(positions, 1, taxels)
    high, wide = patch_shape(taxels)
    walsh = walsh_matrix(taxels).reshape(taxels, high, wide)
    down, across = ((np.diff(walsh, axis=axis)[:, *at] != 0).sum(axis=1) for axis, at in ((1, (..., 0)), (2, (0,))))
    force_n = np.zeros(taxels)
    force_n[: len(positions)] = random.uniform(size=len(positions))
    force_n = force_n[patch].reshape(high, wide)  # an empty place reads 0
    tall, broad = 1, 1
    while tall * broad <= taxels:
        low = walsh[(down < tall) & (across < broad)].reshape(-1, taxels)
        part = (high // tall, wide // broad)
        means = force_n.reshape(tall, part[0], broad, part[1]).mean(axis=(1, 3))
        assert low @ force_n.ravel() == pytest.approx(
            low @ means.repeat(part[0], 0).repeat(part[1], 1).ravel(), abs=1e-4
        )
        assert np.linalg.matrix_rank(low) == tall * broad
        tall, broad = (tall, 2 * broad) if part[1] > part[0] else (2 * tall, broad)
    axis = int(np.ptp(positions, axis=0).argmax())
    one, other = np.split(patch.reshape(high, wide), 2, axis=int(wide > high))
    there = [positions[half[half < len(positions)], axis] for half in (one, other)]
    assert there[0].max() <= there[1].min(initial=np.inf)  # the halves do not overlap


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
