"""Means and noise of the sums over windows."""

import numpy as np
import pytest

from calibration.windows import SETTLE_S, Window, WindowMeans
from skin.measurement import sbhe

PHI = sbhe(64, 16, block_size=16)
PERIOD_NS = 10_000_000


def windows_of(counts: np.ndarray, valid: np.ndarray) -> list[Window]:
    means = WindowMeans(16, PERIOD_NS * 1e-9, 2.0)
    found = (means.take((k + 1) * PERIOD_NS, counts[k], PHI.sums_of_blocks(valid[k])) for k in range(len(counts)))
    return [window for window in found if window is not None]


def test_mean_and_noise_of_a_window() -> None:
    counts = np.rint(np.random.default_rng(0).normal(100, 20, (1000, 16))).astype(np.int32)
    last = windows_of(counts, np.ones((1000, 4), np.bool_))[-1]
    assert last.known.all()
    assert last.mean_n == pytest.approx(np.full(16, 200.0), abs=4 * 40 / 5)
    assert last.noise_n.mean() == pytest.approx(40.0, rel=0.1)


def test_a_block_counts_after_it_has_been_valid_for_a_while() -> None:
    valid = np.ones((400, 4), np.bool_)
    valid[:200, 1] = False
    counts = np.where(PHI.sums_of_blocks(np.array([False, True, False, False])), np.arange(400)[:, None], 7)
    found = windows_of(counts.astype(np.int32), valid)
    mine = PHI.block_of_sum == 1
    for window in found:
        if window.centre_ns < (200 + SETTLE_S * 100) * PERIOD_NS:
            assert not window.known[mine].any()
            assert not window.mean_n[mine].any()
    assert found[-1].known.all()
    assert found[-1].mean_n[mine] == pytest.approx(2.0 * found[-1].centre_ns / PERIOD_NS, abs=4)
    assert (found[-1].mean_n[~mine] == 14).all()


def test_a_gap_begins_a_new_window() -> None:
    means = WindowMeans(16, PERIOD_NS * 1e-9, 1.0)
    ones, valid = np.ones(16, np.int32), np.ones(16, np.bool_)
    for k in range(120):
        means.take((k + 1) * PERIOD_NS, ones, valid)
    assert means.take(10**12, 5 * ones, valid) is None
