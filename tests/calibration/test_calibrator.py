"""A skin with offsets that is tared at its start and followed."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.calibrator import Calibrator
from canskin.calibration_messages import CalibrationState
from skin.clipping import IDLE_MEAN
from skin.layout import load_layout, parse_layout
from skin.measured_sums import decode_measurement
from skin.taxel import NOISE_N as SENSOR_NOISE_N
from tests.calibration.skins import LAYOUT, NEWTON_PER_COUNT, NOISE_N, PHI, Skin, error_n, offsets_n, pressed

ZERO = np.zeros(LAYOUT.taxels.count)
OFFSETS = offsets_n()
#: Noise of one sum.
SUM_NOISE_N = NOISE_N * LAYOUT.measurement.block_size**0.5


def still(force: np.ndarray) -> Callable[[float], np.ndarray]:
    return lambda _time_s: force


def test_an_untouched_skin_reads_nothing_after_its_start() -> None:
    skin = Skin(Calibrator(LAYOUT))
    last = skin.run(4.0, still(OFFSETS))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N
    assert skin.calibrator.status().known_sums == PHI.shape[0]
    assert skin.calibrator.noise_n == pytest.approx(SUM_NOISE_N, rel=0.1)


def test_saturated_sums_have_no_part_in_the_zero() -> None:
    skin, ended = Skin(Calibrator(LAYOUT)), [100, 500]
    skin.run(4.0, still(OFFSETS), saturated=ended)
    offsets_n = skin.calibrator.offsets_n
    assert offsets_n is not None
    assert np.flatnonzero(~np.isfinite(offsets_n)).tolist() == ended
    last = skin.run(5.0, still(OFFSETS))
    assert not last.usable
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_saturated_sums_do_not_move_the_zero() -> None:
    skin, ended = Skin(Calibrator(LAYOUT)), [100, 500]
    skin.run(4.0, still(OFFSETS))
    skin.run(2.0, still(OFFSETS), saturated=ended)
    last = skin.run(0.1, still(OFFSETS))
    assert not last.usable
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_sum_that_stays_saturated_is_named() -> None:
    skin = Skin(Calibrator(LAYOUT))
    skin.run(4.0, still(OFFSETS))
    skin.run(5.0, still(OFFSETS), saturated=[500])
    (text,) = skin.calibrator.status().defects
    assert text == f"sum 500 (block 62, row {PHI.row_of_sum[500]}) is saturated and left out"


def test_before_its_zero_is_measured_a_skin_has_no_offsets() -> None:
    assert Skin(Calibrator(LAYOUT)).run(1.0, still(OFFSETS)).offsets == b""


def test_a_hand_at_the_start_does_not_become_the_zero() -> None:
    skin = Skin(Calibrator(LAYOUT))
    hand = pressed(10, 20, 20, 0.005)
    assert skin.run(6.0, still(OFFSETS + hand)).offsets == b""
    assert skin.calibrator.state is CalibrationState.TOUCHED
    assert skin.calibrator.result is not None
    assert not skin.calibrator.result.is_done
    last = skin.run(5.0, still(OFFSETS))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_faint_hand_that_moves_at_the_start_does_not_become_the_zero() -> None:
    skin = Skin(Calibrator(LAYOUT))
    skin.run(6.0, lambda time_s: OFFSETS + pressed(10, 10 + int(4 * time_s), 3, 0.001))
    assert skin.calibrator.state is CalibrationState.TOUCHED


def test_a_zero_measured_under_a_touch_is_measured_again_when_the_touch_ends() -> None:
    """Of a skin that was never calibrated, a still touch below the spread of the offsets cannot be seen."""
    skin, faint = Skin(Calibrator(LAYOUT)), pressed(30, 30, 3, 0.001)
    skin.run(4.0, still(OFFSETS + faint))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    last = skin.run(6.0, still(OFFSETS))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_zero_forced_under_a_hand_is_measured_again_when_the_hand_is_gone() -> None:
    """The offsets do not run after the hand, past the true zero."""
    skin, hand = Skin(Calibrator(LAYOUT)), pressed(10, 20, 20, 0.005)
    skin.calibrator.tare(force=True)
    assert error_n(skin.run(4.0, still(OFFSETS + hand)), ZERO) < 1.2 * SUM_NOISE_N
    last = skin.run(4.5, still(OFFSETS))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


@pytest.mark.heavy
def test_a_wrong_zero_under_a_hand_that_moves_is_told_ever_more_rarely() -> None:
    said: list[str] = []
    skin = Skin(Calibrator(LAYOUT, say=said.append))
    skin.run(4.0, still(OFFSETS + pressed(30, 30, 3, 0.002)))
    skin.run(60.0, lambda time_s: OFFSETS + pressed(5, 5 + 20 * (int(time_s / 1.1) % 2), 9, 0.0003))
    told = [each for each in said if each.startswith("forces below zero")]
    assert 1 <= len(told) <= 5


def test_stored_offsets_are_used_under_a_hand_and_show_a_faint_touch() -> None:
    faint = pressed(30, 30, 3, 0.001)
    skin = Skin(Calibrator(LAYOUT, offsets_n=PHI.forward(OFFSETS)))
    last = skin.run(5.0, still(OFFSETS + faint))
    assert skin.calibrator.state is CalibrationState.TOUCHED
    assert error_n(last, faint) < 1.2 * SUM_NOISE_N


def test_a_long_touch_leaves_the_zero_as_it_is() -> None:
    skin, touch = Skin(Calibrator(LAYOUT)), pressed(30, 30, 9, 0.005)
    skin.run(4.0, still(OFFSETS))
    last = skin.run(12.0, still(OFFSETS + touch))
    assert error_n(last, touch) < 1.5 * SUM_NOISE_N
    assert skin.calibrator.status().held_blocks > 0


def test_drift_is_followed_and_goes_on_under_a_touch() -> None:
    rate_n = np.random.default_rng(3).normal(0, 1e-3, LAYOUT.taxels.count)
    skin, touch = Skin(Calibrator(LAYOUT)), pressed(30, 30, 9, 0.005)
    last = skin.run(14.0, lambda time_s: OFFSETS + rate_n * time_s)
    assert error_n(last, ZERO) < 1.5 * SUM_NOISE_N
    expected = 1e-3 * LAYOUT.measurement.block_size**0.5
    assert skin.calibrator.status().drift_rms_n_per_s == pytest.approx(expected, rel=0.05)
    last = skin.run(5.0, lambda time_s: OFFSETS + rate_n * time_s + touch)
    assert error_n(last, touch) < 2 * SUM_NOISE_N


def test_a_user_can_tare_again_and_force_it() -> None:
    skin, hand = Skin(Calibrator(LAYOUT)), pressed(10, 20, 20, 0.005)
    skin.run(4.0, still(OFFSETS))
    skin.calibrator.tare()
    skin.run(4.0, still(OFFSETS + hand))
    assert skin.calibrator.result is not None
    assert not skin.calibrator.result.is_done
    assert "row" in skin.calibrator.result.text
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    skin.calibrator.tare(force=True)
    last = skin.run(4.0, still(OFFSETS + hand))
    assert skin.calibrator.result.is_done
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_block_that_comes_later_gets_its_zero_later() -> None:
    skin = Skin(Calibrator(LAYOUT))
    valid = np.arange(LAYOUT.blocks) > 0
    skin.run(4.0, still(OFFSETS), valid=valid)
    assert skin.calibrator.status().known_sums == PHI.shape[0] - 8
    last = skin.run(4.0, still(OFFSETS))
    assert skin.calibrator.status().known_sums == PHI.shape[0]
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_block_that_comes_under_a_touch_is_left_out_until_the_touch_ends() -> None:
    skin, late = Skin(Calibrator(LAYOUT)), 5
    touch = np.zeros(LAYOUT.taxels.count)
    touch[PHI.taxels_of_blocks[late]] = 0.02
    skin.run(4.0, still(OFFSETS), valid=np.arange(LAYOUT.blocks) != late)
    for _ in range(8):
        sums = decode_measurement(skin.run(0.5, still(OFFSETS + touch)), PHI)
        assert not sums.valid[late]
        assert not sums.counts[PHI.block_of_sum == late].any()
        assert sums.valid.sum() == LAYOUT.blocks - 1
    last = skin.run(4.0, still(OFFSETS))
    assert decode_measurement(last, PHI).valid.all()
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_without_measurements_offsets_go_on_for_a_minute_at_most() -> None:
    rate_n = np.random.default_rng(3).normal(0, 1e-3, LAYOUT.taxels.count)
    skin = Skin(Calibrator(LAYOUT))
    last = skin.run(10.0, lambda time_s: OFFSETS + rate_n * time_s)
    hour_ns = 3600 * 10**9
    later = [
        skin.calibrator.apply(msgspec.structs.replace(last, sampled_mono_ns=last.sampled_mono_ns + each)).offsets
        for each in (hour_ns, 2 * hour_ns)
    ]
    assert later[0] == later[1]


def test_a_zero_that_is_not_followed_has_no_drift() -> None:
    rate_n = np.random.default_rng(3).normal(0, 1e-3, LAYOUT.taxels.count)
    skin = Skin(Calibrator(LAYOUT, tares=False))
    skin.calibrator.tare()
    tared = skin.run(4.0, lambda time_s: OFFSETS + rate_n * time_s)
    assert skin.calibrator.state is CalibrationState.LOADED
    assert skin.run(4.0, still(OFFSETS)).offsets == tared.offsets


def test_loaded_offsets_are_used_until_a_zero_is_measured() -> None:
    skin, hand, wrong = Skin(Calibrator(LAYOUT)), pressed(10, 20, 20, 0.005), offsets_n(seed=1)
    skin.run(4.0, still(OFFSETS))
    skin.calibrator.load(PHI.forward(wrong))
    assert skin.calibrator.state is CalibrationState.MEASURING
    last = skin.run(4.0, still(OFFSETS + hand))
    assert skin.calibrator.state is CalibrationState.TOUCHED
    np.testing.assert_allclose(
        np.frombuffer(last.offsets, "<i4") * NEWTON_PER_COUNT, PHI.forward(wrong), atol=NEWTON_PER_COUNT
    )
    assert error_n(skin.run(4.0, still(OFFSETS)), ZERO) < 1.2 * SUM_NOISE_N


def test_without_tare_stored_offsets_stay() -> None:
    calibrator = Calibrator(LAYOUT, offsets_n=PHI.forward(OFFSETS), tares=False)
    last = Skin(calibrator).run(5.0, still(1.1 * OFFSETS))
    assert calibrator.state is CalibrationState.LOADED
    assert np.frombuffer(last.offsets, "<i4") * LAYOUT.taxels.newton_per_count == pytest.approx(
        PHI.forward(OFFSETS), abs=LAYOUT.taxels.newton_per_count
    )


def test_nodes_with_adaptive_sending_have_their_own_zero() -> None:
    assert Calibrator(load_layout(Path("adaptive"), adaptive=True)).state is CalibrationState.OFF


def test_the_mean_of_clipped_noise_is_no_offset_where_nodes_do_not_average() -> None:
    layout = parse_layout(b"[taxels]\nrows = 32\ncolumns = 32", "test")
    random = np.random.default_rng(0)
    skin = Skin(Calibrator(layout), layout=layout)

    def clipped(_time_s: float) -> np.ndarray:
        return np.maximum(random.normal(0, SENSOR_NOISE_N, layout.taxels.count), 0)

    last = skin.run(4.0, clipped)
    offsets_n = np.frombuffer(last.offsets, "<i4") * layout.taxels.newton_per_count
    totals = layout.phi().row_of_sum == 0
    assert totals.any()
    assert np.abs(offsets_n[totals]).mean() < 0.1 * layout.measurement.block_size * IDLE_MEAN * SENSOR_NOISE_N


def test_unclipped_noise_of_an_untouched_skin_has_no_mean() -> None:
    layout = parse_layout(b'[taxels]\nrows = 32\ncolumns = 32\nfrontend = "analogue"', "test")
    random = np.random.default_rng(0)
    skin = Skin(Calibrator(layout), layout=layout)
    last = skin.run(4.0, lambda _time_s: random.normal(0, SENSOR_NOISE_N, layout.taxels.count))
    offsets_n = np.frombuffer(last.offsets, "<i4") * layout.taxels.newton_per_count
    assert np.abs(offsets_n[layout.phi().row_of_sum == 0]).mean() < 0.5 * layout.measurement.block_size**0.5 * 1e-3


@pytest.mark.parametrize(
    ("force", "state", "windows"),
    [
        (ZERO, CalibrationState.FOLLOWING, 4),
        (pressed(10, 20, 20, 0.005), CalibrationState.TOUCHED, 8),
    ],
)
def test_cycles_are_asked_for_after_sixty_windows_without_any(
    force: np.ndarray, state: CalibrationState, windows: int
) -> None:
    """For a line through the fewest windows while the zero is followed, for a whole tare under a touch."""
    skin = Skin(Calibrator(LAYOUT))
    last = skin.run(6.0, still(OFFSETS + force))
    assert skin.calibrator.state is state
    window_ns, at_ns = skin.calibrator._windows.length_ns, last.sampled_mono_ns
    gaps = [gap for gap in range(80) if skin.calibrator.needs_cycles(at_ns + gap * window_ns)]
    assert gaps[0] == pytest.approx(60, abs=2)
    asked_ns = at_ns + gaps[-1] * window_ns
    skin.skip(gaps[-1] * window_ns * 1e-9)
    skin.run(1.0, still(OFFSETS + force))
    asks = [skin.calibrator.needs_cycles(asked_ns + late * window_ns) for late in range(20)]
    assert asks == [True] * windows + [False] * (20 - windows)


def test_noise_is_0_while_no_sum_is_known() -> None:
    skin = Skin(Calibrator(LAYOUT))
    skin.run(4.0, still(OFFSETS))
    skin.run(2.0, still(OFFSETS), valid=np.zeros(LAYOUT.blocks, np.bool_))
    assert skin.calibrator.status().noise_n == 0
