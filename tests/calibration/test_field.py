"""The field of sums: what neighbouring taxels share, above zero and below."""

import numpy as np
import numpy.typing as npt
import pytest

from calibration.field import SEEN_RATIO, Field, FieldFinder
from skin.phi import sbhe
from skin.surface import grid_surface, surface_of_positions
from tests.calibration.helpers import COLUMNS, PHI, ROWS, pressed

#: Of a sum.
NOISE_N = 1e-4
ALL = np.ones(PHI.shape[0], np.bool_)
FINDER = FieldFinder(PHI, grid_surface(ROWS, COLUMNS, 0.004, np.zeros(0, np.intp)))
#: From which force on a taxel is seen.
LEAST_N = SEEN_RATIO * FINDER.picture_gain * NOISE_N

Floats = npt.NDArray[np.float64]


def noise_n(seed: int = 0) -> Floats:
    return np.random.default_rng(seed).normal(0, NOISE_N, PHI.shape[0])


def found(sums_n: Floats, known: npt.NDArray[np.bool_] = ALL) -> Field:
    return FINDER.find(np.where(known, sums_n, 0.0), known, 1e-6)


def test_sums_of_a_field_are_those_of_the_skin() -> None:
    force_n = np.random.default_rng(1).normal(0, 1, PHI.shape[1])
    assert FINDER.sums(force_n) == pytest.approx(PHI.forward(force_n))


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_gives_no_field(seed: int) -> None:
    field = found(noise_n(seed))
    assert np.abs(field.force_n).max() < LEAST_N
    assert field.noise_n == pytest.approx(NOISE_N, rel=0.1)


def test_white_offsets_of_taxels_give_no_field() -> None:
    """They are noise of their own size to the sums."""
    offsets_n = np.random.default_rng(2).normal(0, 1e-3, PHI.shape[1])
    field = found(np.asarray(PHI.forward(offsets_n), np.float64))
    assert field.noise_n == pytest.approx(1e-3 * 32**0.5, rel=0.1)
    assert np.abs(field.force_n).max() < SEEN_RATIO * FINDER.picture_gain * field.noise_n


def test_forces_of_both_signs_are_found_within_their_noise() -> None:
    force_n = pressed(10, 10, 9, 2e-3) + pressed(40, 35, 12, -1e-3)
    field = found(PHI.forward(force_n) + noise_n())
    assert np.abs(field.force_n - force_n).max() < 3 * LEAST_N
    assert field.force_n.sum() == pytest.approx(force_n.sum(), abs=0.02 * np.abs(force_n).sum())
    assert field.noise_n == pytest.approx(NOISE_N, rel=0.2)


@pytest.mark.parametrize("force_n", [pressed(2, 2, 60, 1e-3), pressed(0, 0, 64, 1e-3), pressed(0, 0, 64, -1e-3)])
def test_a_wide_press_is_found(force_n: Floats) -> None:
    assert np.abs(found(PHI.forward(force_n) + noise_n()).force_n - force_n).max() < 3 * LEAST_N


def test_a_shift_of_a_board_s_total_is_no_field() -> None:
    shift_n = np.where(
        (PHI.row_of_sum == 0) & (PHI.block_of_sum == np.flatnonzero(PHI.row_of_sum == 0)[0] // 8), 32e-3, 0
    )
    touch_n = pressed(10, 10, 9, 2e-3)
    field = found(PHI.forward(touch_n) + shift_n + noise_n())
    assert np.count_nonzero(shift_n) == 1
    assert not FINDER.opened(np.abs(field.force_n - touch_n) > 3 * LEAST_N).any()


def test_unknown_sums_have_no_part_in_it() -> None:
    known = np.random.default_rng(3).random(PHI.shape[0]) < 0.8
    force_n = pressed(10, 10, 9, 2e-3)
    sums_n = PHI.forward(force_n) + noise_n()
    field = found(sums_n, known)
    assert np.abs(field.force_n - force_n).max() < 3 * LEAST_N
    other = FINDER.find(np.where(known, sums_n, 7.0), known, 1e-6)
    assert other.force_n.tolist() == field.force_n.tolist()


def test_without_sums_there_is_no_field() -> None:
    field = found(noise_n(), ~ALL)
    assert not field.force_n.any()
    assert field.noise_n == 1e-6


def test_lone_taxels_are_left_out_on_any_skin() -> None:
    """On triangles: a ring of six around one stays, a path of five and a pair go."""
    row, column = np.divmod(np.arange(64), 8)
    places = 0.004 * np.stack((column + 0.5 * (row % 2), row * 3**0.5 / 2, np.zeros(64)), axis=1)
    surface = surface_of_positions(places.tolist())
    ring = np.linalg.norm(places - places[27], axis=1) < 0.005
    path = (row == 7) & (column < 5)
    pair = (row == 0) & (column > 5)
    phi = sbhe(64, 16, block_size=32)
    assert np.array_equal(FieldFinder(phi, surface).opened(ring | path | pair), ring)
