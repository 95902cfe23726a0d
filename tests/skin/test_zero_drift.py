"""Where and when the zero drifts, what a press leaves behind, and what the option says."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from skin.defects import Defect, Defects, creep, parse_defects
from skin.layout import changed, load_layout
from skin.taxel import TaxelModel
from skin.zero_drift import ZeroDrift, parse_drifts

LAYOUT, ANALOGUE = (
    changed(load_layout(each), taxels={"force_max_n": 2.0}) for each in (Path("default"), Path("analogue"))
)
TAXELS = (64, 64)


def weights(text: str, seed: int = 0) -> np.ndarray:
    """Return what a step of 1 N at a place adds to every taxel."""
    (drift,), _ = parse_drifts([f"{text}:step:1"], seed, LAYOUT)
    return np.asarray(drift.offsets_n(TAXELS, np.zeros(1))[0])


def test_a_drift_has_a_place() -> None:
    assert (weights("whole") == 1).all()
    half = weights("half")
    assert (half[:, :32] == 1).all()
    assert not half[:, 32:].any()
    gradient = weights("gradient")
    np.testing.assert_array_equal(gradient[0], gradient[63])
    np.testing.assert_allclose(np.diff(gradient[0]), 1 / 63, rtol=1e-4)
    assert (gradient[0, 0], gradient[0, 63]) == (0, 1)
    patch = weights("patch12@52,8")
    assert patch.sum() == 144
    assert (patch[52:, 8:20] == 1).all()
    board = np.flatnonzero(weights("board5"))
    assert set(board) == set(LAYOUT.phi().taxels_of_blocks[5])
    np.testing.assert_array_equal(weights("converter5"), weights("board5"))


def test_the_seed_and_the_place_in_the_list_place_a_patch() -> None:
    first, same, other = weights("patch12", 1), weights("patch12", 1), weights("patch12", 2)
    assert first.sum() == other.sum() == 144
    np.testing.assert_array_equal(first, same)
    assert (first != other).any()
    (one, two), _ = parse_drifts(["patch12:step:1"] * 2, 1, LAYOUT)
    assert (one.offsets_n(TAXELS, np.zeros(1)) != two.offsets_n(TAXELS, np.zeros(1))).any()


@pytest.mark.parametrize(
    ("text", "times_s", "expected"),
    [
        ("step:-2:5", [0, 4.99, 5, 100], [0, 0, -2, -2]),
        ("ramp:2:10:60", [0, 10, 40, 70, 1000], [0, 0, 1, 2, 2]),
        ("ramp:2", [30, 60], [1, 2]),
        ("exponential:2:10:20", [0, 10, 30, 1e4], [0, 0, 2 * (1 - np.exp(-1)), 2]),
        ("daily:2", [0, 21_600, 43_200, 64_800], [0, 2, 0, -2]),
        ("daily:2:5:40", [0, 5, 15, 35], [0, 0, 2, -2]),
    ],
)
def test_a_drift_has_a_course(text: str, times_s: list[float], expected: list[float]) -> None:
    (drift,), _ = parse_drifts([f"whole:{text}"], 0, LAYOUT)
    offsets_n = drift.offsets_n(TAXELS, np.array(times_s, float))
    assert offsets_n.dtype == np.float32
    assert offsets_n.shape == (len(times_s), *TAXELS)
    np.testing.assert_allclose(offsets_n[:, 3, 4], expected, atol=1e-5)


def test_a_converter_behind_analogue_sums_shifts_its_sums() -> None:
    phi = ANALOGUE.phi()
    (taxels,), (sums,) = parse_drifts(["converter5:step:1", "board5:step:1"], 0, ANALOGUE)
    assert (
        np.flatnonzero(sums.offsets_n(phi.shape[:1], np.zeros(1))[0]).tolist()
        == np.flatnonzero(phi.block_of_sum == 5).tolist()
    )
    assert set(taxels.cells) == set(phi.taxels_of_blocks[5])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected PLACE:COURSE:AMOUNT_N"),
        ("whole:step:-2.1", "expected an amount of at most 2 N, the range of a taxel, got -2.1"),
        ("nose:step:1", "expected PLACE:COURSE:AMOUNT_N.* with PLACE of whole, half"),
        ("whole:jump:1", "COURSE of step, ramp"),
        ("whole:step", "expected PLACE:COURSE"),
        ("whole:ramp:1:2:3:4", "expected PLACE:COURSE"),
        ("whole:ramp:1:", "expected numbers after ramp, got '1:'"),
        ("whole:ramp:nan", "amount_n needs a number: got nan"),
        ("whole:ramp:1:-1", "start_s needs a number of 0 or more"),
        ("whole:ramp:1:0:0", "duration_s needs a number above 0"),
        ("whole:step:1:0:5", "duration_s needs no number with step"),
        ("patch:step:1", "patchSIDE"),
        ("patch65:step:1", "expected a patch within 64 x 64 taxels"),
        ("patch0:step:1", "of a side of 1 or more"),
        ("patch12@53,0:step:1", "expected a patch within 64 x 64 taxels"),
        ("board128:step:1", "expected a block from 0 to 127, got 128"),
    ],
)
def test_a_wrong_drift_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(InputError, match=f"^--drift {text}: .*{says}") as error:
        parse_drifts(["whole:step:0", text], 0, LAYOUT)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("place", "course"), [("nose", "step"), ("whole", "jump")])
def test_a_program_names_place_and_course(place: str, course: str) -> None:
    with pytest.raises(InputError, match="expected one of whole"):
        ZeroDrift(place, course, 1.0)  # type: ignore[arg-type]


def test_drifts_are_added_to_the_force_before_the_range() -> None:
    defects = parse_defects([], ["half:step:0.004", "whole:step:-0.001"], 0, LAYOUT)
    signal = TaxelModel(0.0, defects=defects).signal(
        np.zeros((1, *TAXELS), np.float32), np.random.default_rng(0), period_s=1.0
    )
    np.testing.assert_allclose(signal[0, :, :32], 0.003, atol=1e-8)
    assert not signal[0, :, 32:].any()


@pytest.mark.parametrize("period_s", [0.01, 1.0])
def test_a_press_of_ten_minutes_leaves_a_low_zero_that_recovers(period_s: float) -> None:
    force_n = np.full((round(600 / period_s), 1), 0.01, np.float32)
    pressed, memory_n = creep(0.05, force_n, 0.0, period_s)
    assert pressed[0, 0] == pytest.approx(0.01, abs=1e-5)
    assert pressed[-1, 0] == pytest.approx(0.0105, abs=1e-6)
    assert (np.diff(pressed[:, 0]) >= -1e-9).all()
    released, _ = creep(0.05, np.zeros((round(30 / period_s), 1), np.float32), memory_n, period_s)
    assert released[0, 0] == pytest.approx(-0.0005 * np.exp(-period_s / 30), rel=0.01)
    assert released[-1, 0] == pytest.approx(-0.0005 * np.exp(-1), rel=0.01)


def test_creep_has_no_jumps_and_none_without_force() -> None:
    _, memory_n = creep(0.1, np.full((1000, 1), 0.01, np.float32), 0.0, 1.0)
    falling = np.linspace(0.011, 0.009, 2001, dtype=np.float32)
    readings_n = np.array([creep(0.1, force[None, None], memory_n, 1e-6)[0][0, 0] for force in falling])
    assert np.abs(np.diff(readings_n)).max() < 1.5e-6
    rested, memory_n = creep(0.1, np.zeros((3, 2), np.float32), 0.0, 1.0)
    assert not rested.any()
    assert not memory_n.any()


def test_creep_is_a_defect_of_one_amount() -> None:
    assert parse_defects(["creep"], [], 0, LAYOUT) == Defects((Defect("creep", 0.05),))
    with pytest.raises(InputError, match="--defect creep: ratio needs a number from 0 to 1"):
        parse_defects(["creep=2"], [], 0, LAYOUT)
    force_n = np.full((120, 1, 1), 0.01, np.float32)
    model = TaxelModel(0.0, defects=Defects.of({"creep": 0.05}))
    signal = model.signal(force_n, np.random.default_rng(0), period_s=10.0)
    np.testing.assert_array_equal(signal, creep(0.05, force_n, 0.0, 10.0)[0])
