"""Sampling: one instant for all buses, steps that follow the SYNC counter, exact sums, calibration."""

import numpy as np
import pytest

from dbc import indices as od
from dbc.board_sums import PATTERN_FULL, PATTERN_RAMP
from nodes.electronics import Electronics
from nodes.sampler import CountSampler, Sampler
from skin.defects import Defects, Stage
from skin.layout import load_layout
from skin.sources import Frame, TaxelSource
from skin.taxel import NOISE_N, to_newtons
from skin.zero_drift import ZeroDrift

LAYOUT = load_layout()
PHI = LAYOUT.phi()
PERIOD_NS = 10_000_000


class Steps:
    """A source whose every taxel feels its step in ADC counts."""

    has_noise = True

    def __init__(self) -> None:
        self.asked: list[int] = []

    def frame(self, step: int) -> Frame:
        self.asked.append(step)
        force = np.full((64, 64), step * LAYOUT.taxels.newton_per_count, np.float32)
        return Frame(force, "steps")


@pytest.fixture
def source() -> Steps:
    return Steps()


@pytest.fixture
def sampler(source: Steps) -> Sampler:
    return Sampler(PHI, source, Electronics(LAYOUT.taxels, noise_n=0.0))


def test_four_buses_see_one_instant(sampler: Sampler, source: Steps) -> None:
    first = sampler.sample(1, 0)
    assert all(sampler.sample(1, bus * 100_000, bus) is first for bus in range(4))
    assert source.asked == [0]


def test_a_master_that_counts_anew_at_once_gets_new_samples_on_every_bus(sampler: Sampler) -> None:
    cycles = [
        [sampler.sample(counter, cycle * PERIOD_NS, bus) for bus in (0, 1)]
        for cycle, counter in enumerate((1, 2, 1, 2))
    ]
    assert all(first is second for first, second in cycles)
    assert len({id(sums) for sums, _ in cycles}) == 4


def test_a_sync_that_a_bus_carries_twice_is_one_cycle(sampler: Sampler, source: Steps) -> None:
    assert sampler.sample(1, 0) is sampler.sample(1, 200_000)
    assert source.asked == [0]


def test_steps_follow_the_counter_across_missed_syncs_and_the_overflow(sampler: Sampler, source: Steps) -> None:
    for cycle, counter in ((0, 1), (1, 2), (4, 5), (239, 240), (240, 1), (241, 2)):
        sampler.sample(counter, cycle * PERIOD_NS)
    assert source.asked == [0, 1, 4, 239, 240, 241]


def test_a_sync_without_counter_is_no_step(sampler: Sampler, source: Steps) -> None:
    for cycle, counter in enumerate((1, 0, 2, 0, 3)):
        sampler.sample(counter, cycle * 20 * PERIOD_NS)
    assert source.asked == [0, 0, 1, 1, 2]


def test_syncs_of_one_counter_belong_together_for_100_ms(source: Steps) -> None:
    sampler, first_ns = Sampler(PHI, source, Electronics(LAYOUT.taxels, noise_n=0.0)), 1_000_000_000
    first = sampler.sample(7, first_ns)
    assert sampler.sample(7, first_ns + 99_999_999, 1) is first
    assert sampler.sample(7, first_ns - 99_999_999, 2) is first
    later = sampler.sample(7, first_ns + 100_000_000, 3)
    assert later is not first
    assert source.asked == [6, 7]


def test_a_bus_may_be_seven_cycles_late(sampler: Sampler, source: Steps) -> None:
    cycles = [sampler.sample(counter, counter * PERIOD_NS) for counter in range(1, 10)]
    for counter in range(2, 10):
        assert sampler.sample(counter, counter * PERIOD_NS, 1) is cycles[counter - 1]
    assert sampler.sample(1, PERIOD_NS, 2) is not cycles[0]
    assert source.asked == [*range(9), 8 + 232]  # counter 1 follows 9 in the next turn


def test_the_truth_says_when_it_was(sampler: Sampler) -> None:
    for step, time_ns in ((0, 12_345), (1, 12_345 + 3 * PERIOD_NS)):
        sampler.sample(step + 1, time_ns)
        truth = sampler.take_truth()
        assert truth is not None
        told = truth.step, truth.sync_counter, truth.sampled_mono_ns, truth.label
        assert told == (step, step + 1, time_ns, "steps")
    sampler.sample(5, 4 * PERIOD_NS)
    truth = sampler.take_truth()
    assert truth is not None
    assert (truth.step, truth.sync_counter) == (4, 5)


def test_an_answer_made_ahead_is_asked_for_once_and_shows_when_its_sync_comes(sampler: Sampler, source: Steps) -> None:
    sampler.prepare()
    assert source.asked == []
    assert sampler.sums.tolist() == [0] * 1024
    for counter in (1, 2):
        sampler.sample(counter, counter * PERIOD_NS)
    sampler.prepare()
    sampler.prepare()
    assert source.asked == [0, 1, 2]
    assert (sampler.counts(3) == 1).all()
    ahead = sampler.sample(3, 3 * PERIOD_NS)
    assert (sampler.counts(3) == 2).all()
    assert np.array_equal(ahead, PHI.forward(np.full(4096, 2)))
    sampler.prepare()
    sampler.sample(7, 7 * PERIOD_NS)  # another step than the one made ahead
    assert source.asked == [0, 1, 2, 3, 6]
    assert (sampler.counts(3) == 6).all()


def test_boards_that_make_the_sums_get_the_samples_since_the_sync_before(source: Steps) -> None:
    sampler = CountSampler(PHI, source, Electronics(LAYOUT.taxels, noise_n=0.0, samples=4))
    sampler.prepare()
    assert source.asked == []
    assert sampler.sample(41, 0).shape == (4, 4096)
    sampler.prepare()
    sampler.prepare()
    assert source.asked == [40, 41]
    counts = sampler.sample(42, PERIOD_NS)
    assert counts.shape == (4, 4096)  # a quarter of the period apart
    assert [set(counts[place].tolist()) for place in (0, 2, 3)] == [{40}, {41}, {41}]
    assert source.asked == [40, 41, 41]


def test_gain_offset_and_ramp(sampler: Sampler, source: Steps) -> None:
    chain = PHI.order[5 * 32 : 6 * 32]
    sampler.adjust(5, od.GAIN, 1, 2.0)
    sampler.adjust(5, od.OFFSET, 2, -30)
    sampler.sample(101, 0)
    truth = sampler.take_truth()
    assert truth is not None
    assert sampler.take_truth() is None
    counts = np.rint(np.frombuffer(truth.sensor, "<f4") / LAYOUT.taxels.newton_per_count)
    assert (counts[chain[0]], counts[chain[1]], counts[chain[2]]) == (200, 70, 100)
    sampler.adjust(5, od.TEST_PATTERN, 0, PATTERN_RAMP)
    sums = sampler.sample(102, PERIOD_NS)
    ramp = np.full(4096, 101)
    ramp[chain] = np.arange(32)
    first, last = PHI.starts[5], PHI.starts[6]
    assert np.array_equal(sums[first:last], PHI.forward(ramp)[first:last])


def test_noise_is_seeded_and_clipped() -> None:
    force = np.zeros((64, 64), np.float32)
    one, same, other = (Electronics(LAYOUT.taxels, seed=seed).read(force) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    assert one.min() == 0
    # Half of the noise is clipped away; the rest has the mean sigma / sqrt(2 pi).
    mean_n = one.mean() * LAYOUT.taxels.newton_per_count
    assert mean_n == pytest.approx(0.001 / np.sqrt(2 * np.pi), rel=0.05)


def test_defects_reach_the_sums_and_the_truth_says_what_was_felt() -> None:
    defects = Defects.of({"dead": 0.1, "saturated": 0.05}, 3)
    (full, _), (dead, _) = defects.effects(Stage.READING, (64, 64))
    electronics = Electronics(LAYOUT.taxels, noise_n=0.0, defects=defects)
    sampler = Sampler(PHI, Steps(), electronics)
    sums = sampler.sample(201, 0)
    expected = np.full(4096, 200)
    expected[full] = 1023
    expected[dead] = 0
    truth = sampler.take_truth()
    assert truth is not None
    counts = np.rint(np.frombuffer(truth.sensor, "<f4") / LAYOUT.taxels.newton_per_count)
    assert np.array_equal(counts, expected)
    assert np.array_equal(sums, PHI.forward(expected))
    assert (np.frombuffer(truth.true, "<f4") > 0).all()


def test_drift_and_damper_follow_the_steps_of_the_touch() -> None:
    force = np.full((64, 64), 0.005, np.float32)
    drifting = Electronics(LAYOUT.taxels, noise_n=0.0, defects=Defects.of({"drift": 1e-3}), period_s=0.01)
    start, late, later = (drifting.read(force, step).astype(int) for step in (0, 100, 200))
    assert np.ptp(start) == 0
    inside = later > 0  # the zero of some falls below the range
    np.testing.assert_allclose((later - start)[inside], 2 * (late - start)[inside], atol=2)
    assert np.abs(late - start).max() > 100
    damped = Electronics(LAYOUT.taxels, noise_n=0.0, defects=Defects.of({"damper": 0.01}), period_s=0.01)
    counts = [int(damped.read(force * part, step)[0]) for step, part in ((0, 1), (1, 2), (3, 1), (4, 1))]
    # 5 mN in 10 ms is 0.5 m/s on a spring of 1 N/m: 5 mN more; half the speed downwards takes 2.5 mN.
    assert [round(count * LAYOUT.taxels.newton_per_count, 4) for count in counts] == [0.005, 0.015, 0.0025, 0.005]
    # The speed is that between two samples, not between two steps.
    often = Electronics(LAYOUT.taxels, noise_n=0.0, defects=Defects.of({"damper": 0.01}), period_s=0.01, samples=2)
    for step in (0, 1):
        often.read(force * (1 + step), step)
    felt_n = often.unread[-1][:, 0] * LAYOUT.taxels.newton_per_count
    assert felt_n.round(4).tolist() == [0.0125, 0.015]


def test_creep_follows_the_steps_of_the_touch_whatever_is_left_out() -> None:
    force = np.full((64, 64), 0.01, np.float32)
    zero = np.zeros_like(force)
    offset = Defects.of({"offset": 0.2, "creep": 0.2})  # the zero may fall below that of the start
    boards = [Electronics(LAYOUT.taxels, noise_n=0.0, defects=offset, period_s=1.0, samples=each) for each in (1, 4)]
    for board in boards:
        start = board.read(zero, 0).astype(int)
        for step in range(1, 400):
            board.read(force, step)
        low = (board.read(zero, 400).astype(int) - start)[start > 110]
        assert low.size
        assert low * LAYOUT.taxels.newton_per_count == pytest.approx(-0.2 * 0.01, abs=1e-4)
        later = (board.read(zero, 430).astype(int) - start)[start > 110]
        assert later * LAYOUT.taxels.newton_per_count == pytest.approx(-0.2 * 0.01 * np.exp(-1), abs=1e-4)


def test_the_temperature_of_a_board_explains_its_drift() -> None:
    cells = tuple(PHI.taxels_of_blocks[7].tolist())
    drifts = (ZeroDrift("cells", "ramp", 0.002, 1.0, 1.0, cells=cells), ZeroDrift("whole", "step", -0.001))
    electronics = Electronics(LAYOUT.taxels, noise_n=0.0, defects=Defects(zero_drifts=drifts), period_s=0.01)
    sampler = Sampler(PHI, Steps(), electronics)
    seen = []
    for counter in (0, 1, 151, 231):
        if counter:
            sampler.sample(counter, counter * PERIOD_NS)
        seen.append([sampler.temperature_k(range(*blocks)) - 298.15 for blocks in ((7, 8), (8, 9), (7, 9))])
    assert np.array(seen) == pytest.approx(np.array([[-2, -2, -2], [-2, -2, -2], [0, -2, -1], [2, -2, 0]]), abs=1e-4)


def averaging(source: TaxelSource, noise_n: float = NOISE_N) -> tuple[Sampler, Electronics]:
    electronics = Electronics(LAYOUT.taxels, noise_n=noise_n, seed=3, samples=10, blocks=PHI.taxels_of_blocks)
    return Sampler(PHI, source, electronics), electronics


class Touched:
    """A source that rests for half a second, and then rises on a quarter of the skin."""

    has_noise = False

    def frame(self, step: int) -> Frame:
        force = np.zeros((64, 64), np.float32)
        force[:32, :32] = min(0.01, 0.0005 * max(0, step - 50))
        return Frame(force, "touched")


def test_averaged_sums_are_those_of_the_instant_of_the_sync_within_a_part_of_the_noise() -> None:
    sampler, electronics = averaging(Touched())
    for cycle in range(120):
        sampler.sample(cycle + 1, cycle * PERIOD_NS)
    truth = sampler.take_truth()
    assert truth is not None
    true = np.frombuffer(truth.true, "<f4")
    assert true.max() == np.float32(0.01)
    error = sampler.sums - PHI.forward(true / np.float32(LAYOUT.taxels.newton_per_count))
    single = PHI.forward(electronics.sampled) - PHI.forward(true / np.float32(LAYOUT.taxels.newton_per_count))
    assert np.std(error) < np.std(single) / 5
    assert np.frombuffer(truth.sensor, "<f4") == pytest.approx(to_newtons(electronics.sampled, LAYOUT.taxels))


def test_what_is_sampled_ahead_is_what_would_have_been_sampled() -> None:
    (ahead, _), (plain, _) = averaging(Touched()), averaging(Touched())
    for cycle in range(60):
        first, second = ahead.sample(cycle + 1, cycle * PERIOD_NS), plain.sample(cycle + 1, cycle * PERIOD_NS)
        np.testing.assert_array_equal(first, second)
        ahead.prepare()
        ahead.prepare()


def test_patterns_gains_and_offsets_are_exact_at_once_and_a_reset_ends_them() -> None:
    sampler, _ = averaging(Touched())
    for cycle in range(5):
        sampler.sample(cycle + 1, cycle * PERIOD_NS)
        sampler.prepare()
    sampler.adjust(0, od.TEST_PATTERN, 0, PATTERN_RAMP)
    sampler.adjust(1, od.TEST_PATTERN, 0, PATTERN_FULL)
    sampler.adjust(2, od.OFFSET, 1, 1023)
    sums = sampler.sample(6, 5 * PERIOD_NS)
    ramp = np.zeros(4096, np.int32)
    ramp[PHI.taxels_of_blocks[0]] = np.arange(32)
    ramp[PHI.taxels_of_blocks[1]] = 1023
    patterned = PHI.block_of_sum < 2
    np.testing.assert_array_equal(sums[patterned], PHI.forward(ramp)[patterned])
    assert sampler.saturated(2) == 1
    sampler.reset(1)
    assert abs(sampler.sample(7, 6 * PERIOD_NS)[PHI.block_of_sum == 1]).max() < 1500  # one row of the pattern: 32736


def test_a_missed_sync_leaves_no_gap_in_what_is_averaged() -> None:
    source = Steps()
    sampler, _ = averaging(source, noise_n=0.0)
    for cycle in (0, 2, 3, 6, 7):
        sampler.sample(cycle + 1, cycle * PERIOD_NS)
    assert source.asked == [0, 1, 2, 3, 5, 6, 7]


def test_boards_that_miss_syncs_get_the_samples_of_the_newest_two_steps(source: Steps) -> None:
    electronics = Electronics(LAYOUT.taxels, noise_n=0.0, samples=2)
    for step in (4, 6, 8):
        electronics.prepare(source.frame(step).force_n, step)
    # Between two steps the force is half-way.
    assert [np.unique(each[:, 0]).tolist() for each in electronics.unread] == [[5, 6], [7, 8]]
    electronics.prepare(source.frame(8).force_n, 8)  # it has been sampled
    assert len(electronics.unread) == 2
