"""What the schemes send and show, where the answer is known."""

import numpy as np
import pytest

from dbc.canopen import TPDO_BASES
from dbc.contract import Contract
from dbc.frame import frames
from evaluation.schemes.board import board_of
from evaluation.schemes.events import is_event, run_events
from evaluation.schemes.judge import LATENESS_NS, Images, Updates, quality
from evaluation.schemes.scan import refined, run_scan, smoothed, solved
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SLAP, SLAP_MS, Touch
from evaluation.schemes.schemes import FilteredEvents, Sums, measure_scheme
from evaluation.schemes.sums import SumsRun, run_sums
from evaluation.schemes.wire import TICK_NS, carry, patches
from skin.layout import Bus, changed, load_layout
from tests.layouts import in_one_instant


def steps(*levels: int, ticks: int = 20) -> np.ndarray:
    """Return counts of a skin whose taxel 100 takes each level for `ticks` milliseconds; all else is 0."""
    counts = np.zeros((ticks * len(levels), 4096), np.int16)
    for place, level in enumerate(levels):
        counts[ticks * place : ticks * (place + 1), 100] = level
    return counts


@pytest.mark.parametrize("side", [64, 32, 16, 8])
def test_every_cell_has_one_node_and_all_buses_have_as_many(side: int) -> None:
    held = patches(side)
    assert np.array_equal(np.sort(held.ravel()), np.arange(side * side))
    assert held.shape[0] == 4


def test_traffic_counts_every_bit_once() -> None:
    asked = frames(2)
    asked["can_id"] = 0x555, 0x556
    lines = (Bus(name="one", nodes=1), Bus(name="two", nodes=1))
    carried = carry(asked, np.array([0, 1]), lines, 200)
    traffic = carried.traffic()
    # No heartbeat before 0.5 ms but one on each bus after that. 47 bits without stuffing, and what CRC and identifier
    # add; the heartbeat has a byte more.
    assert carried.frames["can_id"].tolist() == [0x555, 0x556, 0x701, 0x701]
    took_ns = carried.ended_ns - [0, 0, 500_000, 500_000] + 3_000
    assert traffic["kbit_per_s"] == took_ns.sum() / 1000 / 0.2 / 1e3
    assert traffic["load"] == max(took_ns[carried.bus == bus].sum() for bus in (0, 1)) / 200e6
    assert traffic["load_peak"] == 2 * traffic["load"]


def test_frames_keep_their_places_whoever_wins_the_bus() -> None:
    asked = frames(3)
    asked["can_id"], asked["time_ns"], asked["length"] = (0x300, 0x200, 0x200), (0, 50_000, 0), 8
    ended_ns = carry(asked, np.zeros(3, np.intp), (Bus(name="one", nodes=1),), 1).ended_ns
    assert np.argsort(ended_ns[:3]).tolist() == [2, 1, 0]


def test_a_change_is_sent_once_it_reaches_the_threshold_and_no_smaller_one() -> None:
    run = run_events(steps(0, 99, 100, 199, 0), NEWTON_PER_COUNT, 100 * NEWTON_PER_COUNT)
    shown = np.rint(run.updates.force_n / NEWTON_PER_COUNT).astype(int)
    assert shown.tolist() == [100, 0]
    assert set(run.updates.taxel.tolist()) == {100}
    # 2 bytes: 47 + 16 bits and some stuff bits, at once on an idle bus.
    assert np.all((run.latency_ns >= 57_000) & (run.latency_ns < 80_000))


def test_a_full_bus_leaves_high_node_ids_waiting() -> None:
    counts = np.random.default_rng(0).integers(0, 1024, (80, 4096)).astype(np.int16)
    run = run_events(counts, NEWTON_PER_COUNT, 50 * NEWTON_PER_COUNT)
    assert run.sent.traffic()["load"] > 0.99
    node = run.sent.frames["can_id"][run.frame_of].astype(int) - TPDO_BASES[0] - 1
    sent = np.bincount(node, minlength=32)
    assert sent[0] > sent[1] > 0
    assert not sent[8:].any()
    assert run.latency_ns.max() > 70 * TICK_NS
    # Every event of a frame arrives with it, four in a full frame.
    assert len(run.updates.taxel) == (run.sent.frames["length"][is_event(run.sent.frames)] // 2).sum()


def test_a_lost_event_stays_wrong_until_the_next() -> None:
    run = run_events(steps(0, 500, 500, 500), NEWTON_PER_COUNT, 0.004)
    true = (steps(0, 500, 500, 500) * NEWTON_PER_COUNT).astype(np.float32)
    assert quality(true, run.updates)["longest_wrong_ms"] == 2  # the frame and the way to a client take 2 ms
    assert quality(true, run.updates.kept(np.zeros(len(run.frame_of), np.bool_)))["longest_wrong_ms"] == 60


@pytest.mark.heavy
def test_filtered_taxels_send_less_than_a_threshold_in_the_noise_would() -> None:
    scheme = FilteredEvents(0.5e-3)
    # 800,000 samples; a taxel that is not filtered passes the threshold in a third of them.
    assert scheme.show(board_of(Touch("nothing", ticks=200))).latency_ns.size < 200
    assert measure_scheme(scheme, Touch("golf ball at rest", ticks=800))["error_mn"] < 0.06


def test_a_scan_brings_every_value_of_a_still_skin() -> None:
    still = np.tile(np.random.default_rng(10).random(4096, np.float32) * np.float32(0.02), (60, 1))
    run = run_scan(still, 10, 20.0)
    shown = run.updates.held(np.array([60 * TICK_NS]), 4096).force_n[-1]
    assert np.abs(shown - still[0]).max() <= 0.51 * 0.02 / 1023
    assert run.sent.frames["length"][: 4 * 32 * 5].max() == 8


def test_sums_of_a_still_skin_and_a_lost_frame() -> None:
    contract = Contract.from_layout(in_one_instant())
    counts = np.tile(np.random.default_rng(1).integers(0, 1024, 4096).astype(np.int16), (30, 1))
    run = run_sums(contract, counts)
    pack = contract.packing
    exact = pack.counts(pack.raw(contract.phi.forward(counts[0].astype(np.int32))))
    assert run.sums_n.shape == (3, 1024)
    np.testing.assert_allclose(run.sums_n[0], exact * contract.layout.taxels.newton_per_count, rtol=1e-6, atol=1e-7)
    assert run.valid.all()
    assert run.closed_ns[0] == run.latency_ns[:256].max()
    lost = run_sums(contract, counts, loss_ratio=0.05, seed=3)
    assert 0 < (~lost.valid).sum() < lost.valid.size / 2
    assert ((~lost.valid).sum(axis=1) % 8 == 0).all()


def test_quality_of_known_errors() -> None:
    true = np.zeros((4, 16), np.float32)
    true[:, 3] = 0.01
    right = Images(np.array([1_500_000 - LATENESS_NS]), true[:1])
    found = quality(true, right)
    # Zeros are shown for two ticks: 10 log10(0.02² / (0.01² / 16)) dB.
    assert found["psnr_least_db"] == pytest.approx(10 * np.log10(64), abs=1e-4)
    assert found["psnr_peak_db"] == 71.0
    assert found["longest_wrong_ms"] == 2
    assert found["touched_error_mn"] == pytest.approx(10 * 0.5**0.5, rel=1e-6)
    late = Updates(np.array([2_000_000 - LATENESS_NS]), np.array([3]), np.array([0.01], np.float32))
    assert quality(true, late) == found
    assert quality(np.zeros_like(true), late)["touched_error_mn"] is None


def test_finer_and_smoother_images_keep_a_flat_touch() -> None:
    flat = Images(np.array([0, 10_000_000]), np.full((2, 1024), 0.005, np.float32))
    np.testing.assert_allclose(refined(flat).force_n, 0.005, atol=1e-6)
    for shown in (smoothed(flat, 0.012), solved(flat, 0.012)):
        np.testing.assert_allclose(shown.force_n[-1], 0.005, atol=1e-4)
        assert shown.ready_ns.tolist() == [0, 10_000_000]


@pytest.mark.heavy
def test_the_first_image_of_a_slap_is_that_of_the_next_sync() -> None:
    # SYNC comes 10 ms after the slap began, frames take 7 to 9 ms, and LATENESS_NS passes until the image is in use.
    (images,) = Sums(in_one_instant()).show(board_of(Touch(SLAP, ticks=400))).images.values()
    assert isinstance(images, Images)
    times_ns = (SLAP_MS + 10 + np.array([7, 9])) * TICK_NS + LATENESS_NS
    before, after = (images.force_n[used].max() for used in images.used(times_ns))
    assert before < 0.002 < after


def test_drawn_scenes_differ_by_number_and_seed_and_stay_on_the_skin() -> None:
    touches = [Touch(str(number), ticks=500, scene_seed=seed) for number, seed in ((0, 1), (1, 1), (0, 2))]
    assert len({touch.words for touch in touches}) == 3
    for touch in touches:
        true_n = touch.load().true_n
        assert not true_n[0].any()
        assert true_n[400:].any(axis=1).all()


def _run(turns: int, loss_ratio: float = 0.0) -> tuple[Contract, SumsRun]:
    """Return what the default skin's boards sent in 60 ms of a rising force, at 200 Hz."""
    contract = Contract.from_layout(changed(load_layout(), sync={"rate_hz": 200.0, "turns": turns}))
    rising = np.repeat(np.arange(60, dtype=np.int16)[:, None], 4096, axis=1)
    return contract, run_sums(contract, rising, loss_ratio, seed=3)


def test_in_turns_each_sum_is_the_newest_that_was_sent() -> None:
    (contract, apart), (_, together) = _run(2), _run(1)
    turn_of_sum = np.repeat(contract.table.turn, (contract.table.gather >= 0).sum(axis=1))
    assert np.bincount(turn_of_sum).tolist() == [512, 512]
    for cycle in range(1, len(apart.sums_n)):
        expected = np.where(turn_of_sum == cycle % 2, together.sums_n[cycle], together.sums_n[cycle - 1])
        np.testing.assert_array_equal(apart.sums_n[cycle], expected)
    assert not apart.valid[0].any()  # one half has not come yet
    assert apart.valid[1:].all()
    assert len(apart.latency_ns) == 256 / 2 * len(apart.sums_n)


def test_in_turns_a_lost_frame_costs_its_block_two_cycles() -> None:
    contract, run = _run(2, loss_ratio=0.02)
    lost = np.random.default_rng(3).random((len(run.sums_n), 128)) < 0.02
    assert lost.any()
    block_of_row = contract.phi.block_of_sum[contract.table.gather[:, 0]]
    expected = np.ones((len(lost) + 1, contract.phi.blocks), np.bool_)
    expected[0] = False
    for cycle, place in np.argwhere(lost).tolist():
        block = block_of_row[np.flatnonzero(contract.table.turn == cycle % 2)[place]]
        expected[cycle : cycle + 2, block] = False
    np.testing.assert_array_equal(run.valid, expected[:-1, contract.phi.block_of_sum])
