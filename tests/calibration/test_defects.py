"""Defects are found in the sums, named, and left out."""

import numpy as np
import pytest

from calibration.calibrator import Calibrator
from calibration.defects import MEMORY, STUCK_WINDOWS, DefectFinder, Defects
from calibration.windows import Window
from tests.calibration.skins import COLUMNS, LAYOUT, PHI, Skin, offsets_n

NOISE_N = 1e-4
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
    assert any(text.startswith(("block 3 has 6.", "block 3 has 5.9")) for text in found.words)
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
