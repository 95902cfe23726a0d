"""What stands out of the picture of the sums, as a slow look at every square has it."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from calibration.touched import Touch, TouchFinder
from skin.measurement import Sbhe, sbhe
from tests.calibration.skins import COLUMNS, PHI, ROWS, pressed

Floats = npt.NDArray[np.float64]
NO_BLOCK = np.zeros(1, np.bool_)


class Squares(NamedTuple):
    """Largest mean of a square and of a negative one, in deviations; place of the largest; touched blocks."""

    score: float
    release: float
    place: tuple[int, int]
    blocks: list[int]


def look_slowly(phi: Sbhe, shape: tuple[int, int], sums_n: Floats, noise_n: float) -> Squares:
    """Look at every square of 3, 5, 9 and 17 taxels that is no wider than the skin; nothing is beyond its border."""
    used = sums_n.copy()
    totals = np.flatnonzero(phi.row_of_sum == 0)
    if totals.size:
        used[totals] -= np.median(sums_n[totals])
    picture = (np.asarray(phi.adjoint(used), np.float64) / phi.block_size).reshape(shape)
    # A taxel's value is the sum of as many sums as a block has, over the taxels of the block.
    of_noise = noise_n * (phi.shape[0] / phi.blocks) ** 0.5 / phi.block_size
    deviation = max(1.4826 * float(np.median(np.abs(picture))), of_noise)
    score, release, place = 0.0, 0.0, (0, 0)
    near = set[tuple[int, int]]()
    for width in (3, 5, 9, 17):
        if width > min(shape):
            continue
        reach = width // 2
        padded = np.pad(picture, reach)
        for row in range(shape[0]):
            for column in range(shape[1]):
                mean = padded[row : row + width, column : column + width].sum() / width / deviation
                if mean > score:
                    score, place = mean, (row, column)
                release = max(release, -mean)
                if mean > 7:
                    far = reach + 2  # taxels, along the grid
                    near |= {
                        (row + down, column + right)
                        for down in range(-far, far + 1)
                        for right in range(-far, far + 1)
                        if abs(down) + abs(right) <= far
                    }
    of_taxel = phi.block_of_taxel.reshape(shape)
    inside = [each for each in near if 0 <= each[0] < shape[0] and 0 <= each[1] < shape[1]]
    return Squares(float(score), float(release), place, sorted({int(of_taxel[each]) for each in inside}))


#: A skin of 5 x 16 taxels in patches of 16: a square of 5 fits, one of 9 does not.
NARROW = sbhe(80, 40, block_size=16)


def narrow(row: int, column: int, width: int, force_n: float) -> Floats:
    force = np.zeros((5, 16))
    force[row : row + width, column : column + width] = force_n
    return np.asarray(NARROW.forward(force.ravel()), np.float64)


def compare(phi: Sbhe, shape: tuple[int, int], sums_n: Floats, noise_n: float) -> Touch:
    """Return what the finder finds; raises AssertionError if a slow look finds something else."""
    slow = look_slowly(phi, shape, sums_n, noise_n)
    found = TouchFinder(phi, *shape).look(sums_n, np.ones(phi.shape[0], np.bool_), noise_n)
    assert (found.score, found.release_score) == pytest.approx((slow.score, slow.release), rel=1e-6)
    assert (found.row, found.column) == slow.place
    assert np.flatnonzero(found.blocks).tolist() == slow.blocks
    return found


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("width", "force_n"), [(1, 4e-3), (3, 1e-3), (5, 1e-3), (5, -1e-3)])
def test_squares_of_a_narrow_skin(seed: int, width: int, force_n: float) -> None:
    random = np.random.default_rng(seed)
    column = int(random.integers(0, 16 - width))
    noise = random.normal(0, 1e-4, NARROW.shape[0])
    sums_n = noise + narrow(int(random.integers(0, 6 - width)), column, width, force_n)
    compare(NARROW, (5, 16), sums_n, 1e-4)  # as the noise is
    compare(NARROW, (5, 16), sums_n, 1e-3)  # the noise is taken to be more


@pytest.mark.parametrize(("width", "force_n"), [(3, 3e-4), (9, 1e-4), (24, 1e-4)])
def test_squares_of_the_default_skin(width: int, force_n: float) -> None:
    noise = np.random.default_rng(width).normal(0, 2e-4, PHI.shape[0])
    found = compare(PHI, (ROWS, COLUMNS), noise + PHI.forward(pressed(30, 20, width, force_n)), 2e-4)
    assert found.is_touched


def test_a_square_stands_out_above_seven_deviations() -> None:
    sums_n = narrow(1, 6, 3, 1e-3)
    score = look_slowly(NARROW, (5, 16), sums_n, 1.0).score  # in deviations of a noise of 1 N
    finder, known = TouchFinder(NARROW, 5, 16), np.ones(NARROW.shape[0], np.bool_)
    below, above = (finder.look(sums_n, known, score / limit) for limit in (6.99, 7.01))
    assert (below.score, above.score) == pytest.approx((6.99, 7.01))
    assert (below.is_touched, above.is_touched) == (False, True)
    assert not below.blocks.any()
    assert above.blocks.any()


def test_a_skin_that_reads_nothing_is_not_touched() -> None:
    found = TouchFinder(NARROW, 5, 16).look(np.zeros(NARROW.shape[0]), np.ones(NARROW.shape[0], np.bool_), 0.0)
    assert found[:2] == (0.0, 0.0)
    assert (found.row, found.column) == (0, 0)
    assert (found.is_touched, found.is_negative) == (False, False)
    assert not found.blocks.any()


def test_a_skin_without_room_for_a_square_is_not_touched() -> None:
    phi = sbhe(32, 32, block_size=16)
    found = TouchFinder(phi, 2, 16).look(np.full(32, 1.0), np.ones(32, np.bool_), 1e-3)
    assert found[:2] == (0.0, 0.0)


def test_sums_that_are_not_known_have_no_part_in_the_picture() -> None:
    sums_n = narrow(1, 6, 3, 1e-3)
    known = NARROW.row_of_sum != 0
    with_others = np.where(known, sums_n, 1e3)
    found = TouchFinder(NARROW, 5, 16).look(with_others, known, 1e-3)
    slow = look_slowly(NARROW, (5, 16), np.where(known, sums_n, 0.0), 1e-3)
    assert found.score == pytest.approx(slow.score)
    assert with_others.max() == 1e3  # the caller's sums are as they were


def test_blocks_are_held_above_the_limit_and_not_at_it() -> None:
    """The noise is such that the score is 7, as near as numbers can tell."""
    finder, known = TouchFinder(NARROW, 5, 16), np.ones(NARROW.shape[0], np.bool_)
    sums_n = narrow(1, 6, 3, 1.0)
    score = finder.look(sums_n, known, 1e3).score
    exact = finder.look(sums_n, known, 1e3 * score / 7).score
    held = finder.look(sums_n, known, 1e3 * score / 7).blocks.any()
    assert held == (exact > 7)


@pytest.mark.parametrize(
    ("score", "release", "told"),
    [
        (7.0, 0.0, (False, False)),
        (7.1, 7.1, (True, False)),
        (7.1, 7.2, (False, True)),
        (9.0, 7.5, (True, False)),
        (0.0, 7.0, (False, False)),
        (0.0, 7.1, (False, True)),
        (6.9, 6.8, (False, False)),
    ],
)
def test_a_touch_stands_out_at_least_as_much_as_what_is_below_zero(
    score: float, release: float, told: tuple[bool, bool]
) -> None:
    touch = Touch(score, release, NO_BLOCK, 0, 0)
    assert (touch.is_touched, touch.is_negative) == told
