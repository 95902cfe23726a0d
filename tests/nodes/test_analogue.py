"""Boards whose sums are made before the converters."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from dbc import indices as od
from dbc.board_sums import PATTERN_FULL, PATTERN_RAMP
from nodes.analogue import AnalogueElectronics
from nodes.sampler import Sampler, new_sampler
from skin.defects import parse_defects
from skin.layout import load_layout
from skin.sources import Frame

LAYOUT = load_layout(Path("analogue"))
PHI = LAYOUT.phi()
PERIOD_NS = 10_000_000
STEP_COUNTS = 32
#: Of each sum, among those of its block.
PLACE = np.arange(PHI.shape[0]) - PHI.starts[PHI.block_of_sum]
STEP_N = STEP_COUNTS * LAYOUT.taxels.newton_per_count


class Rising:
    """A source whose forces rise by a fixed image in each step."""

    has_noise = False
    slope = np.random.default_rng(2).uniform(0, 0.002, (64, 64)).astype(np.float32)

    def frame(self, step: int) -> Frame:
        return Frame(step * self.slope, "rising")


def boards(*defects: str, noise_n: float = 0.0) -> Sampler:
    made = parse_defects(defects, [], 5, LAYOUT)
    return new_sampler(LAYOUT, PHI, Rising(), noise_n=noise_n, seed=1, defects=made)


def error_n(sums: np.ndarray, step: float) -> np.ndarray:
    return sums * LAYOUT.taxels.newton_per_count - PHI.forward(step * Rising.slope.ravel())


def test_sums_follow_the_touch_from_cycle_to_cycle() -> None:
    sampler = boards()
    for counter in (1, 2, 3, 5, 6):
        sums = sampler.sample(counter, counter * PERIOD_NS)
        assert np.abs(error_n(sums, counter - 1)).max() <= 0.51 * STEP_N


def test_noise_of_taxels_is_added_and_not_clipped() -> None:
    sampler = boards(noise_n=1e-3)
    sums = sampler.sample(1, 0)
    assert error_n(sums, 0).std() == pytest.approx(32**0.5 * 1e-3, rel=0.1)
    assert abs(error_n(sums, 0)[PHI.row_of_sum == 0].mean()) < 3 * 32**0.5 * 1e-3 / 5
    truth = sampler.take_truth()
    assert truth is not None
    assert np.frombuffer(truth.sensor, "<f4").min() < -1e-3


def test_rows_that_are_read_later_see_the_touch_later() -> None:
    sums = boards("skew=1e-3").sample(4, 0)
    for late in (0, 7):
        found = error_n(sums, 3 + late * 0.1)[late == PLACE]
        assert np.abs(found).max() <= 0.51 * STEP_N


@pytest.mark.parametrize(
    "defect", ["damper=0.02", "gain-spread=0.2", "dead=0.05", "stuck=0.05", "drift=0.02", "creep=1"]
)
def test_rows_that_are_read_later_see_the_defects_of_their_taxels(defect: str) -> None:
    """Of forces that rise steadily, what is read a tenth of a period later is a tenth of the way to the next step."""
    plain, skewed = boards(defect), boards(defect, "skew=1e-3")
    *_, now, later = (plain.sample(counter, counter * PERIOD_NS).astype(float) for counter in range(1, 6))
    *_, read = (skewed.sample(counter, counter * PERIOD_NS) for counter in range(1, 5))
    inside = np.abs(later) < 0.9 * np.abs(later).max()  # of the range of the converters
    assert np.abs(read - now - PLACE * 0.1 * (later - now))[inside].max() <= 2 * STEP_COUNTS
    assert np.abs(later - now).max() > 10 * STEP_COUNTS


def test_rows_that_are_read_for_longer_than_a_period_are_refused() -> None:
    with pytest.raises(InputError, match=r"skew: 8 sums of a block take longer than a period"):
        boards("skew=0.005")


def test_mismatch_and_offsets_reach_the_sums() -> None:
    assert np.abs(error_n(boards("mismatch=0.05").sample(4, 0), 3)).max() > 5 * STEP_N
    offsets = error_n(boards("sum-offset").sample(1, 0), 0)
    assert offsets.std() == pytest.approx(0.01, rel=0.1)


def test_test_patterns_show_what_the_converters_would_read() -> None:
    sampler = boards(noise_n=1e-3)
    ramps = (1, 2, 3, 4, 5)
    for block in ramps:
        sampler.adjust(block, od.TEST_PATTERN, 0, PATTERN_RAMP)
    sampler.adjust(6, od.TEST_PATTERN, 0, PATTERN_FULL)
    codes = np.split(sampler.sample(1, 0) // STEP_COUNTS, PHI.starts[1:-1])
    for block in ramps:
        rows = PHI.rows_of(block)
        exact = np.array([sum((-1) ** (row & place).bit_count() * place for place in range(32)) for row in rows])
        assert codes[block].tolist() == np.rint(exact / STEP_COUNTS).tolist()
    full = codes[6]
    assert full.tolist() == [2047 if row == 0 else 0 for row in PHI.rows_of(6)]
    assert sampler.saturated(6) == (0 in PHI.rows_of(6))


def test_drifts_of_a_converter_reach_the_sums_of_its_block() -> None:
    made = parse_defects([], ["converter5:ramp:0.1:0.01:0.02", "board6:step:0.002"], 0, LAYOUT)
    sampler = new_sampler(LAYOUT, PHI, Rising(), noise_n=0.0, seed=1, defects=made)
    for step, drifted_n in ((0, 0.0), (2, 0.05), (4, 0.1)):
        moved_n = error_n(sampler.sample(step + 1, step * PERIOD_NS), step)
        assert moved_n[PHI.block_of_sum == 5] == pytest.approx(drifted_n, abs=STEP_N)
        row, of_board = PHI.row_of_sum[PHI.block_of_sum == 6], moved_n[PHI.block_of_sum == 6]
        assert of_board == pytest.approx(np.where(row == 0, 32 * 0.002, 0), abs=STEP_N)
        assert np.abs(moved_n[(PHI.block_of_sum != 5) & (PHI.block_of_sum != 6)]).max() < STEP_N


def test_a_digital_front_end_has_no_converters_of_sums() -> None:
    with pytest.raises(InputError, match=r"taxels\.frontend is 'digital', expected 'analogue'"):
        AnalogueElectronics(load_layout(), load_layout().phi())
