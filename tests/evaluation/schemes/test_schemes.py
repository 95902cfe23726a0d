"""What the schemes send and show, where the answer is known."""

import numpy as np
import pytest

from dbc.canopen import TPDO_BASES
from dbc.contract import Contract
from dbc.frame import frames
from evaluation.schemes.board import board_of
from evaluation.schemes.events import is_event, run_events
from evaluation.schemes.judge import LATENESS_NS, Images, quality
from evaluation.schemes.scan import refined, run_scan, smoothed, solved
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SLAP, SLAP_MS, Touch
from evaluation.schemes.schemes import FilteredEvents, measure_scheme
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
    # No heartbeat before 0.5 ms but one on each bus after that. 47 bits without stuffing, and what CRC and identifier
    # add; the heartbeat has a byte more.
    assert carried.frames["can_id"].tolist() == [0x555, 0x556, 0x701, 0x701]
    took_ns = carried.ended_ns - [0, 0, 500_000, 500_000] + 3_000
    assert carried.kbit_per_s == took_ns.sum() / 1000 / 0.2 / 1e3


def test_frames_keep_their_places_whoever_wins_the_bus() -> None:
    asked = frames(3)
    asked["can_id"], asked["time_ns"], asked["length"] = (0x300, 0x200, 0x200), (0, 50_000, 0), 8
    ended_ns = carry(asked, np.zeros(3, np.intp), (Bus(name="one", nodes=1),), 1).ended_ns
    assert np.argsort(ended_ns[:3]).tolist() == [2, 1, 0]


def test_a_change_is_sent_once_it_reaches_the_threshold_and_no_smaller_one() -> None:
    run = run_events(steps(0, 99, 100, 199, 0), NEWTON_PER_COUNT, 100 * NEWTON_PER_COUNT)
    shown = np.rint(run.force_n / NEWTON_PER_COUNT).astype(int)
    assert shown.tolist() == [100, 0]
    assert set(run.taxel.tolist()) == {100}
    # 2 bytes: 47 + 16 bits and some stuff bits, at once on an idle bus.
    assert np.all((run.latency_ns >= 57_000) & (run.latency_ns < 80_000))


def test_a_full_bus_leaves_high_node_ids_waiting() -> None:
    counts = np.random.default_rng(0).integers(0, 1024, (80, 4096)).astype(np.int16)
    run = run_events(counts, NEWTON_PER_COUNT, 50 * NEWTON_PER_COUNT)
    assert run.sent.kbit_per_s > 0.9 * 4000  # stuff bits between frames do not count
    mine = run.sent.frames["can_id"][is_event(run.sent.frames)].astype(int)
    sent = np.bincount(mine - TPDO_BASES[0] - 1, minlength=32)
    assert sent[0] > sent[1] > 0
    assert not sent[8:].any()
    assert run.latency_ns.max() > 70 * TICK_NS
    # Every event of a frame arrives with it, four in a full frame.
    assert len(run.taxel) == (run.sent.frames["length"][is_event(run.sent.frames)] // 2).sum()


def test_an_event_is_in_use_once_its_frame_and_the_way_to_a_client_have_passed() -> None:
    counts = steps(0, 500, 500, 500)
    run = run_events(counts, NEWTON_PER_COUNT, 0.004)
    images = run.held(*counts.shape)
    shown = images.force_n[images.used(np.arange(80) * TICK_NS), 100]
    assert np.flatnonzero(shown > 0).tolist() == list(range(22, 80))


@pytest.mark.heavy
def test_filtered_taxels_send_less_than_a_threshold_in_the_noise_would() -> None:
    scheme = FilteredEvents(0.5e-3)
    # 800,000 samples; a taxel that is not filtered passes the threshold in a third of them.
    assert scheme.show(board_of(Touch("nothing", ticks=200))).latency_ns.size < 200
    assert measure_scheme(scheme, Touch("golf ball at rest", ticks=800))["psnr_mean_db"] > 50.5


def test_a_scan_brings_every_value_of_a_still_skin() -> None:
    still = np.tile(np.random.default_rng(10).random(4096, np.float32) * np.float32(0.02), (60, 1))
    run = run_scan(still, 10, 20.0)
    shown = run.held(64, 4096).force_n[-1]
    assert np.abs(shown - still[0]).max() <= 0.51 * 0.02 / 1023
    assert run.sent.frames["length"][: 4 * 32 * 5].max() == 8


def test_sums_of_a_still_skin() -> None:
    contract = Contract.from_layout(in_one_instant())
    counts = np.tile(np.random.default_rng(1).integers(0, 1024, 4096).astype(np.int16), (30, 1))
    run = run_sums(contract, counts)
    pack = contract.packing
    exact = pack.counts(pack.raw(contract.phi.forward(counts[0].astype(np.int32))))
    assert run.sums_n.shape == (3, 1024)
    np.testing.assert_allclose(run.sums_n[0], exact * contract.layout.taxels.newton_per_count, rtol=1e-6, atol=1e-7)
    assert run.closed_ns[0] == run.latency_ns[:256].max()


def test_quality_of_known_errors() -> None:
    true = np.zeros((4, 16), np.float32)
    true[:, 3] = 0.01
    right = Images(np.array([1_500_000 - LATENESS_NS]), true[:1])
    found = quality(true, right)
    # Zeros are shown for two ticks of four: 10 log10(0.02² / (0.01² / 16)) dB, and then the most.
    assert found["psnr_mean_db"] == pytest.approx((10 * np.log10(64) + 71) / 2, abs=1e-4)
    assert found["touched_error_mn"] == pytest.approx(10 * 0.5**0.5, rel=1e-6)
    assert quality(np.zeros_like(true), right)["touched_error_mn"] is None


def test_finer_and_smoother_images_keep_a_flat_touch() -> None:
    flat = Images(np.array([0, 10_000_000]), np.full((2, 1024), 0.005, np.float32))
    np.testing.assert_allclose(refined(flat).force_n, 0.005, atol=1e-6)
    for shown in (smoothed(flat, 0.012), solved(flat, 0.012)):
        np.testing.assert_allclose(shown.force_n[-1], 0.005, atol=1e-4)
        assert shown.ready_ns.tolist() == [0, 10_000_000]


@pytest.mark.heavy
def test_the_first_image_of_a_slap_is_that_of_the_next_sync() -> None:
    # SYNC comes 10 ms after the slap began, frames take 7 to 9 ms, and LATENESS_NS passes until the image is in use.
    contract, board = Contract.from_layout(in_one_instant()), board_of(Touch(SLAP, ticks=400))
    images = run_sums(contract, board.counts, board.idle).images(contract)
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


def _run(turns: int) -> tuple[Contract, SumsRun]:
    """Return what the default skin's boards sent in 60 ms of a rising force, at 200 Hz."""
    contract = Contract.from_layout(changed(load_layout(), sync={"rate_hz": 200.0, "turns": turns}))
    rising = np.repeat(np.arange(60, dtype=np.int16)[:, None], 4096, axis=1)
    return contract, run_sums(contract, rising)


def test_in_turns_each_sum_is_the_newest_that_was_sent() -> None:
    (contract, apart), (_, together) = _run(2), _run(1)
    turn_of_sum = np.repeat(contract.table.turn, (contract.table.gather >= 0).sum(axis=1))
    assert np.bincount(turn_of_sum).tolist() == [512, 512]
    for cycle in range(1, len(apart.sums_n)):
        expected = np.where(turn_of_sum == cycle % 2, together.sums_n[cycle], together.sums_n[cycle - 1])
        np.testing.assert_array_equal(apart.sums_n[cycle], expected)
    assert not apart.images(contract).force_n[0].any()  # one half has not come yet
    assert len(apart.latency_ns) == 256 / 2 * len(apart.sums_n)
