"""Steps on whole buses."""

from pathlib import Path

import numpy as np
import pytest

from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from evaluation.schemes.board import Board
from evaluation.schemes.judge import quality
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SHAKING, SLAP, TAXELS, Touch
from evaluation.schemes.schemes import Stepped, measure_scheme
from evaluation.schemes.steps import SteppedRun, run_stepped
from evaluation.schemes.wire import TICK_NS
from skin.layout import changed, load_layout
from tests.layouts import NODES

TICKS = 150
CONTRACT = Contract.from_layout(load_layout(Path("steps")))


def sampled(true_n: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(true_n.shape, np.float32) * np.float32(1e-3)
    return np.rint(np.clip(true_n + noise, 0, 0.02) / NEWTON_PER_COUNT).astype(np.int16)


@pytest.fixture(scope="module")
def true_n() -> np.ndarray:
    """A third of all taxels pressed at once after 20 ms: every board sends in every slot at first."""
    true = np.zeros((TICKS, TAXELS), np.float32)
    true[20:, ::3] = 0.008
    return true


def board_of(true_n: np.ndarray) -> Board:
    return Board(sampled(true_n, 0), sampled(np.zeros((400, TAXELS), np.float32), 1))


@pytest.fixture(scope="module")
def run(true_n: np.ndarray) -> SteppedRun:
    return run_stepped(board_of(true_n), CONTRACT)


def test_every_frame_belongs_to_somebody_and_ends_in_its_slot(run: SteppedRun) -> None:
    can_id = run.sent.frames["can_id"].astype(int)
    is_sums, is_beat = (can_id > 0x180) & (can_id <= 0x180 + NODES), (can_id > 0x700) & (can_id <= 0x700 + NODES)
    is_sync = can_id == SYNC_COB_ID
    assert (is_sums | is_beat | is_sync).all()
    assert is_sync.sum() == 4 * 2
    assert len(run.latency_ns) == is_sums.sum() > 4 * NODES * 5
    # Five or six boards of a bus begin with the same sample, heartbeats go last, a frame may be on its way.
    assert 100_000 < run.latency_ns.min() < run.latency_ns.max() < 8 * 135_000


def test_a_receiver_that_gets_everything_shows_the_touch(run: SteppedRun, true_n: np.ndarray) -> None:
    images = run.images
    assert images.ready_ns[0] == 0
    assert not images.force_n[:20].any()
    late = images.force_n[100:] - true_n[100:]
    assert np.sqrt(np.mean(late**2)) < 0.4e-3
    assert quality(true_n, images)["psnr_mean_db"] > 25


def test_slots_too_short_for_all_boards_leave_high_node_ids_waiting(true_n: np.ndarray) -> None:
    fast = run_stepped(
        board_of(true_n), Contract.from_layout(changed(load_layout(Path("steps")), steps={"slot_s": 0.0025}))
    )
    assert fast.latency_ns.max() > 10 * TICK_NS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "psnr_db", "kbit_per_s"),
    [("golf-ball", 55.3, 109), ("granola-box", 49.8, 531), (SLAP, 58.1, 258), (SHAKING, 35.5, 1895)],
)
def test_touches_without_meshes_have_the_figures_of_the_documents(name: str, psnr_db: float, kbit_per_s: float) -> None:
    """Of docs/steps.md and docs/bandwidth.md; a new figure is to be changed there, too."""
    found = measure_scheme(Stepped(), Touch(name))
    assert round(found["psnr_mean_db"], 1) == pytest.approx(psnr_db, abs=0.11)
    assert found["kbit_per_s"] == pytest.approx(kbit_per_s, rel=0.01)
