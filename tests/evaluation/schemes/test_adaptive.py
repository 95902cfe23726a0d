"""Adaptive sums on whole buses."""

import numpy as np
import pytest

from dbc.adaptive import FIRST_COB_ID
from dbc.canopen import SYNC_COB_ID
from dbc.frame_bits import frame_time_ns
from evaluation.schemes.adaptive import AdaptiveRun, run_adaptive
from evaluation.schemes.judge import quality
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SHAKING, SLAP, TAXELS, Touch
from evaluation.schemes.schemes import Adaptive, measure_scheme
from evaluation.schemes.wire import TICK_NS, lines_of
from tests.layouts import NODES, TPDOS

TICKS = 150


def sampled(true_n: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(true_n.shape, np.float32) * np.float32(1e-3)
    return np.rint(np.clip(true_n + noise, 0, 0.02) / NEWTON_PER_COUNT).astype(np.int16)


@pytest.fixture(scope="module")
def true_n() -> np.ndarray:
    """A third of all taxels pressed at once after 20 ms: more than the buses carry at once."""
    true = np.zeros((TICKS, TAXELS), np.float32)
    true[20:, ::3] = 0.008
    return true


@pytest.fixture(scope="module")
def run(true_n: np.ndarray) -> AdaptiveRun:
    return run_adaptive(sampled(true_n, 0), sampled(np.zeros((400, TAXELS), np.float32), 1), lines_of(64))


def test_every_frame_belongs_to_somebody_and_no_tpdo_follows_sync_at_once(run: AdaptiveRun) -> None:
    frames = run.sent.frames
    can_id = frames["can_id"].astype(int)
    is_tpdo = (can_id >= FIRST_COB_ID) & (can_id < FIRST_COB_ID + NODES * TPDOS)
    is_beat, is_sync = (can_id > 0x700) & (can_id <= 0x700 + NODES), can_id == SYNC_COB_ID
    assert (is_tpdo | is_beat | is_sync).all()
    assert is_sync.sum() == 4 * 2
    begun = frames["time_ns"] - frame_time_ns(frames, 1_000_000, 0)
    assert np.all(begun[is_tpdo] % (100 * TICK_NS) >= TICK_NS)
    assert (run.latency_ns > 0).all()
    assert run.latency_ns.max() > 5 * TICK_NS  # news of many nodes waits for the bus


def test_a_receiver_that_gets_everything_shows_the_touch(run: AdaptiveRun, true_n: np.ndarray) -> None:
    images = run.images(np.ones(len(run.sent.frames), np.bool_))
    assert images.ready_ns[0] == 0
    assert not images.force_n[:20].any()
    late = images.force_n[100:] - true_n[100:]
    assert np.sqrt(np.mean(late**2)) < 0.4e-3
    assert quality(true_n, images)["psnr_mean_db"] > 25


def test_lost_frames_cost_quality_until_the_refresh(run: AdaptiveRun, true_n: np.ndarray) -> None:
    arrives = np.random.default_rng(0).random(len(run.sent.frames)) >= 0.05
    whole = run.images(np.ones(len(arrives), np.bool_)).force_n
    part = run.images(arrives).force_n
    # Right after the jump the loss shows; refreshes have repaired it 100 ms later.
    assert np.mean((part[40] - true_n[40]) ** 2) > 2 * np.mean((whole[40] - true_n[40]) ** 2)
    assert np.mean((part[-1] - true_n[-1]) ** 2) < 2 * np.mean((whole[-1] - true_n[-1]) ** 2)
    nothing = run.images(np.zeros(len(arrives), np.bool_)).force_n
    assert not nothing.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "psnr_db", "kbit_per_s"),
    [("golf-ball", 54.8, 112), ("granola-box", 49.7, 639), (SLAP, 57.7, 323), (SHAKING, 37.2, 3507)],
)
def test_touches_without_meshes_have_the_figures_of_the_documents(name: str, psnr_db: float, kbit_per_s: float) -> None:
    """Of docs/adaptive.md and docs/bandwidth.md; a new figure is to be changed there, too."""
    found = measure_scheme(Adaptive(), Touch(name))
    assert round(found["psnr_mean_db"], 1) == pytest.approx(psnr_db, abs=0.11)
    assert found["kbit_per_s"] == pytest.approx(kbit_per_s, rel=0.01)
