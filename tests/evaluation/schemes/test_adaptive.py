"""Adaptive sums and filtered events on whole buses, and the scenes that nobody tuned for."""

from dataclasses import replace

import numpy as np
import pytest

from dbc.adaptive import FIRST_COB_ID, NODES, TPDOS
from dbc.canopen import SYNC_COB_ID
from dbc.frame_bits import frame_time_ns
from evaluation.schemes.adaptive import AdaptiveRun, run_adaptive
from evaluation.schemes.comparison import wins_and_losses
from evaluation.schemes.fresh_scenes import FIELDS, POSED, REACH_M, random_contacts
from evaluation.schemes.judge import quality
from evaluation.schemes.scenes import SIDE, TAXELS, Touch, random_touch
from evaluation.schemes.schemes import FilteredEvents
from evaluation.schemes.sensor_noise import NoiseKind, noise_of
from evaluation.schemes.sums import SOLVED_NS
from evaluation.schemes.wire import TICK_NS

COUNT_N, TICKS = 0.02 / 1023, 150


def sampled(true_n: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(true_n.shape, np.float32) * np.float32(1e-3)
    return np.rint(np.clip(true_n + noise, 0, 0.02) / COUNT_N).astype(np.int16)


@pytest.fixture(scope="module")
def true_n() -> np.ndarray:
    """A third of all taxels pressed at once after 20 ms: more than the buses carry at once."""
    true = np.zeros((TICKS, TAXELS), np.float32)
    true[20:, ::3] = 0.008
    return true


@pytest.fixture(scope="module")
def run(true_n: np.ndarray) -> AdaptiveRun:
    return run_adaptive(sampled(true_n, 0), sampled(np.zeros((400, TAXELS), np.float32), 1))


def test_every_frame_belongs_to_somebody_and_no_tpdo_follows_sync_at_once(run: AdaptiveRun) -> None:
    frames, sent = run.sent.asked.frames, run.sent
    can_id = frames["can_id"].astype(int)
    is_tpdo = (can_id >= FIRST_COB_ID) & (can_id < FIRST_COB_ID + NODES * TPDOS)
    is_beat, is_sync = (can_id > 0x700) & (can_id <= 0x700 + NODES), can_id == SYNC_COB_ID
    assert (is_tpdo | is_beat | is_sync).all()
    assert is_sync.sum() == 4 * 2
    begun = sent.free_ns - frame_time_ns(frames, 1_000_000, 0)
    assert np.all(begun[is_tpdo] % (100 * TICK_NS) >= TICK_NS)
    for bus in range(4):
        mine = sent.asked.bus == bus
        assert np.all(np.diff(sent.free_ns[mine]) > 0)
        assert np.all(begun[mine][1:] >= sent.free_ns[mine][:-1])
    assert np.array_equal(np.sort(can_id[is_beat & (sent.asked.bus == 0)]), np.unique(can_id[is_beat]))


def test_a_receiver_that_gets_everything_shows_the_touch(run: AdaptiveRun, true_n: np.ndarray) -> None:
    images = run.images(np.ones(len(run.sent.asked), np.bool_))
    assert images.ready_ns[0] == SOLVED_NS
    assert not images.force_n[:20].any()
    late = images.force_n[100:] - true_n[100:]
    assert np.sqrt(np.mean(late**2)) < 0.4e-3
    assert quality(true_n, images)["psnr_mean_db"] > 25


def test_lost_frames_cost_quality_until_the_refresh(run: AdaptiveRun, true_n: np.ndarray) -> None:
    arrives = np.random.default_rng(0).random(len(run.sent.asked)) >= 0.05
    whole = run.images(np.ones(len(arrives), np.bool_)).force_n
    part = run.images(arrives).force_n
    # Right after the jump the loss shows; refreshes have repaired it 100 ms later.
    assert np.mean((part[40] - true_n[40]) ** 2) > 2 * np.mean((whole[40] - true_n[40]) ** 2)
    assert np.mean((part[-1] - true_n[-1]) ** 2) < 2 * np.mean((whole[-1] - true_n[-1]) ** 2)
    nothing = run.images(np.zeros(len(arrives), np.bool_)).force_n
    assert not nothing.any()


@pytest.mark.heavy
def test_filtered_taxels_send_less_than_a_threshold_in_the_noise_would() -> None:
    shown = FilteredEvents(0.5e-3).show(Touch("nothing", ticks=200))
    # 800,000 samples; a taxel that is not filtered passes the threshold in a third of them.
    assert shown.latency_ns.size < 200
    touch = Touch("golf ball at rest", ticks=800)
    plain, solved = (FilteredEvents(0.5e-3, receiver).show(touch) for receiver in ("plain", "solved"))
    assert np.array_equal(plain.sent.asked.frames, solved.sent.asked.frames)
    errors = [quality(touch.load().true_n, shown.images)["error_mn"] for shown in (plain, solved)]
    assert errors[0] != errors[1]
    assert max(errors) < 0.06


@pytest.mark.heavy
@pytest.mark.parametrize("name", [*POSED, *FIELDS])
def test_every_fresh_scene_touches_the_skin(name: str) -> None:
    what = Touch(name, ticks=400).load()
    assert what.true_n.shape == (400, TAXELS)
    assert what.true_n[-1].max() > 5e-4
    assert 0 <= what.true_n.min() <= what.true_n.max() < 0.03


@pytest.mark.heavy
def test_random_scenes_follow_their_seed_and_stay_on_the_skin() -> None:
    assert random_contacts(5, 3) == random_contacts(5, 3)
    assert len({random_contacts(seed, number) for seed in range(3) for number in range(3)}) == 9
    counts = {len(random_contacts(0, number)) for number in range(40)}
    assert counts == {1, 2, 3, 4}
    for number in range(20):
        for contact in random_contacts(1, number):
            poses = [contact.pose(tick) for tick in range(0, 1500, 7)]
            assert max(max(abs(pose.x_m), abs(pose.y_m)) for pose in poses) <= REACH_M + 1e-9
            assert max(pose.depth_m for pose in poses) <= 0.012
            assert poses[0].depth_m == 0
    touch = random_touch(3, 5, None, 0)
    assert touch.words == "random scene 3 of seed 5"
    assert touch.load().true_n.max() > 1e-3


@pytest.mark.parametrize("kind", ["normal", "coloured", "heavy-tailed", "common-mode"])
def test_noise_has_its_deviation(kind: NoiseKind) -> None:
    noise = noise_of(kind, (2000, 200), 1e-3, np.random.default_rng(0))
    expected = 1e-3 * (1 + 0.3**2) ** 0.5 if kind == "common-mode" else 1e-3
    assert np.std(noise) == pytest.approx(expected, rel=0.05)
    after = np.mean(noise[1:] * noise[:-1]) / np.var(noise)
    beside = np.mean(noise[:, 1:] * noise[:, :-1]) / np.var(noise)
    assert after == pytest.approx(0.9 if kind == "coloured" else 0.0, abs=0.02)
    assert beside == pytest.approx(0.3**2 / (1 + 0.3**2) if kind == "common-mode" else 0.0, abs=0.02)
    tail = np.mean(np.abs(noise) > 5e-3)
    assert (tail > 5e-4) == (kind == "heavy-tailed")


def test_nodes_learn_from_a_skin_with_the_defects_of_the_touch() -> None:
    touch = Touch("nothing", ticks=300, stuck=20, drift_n_per_s=5e-3, noise_n=0.5e-3)
    idle, felt = touch.idle(), touch.load().counts
    stuck = np.flatnonzero(np.ptp(idle, axis=0) == 0)
    assert len(stuck) == 20
    np.testing.assert_array_equal(idle[:300, stuck], felt[:, stuck])
    # Zeros drift from the beginning of the touch on.
    assert idle[-100:].mean() == pytest.approx(idle[:100].mean(), rel=0.05)
    assert felt[-50:].mean() > 1.3 * felt[:50].mean()


def test_sensors_of_the_paper_feel_what_they_always_felt() -> None:
    from skin.taxel import sense

    touch = Touch("golf-ball", ticks=50, seed=4)
    what = touch.load()
    np.testing.assert_array_equal(what.felt_n, sense(what.true_n, np.random.default_rng(4)))
    assert touch.is_plain
    assert not replace(touch, stuck=1).is_plain
    coarse = np.zeros((10, SIDE * SIDE // 4), np.float32)
    np.testing.assert_array_equal(
        touch.sensed(coarse, np.random.default_rng(5)), sense(coarse, np.random.default_rng(5))
    )


def test_losses_are_named_as_plainly_as_wins() -> None:
    def row(touch: Touch, family: str, psnr_db: float, error_mn: float, kbit_per_s: float) -> dict[str, object]:
        figures = {"psnr_mean_db": psnr_db, "touched_error_mn": error_mn, "kbit_per_s": kbit_per_s}
        return {"touch": touch, "name": family, "family": family} | figures

    won, lost = Touch("golf-ball"), Touch("nothing")
    rows = [row(won, "adaptive", 50, 0.3, 100), row(won, "scan", 40, 0.8, 3000), row(won, "events", 45, 0.9, 200)]
    rows += [row(lost, "adaptive", 50, 0.3, 100), row(lost, "scan", 51, 0.2, 3000)]
    _, first, second = wins_and_losses(rows).splitlines()
    assert first.startswith("win: golf-ball: +5.0 dB to events; touched 0.30 mN, 0.80 scan; 100 kbit/s, 200 events")
    assert second.startswith("LOSS in PSNR, touched error: nothing: -1.0 dB to scan")
