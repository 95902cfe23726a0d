"""The newest sums of blocks, and means over cycles."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from classifier.newest_sums import HOLD_CYCLES, NewestSums, averaged_cycles
from skin.phi import Sbhe


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
def test_the_noise_of_means_is_that_of_their_cycles(phi: Sbhe, cycles: int) -> None:
    newest, came, rng = NewestSums(phi, cycles), np.ones(phi.blocks, np.bool_), np.random.default_rng(0)
    means = []
    for _ in range(40 * cycles):
        newest.take(np.rint(rng.normal(500, 100, phi.shape[0])).astype(np.int32), came, 1)
        means.append(newest.sums.copy())
    settled = np.array(means[5 * cycles :])
    assert settled.mean() == pytest.approx(500, rel=0.01)
    assert settled.std() == pytest.approx(100 * cycles**-0.5, rel=0.05)


@pytest.mark.parametrize("cycles", [4, 20])
@pytest.mark.parametrize("gap", [1, 2, 3, 7, 12])
def test_an_old_mean_fades_in_cycles_without_sums(phi: Sbhe, cycles: int, gap: int) -> None:
    """No more of it is left than if sums had come in every cycle."""
    newest, came = NewestSums(phi, cycles), np.ones(phi.blocks, np.bool_)
    for _ in range(10 * cycles):
        newest.take(np.full(phi.shape[0], 1000, np.int32), came, 1)
    newest.take(np.zeros(phi.shape[0], np.int32), came, gap)
    left = ((cycles - 1) / (cycles + 1)) ** gap
    assert newest.sums == pytest.approx(np.full(phi.shape[0], 1000 * left))


@pytest.mark.parametrize("cycles", [4, 20])
@pytest.mark.parametrize("steps", [(1,), (2,), (1, 3), (9,), (30, 1, 1)])
def test_the_noise_that_is_told_is_that_of_the_sums(phi: Sbhe, cycles: int, steps: tuple[int, ...]) -> None:
    newest, came, rng = NewestSums(phi, cycles), np.ones(phi.blocks, np.bool_), np.random.default_rng(1)
    true, told = [], []
    for turn in range(600):
        step = steps[turn % len(steps)]
        newest.take(np.rint(rng.normal(0, 1000, phi.shape[0])).astype(np.int32), came, step)
        if turn > 60 and turn % len(steps) == 0:
            true.append(newest.sums.std())
            told.append(newest.noise_ratio * 1000 * cycles**-0.5)
    assert np.mean(told) == pytest.approx(np.mean(true), rel=0.05)


@pytest.mark.parametrize(("cycles", "held"), [(1, 4), (4, 4), (8, 4), (10, 5), (20, 10)])
def test_a_mean_is_held_for_four_cycles_or_half_of_those_that_are_averaged(phi: Sbhe, cycles: int, held: int) -> None:
    newest, came = NewestSums(phi, cycles), np.ones(phi.blocks, np.bool_)
    high = np.full(phi.shape[0], 1000, np.int32)
    assert newest.take(high, 0 * came, 1) == 0
    newest.take(high, came, 1)
    assert [newest.take(0 * high, 0 * came, 1) for _ in range(held + 1)] == [1] * held + [0]


def test_a_block_that_is_left_out_does_not_count_as_noise(phi: Sbhe) -> None:
    newest, came = NewestSums(phi, 4), np.ones(phi.blocks, np.bool_)
    high = np.full(phi.shape[0], 1000, np.int32)
    for _ in range(40):
        newest.take(high, came, 1)
    came[0] = False
    ratios = [newest.take(high, came, 1) for _ in range(HOLD_CYCLES + 1)]
    assert ratios == [1.0] * HOLD_CYCLES + [pytest.approx(1 - 1 / phi.blocks)]
    assert newest.noise_ratio == pytest.approx(1)
    came[0] = True
    assert newest.take(0 * high, came, 1) == 1
    assert 1 < newest.noise_ratio**2 < 1 + 3 / phi.blocks
    assert np.all(newest.sums[phi.block_of_sum != 0] == 600)
    assert np.all(newest.sums[phi.block_of_sum == 0] < 100)


@pytest.mark.parametrize(("rate_hz", "cycles"), [(500.0, 20), (100.0, 4), (40.0, 2), (20.0, 1), (10.0, 1), (1.0, 1)])
def test_sums_are_averaged_over_about_forty_milliseconds(rate_hz: float, cycles: int) -> None:
    parts = {"sync": SimpleNamespace(rate_hz=rate_hz), "measurement": SimpleNamespace(matrix=None)}
    layout: Any = SimpleNamespace(samples_per_sync=1, **parts)
    assert averaged_cycles(layout) == cycles
    codes = SimpleNamespace(matrix=(("+",), ("-",)))
    for changed in ({"samples_per_sync": 2}, {"measurement": codes}):
        assert averaged_cycles(SimpleNamespace(**{**vars(layout), **changed})) == 1  # type: ignore[arg-type]
