import numpy as np
import pytest

from canskin.errors import InputError
from touch.coarse_arrays import ARRAYS, SIDE_M, averaged, grid_of


def test_the_seven_arrays_have_the_papers_taxels() -> None:
    assert [side * side for side in ARRAYS] == [4096, 1024, 256, 64, 16, 4, 1]


@pytest.mark.parametrize("side", ARRAYS)
def test_every_array_spans_256_mm(side: int) -> None:
    grid = grid_of(side)
    assert (grid.rows, grid.columns) == (side, side)
    assert grid.half_extent_m == pytest.approx((0.128, 0.128))
    assert grid.taxel_radius_m == pytest.approx(SIDE_M / side / 2)
    assert grid_of(side, "averaged") == grid_of(64)


def test_averaged_cells_are_means() -> None:
    force_n = np.arange(2 * 4096, dtype=np.float32).reshape(2, 64, 64)
    halves = averaged(force_n, 2)
    assert halves[1, 0, 1] == pytest.approx(force_n[1, :32, 32:].mean(dtype=np.float64), rel=1e-6)
    for side in ARRAYS:
        cells = averaged(force_n, side)
        assert cells.shape == (2, side, side)
        assert cells.mean() == pytest.approx(force_n.mean(dtype=np.float64))
    np.testing.assert_array_equal(averaged(force_n, 64), force_n)


def test_unknown_arrays_are_refused() -> None:
    with pytest.raises(InputError, match=r"side 3.*64, 32"):
        grid_of(3)
    with pytest.raises(InputError, match=r"64, 64.*\(32, 32\)"):
        averaged(np.zeros((32, 32), np.float32), 8)
