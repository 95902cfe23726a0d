"""What a calibrator tells of its zero: what it rests on, since when, and which forces are doubtful."""

import numpy as np
import numpy.typing as npt
import pytest

from canskin.calibration_messages import ZeroSupport
from canskin.messages import Measurement
from tests.calibration.helpers import (
    COUNTS,
    SMALL_COUNT_N,
    SMALL_PHI,
    Cycles,
    offsets_of,
    pressed,
    pressed_counts,
    tared,
)

MS = 1_000_000
PATCH_COUNTS = pressed_counts(10, 10, 8, 80)
STANDS = pressed(10, 10, 8, 80, (32, 32)) > 0


def supports(skin: Cycles) -> set[int]:
    return set(skin.made.status().zero_support)


def support_times(skin: Cycles) -> set[int]:
    return set(np.frombuffer(skin.made.status().zero_mono_ns, "<i8").tolist())


def test_each_block_tells_what_its_zero_rests_on() -> None:
    skin = Cycles()
    skin.missing = [4]
    assert supports(skin) == {ZeroSupport.NONE}
    skin.made.load(np.where(SMALL_PHI.block_of_sum == 4, np.nan, COUNTS * SMALL_COUNT_N))
    expected = [ZeroSupport.STORED] * SMALL_PHI.blocks
    expected[4] = ZeroSupport.NONE
    assert list(skin.made.status().zero_support) == expected
    assert support_times(skin) == {0}
    skin.run(10.1)
    expected = [ZeroSupport.NONE if block == 4 else ZeroSupport.MEASURED for block in range(SMALL_PHI.blocks)]
    assert list(skin.made.status().zero_support) == expected
    assert support_times(skin) == {0, 2400 * MS}
    skin.made.forget()
    assert supports(skin) == {ZeroSupport.NONE}
    assert support_times(skin) == {0}


def test_a_measured_zero_is_fresh_while_nothing_touches() -> None:
    skin = tared()
    first = support_times(skin)
    skin.run(4)
    (last_ns,) = support_times(skin)
    assert {last_ns - 4 * 250 * MS} == first
    skin.run(4, COUNTS + pressed_counts(0, 0, 20, 300))
    assert min(support_times(skin)) == last_ns


def test_a_corrected_zero_is_measured_again_after_two_calm_seconds() -> None:
    skin = tared()
    skin.run(2, COUNTS - PATCH_COUNTS)
    assert ZeroSupport.CORRECTED in supports(skin)
    skin.run(12, COUNTS - PATCH_COUNTS)
    assert supports(skin) == {ZeroSupport.MEASURED}


def test_corrections_are_told_once_in_ten_seconds() -> None:
    skin = tared()
    skin.run(40)
    for turn in range(1, 5):
        skin.run(4, COUNTS - turn * PATCH_COUNTS)
    told = [each for each in skin.said if each.endswith("a taxel below zero: the zero is corrected there")]
    assert len(told) == 1


def test_a_forced_zero_is_told_until_it_falls() -> None:
    skin = Cycles()
    skin.made.tare(force=True)
    skin.run(10.1, COUNTS + PATCH_COUNTS)
    assert supports(skin) == {ZeroSupport.TOLD}
    skin.run(20, COUNTS + PATCH_COUNTS)
    assert supports(skin) == {ZeroSupport.TOLD}
    skin.run(4, COUNTS)
    assert ZeroSupport.CORRECTED in supports(skin)


def doubtful_in(measurement: Measurement) -> npt.NDArray[np.bool_]:
    bits = np.unpackbits(np.frombuffer(measurement.doubtful, np.uint8), count=1024)
    return bits.astype(np.bool_)


def test_without_a_zero_that_is_to_come_all_taxels_are_doubtful() -> None:
    assert doubtful_in(Cycles().run(1)).all()
    assert Cycles(tares=False).run(1).doubtful == b""
    assert tared().run(0.1).doubtful == b""


def test_a_force_that_stands_still_is_doubtful_until_it_goes() -> None:
    skin = tared()
    assert skin.run(20, COUNTS + PATCH_COUNTS).doubtful == b""
    last = skin.run(8, COUNTS + PATCH_COUNTS)
    assert (doubtful_in(last) == STANDS).mean() > 0.98
    status = skin.made.status()
    assert status.doubtful_taxels == doubtful_in(last).sum()
    assert status.doubtful_force_n == pytest.approx(64 * 80 * SMALL_COUNT_N, rel=0.1)
    assert status.doubtful_since_mono_ns == pytest.approx((2400 + 24 * 250) * MS, abs=500 * MS)
    assert "stands still" in skin.said[-1]
    last = skin.run(3, COUNTS)
    assert last.doubtful == b""
    status = skin.made.status()
    assert (status.doubtful_taxels, status.doubtful_force_n, status.doubtful_since_mono_ns) == (0, 0.0, 0)
    assert skin.said[-1] == "no force is doubtful any more"


def test_what_is_doubtful_becomes_part_of_a_zero_that_is_asked_for() -> None:
    skin = tared()
    skin.run(30, COUNTS + PATCH_COUNTS)
    skin.made.tare()
    last = skin.run(8.3, COUNTS + PATCH_COUNTS)
    assert skin.made.result is not None
    assert skin.made.result.is_done
    assert np.abs(np.array(offsets_of(last)) - COUNTS - PATCH_COUNTS).max() <= 1


def test_a_block_that_never_sent_has_no_corrected_zero() -> None:
    skin = Cycles()
    skin.missing = [4]
    skin.run(10.1)
    skin.run(2, COUNTS - PATCH_COUNTS)
    assert ZeroSupport.CORRECTED in supports(skin)
    assert skin.made.status().zero_support[4] == ZeroSupport.NONE
