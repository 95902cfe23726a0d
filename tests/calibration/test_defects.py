"""Defects are found in the sums, named, and left out: from which window and how much noise on, and no earlier."""

import numpy as np
import numpy.typing as npt
import pytest

from calibration.calibrator import Calibrator
from calibration.defects import MEMORY, STUCK_WINDOWS, DefectFinder, Defects, subject_of
from calibration.windows import Window
from skin.measurement import sbhe
from tests.calibration.skins import COLUMNS, LAYOUT, PHI, Skin, offsets_n

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

NOISE_N, LEAST_N = 1e-4, 1e-6
NO_TOUCH = np.zeros(PHI.blocks, np.bool_)
ALL = np.ones(PHI.shape[0], np.bool_)


def window(seed: int, taxel_noise_n: np.ndarray, stuck: int | None = None) -> Window:
    """Return the noise of 25 cycles of a skin."""
    random = np.random.default_rng(seed)
    sums = PHI.forward(random.normal(0, taxel_noise_n, (26, PHI.shape[1])))
    differences = np.diff(sums, axis=0)
    if stuck is not None:
        differences[:, stuck] = 0
    noise_n = np.abs(differences).mean(axis=0) * np.pi**0.5 / 2
    return Window(0, np.zeros(PHI.shape[0]), noise_n, differences[-1], ALL)


def looked_at(windows: int, taxel_noise_n: np.ndarray, stuck: int | None = None) -> Defects:
    finder = DefectFinder(PHI, COLUMNS, 1e-6)
    for seed in range(windows):
        found = finder.take(window(seed, taxel_noise_n, stuck), NO_TOUCH)
    return found


@pytest.fixture
def even() -> np.ndarray:
    return np.full(PHI.shape[1], NOISE_N)


def test_a_good_skin_has_no_defects(even: np.ndarray) -> None:
    found = looked_at(MEMORY + 5, even)
    assert found.usable.all()
    assert found.words == []


def test_a_stuck_sum_is_named_and_left_out(even: np.ndarray) -> None:
    assert looked_at(STUCK_WINDOWS - 1, even, stuck=77).usable.all()
    found = looked_at(STUCK_WINDOWS, even, stuck=77)
    assert np.flatnonzero(~found.usable).tolist() == [77]
    assert found.words == [f"sum 77 (block 9, row {PHI.row_of_sum[77]}) is stuck and left out"]


@pytest.mark.parametrize("taxel", [1120, 2213, 3000])
def test_a_noisy_taxel_is_named(even: np.ndarray, taxel: int) -> None:
    even[taxel] *= 12
    found = looked_at(MEMORY + 5, even)
    row, column = divmod(taxel, COLUMNS)
    assert len(found.words) == 1
    assert f"most likely of the taxel at row {row}, column {column}" in found.words[0]
    assert found.usable.all()


def test_sums_with_too_much_noise_are_left_out_and_a_silent_block_is_named(even: np.ndarray) -> None:
    even[PHI.taxels_of_blocks[3]] *= 6
    even[PHI.taxels_of_blocks[5]] *= 0.1
    found = looked_at(MEMORY + 5, even)
    assert np.flatnonzero(~found.usable).tolist() == list(range(24, 32))
    assert any(text.startswith("block 3 has 5.") for text in found.words)
    assert any(text.startswith("block 5 has less than 1/3 of the noise") for text in found.words)


def test_changes_under_a_touch_are_no_noise(even: np.ndarray) -> None:
    finder = DefectFinder(PHI, COLUMNS, 1e-6)
    held = np.arange(PHI.blocks) == 3
    for seed in range(MEMORY + 5):
        noise_n = even.copy()
        noise_n[PHI.taxels_of_blocks[3]] *= 20 if seed % 2 else 1
        found = finder.take(window(seed, noise_n), held if seed % 2 else NO_TOUCH)
    assert found.words == []


def test_an_untouched_skin_without_noise_has_no_stuck_sums() -> None:
    finder = DefectFinder(PHI, COLUMNS, 1e-6)
    for _ in range(2 * STUCK_WINDOWS):
        found = finder.take(window(0, np.zeros(PHI.shape[1])), NO_TOUCH)
    assert found.usable.all()


def test_a_sum_that_gets_stuck_is_left_out_of_measurements() -> None:
    said: list[str] = []
    skin = Skin(Calibrator(LAYOUT, say=said.append), stuck=500)
    offsets = offsets_n()
    skin.run(3.0, lambda _: offsets)
    last = skin.run(5.0, lambda _: offsets)
    assert np.flatnonzero(np.frombuffer(last.usable, np.uint8) == 0).tolist() == [500]
    assert sum("sum 500" in text for text in said) == 1
    assert skin.calibrator.status().defects[0].startswith("sum 500")


def of_blocks(changed: dict[int, float]) -> Floats:
    """Return noise of all sums that is 1 but for some blocks, in units of the usual noise."""
    times = np.ones(PHI.shape[0])
    for block, each in changed.items():
        times[PHI.block_of_sum == block] = each
    return times


class Finder:
    """A finder that gets windows of the same noise, sum by sum."""

    def __init__(self, least_n: float = LEAST_N) -> None:
        self._finder = DefectFinder(PHI, COLUMNS, least_n)

    def take(
        self,
        windows: int,
        times: Floats,
        *,
        known: Bools | None = None,
        held: Bools = NO_TOUCH,
        difference_n: Floats | None = None,
    ) -> Defects:
        known = np.ones(PHI.shape[0], np.bool_) if known is None else known
        nothing = np.zeros(PHI.shape[0])
        made = Window(0, nothing, NOISE_N * times, nothing if difference_n is None else difference_n, known)
        for _ in range(windows):
            found = self._finder.take(made, held)
        return found


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


def test_noise_below_the_least_is_no_defect() -> None:
    assert Finder(least_n=NOISE_N).take(40, of_blocks({5: 0.1})).words == []
    assert named(Finder(least_n=0.99 * NOISE_N).take(40, of_blocks({5: 0.1}))) == ["block 5"]
    assert Finder(least_n=2 * NOISE_N).take(40, of_blocks({5: 3.4})).words == []
    (text,) = Finder(least_n=2 * NOISE_N).take(40, of_blocks({5: 3.6})).words
    assert text.startswith("block 5 has 1.8 times the noise")


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


def test_a_block_of_which_too_few_sums_come_is_not_judged() -> None:
    finder = Finder()
    few = all_but(40, 41, 42)
    assert finder.take(50, of_blocks({5: 3.0}), known=few).words == []


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
    place = f", most likely of the taxel at row {row}, column {column}" if is_named else ""
    assert found.words == [f"block 5 has 3.0 times the noise{place}"]


def test_blocks_without_or_with_a_single_sum_are_left_in_peace() -> None:
    """Three sums of four blocks: a block of one has no others, that may tell that it is stuck."""
    phi = sbhe(64, 3, block_size=16)
    finder = DefectFinder(phi, 8, LEAST_N)
    noise_n = np.array([NOISE_N, 0.0, NOISE_N])
    window = Window(0, np.zeros(3), noise_n, np.zeros(3), np.ones(3, np.bool_))
    for _ in range(39):
        found = finder.take(window, np.zeros(4, np.bool_))
    assert found.usable.all()
    assert found.words == []
    (text,) = finder.take(window, np.zeros(4, np.bool_)).words
    assert subject_of(text) == f"block {phi.block_of_sum[1]}"


def test_a_sum_whose_only_other_moves_is_stuck_too() -> None:
    phi = sbhe(64, 8, block_size=16)
    finder = DefectFinder(phi, 8, LEAST_N)
    nothing, ones = np.zeros(8), np.ones(8, np.bool_)
    window = Window(0, nothing, np.array([0.0, 1, 1, 1, 1, 1, 1, 1]), nothing, ones)
    for _ in range(12):
        found = finder.take(window, np.zeros(4, np.bool_))
    assert np.flatnonzero(~found.usable).tolist() == [0]


def test_noise_of_a_block_is_that_of_each_of_its_sums() -> None:
    """Blocks of one to several sums: that of one sum has 0.45 times the noise of the others, which is no defect."""
    phi = next(
        each
        for each in (sbhe(64, 9, block_size=16, selection="uniform", seed=seed) for seed in range(100))
        if sorted(np.diff(each.starts).tolist())[:2] == [1, 2]
    )
    finder = DefectFinder(phi, 8, LEAST_N)
    nothing, single = np.zeros(9), np.diff(phi.starts)[phi.block_of_sum] == 1
    window = Window(0, nothing, NOISE_N * np.where(single, 0.45, 1.0), nothing, np.ones(9, np.bool_))
    for _ in range(45):
        found = finder.take(window, np.zeros(4, np.bool_))
    assert single.sum() == 1
    assert found.words == []


def test_at_the_very_limit_nothing_is_a_defect() -> None:
    times = of_blocks({5: 1.75})
    times[100] = 4.0
    finder = DefectFinder(PHI, COLUMNS, LEAST_N)
    nothing = np.zeros(PHI.shape[0])
    window = Window(
        0, nothing, times, nothing, np.ones(PHI.shape[0], np.bool_)
    )  # of 1 N: squares are whole numbers of 1/16 N²
    for _ in range(40):
        found = finder.take(window, NO_TOUCH)
    assert found.usable.all()
    assert not any("block 5" in text for text in found.words)


def test_what_a_sum_that_is_not_known_shows_names_no_taxel() -> None:
    first, _ = apart()
    missing = 5 * 8 + 2
    one_n = np.zeros(PHI.shape[1])
    one_n[first] = NOISE_N
    difference_n = np.asarray(PHI.forward(one_n), np.float64)
    difference_n[missing] = 1e3
    found = Finder().take(40, of_blocks({5: 3.0}), known=all_but(missing), difference_n=difference_n)
    row, column = divmod(first, 64)
    (text,) = (each for each in found.words if each.startswith("block 5"))
    assert text.endswith(f"most likely of the taxel at row {row}, column {column}")


def test_a_defect_is_told_once_by_its_first_two_words() -> None:
    assert subject_of("sum 77 (block 9, row 3) is stuck and left out") == "sum 77"
    assert subject_of("block 3 has 6.0 times the noise") == "block 3"
