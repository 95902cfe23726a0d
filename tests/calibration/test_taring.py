"""When the zero of a skin is measured, what is said of it, and what it is."""

import re

import numpy as np
import numpy.typing as npt
import pytest

from calibration.calibrator import Calibrator, TareResult
from calibration.field import FieldFinder
from canskin.calibration_messages import CalibrationState, ZeroSupport
from canskin.messages import Measurement
from skin.surface import grid_surface
from tests.calibration.helpers import (
    COUNTS,
    LAYOUT,
    NOISE_N,
    PHI,
    SMALL_COUNT_N,
    SMALL_PHI,
    SMALL_SUMS,
    Counts,
    Cycles,
    Skin,
    error_n,
    offsets_n,
    offsets_of,
    pressed,
    pressed_counts,
    still,
    tared,
)
from tests.surfaces import tube_layout

MS = 1_000_000
MEASURING, TOUCHED = CalibrationState.MEASURING, CalibrationState.TOUCHED
FOLLOWING, LOADED, OFF = CalibrationState.FOLLOWING, CalibrationState.LOADED, CalibrationState.OFF

Floats = npt.NDArray[np.float64]
ZERO = np.zeros(LAYOUT.taxels.count)
OFFSETS = offsets_n()
#: Noise of one sum.
SUM_NOISE_N = NOISE_N * LAYOUT.measurement.block_size**0.5


def place_of(text: str) -> tuple[int, int]:
    """Return the row and the column that a line of the log names."""
    found = re.search(r"around taxel \d+ \(row (\d+), column (\d+)\)", text)
    assert found is not None
    return int(found[1]), int(found[2])


def test_a_zero_takes_half_a_second_and_two() -> None:
    skin = Cycles()
    assert skin.made.state is MEASURING
    assert skin.made.tare_s == 2.0
    assert skin.run(10).offsets == b""
    assert skin.made.state is MEASURING
    assert skin.made.result is None
    assert not skin.said
    skin.run(0.1)  # the cycle that ends the tenth window
    assert skin.made.state is FOLLOWING
    assert offsets_of(skin.run(0.1)) == COUNTS.tolist()
    status = skin.made.status()
    # The middle of the window from 2275 to 2525 ms.
    assert status.tared_mono_ns == 2400 * MS
    assert (status.known_sums, status.revision, status.held_blocks, status.defects) == (SMALL_SUMS, 1, 0, [])
    assert status.offset_rms_n == pytest.approx(SMALL_COUNT_N * np.sqrt(np.mean(COUNTS.astype(np.float64) ** 2)))
    # Consecutive cycles differ by 6 counts: normal numbers of a deviation σ do by 2 σ / √π.
    assert status.noise_n == pytest.approx(6 * SMALL_COUNT_N * np.pi**0.5 / 2)
    assert status.drift_rms_n_per_s == 0


def test_what_is_said_of_a_zero() -> None:
    skin, offsets = Cycles(noise=300), 100 * COUNTS
    skin.run(10.1, offsets)
    rms_mn = 1e3 * SMALL_COUNT_N * np.sqrt(np.mean(offsets.astype(np.float64) ** 2))
    largest_mn = 1e3 * SMALL_COUNT_N * np.abs(offsets).max()
    noise_mn = 1e3 * 600 * SMALL_COUNT_N * np.pi**0.5 / 2
    words = f"zero of {SMALL_SUMS} of {SMALL_SUMS} sums: offsets {rms_mn:.2f} mN rms, up to {largest_mn:.2f} mN"
    words += f"; noise {noise_mn:.2f} mN"
    assert skin.said == [words]
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (True, words)


def test_a_zero_waits_for_half_of_the_sums() -> None:
    skin = Cycles()
    skin.missing = list(range(17))
    skin.run(12)
    assert skin.made.state is MEASURING
    assert skin.made.has_few_sums
    skin = Cycles()
    skin.missing = list(range(16))
    skin.run(10.1)
    assert skin.made.state is FOLLOWING
    assert skin.said[0].startswith(f"zero of {SMALL_SUMS // 2} of {SMALL_SUMS} sums")
    assert skin.said[0].endswith("; the others get theirs when nothing has touched them for 2 s")
    assert np.isnan(skin.made.offsets_n).sum() == SMALL_SUMS // 2  # type: ignore[arg-type]


def losing(skin: Cycles, windows: int, counts: Counts = COUNTS) -> Measurement:
    """Go on while every block in its turn misses two of 32 cycles, as it does after a lost frame."""
    for _ in range(10 * windows):
        skin.missing = [skin.cycle % 32, (skin.cycle - 1) % 32]
        applied = skin.run(0.1, counts)
    return applied


def test_lost_frames_leave_no_block_of_a_skin_at_rest_without_a_zero() -> None:
    skin = Cycles()
    losing(skin, 11)
    assert skin.made.state is FOLLOWING
    skin.missing = []
    touched = skin.run(1, COUNTS + pressed_counts(0, 0, 20, 300))
    assert touched.usable == b""
    assert np.abs(np.array(offsets_of(touched)) - COUNTS).max() <= 1


def test_a_touch_among_lost_frames_is_no_zero() -> None:
    skin = Cycles()
    losing(skin, 6)
    assert not losing(skin, 10, COUNTS + pressed_counts(0, 0, 20, 300)).offsets
    assert skin.made.state is TOUCHED


@pytest.mark.parametrize("late", [0, 4])
def test_an_even_drift_is_found_with_the_zero_and_foreseen(late: int) -> None:
    """Ten counts in each window of a quarter of a second."""
    skin = Cycles()
    skin.run(10.1 + late, drift=10.0)
    assert skin.made.status().drift_rms_n_per_s == pytest.approx(4 * 10 * SMALL_COUNT_N, rel=0.01)
    applied = skin.run(0.3, drift=10.0)
    expected = COUNTS + 10.0 * (skin.cycle - 1) / 10
    assert np.abs(np.array(offsets_of(applied)) - expected).max() <= 1.5


def test_a_touch_at_the_start_is_told_once_with_its_place() -> None:
    skin = Cycles()
    hand = COUNTS + pressed_counts(10, 20, 5, 300)
    skin.run(14, hand)
    assert skin.made.state is TOUCHED
    (words,) = skin.said
    row, column = place_of(words)
    assert 10 <= row < 15
    assert 20 <= column < 25
    assert words.endswith(": its zero is measured when it has been untouched for 2 s")
    assert skin.made.result == TareResult(is_done=False, text=words)
    assert skin.made.status().tared_mono_ns == 0
    skin.run(8.1, COUNTS)
    assert skin.made.state is FOLLOWING


def test_a_touch_during_a_later_zero_leaves_the_old_one() -> None:
    skin = tared()
    skin.made.tare()
    assert skin.made.result is None
    hand = COUNTS + pressed_counts(10, 20, 5, 300)
    assert np.abs(np.array(offsets_of(skin.run(8.2, hand))) - COUNTS).max() <= 1
    assert skin.made.state is FOLLOWING
    (words,) = skin.said[1:]
    assert 10 <= place_of(words)[0] < 15
    assert words.endswith(": the zero stays as it was")
    assert skin.made.result == TareResult(is_done=False, text=words)
    assert skin.made.status().revision == 1


def test_a_tare_that_is_refused_is_over_where_nothing_is_measured_unasked() -> None:
    skin = Cycles(tares=False)
    hand = COUNTS + pressed_counts(10, 20, 5, 300)
    skin.made.tare()
    skin.run(14, hand)
    assert skin.made.result is not None
    assert skin.made.result.text.endswith(": the zero stays as it was")
    assert skin.made.state is CalibrationState.OFF
    skin.run(20, COUNTS)
    assert skin.made.status().known_sums == 0


def test_a_forced_zero_takes_a_touch_for_its_own_once() -> None:
    skin = tared()
    hand = COUNTS + pressed_counts(10, 20, 5, 300)
    skin.made.tare(force=True)
    skin.run(8.2, hand)
    assert offsets_of(skin.run(0.1, hand)) == hand.tolist()
    assert skin.made.status().revision == 2
    skin.made.tare()
    skin.run(8.2, hand + pressed_counts(2, 2, 5, 300))
    assert skin.made.result is not None
    assert not skin.made.result.is_done  # the next is not forced


def test_a_zero_that_is_asked_for_anew_begins_anew() -> None:
    skin = Cycles()
    skin.run(7.1, COUNTS + 100)
    skin.made.tare()
    skin.run(7.9, COUNTS)
    assert skin.made.state is MEASURING
    skin.run(0.2, COUNTS)
    assert skin.made.state is FOLLOWING
    assert offsets_of(skin.run(0.1)) == COUNTS.tolist()
    assert skin.made.status().revision == 1


def test_loaded_offsets_hold_at_once_and_end_a_measurement() -> None:
    skin = Cycles()
    skin.run(5)
    known = np.where(np.arange(SMALL_SUMS) == 7, np.nan, COUNTS * SMALL_COUNT_N)
    skin.made.load(known)
    assert skin.made.state is MEASURING
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (False, "other offsets were loaded meanwhile")
    applied = skin.made.apply(skin.measured(COUNTS))
    assert offsets_of(applied) == np.where(np.arange(SMALL_SUMS) == 7, 0, COUNTS).tolist()
    assert np.flatnonzero(np.frombuffer(applied.usable, np.uint8) == 0).tolist() == [7]
    assert skin.made.status().revision == 1
    status = tared().made
    status.load(known)
    assert status.result is None  # nothing was being measured
    assert (status.status().revision, status.status().tared_mono_ns, status.status().drift_rms_n_per_s) == (2, 0, 0.0)


def test_forgotten_offsets_are_measured_as_at_the_start() -> None:
    skin = tared()
    skin.made.forget()
    assert (skin.made.state, skin.made.offsets_n, skin.made.result) == (MEASURING, None, None)
    assert skin.run(1).offsets == b""
    skin.made.forget()
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (False, "the nodes were written to meanwhile")
    assert skin.made.status().revision == 3
    skin.run(9.2)
    assert skin.made.status().revision == 4


def test_without_taring_nothing_is_learned_unless_it_is_asked_for() -> None:
    skin = Cycles(tares=False)
    assert skin.made.state is OFF
    skin.run(12)
    assert skin.made.state is OFF
    assert skin.made.offsets_n is None
    skin.made.load(COUNTS * SMALL_COUNT_N)
    assert skin.made.state is LOADED
    skin.made.forget()
    assert (skin.made.state, skin.made.offsets_n) == (OFF, None)
    skin.made.tare()
    assert skin.made.state is MEASURING
    skin.run(10.1)
    assert skin.made.state is LOADED
    assert offsets_of(skin.run(5, COUNTS + 100)) == COUNTS.tolist()  # nothing is followed


REGION, STANDING = (10, 10, 17, 17), pressed_counts(10, 10, 8, 80)


def felt_n(skin: Cycles, applied: Measurement) -> Floats:
    """Return the field of corrected sums, newtons, shape (32, 32)."""
    counts = np.frombuffer(applied.sums, "<i4") - np.frombuffer(applied.offsets, "<i4")
    finder = FieldFinder(SMALL_PHI, grid_surface(32, 32, 0.004, np.zeros(0, np.intp)))
    return finder.find(counts * SMALL_COUNT_N, np.ones(SMALL_SUMS, np.bool_), 1e-4).force_n.reshape(32, 32)


def test_a_region_is_tared_under_a_touch_elsewhere_and_its_zero_returns() -> None:
    hand, force_n = pressed_counts(22, 2, 8, 150), 80 * SMALL_COUNT_N
    skin = tared()
    skin.run(8, COUNTS + STANDING + hand)
    skin.made.tare(region=REGION)
    skin.run(8.2, COUNTS + STANDING + hand)
    assert skin.made.state is FOLLOWING
    assert skin.made.result is not None
    assert skin.made.result.is_done
    assert skin.made.result.text.startswith("zero of 64 taxels: moved by up to 1.")
    status = skin.made.status()
    assert status.revision == 2
    in_region = np.unique(SMALL_PHI.block_of_taxel.reshape(32, 32)[10:18, 10:18])
    told = np.flatnonzero(np.frombuffer(status.zero_support, np.uint8) == ZeroSupport.TOLD)
    assert told.tolist() == in_region.tolist()
    felt = felt_n(skin, skin.run(4, COUNTS + STANDING + hand))
    assert np.abs(felt[10:18, 10:18]).max() < 0.1 * force_n
    assert felt[22:30, 2:10].mean() == pytest.approx(150 * SMALL_COUNT_N, rel=0.05)
    skin.run(5, COUNTS + hand)
    felt = felt_n(skin, skin.run(1, COUNTS + hand))  # what stood in the region has left
    assert np.abs(felt[10:18, 10:18]).max() < 0.1 * force_n
    assert felt[22:30, 2:10].mean() == pytest.approx(150 * SMALL_COUNT_N, rel=0.05)
    skin.run(4, COUNTS)
    assert np.abs(felt_n(skin, skin.run(1, COUNTS))).max() < 0.05 * force_n


def test_a_region_of_a_skin_without_zero_is_refused() -> None:
    skin = Cycles()
    skin.made.tare(region=REGION)
    skin.run(10.1)
    assert skin.said[0] == "the skin has no zero yet: measure that of all of the skin first"
    assert skin.made.state is MEASURING
    skin.run(8.1)
    assert skin.made.state is FOLLOWING


def test_a_tube_of_positions_is_tared_and_what_stands_on_it_is_named_by_number_and_settled() -> None:
    layout, said = tube_layout(sync={"rate_hz": 40.0}, sampling={"rate_hz": 1000.0}), []
    skin: Skin[Calibrator] = Skin(Calibrator(layout, say=said.append), layout=layout)
    offsets = np.random.default_rng(1).uniform(0, 0.002, 480)
    positions_m = layout.taxels.surface.positions_m
    weight = 0.01 * np.exp(-(np.linalg.norm(positions_m - positions_m[245], axis=1) ** 2) / (2 * 0.008**2))
    skin.run(3.0, still(offsets))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    skin.run(9.0, still(offsets + weight))
    assert skin.calibrator.status().doubtful_taxels > 10
    named = int(re.search(r"a force around taxel (\d+) stands still", said[-1])[1])  # type: ignore[index]
    assert np.linalg.norm(positions_m[named] - positions_m[245]) < 0.008
    skin.calibrator.tare(region=(0, 190, 0, 310))  # from taxel 190 to 310
    skin.run(4.0, still(offsets + weight))
    assert said[-2].startswith("zero of 121 taxels")
    assert said[-1] == "no force is doubtful any more"


def test_a_faint_hand_that_moves_at_the_start_does_not_become_the_zero() -> None:
    skin = Skin(Calibrator(LAYOUT))
    skin.run(6.0, lambda time_s: OFFSETS + pressed(10, 10 + int(4 * time_s), 3, 0.001))
    assert skin.calibrator.state is CalibrationState.TOUCHED


def test_stored_offsets_are_used_under_a_hand_and_show_a_faint_touch() -> None:
    faint = pressed(30, 30, 3, 0.001)
    skin = Skin(Calibrator(LAYOUT, offsets_n=PHI.forward(OFFSETS)))
    last = skin.run(5.0, still(OFFSETS + faint))
    assert skin.calibrator.state is CalibrationState.TOUCHED
    assert error_n(last, faint) < 1.2 * SUM_NOISE_N
