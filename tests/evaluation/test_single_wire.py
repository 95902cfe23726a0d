"""Data of a single-wire skin, made here: codes, images, verdicts, and folders that lack something."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from canskin.errors import InputError
from evaluation.result import Options
from evaluation.single_wire import JUDGED, OURS, SIZES, STEP, drawn_codes, evaluate, read_press, support

FRAMES, PRESSES = 1000, 10
#: Press 6, the first that is judged, begins at this frame of codes.
FIRST = 1003


def codes_by_hand(frame: int) -> np.ndarray:
    """The codes of a frame of weights, one number of the generator after another."""
    codes = np.empty((100, 100), np.int8)
    for taxel in range(100):
        state = taxel + 8
        for _ in range(100 * frame):
            state = (1664525 * state + 1013904223) % 2**32
        for place in range(100):
            state = (1664525 * state + 1013904223) % 2**32
            codes[place, taxel] = state // 2**24 >= 128
    return codes


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone with one object, a ring, that is pressed from frame 150 on; the sums of another are not there."""
    folder = tmp_path_factory.mktemp("wire")
    inside = folder / "Data_Analysis" / "Measurements_Collected" / "ring"
    inside.mkdir(parents=True)
    row, column = np.indices((10, 10))
    ring = np.where(abs(np.hypot(row - 4.5, column - 4.5) - 3) < 1, 0.8, 0.0).ravel()
    scans = np.zeros((100, 600, PRESSES))
    scans[:, 599, 9] = ring
    noise, pressed = np.random.default_rng(1), np.arange(FRAMES) >= 150
    sums = np.full((100, FRAMES, 6), np.nan)
    signs = 2.0 * drawn_codes(FIRST - 1000, FRAMES) - 1
    sums[..., 5] = ((signs @ ring) * pressed[:, None] - 0.2 + noise.normal(0, 0.15, (FRAMES, 100))).T
    sums[3, 520, 5] = np.nan  # a sum that did not come
    savemat(inside / "ring_random2.mat", {"C": sums})
    savemat(inside / "ring_random2_time.mat", {"framePosition": np.full((1, 6), FIRST, np.uint16)})
    savemat(inside / "ring_raster.mat", {"D": scans})
    learned = folder / "Data_Analysis" / "Dictionary_Learning"
    learned.mkdir()
    savemat(learned / "dictionary.mat", {"Dksvd": np.eye(100)})
    (inside.parent / "comb").mkdir()
    (inside.parent / "comb" / "comb_random2.mat").touch()
    return folder


def test_codes_are_those_of_the_published_generator(data: Path) -> None:
    np.testing.assert_array_equal(drawn_codes(2, 1)[0], codes_by_hand(2))
    press = read_press(data / "Data_Analysis", "ring", 5)
    np.testing.assert_array_equal(press.codes[0], codes_by_hand(3))
    assert press.sums.shape == (JUDGED.stop, 100)


def test_a_taxel_is_touched_above_a_part_of_the_largest() -> None:
    assert support(np.array([0.0, 0.22, 0.24, 1.0])).tolist() == [False, False, True, True]


def test_our_solver_and_pursuit_are_judged_on_the_same_frames(data: Path) -> None:
    found = evaluate(Options(quick=True, recordings=data))
    figures = {(row["method"], row["sums"]): row for row in found.rows}
    assert len({row["method"] for row in found.rows}) == 5
    assert {row["images"] for row in found.rows} == {len(JUDGED) // (2 * STEP)}
    for size in SIZES:
        assert figures[OURS, size]["support"] > 0.98
        assert figures[OURS, size]["unseen_error"] < figures["pursuit, codes ±1", size]["unseen_error"]
    # A taxel whose code is 0 is subtracted: codes of 0 and 1 do not fit the sums.
    signed, plain = (figures[f"pursuit, codes {codes}", SIZES[-1]] for codes in ("±1", "0/1"))
    assert signed["unseen_error"] < plain["unseen_error"]
    assert "Objects: ring. Left out, without sums that can be read: comb." in found.note


def test_folders_that_lack_something_are_one_clear_error(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no Measurements_Collected in"):
        evaluate(Options(recordings=tmp_path))
    (tmp_path / "Measurements_Collected").mkdir()
    with pytest.raises(InputError, match="expected a folder for each object NAME"):
        evaluate(Options(recordings=tmp_path))
    broken = tmp_path / "Measurements_Collected" / "ring"
    broken.mkdir()
    for what in ("random2", "random2_time", "raster"):
        (broken / f"ring_{what}.mat").write_bytes(b"no matrix")
    with pytest.raises(InputError, match=r"ring_random2\.mat' cannot be read as \.mat"):
        evaluate(Options(recordings=tmp_path))
    savemat(broken / "ring_random2.mat", {"C": np.zeros((100, 700, 2))})
    with pytest.raises(InputError, match=r"array 'C': expected at least \(100, 700, 6\), got \(100, 700, 2\)"):
        read_press(tmp_path, "ring", 5)
