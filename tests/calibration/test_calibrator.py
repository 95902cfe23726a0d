"""A skin with offsets that is tared at its start and followed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration.calibrator import Calibrator
from skin.calibration_messages import CalibrationState
from skin.clipping import IDLE_MEAN
from skin.layout import load_layout, parse_layout
from skin.taxel import NOISE_N as SENSOR_NOISE_N
from tests.calibration.skins import LAYOUT, NOISE_N, PHI, Skin, error_n, offsets_n, pressed

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
