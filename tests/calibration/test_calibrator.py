"""A skin with offsets that is tared at its start and followed."""

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from calibration.calibrator import Calibrator
from calibration.offline import measurement_of
from canskin.calibration_messages import CalibrationState, CalibrationStatus, ZeroSupport
from canskin.sums import doubtful_taxels
from skin.layout import Layout, changed
from tests.calibration.helpers import (
    COUNTS,
    LAYOUT,
    NOISE_N,
    SMALL,
    SMALL_COUNT_N,
    SMALL_PHI,
    SMALL_SUMS,
    Cycles,
    Skin,
    error_n,
    offsets_n,
    offsets_of,
    pressed,
    still,
    tared,
)
from tests.layouts import STEPPED_SKIN, small_layout
from tests.messages import stepped_measurement

MS = 1_000_000
MEASURING, TOUCHED = CalibrationState.MEASURING, CalibrationState.TOUCHED
FOLLOWING, LOADED, OFF = CalibrationState.FOLLOWING, CalibrationState.LOADED, CalibrationState.OFF

ZERO = np.zeros(LAYOUT.taxels.count)
OFFSETS = offsets_n()
#: Noise of one sum.
SUM_NOISE_N = NOISE_N * LAYOUT.measurement.block_size**0.5


def test_in_turns_it_learns_from_measurements_whose_sums_are_all_new() -> None:
    """Those between them hold half of the sums: as new ones they would halve the noise, and take twice the time."""
    together = Calibrator(changed(SMALL, sync={"rate_hz": 20.0}))
    apart = Calibrator(changed(SMALL, sync={"rate_hz": 40.0, "turns": 2}))
    held, period_ns = np.arange(SMALL_SUMS) % 8 < 4, 50 * MS
    before = COUNTS
    for cycle in range(101):
        sums = COUNTS + np.random.default_rng(cycle).integers(-9, 10, SMALL_SUMS).astype(np.int32)
        half = measurement_of(SMALL, SMALL_PHI, 2 * cycle, np.where(held, before, sums))
        whole = measurement_of(SMALL, SMALL_PHI, 2 * cycle + 1, sums)
        begin_ns, before = cycle * period_ns, sums
        apart.take(msgspec.structs.replace(half, sampled_mono_ns=begin_ns + period_ns // 2))
        for each in (apart, together):
            each.take(msgspec.structs.replace(whole, sampled_mono_ns=begin_ns + period_ns))
            each.work()
    assert apart.state is FOLLOWING
    assert apart.tare_s == together.tare_s
    assert apart.status() == together.status()
    np.testing.assert_array_equal(apart.offsets_n, together.offsets_n)


def test_nothing_is_learned_before_the_kernels_are_compiled() -> None:
    compiling: list[Callable[[], None]] = []
    skin = Skin(Calibrator(LAYOUT, submit=compiling.append))
    skin.run(4.0, still(OFFSETS))
    assert skin.calibrator.offsets_n is None
    (compile_all,) = compiling
    compile_all()
    assert error_n(skin.run(4.0, still(OFFSETS)), ZERO) < 1.2 * SUM_NOISE_N


def test_saturated_sums_have_no_part_in_the_zero() -> None:
    skin, ended = Skin(Calibrator(LAYOUT)), [100, 500]
    skin.run(4.0, still(OFFSETS), saturated=ended)
    offsets_n = skin.calibrator.offsets_n
    assert offsets_n is not None
    assert np.flatnonzero(~np.isfinite(offsets_n)).tolist() == ended
    last = skin.run(5.0, still(OFFSETS))
    assert not last.usable
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_zero_forced_under_a_hand_is_measured_again_when_the_hand_is_gone() -> None:
    """The offsets do not run after the hand, past the true zero."""
    skin, hand = Skin(Calibrator(LAYOUT)), pressed(10, 20, 20, 0.005)
    skin.calibrator.tare(force=True)
    assert error_n(skin.run(4.0, still(OFFSETS + hand)), ZERO) < 1.2 * SUM_NOISE_N
    last = skin.run(4.5, still(OFFSETS))
    assert skin.calibrator.state is CalibrationState.FOLLOWING
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_drift_is_followed_and_goes_on_under_a_touch() -> None:
    rate_n = np.random.default_rng(3).normal(0, 1e-3, LAYOUT.taxels.count)
    skin, touch = Skin(Calibrator(LAYOUT)), pressed(30, 30, 9, 0.005)
    last = skin.run(14.0, lambda time_s: OFFSETS + rate_n * time_s)
    assert error_n(last, ZERO) < 1.5 * SUM_NOISE_N
    expected = 1e-3 * LAYOUT.measurement.block_size**0.5
    assert skin.calibrator.status().drift_rms_n_per_s == pytest.approx(expected, rel=0.05)
    last = skin.run(5.0, lambda time_s: OFFSETS + rate_n * time_s + touch)
    assert error_n(last, touch) < 2 * SUM_NOISE_N


def test_a_zero_that_is_not_followed_has_no_drift() -> None:
    rate_n = np.random.default_rng(3).normal(0, 1e-3, LAYOUT.taxels.count)
    skin = Skin(Calibrator(LAYOUT, tares=False))
    skin.calibrator.tare()
    tared = skin.run(4.0, lambda time_s: OFFSETS + rate_n * time_s)
    assert skin.calibrator.state is CalibrationState.LOADED
    assert skin.run(4.0, still(OFFSETS)).offsets == tared.offsets


def test_the_zero_of_an_stepped_board_is_known_from_its_first_sums_on() -> None:
    made, blocks = Calibrator(STEPPED_SKIN), STEPPED_SKIN.phi().blocks
    assert set(made.status().zero_support) == {ZeroSupport.NONE}
    known = np.ones(STEPPED_SKIN.phi().kept.shape, np.bool_)
    known[3] = False
    force_n = np.zeros(STEPPED_SKIN.taxels.count)
    for look in range(1, 40):
        came = stepped_measurement(force_n, known, layout=STEPPED_SKIN, sampled_mono_ns=look * 25_000_000)
        made.take(came)
        made.work()
    expected = [ZeroSupport.NONE if block == 3 else ZeroSupport.STORED for block in range(blocks)]
    assert list(made.status().zero_support) == expected


@pytest.mark.parametrize("tares", [True, False])
@pytest.mark.parametrize("layout", [SMALL, STEPPED_SKIN], ids=["synchronous", "steps"])
def test_blocks_are_doubted_until_the_next_call(layout: Layout, *, tares: bool) -> None:
    made, phi = Calibrator(layout, tares=tares), layout.phi()
    if not layout.sends.boards_keep_zero:
        made.load(np.zeros(phi.shape[0]))
    came = measurement_of(layout, phi, 0, np.zeros(phi.shape[0], np.int32), np.ones(phi.blocks, np.bool_), time_ns=1)
    changed = np.arange(phi.blocks) == 2
    made.doubt_blocks(changed, 7)
    marked = doubtful_taxels(made.apply(came), phi.shape[1])
    assert marked is not None
    np.testing.assert_array_equal(marked, phi.of_taxels(changed))
    status = made.status()
    assert (status.doubtful_taxels, status.doubtful_since_mono_ns) == (marked.sum(), 7)
    made.doubt_blocks(changed, 9)
    assert made.status().doubtful_since_mono_ns == 7
    made.doubt_blocks(~np.ones_like(changed), 9)
    assert made.apply(came).doubtful == b""
    assert (made.status().doubtful_taxels, made.status().doubtful_since_mono_ns) == (0, 0)


def test_noise_is_0_while_no_sum_is_known() -> None:
    skin = Skin(Calibrator(LAYOUT))
    skin.run(4.0, still(OFFSETS))
    skin.run(2.0, still(OFFSETS), valid=np.zeros(LAYOUT.blocks, np.bool_))
    assert skin.calibrator.status().noise_n == 0


@pytest.mark.parametrize(
    ("part", "tables", "has_bias"),
    [
        (1.05, {}, True),
        (0.95, {}, False),
        (1.05, {"sampling": {"rate_hz": 80.0}}, False),
        (1.05, {"taxels": {"frontend": "analogue"}}, False),
    ],
)
def test_the_mean_of_clipped_noise_is_left_in_sums_of_single_samples(
    part: float, tables: dict[str, Any], has_bias: bool
) -> None:
    """The paper's sensor has 1 mN, a sum of 32 5.7 mN; below 0.3 times that the sensor adds none."""
    limit = 0.3 * 1e-3 * 32**0.5
    noise = round(part * limit / SMALL_COUNT_N / np.pi**0.5)
    layout = small_layout(32, 32, sync={"rate_hz": 40.0}, **tables)
    skin = Cycles(layout, noise=noise)
    skin.run(10.2)
    assert skin.made.state is FOLLOWING
    bias = 32 * 1e-3 / np.sqrt(2 * np.pi) / SMALL_COUNT_N if has_bias else 0.0
    expected = COUNTS - np.where(SMALL_PHI.row_of_sum == 0, bias, 0.0)
    assert np.abs(np.array(offsets_of(skin.run(0.1))) - expected).max() < 0.51
    # What follows keeps it.
    skin.run(5)
    assert np.abs(np.array(offsets_of(skin.run(0.1))) - expected).max() < 0.51


def test_before_the_first_window_nothing_is_known() -> None:
    expected = CalibrationStatus(
        state=MEASURING, zero_support=bytes(SMALL_PHI.blocks), zero_mono_ns=bytes(8 * SMALL_PHI.blocks)
    )
    assert Calibrator(SMALL).status() == expected
    skin = Cycles()
    skin.run(1)
    assert skin.made.status() == expected


def test_windows_that_nobody_had_time_for_are_not_lost() -> None:
    skin = Cycles()
    for _ in range(101):
        skin.made.take(skin.measured(COUNTS))
        skin.cycle += 1
    assert skin.made.state is MEASURING
    skin.made.work()
    assert skin.made.state is FOLLOWING
    skin.made.work()  # nothing is left
    assert skin.made.status().revision == 1


@pytest.mark.parametrize(("gap", "drift"), [(9, 100.0), (30, 100.0), (70, 40.0), (70, -40.0)])
def test_offsets_have_gone_on_through_a_gap_when_its_first_window_ends(gap: int, drift: float) -> None:
    """Cycles that are missing, whole windows or nearly one; offsets are foreseen within a cycle or two of drift."""
    skin = Cycles(noise=0)
    skin.run(30, drift=drift)
    skin.cycle += gap
    skin.run(1.1, drift=drift)
    applied = skin.run(0.1, drift=drift)
    expected = COUNTS + drift * (skin.cycle - 1) / 10
    assert np.abs(np.array(offsets_of(applied)) - expected).max() <= abs(drift) * (0.2 if gap == 9 else 0.05) + 0.6
    status = skin.made.status()
    assert status.held_blocks == 0
    assert status.drift_rms_n_per_s == pytest.approx(4 * abs(drift) * SMALL_COUNT_N, rel=0.02)


@pytest.mark.parametrize(("counts", "is_named"), [(2, False), (3, True)])
def test_noise_below_three_counts_is_no_defect(counts: int, is_named: bool) -> None:
    """Up and down by 3 counts: 3 √π = 5.3 counts, more than 1.75 times 3; by 2 counts: 3.5."""
    loud = np.where(SMALL_PHI.block_of_sum == 5, counts, 1)
    skin = Cycles(noise=1)
    skin.noise = loud
    skin.run(60)
    assert [text.split(" has")[0] for text in skin.made.status().defects] == ["block 5"] * is_named
    assert sum(text.startswith("block 5") for text in skin.said) == is_named


def test_a_defect_is_said_once_and_again_when_it_has_come_back() -> None:
    stuck = np.where(np.arange(SMALL_SUMS) == 33, 0, 3)
    skin = tared()
    for turn in range(2):
        skin.noise = stuck
        skin.run(15)
        words = f"sum 33 (block 4, row {SMALL_PHI.row_of_sum[33]}) is stuck and left out"
        assert skin.said[1:] == [words] * (turn + 1)
        assert skin.made.status().defects == [words]
        usable = np.frombuffer(skin.run(0.1).usable, np.uint8)
        assert np.flatnonzero(usable == 0).tolist() == [33]
        skin.noise = 3
        skin.run(2)
        assert skin.made.status().defects == []
        assert skin.run(0.1).usable == b""
