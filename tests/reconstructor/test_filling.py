"""Unknown sums are filled in from the forces around; `pytest -s` prints the table of docs/reconstruction.md."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from canskin.errors import InputError
from reconstructor.stepped import SteppedImager
from reconstructor.walsh import WalshReconstructor
from skin.measured_sums import SteppedSums, decode_stepped
from skin.psnr import decibels
from skin.sources import DEFAULT_OBJECTS, load_touches
from skin.walsh import grouped_rows, neighbours, walsh_matrix
from tests.layouts import STEPPED, STEPPED_SKIN, small_layout
from tests.messages import stepped_measurement

PHI = STEPPED_SKIN.phi()
BLOCKS, SIZE = PHI.kept.shape
COUNT_N = STEPPED_SKIN.taxels.newton_per_count
#: Images until a new state of the skin is fully shown: at ten images a second, half a second.
SETTLING = 5


@cache
def touches() -> np.ndarray:
    """Forces of whole counts, (touches, n)."""
    force_n = load_touches(DEFAULT_OBJECTS, 20, STEPPED_SKIN, seed=3).force_n.reshape(20, -1)
    return np.rint(force_n / COUNT_N) * COUNT_N


def sums_of(force_n: np.ndarray, known: np.ndarray | None = None) -> SteppedSums:
    return decode_stepped(stepped_measurement(force_n, known, layout=STEPPED_SKIN), PHI)


def dead(ratio: float, seed: int = 0) -> np.ndarray:
    """Known sums of a skin with some dead blocks."""
    known = np.ones((BLOCKS, SIZE), np.bool_)
    known[np.random.default_rng(seed).permutation(BLOCKS)[: round(ratio * BLOCKS)]] = False
    return known


def coarse(ratio: float, seed: int = 0) -> np.ndarray:
    """Known sums of a skin of which some blocks have sent group 0 alone."""
    known = np.ones((BLOCKS, SIZE), np.bool_)
    some = np.random.default_rng(seed).permutation(BLOCKS)[: round(ratio * BLOCKS)]
    known[np.ix_(some, np.setdiff1d(np.arange(SIZE), grouped_rows(SIZE)[0]))] = False
    return known


@pytest.mark.parametrize(
    ("name", "drawn", "ratio", "gain_db"),
    [
        ("all sums", dead, 0.0, 0.0),
        ("1 % of the nodes dead", dead, 0.01, 3.0),
        ("5 % of the nodes dead", dead, 0.05, 8.0),
        ("20 % of the nodes dead", dead, 0.2, 8.0),
        ("group 0 alone of half of the nodes", coarse, 0.5, 2.5),
    ],
)
def test_filling_beats_zeros(
    name: str, drawn: Callable[[float, int], np.ndarray], ratio: float, gain_db: float
) -> None:
    errors_n2 = []
    for seed, force_n in enumerate(touches()):
        sums = sums_of(force_n, drawn(ratio, seed))
        images = (shown(sums), shown(sums._replace(known=np.ones_like(sums.known))))
        errors_n2.append([float(np.mean((image.reshape(-1) - force_n) ** 2)) for image in images])
    filled_db, zeros_db = decibels(np.mean(errors_n2, axis=0), 0.02)
    print(f"\n| {name} | {filled_db:.1f} | {zeros_db:.1f} |")
    assert filled_db >= zeros_db + gain_db


def shown(sums: SteppedSums) -> np.ndarray:
    solver = SteppedImager(STEPPED_SKIN)
    for _ in range(SETTLING):
        image = solver.solve(sums)[0]
    return image


def test_with_every_sum_it_is_the_image_of_the_evaluation() -> None:
    sums = sums_of(touches()[0])
    plain, service = WalshReconstructor(STEPPED_SKIN.patches(), 64, 64, 1e-3), SteppedImager(STEPPED_SKIN)
    sums_n = (sums.counts.astype(np.float32) * np.float32(COUNT_N)).reshape(BLOCKS, SIZE)
    grouped = np.ascontiguousarray(sums_n[:, grouped_rows(SIZE).ravel()])
    for _ in range(3):
        np.testing.assert_array_equal(service.solve(sums)[0], plain.solve(grouped))


def test_patches_with_empty_places() -> None:
    """The known sums of a mat of 10 x 10 taxels show a smooth touch, also with a group of every patch missing."""
    cells = neighbours(np.stack(np.divmod(np.arange(100), 10), axis=1), 4, SIZE)
    row, column = np.mgrid[:10, :10]
    force_n = (0.012 * np.exp(-((row - 4) ** 2 + (column - 6) ** 2) / 12)).astype(np.float32)
    sums_n = np.append(force_n.ravel(), np.zeros(28, np.float32))[cells] @ walsh_matrix(SIZE).T
    solver = WalshReconstructor([cells], 10, 10, 0.0)
    np.testing.assert_allclose(solver.solve(sums_n), force_n, atol=1e-7)
    known = np.ones(cells.shape, np.bool_)
    known[:, 24:] = False
    for _ in range(SETTLING):
        image_n = solver.solve(np.where(known, sums_n, 1.0).astype(np.float32), known)
    assert np.sqrt(np.mean((image_n - force_n) ** 2)) < 2e-4


def test_nothing_is_filled_in_across_a_gap() -> None:
    """A touch at the edge of one patch, and sums that are missing in the patch beside."""
    layout = small_layout(8, 17, **STEPPED, taxels={"shape": ["########.########"] * 8})
    cells, gap = np.concatenate(layout.patches()), ~layout.phi().is_wired
    force_n = np.zeros((8, 17), np.float32)
    force_n[2:6, 5:8] = 0.01
    sums_n = np.append(force_n.ravel(), np.zeros(layout.phi().empty, np.float32))[cells] @ walsh_matrix(SIZE).T
    known = np.ones(cells.shape, np.bool_)
    known[(cells % 17 > 8).all(axis=1), 1:] = False
    assert not known.all()
    solver = WalshReconstructor([cells], 8, 17, 1e-3)
    for _ in range(20 * SETTLING):
        image_n = solver.solve(sums_n.astype(np.float32), known)
    assert not image_n.ravel()[gap].any()
    assert image_n[:, 9:].max() < 1e-5
    assert image_n[2:6, 7].min() > 0.009


def test_known_sums_are_kept() -> None:
    known = coarse(0.5) & dead(0.05)
    cells = np.concatenate(STEPPED_SKIN.patches())
    solver = WalshReconstructor([cells], 64, 64, 0.0)
    # Forces far from 0, so that none is clipped.
    force_n = 0.01 + 0.2 * touches()[1]
    sums_n = np.asarray(PHI.forward(force_n.astype(np.float32))).reshape(BLOCKS, SIZE)
    rows = grouped_rows(SIZE).ravel()
    image = solver.solve(sums_n[:, rows], known[:, rows])
    made = np.asarray(PHI.forward(image.reshape(-1))).reshape(BLOCKS, SIZE)
    np.testing.assert_allclose(made[known], sums_n[known], atol=1e-5)


def test_old_forces_vanish_within_a_few_images() -> None:
    known, solver = dead(0.2), SteppedImager(STEPPED_SKIN)
    for _ in range(SETTLING):
        solver.solve(sums_of(np.full(4096, 0.015), known))
    for _ in range(SETTLING):
        image = solver.solve(sums_of(np.zeros(4096), known))[0]
    # What is left is less than a tenth of the sensor's noise.
    assert image.max() < 1e-4


def test_a_dead_skin_shows_nothing() -> None:
    solver = SteppedImager(STEPPED_SKIN)
    solver.solve(sums_of(touches()[0]))
    nothing = np.zeros((BLOCKS, SIZE), np.bool_)
    assert not solver.solve(sums_of(touches()[0], nothing))[0].any()
    # One known patch says nothing of forces at the other end of the skin.
    nothing[0] = True
    image = solver.solve(sums_of(np.full(4096, 0.01), nothing))[0]
    assert image[0, 0] > 0.005
    assert image[-16:, -16:].max() < 1e-3


def test_noise_that_is_not_known_is_the_sensors() -> None:
    sums = sums_of(touches()[0])
    known, unknown = shown(sums), shown(sums._replace(noise_n=0.0))
    np.testing.assert_array_equal(known, unknown)
    assert not np.array_equal(known, shown(sums._replace(noise_n=2e-3)))


def test_known_of_another_shape_is_refused() -> None:
    solver = WalshReconstructor(STEPPED_SKIN.patches(), 64, 64, 0.0)
    with pytest.raises(InputError, match="known: expected booleans of shape"):
        solver.solve(np.zeros((BLOCKS, SIZE), np.float32), np.ones(4096, np.bool_))
