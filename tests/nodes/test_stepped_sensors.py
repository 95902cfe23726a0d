"""What the taxels of stepped boards read, and when."""

import numpy as np
import pytest

from dbc.board_sums import PATTERN_FULL, PATTERN_RAMP
from dbc.patch_filter import SAMPLE_NS
from nodes.electronics import Calibration
from nodes.steps.sensors import DRIFT_PPM, STEP_NS, PatchSensors
from skin.clipping import IDLE_DEVIATION, IDLE_MEAN
from skin.defects import NO_DEFECTS, Defects, creep
from skin.layout import Taxels
from skin.sources import Frame
from skin.taxel import TaxelModel
from skin.zero_drift import ZeroDrift

#: Fine enough to see times.
TAXELS = Taxels(rows=16, columns=16, adc_bits=16)
SHAPE = (16, 16)
CELLS = np.arange(256).reshape(8, 32)
BEGIN_NS = 5_000_000_000


class Ramp:
    """A force that grows by 0.1 mN in each step of 10 ms, for 100 steps."""

    has_noise = False

    def frame(self, step: int) -> Frame:
        return Frame(np.full(SHAPE, 1e-4 * min(step, 100), np.float32), "")


def sensors(
    noise_n: float = 0.0, seed: int = 1, calibration: Calibration | None = None, defects: Defects = NO_DEFECTS
) -> PatchSensors:
    model = TaxelModel(noise_n, TAXELS.force_max_n, defects)
    return PatchSensors(calibration or Calibration(TAXELS), CELLS, model, Ramp(), seed=1)


def sampled_at_ms(board: PatchSensors, tick: int) -> np.ndarray:
    """Return the instants, after the touch began, of a tick's samples; a board samples all its taxels at once."""
    sample_n = board.sample(BEGIN_NS + tick * SAMPLE_NS)
    assert np.ptp(sample_n, axis=1).max() < 1e-6
    return np.asarray(sample_n.mean(axis=1) * 1e5)


def test_an_untouched_skin_reads_clipped_noise() -> None:
    board = sensors(1e-3)
    samples_n = np.stack([board.sample(0) for _ in range(200)])
    assert samples_n.mean() == pytest.approx(1e-3 * IDLE_MEAN, rel=0.02)
    assert samples_n.std() == pytest.approx(1e-3 * IDLE_DEVIATION, rel=0.02)
    assert samples_n.max() > 3.8e-3
    frames_n = samples_n - samples_n.mean(axis=0)
    assert abs(np.mean(frames_n[1:] * frames_n[:-1])) < 0.02 * frames_n.var()


def test_every_board_samples_at_its_own_instant_of_the_last_millisecond() -> None:
    board = sensors()
    board.sample(0)
    board.touch_from_ns = BEGIN_NS
    late = np.array([tick - sampled_at_ms(board, tick) for tick in range(20, 120)])
    assert late.min() > -0.15
    assert late.max() < 1.15
    assert np.ptp(late.mean(axis=0)) > 0.3
    jitter = np.std(late - late.mean(axis=0))
    assert 0.01 < jitter < 0.03


def test_clocks_drift_and_a_whole_sample_is_skipped_or_repeated() -> None:
    board = sensors()
    board.touch_from_ns = BEGIN_NS
    before = 50 - sampled_at_ms(board, 50)
    for _ in range(4999):
        board.sample(0)
    moved = 50 - sampled_at_ms(board, 50) - before
    limit = 5000 * DRIFT_PPM * 1e-6 + 0.15
    whole = np.round(moved)
    assert np.abs(moved - whole).max() < limit
    assert np.ptp(moved - whole) > 0.2
    assert set(whole) <= {-1, 0, 1}


def test_the_touch_may_be_looked_at_anywhere() -> None:
    board = sensors()
    board.touch_from_ns = BEGIN_NS
    for tick in (3, 700, 701, 12, 995, 2000):
        expected = min(tick, 1000)
        assert sampled_at_ms(board, tick) == pytest.approx(expected, abs=1.2)


def test_defects_show_as_in_synchronous_nodes() -> None:
    made = Defects.of({"stuck": 0.02, "dead": 0.02, "saturated": 0.02, "gain_spread": 0.2, "drift": 1e-3}, 4)
    board = sensors(defects=made)
    board.touch_from_ns = BEGIN_NS
    step = 90
    shown = np.zeros(256)
    shown[CELLS] = board.sample(BEGIN_NS + step * STEP_NS)
    model = TaxelModel(0.0, TAXELS.force_max_n, made)
    moments_n, time_s = Ramp().frame(step).force_n[None], np.array([step * 0.01])
    expected = model.signal_of_moments(moments_n, np.random.default_rng(0), time_s).ravel()
    assert shown == pytest.approx(expected, abs=3e-5)


def test_a_damper_adds_the_force_of_the_interval() -> None:
    board = sensors(defects=Defects.of({"damper": 0.01}, 0))
    board.touch_from_ns = BEGIN_NS
    # 10 mN/s, 1 N/m: 10 mm/s; times 0.01 N s/m.
    assert board.sample(BEGIN_NS + 50 * STEP_NS) == pytest.approx(0.005 + 1e-4, abs=2e-5)
    assert board.sample(BEGIN_NS + 150 * STEP_NS) == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize("jump", [1, 7])
def test_creep_follows_the_touch_whatever_is_left_out(jump: int) -> None:
    board = sensors(defects=Defects.of({"creep": 0.2}))
    board.touch_from_ns = BEGIN_NS
    for step in range(0, 3000, jump):
        shown = board.sample(BEGIN_NS + step * STEP_NS)
    expected, _ = creep(0.2, np.stack([Ramp().frame(each).force_n[:1, 0] for each in range(step + 1)]), 0.0, 0.01)
    assert expected[-1] > 0.0107
    assert shown == pytest.approx(expected[-1, 0], abs=2e-5)


def test_drifts_of_places_follow_the_time_of_the_touch() -> None:
    board = sensors(
        defects=Defects(zero_drifts=(ZeroDrift("cells", "ramp", 0.004, 10.0, 10.0, cells=tuple(CELLS[3])),))
    )
    assert not board.sample(0).any()
    board.touch_from_ns = BEGIN_NS
    for time_s, expected in ((10, 0.01), (15, 0.012), (30, 0.014)):
        shown = board.sample(BEGIN_NS + time_s * 100 * STEP_NS)
        assert shown[3] == pytest.approx(expected, abs=1e-5)
        assert shown[2] == pytest.approx(0.01, abs=1e-5)


def test_corrections_and_patterns_take_effect_when_they_are_read() -> None:
    calibration = Calibration(TAXELS)
    board = sensors(calibration=calibration)
    board.touch_from_ns = BEGIN_NS
    tick_ns = BEGIN_NS + 2_000_000_000
    calibration.gain[CELLS[1]], calibration.offset[CELLS[2]] = 0.5, -5000
    calibration.set_pattern(CELLS[3], PATTERN_RAMP)
    calibration.set_pattern(CELLS[4], PATTERN_FULL)
    assert board.sample(tick_ns) == pytest.approx(0.01, abs=1e-6)
    board.is_stale = True
    shown = board.sample(tick_ns)
    assert shown[1] == pytest.approx(0.005, abs=1e-6)
    assert shown[2] == pytest.approx(0.01 - 5000 * TAXELS.newton_per_count, abs=1e-6)
    assert board.counts[3].tolist() == list(range(32))
    assert (board.counts[4] == TAXELS.count_max).all()


def test_before_the_touch_begins_the_sensors_show_their_offsets() -> None:
    made = Defects.of({"stuck": 0.1}, 4)
    model = TaxelModel(0.0, TAXELS.force_max_n, made)
    shown = np.zeros(256)
    shown[CELLS] = sensors(defects=made).sample(BEGIN_NS)
    expected = model.signal_of_moments(np.zeros((1, *SHAPE), np.float32), np.random.default_rng(0), np.zeros(1))
    assert np.count_nonzero(expected)
    assert shown == pytest.approx(expected.ravel(), abs=3e-5)
