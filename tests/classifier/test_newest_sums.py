"""The newest sums of blocks, and means over cycles."""

import numpy as np
import pytest

from classifier.newest_sums import HOLD_CYCLES, NewestSums
from skin.measurement import Sbhe


def test_a_lost_block_keeps_its_sums_for_some_cycles(phi: Sbhe) -> None:
    newest, all_came = NewestSums(phi), np.ones(phi.blocks, np.bool_)
    first = np.arange(phi.shape[0], dtype=np.int32)
    assert newest.take(first, all_came, 1) == 1
    some = all_came.copy()
    some[0] = False
    for _ in range(HOLD_CYCLES):
        assert newest.take(first + 1, some, 1) == 1
    np.testing.assert_array_equal(newest.sums, np.where(phi.block_of_sum == 0, first, first + 1))
    assert newest.take(first + 1, some, 1) == pytest.approx(1 - 1 / phi.blocks)
    assert not newest.valid[0]


@pytest.mark.parametrize("cycles", [4, 20])
def test_the_noise_of_means_is_that_of_so_many_cycles(phi: Sbhe, cycles: int) -> None:
    newest, came, rng = NewestSums(phi, cycles), np.ones(phi.blocks, np.bool_), np.random.default_rng(0)
    means = []
    for _ in range(40 * cycles):
        newest.take(np.rint(rng.normal(500, 100, phi.shape[0])).astype(np.int32), came, 1)
        means.append(newest.sums.copy())
    settled = np.array(means[5 * cycles :])
    assert settled.mean() == pytest.approx(500, rel=0.01)
    assert settled.std() == pytest.approx(100 * cycles**-0.5, rel=0.05)


def test_means_count_when_so_many_sums_have_come_and_again_after_a_block_was_left_out(phi: Sbhe) -> None:
    newest, came = NewestSums(phi, 4), np.ones(phi.blocks, np.bool_)
    high = np.full(phi.shape[0], 1000, np.int32)
    assert [newest.take(high, came, 1) for _ in range(4)] == [0, 0, 0, 1]
    assert np.all(newest.sums == 1000)
    came[0] = False
    for _ in range(HOLD_CYCLES + 1):
        newest.take(high, came, 1)
    came[0] = True
    assert [newest.take(0 * high, came, 1) == 1 for _ in range(4)] == [False] * 3 + [True]
    assert np.all(newest.sums[phi.block_of_sum == 0] == 0)
    newest.forget()
    assert [newest.take(high, came, 1) for _ in range(4)] == [0, 0, 0, 1]
    assert np.all(newest.sums == 1000)
