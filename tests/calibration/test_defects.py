"""Defects are found in the sums, named, and left out: from which window and how much noise on, and no earlier."""

import numpy as np
import numpy.typing as npt
import pytest

from calibration.defects import DefectFinder, Defects
from calibration.windows import Window
from skin.phi import sbhe
from tests import surfaces
from tests.calibration.helpers import LAYOUT, PHI

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

NOISE_N, LEAST_N = 1e-4, 1e-6
NO_TOUCH = np.zeros(PHI.blocks, np.bool_)
ALL = np.ones(PHI.shape[0], np.bool_)
FULL_N = LAYOUT.taxels.force_max_n
#: Sums of some force, and of taxels that are all at an end of the range.
SOME, NONE = np.full(PHI.shape[0], 0.01), np.zeros(PHI.shape[0])
FULL = np.asarray(PHI.forward(np.full(PHI.shape[1], FULL_N)), np.float64)


def of_blocks(changed: dict[int, float]) -> Floats:
    """Return noise of all sums that is 1 but for some blocks, in units of the usual noise."""
    times = np.ones(PHI.shape[0])
    for block, each in changed.items():
        times[PHI.block_of_sum == block] = each
    return times


class Finder:
    """A finder that gets windows of the same noise, sum by sum."""

    def __init__(self) -> None:
        self._finder = DefectFinder(PHI, LAYOUT.taxels.surface, LEAST_N, lambda _: None, FULL_N)

    def take(
        self,
        windows: int,
        times: Floats,
        *,
        known: Bools | None = None,
        held: Bools = NO_TOUCH,
        difference_n: Floats | None = None,
        mean_n: Floats = NONE,
    ) -> Defects:
        known = np.ones(PHI.shape[0], np.bool_) if known is None else known
        nothing = np.zeros(PHI.shape[0])
        made = Window(0, mean_n, NOISE_N * times, nothing if difference_n is None else difference_n, known)
        for _ in range(windows):
            self._finder.take(made, held)
        return self._finder.found

    @property
    def still(self) -> list[int]:
        return np.flatnonzero(self._finder.stands_still).tolist()


def named(found: Defects) -> list[str]:
    return [" ".join(text.split(" (")[0].split()[:2]) for text in found.words]


def all_but(*sums: int) -> Bools:
    return ~np.isin(np.arange(PHI.shape[0]), sums)


@pytest.mark.parametrize(("still", "told"), [((16, 17), ["sum 16", "sum 17"]), ((16, 17, 18), [])])
def test_sums_are_stuck_while_three_quarters_of_the_others_of_their_block_move(
    still: tuple[int, ...], told: list[str]
) -> None:
    """Of seven others, six are enough and five are not."""
    finder = Finder()
    moving = all_but(*still).astype(np.float64)
    assert named(finder.take(11, moving)) == []
    found = finder.take(1, moving)
    assert named(found) == told
    assert np.flatnonzero(~found.usable).tolist() == list(still[: len(told)])
    assert named(finder.take(1, np.ones(PHI.shape[0]))) == []  # they have moved
    assert named(finder.take(11, moving)) == []
    assert named(finder.take(1, moving)) == told


def test_windows_in_which_others_rest_tell_nothing_of_a_stuck_sum() -> None:
    finder = Finder()
    finder.take(11, all_but(16).astype(np.float64))
    assert named(finder.take(30, np.zeros(PHI.shape[0]))) == []
    assert named(finder.take(30, all_but(16).astype(np.float64), known=all_but(16, 17, 18))) == []
    assert named(finder.take(1, all_but(16).astype(np.float64))) == ["sum 16"]


@pytest.mark.parametrize(("ended", "told"), [((40, 44), ["sum 40", "sum 44"]), ((40, 44, 47), [])])
def test_sums_are_saturated_while_three_quarters_of_their_block_are_not(
    ended: tuple[int, ...], told: list[str]
) -> None:
    finder, times = Finder(), np.ones(PHI.shape[0])
    assert named(finder.take(11, times, known=all_but(*ended))) == []
    found = finder.take(1, times, known=all_but(*ended))
    assert named(found) == told
    assert all(text.endswith("is saturated and left out") for text in found.words)
    assert np.flatnonzero(~found.usable).tolist() == list(ended[: len(told)])
    assert named(finder.take(1, times)) == []


def test_a_touch_ends_what_tells_of_saturation() -> None:
    finder, times, missing = Finder(), np.ones(PHI.shape[0]), all_but(40)
    finder.take(11, times, known=missing)
    finder.take(1, times, known=missing, held=PHI.block_of_sum[40] == np.arange(PHI.blocks))
    assert named(finder.take(12, times, known=missing)) == []  # a release falls into the first
    assert named(finder.take(1, times, known=missing)) == ["sum 40"]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({5: 1.74}, []),
        ({5: 1.76}, ["block 5 has 1.8 times the noise"]),
        ({5: 3.9}, ["block 5 has 3.9 times the noise"]),
        ({5: 0.334}, []),
        ({5: 0.333}, ["block 5 has less than 1/3 of the noise: do its taxels measure?"]),
    ],
)
def test_a_block_is_named_above_seven_quarters_or_below_a_third_of_the_noise_of_all(
    changed: dict[int, float], told: list[str]
) -> None:
    # A difference of all taxels alike names none of them.
    even = np.asarray(PHI.forward(np.full(PHI.shape[1], NOISE_N)), np.float64)
    finder, times = Finder(), of_blocks(changed)
    assert finder.take(39, times, difference_n=even).words == []
    found = finder.take(1, times, difference_n=even)
    assert found.words == told
    assert found.usable.all()


@pytest.mark.parametrize(("times", "told"), [(3.9, []), (4.1, ["sum 100"])])
def test_a_sum_is_left_out_above_four_times_the_noise_of_all(times: float, told: list[str]) -> None:
    noise = np.ones(PHI.shape[0])
    noise[100] = times
    finder = Finder()
    assert finder.take(39, noise).usable.all()
    found = finder.take(1, noise)
    assert [each for each in named(found) if each.startswith("sum")] == told
    assert np.flatnonzero(~found.usable).tolist() == [100] * len(told)
    words = f"sum 100 (block 12, row {PHI.row_of_sum[100]}) is noisy and left out"
    assert found.words[: len(told)] == [words] * len(told)


def test_noise_is_the_mean_of_forty_windows_and_follows_later_ones_by_a_fortieth() -> None:
    """The mean square of half the windows with twice the noise is 2.5; √2.5 is 1.58."""
    finder = Finder()
    finder.take(20, np.ones(PHI.shape[0]))
    assert finder.take(20, of_blocks({5: 2.0})).words == []
    squares = 4 - 1.5 * (1 - 1 / 40) ** np.arange(1, 50)
    loud = [bool(finder.take(1, of_blocks({5: 2.0})).words) for _ in squares]
    assert loud == (np.sqrt(squares) > 1.75).tolist()
    assert 10 < loud.index(True) < 40


def test_windows_under_a_touch_and_of_its_release_do_not_count() -> None:
    finder = Finder()
    held = np.arange(PHI.blocks) == 5
    finder.take(39, of_blocks({5: 3.0}))
    assert finder.take(5, of_blocks({5: 3.0}), held=held).words == []
    assert finder.take(1, of_blocks({5: 3.0})).words == []
    assert named(finder.take(1, of_blocks({5: 3.0}))) == ["block 5"]


def apart() -> tuple[int, int]:
    """Return two taxels of block 5 whose signs agree in half of its sums."""
    taxels = PHI.taxels_of_blocks[5].tolist()
    signs = np.asarray(PHI.forward(np.eye(PHI.shape[1])[taxels]), np.float64)
    products = signs @ signs.T
    first, second = np.argwhere(products == 0)[0]
    return taxels[first], taxels[second]


@pytest.mark.parametrize(("ratio", "is_named"), [(1.24, False), (1.26, True)])
def test_a_taxel_is_named_when_it_has_a_quarter_more_than_the_next(ratio: float, is_named: bool) -> None:
    first, second = apart()
    finder, times = Finder(), of_blocks({5: 3.0})
    one_n = np.zeros((2, PHI.shape[1]))
    one_n[0, first], one_n[1, second] = NOISE_N * ratio**0.5, NOISE_N
    differences_n = np.asarray(PHI.forward(one_n), np.float64)
    for turn in range(40):
        found = finder.take(1, times, difference_n=differences_n[turn % 2])
    row, column = divmod(first, 64)
    place = f", most likely of taxel {first} (row {row}, column {column})" if is_named else ""
    assert found.words == [f"block 5 has 3.0 times the noise{place}"]


def test_blocks_without_or_with_a_single_sum_are_left_in_peace() -> None:
    """Three sums of four blocks: a block of one has no others, that may tell that it is stuck."""
    phi = sbhe(64, 3, block_size=16)
    finder = DefectFinder(phi, surfaces.grid(8, 8), LEAST_N, lambda _: None, FULL_N)
    noise_n = np.array([NOISE_N, 0.0, NOISE_N])
    window = Window(0, np.zeros(3), noise_n, np.zeros(3), np.ones(3, np.bool_))
    for _ in range(39):
        finder.take(window, np.zeros(4, np.bool_))
    assert finder.found.usable.all()
    assert finder.found.words == []
    finder.take(window, np.zeros(4, np.bool_))
    (text,) = finder.found.words
    assert text.startswith(f"block {phi.block_of_sum[1]} ")


def test_noise_of_a_block_is_that_of_each_of_its_sums() -> None:
    """Blocks of one to several sums: that of one sum has 0.45 times the noise of the others, which is no defect."""
    phi = next(
        each
        for each in (sbhe(64, 9, block_size=16, selection="uniform", seed=seed) for seed in range(100))
        if sorted(np.diff(each.starts).tolist())[:2] == [1, 2]
    )
    finder = DefectFinder(phi, surfaces.grid(8, 8), LEAST_N, lambda _: None, FULL_N)
    nothing, single = np.zeros(9), np.diff(phi.starts)[phi.block_of_sum] == 1
    window = Window(0, nothing, NOISE_N * np.where(single, 0.45, 1.0), nothing, np.ones(9, np.bool_))
    for _ in range(45):
        finder.take(window, np.zeros(4, np.bool_))
    assert single.sum() == 1
    assert finder.found.words == []


#: All sums change but those of block 5, whose others stand still.
STILL = of_blocks({5: 0.0})


@pytest.mark.parametrize(
    ("noise", "learns", "mean_n", "known", "windows", "still"),
    [
        (1.0, 40, SOME, ALL, 11, []),
        (1.0, 40, SOME, ALL, 12, [5]),
        (1.0, 40, SOME, ALL, 1000, [5]),  # what stands still teaches no noise
        (1.0, 28, SOME, ALL, 12, []),
        (0.0099, 40, SOME, ALL, 1000, []),  # only rounded
        (1.0, 40, NONE, ALL, 1000, []),
        (1.0, 40, FULL, ALL, 1000, []),
        (1.0, 40, SOME, all_but(int(PHI.starts[5])), 1000, []),
    ],
)
def test_a_block_with_noise_stands_still_when_no_sum_of_it_changes(
    noise: float, learns: int, mean_n: Floats, known: Bools, windows: int, still: list[int]
) -> None:
    finder = Finder()
    finder.take(learns, noise * np.ones(PHI.shape[0]), mean_n=mean_n)
    finder.take(windows, noise * STILL, mean_n=mean_n, known=known)
    assert finder.still == still
    finder.take(1, noise * np.ones(PHI.shape[0]), mean_n=mean_n)
    assert finder.still == []


def test_a_block_that_has_stood_still_before_has_to_stand_still_for_four_times_as_long() -> None:
    finder = Finder()
    finder.take(40, np.ones(PHI.shape[0]), mean_n=SOME)
    finder.take(4, STILL, mean_n=SOME)
    finder.take(1, np.ones(PHI.shape[0]), mean_n=SOME)
    for windows, still in ((15, []), (1, [5])):
        finder.take(windows, STILL, mean_n=SOME)
        assert finder.still == still
